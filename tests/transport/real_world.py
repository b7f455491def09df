"""Pairs of connected ports, in real time, for testing the behaviour that every port must have."""

from __future__ import annotations

import asyncio
import io
import os
import pty
import tty
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from transport.certificates import Authority

from framekit.api.event_loop import new_event_loop
from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault
from framekit.transport.clock import AsyncioClock
from framekit.transport.port import AcceptedPort, Port
from framekit.transport.pty_port import PtyPair
from framekit.transport.schemes import make_listener, open_port
from framekit.transport.simulated_line import SimulatedLine

T = TypeVar("T")

LONGEST = 180
"""Seconds after which a test that waits for an event is aborted."""


class PtyMaster(io.FileIO):
    """The test's end of a pseudo-terminal, unbuffered.

    Programs may open the other end, `path`, and close it again; closing this end unplugs it.
    """

    def __init__(self) -> None:
        master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        super().__init__(master, "r+")

    def close(self) -> None:
        if not self.closed:
            os.close(self._slave)
        super().close()


def open_pty() -> tuple[str, PtyMaster]:
    """Open a pseudo-terminal; return the path of the port for programs, and the file at the other end."""
    master = PtyMaster()
    return master.path, master


class Waiting:
    """Awaitable events of a port. `seen` lists their kinds, `times` their times."""

    def __init__(self) -> None:
        self.queue: asyncio.Queue[tuple[str, Any]] = asyncio.Queue()
        self.seen: list[str] = []
        self.times: list[int] = []

    def _note(self, kind: str, now: int, value: object = None) -> None:
        self.seen.append(kind)
        self.times.append(now)
        self.queue.put_nowait((kind, value))

    def opened(self, now: int) -> None:
        self._note("opened", now)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self._note("received", now, (data, faults))

    def other_sender(self, now: int) -> None:
        self._note("other sender", now)

    def line_break(self, now: int) -> None:
        self._note("break", now)

    def sent(self, now: int) -> None:
        self._note("sent", now)

    def closed(self, now: int, reason: str) -> None:
        self._note("closed", now, reason)

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        self._note("control", now, lines)

    async def until(self, kind: str) -> Any:
        """Return the next event of a kind; earlier events are skipped."""
        while True:
            found, value = await self.queue.get()
            if found == kind:
                return value

    async def sent_and_heard(self, count: int) -> bytes:
        """Return `count` received bytes; also wait for `sent`, which may come before, between or after them."""
        data, sent = b"", False
        while len(data) < count or not sent:
            kind, value = await self.queue.get()
            sent = sent or kind == "sent"
            data += value[0] if kind == "received" else b""
        return data

    async def bytes(self, count: int) -> bytes:
        data = bytearray()
        while len(data) < count:
            data += (await self.until("received"))[0]
        return bytes(data)


@dataclass
class Pair:
    """Two open ports. `again` reopens the left port and returns both; `pull` unplugs the far end of the left port."""

    clock: AsyncioClock
    left: Port
    right: Port
    here: Waiting
    there: Waiting
    again: Callable[[], Coroutine[Any, Any, None]]
    pull: Callable[[], None]


async def opened(port: Port) -> Waiting:
    events = Waiting()
    port.open(events)
    await events.until("opened")
    return events


async def _both(left: Port, right: Port) -> tuple[Waiting, Waiting]:
    here, there = Waiting(), Waiting()
    left.open(here)
    right.open(there)
    await here.until("opened")
    await there.until("opened")
    return here, there


@asynccontextmanager
async def simulated(settings: LineFormat | None) -> AsyncIterator[Pair]:
    clock = AsyncioClock(asyncio.get_running_loop())
    line = SimulatedLine(clock, settings)
    left, right = line.port("left"), line.port("right")
    here, there = await _both(left, right)

    async def again() -> None:
        pair.left.close()
        if settings is None:
            await pair.there.until("closed")
            pair.here, pair.there = await _both(left, right)
        else:
            pair.here = await opened(left)

    pair = Pair(clock, left, right, here, there, again, left.pull if settings else right.close)
    yield pair


@asynccontextmanager
async def pseudo_terminals() -> AsyncIterator[Pair]:
    clock = AsyncioClock(asyncio.get_running_loop())
    with PtyPair() as wires:
        left = open_port(wires.first, LineFormat(19200, parity="E"), clock)
        right = open_port(wires.second, LineFormat(19200, parity="E"), clock)
        here, there = await _both(left, right)

        async def again() -> None:
            left.close()
            pair.here = await opened(left)

        pair = Pair(clock, left, right, here, there, again, wires.close)
        yield pair


@asynccontextmanager
async def network(client: str) -> AsyncIterator[Pair]:
    """Return a client port of this URL scheme, and the port of the accepted connection."""
    clock = AsyncioClock(asyncio.get_running_loop())
    accepted: asyncio.Queue[AcceptedPort] = asyncio.Queue()
    folder = TemporaryDirectory()
    listens, query = "tcp-listen://127.0.0.1:0", ""
    if client == "tls":
        authority = Authority(Path(folder.name))
        cert, key = authority.issue("server", hosts=("127.0.0.1",))
        listens, query = f"tls://127.0.0.1:0?cert={cert}&key={key}", f"?ca={authority.ca}"
    listener = make_listener(listens, clock, accepted.put_nowait)
    listener.listen()
    left = open_port(f"{client}://127.0.0.1:{listener.name.rpartition(':')[2]}{query}", LineFormat(1_000_000), clock)

    async def connected() -> tuple[Waiting, Port, Waiting]:
        here = Waiting()
        left.open(here)
        right = await accepted.get()
        there = await opened(right)
        await here.until("opened")
        return here, right, there

    async def again() -> None:
        left.close()
        await pair.there.until("closed")
        pair.here, pair.right, pair.there = await connected()

    here, right, there = await connected()
    pair = Pair(clock, left, right, here, there, again, right.close)
    try:
        yield pair
    finally:
        listener.stop()
        folder.cleanup()


PAIRS: dict[str, Callable[[], AbstractAsyncContextManager[Pair]]] = {
    "simulated line": lambda: simulated(LineFormat(2_000_000)),
    "simulated stream": lambda: simulated(None),
    "pty": pseudo_terminals,
    "tcp": lambda: network("tcp"),
    "tls": lambda: network("tls"),
    "socket": lambda: network("socket"),
}


def run(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a test in the selected event loop, with a limit on the whole; return its result."""
    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        return runner.run(asyncio.wait_for(coroutine, LONGEST))


def on_pair(kind: str, check: Callable[[Pair], Coroutine[Any, Any, None]]) -> None:
    """Run a check on a pair, and close both ports."""

    async def all_of_it() -> None:
        async with PAIRS[kind]() as pair:
            try:
                await check(pair)
            finally:
                pair.left.close()
                pair.right.close()

    run(all_of_it())

"""Helpers of the link tests: protocols from text, receivers fed in pieces, and engines on a virtual line."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER, LineFormat
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived
from framekit.link.engine import Engine
from framekit.link.events import (
    Break,
    CharacterFault,
    Command,
    Exchange,
    LineFault,
    Outcome,
    Seen,
    Send,
    Served,
    SetRts,
)
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope
from framekit.link.values import FrameValue

MS = 1_000_000
SECOND = 1_000 * MS


@cache
def load(text: str) -> Protocol:
    """Load a protocol from its text; `extends: standard` works."""
    return load_protocol_text(text, "made_up", Path(__file__).parents[2] / "frames")


@cache
def compiled(text: str) -> tuple[Protocol, Any]:
    """Return the protocol and its codec."""
    protocol = load(text)
    return protocol, compile_protocol(protocol)


def line_of(protocol: Protocol) -> LineFormat | None:
    return None if protocol.line.kind == "stream" else LineFormat(9600)


def receiver_of(text: str, **params: Any) -> Receiver:
    protocol, codec = compiled(text)
    return Receiver(codec, protocol, Scope(protocol, params=params, line=line_of(protocol)))


def comparable(event: Arrival) -> tuple[Any, ...]:
    """Return the parts of an arrival that tests compare."""
    if isinstance(event, FrameArrived):
        return ("frame", event.value.frame, event.raw, event.offset, event.value.refusal)
    if isinstance(event, BadFrame):
        return ("bad", event.frame, event.cause, event.raw, event.offset)
    return ("noise", event.data, event.offset, event.skipped)


def feed(
    receiver: Receiver,
    pieces: Iterable[bytes],
    expected: tuple[str, ...],
    others: tuple[str, ...] = (),
    *,
    step: int = 0,
    quiet_at_end: bool = True,
) -> list[tuple[Any, ...]]:
    """Return all events for pieces that arrive `step` ns apart, and for the silence after them."""
    found, now = [], 0
    for piece in pieces:
        receiver.append(piece, now)
        while (event := receiver.next(expected, others)) is not None:
            found.append(comparable(event))
        now += step
    if quiet_at_end:
        receiver.tick(now + 3600 * SECOND)
        while (event := receiver.next(expected, others)) is not None:
            found.append(comparable(event))
    return found


def cut_at(data: bytes, places: Sequence[int]) -> list[bytes]:
    """Cut `data` at these offsets."""
    edges = [0, *sorted({place % (len(data) + 1) for place in places}), len(data)]
    return [data[start:end] for start, end in pairwise(edges) if start < end]


class Echoing:
    """A server whose replies are computed from the requests by a function."""

    def __init__(self, answer: Callable[[FrameValue], FrameValue | None]) -> None:
        self.answer = answer
        self.requests: list[FrameValue] = []
        self.not_answered = 0

    def serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Any) -> Served:
        if not check_only:
            self.requests.append(request)
        if request.refusal is not None:
            return Served(None, refusal=request.refusal)
        return Served(self.answer(request), reply_buffer=buffer[::-1])

    def unanswered(self) -> None:
        self.not_answered += 1


class Side:
    """An engine on virtual time, with its transmissions and events. Its peer is the test, or another `Side`."""

    def __init__(self, text: str, role: str | None, *, line: LineFormat | None = None, **options: Any) -> None:
        protocol, codec = compiled(text)
        self.seen: list[Seen] = []
        self.arrived: list[FrameValue] = []
        self.outcomes: list[Outcome] = []
        self.engine = Engine(
            protocol, codec, role, line=line or line_of(protocol),
            on_frame=self.arrived.append, monitor=self.seen.append, **options,
        )  # fmt: skip
        self.now = 0
        self.sent: list[tuple[int, bytes]] = []
        self.commands: list[Command] = []
        self._waiting: list[Command] = []
        self._leaving: int | None = None
        self.forwarded = 0
        self.do(self.engine.opened(0))

    # ---- what happens to it -------------------------------------------------------------------------------

    def do(self, commands: list[Command]) -> None:
        self.commands.extend(commands)
        self._waiting.extend(commands)
        self._give()

    def _give(self) -> None:
        while self._waiting and self._leaving is None:
            command = self._waiting[0]
            if getattr(command, "not_before", 0) > self.now:
                return
            self._waiting.pop(0)
            if isinstance(command, Send):
                self.sent.append((self.now, command.data))
                if not command.inside:
                    self._leaving = self.now + self.engine.scope.line.chars(len(command.data))
            elif isinstance(command, Break):
                self.sent.append((self.now, b"BREAK"))
                self._leaving = self.now + command.duration
            elif isinstance(command, SetRts):
                self.sent.append((self.now, b"RTS" if command.on else b"rts"))

    def next_time(self) -> int:
        times = [self.engine.deadline]
        if self._leaving is not None:
            times.append(self._leaving)
        elif self._waiting:
            times.append(getattr(self._waiting[0], "not_before", self.now))
        return max(self.now, min(times))

    def run(self, time: int) -> None:
        """Advance the time and run all timers that are due, including those at the end."""
        end = self.now + time
        while (at := self.next_time()) <= end and at < NEVER:
            self.now = at
            if self._leaving is not None and self._leaving <= at:
                self._leaving = None
                self.do(self.engine.sent(at))
            elif self._waiting and self._leaving is None:
                self._give()
            else:
                self.do(self.engine.tick(at))
        self.now = end

    def gets(self, data: bytes, *, faults: dict[int, LineFault] | None = None, whole: bool = False) -> None:
        """Receive bytes one by one, or with `whole` in one piece after their transmission time."""
        pieces = [data] if whole else [data[index : index + 1] for index in range(len(data))]
        place = 0
        for piece in pieces:
            self.run(self.engine.scope.line.chars(len(piece)))
            marks = [
                CharacterFault(index - place, fault)
                for index, fault in (faults or {}).items()
                if place <= index < place + len(piece)
            ]
            self.do(self.engine.receive(piece, self.now, marks))
            place += len(piece)

    def line_break(self) -> None:
        self.do(self.engine.line_break(self.now))

    # ---- asking it ----------------------------------------------------------------------------------------

    def ask(self, request: FrameValue | None = None, *, expected: tuple[str, ...] = (), **more: Any) -> Exchange:
        exchange = Exchange(request=request, expected=expected, on_done=self.outcomes.append, **more)
        self.do(self.engine.start(exchange, self.now))
        return exchange

    def taken(self) -> list[bytes]:
        """Return the transmissions since the last call."""
        found = [data for _, data in self.sent]
        self.sent.clear()
        self.forwarded = 0
        return found

    def reasons(self, kind: str) -> list[str]:
        return [seen.reason for seen in self.seen if seen.kind == kind]


def connect(first: Side, second: Side, time: int, damage: Callable[[bytes], bytes] = lambda data: data) -> None:
    """Let two sides communicate for a time; `damage` changes the transmitted bytes."""
    end = first.now + time
    while True:
        at = min(first.next_time(), second.next_time())
        if (at > end or at >= NEVER) and all(side.forwarded == len(side.sent) for side in (first, second)):
            break
        for side, peer in ((first, second), (second, first)):
            if side.next_time() <= at <= end:
                side.run(at - side.now)
            fresh = side.sent[side.forwarded :]
            side.forwarded = len(side.sent)
            for started, data in fresh:
                took = side.engine.scope.line.chars(len(data))
                side.run(max(0, started + took - side.now))
                peer.run(max(0, side.now - peer.now))
                peer.do(peer.engine.receive(damage(data), peer.now))
    for side in (first, second):
        side.run(max(0, end - side.now))

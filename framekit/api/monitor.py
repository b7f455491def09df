"""What is seen on lines, for people: a monitor of one line, the log of frames, and what a display shows."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framekit.api.errors import RequestError
from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.plain import PlainValues
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import LineFormat
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.events import CharacterFault, Command
from framekit.link.listener import Listener
from framekit.link.observe import Monitor, Seen
from framekit.link.scope import Scope
from framekit.run.block_state import BlockStatus
from framekit.service.capture import Capture
from framekit.service.driver import Driver
from framekit.service.line_load import LineLoad
from framekit.transport.clock import AsyncioClock, Clock
from framekit.transport.port import Port
from framekit.transport.schemes import open_port

UNKNOWN = "unknown"
USER_DEFINED = "user-defined"
KEPT = 10_000
"""So many entries are kept; older ones are dropped and counted."""
FAULTY = ("bad", "noise", "trouble")


def result_of(protocol: Protocol, seen: Seen, role: str | None = None) -> str:
    """The processing result: whose frame it is (protocol and side), or that it could not be processed.

    `role` is the own one; without it (somebody only listens) the side that sent it stands there.
    """
    if seen.kind in FAULTY:
        return UNKNOWN
    if seen.kind != "frame":
        return ""
    if protocol.frames_alone:
        return USER_DEFINED
    side = role
    if side is None:
        frame = protocol.frames.get(seen.frame)
        side = "" if frame is None or frame.side not in ("client", "server") else frame.side
    return f"{protocol.name} {side}".rstrip()


def ascii_of(data: bytes) -> str:
    """Printable characters as they are, others as a dot."""
    return "".join(chr(byte) if 32 <= byte < 127 else "·" for byte in data)


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """One thing seen. `number` counts all of them from 1."""

    number: int
    channel: int
    seen: Seen
    result: str


@dataclass(frozen=True, slots=True)
class FrameFilter:
    """Which entries are wanted; empty wants all. `text` is searched in names, reasons, hex pairs and ASCII."""

    channel: int | None = None
    frame: str = ""
    bad_only: bool = False
    text: str = ""

    def takes(self, channel: int, seen: Seen) -> bool:
        """Whether it is wanted."""
        if self.channel is not None and channel != self.channel:
            return False
        if self.bad_only and seen.kind not in FAULTY:
            return False
        if self.frame and self.frame.lower() not in seen.frame.lower():
            return False
        return not self.text or self._found(seen)

    def _found(self, seen: Seen) -> bool:
        wanted = self.text.lower()
        texts = (seen.frame, seen.kind, seen.reason, seen.raw.hex(" "), seen.raw.hex(), ascii_of(seen.raw))
        return any(wanted in text.lower() for text in texts)

    def matches(self, entry: FrameEntry) -> bool:
        """The same for an entry."""
        return self.takes(entry.channel, entry.seen)


@dataclass(frozen=True, slots=True)
class FieldRow:
    """One field of a frame: its path, where it stands and what it says."""

    path: str
    offset: int
    data: bytes
    value: str


class FrameLog:
    """The last `kept` entries. `add` is a run's monitor."""

    def __init__(
        self,
        protocols: Mapping[int, Protocol],
        roles: Mapping[int, str | None] | None = None,
        params: Mapping[int, Mapping[str, Any]] | None = None,
        kept: int = KEPT,
    ) -> None:
        self.protocols = dict(protocols)
        self.roles = dict(roles or {})
        self.counts: Counter[str] = Counter()
        self.dropped = 0
        self._params = dict(params or {})
        self._entries: deque[FrameEntry] = deque(maxlen=kept)
        self._number = 0

    def know(self, channel: int, protocol: Protocol, role: str | None, params: Mapping[str, Any]) -> None:
        """A channel that came later."""
        self.protocols[channel], self.roles[channel], self._params[channel] = protocol, role, params

    def add(self, channel: int, seen: Seen) -> None:
        """Takes what was seen on a channel."""
        self._number += 1
        if seen.kind != "noise" or not seen.reason:  # what a bad frame left is part of that
            self.counts[seen.kind] += 1
        if len(self._entries) == self._entries.maxlen:
            self.dropped += 1
        result = result_of(self.protocols[channel], seen, self.roles.get(channel))
        self._entries.append(FrameEntry(self._number, channel, seen, result))

    @property
    def last_number(self) -> int:
        """The number of the newest entry; 0 when there is none."""
        return self._number

    def since(self, number: int) -> list[FrameEntry]:
        """Entries newer than a number, older first."""
        found: list[FrameEntry] = []
        for entry in reversed(self._entries):
            if entry.number <= number:
                break
            found.append(entry)
        return found[::-1]

    def chosen(self, wanted: FrameFilter) -> Iterator[FrameEntry]:
        """The entries a filter wants, older first."""
        return (entry for entry in self._entries if wanted.matches(entry))

    def entry(self, number: int) -> FrameEntry | None:
        """An entry by its number, if it is still kept."""
        first = self._number - len(self._entries) + 1
        return self._entries[number - first] if first <= number <= self._number else None

    def fields(self, entry: FrameEntry) -> list[FieldRow]:
        """The fields of a frame with their places; of a bad one as far as it can be read."""
        protocol = self.protocols[entry.channel]
        if entry.seen.frame not in protocol.frames:
            return []
        codec = compile_protocol(protocol)
        return field_rows(codec, protocol, entry.seen, self._params.get(entry.channel))


def field_rows(codec: Codec, protocol: Protocol, seen: Seen, params: Mapping[str, Any] | None = None) -> list[FieldRow]:
    """The fields of a frame that was seen, in the order of its bytes."""
    plain = PlainValues(protocol)
    try:
        _, spans, _ = codec.trace(seen.frame, seen.raw, Scope(protocol, params=params))
    except EVALUATION_ERRORS:
        return [FieldRow(name, 0, b"", str(value)) for name, value in plain.to_plain(seen.frame, seen.fields).items()]
    rows = []
    for path, start, end, value in spans:
        shown = plain.to_plain("", {"": value})[""]
        rows.append(FieldRow(path, start, seen.raw[start:end], "" if shown is None else str(shown)))
    return rows


class _Listening:
    """A listener as drivers know engines: it never has a command."""

    def __init__(self, listener: Listener, monitor: Monitor) -> None:
        self.listener = listener
        self.monitor = monitor

    @property
    def deadline(self) -> int:
        return self.listener.deadline

    def opened(self, now: int) -> list[Command]:
        self.monitor(Seen("", "open", now))
        return []

    def closed(self, now: int, reason: str = "") -> list[Command]:
        self.listener.ended(now)
        self.monitor(Seen("", "closed", now, reason=reason))
        return []

    def receive(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> list[Command]:
        self.listener.receive(data, now, faults)
        return []

    def other_sender(self, now: int) -> list[Command]:
        self.listener.other_sender(now)
        return []

    def line_break(self, now: int) -> list[Command]:
        self.listener.line_break(now)
        return []

    def sent(self, now: int) -> list[Command]:
        return []

    def control(self, lines: Mapping[str, bool], now: int) -> list[Command]:
        return []

    def tick(self, now: int) -> list[Command]:
        self.listener.tick(now)
        return []


class LineMonitor:
    """Tells `monitor` everything that goes over the line. Raises ParameterError for parameters that do not fit.

    `lost`: what is not in its capture, known after `stop`.
    """

    def __init__(
        self,
        protocol: Protocol,
        port: Port,
        clock: Clock,
        monitor: Monitor,
        *,
        params: Mapping[str, Any] | None = None,
        on_state: Callable[[str], None] | None = None,
    ) -> None:
        self.protocol = protocol
        self.port = port
        self.clock = clock
        self.listener = Listener(
            protocol, compile_protocol(protocol), monitor, params=params, line=port.settings, now=clock.now()
        )
        self.lost: list[str] = []
        self._capture: Capture | None = None
        self._driver = Driver(_Listening(self.listener, monitor), port, clock, on_state)

    @classmethod
    def at(
        cls, protocol: Protocol, url: str, monitor: Monitor, *, line: LineFormat | None,
        params: Mapping[str, Any] | None = None, capture: Path | None = None,
        on_state: Callable[[str], None] | None = None,
    ) -> LineMonitor:  # fmt: skip
        """A monitor of a port, in the running loop, with all it hears in the file `capture`.

        Raises RequestError; OSError for a capture that cannot be written.
        """
        clock = AsyncioClock(asyncio.get_running_loop())
        try:
            port = open_port(protocol.line.port_of(url), line, clock, listen_only=True)
            capturing = None if capture is None else Capture(capture, (1,), clock)
            tapped = port if capturing is None else capturing.around(1, port)
            found = cls(protocol, tapped, clock, monitor, params=params, on_state=on_state)
        except ValueError as error:
            raise RequestError(str(error)) from None
        found._capture = capturing
        return found

    @property
    def load(self) -> LineLoad:
        """How busy the line is."""
        return self._driver.load

    def start(self) -> None:
        """Opens the port."""
        self._driver.start()

    def stop(self) -> None:
        """Closes the port; what is unfinished is told."""
        self._driver.stop()
        self.listener.ended(self.clock.now())
        if self._capture is not None:
            self._capture.close()
            self.lost = self._capture.troubles


@dataclass(frozen=True, slots=True)
class LineOf:
    """One line that is shown: what it is called, how it is doing (open, or why not), how busy it is."""

    name: str
    state: Callable[[], str]
    load: LineLoad


class LiveView:
    """What a display shows of `lines`. `now` tells the time, `blocks` how the blocks are doing, where there are any."""

    def __init__(
        self,
        log: FrameLog,
        now: Callable[[], int],
        lines: Mapping[int, LineOf],
        blocks: Callable[[], list[BlockStatus]] = list,
    ) -> None:
        self.log = log
        self.now = now
        self.lines = lines
        self.blocks = blocks
        self.began = now()

    @property
    def elapsed(self) -> int:
        """Since it began (ns)."""
        return self.now() - self.began

    def seconds(self, at: int) -> float:
        """A time of the clock in seconds since it began."""
        return (at - self.began) / 1e9

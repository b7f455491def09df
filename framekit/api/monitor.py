"""Lines without a run: monitors, the log of frames, the content of a display; decoding and replay of captures."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from framekit.api.errors import LineClosedError, RequestError
from framekit.api.rows import FAULTY, FieldRow, FrameEntry, ascii_of, inner_names
from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.contents import Requests, contents_of
from framekit.codec.plain import PlainValues
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import error_text, plural
from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault, Command, Monitor, Seen
from framekit.link.listener import Listener
from framekit.link.scope import Scope
from framekit.link.values import EVALUATION_ERRORS
from framekit.link.variables import ParameterError
from framekit.run.block_state import BlockStatus
from framekit.run.status import USER_DEFINED
from framekit.run.trouble import TroubleReport
from framekit.service.capture import Capture, CaptureDecoder, CaptureReader, file_of_channel
from framekit.service.driver import Driver, LineLoad
from framekit.transport.clock import AsyncioClock, Clock, VirtualClock
from framekit.transport.port import AcceptedPort, Port, PortEvents
from framekit.transport.port import LineEvent as LineEvent
from framekit.transport.schemes import make_listener, open_port, scheme_of
from framekit.transport.simulated_line import SimulatedLine

UNKNOWN = "unknown"
KEPT = 10_000
"""Largest number of kept entries; older entries are dropped and counted."""


def result_of(protocol: Protocol, seen: Seen, role: str | None = None) -> str:
    """Return the processing result: protocol and side of the frame, or that it could not be processed.

    `role` is the own role; without it (a monitor only listens) the sender's side is used.
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


@dataclass(frozen=True, slots=True)
class FrameFilter:
    """Selection of entries; empty selects all. `text` is searched in names, reasons, hex pairs and ASCII."""

    channel: int | None = None
    frame: str = ""
    bad_only: bool = False
    text: str = ""

    def takes(self, channel: int, seen: Seen) -> bool:
        """Return whether an event is selected."""
        if self.channel is not None and channel != self.channel:
            return False
        if self.bad_only and seen.kind not in FAULTY:
            return False
        if self.frame and not any(self.frame.lower() in name.lower() for name in _names(seen)):
            return False
        return not self.text or self._found(seen)

    def _found(self, seen: Seen) -> bool:
        wanted = self.text.lower()
        texts = (*_names(seen), seen.kind, seen.reason, seen.raw.hex(" "), seen.raw.hex(), ascii_of(seen.raw))
        return any(wanted in text.lower() for text in texts)


def _names(seen: Seen) -> tuple[str, ...]:
    """Return the names of a frame and of the frames inside it."""
    return (seen.frame, *inner_names(seen.fields))


def parse_filter(text: str, bad_only: bool) -> FrameFilter:
    """Parse `ch:1 frame:read text …`: a channel, a part of a frame's name, and a text to be found."""
    channel: int | None = None
    frame, rest = "", []
    for word in text.split():
        key, colon, value = word.partition(":")
        if colon and key == "ch" and value.isdecimal() and len(value) < 10:
            channel = int(value)
        elif colon and key == "frame":
            frame = value
        else:
            rest.append(word)
    return FrameFilter(channel, frame, bad_only, " ".join(rest))


class FrameLog:
    """The last `kept` entries. `add` is a run's monitor."""

    def __init__(self, protocols: Mapping[int, Protocol] | None = None, kept: int = KEPT) -> None:
        self.counts: Counter[str] = Counter()
        self.dropped = 0
        self.last_number = 0
        """Number of the newest entry; 0 without entries."""
        self._channels: dict[int, tuple[Protocol, str | None, Mapping[str, Any]]] = {}
        for channel, protocol in (protocols or {}).items():
            self.know(channel, protocol, None, {})
        self._entries: deque[FrameEntry] = deque(maxlen=kept)
        self._requests = Requests()

    def know(self, channel: int, protocol: Protocol, role: str | None, params: Mapping[str, Any]) -> None:
        """Register a channel with its protocol."""
        self._channels[channel] = protocol, role, params

    def add(self, channel: int, seen: Seen) -> None:
        """Add an event of a channel."""
        self.last_number += 1
        if seen.kind != "noise" or not seen.reason:  # noise left by a bad frame is part of that frame
            self.counts[seen.kind] += 1
        if len(self._entries) == self._entries.maxlen:
            self.dropped += 1
        protocol, role, _ = self._channels[channel]
        self._requests.attach(contents_of(protocol), seen, channel)
        self._entries.append(FrameEntry(self.last_number, channel, seen, result_of(protocol, seen, role)))

    def protocol(self, channel: int) -> Protocol:
        """Return the protocol of a channel."""
        return self._channels[channel][0]

    def since(self, number: int, most: int = KEPT) -> list[FrameEntry]:
        """Return the entries newer than a number, the last `most` of them, older first."""
        found: list[FrameEntry] = []
        for entry in reversed(self._entries):
            if entry.number <= number or len(found) == most:
                break
            found.append(entry)
        return found[::-1]

    def latest(self, wanted: FrameFilter, number: int, most: int) -> Iterator[FrameEntry]:
        """Return the entries up to a number that a filter selects, newer first; at most `most` entries are examined."""
        up_to = (entry for entry in reversed(self._entries) if entry.number <= number)
        return (entry for entry in islice(up_to, most) if wanted.takes(entry.channel, entry.seen))

    def chosen(self, wanted: FrameFilter) -> Iterator[FrameEntry]:
        """Return the entries that a filter selects, older first."""
        return (entry for entry in self._entries if wanted.takes(entry.channel, entry.seen))

    def entry(self, number: int) -> FrameEntry | None:
        """Return an entry by its number; None if it is no longer kept."""
        first = self.last_number - len(self._entries) + 1
        return self._entries[number - first] if first <= number <= self.last_number else None

    def fields(self, entry: FrameEntry) -> list[FieldRow]:
        """Return the fields of a frame with their offsets; of a bad frame the readable fields."""
        protocol, _, params = self._channels[entry.channel]
        if entry.seen.frame not in protocol.frames:
            return []
        return field_rows(compile_protocol(protocol), protocol, entry.seen, params)


def field_rows(codec: Codec, protocol: Protocol, seen: Seen, params: Mapping[str, Any] | None = None) -> list[FieldRow]:
    """Return the fields of an entry's frame, in the order of its bytes."""
    plain = PlainValues(protocol)
    try:
        _, spans, _ = codec.trace(seen.frame, seen.raw, Scope(protocol, params=params))
    except EVALUATION_ERRORS:
        return [FieldRow(name, 0, b"", str(value)) for name, value in plain.to_plain(seen.frame, seen.fields).items()]
    rows: list[FieldRow] = []
    for path, start, end, value in spans:
        shown = plain.named(seen.frame, path, plain.to_plain("", {"": value})[""])
        rows.append(FieldRow(path, start, seen.raw[start:end], "" if shown is None else str(shown)))
    content = contents_of(protocol, codec).rows(seen.frame, seen.fields, seen.request)
    return rows + [FieldRow(path, rows[-1].offset if rows else 0, b"", str(value)) for path, value in content]


class _Listening:
    """A listener with the interface of an engine for drivers; it never has a command."""

    def __init__(self, listener: Listener, monitor: Monitor) -> None:
        self.listener = listener
        self.monitor = monitor

    @property
    def deadline(self) -> int:
        return self.listener.deadline

    @property
    def good_frames(self) -> int:
        return self.listener.counters.received

    def opened(self, now: int) -> list[Command]:
        self.monitor(Seen("", "open", now))
        return []

    def hear_marks(self) -> None:
        self.listener.hear_marks()

    def hear_late(self) -> None:
        self.listener.hear_late()

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
    """Reports everything on the line to `monitor`. Raises ParameterError for parameters that do not fit.

    `lost`: data missing in its capture, known after `stop`.
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

        def told(seen: Seen) -> None:
            seen.client = port.sender
            monitor(seen)

        self.listener = Listener(
            protocol, compile_protocol(protocol), told, params=params, line=port.settings, now=clock.now()
        )
        self.lost: list[str] = []
        self._capture: Capture | None = None
        self._driver = Driver(_Listening(self.listener, told), port, clock, on_state)

    @classmethod
    def at(
        cls, protocol: Protocol, url: str, monitor: Monitor, *, line: LineFormat | None,
        params: Mapping[str, Any] | None = None, capture: Path | None = None,
        on_state: Callable[[str], None] | None = None,
    ) -> LineMonitor:  # fmt: skip
        """Return a monitor of a port, in the running loop, with a capture of its traffic in the file `capture`.

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
        """Return the load of the line."""
        return self._driver.load

    def watch_troubles(self, listener: Callable[[TroubleReport], None]) -> None:
        """Call `listener` when the capture cannot be written, at once."""
        if self._capture is not None:
            self._capture.troubles.listen(listener)

    def start(self) -> None:
        """Open the port."""
        self._driver.start()

    def stop(self) -> None:
        """Close the port; unfinished frames are reported."""
        self._driver.stop()
        self.listener.ended(self.clock.now())
        if self._capture is not None:
            self._capture.close()
            self.lost = self._capture.problems


@dataclass(frozen=True, slots=True)
class LineOf:
    """A displayed line: its name, its state (open, or why not), and its load."""

    name: str
    state: Callable[[], str]
    load: LineLoad


class LiveView:
    """Content of a display. `now` returns the time, `blocks` the state of the blocks, if any.

    `points`: the present values, as rows of text; `troubles`: the present troubles, as sentences.
    """

    def __init__(
        self,
        log: FrameLog,
        now: Callable[[], int],
        lines: Mapping[int, LineOf],
        blocks: Callable[[], list[BlockStatus]] = list,
        points: Callable[[], list[tuple[str, ...]]] = list,
        troubles: Callable[[], list[str]] = list,
    ) -> None:
        self.log = log
        self.now = now
        self.lines = lines
        self.blocks = blocks
        self.points = points
        self.troubles = troubles
        self.began = now()

    @property
    def elapsed(self) -> int:
        """Return the time since the begin (ns)."""
        return self.now() - self.began

    def seconds(self, at: int) -> float:
        """Return a time of the clock in seconds since it began."""
        return (at - self.began) / 1e9


class Replay(PortEvents):
    """Sends the data that a capture has in `direction`; `on_end(reason)` is called once, '' when everything has been
    sent.

    `speed_up`: factor of the speed; None: each piece as soon as the previous has left.
    """

    def __init__(
        self,
        events: Iterable[LineEvent],
        port: Port,
        clock: Clock,
        on_end: Callable[[str], None],
        *,
        direction: Literal["in", "out"] = "out",
        speed_up: float | None = 1.0,
    ) -> None:
        self.port = port
        self.clock = clock
        self.pieces_sent = self.bytes_sent = self.bytes_received = 0
        self.began = self.ended_at = 0
        self._events = [event for event in events if event.kind == "data" and event.direction == direction]
        self._on_end = on_end
        self._speed_up = speed_up
        self._character = 0 if port.settings is None else port.settings.character_time
        self._over = False

    @property
    def pieces(self) -> int:
        """Return the number of pieces."""
        return len(self._events)

    def start(self) -> None:
        """Open the port and begin."""
        self.port.open(self)

    def stop(self) -> None:
        """End at once."""
        self._end("stopped")

    def _begun_at(self, event: LineEvent) -> int:
        """Return the time of its first bit on the line: received bytes have the time of their last."""
        return event.at - (len(event.data) * self._character if event.direction == "in" else 0)

    def _next(self) -> None:
        """Schedule the next piece at its time, or end."""
        if self._over:
            return
        if self.pieces_sent >= len(self._events):
            self._end("")
        elif self._speed_up is None:
            self._send()
        else:
            passed = self._begun_at(self._events[self.pieces_sent]) - self._begun_at(self._events[0])
            self.clock.call_at(self.began + round(passed / self._speed_up), self._send)

    def _send(self) -> None:
        if self._over:
            return
        data = self._events[self.pieces_sent].data
        self.pieces_sent += 1
        self.bytes_sent += len(data)
        self.port.write(data)

    def _end(self, reason: str) -> None:
        if not self._over:
            self._over = True
            self.ended_at = self.clock.now()
            self.port.close()
            self._on_end(reason)

    # ---- events of the port -------------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        self.began = now
        self._next()

    def sent(self, now: int) -> None:
        self._next()

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self.bytes_received += len(data)

    def closed(self, now: int, reason: str) -> None:
        self._end(reason)


PATIENCE = 500_000_000
"""Allowed delay of the last byte beyond the duration of all bytes (ns)."""
SLOW = 1.25
"""Factor by which a line may exceed the computed time before it counts as running at another speed."""

PortMaker = Callable[[LineFormat], Port]


@dataclass(slots=True)
class LoopbackResult:
    """Result for one speed and format. Times in ns; `problems` is empty if everything returned."""

    line: LineFormat
    sent: int = 0
    received: int = 0
    expected_time: int = 0
    measured_time: int = 0
    problems: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        return not self.problems


def pattern_of(line: LineFormat) -> bytes:
    """Return every character of the format, then alternating ones and zeros."""
    most = 1 << line.data_bits
    return bytes(range(most)) + bytes((0x55 & most - 1, 0xAA & most - 1)) * 8


class Loopback:
    """Tests `lines` in order; `on_end` gets all results. Each test opens and closes a port of its own."""

    def __init__(
        self,
        make_port: PortMaker,
        clock: Clock,
        lines: Sequence[LineFormat],
        on_end: Callable[[list[LoopbackResult]], None],
    ) -> None:
        self.results: list[LoopbackResult] = []
        self._make_port = make_port
        self._clock = clock
        self._lines = list(lines)
        self._on_end = on_end

    def start(self) -> None:
        """Begin with the first line. Raises ValueError for a port of no known kind."""
        self._next()

    def _next(self) -> None:
        if len(self.results) == len(self._lines):
            self._on_end(self.results)
            return
        line = self._lines[len(self.results)]
        _Trial(self._make_port(line), self._clock, line, self._done).start()

    def _done(self, result: LoopbackResult) -> None:
        self.results.append(result)
        self._clock.call_soon(self._next)


class _Trial(PortEvents):
    """One speed and format on one port."""

    def __init__(self, port: Port, clock: Clock, line: LineFormat, done: Callable[[LoopbackResult], None]) -> None:
        self._port = port
        self._pattern = pattern_of(line)
        self._result = LoopbackResult(line, expected_time=len(self._pattern) * line.character_time)
        self._done = done
        self._data = bytearray()
        self._faults: list[str] = []
        self._began = 0
        self._limit = clock.alarm(self._finish)
        self._over = False

    def start(self) -> None:
        self._port.open(self)

    # ---- events of the port -------------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        self._began = now
        self._result.sent = len(self._pattern)
        self._limit.set(now + round(SLOW * 2 * self._result.expected_time) + PATIENCE)
        self._port.write(self._pattern)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self._data += data
        self._faults += [fault.fault.value for fault in faults]
        self._result.measured_time = now - self._began
        if len(self._data) >= len(self._pattern):
            self._finish()

    def line_break(self, now: int) -> None:
        self._faults.append("break")

    def closed(self, now: int, reason: str) -> None:
        self._result.problems.append(reason)
        self._finish()

    # ---- results ------------------------------------------------------------------------------------------

    def _finish(self) -> None:
        if self._over:
            return
        self._over = True
        self._limit.cancel()
        self._port.close()
        self._result.received = len(self._data)
        if self._result.sent and not self._result.problems:
            self._validate()
        self._done(self._result)

    def _validate(self) -> None:
        problems, sent, came = self._result.problems, self._pattern, bytes(self._data)
        if not came:
            problems.append("nothing came back – are transmitted and received data wired together?")
            return
        if len(came) < len(sent):
            problems.append(f"{len(sent) - len(came)} of {len(sent)} bytes are missing")
        elif len(came) > len(sent):
            problems.append(f"{plural(len(came) - len(sent), 'byte')} too many")
        if len(came) == len(sent):
            changed = [place for place in range(len(sent)) if came[place] != sent[place]]
            if changed:
                first = changed[0]
                what = f"{len(changed)} of {len(sent)} bytes changed, the first at {first}"
                problems.append(f"{what}: {sent[first]:02X} came back as {came[first]:02X}")
        elif not sent.startswith(came):
            first = next(place for place, (one, other) in enumerate(zip(sent, came, strict=False)) if one != other)
            problems.append(f"from byte {first} on it is something else")
        for kind in sorted(set(self._faults)):
            problems.append(f"{self._faults.count(kind)} × {kind}")
        self._validate_time()

    def _validate_time(self) -> None:
        expected, measured = self._result.expected_time, self._result.measured_time
        duration = f"{measured / 1e6:.1f} ms instead of {expected / 1e6:.1f} ms"
        if measured > SLOW * expected + PATIENCE:
            self._result.problems.append(f"it took {duration}: the line is slower than set")
        elif measured * SLOW < expected:
            self._result.remarks.append(f"it took {duration}: bytes have no bit times here")


# ---- on ports ---------------------------------------------------------------------------------------------

SIMULATED = "sim:loop"
"""Name of the port of a simulated line that is wired back to itself."""


def decoder(
    path: Path, protocol: Protocol, *, line: LineFormat | None, params: Mapping[str, Any], client: Literal["in", "out"]
) -> CaptureDecoder:
    """Return a decoder for a capture.

    Raises CaptureError (a ValueError), RequestError for parameters that do not fit.
    """
    try:
        return CaptureDecoder(path, protocol, line=line, params=params, client=client)
    except ParameterError as error:
        raise RequestError(str(error)) from None


def recorded(path: Path, direction: Literal["in", "out"], channel: int | None) -> list[LineEvent]:
    """Return the bytes of one channel and direction in a capture. Raises CaptureError (a ValueError), RequestError."""
    with CaptureReader(path) as reader:
        found = [
            (number, event)
            for number, event in reader.events()
            if event.kind == "data" and event.direction == direction
        ]
    channels = sorted({number for number, _ in found})
    if channel is None and len(channels) > 1:
        raise RequestError(f"the capture has the channels {', '.join(map(str, channels))} – choose one with --channel")
    events = [event for number, event in found if channel in (None, number)]
    if not events:
        raise RequestError(f"the capture has no bytes of direction {direction} there – try --direction")
    return events


async def replay(
    events: Iterable[LineEvent], url: str, line: LineFormat, *, direction: Literal["in", "out"],
    speed_up: float | None, waiting: Callable[[str], None], begun: Callable[[Replay], None],
) -> tuple[Replay, str]:  # fmt: skip
    """Send a capture on a port, or to the first that connects to it; return the replay and the reason of its end.

    The reason is '' if everything has been sent. `waiting` gets the address to connect to, `begun` the replay. Raises
    RequestError, LineClosedError.
    """
    ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    clock = AsyncioClock(asyncio.get_running_loop())
    port = await _port_at(url, line, clock, waiting)
    sending = Replay(events, port, clock, ended.set_result, direction=direction, speed_up=speed_up)
    begun(sending)
    sending.start()
    return sending, await ended


async def _port_at(url: str, line: LineFormat, clock: AsyncioClock, waiting: Callable[[str], None]) -> Port:
    """Return the port, not yet opened; for a listener, the first connection."""
    first: asyncio.Future[AcceptedPort] = clock.loop.create_future()

    def accepted(port: AcceptedPort) -> None:
        if first.done():
            port.close()
        else:
            first.set_result(port)

    kind = scheme_of(url)
    try:
        if kind is None or kind.open is not None:
            return open_port(url, line, clock)
        listener = make_listener(url, clock, accepted)
    except ValueError as error:
        raise RequestError(str(error)) from None
    try:
        await listener.start()
    except OSError as error:
        raise LineClosedError(f"{url}: {error_text(error)}", "closed") from None
    waiting(listener.reached.partition("://")[2])
    try:
        return await first
    finally:
        listener.stop()


def loopback(url: str, lines: Sequence[LineFormat]) -> list[LoopbackResult]:
    """Test a port that is wired back to itself with each of `lines`. Raises RequestError for an invalid port."""
    if url != SIMULATED:
        return asyncio.run(_real_loopback(url, lines))
    clock = VirtualClock()
    found: list[LoopbackResult] = []
    Loopback(lambda line: SimulatedLine(clock, line, echo=True).port("loop"), clock, lines, found.extend).start()
    while clock.advance():
        pass
    return found


async def _real_loopback(url: str, lines: Sequence[LineFormat]) -> list[LoopbackResult]:
    clock = AsyncioClock(asyncio.get_running_loop())
    ended: asyncio.Future[list[LoopbackResult]] = clock.loop.create_future()
    try:
        Loopback(lambda line: open_port(url, line, clock), clock, lines, ended.set_result).start()
    except ValueError as error:
        raise RequestError(str(error)) from None
    return await ended


def written_over(capture: Path) -> Path | None:
    """Return an existing file that a capture of that name would overwrite, of one channel or of several; None if none
    exists.
    """
    files = (capture, file_of_channel(capture, 1)) if capture.name else (capture,)
    return next((file for file in files if file.is_file()), None)

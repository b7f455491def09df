"""Captures: the events of lines in files (pcap, or JSON lines), written and read, and the frames in them."""

from __future__ import annotations

import enum
import errno
import json
import os
import struct
import time
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from io import FileIO
from pathlib import Path
from struct import Struct
from typing import Any, BinaryIO, Literal

from framekit.codec.codec import compile_protocol
from framekit.codec.columns import Cut
from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import error_text
from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault, LineFault, Seen
from framekit.link.listener import Listener
from framekit.run.trouble import SampleCount, Troubles
from framekit.service.write_queue import WriteQueue
from framekit.sinks.opened_file import OpenedFile, not_opened
from framekit.transport.clock import AsyncioClock, Clock
from framekit.transport.port import LineEvent, Port, TappedPort, Way

HEADER = {"capture": "framekit", "version": 1}


class CaptureError(ValueError):
    """The file is no capture, or cannot be read."""


def event_line(channel: int, event: LineEvent, epoch: int) -> bytes:
    """Return an event as a line of JSON; `epoch` (ns) is added to its time."""
    line: dict[str, Any] = {"time_ns": event.at + epoch, "channel": channel, "event": event.kind}
    if event.direction:
        line["direction"] = event.direction
    if event.data:
        line["bytes"] = event.data.hex(" ").upper()
    if event.faults:
        line["faults"] = [[fault.index, fault.fault.value] for fault in event.faults]
    if event.lines:
        line["lines"] = dict(event.lines)
    if event.reason:
        line["reason"] = event.reason
    return _line(line)


def _line(value: Any) -> bytes:
    return json.dumps(value, ensure_ascii=False).encode("utf-8") + b"\n"


class JsonReader:
    """The events of a file with their channels.

    `is_cut`: whether the last line is incomplete (its writer was killed).
    """

    def __init__(self, lines: Iterable[bytes]) -> None:
        """Read the head of a file. Raise CaptureError."""
        self.is_cut = False
        self._lines = iter(lines)
        try:
            head = json.loads(next(self._lines, b""))
        except (ValueError, RecursionError):
            head = None
        if not isinstance(head, dict) or head.get("capture") != HEADER["capture"]:
            raise CaptureError('this is no capture – its first line is not {"capture": "framekit", …}')
        if head.get("version") != HEADER["version"]:
            raise CaptureError(f"this capture is of version {head.get('version')}, known is {HEADER['version']}")

    def events(self) -> Iterator[tuple[int, LineEvent]]:
        """Yield the events in the order of the file. Raises CaptureError for a line that is no event."""
        for number, text in enumerate(self._lines, 2):
            if not text.endswith(b"\n"):
                self.is_cut = True
                return
            try:
                yield _event(json.loads(text))
            except RecursionError:
                raise CaptureError(f"line {number} is no event of a capture (it is nested too deeply)") from None
            except (ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError) as error:
                raise CaptureError(f"line {number} is no event of a capture ({explain(error)})") from None


def _event(line: dict[str, Any]) -> tuple[int, LineEvent]:
    kind, direction = line["event"], line.get("direction", "")
    if kind not in ("data", "break", "control", "open", "closed") or direction not in ("in", "out", ""):
        raise ValueError(f"{kind} {direction}")
    faults = tuple(CharacterFault(int(index), LineFault(fault)) for index, fault in line.get("faults", ()))
    data = bytes.fromhex(line.get("bytes", ""))
    at, channel = int(line["time_ns"]), int(line["channel"])
    if not -MOST_TIME <= at <= MOST_TIME or not 0 <= channel <= MOST_TIME:
        raise OverflowError("a number is too large")
    lines = {str(name): bool(is_on) for name, is_on in line.get("lines", {}).items()}
    return channel, LineEvent(kind, at, direction, data, faults, lines, str(line.get("reason", "")))


MOST_TIME = 1 << 63
"""Greatest distance from 1970 of a time in a capture (ns)."""


LINK_TYPE = 250
MAGIC_MICROSECONDS, MAGIC_NANOSECONDS = 0xA1B2C3D4, 0xA1B23C4D
LONGEST = 65_000
"""Largest size of a record (bytes); readers join records of equal time."""
SECOND = 1_000_000_000

_GLOBAL = "IHHiIII"
GLOBAL_HEADER = struct.pack("<" + _GLOBAL, MAGIC_NANOSECONDS, 2, 4, 0, 0, 0xFFFF, LINK_TYPE)
"""Header of a file: nanosecond times, link type 250."""
_RECORD = "IIII"
_SERIAL = struct.Struct(">IIBBH")


class EventType(enum.IntEnum):
    """The event of a record; the payload of an error is the damaged character."""

    STATUS_CHANGE = 0
    DATA_TX_START = 1
    DATA_RX_START = 2
    DATA_TX_END = 3
    DATA_RX_END = 4
    CAPTURE_DATA_LOST = 5
    CAPTURE_COMPLETE = 6
    FRAMING_ERROR = 7
    PARITY_ERROR = 8
    SERIAL_BREAK_EVENT = 9
    SERIAL_OVERFLOW_EVENT = 10


CONTROL_LINES = {"cts": 0x01, "dcd": 0x02, "dsr": 0x04, "rts": 0x08, "dtr": 0x10, "ri": 0x20}
_FAULTS = {
    LineFault.FRAMING: EventType.FRAMING_ERROR,
    LineFault.PARITY: EventType.PARITY_ERROR,
    LineFault.OVERRUN: EventType.SERIAL_OVERFLOW_EVENT,
}
_FAULT_OF = {kind: fault for fault, kind in _FAULTS.items()}
_DIRECTIONS: dict[EventType, Way] = {
    EventType.DATA_TX_START: "out",
    EventType.DATA_TX_END: "out",
    EventType.DATA_RX_START: "in",
    EventType.DATA_RX_END: "in",
    EventType.FRAMING_ERROR: "in",
    EventType.PARITY_ERROR: "in",
    EventType.SERIAL_OVERFLOW_EVENT: "in",
}
_TYPES = {int(kind): kind for kind in EventType}


# ---- writing ----------------------------------------------------------------------------------------------


class PcapRecords:
    """Makes records of events; keeps the state of the control lines. `epoch` (ns) is added to the events' times."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch
        self._lines = 0

    def of(self, event: LineEvent) -> bytes:
        """Return the records of an event: several if it has damaged characters."""
        at = event.at + self._epoch
        match event.kind:
            case "data":
                return b"".join(self._record(at, kind, piece) for kind, piece in _pieces(event))
            case "break":
                return self._record(at, EventType.SERIAL_BREAK_EVENT)
            case "closed":
                return self._record(at, EventType.CAPTURE_DATA_LOST)
        for name, on in event.lines.items():
            bit = CONTROL_LINES.get(name, 0)
            self._lines = self._lines | bit if on else self._lines & ~bit
        return self._record(at, EventType.STATUS_CHANGE)

    def end(self, at: int) -> bytes:
        """Return the record for the regular end of a capture."""
        return self._record(at + self._epoch, EventType.CAPTURE_COMPLETE)

    def _record(self, at: int, kind: EventType, data: bytes = b"") -> bytes:
        seconds, rest = divmod(at, SECOND)
        size = _SERIAL.size + len(data)
        head = struct.pack("<" + _RECORD, seconds & 0xFFFFFFFF, rest, size, size)
        return head + _SERIAL.pack(seconds & 0xFFFFFFFF, rest // 1000, kind, self._lines, 0) + data


def _pieces(event: LineEvent) -> Iterator[tuple[EventType, bytes]]:
    """Yield the records of an event: sent bytes with the time of their begin, received bytes with the time of their
    end, damaged characters singly.
    """
    kind = EventType.DATA_TX_START if event.direction == "out" else EventType.DATA_RX_END
    place = 0
    damaged = [fault for fault in event.faults if fault.fault in _FAULTS]  # the format cannot express a mark
    for fault in sorted(damaged, key=lambda fault: fault.index):
        if place <= fault.index < len(event.data):
            yield from _cut(kind, event.data[place : fault.index])
            yield _FAULTS[fault.fault], event.data[fault.index : fault.index + 1]
            place = fault.index + 1
    yield from _cut(kind, event.data[place:])


def _cut(kind: EventType, data: bytes) -> Iterator[tuple[EventType, bytes]]:
    for start in range(0, len(data), LONGEST):
        yield kind, data[start : start + LONGEST]


# ---- reading ----------------------------------------------------------------------------------------------


class PcapReader:
    """The events of a file, times in ns since 1970.

    `is_cut`: whether the last record is incomplete (its writer was killed). `order`: the byte order of records, as
    `struct` writes it.
    """

    def __init__(self, file: BinaryIO) -> None:
        """Read the header of a file. Raise CaptureError."""
        self.is_cut = False
        self._file = file
        head = file.read(24)
        if len(head) < 24:
            raise CaptureError("this is no pcap file: it ends within its header")
        for order in "<>":
            magic = struct.unpack(order + "I", head[:4])[0]
            if magic in (MAGIC_MICROSECONDS, MAGIC_NANOSECONDS):
                break
        else:
            raise CaptureError("this is no pcap file – its first four bytes are none that pcap files begin with")
        self.order = order
        self._scale = 1 if magic == MAGIC_NANOSECONDS else 1000
        link = struct.unpack(order + _GLOBAL, head)[6] & 0x0FFFFFFF
        if link != LINK_TYPE:
            raise CaptureError(f"this pcap file is of link type {link} – serial lines are {LINK_TYPE}")

    def events(self) -> Iterator[tuple[int, LineEvent]]:
        """Yield the events in the order of the file, all of channel 1; records of equal time are joined across damaged
        characters.
        """
        held: LineEvent | None = None
        lines = -1
        for at, kind, control, data in self._records():
            direction = _DIRECTIONS.get(kind, "")
            if data and direction:
                fault = _FAULT_OF.get(kind)
                if held is not None and held.at == at and held.direction == direction:
                    held = _joined(held, data, fault)
                    continue
                if held is not None:
                    yield 1, held
                held = _joined(LineEvent("data", at, direction), data, fault)
                continue
            if held is not None:
                yield 1, held
                held = None
            if kind is EventType.SERIAL_BREAK_EVENT:
                yield 1, LineEvent("break", at)
            elif kind is EventType.CAPTURE_DATA_LOST:
                yield 1, LineEvent("closed", at)
            elif kind is EventType.STATUS_CHANGE:
                yield 1, self._status(at, control, lines)
                lines = control
        if held is not None:
            yield 1, held

    @staticmethod
    def _status(at: int, control: int, before: int) -> LineEvent:
        changed = control if before < 0 else control ^ before
        if not changed:
            return LineEvent("open", at)
        states = {name: bool(control & bit) for name, bit in CONTROL_LINES.items() if changed & bit}
        return LineEvent("control", at, lines=states)

    def _records(self) -> Iterator[tuple[int, EventType, int, bytes]]:
        while head := self._file.read(16):
            if len(head) < 16:
                self.is_cut = True
                return
            seconds, rest, size, _ = struct.unpack(self.order + _RECORD, head)
            body = self._file.read(size) if size <= 0x4000_0000 else b""
            if len(body) < size:
                self.is_cut = True
                return
            if size >= _SERIAL.size:
                _, _, number, control, _ = _SERIAL.unpack(body[: _SERIAL.size])
                kind = _TYPES.get(number)
                if kind is not None:
                    yield seconds * SECOND + rest * self._scale, kind, control, body[_SERIAL.size :]


def _joined(event: LineEvent, data: bytes, fault: LineFault | None) -> LineEvent:
    faults = event.faults
    if fault is not None:
        faults += tuple(CharacterFault(len(event.data) + index, fault) for index in range(len(data)))
    return LineEvent("data", event.at, event.direction, event.data + data, faults)


JSON_SUFFIXES = (".json", ".jsonl", ".ndjson")


def _appending(path: str, flags: int) -> int:
    """Open a file so that each write goes to its end, also after another program has cut it."""
    return os.open(path, flags | os.O_APPEND, 0o666)


class _Sink:
    """A file of whole records.

    It ends at the first record that cannot be written: a gap in a capture would be misread. If another program moves,
    deletes or cuts the file, the next record begins a new file.
    """

    def __init__(self, path: Path, head: bytes, troubles: Troubles) -> None:
        """Create the file and write its header. Raise OSError."""
        self.path = path
        self._head = head
        self._lost = 0
        self._troubles = troubles
        self._begin("w")
        self.trouble = troubles.source(
            f"capture {path}", lambda: "the capture ends here", lambda: SampleCount(lost=self._lost), "record"
        )

    def _begin(self, mode: Literal["w", "a"]) -> None:
        """Open the file and write its header. Raise OSError."""
        try:
            self._file = FileIO(self.path, mode, opener=_appending)
        except OSError as error:
            raise not_opened(self.path, error) from None
        try:
            self._opened = OpenedFile(self.path)
            if os.fstat(self._file.fileno()).st_size:
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(self.path))
            if self._file.write(self._head) < len(self._head):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
        except OSError:
            self._file.close()
            raise
        self._size = len(self._head)

    def _follow_path(self) -> None:
        """Begin a new file at the path if it is not the open file any more, or was cut. Raise OSError."""
        if change := self._opened.change(self._size):
            self._file.close()
            self._begin("a")
            self._troubles.note(self.trouble.name, change)

    def write(self, record: bytes, *, wait: bool = False) -> bool:
        """Write a record and return True; a sink with limited room returns False if it is full, unless `wait` is
        set.
        """
        self.write_records(record, 1)
        return True

    def write_records(self, records: bytes, number: int) -> None:
        """Write joined records, or count all of them as lost."""
        if self.trouble.reason:
            self._lost += number
        elif not self._file.closed:
            self._write(records, number)

    def has_failed(self, error: BaseException, number: int) -> None:
        """Report an error of the thread that writes; `number` records are not written."""
        self.trouble.begins(error_text(error))
        self._lost += number

    def _write(self, records: bytes, number: int) -> None:
        try:
            self._follow_path()
            written = self._file.write(records)
            if written < len(records):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self._lost += number
            with suppress(OSError, ValueError):  # a reader passes over a record that is cut off
                self._file.truncate(self._size)
            self.trouble.begins(error_text(error))
        else:
            self._size += written

    def close(self) -> None:
        self._file.close()


MOST_WAITING = 8 << 20
"""Largest number of bytes of records that wait for a slow disk."""


class _LaterSink:
    """A `_Sink` that a thread writes: the caller waits for a slow disk only when too many records wait."""

    def __init__(self, path: Path, head: bytes, troubles: Troubles) -> None:
        """Create the file, and begin to write it in a thread. Raise OSError."""
        self.path = path
        self._sink = _Sink(path, head, troubles)
        self._queue = WriteQueue(self._sink.write_records, MOST_WAITING, f"writes {path}", self._sink.has_failed)

    def write(self, record: bytes, *, wait: bool = False) -> bool:
        if self._queue.add(record, wait=wait):
            return True
        return self._queue.is_closed and self._sink.write(record)  # which counts it as lost

    def close(self) -> None:
        self._queue.close()
        self._sink.close()


def file_of_channel(path: Path, channel: int) -> Path:
    """Return the path of the pcap file of one of several channels."""
    return path.with_name(f"{path.stem}-{channel}{path.suffix}")


class Capture:
    """A capture being written. A name ending in .json or .jsonl makes JSON lines, any other pcap.

    A pcap file holds one line: with several channels each has its own, `NAME-1.pcap`, `NAME-2.pcap`. Times in the file
    are those of the wall clock; on a virtual clock they count from 1970. `later`: a thread writes, so that the caller
    does not wait for a slow disk. Raises OSError.
    """

    def __init__(
        self,
        path: Path,
        channels: Sequence[int],
        clock: Clock,
        troubles: Troubles | None = None,
        *,
        later: bool = False,
    ) -> None:
        self._clock = clock
        self.troubles = troubles or Troubles(clock.now)
        self._epoch = time.time_ns() - clock.now() if isinstance(clock, AsyncioClock) else 0
        self._records: dict[int, PcapRecords] = {}
        self._ports = 0
        self._sinks: dict[int, _Sink | _LaterSink] = {}
        made = _LaterSink if later else _Sink
        if path.suffix.lower() in JSON_SUFFIXES:
            sink = made(path, _line(HEADER), self.troubles)
            self._sinks = dict.fromkeys(channels, sink)
        else:
            for channel in channels:
                name = path if len(channels) == 1 else file_of_channel(path, channel)
                self._sinks[channel] = made(name, GLOBAL_HEADER, self.troubles)
                self._records[channel] = PcapRecords(self._epoch)

    @property
    def paths(self) -> list[Path]:
        """Return the paths of the files."""
        return list(dict.fromkeys(sink.path for sink in self._sinks.values()))

    @property
    def problems(self) -> list[str]:
        """Return the reasons why records are missing in the files."""
        return [str(trouble) for trouble in self.troubles.present()]

    def around(self, channel: int, port: Port) -> Port:
        """Return a port around `port` that captures its traffic."""
        return TappedPort(port, self._clock, partial(self._keep, channel))

    def around_next(self, port: Port) -> Port:
        """Return the port with capture as `around` does, for a port of a server with many ports: in JSON lines each is
        a new channel.

        In a pcap file all ports share its only line.
        """
        first = next(iter(self._sinks))
        self._ports += 1
        return self.around(first if self._records else first + self._ports - 1, port)

    def write(self, channel: int, event: LineEvent, *, wait: bool = False) -> bool:
        """Write an event; raise no error if a file cannot be written.

        Return False if the event is dropped because too many wait for a slow disk (only with `later`); with `wait`,
        wait instead.
        """
        records = self._records.get(channel)
        if records is None:
            sink = self._sinks.get(channel) or next(iter(self._sinks.values()))
            return sink.write(event_line(channel, event, self._epoch), wait=wait)
        return self._sinks[channel].write(records.of(event), wait=wait)

    def _keep(self, channel: int, event: LineEvent) -> None:
        self.write(channel, event)

    def close(self) -> None:
        """Complete and close the files."""
        for channel, records in self._records.items():
            self._sinks[channel].write(records.end(self._clock.now()), wait=True)
        for sink in self._sinks.values():
            sink.close()


class CaptureReader:
    """A capture opened for reading, in any format; closed at the end of a `with`."""

    def __init__(self, path: Path) -> None:
        """Open a capture. Raise CaptureError."""
        self._path = path
        try:
            self._file: BinaryIO = path.open("rb")
        except OSError as error:
            raise CaptureError(f"{path}: {error_text(error)}") from None
        first = self._file.read(1)
        self._file.seek(0)
        try:
            self._reader: PcapReader | JsonReader = JsonReader(self._file) if first == b"{" else PcapReader(self._file)
        except CaptureError as error:
            self._file.close()
            raise CaptureError(f"{path}: {error}") from None

    @property
    def order(self) -> str | None:
        """Return the byte order of the records, as `struct` writes it; None without binary records (JSON lines)."""
        return self._reader.order if isinstance(self._reader, PcapReader) else None

    @property
    def is_cut(self) -> bool:
        """Return whether the last record was incomplete; known when all events have been read."""
        return self._reader.is_cut

    def events(self) -> Iterator[tuple[int, LineEvent]]:
        """Yield channel (1 in a pcap file) and event, in the order of the file. Raises CaptureError."""
        try:
            yield from self._reader.events()
        except CaptureError as error:
            raise CaptureError(f"{self._path}: {error}") from None

    def __enter__(self) -> CaptureReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


HEAD, RECORD, SERIAL = 24, 16, 12
"""Sizes (bytes) of the file's header, of a record's header, and of the serial line's header in a record."""
KIND = RECORD + 8


def cut_of_capture(path: Path, direction: Literal["in", "out"]) -> Cut:
    """Return the records of one direction, damaged characters as separate records. An incomplete record is left out.

    Raises CaptureError.
    """
    with CaptureReader(path) as reader:
        if reader.order is not None:
            kinds = frozenset(int(kind) for kind, way in _DIRECTIONS.items() if way == direction)
            return _cut_file(path.read_bytes(), reader.order, kinds)
        events = (event for _, event in reader.events())
        return Cut.of([event.data for event in events if event.kind == "data" and event.direction == direction])


def _cut_file(data: bytes, order: str, kinds: frozenset[int]) -> Cut:
    starts, lengths = array("q"), array("q")
    size_at = Struct(order + "I").unpack_from
    at, end = HEAD, len(data) - RECORD
    while at < end:
        (size,) = size_at(data, at + 8)
        after = at + RECORD + size
        if after > len(data):
            break
        if size > SERIAL and data[at + KIND] in kinds:
            starts.append(at + RECORD + SERIAL)
            lengths.append(size - SERIAL)
        at = after
    return Cut(data, starts, lengths)


class CaptureDecoder:
    """Decodes one capture.

    `client`: the direction of the client's frames, if a channel has both directions. `is_cut`: whether the last record
    was incomplete; known when everything has been read.
    """

    def __init__(
        self,
        path: Path,
        protocol: Protocol,
        *,
        line: LineFormat | None = None,
        params: Mapping[str, Any] | None = None,
        client: Literal["in", "out"] = "out",
    ) -> None:
        """Open the capture. Raises CaptureError, and ParameterError for parameters that do not fit."""
        self.is_cut = False
        self._path = path
        self._protocol = protocol
        self._line = line
        self._params = params
        self._client: Literal["in", "out"] = client
        self._found: list[tuple[int, Seen]] = []
        self._directions = self._directions_of(path)
        self._listeners = {channel: self._listener(channel) for channel in self._directions}

    @staticmethod
    def _directions_of(path: Path) -> dict[int, set[str]]:
        found: dict[int, set[str]] = {}
        with CaptureReader(path) as reader:
            for channel, event in reader.events():
                found.setdefault(channel, set())
                if event.kind == "data":
                    found[channel].add(event.direction)
        return found

    def _listener(self, channel: int) -> Listener:
        def monitor(seen: Seen) -> None:
            self._found.append((channel, seen))

        both = len(self._directions[channel]) > 1
        return Listener(
            self._protocol,
            compile_protocol(self._protocol),
            monitor,
            params=self._params,
            line=self._line,
            client=self._client if both else None,
        )

    def seen(self) -> Iterator[tuple[int, Seen]]:
        """Yield channels and events, in the order of time (ns since 1970) on each channel. Raises CaptureError."""
        with CaptureReader(self._path) as reader:
            for channel, event in reader.events():
                self._take(channel, event)
                yield from self._told()
            self.is_cut = reader.is_cut
        for listener in self._listeners.values():
            listener.ended(listener.scope.now)
        yield from self._told()

    def _told(self) -> list[tuple[int, Seen]]:
        found, self._found[:] = list(self._found), []
        return found

    def _take(self, channel: int, event: LineEvent) -> None:
        listener = self._listeners[channel]
        match event.kind:
            case "data":
                at = event.at
                if event.direction == "out":
                    at += listener.scope.line.chars(len(event.data))
                listener.receive(event.data, at, event.faults, event.direction)
            case "break":
                listener.line_break(event.at, event.direction)
            case "open":
                self._found.append((channel, Seen("", "open", event.at)))
            case "closed":  # bytes that were given to the port shortly before have not all left by then
                listener.ended(event.at)
                at = max(event.at, listener.scope.now)
                self._found.append((channel, Seen("", "closed", at, reason=event.reason)))

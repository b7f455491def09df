"""Captures of one serial line as pcap files of link type 250, which network analysers read; written and read.

Each record has the 12-byte header of LINKTYPE_RTAC_SERIAL (its page at tcpdump.org): seconds and microseconds, event
type, control lines, footer; big-endian. Knows files and bytes, and neither frames nor ports.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterator
from typing import BinaryIO

from framekit.link.events import CharacterFault, LineFault
from framekit.transport.port import LineEvent, Way

LINK_TYPE = 250
MAGIC_MICROSECONDS, MAGIC_NANOSECONDS = 0xA1B2C3D4, 0xA1B23C4D
LONGEST = 65_000
"""Data is cut into records of so many bytes; readers take the pieces of one time together."""
SECOND = 1_000_000_000

_GLOBAL = "IHHiIII"
_RECORD = "IIII"
_SERIAL = struct.Struct(">IIBBH")


class EventType(enum.IntEnum):
    """What a record stands for; the payload of an error is the damaged character."""

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


def kinds_of(direction: Way) -> list[int]:
    """The numbers of the event types that carry bytes of this direction, damaged ones too."""
    return [int(kind) for kind, its in _DIRECTIONS.items() if its == direction]


class PcapFormatError(ValueError):
    """The file is no pcap file of a serial line."""


# ---- writing ----------------------------------------------------------------------------------------------


def global_header() -> bytes:
    """What a file begins with: nanosecond times, link type 250."""
    return struct.pack("<" + _GLOBAL, MAGIC_NANOSECONDS, 2, 4, 0, 0, 0xFFFF, LINK_TYPE)


class PcapRecords:
    """Makes records of events; remembers the control lines. `epoch` (ns) is added to the events' times."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch
        self._lines = 0

    def of(self, event: LineEvent) -> bytes:
        """The records of an event: several where characters of it are damaged."""
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
        """The record that says that nothing is missing behind it."""
        return self._record(at + self._epoch, EventType.CAPTURE_COMPLETE)

    def _record(self, at: int, kind: EventType, data: bytes = b"") -> bytes:
        seconds, rest = divmod(at, SECOND)
        size = _SERIAL.size + len(data)
        head = struct.pack("<" + _RECORD, seconds & 0xFFFFFFFF, rest, size, size)
        return head + _SERIAL.pack(seconds & 0xFFFFFFFF, rest // 1000, kind, self._lines, 0) + data


def _pieces(event: LineEvent) -> Iterator[tuple[EventType, bytes]]:
    """Sent bytes begin at their time, received ones are complete then; damaged characters stand by themselves."""
    kind = EventType.DATA_TX_START if event.direction == "out" else EventType.DATA_RX_END
    place = 0
    for fault in sorted(event.faults, key=lambda fault: fault.index):
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
    """The events of a file, times in ns since 1970. `is_cut`: the last record is not whole (its writer was killed).

    `order`: the byte order of records, as `struct` writes it.
    """

    def __init__(self, file: BinaryIO) -> None:
        """Raises PcapFormatError."""
        self.is_cut = False
        self._file = file
        head = file.read(24)
        if len(head) < 24:
            raise PcapFormatError("this is no pcap file: it ends within its header")
        for order in "<>":
            magic = struct.unpack(order + "I", head[:4])[0]
            if magic in (MAGIC_MICROSECONDS, MAGIC_NANOSECONDS):
                break
        else:
            raise PcapFormatError("this is no pcap file – its first four bytes are none that pcap files begin with")
        self.order = order
        self._scale = 1 if magic == MAGIC_NANOSECONDS else 1000
        link = struct.unpack(order + _GLOBAL, head)[6] & 0x0FFFFFFF
        if link != LINK_TYPE:
            raise PcapFormatError(f"this pcap file is of link type {link} – serial lines are {LINK_TYPE}")

    def events(self) -> Iterator[LineEvent]:
        """In the order of the file. Pieces of one time with damaged characters between them become one again."""
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
                    yield held
                held = _joined(LineEvent("data", at, direction), data, fault)
                continue
            if held is not None:
                yield held
                held = None
            if kind is EventType.SERIAL_BREAK_EVENT:
                yield LineEvent("break", at)
            elif kind is EventType.CAPTURE_DATA_LOST:
                yield LineEvent("closed", at)
            elif kind is EventType.STATUS_CHANGE:
                yield self._status(at, control, lines)
                lines = control
        if held is not None:
            yield held

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

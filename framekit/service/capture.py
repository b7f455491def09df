"""Captures of lines in files, in both formats: written while things happen, read again.

A record is written whole and at once, so that a killed program leaves a file that can be read. The formats themselves
are in modules of their own.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import BinaryIO

from framekit.service.json_capture import JsonCaptureError, JsonReader, event_line, header_line
from framekit.service.pcap import PcapFormatError, PcapReader, PcapRecords, global_header
from framekit.transport.clock import AsyncioClock, Clock
from framekit.transport.port import LineEvent, Port, Tap, TappedPort

JSON_SUFFIXES = (".json", ".jsonl", ".ndjson")

log = logging.getLogger(__name__)


class CaptureError(ValueError):
    """The file is no capture, or cannot be read."""


class _Sink:
    """A file that takes records until one cannot be written; that is told once, and nothing else stops."""

    def __init__(self, path: Path, head: bytes) -> None:
        """Raises OSError."""
        self.path = path
        self.trouble = ""
        self._file = path.open("wb", buffering=0)
        self._file.write(head)

    def write(self, record: bytes) -> None:
        if self.trouble or self._file.closed:
            return
        try:
            written = self._file.write(record)
        except OSError as error:
            self._give_up(error.strerror or str(error))
        else:
            if written < len(record):
                self._give_up("there was no place for the whole record")

    def _give_up(self, why: str) -> None:
        self.trouble = f"{self.path}: {why}; nothing is captured any more"
        log.error("%s", self.trouble)

    def close(self) -> None:
        self._file.close()


class Capture:
    """A capture being written. A name ending in .json or .jsonl makes JSON lines, any other pcap.

    A pcap file holds one line: with several channels each has its own, `NAME-1.pcap`, `NAME-2.pcap`. Times in the file
    are those of the wall clock; on a virtual clock they count from 1970. Raises OSError.
    """

    def __init__(self, path: Path, channels: Sequence[int], clock: Clock) -> None:
        self._clock = clock
        self._epoch = time.time_ns() - clock.now() if isinstance(clock, AsyncioClock) else 0
        self._records: dict[int, PcapRecords] = {}
        self._ports = 0
        self._sinks: dict[int, _Sink] = {}
        if path.suffix.lower() in JSON_SUFFIXES:
            sink = _Sink(path, header_line())
            self._sinks = dict.fromkeys(channels, sink)
        else:
            for channel in channels:
                name = path if len(channels) == 1 else path.with_name(f"{path.stem}-{channel}{path.suffix}")
                self._sinks[channel] = _Sink(name, global_header())
                self._records[channel] = PcapRecords(self._epoch)

    @property
    def paths(self) -> list[Path]:
        """The files."""
        return list(dict.fromkeys(sink.path for sink in self._sinks.values()))

    @property
    def troubles(self) -> list[str]:
        """Why something is not in the files."""
        return list(dict.fromkeys(sink.trouble for sink in self._sinks.values() if sink.trouble))

    def tap(self, channel: int) -> Tap:
        """What to tell the events of a channel."""
        return partial(self.write, channel)

    def around(self, channel: int, port: Port) -> Port:
        """The port with everything that goes through it captured."""
        return TappedPort(port, self._clock, self.tap(channel))

    def around_next(self, port: Port) -> Port:
        """As `around`, for one port of a server with many: where the format tells channels apart each is the next one.

        A pcap file has no room for that: all of them are its one line.
        """
        first = next(iter(self._sinks))
        self._ports += 1
        return self.around(first if self._records else first + self._ports - 1, port)

    def write(self, channel: int, event: LineEvent) -> None:
        """Writes one event; never raises for a file that cannot be written."""
        records = self._records.get(channel)
        if records is None:
            sink = self._sinks.get(channel) or next(iter(self._sinks.values()))
            sink.write(event_line(channel, event, self._epoch))
        else:
            self._sinks[channel].write(records.of(event))

    def close(self) -> None:
        """Ends the files."""
        for channel, records in self._records.items():
            self._sinks[channel].write(records.end(self._clock.now()))
        for sink in self._sinks.values():
            sink.close()


class CaptureReader:
    """A capture read again, whatever its format. Closed at the end of a `with`."""

    def __init__(self, path: Path) -> None:
        """Raises CaptureError."""
        self._path = path
        try:
            self._file: BinaryIO = path.open("rb")
        except OSError as error:
            raise CaptureError(f"{path}: {error.strerror or error}") from None
        first = self._file.read(1)
        self._file.seek(0)
        try:
            self._reader: PcapReader | JsonReader = JsonReader(self._file) if first == b"{" else PcapReader(self._file)
        except (PcapFormatError, JsonCaptureError) as error:
            self._file.close()
            raise CaptureError(f"{path}: {error}") from None

    @property
    def is_cut(self) -> bool:
        """Whether the last record was not whole; known when all events have been read."""
        return self._reader.is_cut

    def events(self) -> Iterator[tuple[int, LineEvent]]:
        """Channel (1 in a pcap file) and event, in the order of the file. Raises CaptureError."""
        try:
            if isinstance(self._reader, JsonReader):
                yield from self._reader.events()
            else:
                for event in self._reader.events():
                    yield 1, event
        except JsonCaptureError as error:
            raise CaptureError(f"{self._path}: {error}") from None

    def __enter__(self) -> CaptureReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

"""Captures decoded: the bytes of a file to frames, bad frames and noise, as if somebody had listened at the time.

A capture made by one of two sides has two directions; one made between them has a single one with both sides in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from framekit.codec.codec import compile_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import LineFormat
from framekit.link.listener import Listener
from framekit.link.observe import Seen
from framekit.service.capture import CaptureReader
from framekit.transport.port import LineEvent


class CaptureDecoder:
    """Decodes one capture. `client`: the direction of the client's frames, where a channel has both directions.

    `is_cut`: the last record was not whole; known when everything has been read.
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
        """Raises CaptureError, and ParameterError for parameters that do not fit."""
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
        """Channel and what was seen, in the order of time (ns since 1970) on each channel. Raises CaptureError."""
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
            case "closed":
                listener.ended(event.at)
                self._found.append((channel, Seen("", "closed", event.at, reason=event.reason)))

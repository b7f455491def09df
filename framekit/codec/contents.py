"""Read the bytes of frames as the layouts that `shows:` of their definition names, for displays.

Exchanges do not use these values: the bytes of a frame stay bytes. Bytes that do not have the layout, for example
because they go on in the next frame, are shown as bytes only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.codec.evaluate import EVALUATION_ERRORS
from framekit.codec.functions import FrameFunctions
from framekit.codec.plain import PlainValues
from framekit.codec.result_names import Names, named_paths, names_in_layout
from framekit.codec.shown import shown, with_names
from framekit.definition.model.frames import flat
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Data


class Contents:
    """Reads the bytes of a protocol's frames as the layouts that displays show them as."""

    def __init__(self, protocol: Protocol, functions: FrameFunctions) -> None:
        self.protocol = protocol
        self.functions = functions
        self.plain = PlainValues(protocol)
        self._data: dict[str, list[Data]] = {}
        """For each frame its bytes that displays read as layouts."""
        self._names: dict[str, Names] = {}

    def to_plain(self, frame: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of a frame in plain form, and after them the content of its bytes by layout."""
        found = self.plain.to_plain(frame, fields)
        for layout, values in self._read(frame, fields):
            found.setdefault(layout, shown(values))
        return found

    def with_names(self, frame: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        """Return the same for people: each number has its name."""
        found = {
            name: self.plain.named(frame, name, value) for name, value in self.plain.to_plain(frame, fields).items()
        }
        for layout, values in self._read(frame, fields):
            found.setdefault(layout, with_names(self._names_of(layout), layout, shown(values)))
        return found

    def names(self, frame: str, fields: Mapping[str, Any]) -> dict[str, str]:
        """Return the names of the numbers in `to_plain` by their places: `{"body.nack.minor": "password invalid"}`."""
        known = self.plain.names(frame)
        found: dict[str, str] = {}
        if known:
            for name, value in fields.items():
                found.update(named_paths(known, name, name, value))
        for layout, values in self._read(frame, fields):
            if layout not in fields:
                found.update(named_paths(self._names_of(layout), layout, layout, values))
        return found

    def rows(self, frame: str, fields: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        """Yield each single value of the content of a frame's bytes: its path, and the value with its name."""
        for layout, values in self._read(frame, fields):
            yield from _paths(layout, with_names(self._names_of(layout), layout, shown(values)))

    def _read(self, frame: str, fields: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield layouts and their values."""
        for data in self._shown_in(frame):
            assert data.shows is not None
            name = data.shows.layouts.get(fields.get(data.shows.by, -1))
            content = fields.get(data.name)
            if name is None or not isinstance(content, bytes):
                continue
            _, decode = self.functions.layouts[name.layout]
            try:
                yield name.layout, decode(content, self.functions.defaults)
            except (FrameError, *EVALUATION_ERRORS):
                continue

    def _shown_in(self, frame: str) -> list[Data]:
        found = self._data.get(frame)
        if found is None:
            known = self.protocol.frames.get(frame)
            segments = () if known is None else flat(known.segments)
            found = self._data[frame] = [one for one in segments if isinstance(one, Data) and one.shows is not None]
        return found

    def _names_of(self, layout: str) -> Names:
        """Return the names of numbers by field."""
        names = self._names.get(layout)
        if names is None:
            names = self._names[layout] = names_in_layout(self.protocol, layout)
        return names


def contents_of(protocol: Protocol, functions: FrameFunctions | None = None) -> Contents:
    """Return the contents of a protocol's frames; they are kept as long as its functions (None: the compiled ones)."""
    functions = functions or compile_protocol(protocol)
    found = functions.kept.get(Contents)
    if not isinstance(found, Contents):
        found = functions.kept[Contents] = Contents(protocol, functions)
    return found


def _paths(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _paths(f"{path}.{name}", item)
    elif isinstance(value, list):
        for place, item in enumerate(value):
            yield from _paths(f"{path}[{place}]", item)
    else:
        yield path, value

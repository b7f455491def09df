"""Read the bytes of frames as the layouts that `shows:` of their definition names, for displays.

Exchanges do not use these values: the bytes of a frame stay bytes. Bytes that do not have the layout, for example
because they go on in the next frame, are shown as bytes only. Where the layout depends on the request, the display
remembers the frames before (`Requests`), so that exchanges do no work for it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any
from typing import Protocol as Kind

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.codec.evaluate import EVALUATION_ERRORS, compiled
from framekit.codec.functions import FrameFunctions
from framekit.codec.plain import PlainValues
from framekit.codec.result_names import Names, named_paths, names_in_layout
from framekit.codec.shown import shown, with_names
from framekit.definition.expression import Expression, Name, walk
from framekit.definition.kinds.data import REQUEST
from framekit.definition.model.frames import flat
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Data

Fields = Mapping[str, Any]
"""The values of a frame as codecs give them: an inner frame is `{frame: fields}`."""


class Contents:
    """Reads the bytes of a protocol's frames as the layouts that displays show them as."""

    def __init__(self, protocol: Protocol, functions: FrameFunctions) -> None:
        self.protocol = protocol
        self.functions = functions
        self.plain = PlainValues(protocol)
        self._data: dict[str, list[Data]] = {}
        """For each frame its bytes that displays read as layouts."""
        self._names: dict[str, Names] = {}

    def to_plain(self, frame: str, fields: Fields, request: Fields | None = None) -> dict[str, Any]:
        """Return the values of a frame in plain form, and after them the content of its bytes by layout."""
        found = self.plain.to_plain(frame, fields)
        for layout, values in self._read(frame, fields, request):
            found.setdefault(layout, shown(values))
        return found

    def with_names(self, frame: str, fields: Fields, request: Fields | None = None) -> dict[str, Any]:
        """Return the same for people: each number has its name."""
        found = {
            name: self.plain.named(frame, name, value) for name, value in self.plain.to_plain(frame, fields).items()
        }
        for layout, values in self._read(frame, fields, request):
            found.setdefault(layout, with_names(self._names_of(layout), layout, shown(values)))
        return found

    def names(self, frame: str, fields: Fields, request: Fields | None = None) -> dict[str, str]:
        """Return the names of the numbers in `to_plain` by their places: `{"body.nack.minor": "password invalid"}`."""
        known = self.plain.names(frame)
        found: dict[str, str] = {}
        if known:
            for name, value in fields.items():
                found.update(named_paths(known, name, name, value))
        for layout, values in self._read(frame, fields, request):
            if layout not in fields:
                found.update(named_paths(self._names_of(layout), layout, layout, values))
        return found

    def rows(self, frame: str, fields: Fields, request: Fields | None = None) -> Iterator[tuple[str, Any]]:
        """Yield each single value of the content of a frame's bytes: its path, and the value with its name."""
        for layout, values in self._read(frame, fields, request):
            yield from _paths(layout, with_names(self._names_of(layout), layout, shown(values)))

    def _read(self, frame: str, fields: Fields, request: Fields | None) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield layouts and their values."""
        for data in self._shown_in(frame):
            assert data.shows is not None
            content = fields.get(data.name)
            try:
                name = data.shows.layouts.get(compiled(data.shows.by, _attribute)({REQUEST: request, **fields}))
                if name is None or not isinstance(content, bytes):
                    continue
                _, decode = self.functions.layouts[name.layout]
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

    def asks(self, frame: str) -> bool:
        """Return whether the request of a frame says what its bytes are."""
        shown = (data.shows for data in self._shown_in(frame))
        nodes = (node for one in shown if one is not None for node in walk(one.by))
        return any(isinstance(node, Name) and node.name == REQUEST for node in nodes)

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


class Event(Kind):
    """An event of a line: `Seen` of the layer above."""

    kind: Any
    frame: str
    client: str
    request: Mapping[str, Any] | None

    @property
    def fields(self) -> Fields:
        """Return the fields of a frame."""


class Requests:
    """Remember the latest frames of each channel for a display, and find the request of a frame among them.

    A request has the same values as the frame in the fields that the frame echoes.
    """

    MOST = 64
    """Number of frames that are remembered for each channel."""

    def __init__(self) -> None:
        self._asking: dict[Contents, dict[str, str]] = {}
        """The frames of a protocol whose requests say what their bytes are, with their side."""
        self._before: dict[Any, deque[tuple[str, Fields]]] = {}
        """For each channel the frames before, with their client."""

    def attach(self, contents: Contents, seen: Event, channel: Any = 1) -> None:
        """Give a frame its request, or remember it. To be called for every event in order."""
        asking = self._asking.get(contents)
        frames = contents.protocol.frames
        if asking is None:
            asking = self._asking[contents] = {name: one.side for name, one in frames.items() if contents.asks(name)}
        if not asking or seen.kind != "frame" or seen.frame not in frames:
            return
        before = self._before.setdefault(channel, deque(maxlen=self.MOST))
        if seen.frame in asking:
            fields, echo = seen.fields, frames[seen.frame].echo
            mine = (request for client, request in reversed(before) if client == seen.client)
            seen.request = next((request for request in mine if _answers(fields, request, echo)), None)
        elif frames[seen.frame].side not in asking.values():
            before.append((seen.client, seen.fields))


def _answers(fields: Fields, request: Fields, echo: Mapping[str, Expression]) -> bool:
    """Return whether a frame has the values of its request in the fields that it echoes."""
    names = {**request, REQUEST: request}
    try:
        return all(compiled(value.root, _attribute)(names) == fields[name] for name, value in echo.items())
    except EVALUATION_ERRORS:
        return False


def _attribute(value: Any, name: str) -> Any:
    """Return `value.name`; an inner frame, `{frame: fields}`, has the attributes of its fields."""
    if name not in value and len(value) == 1:
        (value,) = value.values()
    return value[name]


def _paths(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _paths(f"{path}.{name}", item)
    elif isinstance(value, list):
        for place, item in enumerate(value):
            yield from _paths(f"{path}[{place}]", item)
    else:
        yield path, value

"""What the link knows of every frame before any byte comes: codec, beginning, inner frames, echo, announcements.

Made once for a codec. It knows the codec only by the contract below, and no sequences.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol, TypeVar

from framekit.definition.model import protocol as model
from framekit.definition.model.segments import (
    Inner,
)
from framekit.definition.model.walk import everything
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names
from framekit.link.frame_info import FrameCodec, FrameInfo, Shape
from framekit.link.values import FrameValue, plain

Context = Mapping[str, Any]
Made = TypeVar("Made")


class ProtocolCodec(Protocol):
    """A compiled protocol. `QUIET` and `LOST` are the special results of `measure`; both below every other result."""

    @property
    def frames(self) -> Mapping[str, FrameCodec]: ...
    @property
    def layouts(self) -> Mapping[str, tuple[Callable[..., bytes], Callable[..., dict[str, Any]]]]: ...
    @property
    def QUIET(self) -> int: ...  # noqa: N802 - a constant of the generated module
    @property
    def LOST(self) -> int: ...  # noqa: N802


def made_once(protocol: model.Protocol, codec: ProtocolCodec, kind: type[Made], make: Callable[[], Made]) -> Made:
    """What `make` makes of a protocol, made once for all who use this codec of it."""
    kept: dict[Any, tuple[model.Protocol, Made]] = getattr(codec, "kept", {})
    found = kept.get(kind)
    if found is None or found[0] is not protocol:
        found = kept[kind] = protocol, make()
    return found[1]


def table_of(protocol: model.Protocol, codec: ProtocolCodec) -> FrameTable:
    """The table of all frames of a protocol, made once for a codec."""
    return made_once(protocol, codec, FrameTable, lambda: FrameTable(protocol, codec))


class FrameTable:
    """All frames of a protocol; `on_line` are those looked for on the line, frames that exist to be refused last.

    A frame that stands in others (`inner`) never is.
    """

    def __init__(self, protocol: model.Protocol, codec: ProtocolCodec) -> None:
        self.codec = codec
        self.infos = {name: FrameInfo(frame, codec.frames[name]) for name, frame in protocol.frames.items()}
        every = (segment for frame in protocol.frames.values() for segment in everything(frame.segments))
        inner = {name for segment in every if isinstance(segment, Inner) for name in segment.frames}
        for info in self.infos.values():
            info.make = partial(self.received_as, info)
            info.on_line = not info.frame.inner and info.name not in inner
        outer = [info for info in self.infos.values() if info.on_line and info.frame.side != "none"]
        self.on_line = tuple(info.name for info in sorted(outer, key=lambda info: info.refuse is not None))

    def received(self, name: str, fields: dict[str, Any], raw: bytes | None, refusal: int | None) -> FrameValue:
        """The frame value of decoded fields; a refusal holds for the frame and for what it carries."""
        info = self.infos.get(name)
        return FrameValue(name, fields, raw, refusal) if info is None else self.received_as(info, fields, raw, refusal)

    def received_as(
        self, info: FrameInfo, fields: dict[str, Any], raw: bytes | None, refusal: int | None
    ) -> FrameValue:
        """As `received`, for a frame that is known."""
        value = FrameValue(info.name, fields, raw, info.refuse if refusal is None else refusal)
        if info.shape:
            self._convert(info.shape, value, fields)
        return value

    def _take_inner(self, name: str, outer: FrameValue, fields: dict[str, Any]) -> None:
        """The frame inside becomes a frame value; if it is to be refused, so is the one around it."""
        found = fields.get(name)
        if type(found) is dict and len(found) == 1:
            ((frame, content),) = found.items()
            info = self.infos.get(frame)
            refusal = outer.refusal
            if info is None or info.shape:
                fields[name] = inner = self.received(frame, content, None, refusal)
            else:  # the usual case, and the one that has to be quick
                fields[name] = inner = FrameValue(frame, content, None, info.refuse if refusal is None else refusal)
            if refusal is None:
                outer.refusal = inner.refusal

    def _convert(self, shape: Shape, outer: FrameValue, fields: dict[str, Any]) -> None:
        for kind, name, below in shape:
            found = fields.get(name)
            if kind == "inner":
                self._take_inner(name, outer, fields)
            elif kind == "record" and type(found) is dict:
                self._convert(below, outer, found)
            elif kind == "list" and type(found) is list:
                for item in found:
                    if type(item) is dict:
                        self._convert(below, outer, item)

    def made(self, name: str, fields: dict[str, Any], names: Names) -> FrameValue:
        """A frame value from a constructor's fields: constants and `is` are known at once."""
        return FrameValue(name, self.completed(self.infos[name], fields, names))

    @staticmethod
    def completed(info: FrameInfo, fields: dict[str, Any], names: Names) -> dict[str, Any]:
        """The fields of a constructor with constants and `is`."""
        for field, numbers in info.numbers.items():
            given = fields.get(field)
            if type(given) is str:
                fields[field] = numbers.get(given, given)
        for field, constant in info.known.items():
            fields.setdefault(field, constant)
        for field, evaluate in info.computed:
            if field not in fields:
                try:
                    fields[field] = evaluate(Names(fields, names))
                except EVALUATION_ERRORS:
                    continue
        return fields

    def encode(self, value: FrameValue, names: Context) -> bytes:
        """The bytes of a frame value; afterwards the value holds them and every field as sent. Raises ValueError."""
        info = self.infos[value.frame]
        data = info.encode(value.fields if info.flat else plain(value.fields), names)
        self.mark_sent(value, data, names)
        return data

    def mark_sent(self, value: FrameValue, data: bytes, names: Context) -> None:
        """The value has become these bytes: from now on it holds them, and every field as sent."""
        info = self.infos[value.frame]
        value.raw = data
        value.pending = read = partial(self._read_back, info, data, names)
        for kind, name, _ in info.shape:
            inner = value.fields.get(name) if kind == "inner" else None
            if type(inner) is FrameValue and inner.raw is None:
                inner.pending = partial(_read_inner, read, name)  # which does not lead back to `value`
        if info.announces:
            value.complete()

    def read_later(self, value: FrameValue, names: tuple[str, ...]) -> Callable[[], dict[str, Any]] | None:
        """What reads all fields of a frame that has just been sent, on these names as they are now; None: too late."""
        if not isinstance(value.pending, partial):
            return None
        info, data, context = value.pending.args
        try:
            return partial(self._read_back, info, data, {name: context[name] for name in names})
        except EVALUATION_ERRORS:
            return None

    def _read_back(self, info: FrameInfo, data: bytes, names: Context) -> dict[str, Any]:
        try:
            return self.received(info.name, info.decode(data, names), data, None).fields
        except EVALUATION_ERRORS:
            return {}

    def fill_echo(self, reply: FrameValue, *requests: FrameValue | None) -> None:
        """Building a reply, or a frame that carries one, copies what it repeats of the first request that has it."""
        info = self.infos.get(reply.frame)
        if info is None:
            return
        for field, plain_name, evaluate in info.echo:
            for request in requests:
                if field not in reply.fields and request is not None:
                    try:
                        reply.fields[field] = echoed(plain_name, evaluate, request)
                    except EVALUATION_ERRORS:
                        continue
        for kind, name, _ in info.shape:
            inner = reply.fields.get(name) if kind == "inner" else None
            if type(inner) is FrameValue and inner.raw is None:
                below = self.infos.get(inner.frame)
                if below is not None and (below.echo or below.shape):
                    self.fill_echo(inner, *requests)

    def fits_echo(self, reply: FrameValue, requests: tuple[FrameValue, ...], names: Callable[[], Names]) -> bool:
        """Whether a reply repeats what it has to of the first of `requests` that has it; inner frames too.

        `names` gives those that the reply's `echo` may read.
        """
        info = self.infos.get(reply.frame)
        if info is None:
            return True
        fields = reply.fields
        for field, plain_name, evaluate in info.echo:
            for request in requests:
                if plain_name is not None and plain_name in request.fields:
                    wanted = request.fields[plain_name]
                elif plain_name is not None and plain_name not in self.infos[request.frame].value_names:
                    continue
                else:
                    try:
                        wanted = echoed(plain_name, evaluate, request, None if plain_name is not None else names())
                    except EVALUATION_ERRORS:
                        continue
                if field in fields and fields[field] != wanted:
                    return False
                break
        if info.shape:
            for kind, name, _ in info.shape:
                inner = reply.fields.get(name)
                if kind != "inner" or type(inner) is not FrameValue:
                    continue
                below = self.infos.get(inner.frame)
                if below is not None and (below.echo or below.shape) and not self.fits_echo(inner, requests, names):
                    return False
        return True


def _read_inner(read: Callable[[], dict[str, Any]], name: str) -> dict[str, Any]:
    """The fields of a frame inside another, as they were sent."""
    inner = read().get(name)
    return inner.fields if type(inner) is FrameValue else {}


def echoed(plain_name: str | None, evaluate: Evaluate, request: FrameValue, names: Names | None = None) -> Any:
    """What a reply repeats of a request. Raises KeyError when the request has no such field."""
    if plain_name is not None:
        return request.field(plain_name)
    return evaluate(Names({**request.complete(), "request": request}, names))

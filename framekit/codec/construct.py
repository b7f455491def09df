"""Frames as objects of the construct library, for use inside constructs of one's own.

The object calls the compiled functions of the frame: `measure` says where the frame ends in a stream, `decode` and
`encode` do the rest. So it finds the same frames, with the same faults, as everything else in framekit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any

import construct

from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.functions import Context, FrameFunctions
from framekit.definition.model.frames import Frame, StaticSizes


class FrameParseError(FrameError, construct.ConstructError):
    """A FrameError that is a ConstructError too, as `construct.Select` and `construct.Optional` expect."""

    def __init__(self, error: FrameError, path: str) -> None:
        super().__init__(
            error.cause, error.segment, error.offset, error.expected, error.found, error.refuse, error.fields
        )
        self.path = path


class FrameBuildError(EncodeError, construct.ConstructError):
    """An EncodeError that is a ConstructError too."""

    def __init__(self, error: EncodeError, path: str) -> None:
        super().__init__(error.field, str(error), error.more)
        self.path = path


class CompiledFrame(construct.Construct):
    """One frame of a protocol as a construct object.

    Parses one frame from the place where the stream stands, and leaves the stream behind it: bare in `Struct`, `Array`
    or `GreedyRange`, nested, or by itself. Only a frame that nothing but silence ends takes everything to the end of
    the stream. The result is a `construct.Container` of the frame's values. Builds from a mapping; lengths, counts,
    checks, constants and what has a default may be left out. `sizeof` gives the bytes of a frame that never varies.

    Parameters, and other names that the frame reads, are keywords of `parse` and `build`. Raises FrameParseError (a
    FrameError), FrameBuildError (an EncodeError), construct.SizeofError.
    """

    def __init__(
        self,
        functions: FrameFunctions,
        frames: Mapping[str, Frame],
        name: str,
        context: Callable[[Mapping[str, Any]], Context],
    ) -> None:
        """`context`: the names that the frame reads, with those that one call gives."""
        super().__init__()
        self.name = name
        self.docs = frames[name].doc
        self._functions = functions
        self._sizes = StaticSizes(frames).frame(name)
        self._context = context

    def _parse(self, stream: BytesIO, context: construct.Container, path: str) -> construct.Container:
        names = self._context(context._params)
        try:
            return _container(self._functions.decode(self.name, self._cut(stream, names, path), names))
        except FrameError as error:
            raise FrameParseError(error, path) from None

    def _cut(self, stream: BytesIO, names: Context, path: str) -> bytes:
        """The bytes of the frame that begins here; all that were read where none does.

        More is read at least in proportion to what is there, so a long frame is not measured at every byte.
        """
        start = construct.stream_tell(stream, path)
        data, wanted = bytearray(), max(self._sizes.least, 1)
        while True:
            more = stream.read(max(wanted, len(data)))
            data += more
            length = self._functions.measure(self.name, data, ctx=names)
            if length > 0:
                construct.stream_seek(stream, start + length, 0, path)
                return bytes(data[:length])
            if length == self._functions.QUIET:
                data += construct.stream_read_entire(stream, path)
                return bytes(data)
            if length >= 0 or length == self._functions.LOST or not more:
                return bytes(data)
            wanted = -length

    def _build(self, obj: Any, stream: BytesIO, context: construct.Container, path: str) -> Any:
        try:
            data = self._functions.encode(self.name, obj, self._context(context._params))
        except EncodeError as error:
            raise FrameBuildError(error, path) from None
        construct.stream_write(stream, data, len(data), path)
        return obj

    def _sizeof(self, context: construct.Container, path: str) -> int:
        if self._sizes.fixed is None:
            raise construct.SizeofError(f"the size of frame '{self.name}' varies", path=path)
        return self._sizes.fixed


def _container(value: Any) -> Any:
    """Dictionaries as construct's containers, lists as its lists."""
    if isinstance(value, dict):
        return construct.Container({name: _container(item) for name, item in value.items()})
    return construct.ListContainer([_container(item) for item in value]) if isinstance(value, list) else value

"""Provide frames as objects of the construct library, for use inside other constructs.

The object calls the compiled functions of the frame: `measure` finds its end in a stream, `decode` and `encode` convert
it. So it finds the same frames, with the same faults, as the rest of framekit.
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
    """A FrameError that is also a ConstructError, as `construct.Select` and `construct.Optional` expect."""

    def __init__(self, error: FrameError, path: str) -> None:
        super().__init__(
            error.cause, error.segment, error.offset, error.expected, error.found, error.refuse, error.fields
        )
        self.path = path


class FrameBuildError(EncodeError, construct.ConstructError):
    """An EncodeError that is also a ConstructError."""

    def __init__(self, error: EncodeError, path: str) -> None:
        super().__init__(error.field, str(error), error.more)
        self.path = path


class CompiledFrame(construct.Construct):
    """One frame of a protocol as a construct object.

    Parses one frame at the current position of the stream and leaves the stream after it, on its own or inside
    `Struct`, `Array` or `GreedyRange`. Only a frame that ends by silence takes all bytes to the end of the stream. The
    result is a `construct.Container` of the frame's values. Builds from a mapping; lengths, counts, checks, constants
    and values with a default may be omitted. `sizeof` returns the size in bytes of a frame of constant size.

    Parameters, and other names that the frame reads, are keywords of `parse` and `build`. Raises FrameParseError (a
    FrameError), FrameBuildError (an EncodeError) and construct.SizeofError.
    """

    def __init__(
        self,
        functions: FrameFunctions,
        frames: Mapping[str, Frame],
        name: str,
        context: Callable[[Mapping[str, Any]], Context],
    ) -> None:
        """Take the functions and the model of frame `name`.

        `context` returns the complete context of the frame, given the keywords of one call.
        """
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
        """Return the bytes of the frame that begins here, or all bytes read if no frame does.

        Each read is at least as long as the bytes at hand, so a long frame is not measured at every byte.
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
    """Convert dictionaries to construct's containers and lists to its lists."""
    if isinstance(value, dict):
        return construct.Container({name: _container(item) for name, item in value.items()})
    return construct.ListContainer([_container(item) for item in value]) if isinstance(value, list) else value

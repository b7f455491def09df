"""The codec made of constructs: decoding and encoding with plain dictionaries and a context mapping."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from construct import Construct

from construct_oracle.faults import ConstructFrameError
from construct_oracle.frame import FrameConstruct
from construct_oracle.names import CONTEXT_KEY


class ConstructCodec:
    """The frames and layouts of a protocol as constructs.

    `frames` and `layouts` can be used in other constructs, with the context as keyword arguments; `decode` and `encode`
    take it as a mapping. Without a context, constant start values of parameters and state are used.
    """

    def __init__(self, frames: Mapping[str, FrameConstruct], layouts: Mapping[str, FrameConstruct]) -> None:
        self.frames: dict[str, Construct] = dict(frames)
        self.layouts: dict[str, Construct] = dict(layouts)

    def decode(self, frame: str, data: bytes, ctx: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the values of a frame; `data` is exactly one frame.

        Raises FrameError, and KeyError for an unknown frame.
        """
        return self._decode(self.frames[frame], data, ctx)

    def encode(self, frame: str, fields: Mapping[str, Any], ctx: Mapping[str, Any] | None = None) -> bytes:
        """Return the bytes of a frame. Raises EncodeError, and KeyError for an unknown frame."""
        return self._encode(self.frames[frame], fields, ctx)

    def decode_layout(self, layout: str, data: bytes, ctx: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the values of a layout. Raises FrameError."""
        return self._decode(self.layouts[layout], data, ctx)

    def encode_layout(self, layout: str, fields: Mapping[str, Any], ctx: Mapping[str, Any] | None = None) -> bytes:
        """Return the bytes of a layout. Raises EncodeError."""
        return self._encode(self.layouts[layout], fields, ctx)

    @staticmethod
    def _decode(construct: Construct, data: bytes, ctx: Mapping[str, Any] | None) -> dict[str, Any]:
        try:
            values: dict[str, Any] = plain(construct.parse(data, **{CONTEXT_KEY: ctx or {}}))
        except ConstructFrameError as error:
            error.fields = plain(error.fields)
            raise
        return values

    @staticmethod
    def _encode(construct: Construct, fields: Mapping[str, Any], ctx: Mapping[str, Any] | None) -> bytes:
        data: bytes = construct.build(fields, **{CONTEXT_KEY: ctx or {}})
        return data


def plain(value: Any) -> Any:
    """Return containers as plain dictionaries and lists."""
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list) else value

"""The functions of a generated module, behind the names of its frames.

Imported by commands that have to be quick: it stands on nothing but the errors. Where the module comes from, and which
protocol it belongs to, is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import CodeType, ModuleType
from typing import Any

from framekit.codec.errors import FrameError

Context = Mapping[str, Any]
Encode = Callable[..., bytes]
Decode = Callable[..., dict[str, Any]]
Span = tuple[str, int, int, Any]


def module_of(protocol: str, code: CodeType) -> ModuleType:
    """The module that the code of a protocol's frames makes."""
    module = ModuleType(f"framekit_generated_{protocol}")
    exec(code, vars(module))
    return module


class FrameFunctions:
    """The functions of every frame by its name; `encoders`, `decoders`, `measurers` are for those who call often.

    `kept`: what users of these functions have made of them, by its class, for as long as they are used.
    Contexts are mappings name → value; None means the start values of the definition (`defaults`).
    """

    def __init__(self, module: ModuleType) -> None:
        names: dict[str, Any] = vars(module)
        self.module = module
        self.kept: dict[Any, Any] = {}
        self.frames: Mapping[str, Any] = names["FRAMES"]
        self.layouts: Mapping[str, tuple[Encode, Decode]] = names["LAYOUTS"]
        self.defaults: Mapping[str, Any] = names["DEFAULTS"]
        self.QUIET: int = names["QUIET"]
        self.LOST: int = names["LOST"]
        self.encoders: dict[str, Encode] = {name: frame.encode for name, frame in self.frames.items()}
        self.decoders: dict[str, Decode] = {name: frame.decode for name, frame in self.frames.items()}
        self.measurers: dict[str, Callable[..., int]] = {name: frame.measure for name, frame in self.frames.items()}

    def encode(self, frame: str, fields: Mapping[str, Any], ctx: Context | None = None) -> bytes:
        """The bytes of a frame. Raises EncodeError for values it cannot carry, KeyError for an unknown frame."""
        return self.encoders[frame](fields, self.defaults if ctx is None else ctx)

    def decode(self, frame: str, data: bytes, ctx: Context | None = None) -> dict[str, Any]:
        """The values of exactly one frame. Raises FrameError."""
        return self.decoders[frame](data, self.defaults if ctx is None else ctx)

    def measure(
        self,
        frame: str,
        data: bytes | bytearray,
        start: int = 0,
        end: int | None = None,
        ctx: Context | None = None,
        seen: int = 0,
    ) -> int:
        """How long the frame at data[start] is; nothing from `end` on is looked at.

        Its length; 0 when it does not begin there; -n when it wants n bytes more at least; QUIET or LOST.
        """
        end = len(data) if end is None else end
        return self.measurers[frame](data, start, end, self.defaults if ctx is None else ctx, seen)

    def trace(
        self, frame: str, data: bytes, ctx: Context | None = None
    ) -> tuple[dict[str, Any], list[Span], FrameError | None]:
        """A frame as far as it can be read: values, (path, first byte, byte behind the last, value), the fault."""
        found = self.frames[frame].examine(data, self.defaults if ctx is None else ctx)
        return found.fields, found.spans, None if found.fault is None else found.error(frame)

    def check_warnings(self, frame: str, data: bytes, ctx: Context | None = None) -> list[str]:
        """Wrong check codes of a frame that only warn."""
        return list(self.frames[frame].examine(data, self.defaults if ctx is None else ctx).notes.warnings)

    def encode_layout(self, layout: str, fields: Mapping[str, Any], ctx: Context | None = None) -> bytes:
        """The bytes of a layout by itself. Raises EncodeError, KeyError for one that needs a frame around it."""
        return self.layouts[layout][0](fields, self.defaults if ctx is None else ctx)

    def decode_layout(self, layout: str, data: bytes, ctx: Context | None = None) -> dict[str, Any]:
        """The values of a layout by itself. Raises FrameError, KeyError for one that needs a frame around it."""
        return self.layouts[layout][1](data, self.defaults if ctx is None else ctx)

"""The functions of a generated module, behind the names of its frames.

Imported by commands that have to be quick: it stands on nothing but the errors. Where the module comes from, and which
protocol it belongs to, is not known here.
"""

from __future__ import annotations

import sys
import typing
from _thread import allocate_lock
from collections.abc import Callable, Mapping, Sequence
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

from framekit.codec.errors import FrameError

if TYPE_CHECKING:
    from framekit.definition.model.protocol import Protocol


Context = Mapping[str, Any]
Encode = Callable[..., bytes]
Decode = Callable[..., dict[str, Any]]
Span = tuple[str, int, int, Any]

_NAMED = allocate_lock()
"""Held while a module has its name."""


def module_of(protocol: str, code: CodeType) -> ModuleType:
    """The module that the code of a protocol's frames makes."""
    return run_in(ModuleType(f"framekit_generated_{protocol}"), code)


def run_in(module: ModuleType, code: CodeType) -> ModuleType:
    """Runs code as that of a module, which meanwhile is found by its name: decorators of classes look there."""
    with _NAMED:
        sys.modules[module.__name__] = module
        try:
            exec(code, vars(module))
        finally:
            sys.modules.pop(module.__name__, None)
    return module


class FrameFunctions:
    """The functions of every frame by its name; `encoders`, `decoders`, `measurers` are for callers in a loop.

    `kept`: what users of these functions have made of them, by its class, for as long as they are used.
    `fused`: of frames that are read together with the one inside, the place of the byte that tells which, and by its
    value what reads the two; it raises whatever comes up if they do not fit.
    Contexts are mappings name → value; None means the start values of the definition (`defaults`).
    """

    def __init__(self, module: ModuleType) -> None:
        names: dict[str, Any] = vars(module)
        self.module = module
        self.kept: dict[Any, Any] = {}
        self.frames: Mapping[str, Any] = names["FRAMES"]
        self.layouts: Mapping[str, tuple[Encode, Decode]] = names["LAYOUTS"]
        self.fused: Mapping[str, tuple[int, Sequence[Decode | None]]] = names["FUSED"]
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
        found = self.frames[frame].diagnose(data, self.defaults if ctx is None else ctx)
        return found.fields, found.spans, None if found.fault is None else found.error(frame)

    def check_warnings(self, frame: str, data: bytes, ctx: Context | None = None) -> list[str]:
        """Return the wrong check codes that only warn, and why bytes inside are none of the frames of their place."""
        notes = self.frames[frame].diagnose(data, self.defaults if ctx is None else ctx).notes
        unknown = (f"{path} is none of its frames; nearest: {fault}" for path, fault in notes.unknown)
        return [*notes.warnings, *unknown]


class FrameFacts(typing.Protocol):
    """What has to be known of a frame."""

    @property
    def name(self) -> str: ...
    @property
    def inner(self) -> bool: ...
    @property
    def side(self) -> str: ...
    @property
    def refuse(self) -> int | None: ...


Catalogue = Mapping[str, FrameFacts]
"""The frames of a protocol by their names."""


class Fit(NamedTuple):
    """A frame that the bytes are; `refusal` is the code a server would refuse it with."""

    frame: str
    fields: dict[str, Any]
    refusal: int | None = None


def candidates(protocol: Protocol, frame: str | None = None, side: str | None = None) -> list[str]:
    """The frames to try: one or those of a group, or all that stand on the line and may come from that side.

    Raises KeyError for a frame or group there is not.
    """
    return list(protocol.frames_of(frame)) if frame is not None else of_side(protocol.frames, side)


def of_side(frames: Catalogue, side: str | None = None) -> list[str]:
    """The frames that stand on the line and come from that side (None: from either); those that are refused last.

    A frame that no side sends (`from: none`) is only for procedures: as an answer it would hide what is wrong.
    """
    sides = (side, "both") if side is not None else ("client", "server", "both")
    found = [one for one in frames.values() if not one.inner and one.side in sides]
    return [one.name for one in sorted(found, key=lambda one: one.refuse is not None)]


def fitting(
    codec: FrameFunctions, frames: Catalogue, data: bytes, names: list[str], context: Context | None = None
) -> tuple[list[Fit], list[tuple[str, FrameError]]]:
    """The frames that the bytes are, and why they are not the others. Frames to be refused count only alone."""
    fits: list[Fit] = []
    faults: list[tuple[str, FrameError]] = []
    for name in names:
        frame = frames[name]
        if fits and frame.refuse is not None:
            continue
        try:
            fits.append(Fit(name, codec.decode(name, data, context), frame.refuse))
        except FrameError as error:
            if error.refuse is not None and error.cause != "check":
                fits.append(Fit(name, error.fields, error.refuse))
            faults.append((name, error))
    whole = [fit for fit in fits if fit.refusal is None]
    known = [fit for fit in whole if not _holds_unknown(fit.fields)]
    return known or whole or fits, faults


def nearest(faults: list[tuple[str, FrameError]]) -> tuple[str, FrameError] | None:
    """The frame that fits best, and its fault: all but its check code is right, or else the most of it."""

    def fitness(fault: tuple[str, FrameError]) -> tuple[bool, int]:
        error = fault[1]
        other = error.also if error.cause == "check" else error
        return (True, error.offset) if other is None else (False, other.offset)

    return max(faults, key=fitness, default=None)


def reason(faults: list[tuple[str, FrameError]], data: bytes) -> str:
    """Why the bytes are no frame: what the frame that fits best has to say."""
    if not data:
        return "there are no bytes to decode"
    best = nearest(faults)
    if best is None:
        return "this protocol has no frames that could be tried"
    also = f"; also {best[1].also}" if best[1].also is not None else ""
    return f"no frame fits; nearest is '{best[0]}': {best[1]}{also}"


def _holds_unknown(fields: Mapping[str, Any]) -> bool:
    """Whether a frame inside is none that the protocol knows."""
    return any(isinstance(value, dict) and ("unknown" in value or _holds_unknown(value)) for value in fields.values())

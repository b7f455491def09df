"""Call the functions of a generated module by the names of its frames.

Commands with short start-up time import this module: it depends on the errors only, and neither on the source of the
generated module nor on its protocol.
"""

from __future__ import annotations

import sys
import typing
from _thread import allocate_lock
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

from framekit.codec.errors import FrameError

if TYPE_CHECKING:
    from framekit.definition.model.protocol import Protocol


Context = Mapping[str, Any]
"""Values of the names that frames read from outside, by name."""
Encode = Callable[..., bytes]
"""Build a frame: `(fields, context) -> bytes`."""
Decode = Callable[..., dict[str, Any]]
"""Read a frame: `(data, context) -> fields`."""
Span = tuple[str, int, int, Any]
"""Path of a value, offset of its first byte, offset after its last byte, and the value."""

_NAMED = allocate_lock()
"""Held while a module is registered in `sys.modules`."""


def module_of(protocol: str, code: CodeType) -> ModuleType:
    """Return the module that results from running the code of a protocol's frames."""
    return run_in(ModuleType(f"framekit_generated_{protocol}"), code)


def run_in(module: ModuleType, code: CodeType) -> ModuleType:
    """Run code in a module, which is in `sys.modules` during the run because decorators of classes look there."""
    with _NAMED:
        sys.modules[module.__name__] = module
        try:
            exec(code, vars(module))
        finally:
            sys.modules.pop(module.__name__, None)
    return module


class FrameFunctions:
    """The functions of every frame by its name; `encoders`, `decoders` and `measurers` are for callers in a loop.

    Contexts are mappings name → value; None means the start values of the definition (`defaults`).
    """

    def __init__(self, module: ModuleType) -> None:
        names: dict[str, Any] = vars(module)
        self.module = module
        self.kept: dict[Any, Any] = {}
        """Objects that users derive from these functions, by their class, kept as long as the functions."""
        self.frames: Mapping[str, Any] = names["FRAMES"]
        self.layouts: Mapping[str, tuple[Encode, Decode]] = names["LAYOUTS"]
        self.fused: Mapping[str, tuple[int, Sequence[Decode | None]]] = names["FUSED"]
        """Readers of a frame together with its inner frame.

        Each entry is the offset of the deciding byte, and the readers by its value. A reader may raise any exception if
        the bytes do not fit.
        """
        self.defaults: Mapping[str, Any] = names["DEFAULTS"]
        self.QUIET: int = names["QUIET"]
        self.LOST: int = names["LOST"]
        self.encoders: dict[str, Encode] = {name: frame.encode for name, frame in self.frames.items()}
        self.decoders: dict[str, Decode] = {name: frame.decode for name, frame in self.frames.items()}
        self.measurers: dict[str, Callable[..., int]] = {name: frame.measure for name, frame in self.frames.items()}

    def encode(self, frame: str, fields: Mapping[str, Any], ctx: Context | None = None) -> bytes:
        """Return the bytes of a frame. Raises EncodeError for values that do not fit, KeyError for an unknown frame."""
        return self.encoders[frame](fields, self.defaults if ctx is None else ctx)

    def decode(self, frame: str, data: bytes, ctx: Context | None = None) -> dict[str, Any]:
        """Return the values of exactly one frame.

        Raises FrameError if the bytes do not fit, KeyError for an unknown frame.
        """
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
        """Return the length in bytes of the frame at `data[start]`, looking at no byte from `end` on.

        Returns 0 if the frame does not begin there, -n if at least n more bytes are needed, QUIET if only silence ends
        the frame, LOST if its end cannot be found. `seen`: the number of bytes at hand in the previous call for this
        frame.
        """
        end = len(data) if end is None else end
        return self.measurers[frame](data, start, end, self.defaults if ctx is None else ctx, seen)

    def trace(
        self, frame: str, data: bytes, ctx: Context | None = None
    ) -> tuple[dict[str, Any], list[Span], FrameError | None]:
        """Read a frame as far as possible: its values, their spans, and the fault or None."""
        found = self.frames[frame].diagnose(data, self.defaults if ctx is None else ctx)
        return found.fields, found.spans, None if found.fault is None else found.error(frame)

    def check_warnings(self, frame: str, data: bytes, ctx: Context | None = None) -> list[str]:
        """Return the wrong check codes that only warn, and the reasons why inner bytes fit none of their frames."""
        notes = self.frames[frame].diagnose(data, self.defaults if ctx is None else ctx).notes
        unknown = (f"{path} is none of its frames; nearest: {fault}" for path, fault in notes.unknown)
        return [*notes.warnings, *unknown]

    def fault_inside(self, frame: str, data: bytes, ctx: Context | None = None) -> FrameError | None:
        """Return the fault of the nearest candidate for inner bytes that fit none of their frames, None without any."""
        notes = self.frames[frame].diagnose(data, self.defaults if ctx is None else ctx).notes
        return notes.unknown[0][1] if notes.unknown else None


class FrameFacts(typing.Protocol):
    """The properties of a frame that the search for fitting frames needs."""

    @property
    def name(self) -> str: ...
    @property
    def inner(self) -> bool: ...
    @property
    def side(self) -> str: ...
    @property
    def refuse(self) -> int | None: ...


Catalogue = Mapping[str, FrameFacts]
"""The frames of a protocol by name."""


class Fit(NamedTuple):
    """A frame that the bytes fit; `refusal` is the code with which a server would refuse it."""

    frame: str
    fields: dict[str, Any]
    refusal: int | None = None


def candidates(protocol: Protocol, frame: str | None = None, side: str | None = None) -> list[str]:
    """Return the frames to try: the named frame, the frames of a group, or all frames on the line from that side.

    Raises KeyError for an unknown frame or group.
    """
    return list(protocol.frames_of(frame)) if frame is not None else of_side(protocol.frames, side)


def of_side(frames: Catalogue, side: str | None = None) -> list[str]:
    """Return the frames on the line that a side sends (None: any side); refused frames come last.

    A frame that no side sends (`from: none`) is for procedures only: as an answer it would hide the real fault.
    """
    sides = (side, "both") if side is not None else ("client", "server", "both")
    found = [one for one in frames.values() if not one.inner and one.side in sides]
    return [one.name for one in sorted(found, key=lambda one: one.refuse is not None)]


def fitting(
    codec: FrameFunctions, frames: Catalogue, data: bytes, names: list[str], context: Context | None = None
) -> tuple[list[Fit], list[tuple[str, FrameError]]]:
    """Return the frames that the bytes fit, and the faults of the other frames.

    A frame with `refuse` counts only if no other frame fits.
    """
    fits, faults = _fits(codec, frames, data, names, context)
    whole = [fit for fit in fits if fit.refusal is None]
    known = [fit for fit in whole if not _holds_unknown(fit.fields)]
    return known or whole or fits, faults


def likely(
    codec: FrameFunctions, frames: Catalogue, data: bytes, names: list[str], context: Context | None = None
) -> tuple[list[Fit], list[tuple[str, FrameError]]]:
    """Return the frames that bytes of unknown origin are, presumably, and the faults of the other frames.

    A frame that holds bytes for which its definition has a refusal, such as a request with an unknown function, counts
    only if no other frame fits, or has a fault inside: the bytes are rather a damaged reply.
    """
    fits, faults = _fits(codec, frames, data, names, context)
    whole = [fit for fit in fits if fit.refusal is None and not _holds_unknown(fit.fields)]
    right = [fit for fit in whole if not _holds_refused(fit.fields, frames)]
    if right or len(fits) < 2:
        return right or fits, faults
    faulty = [fit for fit in fits if fit.refusal is None and damage(codec, fit.frame, data, context) is not None]
    refused = [fit for fit in fits if fit.refusal is not None]
    return [*faulty, *refused] if faulty else whole or fits, faults


OTHER_KIND = frozenset({"constant", "where"})
"""Causes of faults that show that bytes are another kind of frame, and not a damaged frame."""


def damage(codec: FrameFunctions, frame: str, data: bytes, context: Context | None = None) -> FrameError | None:
    """Return the fault of inner bytes that are a known frame but for this fault; None without any."""
    fault = codec.fault_inside(frame, data, context)
    return None if fault is None or fault.cause in OTHER_KIND else fault


def _fits(
    codec: FrameFunctions, frames: Catalogue, data: bytes, names: list[str], context: Context | None
) -> tuple[list[Fit], list[tuple[str, FrameError]]]:
    """Return every frame that the bytes fit or that is refused for them, and the faults of the other frames."""
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
    return fits, faults


def nearest(faults: list[tuple[str, FrameError]]) -> tuple[str, FrameError] | None:
    """Return the closest frame with its fault, or None for no faults.

    A frame with only its check code wrong is closest, then the frame with the largest offset of its fault.
    """

    def fitness(fault: tuple[str, FrameError]) -> tuple[bool, int]:
        error = fault[1]
        other = error.also if error.cause == "check" else error
        return (True, error.offset) if other is None else (False, other.offset)

    return max(faults, key=fitness, default=None)


MOST_APART = 2
"""Bytes by which a frame may be too short or too long so that a reading by it is still likely."""


def is_nearly_whole(fault: FrameError) -> bool:
    """Return whether the length alone is wrong, by few bytes: a count disagrees with the bytes that it counts."""
    numbers = [int(text) for part in (fault.expected, fault.found) for text in part.split() if text.isdecimal()]
    if fault.cause == "short" and len(numbers) == 2:
        return numbers[1] > 0 and numbers[0] - numbers[1] <= MOST_APART
    return fault.cause == "surplus" and bool(numbers) and numbers[-1] <= MOST_APART


def other_sides(
    codec: FrameFunctions, frames: Catalogue, data: bytes, fits: list[Fit], context: Context | None = None
) -> Iterator[tuple[str, FrameError]]:
    """Yield the frames of the other side with their faults, if they would fit but for a count within.

    `fits`: the frames that fit.
    """
    sides = {frames[fit.frame].side for fit in fits}
    if len(sides) != 1 or not sides <= {"client", "server"}:
        return
    for name in of_side(frames):
        if frames[name].side == "both" or frames[name].side in sides:
            continue
        try:
            codec.decode(name, data, context)
        except FrameError:
            continue
        fault = codec.fault_inside(name, data, context)
        if fault is not None and is_nearly_whole(fault):
            yield name, fault


def reason(
    codec: FrameFunctions, faults: list[tuple[str, FrameError]], data: bytes, context: Context | None = None
) -> str:
    """Return why the bytes are no frame: the fault of the closest frame, and a wrong length within."""
    if not data:
        return "there are no bytes to decode"
    best = nearest(faults)
    if best is None:
        return "this protocol has no frames that could be tried"
    other = best[1].also
    if other is None and best[1].cause == "check":
        inside = codec.fault_inside(best[0], data, context)
        other = inside if inside is not None and is_nearly_whole(inside) else None
    also = f"; also {other}" if other is not None else ""
    return f"no frame fits; nearest is '{best[0]}': {best[1]}{also}"


def _holds_unknown(fields: Mapping[str, Any]) -> bool:
    """Return whether an inner frame at any depth is unknown to the protocol."""
    return any(isinstance(value, dict) and ("unknown" in value or _holds_unknown(value)) for value in fields.values())


def _holds_refused(fields: Mapping[str, Any], frames: Catalogue) -> bool:
    """Return whether an inner frame at any depth is a frame that its definition refuses."""
    for value in fields.values():
        if isinstance(value, dict):
            inside = frames.get(next(iter(value))) if len(value) == 1 else None
            if (inside is not None and inside.inner and inside.refuse is not None) or _holds_refused(value, frames):
                return True
    return False

"""A protocol's frames from Python: bytes from fields, fields from bytes. No port is involved."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from framekit.api.errors import RequestError
from framekit.api.settings import ProtocolGiven, checked_params, checked_station, protocol_of
from framekit.api.values import Frame
from framekit.codec.codec import compile_protocol
from framekit.codec.columns import Batch, Cut
from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.functions import candidates, likely, nearest, reason
from framekit.definition.model import protocol as model
from framekit.definition.problems import did_you_mean, no_such, plural
from framekit.link.scope import Scope
from framekit.link.values import Names

if TYPE_CHECKING:
    from framekit.codec.codec import Builders
    from framekit.codec.construct import CompiledFrame


_MOST_NAMES = 8
"""Largest number of frames listed in the message about an unknown name."""


class Protocol:
    """A compiled definition, made by `framekit.load`. `name` and `about` are the file's."""

    def __init__(self, definition: model.Protocol, params: Mapping[str, Any] | None = None, own: Any = None) -> None:
        self._definition = definition
        self.name = definition.name
        self.about = definition.about
        self._codec = compile_protocol(definition)
        own = None if own is None else checked_station(definition, own)
        self._scope = Scope(definition, params=checked_params(definition, params or {}), own=own)

    @cached_property
    def _builders(self) -> Builders:
        from framekit.codec.codec import Builders

        return Builders(self._codec, self._scope)

    @property
    def definition(self) -> model.Protocol:
        """Return the whole model of the definition."""
        return self._definition

    @property
    def frames(self) -> tuple[str, ...]:
        """Return the names of the frames that occur on the line, in the order of the definition."""
        return tuple(frame.name for frame in self.definition.frames.values() if not frame.inner)

    @property
    def services(self) -> tuple[str, ...]:
        """Return the names of the services, `read` and `write` among them."""
        return tuple(self.definition.services)

    def encode(self, frame: str, /, **fields: Any) -> bytes:
        """Return the bytes of a frame. Raises EncodeError (a ValueError) for impossible fields, RequestError."""
        self._known(frame, self.definition.frames)
        return self._codec.encode(frame, fields, self._scope)

    def builder(self, frame: str, /, *inside: str) -> Callable[..., bytes]:
        """Return a function that builds a frame from single values: `build(station=17, values=[1, 2])`.

        `inside`: the name of the inner frame, of the frame inside that, and so on. The function has a keyword for every
        given value; lengths, counts, checks and constants are computed, and values with a default may be omitted. Its
        signature and docstring describe the arguments. It returns the bytes of `encode`, and raises its errors. Keep
        the function: making it takes longer than calling it. Raises RequestError for an impossible inner frame.
        """
        self._known(frame, self.definition.frames)
        for outer, name in pairwise((frame, *inside)):
            _named(name)
            frames = self._builders.inside(outer)
            if name not in frames:
                some = ", ".join([*frames[:_MOST_NAMES], *["…"][: len(frames) > _MOST_NAMES]])
                hint = did_you_mean(name, frames) or (f"give one of {some}" if frames else "leave it out")
                raise RequestError(f"no frame '{name}' can stand in '{outer}' – {hint}")
        return self._builders.builder(frame, *inside)

    def construct(self, frame: str) -> CompiledFrame:
        """Return a frame as an object of the construct library: bare in `Struct`, `Array`, `GreedyRange`, or nested.

        It parses a frame at the position of the stream, builds from a mapping, and has a size if that is fixed.
        Parameters are keywords of `parse` and `build`. Its errors are both FrameError or EncodeError and
        `construct.ConstructError`. Raises RequestError for an unknown frame.
        """
        from framekit.codec.construct import CompiledFrame

        self._known(frame, self.definition.frames)
        return CompiledFrame(
            self._codec,
            self.definition.frames,
            frame,
            lambda given: Names(given, self._scope) if given else self._scope,
        )

    def decode(self, data: bytes, frame: str | None = None, *, sender: str | None = None) -> Frame:
        """Decode bytes that are exactly one frame. `frame`: only this frame, or the frames of this group.

        `sender`: `client` or `server`, if both send similar frames. Raises FrameError (a ValueError) with the fault of
        the frame that fits best.
        """
        fits, faults = self._fitting(data, frame, sender)
        if fits:
            return fits[0]
        best = nearest(faults)
        if best is None or not data:
            raise FrameError("short", frame or "frame", 0, "bytes", "none")
        fault = best[1]
        raise FrameError(
            fault.cause, f"{best[0]}, {fault.segment}", fault.offset, fault.expected, fault.found, fault.refuse,
            fault.fields,
        ) from None  # fmt: skip

    def decode_all(self, data: bytes, frame: str | None = None, *, sender: str | None = None) -> list[Frame]:
        """Return every frame that the bytes may be; an empty list if they are none."""
        return self._fitting(data, frame, sender)[0]

    def decode_many(self, frames: Sequence[bytes], frame: str) -> Batch:
        """Decode many frames called `frame`, into columns if NumPy is installed; the values are those of `decode`.

        A bad frame raises no error: `Batch.faults` has all faults. Raises RequestError for an unknown frame.
        """
        return self._decode_cut(Cut.of(frames), frame)

    def decode_capture(self, path: str | Path, frame: str, direction: Literal["in", "out"] = "in") -> Batch:
        """Decode a capture in which every record of `direction` is one frame, as `decode_many` does.

        Raises CaptureError (a ValueError), RequestError.
        """
        from framekit.service.capture import cut_of_capture

        return self._decode_cut(cut_of_capture(Path(path), direction), frame)

    def _decode_cut(self, cut: Cut, frame: str) -> Batch:
        from framekit.table_of_extras import OPTIONS, load

        self._known(frame, self.definition.frames)
        batch: Batch = load(OPTIONS["decode_many"])(self._codec, frame, self._scope).decode(cut)
        return batch

    def why_not(self, data: bytes) -> str:
        """Return the reason why bytes are no frame, in words; '' if they are one."""
        fits, faults = self._fitting(data, None, None)
        return "" if fits else reason(self._codec, faults, data, self._scope)

    def _fitting(
        self, data: bytes, frame: str | None, sender: str | None
    ) -> tuple[list[Frame], list[tuple[str, FrameError]]]:
        if frame is not None:
            self._known(frame, [*self.definition.frames, *self.definition.groups])
        if not isinstance(data, (bytes, bytearray, memoryview)):
            raise RequestError(f"a frame is bytes, such as bytes.fromhex('02 57'), not {data!r}")
        if sender not in (None, "client", "server"):
            raise RequestError(f"'{sender}' is neither client nor server")
        frames, bytes_ = self.definition.frames, bytes(data)
        found, faults = likely(self._codec, frames, bytes_, candidates(self.definition, frame, sender), self._scope)
        return [Frame(fit.frame, fit.fields, bytes_, fit.refusal) for fit in found], faults

    def _known(self, frame: str, known: Any) -> None:
        _named(frame)
        if frame not in known:
            raise RequestError(no_such(f"'{self.name}' has no frame", frame, known))

    def __repr__(self) -> str:
        return f"<protocol {self.name}, {plural(len(self.frames), 'frame')}>"


def _named(frame: object) -> None:
    if not isinstance(frame, str):
        raise RequestError(f"{frame!r} names no frame – give a text")


def load(protocol: ProtocolGiven, *, params: Mapping[str, Any] | None = None, own: Any = None) -> Protocol:
    """Load a shipped protocol by its name, one in the current folder, or a YAML file.

    `params` and `own` (the own station) are for frames whose bytes depend on them. Raises DefinitionError with every
    problem of the file, RequestError for parameters that do not fit.
    """
    return Protocol(protocol_of(protocol), params, own)


__all__ = ["EncodeError", "FrameError", "Protocol", "load"]

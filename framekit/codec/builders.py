"""Builders of a protocol's frames: functions with a keyword for every value, made when they are first asked for.

Which frames may stand in which is known here; how a builder is written, and what the context holds, is not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_type_hints

from framekit.codec.codec import Codec
from framekit.codec.errors import EncodeError
from framekit.codec.functions import Context
from framekit.codec.python.generate import ENCODER, BuilderModules
from framekit.codec.python.parameters import inner_frames

Build = Callable[..., bytes]


class Builders:
    """The builders of one protocol, for frames that depend on nothing but one context."""

    def __init__(self, codec: Codec, context: Context) -> None:
        self._codec = codec
        self._context = context
        self._modules = BuilderModules(codec.protocol)
        self._made: dict[tuple[str, ...], Build] = {}

    def inside(self, frame: str) -> tuple[str, ...]:
        """The frames that may stand in a frame."""
        return tuple(inner_frames(self._codec.protocol.frames[frame]))

    def builder(self, *frames: str) -> Build:
        """The function that builds the first of the frames with each of the others inside the one before it.

        Raises KeyError where one cannot stand there.
        """
        if frames not in self._made:
            self._made[frames] = self._make(frames)
        return self._made[frames]

    def _make(self, frames: tuple[str, ...]) -> Build:
        name, source = self._modules.source(frames)
        encoder = self._codec.encoders[frames[0]]
        names: dict[str, Any] = {"ctx": self._context, "EncodeError": EncodeError, ENCODER: encoder}
        names["__name__"] = f"framekit_builders_{self._codec.protocol.name}"
        exec(compile(source, f"<builder of {' with '.join(frames)}>", "exec"), names)
        found: Build = names[name]
        found.__annotations__ = get_type_hints(found, names)
        return found

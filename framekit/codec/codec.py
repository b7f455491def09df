"""Compile protocols: their frames as functions by name, and builders on demand.

The source that `framekit.codec.python` generates runs in a module of its own. The number of cached codecs equals that
of cached definitions. The compiler is imported only on a cache miss, as most commands find compiled code in the cache.
"""

from __future__ import annotations

from collections.abc import Callable
from types import CodeType, ModuleType
from typing import Any, get_type_hints

from framekit.codec.errors import EncodeError
from framekit.codec.functions import Context, Decode, Encode, FrameFunctions, Span, module_of, run_in
from framekit.definition.load.protocol import MOST_KEPT
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import DefinitionError, Problem
from framekit.definition.sources import current_cache

__all__ = ["Codec", "Context", "Decode", "Encode", "Span", "code_of", "codec_from", "compile_protocol"]


class Codec(FrameFunctions):
    """Hold the functions of every frame of a protocol."""

    def __init__(self, protocol: Protocol, module: ModuleType) -> None:
        super().__init__(module)
        self.protocol = protocol


_compiled: dict[int, Codec] = {}
"""Codecs by the identity of their protocol, which the codec keeps alive; the most recently used is last."""


def compile_protocol(protocol: Protocol) -> Codec:
    """Return the codec of a protocol, compiled once while it is in use. Raises DefinitionError."""
    known = _compiled.get(id(protocol))
    if known is None:
        cache = current_cache()
        if cache is None:
            return codec_from(protocol, code_of(protocol))
        return _keep(Codec(protocol, cache.module(protocol)))
    return _keep(known)


def code_of(protocol: Protocol) -> CodeType:
    """Return the code object of a protocol's frames. Raises DefinitionError."""
    from framekit.codec.python.generate import generate_source

    try:
        return compile(generate_source(protocol, standalone=False), f"<frames of {protocol.name}>", "exec")
    except SyntaxError as error:
        if not error.msg.startswith("too many"):  # limits of Python, for example 20 nested blocks
            raise
        at = next(iter(protocol.frames.values())).at
        what = f"parts of a frame stand too deeply inside each other ({error.msg})"
        raise DefinitionError([Problem(at, what, "take some of them out")]) from None


def codec_from(protocol: Protocol, code: CodeType) -> Codec:
    """Return the codec of a protocol from compiled code; `compile_protocol` returns the same codec from now on."""
    return _keep(Codec(protocol, module_of(protocol.name, code)))


def _keep(codec: Codec) -> Codec:
    """Put a codec at the end of the cache and drop the oldest codecs beyond the limit."""
    _compiled.pop(id(codec.protocol), None)
    _compiled[id(codec.protocol)] = codec
    while len(_compiled) > MOST_KEPT:
        _compiled.pop(next(iter(_compiled)), None)
    return codec


# ---- builders ------------------------------------------------------------------------------------------------

Build = Callable[..., bytes]


class Builders:
    """Provide the builders of a protocol, with a keyword for every value, for one fixed context."""

    def __init__(self, codec: Codec, context: Context) -> None:
        from framekit.codec.python.generate import BuilderModules

        self._codec = codec
        self._context = context
        self._modules = BuilderModules(codec.protocol)
        self._made: dict[tuple[str, ...], Build] = {}

    def inside(self, frame: str) -> tuple[str, ...]:
        """Return the names of the frames that a frame may contain."""
        from framekit.codec.python.flat import inner_frames

        return tuple(inner_frames(self._codec.protocol.frames[frame]))

    def builder(self, *frames: str) -> Build:
        """Return the function that builds the first frame, with each further frame inside the previous frame.

        Raises KeyError if a frame cannot be inside the previous frame.
        """
        if frames not in self._made:
            self._made[frames] = self._make(frames)
        return self._made[frames]

    def _make(self, frames: tuple[str, ...]) -> Build:
        from framekit.codec.python.generate import ENCODER

        name, source = self._modules.source(frames)
        encoder = self._codec.encoders[frames[0]]
        module = ModuleType(f"framekit_builders_{self._codec.protocol.name}")
        names: dict[str, Any] = vars(module)
        names |= {"ctx": self._context, "EncodeError": EncodeError, ENCODER: encoder}
        run_in(module, compile(source, f"<builder of {' with '.join(frames)}>", "exec"))
        found: Build = names[name]
        found.__annotations__ = get_type_hints(found, names)
        return found

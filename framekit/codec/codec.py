"""A protocol compiled once: its frames as functions, behind names, and their builders, made when they are asked for.

The source that `framekit.codec.python` writes is run in a module of its own. As many codecs are kept as loaded
definitions. The compiler is imported when something is to be compiled: most commands find that in the cache.
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
    """The functions of every frame of a protocol."""

    def __init__(self, protocol: Protocol, module: ModuleType) -> None:
        super().__init__(module)
        self.protocol = protocol


_compiled: dict[int, Codec] = {}
"""By the identity of the protocol, which a codec keeps alive; the one asked for last stands last."""


def compile_protocol(protocol: Protocol) -> Codec:
    """The codec of a protocol; the same protocol is compiled once while it is among those in use. Raises
    DefinitionError."""
    known = _compiled.get(id(protocol))
    if known is None:
        cache = current_cache()
        if cache is None:
            return codec_from(protocol, code_of(protocol))
        return _keep(Codec(protocol, cache.module(protocol)))
    return _keep(known)


def code_of(protocol: Protocol) -> CodeType:
    """The compiled module of a protocol's frames. Raises DefinitionError."""
    from framekit.codec.python.generate import generate_source

    try:
        return compile(generate_source(protocol, standalone=False), f"<frames of {protocol.name}>", "exec")
    except SyntaxError as error:
        if not error.msg.startswith("too many"):  # Python's own limits; 20 blocks inside each other is one of them
            raise
        at = next(iter(protocol.frames.values())).at
        what = f"parts of a frame stand too deeply inside each other ({error.msg})"
        raise DefinitionError([Problem(at, what, "take some of them out")]) from None


def codec_from(protocol: Protocol, code: CodeType) -> Codec:
    """The codec of a protocol whose module has been compiled before; `compile_protocol` gives the same from now on."""
    return _keep(Codec(protocol, module_of(protocol.name, code)))


def _keep(codec: Codec) -> Codec:
    """Keeps as many codecs as definitions are kept; another one lives as long as it is in use."""
    _compiled.pop(id(codec.protocol), None)
    _compiled[id(codec.protocol)] = codec
    while len(_compiled) > MOST_KEPT:
        _compiled.pop(next(iter(_compiled)), None)
    return codec


# ---- builders ------------------------------------------------------------------------------------------------

Build = Callable[..., bytes]


class Builders:
    """The builders of one protocol, a keyword for every value, for frames that depend on nothing but one context."""

    def __init__(self, codec: Codec, context: Context) -> None:
        from framekit.codec.python.generate import BuilderModules

        self._codec = codec
        self._context = context
        self._modules = BuilderModules(codec.protocol)
        self._made: dict[tuple[str, ...], Build] = {}

    def inside(self, frame: str) -> tuple[str, ...]:
        """The frames that may stand in a frame."""
        from framekit.codec.python.flat import inner_frames

        return tuple(inner_frames(self._codec.protocol.frames[frame]))

    def builder(self, *frames: str) -> Build:
        """The function that builds the first of the frames with each of the others inside the one before it.

        Raises KeyError where one cannot stand there.
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

"""A protocol compiled once: its frames as functions, behind names.

The source that `framekit.codec.python` writes is run in a module of its own. As many codecs are kept as loaded
definitions. Which link uses it, and what a context holds, is not known here.
"""

from __future__ import annotations

from types import CodeType, ModuleType

from framekit.codec.functions import Context, Decode, Encode, FrameFunctions, Span, module_of
from framekit.definition.load.protocol import MOST_KEPT
from framekit.definition.model.protocol import Protocol
from framekit.definition.sources import current_keeper

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
        keeper = current_keeper()
        if keeper is None:
            return codec_from(protocol, code_of(protocol))
        return _keep(Codec(protocol, keeper.module(protocol)))
    return _keep(known)


def code_of(protocol: Protocol) -> CodeType:
    """The compiled module of a protocol's frames. Raises DefinitionError."""
    from framekit.codec.python.generate import generate_source

    return compile(generate_source(protocol, standalone=False), f"<frames of {protocol.name}>", "exec")


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

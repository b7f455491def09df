"""Small protocols for tests of single segments: the frame `f` with the given YAML body, and further sections."""

from __future__ import annotations

from construct_oracle import ConstructCodec, compile_construct

from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.model.protocol import Protocol


def small_protocol(body: str, *sections: str, keys: str = "", order: str = "big") -> Protocol:
    """Return a protocol with the frame `f`: its body, further keys of the frame, and whole sections of the file."""
    lines = ["protocol: small", f"order: {order}", *sections]
    if not any("frames:" in section for section in sections):
        lines.append("frames:")
    separator = ", " if keys else ""
    lines.append(f"  f: {{{keys}{separator}body: {body}}}")
    return load_protocol_text("\n".join(lines), "small")


def small_codec(body: str, *sections: str, keys: str = "", order: str = "big") -> ConstructCodec:
    """Return the construct codec of a small protocol."""
    return compile_construct(small_protocol(body, *sections, keys=keys, order=order))

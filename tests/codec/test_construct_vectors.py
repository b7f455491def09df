"""The frame cases of the shipped vectors with the construct codec alone: an independent reading of the manuals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from construct_oracle import ConstructCodec, compile_construct
from shipped import vectors_of
from spread import spread
from strategies import base_context

from framekit.codec.errors import FrameError
from framekit.codec.plain import PlainValues
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.sources import shipped_definitions
from framekit.definition.vectors import FrameVector

VECTORS = shipped_definitions("*.vectors.yaml")


@pytest.mark.parametrize("name", spread((path.name.removesuffix(".vectors.yaml") for path in VECTORS), 4))
def test_frames_of_vectors(name: str) -> None:
    protocol = load_protocol(name)
    codec = compile_construct(protocol)
    vectors = vectors_of(name)
    assert vectors.frames or vectors.conversations
    for vector in vectors.frames:
        if vector.frame is not None:
            holds(vector, protocol, codec)


def holds(vector: FrameVector, protocol: Protocol, codec: ConstructCodec) -> None:
    """Assert that the values of a test case encode to its bytes, and that these decode to the values or are refused."""
    assert vector.frame is not None
    context = base_context(protocol) | plain_values(protocol, vector)
    if vector.expect is not None:
        data = vector.wire.exact
        assert data is not None
        with pytest.raises(FrameError) as caught:
            codec.decode(vector.frame, data, context)
        kind, wanted = vector.expect
        assert (caught.value.refuse if kind == "refused" else caught.value.cause) == wanted or kind == "noise", (
            vector.at
        )
        return
    values = PlainValues(protocol).from_plain(vector.frame, vector.values or {})
    built = codec.encode(vector.frame, values, context)
    assert vector.wire.matches(built), f"{vector.at}: {built.hex(' ')} is not {vector.wire}"
    for data in filter(None, (vector.wire.exact, built)):
        assert has(codec.decode(vector.frame, data, context), values), vector.at


def plain_values(protocol: Protocol, vector: FrameVector) -> dict[str, Any]:
    """Return the parameters, the state and the request of a case."""
    found: dict[str, Any] = {}
    for name, value in {**vector.params, **vector.state}.items():
        kind = protocol.params[name].type if name in protocol.params else ""
        if kind in ("flag", "choice"):
            found[name] = value == "yes" if kind == "flag" else value
            continue
        found[name] = int(value, 0) if isinstance(value, str) and value[:1].isdigit() else value
    if vector.request:
        ((frame, fields),) = vector.request.items()
        found["request"] = PlainValues(protocol).from_plain(frame, fields)
    return found


def has(found: Any, wanted: Any) -> bool:
    """Return whether the decoded value contains all given values; a name may stand for its number."""
    if isinstance(wanted, Mapping):
        return all(name in found and has(found[name], value) for name, value in wanted.items())
    if isinstance(wanted, list):
        return len(found) == len(wanted) and all(map(has, found, wanted))
    return bool(found == wanted) or (isinstance(wanted, str) and isinstance(found, int))

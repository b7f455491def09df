"""The two compilers compared: every frame of every shipped definition, encoded and decoded, whole and damaged.

Both must encode the same values to the same bytes, decode the same bytes to the same values, and find the same fault
with the same refusal in damaged bytes. Damaged bytes are first cut to one frame, as a receiver does.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cache
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st
from segment_cases import CASES, Case
from shipped import APPLICATIONS, PROTOCOLS
from spread import spread
from strategies import FrameValues

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.protocol import Protocol

EXAMPLES = settings(
    max_examples=int(os.environ.get("FRAMEKIT_EXAMPLES", "3")),
    deadline=None,
    database=None,
    derandomize=True,
    phases=[Phase.generate, Phase.shrink],
    suppress_health_check=[*HealthCheck],
)
"""A few examples of every frame by default; with FRAMEKIT_EXAMPLES=200 the comparison takes minutes."""


class Pair:
    """A protocol compiled by both compilers."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.made = FrameValues(self.protocol)
        self.reference = self.made.codec
        self.compiled = compile_protocol(self.protocol)

    def build(self, frame: str, values: dict[str, Any], context: dict[str, Any]) -> tuple[Any, Any]:
        return (
            built(lambda: self.reference.encode(frame, values, context)),
            built(lambda: self.compiled.frames[frame].encode(values, context)),
        )

    def read(self, frame: str, data: bytes, context: dict[str, Any]) -> tuple[Any, Any]:
        return (
            read(lambda: self.reference.decode(frame, data, context)),
            read(lambda: self.compiled.frames[frame].decode(data, context)),
        )

    def cut(self, frame: str, data: bytes, context: dict[str, Any]) -> bytes | None:
        """Return the bytes of the first frame, or None if its end cannot be found."""
        size = self.compiled.frames[frame].measure(data, 0, len(data), context)
        return data[:size] if size > 0 else None


def built(encode: Any) -> Any:
    try:
        return encode()
    except EncodeError:
        return EncodeError


def read(decode: Any) -> Any:
    try:
        return decode()
    except FrameError as error:
        return error.cause, error.refuse, error.offset, error.fields


@pytest.mark.parametrize("name", spread([*PROTOCOLS, *APPLICATIONS], 8, 3))
def test_both_compilers_agree(name: str) -> None:
    """Compare every frame; the frames of an application are compared there, not again in its protocols."""
    both = Pair(load_protocol(name))
    assert both.protocol.frames or name == "standard"
    for frame in both.protocol.frames.values():
        if not frame.inner or name in APPLICATIONS:
            agree(both, frame.name)


@pytest.mark.parametrize("case", spread(CASES, 4), ids=lambda case: case.title)
def test_both_compilers_agree_on_every_kind_of_segment(case: Case) -> None:
    if case.top:
        agree(Pair(load_protocol_text(case.yaml)), "f")
    else:
        agree(gathered(), f"f{CASES.index(case)}")


@cache
def gathered() -> Pair:
    """Gather the cases without further sections in one protocol, since compiling takes longer than comparing."""
    frames = [
        case.yaml.partition("frames:\n")[2].replace("  f:", f"  f{place}:", 1)
        for place, case in enumerate(CASES)
        if not case.top
    ]
    return Pair(load_protocol_text("protocol: cases\nframes:\n" + "".join(frames)))


def agree(both: Pair, frame: str) -> None:
    """Compare on drawn values, damaged bytes and wrong values."""

    @EXAMPLES
    @given(both.made.frame(frame), st.data())
    def compare(made: tuple[dict[str, Any], dict[str, Any]], more: st.DataObject) -> None:
        values, context = made
        data = same_bytes_and_values(both, frame, values, context)
        same_fault(both, frame, more.draw(damage(data), label="damaged"), context)
        reference, compiled = both.build(frame, more.draw(spoil(values), label="spoilt"), context)
        assert compiled == reference

    compare()


def same_bytes_and_values(both: Pair, frame: str, values: dict[str, Any], context: dict[str, Any]) -> bytes:
    """Assert that valid values encode to the same bytes, and that these decode to the values."""
    reference, compiled = both.build(frame, values, context)
    assert compiled == reference
    assume(isinstance(reference, bytes))
    one, other = both.read(frame, reference, context)
    assert other == one
    if isinstance(one, dict) and same_frames(one, values):
        assert has(one, values)
        assert both.build(frame, one, context) == (reference, reference)
    return reference


def same_fault(both: Pair, frame: str, damaged: bytes, context: dict[str, Any]) -> None:
    """Assert that bytes decode alike or have the same fault; if no frame ends in them, both must find some fault."""
    one_frame = both.cut(frame, damaged, context)
    one, other = both.read(frame, damaged if one_frame is None else one_frame, context)
    if one_frame is None:
        assert isinstance(one, tuple) == isinstance(other, tuple)
    else:
        assert other == one or repr(other) == repr(one)  # NaN does not equal itself


# ---- damage -------------------------------------------------------------------------------------------------


@st.composite
def damage(draw: Any, data: bytes) -> bytes:
    """Draw the bytes with one to three bytes changed, removed or inserted."""
    changed = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, max(len(changed) - 1, 0)))
        kind = draw(st.sampled_from(("flip", "set", "set", "leave out", "put in", "cut", "append")))
        if kind == "append":
            changed += draw(st.binary(min_size=1, max_size=3))
        elif kind == "put in":
            changed.insert(place, draw(st.integers(0, 255)))
        elif kind == "cut":
            del changed[place:]
        elif changed:
            _change(draw, changed, place, kind)
    return bytes(changed)


def _change(draw: Any, data: bytearray, place: int, kind: str) -> None:
    if kind == "flip":
        data[place] ^= 1 << draw(st.integers(0, 7))
    elif kind == "set":
        data[place] = draw(st.integers(0, 255) | st.sampled_from(list(b"0123456789ABCDEF%\x00\xff\x10\x03\x04\x17")))
    else:
        del data[place]


@st.composite
def spoil(draw: Any, values: dict[str, Any]) -> dict[str, Any]:
    """Draw the values with one value removed, added or replaced, at any depth."""
    return _spoilt(draw, values)


STRANGE = st.one_of(st.integers(-5, 300), st.just(1 << 40), st.text(max_size=3), st.binary(max_size=3))


def _spoilt(draw: Any, values: dict[str, Any]) -> dict[str, Any]:
    result = dict(values)
    if not result or draw(st.integers(0, 9)) == 0:
        return result | {"no_such_field": 1}
    name = draw(st.sampled_from(sorted(result)))
    value = result[name]
    if isinstance(value, dict) and value and draw(st.booleans()):
        result[name] = _spoilt(draw, value)
    elif isinstance(value, list) and value and isinstance(value[0], dict) and draw(st.booleans()):
        result[name] = [_spoilt(draw, value[0]), *value[1:]]
    elif draw(st.booleans()):
        del result[name]
    else:
        result[name] = draw(STRANGE)
    return result


# ---- comparing ----------------------------------------------------------------------------------------------


def has(found: Any, wanted: Any) -> bool:
    """Return whether the decoded value contains all given values.

    A name may stand for its number, and bytes may be padded.
    """
    if isinstance(wanted, Mapping):
        return all(name in found and has(found[name], value) for name, value in wanted.items())
    if isinstance(wanted, list):
        return len(found) == len(wanted) and all(map(has, found, wanted))
    if isinstance(wanted, bytes):
        return isinstance(found, bytes) and found.startswith(wanted)
    return bool(found == wanted) or (isinstance(wanted, str) and isinstance(found, int))


def same_frames(found: Any, wanted: Any) -> bool:
    """Return whether inner frames were decoded as the same frames; some bytes also fit an earlier candidate."""
    if isinstance(wanted, Mapping):
        common = [name for name in wanted if name in found]
        single = len(wanted) == 1 and not common and isinstance(next(iter(wanted.values())), Mapping)
        return not single and all(same_frames(found[name], wanted[name]) for name in common)
    if isinstance(wanted, list) and isinstance(found, list):
        return all(map(same_frames, found, wanted))
    return True

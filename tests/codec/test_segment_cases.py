"""Every kind of segment, encoded and decoded by both compilers."""

from __future__ import annotations

from typing import Any

import pytest
from construct_oracle import compile_construct
from segment_cases import CASES, Case
from spread import spread

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol_text

COMPILERS = {"python": compile_protocol, "construct": compile_construct}


def codec(case: Case, compiler: str) -> Any:
    return COMPILERS[compiler](load_protocol_text(case.yaml))


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_both_ways(case: Case, compiler: str) -> None:
    tested = codec(case, compiler)
    assert tested.encode("f", case.values).hex(" ").upper() == case.data
    read = tested.decode("f", case.bytes)
    assert read == {**case.values, **case.more}
    assert tested.encode("f", read) == case.bytes


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("case", [case for case in CASES if case.bad], ids=lambda case: case.title)
def test_bytes_that_are_not_the_frame(case: Case, compiler: str) -> None:
    tested = codec(case, compiler)
    for data, cause in case.bad.items():
        with pytest.raises(FrameError) as caught:
            tested.decode("f", bytes.fromhex(data))
        assert caught.value.cause == cause, data


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("case", spread(CASES, 4), ids=lambda case: case.title)
def test_unknown_and_missing_values_are_refused_by_name(case: Case, compiler: str) -> None:
    tested = codec(case, compiler)
    with pytest.raises(EncodeError, match="nobody"):
        tested.encode("f", {**case.values, "nobody": 1})
    if len(case.values) == 1 and not case.more and not isinstance(next(iter(case.values.values())), dict):
        (name,) = case.values
        with pytest.raises(EncodeError, match=name):
            tested.encode("f", {})


@pytest.mark.parametrize("case", spread(CASES, 4, 2), ids=lambda case: case.title)
def test_a_frame_is_measured_however_it_comes(case: Case) -> None:
    """The frame is complete at its end; shorter data need more bytes or end by silence."""
    tested = codec(case, "python")
    data = case.bytes
    whole = tested.measure("f", data + b"\x00\x00", 0, len(data) + 2)
    only_silence = tested.measure("f", data, 0, len(data)) == tested.QUIET
    assert only_silence or whole == len(data)
    for end in range(1, len(data)):
        found = tested.measure("f", data[:end], 0, end)
        assert found < 0, "no frame is complete before its end"
        if not only_silence:
            assert end - found <= len(data), "nor does it ask for bytes beyond it"

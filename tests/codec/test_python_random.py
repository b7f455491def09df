"""Random definitions: encoded frames decode to their values, `trace` agrees, and every prefix is measured."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from construct_oracle import compile_construct
from random_bodies import RandomBody
from small_protocol import small_protocol

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import EncodeError, FrameError

SEEDS = range(50)


def read(codec: Any, data: bytes) -> Any:
    try:
        return codec.decode("f", data)
    except FrameError as error:
        return error.cause, error.refuse


def check_reading(codec: Codec, data: bytes) -> None:
    """Assert that `decode` and `trace` give the same result."""
    quick, (fields, _, fault) = read(codec, data), codec.trace("f", data)
    assert quick == (fields if fault is None else (fault.cause, fault.refuse)), data.hex(" ")


def check_measuring(codec: Codec, data: bytes) -> None:
    """Assert that every prefix is measured right.

    Like in a receiver, `measure` gets the length that earlier calls have already seen.
    """
    whole = codec.measure("f", data)
    if whole != len(data):
        return  # ends by silence, or its data contain an end mark
    seen = wanted = 0
    for have in range(len(data)):
        if have >= wanted:
            found = codec.measure("f", data, 0, have, None, seen)
            assert codec.QUIET < found < 0
            assert found == codec.measure("f", data, 0, have)
            assert have - found <= len(data)
            seen, wanted = have, have - found
    assert codec.measure("f", data + b"\x10\x03\x00") == len(data)


def damaged(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(random.choice([1, 1, 2])):
        place = random.randrange(len(changed) + 1)
        if place < len(changed) and random.random() < 0.7:
            changed[place] = random.randrange(256)
        elif place < len(changed) and random.random() < 0.5:
            del changed[place]
        else:
            changed.insert(place, random.choice([0x10, 0x03, 0x30, 0x00]))
    return bytes(changed)


@pytest.mark.parametrize("seed", SEEDS)
def test_random_definitions(seed: int) -> None:
    body = RandomBody(seed)
    protocol = small_protocol(body.text, *body.sections)
    codec, reference = compile_protocol(protocol), compile_construct(protocol)
    try:
        data = codec.encode("f", body.values)
    except EncodeError:  # a computed number that its field cannot hold
        with pytest.raises(EncodeError):
            reference.encode("f", body.values)
        return
    assert data == reference.encode("f", body.values)
    fields = codec.decode("f", data)
    assert fields == reference.decode("f", data)
    assert codec.encode("f", fields) == data
    check_reading(codec, data)
    check_measuring(codec, data)
    random = Random(seed)
    for _ in range(6):
        check_reading(codec, damaged(data, random))

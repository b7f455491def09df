"""Possible bytes of bit fields with fixed parts: computed byte by byte, and compared with all numbers of the field."""

from __future__ import annotations

from itertools import pairwise
from random import Random

import pytest

from framekit.codec.python.choices import fixed_bytes
from framekit.definition.load.protocol import load_protocol_text

DEFINITION = """
protocol: bits
groups: {{all: {{head: [{{bits: {{{parts}}}, of: {type}, order: {order}}}]}}}}
frames: {{one: {{group: all, where: {{{where}}}, body: []}}}}
"""


@pytest.mark.parametrize("size", [1, 2])
@pytest.mark.parametrize("order", ["big", "little"])
def test_bytes_are_those_of_all_numbers_that_fit(size: int, order: str) -> None:
    random = Random(size)
    for _ in range(12):
        cuts = sorted({0, 8 * size, *random.sample(range(1, 8 * size), 3)})
        spans = [(low, high - 1) for low, high in pairwise(cuts)]
        fixed = {
            number: sorted(random.sample(range(2 << high - low), min(2 << high - low, random.randint(1, 3))))
            for number, (low, high) in enumerate(spans)
            if random.random() < 0.6
        }
        text = DEFINITION.format(
            parts=", ".join(f"p{n}: {low}" + (f"-{high}" if high > low else "") for n, (low, high) in enumerate(spans)),
            where=", ".join(f"p{n}: {values}" for n, values in fixed.items()),
            type=f"u{8 * size}", order=order,
        )  # fmt: skip
        protocol = load_protocol_text(text)
        fitting = [
            number.to_bytes(size, order)  # type: ignore[arg-type]
            for number in range(1 << 8 * size)
            if all(
                number >> spans[n][0] & (2 << spans[n][1] - spans[n][0]) - 1 in values for n, values in fixed.items()
            )
        ]
        every = {place: {data[place] for data in fitting} for place in range(size)}
        wanted = {place: values for place, values in every.items() if fixed and len(values) <= 128}
        assert dict(fixed_bytes(protocol.frames["one"].segments)) == wanted

"""Definitions drawn at random, and those that once went wrong: what `check` takes never crashes and round-trips."""

from __future__ import annotations

from typing import Any

import pytest
from definition_trial import Trial

FOUND: dict[str, tuple[str, dict[str, Any], str]] = {
    "a value in the range of a check takes no bytes": (
        "[{field: w, type: u8}, {value: a, read: w}, {field: v, type: u8}, {check: sum8, over: w..here}]",
        {"w": 5, "v": 6},
        "05 06 0B",
    ),
    "a record in a case": (
        "[{field: k, type: u8}, {choose: k, cases: {0: [{include: hop, as: d1}]}, else: []}, {const: 7E}]",
        {"k": 0, "d1": {"a": 3}},
        "00 03 7E",
    ),
    "a record in a case that is not taken": (
        "[{field: k, type: u8}, {choose: k, cases: {0: [{include: hop, as: d1}]}, else: []}, {const: 7E}]",
        {"k": 1},
        "01 7E",
    ),
    "a record in an optional part": (
        "[{field: k, type: u8}, {optional: [{include: hop, as: d1}]}, {const: 7E}]",
        {"k": 1, "d1": {"a": 3}},
        "01 03 7E",
    ),
    "a condition on a field of a record": (
        "[{include: hop, as: h}, {field: b, type: u8, when: h.a == 0}, {const: 7E}]",
        {"h": {"a": 0}, "b": 5},
        "00 05 7E",
    ),
    "a condition on a field of a record that is not there": (
        "[{field: k, type: u8}, {include: hop, as: h, when: k}, {field: b, type: u8, when: k and h.a == 0}]",
        {"k": 0},
        "00",
    ),
    "a length of computed size": (
        "[{field: s, type: u8}, {length: n, type: uint, size: s, of: [d]}, {data: d, size: n}]",
        {"s": 2, "d": b"abc"},
        "02 00 03 61 62 63",
    ),
    "bits of computed size": (
        "[{field: s, type: u8}, {bits: {a: 0-3, b: 12}, of: uint, size: s}, {const: 7E}]",
        {"s": 2, "a": 5, "b": 1},
        "02 10 05 7E",
    ),
}
"""By what it shows: a body, values, their bytes."""


def protocol_of(body: str) -> str:
    return f"protocol: found\nlayouts: {{hop: [{{field: a, type: u8}}]}}\nframes: {{f: {{body: {body}}}}}"


@pytest.mark.parametrize("title", FOUND)
def test_definitions_that_once_went_wrong(title: str) -> None:
    body, values, data = FOUND[title]
    assert Trial(protocol_of(body), values).run() == bytes.fromhex(data)

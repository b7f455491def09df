# ruff: noqa: E501 - definitions in YAML
"""`len` of an inner frame: in headers, after it, in items, by both compilers; and in rows of services."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from definition_trial import Trial
from spread import spread

GROUPS = """\
protocol: lengths
groups: {pdu: {}, f: {}}
frames:
  a: {group: pdu, body: [{const: 01}, {field: x, type: u8}]}
  b: {group: pdu, body: [{const: 02}, {length: n, type: u8, of: [d]}, {data: d, size: n}]}
  f: {group: f, body: [%s]}
"""
BODIES = {
    "before it": "{const: 7E}, {field: size, type: u8, is: len(pdu) + 1}, {field: k, type: u8}, {inner: pdu, of: pdu, size: size - 1}",
    "behind it": "{const: 7E}, {inner: pdu, of: pdu}, {field: k, type: u8}, {field: size, type: u16, is: len(pdu) * 2}, {check: sum8}",
    "of fixed size": "{field: k, type: u8}, {inner: pdu, of: [a]}, {field: size, type: u8, is: len(pdu)}",
    "in a wrap": "{const: 7E}, {field: k, type: u8}, {wrap: hex, of: [{inner: pdu, of: pdu}, {field: size, type: u8, is: len(pdu)}]}, {const: 0D}",
    "a condition": "{field: k, type: u8}, {inner: pdu, of: pdu}, {field: size, type: u8, when: len(pdu) > 2, default: 9}",
    "in an item": "{field: k, type: u8}, {repeat: items, times: 2, of: [{field: size, type: u8, is: len(pdu)}, {inner: pdu, of: pdu, size: size}]}",
    "in items beside it": "{field: k, type: u8}, {inner: pdu, of: pdu}, {repeat: items, times: 2, of: [{field: size, type: u8, is: len(pdu)}, {field: y, type: u8}]}",
}


def values_for(body: str, random: Random) -> dict[str, Any]:
    def pdu() -> dict[str, Any]:
        if random.random() < 0.4 or "of: [a]" in body:
            return {"a": {"x": random.randrange(256)}}
        return {"b": {"d": random.randbytes(random.randrange(5))}}

    values: dict[str, Any] = {"k": random.randrange(256)}
    if "repeat" not in body or "pdu}, {repeat" in body:
        values["pdu"] = pdu()
    if "repeat" in body:
        items = [{"y": random.randrange(256)} if "pdu" in values else {"pdu": pdu()} for _ in range(2)]
        values["items"] = items
    if "default: 9" in body and len(values["pdu"].get("b", {"d": b""})["d"]) > 0 and "b" in values["pdu"]:
        values["size"] = random.randrange(256)
    return values


@pytest.mark.parametrize("title", spread(BODIES, 2))
def test_both_compilers_agree(title: str) -> None:
    random, built = Random(title), 0
    for number in range(12):
        values = values_for(BODIES[title], random)
        built += Trial(GROUPS % BODIES[title], values, number).run() is not None
    assert built == 12

# ruff: noqa: E501 - definitions in YAML
"""Texts that end before one of several bytes: both compilers refuse to encode a text that decodes as a longer text."""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest
from construct_oracle import compile_construct
from link.link_world import load

from framekit.codec.codec import Builders, compile_protocol
from framekit.codec.errors import EncodeError
from framekit.definition.problems import DefinitionError

BODIES = {
    "text": "[{field: a, type: ascii, end: [20, 0A]}, {field: b, type: ascii, end: [0A], default: \"''\"}, {const: LF}]",
    "three": "[{field: a, type: ascii, end: [20, 2C]}, {field: b, type: ascii, end: [2C]}, {const: 2C}, {field: c, type: ascii, end: [0A]}, {const: LF}]",
    "number": "[{field: n, type: u8}, {field: a, type: ascii, end: [20, 2C]}, {field: b, type: ascii, size: 2}]",
    "when": "[{field: n, type: u8}, {field: a, type: ascii, end: [20], when: n == 1}, {field: b, type: ascii, size: 1}, {field: c, type: ascii, end: [0A]}, {const: LF}]",
    "record": "[{include: words, as: r}, {field: b, type: ascii, size: 1}, {check: sum8}]",
    "sure": "[{field: a, type: ascii, end: [20, 2C]}, {const: 2C}, {field: b, type: ascii, end: [0A]}, {const: LF}]",
    "header": "[{check: sum8, over: [a, b]}, {field: a, type: ascii, end: [20]}, {field: b, type: ascii, size: 2}]",
    "list": "[{repeat: l, times: 2, of: [{field: a, type: ascii, end: [20, 2C]}, {field: b, type: ascii, size: 1}]}, {const: LF}]",
    "behind": "[{repeat: l, times: 2, separator: 2C, of: [{field: a, type: ascii, end: [20, 2C]}]}, {field: b, type: ascii, size: 1}]",
    "case": "[{field: n, type: u8}, {choose: n, cases: {0: [{field: a, type: ascii, end: [20, 2C]}], 1: [{field: a, type: ascii, end: [2C]}, {const: 2C}]}}, {field: b, type: ascii, size: 1}]",
    "lines": "[{field: a, type: ascii, end: [0D 0A, 0A]}, {field: n, type: u8, default: 13}, {const: LF, when: n == 13}]",
    "pieces": "[{field: a, type: ascii, end: [20 2C, 2C 20, 2C 2C]}, {field: b, type: ascii, size: 2}, {field: c, type: ascii, end: [0A]}, {const: LF}]",
    "pieces of a list": "[{repeat: l, times: 2, of: [{field: a, type: ascii, end: [20 2C, 2C]}, {field: b, type: ascii, size: 2}]}, {const: LF}]",
    "behind a constant": "[{field: a, type: ascii, end: [20 2C, 2C 20]}, {const: 2C 20}, {field: b, type: ascii, end: [0A]}, {const: LF}]",
}  # fmt: skip
TEXTS = ("", "x", "xy", " ", " x", ",", ",y", "x,", "y ")


def values(name: str) -> list[dict[str, Any]]:
    if name == "record":
        return [{"r": {"k": k, "a": a}, "b": b} for k, a, b in product((1,), TEXTS, TEXTS)]
    if name == "list":
        return [
            {"l": [{"a": a, "b": b}, {"a": c, "b": d}]} for a, b, c, d in product(TEXTS[:5], " x", TEXTS[:5], " ,y")
        ]
    if name == "pieces":
        return [{"a": a, "b": b, "c": c} for a, b, c in product(TEXTS, (" ,", ", ", ",,", "x,", ",x"), TEXTS)]
    if name == "lines":
        texts = ("", "x", "x\r", "\r", "\rx", "\n", "x\r\n", "\r\r")
        return [{"a": a, "n": n} for a, n in product(texts, (13, 10, 14))]
    if name == "pieces of a list":
        pairs = (" ,", ", ", ",,", "x,", "  ")
        return [
            {"l": [{"a": a, "b": b}, {"a": c, "b": d}]} for a, b, c, d in product(TEXTS[:5], pairs, TEXTS[:5], pairs)
        ]
    if name == "behind":
        return [{"l": [{"a": "x"}, {"a": a}], "b": b} for a, b in product(TEXTS, TEXTS)]
    names = [letter for letter in "nabc" if f"field: {letter}," in BODIES[name]]
    return [
        {one: value for one, value in zip(names, found, strict=True) if value is not None}
        for found in product(*((0, 1) if name == "n" else (*TEXTS, None) for name in names))
    ]


@pytest.mark.parametrize("name", BODIES)
def test_what_is_built_reads_the_same(name: str) -> None:
    protocol = load(
        f"protocol: p\nlayouts: {{words: [{{field: k, type: u8}}, {{field: a, type: ascii, end: [20, 2C]}}]}}\n"
        f"frames: {{f: {{body: {BODIES[name]}}}}}"
    )
    generated, oracle = compile_protocol(protocol), compile_construct(protocol)
    build: Any = Builders(generated, {}).builder("f")
    built = refused = 0
    for given in values(name):
        try:
            data = generated.encode("f", given)
        except EncodeError:
            refused += 1
            with pytest.raises(EncodeError):
                oracle.encode("f", given)
            with pytest.raises((EncodeError, TypeError)):  # TypeError: a value is missing
                build(**given)
            continue
        built += 1
        assert oracle.encode("f", given) == data == build(**given)
        read = generated.decode("f", data)
        assert {name: read[name] for name in given} == given, data
    assert built > 5 and refused > 5


def test_the_message_names_the_text() -> None:
    protocol = load(f"protocol: p\nframes: {{f: {{body: {BODIES['text']}}}}}")
    with pytest.raises(EncodeError, match="'a' ends before 20 or 0A, and something else follows it"):
        compile_protocol(protocol).encode("f", {"a": "x", "b": "y"})


def test_an_end_within_another_one_is_refused() -> None:
    with pytest.raises(DefinitionError, match="0A stands within 0D 0A 00, and would end it earlier"):
        load("protocol: p\nframes: {f: {body: [{field: a, type: ascii, end: [0D 0A 00, 0A]}, {field: b, type: u8}]}}")


@pytest.mark.parametrize("ending", ["0A", "0D 0A"])
def test_a_stream_shows_where_lines_end(ending: str) -> None:
    """The frame is complete exactly with the last byte of its end, in any pieces."""
    codec = compile_protocol(load(f"protocol: p\nframes: {{f: {{body: {BODIES['lines']}}}}}"))
    data = b"a\rb" + bytes.fromhex(ending)
    for size in range(len(data)):
        assert codec.measure("f", data[:size]) < 0
    assert codec.measure("f", data + b"more") == len(data)

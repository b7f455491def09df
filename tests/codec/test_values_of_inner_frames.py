# ruff: noqa: E501 - definitions in YAML
"""Values of inner frames in expressions: computed values and constants too, when reading and when building."""

from __future__ import annotations

from typing import Any

import pytest

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError
from framekit.definition.load.protocol import load_protocol_text

TEXT = """\
protocol: inner
groups: {pdu: {head: [{field: code, type: u8}]}}
frames:
  a: {group: pdu, where: {code: 1}, body: [{field: n, type: u16}]}
  b: {group: pdu, where: {code: 2}, body: [{length: l, type: u8, of: [d]}, {data: d, size: l}, {field: k, type: u8, default: 9}]}
  f: {body: [%s]}
"""
BODIES = {
    "a value": "{inner: body, of: pdu}, {value: v, read: \"body.b.l + body.b.k if 'b' in body else body.a.code\"}, {field: w, type: u8, is: v}",
    "a field": "{inner: body, of: pdu}, {field: w, type: u8, is: \"body.b.l + body.b.k if 'b' in body else body.a.code\"}",
    "an absent frame": "{field: on, type: u8, build: 1}, {inner: body, of: pdu, when: on == 1}, {field: w, type: u8, is: \"(body.b.l + body.b.k if 'b' in body else body.a.code) if on == 1 else 0\"}",
    "an item": "{repeat: list, times: 1, of: [{length: z, type: u8, of: [body]}, {inner: body, of: pdu, size: z}, {field: w, type: u8, is: \"body.b.l + body.b.k if 'b' in body else body.a.code\"}]}",
}  # fmt: skip


def functions_of(body: str) -> tuple[Any, Any]:
    functions = compile_protocol(load_protocol_text(TEXT % body)).frames["f"]
    return functions.encode, functions.decode


@pytest.mark.parametrize("title", BODIES)
@pytest.mark.parametrize(("body", "last"), [({"a": {"n": 7}}, 1), ({"b": {"d": b"xyz"}}, 12)])
def test_a_frame_is_built_as_it_is_read(title: str, body: Any, last: int) -> None:
    encode, decode = functions_of(BODIES[title])
    built = encode({"list": [{"body": body}]} if title == "an item" else {"body": body})
    assert built[-1] == last
    assert encode(decode(built)) == built


def test_a_given_value_has_to_agree() -> None:
    encode, _ = functions_of(BODIES["a field"])
    with pytest.raises(EncodeError, match="w"):
        encode({"body": {"a": {"n": 7}}, "w": 5})


def test_an_absent_inner_frame_has_no_values() -> None:
    encode, _ = functions_of(BODIES["an absent frame"])
    assert encode({"on": 0}) == b"\0\0"

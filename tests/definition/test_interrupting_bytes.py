"""Frames that interrupt others: bytes that cannot occur in a fixed value do not prevent it."""

from __future__ import annotations

import pytest

from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError

TICK = "protocol: p\nframes:\n  tick: {body: [{const: F8}]}\n"


@pytest.mark.parametrize(
    "frame",
    [
        "{inside: tick, body: [{const: 90}, {bits: {top: 7, v: 0-6}, of: u8, is: {top: 0}}, {const: 01}]}",
        "{inside: tick, body: [{field: k, type: u8}, {const: 01}], where: {k: [0x90, 0x91]}}",
        "{inside: tick, body: [{bits: {kind: 4-7, v: 0-3}, of: u8}, {const: 01}], where: {kind: [8, 9]}}",
        "{inside: tick, body: [{field: k, type: u8, values: {0x92: x}, only: values}, {const: 01}]}",
        "{inside: tick, body: [{field: k, type: u16, is: 0x0102}, {const: 01}]}",
    ],
)
def test_fixed_values_leave_room_for_the_byte_that_interrupts(frame: str) -> None:
    load_protocol_text(f"{TICK}  a: {frame}\n", "p")


@pytest.mark.parametrize(
    ("frame", "holder"),
    [
        ("{inside: tick, body: [{const: 90}, {bits: {top: 7, v: 0-6}, of: u8, is: {top: 1}}, {const: 01}]}", "part"),
        ("{inside: tick, body: [{field: k, type: u8}, {const: 01}], where: {k: [0x90, 0xF8]}}", "'k'"),
        ("{inside: tick, body: [{field: k, type: u8, values: {0x92: x}}, {const: 01}]}", "'k'"),
        ("{inside: tick, body: [{field: k, type: u16, is: 0x01F8}, {const: 01}]}", "'k'"),
    ],
)
def test_a_value_that_may_be_that_byte_is_refused(frame: str, holder: str) -> None:
    with pytest.raises(DefinitionError, match=rf"{holder}.* may hold F8, which tells where 'tick' interrupts 'a'"):
        load_protocol_text(f"{TICK}  a: {frame}\n", "p")

"""`Protocol.builder`: its results, their dependence on parameters, and the names it refuses."""

from __future__ import annotations

import inspect
from typing import Any

import pytest

import framekit
from framekit.api.errors import RequestError


def test_it_builds_what_encode_gives() -> None:
    modbus = framekit.load("modbus-rtu")
    build = modbus.builder("reply_adu", "read_holding_reply")
    pdu = {"read_holding_reply": {"values": b"\0\1"}}
    assert build(station=17, values=b"\0\1") == modbus.encode("reply_adu", station=17, pdu=pdu)
    assert str(inspect.signature(build)) == "(*, station: int, values: bytes) -> bytes"
    assert modbus.builder("reply_adu", "read_holding_reply") is build


def test_it_refuses_what_encode_refuses() -> None:
    build = framekit.load("modbus-rtu").builder("reply_adu", "read_holding_reply")
    with pytest.raises(framekit.EncodeError, match=r"^'values' has a length of 256, more than 255$") as caught:
        build(station=17, values=bytes(256))
    assert caught.value.field == "pdu.read_holding_reply.values"


def test_parameters_are_those_of_the_protocol() -> None:
    bcc, crc = (framekit.load("df1", params={"check_kind": kind}) for kind in ("bcc", "crc"))
    for df1 in (bcc, crc):
        values = {"dst": 9, "src": 1, "tns": 5, "address": 4, "size": 2}
        data = df1.builder("message", "unprotected_read")(**values)
        assert data == df1.encode("message", packet={"unprotected_read": values})
    assert len(crc.builder("ack")()) == 2


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (("reply_ad",), "'modbus-rtu' has no frame 'reply_ad' – did you mean 'reply_adu'?"),
        ((17,), "17 names no frame – give a text"),
        (("reply_adu", ["read"]), "['read'] names no frame – give a text"),
        (("reply_adu", "exeption"), "no frame 'exeption' can stand in 'reply_adu' – did you mean 'exception'?"),
        (("exception", "x"), "no frame 'x' can stand in 'exception' – leave it out"),
        (("reply_adu", "read_holding"), "no frame 'read_holding' can stand in 'reply_adu' – did you mean "),
    ],
)
def test_frames_that_cannot_be_built(frames: tuple[Any, ...], message: str) -> None:
    with pytest.raises(RequestError) as caught:
        framekit.load("modbus-rtu").builder(*frames)
    assert str(caught.value).startswith(message)


def test_names_far_from_all_others_are_told_with_some_of_those_there_are() -> None:
    with pytest.raises(RequestError, match=r"can stand in 'reply_adu' – give one of read_coils_reply, .*, …$"):
        framekit.load("modbus-rtu").builder("reply_adu", "zzz")

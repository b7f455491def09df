"""Hand-written codecs of the benchmarked frames: the same values, the same checks, written as well as we can.

The check codes come from the same functions as framekit's, since the best hand would use the best function too. The
code uses the quickest form that was found: `issuperset` of keys instead of sets of them, one CRC over a frame with its
code.
"""

from __future__ import annotations

from binascii import hexlify, unhexlify
from struct import Struct
from struct import error as StructError  # noqa: N812
from typing import Any

from fastcrc.crc16 import modbus as crc

Fields = dict[str, Any]

REPLY_HEAD = Struct(">BBB")
INDIVIDUAL_HEAD = Struct(">c2s1s2s2s")


class BadFrameError(ValueError):
    """Bytes that are not the frame."""


# ---- register reply: station, 03, byte count, data, CRC ---------------------------------------------------


def decode_registers(data: bytes) -> Fields:
    try:
        station, function, count = data[0], data[1], data[2]  # faster than a struct
    except IndexError:
        raise BadFrameError("short") from None
    if function != 3:
        raise BadFrameError("function")
    if len(data) != count + 5:
        raise BadFrameError("length")
    if crc(data):  # the CRC of a frame including its own code, low byte first, is 0
        raise BadFrameError("check")
    return {"station": station, "pdu": {"read_holding_reply": {"function": 3, "bytes": count, "values": data[3:-2]}}}


def encode_registers(fields: Fields) -> bytes:
    ((name, pdu),) = fields["pdu"].items()
    if name != "read_holding_reply" or len(fields) != 2:
        raise BadFrameError("fields")
    values = pdu["values"]
    size = len(values)
    if len(pdu) != 1 and not (
        REGISTER_KEYS.issuperset(pdu) and pdu.get("function", 3) == 3 and pdu.get("bytes", size) == size
    ):
        raise BadFrameError("fields")
    try:
        data: bytes = REPLY_HEAD.pack(fields["station"], 3, size) + values
    except StructError:
        raise BadFrameError("range") from None
    return data + crc(data).to_bytes(2, "little")


REGISTER_KEYS = frozenset({"function", "bytes", "values"})


# ---- individual read of four variables, ASCII with sum ----------------------------------------------------


def decode_individual(data: bytes) -> Fields:
    """Decode the reply: ACK, station, r, SS, blocks, then byte count and digits of each, ETX, sum."""
    if data[0] != 6 or data[-3] != 3:
        raise BadFrameError("constant")
    if b"%02X" % (sum(data[:-2]) & 0xFF) != data[-2:]:
        raise BadFrameError("check")
    command = chr(data[3])
    if command not in "rR" or data[4:6] != b"SS":
        raise BadFrameError("where")
    blocks = int(data[6:8], 16)
    values, at = [], 8
    for _ in range(blocks):
        size = int(data[at : at + 2], 16)
        end = at + 2 + 2 * size
        content = unhexlify(data[at + 2 : end])
        if len(content) != size:
            raise BadFrameError("short")
        values.append({"bytes": size, "data": content})
        at = end
    if at != len(data) - 3:
        raise BadFrameError("surplus")
    return {"station": int(data[1:3], 16), "command": command, "type": "SS", "blocks": blocks, "values": values}


def encode_individual(fields: Fields) -> bytes:
    values = fields["values"]
    if not INDIVIDUAL_KEYS.issuperset(fields) or fields["command"] not in "rR" or fields.get("type", "SS") != "SS":
        raise BadFrameError("fields")
    if fields.get("blocks", len(values)) != len(values) or not 0 <= fields["station"] <= 255 or len(values) > 255:
        raise BadFrameError("range")
    parts = [b"\x06%02X%sSS%02X" % (fields["station"], fields["command"].encode("latin-1"), len(values))]
    for value in values:
        content = value["data"]
        size = len(content)
        if size > 255 or (len(value) != 1 and not (VALUE_KEYS.issuperset(value) and value.get("bytes", size) == size)):
            raise BadFrameError("length")
        parts.append(b"%02X" % size + hexlify(content).upper())
    data = b"".join(parts) + b"\x03"
    return data + b"%02X" % (sum(data) & 0xFF)


INDIVIDUAL_KEYS = frozenset({"station", "command", "type", "blocks", "values"})
VALUE_KEYS = frozenset({"bytes", "data"})


# ---- user frame WR.REQ: ENQ, text, 44 bytes, EOT, sum -----------------------------------------------------


def decode_write(data: bytes) -> Fields:
    if len(data) != 52:
        raise BadFrameError("length")
    if data[:5] != b"\x05WR44" or data[49] != 4:
        raise BadFrameError("constant")
    if b"%02X" % (sum(data[:50]) & 0xFF) != data[50:]:
        raise BadFrameError("check")
    return {"payload": data[5:49]}


def encode_write(fields: Fields) -> bytes:
    payload = fields["payload"]
    if len(fields) != 1 or len(payload) != 44:
        raise BadFrameError("fields")
    data: bytes = b"\x05WR44" + payload + b"\x04"
    return data + b"%02X" % (sum(data) & 0xFF)


# ---- register request: station, 03, address, count, CRC ---------------------------------------------------

REQUEST = Struct(">BBHH")
REQUEST_WITH_CHECK = Struct(">BBHH2x")


def decode_request(data: bytes) -> Fields:
    try:
        station, function, address, count = REQUEST_WITH_CHECK.unpack(data)
    except StructError:
        raise BadFrameError("length") from None
    if function != 3:
        raise BadFrameError("function")
    if crc(data):
        raise BadFrameError("check")
    if not 1 <= count <= 125:
        raise BadFrameError("count")
    return {"station": station, "pdu": {"read_holding": {"function": 3, "address": address, "count": count}}}


def encode_request(fields: Fields) -> bytes:
    ((name, pdu),) = fields["pdu"].items()
    if name != "read_holding" or len(fields) != 2:
        raise BadFrameError("fields")
    if len(pdu) != 2 and not (REQUEST_KEYS.issuperset(pdu) and pdu.get("function", 3) == 3):
        raise BadFrameError("fields")
    count = pdu["count"]
    if not 1 <= count <= 125:
        raise BadFrameError("count")
    try:
        data = REQUEST.pack(fields["station"], 3, pdu["address"], count)
    except StructError:
        raise BadFrameError("range") from None
    return data + crc(data).to_bytes(2, "little")


REQUEST_KEYS = frozenset({"function", "address", "count"})

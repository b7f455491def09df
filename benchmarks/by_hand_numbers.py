"""The register reply written by hand with registers as numbers: one struct for the head and all of them."""

from __future__ import annotations

from struct import Struct
from struct import error as StructError  # noqa: N812
from typing import Any

from fastcrc.crc16 import modbus as crc

from benchmarks.by_hand import REGISTER_KEYS, BadFrameError

Fields = dict[str, Any]
REPLIES = [Struct(f">BBB{count}H") for count in range(128)]
"""By the number of registers."""
REPLIES_WITH_CHECK = [Struct(f">BBB{count}H2x") for count in range(128)]


def decode_numbers(data: bytes) -> Fields:
    try:
        station, function, count, *values = REPLIES_WITH_CHECK[data[2] // 2].unpack(data)
    except (StructError, LookupError):
        raise BadFrameError("length") from None
    if function != 3 or count % 2:
        raise BadFrameError("function")
    if crc(data):
        raise BadFrameError("check")
    return {"station": station, "pdu": {"read_holding_reply": {"function": 3, "bytes": count, "values": values}}}


def encode_numbers(fields: Fields) -> bytes:
    ((name, pdu),) = fields["pdu"].items()
    if name != "read_holding_reply" or len(fields) != 2:
        raise BadFrameError("fields")
    values = pdu["values"]
    size = 2 * len(values)
    if len(pdu) != 1 and not (
        REGISTER_KEYS.issuperset(pdu) and pdu.get("function", 3) == 3 and pdu.get("bytes", size) == size
    ):
        raise BadFrameError("fields")
    try:
        data: bytes = REPLIES[len(values)].pack(fields["station"], 3, size, *values)
    except (StructError, LookupError):
        raise BadFrameError("range") from None
    return data + crc(data).to_bytes(2, "little")

"""Hand-written functions that build frames of named values: the checks of the encoders by hand, without dictionaries.

The structs are created here, since Python calls a method of an imported object more slowly.
"""

from __future__ import annotations

from struct import Struct
from struct import error as StructError  # noqa: N812

from fastcrc.crc16 import arc
from fastcrc.crc16 import modbus as crc

from benchmarks.by_hand import BadFrameError

REQUEST = Struct(">BBHH")
REPLY_HEAD = Struct(">BBB")
PACKET = Struct("<BBBBH")
REPLIES = [Struct(f">BBB{count}H").pack for count in range(126)]
"""By number of registers; bound methods, since their calls are faster."""
WORD = Struct("<H")


def build_request(*, station: int, address: int, count: int) -> bytes:
    if not 1 <= count <= 125:
        raise BadFrameError("count")
    try:
        data = REQUEST.pack(station, 3, address, count)
    except StructError:
        raise BadFrameError("range") from None
    return data + WORD.pack(crc(data))


def build_registers(*, station: int, values: bytes) -> bytes:
    try:
        data: bytes = REPLY_HEAD.pack(station, 3, len(values)) + values
    except StructError:
        raise BadFrameError("range") from None
    if len(data) > 254:
        raise BadFrameError("length")
    return data + WORD.pack(crc(data))


def build_numbers(*, station: int, values: list[int]) -> bytes:
    size = len(values)
    try:
        data: bytes = REPLIES[size](station, 3, 2 * size, *values)
    except (StructError, LookupError):
        raise BadFrameError("range") from None
    return data + WORD.pack(crc(data))


def build_write(*, payload: bytes) -> bytes:
    if len(payload) != 44:
        raise BadFrameError("length")
    data: bytes = b"\x05WR44" + payload + b"\x04"
    return data + b"%02X" % (sum(data) & 0xFF)


def build_typed_read(
    *, dst: int, src: int, tns: int, data: bytes, priority: int = 0, cmd: int = 0, sts: int = 0
) -> bytes:
    if priority not in (0, 1) or not 0 <= cmd <= 31 or sts == 0xF0:
        raise BadFrameError("range")
    try:
        text = PACKET.pack(dst, src, 0x40 | priority << 5 | cmd, sts, tns) + data
    except StructError:
        raise BadFrameError("range") from None
    if len(text) > 250:
        raise BadFrameError("length")
    code = WORD.pack(arc(text + b"\x03"))
    return b"\x10\x02%b\x10\x03%b" % (text.replace(b"\x10", b"\x10\x10"), code)

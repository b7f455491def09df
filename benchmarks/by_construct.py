"""Frames as a user of `construct` would write them, with `Checksum` over the raw bytes.

And the code that Kaitai generates. The check codes come from the same functions as framekit's. Kaitai's compiler is not
a Python package: the class below is written as its Python target writes such a description (`seq` of u1 fields, a sized
byte field, `valid` on constants). Kaitai has no check codes, so the CRC is compared after it.
"""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from typing import Any

from construct import (
    Byte,
    Bytes,
    Checksum,
    Const,
    Construct,
    GreedyBytes,
    Int16ub,
    Int16ul,
    Prefixed,
    RawCopy,
    Struct,
    Terminated,
    this,
)
from fastcrc.crc16 import modbus as crc

from benchmarks.by_hand import BadFrameError

Fields = dict[str, Any]


def digits(data: bytes) -> bytes:
    return b"%02X" % (sum(data) & 0xFF)


REPLY = Struct(
    "content" / RawCopy(Struct("station" / Byte, "function" / Const(3, Byte), "values" / Prefixed(Byte, GreedyBytes))),
    "check" / Checksum(Int16ul, crc, this.content.data),
    Terminated,
)
REQUEST = Struct(
    "content" / RawCopy(Struct("station" / Byte, "function" / Const(3, Byte), "address" / Int16ub, "count" / Int16ub)),
    "check" / Checksum(Int16ul, crc, this.content.data),
    Terminated,
)
WRITE = Struct(
    "content" / RawCopy(Struct("start" / Const(b"\x05WR44"), "payload" / Bytes(44), "end" / Const(b"\x04"))),
    "check" / Checksum(Bytes(2), digits, this.content.data),
    Terminated,
)


def in_construct(frame: str, values: Fields) -> tuple[Construct, Fields] | None:
    """Return the construct of a benchmarked frame, and its values in construct's form.

    None for frames not written here.
    """
    if frame == "reply_adu":
        content = {"station": values["station"], "values": values["pdu"]["read_holding_reply"]["values"]}
        return REPLY, {"content": {"value": content}}
    if frame == "request_adu":
        return REQUEST, {"content": {"value": {"station": values["station"], **values["pdu"]["read_holding"]}}}
    if frame == "WR.REQ":
        return WRITE, {"content": {"value": {"payload": values["payload"]}}}
    return None


def kaitai_reply() -> Callable[[bytes], object]:
    """Return a decoder of the register reply on Kaitai Struct's runtime, in the form of its compiler's output."""
    from kaitaistruct import KaitaiStream, KaitaiStruct, ValidationNotEqualError

    class ReplyAdu(KaitaiStruct):  # type: ignore[misc]
        def __init__(self, _io: Any, _parent: Any = None, _root: Any = None) -> None:
            super().__init__(_io)
            self._parent = _parent
            self._root = _root or self
            self._read()

        def _read(self) -> None:
            self.station = self._io.read_u1()
            self.pdu = ReplyAdu.Pdu(self._io, self, self._root)
            self.crc = self._io.read_u2le()

        class Pdu(KaitaiStruct):  # type: ignore[misc]
            def __init__(self, _io: Any, _parent: Any = None, _root: Any = None) -> None:
                super().__init__(_io)
                self._parent = _parent
                self._root = _root
                self._read()

            def _read(self) -> None:
                self.function = self._io.read_u1()
                if not self.function == 3:
                    raise ValidationNotEqualError(3, self.function, self._io, "/types/pdu/seq/0")
                self.num_bytes = self._io.read_u1()
                self.values = self._io.read_bytes(self.num_bytes)

    def decode(data: bytes) -> object:
        found = ReplyAdu(KaitaiStream(BytesIO(data)))
        if found.crc != crc(data[:-2]) or not found._io.is_eof():
            raise BadFrameError("check")
        return found

    return decode

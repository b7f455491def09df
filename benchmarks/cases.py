"""The benchmarked frames: values, and hand-written encoders and decoders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.by_hand import (
    decode_individual,
    decode_registers,
    decode_request,
    decode_write,
    encode_individual,
    encode_registers,
    encode_request,
    encode_write,
)
from benchmarks.by_hand_links import decode_mailbox, decode_typed_read, encode_mailbox, encode_typed_read
from benchmarks.by_hand_named import build_numbers, build_registers, build_request, build_typed_read, build_write
from framekit.codec.codec import Builders, Codec, compile_protocol
from framekit.definition.load.protocol import load_protocol

Fields = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Case:
    """A frame with its values, and its hand-written encoder and decoder."""

    name: str
    protocol: str
    frame: str
    values: Fields
    encode: Callable[[Fields], bytes]
    decode: Callable[[bytes], Fields]

    @property
    def codec(self) -> Codec:
        return codec_of(self.protocol)

    def checked(self) -> tuple[bytes, Fields]:
        """Return the frame's bytes and decoded values; assert that the hand-written functions agree."""
        data = self.codec.encode(self.frame, self.values)
        fields = self.codec.decode(self.frame, data)
        assert self.encode(self.values) == data, self.name
        assert self.decode(data) == fields, self.name
        return data, fields


@cache
def codec_of(protocol: str) -> Codec:
    """Return the codec of a shipped protocol."""
    return compile_protocol(load_protocol(protocol))


def registers(count: int) -> Fields:
    return {"station": 17, "pdu": {"read_holding_reply": {"values": bytes(range(2 * count))}}}


def builder_of(protocol: str, *frames: str) -> Callable[..., bytes]:
    """Return a builder of these frames, each nested in the one before it, from named values."""
    codec = codec_of(protocol)
    return Builders(codec, codec.defaults).builder(*frames)


VARIABLES = [{"data": bytes([number, 0x34])} for number in range(4)]
REQUEST = {"station": 17, "pdu": {"read_holding": {"address": 107, "count": 3}}}
INDIVIDUAL = {"station": 32, "command": "r", "values": VARIABLES}
WRITE = {"payload": bytes(range(44))}
# 16 words in PLC-5 typed data, two of them with a byte 10 that is doubled on the line
WORDS = bytes((0x99, 0x09, 0x21, 0x42)) + b"".join(number.to_bytes(2, "little") for number in range(10, 26))
TYPED_READ = {"packet": {"reply": {"dst": 9, "src": 1, "cmd": 15, "tns": 4242, "data": WORDS}}}
FLAGS: tuple[str, ...] = ("oversweep", "constant_sweep", "plc_fault_news", "io_fault_news", "plc_fault", "io_fault")
FLAGS += ("programmer", "outputs_off", "run_switch", "oem")
STATUS = {"control_program": 0, "level": 2, "sweep": 39, **dict.fromkeys(FLAGS, 0), "plc_fault": 1, "state": 2}
ADDRESSES = {"source": b"\0\1\2\3", "destination": b"\4\5\6\7"}
COMPLETION = {"seconds": 11, "minutes": 22, "hours": 13, "seq": 5, **ADDRESSES, "code": 0, "inline": bytes(range(6))}
COMPLETION["status"] = STATUS
MAILBOX = {"body": {"completion": COMPLETION}}

CASES = (
    Case("Modbus read request", "modbus-rtu", "request_adu", REQUEST, encode_request, decode_request),
    Case("Modbus reply, 10 registers", "modbus-rtu", "reply_adu", registers(10), encode_registers, decode_registers),
    Case("Modbus reply, 125 registers", "modbus-rtu", "reply_adu", registers(125), encode_registers, decode_registers),
    Case("MLDP reply, 4 blocks", "mldp", "read_individual_reply", INDIVIDUAL, encode_individual, decode_individual),
    Case("DF1 typed-read reply, 16 words", "df1", "message", TYPED_READ, encode_typed_read, decode_typed_read),
    Case("SNP mailbox, completion", "snp", "mailbox", MAILBOX, encode_mailbox, decode_mailbox),
    Case("WR.REQ", "third-party-plc", "WR.REQ", WRITE, encode_write, decode_write),
)


@dataclass(frozen=True, slots=True)
class Named:
    """Nested frames with their named values, and the hand-written function that builds them."""

    name: str
    protocol: str
    frames: tuple[str, ...]
    values: Fields
    by_hand: Callable[..., bytes]

    def checked(self) -> Callable[..., bytes]:
        """Return the builder; assert that the hand-written function builds the same bytes."""
        build = builder_of(self.protocol, *self.frames)
        assert build(**self.values) == self.by_hand(**self.values), self.name
        return build


REGISTERS = str(Path(__file__).parent / "registers.yaml")
"""Definition of the register reply with registers as numbers."""
REPLY = ("reply_adu", "read_holding_reply")
PACKET_VALUES = TYPED_READ["packet"]["reply"]


def data_of(count: int) -> Fields:
    return {"station": 17, "values": bytes(range(2 * count))}


def numbers_of(count: int) -> Fields:
    return {"station": 17, "values": list(range(100, 100 + count))}


READ = {"station": 17, "address": 107, "count": 3}
NAMED = (
    Named("Modbus read request", "modbus-rtu", ("request_adu", "read_holding"), READ, build_request),
    Named("Modbus reply, 10 registers", "modbus-rtu", REPLY, data_of(10), build_registers),
    Named("Modbus reply, 125 registers", "modbus-rtu", REPLY, data_of(125), build_registers),
    Named("Modbus reply, 10 registers as numbers", REGISTERS, REPLY, numbers_of(10), build_numbers),
    Named("Modbus reply, 125 registers as numbers", REGISTERS, REPLY, numbers_of(125), build_numbers),
    Named("DF1 typed-read reply, 16 words", "df1", ("message", "reply"), PACKET_VALUES, build_typed_read),
    Named("WR.REQ", "third-party-plc", ("WR.REQ",), WRITE, build_write),
)

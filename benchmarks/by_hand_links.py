"""Hand-written codecs of two complex links: doubled escape bytes, and mailboxes of many small fields."""

from __future__ import annotations

from struct import Struct
from struct import error as StructError  # noqa: N812
from typing import Any

from fastcrc.crc16 import arc

from benchmarks.by_hand import BadFrameError

Fields = dict[str, Any]

# ---- a packet between DLE STX and DLE ETX, every DLE doubled, CRC over packet and ETX ----------------------

PACKET = Struct("<BBBBH")
REPLY_KEYS = frozenset({"dst", "src", "is_reply", "priority", "cmd", "sts", "tns", "data"})


def decode_typed_read(data: bytes) -> Fields:
    if data[:2] != b"\x10\x02" or data[-4:-2] != b"\x10\x03":
        raise BadFrameError("constant")
    text = data[2:-4]
    if b"\x10" in text:
        if b"\x10\x06" in text or b"\x10\x15" in text:
            raise BadFrameError("acknowledgements inside are not for this function")
        if text.count(b"\x10") != 2 * text.count(b"\x10\x10"):
            raise BadFrameError("escape")
        text = text.replace(b"\x10\x10", b"\x10")
    if not 6 <= len(text) <= 250:
        raise BadFrameError("length")
    if arc(text + data[-3:]):  # the CRC of the covered bytes and the code, low byte first, is 0
        raise BadFrameError("check")
    dst, src, command, sts, tns = PACKET.unpack_from(text)
    if not command & 0x40 or sts == 0xF0:
        raise BadFrameError("no plain reply")
    reply = {"dst": dst, "src": src, "is_reply": 1, "priority": command >> 5 & 1, "cmd": command & 0x1F, "sts": sts}
    return {"packet": {"reply": {**reply, "tns": tns, "data": text[6:]}}}


def encode_typed_read(fields: Fields) -> bytes:
    ((name, reply),) = fields["packet"].items()
    if name != "reply" or len(fields) != 1 or not REPLY_KEYS.issuperset(reply) or reply.get("is_reply", 1) != 1:
        raise BadFrameError("fields")
    priority, command, status = reply.get("priority", 0), reply.get("cmd", 0), reply.get("sts", 0)
    if priority not in (0, 1) or not 0 <= command <= 31 or status == 0xF0:
        raise BadFrameError("range")
    try:
        head = PACKET.pack(reply["dst"], reply["src"], 0x40 | priority << 5 | command, status, reply["tns"])
    except StructError:
        raise BadFrameError("range") from None
    text = head + reply["data"]
    if len(text) > 250:
        raise BadFrameError("length")
    code = arc(text + b"\x03")
    return b"\x10\x02%s\x10\x03%s" % (text.replace(b"\x10", b"\x10\x10"), code.to_bytes(2, "little"))


# ---- a mailbox of 40 bytes: time, addresses, six bytes of data, status; a rotating sum ---------------------

MAILBOX = Struct("<2s2xBBBxBB4s4s2xBx6sBBHHcBHxB")
MAILBOX_OUT = Struct("<2s2xBBBxBB4s4s2sBx6sBBHHcBHx")
ROTATED = tuple((code << 1 | code >> 7) & 0xFF for code in range(256))
TO_BCD = tuple(tens << 4 | ones for tens in range(10) for ones in range(10))
MAILBOX_KEYS = frozenset({"body", "next_type", "next_length"})
DIGITS = ("second_digits", "minute_digits", "hour_digits")
DIGIT_KEYS = frozenset(DIGITS)
FLAGS: tuple[str, ...] = ("oversweep", "constant_sweep", "plc_fault_news", "io_fault_news", "plc_fault")
FLAGS += ("io_fault", "programmer", "outputs_off", "run_switch", "oem")
STATUS_KEYS = {"control_program", "level", "sweep", *FLAGS, "state"}
COMPLETION_KEYS = frozenset(
    {
        "second_digits",
        "minute_digits",
        "hour_digits",
        "seconds",
        "minutes",
        "hours",
        "seq",
        "kind",
        "source",
        "destination",
        "code",
        "inline",
        "status",
    }
)


def rotating_sum(data: bytes) -> int:
    code = 0
    for byte in data:
        code = ROTATED[code ^ byte]
    return code


def decode_mailbox(data: bytes) -> Fields:
    if len(data) != 40:
        raise BadFrameError("length")
    (
        start, seconds, minutes, hours, seq, kind, source, destination, code, inline, program, level, sweep, bits,
        end, next_type, next_length, check,
    ) = MAILBOX.unpack(data)  # fmt: skip
    if start != b"\x1bM" or kind != 0xD4 or end != b"\x17":
        raise BadFrameError("constant")
    if check != rotating_sum(data[:-1]):
        raise BadFrameError("check")
    status = {
        "control_program": program,
        "level": level,
        "sweep": sweep,
        "oversweep": bits & 1,
        "constant_sweep": bits >> 1 & 1,
        "plc_fault_news": bits >> 2 & 1,
        "io_fault_news": bits >> 3 & 1,
        "plc_fault": bits >> 4 & 1,
        "io_fault": bits >> 5 & 1,
        "programmer": bits >> 6 & 1,
        "outputs_off": bits >> 7 & 1,
        "run_switch": bits >> 8 & 1,
        "oem": bits >> 9 & 1,
        "state": bits >> 12,
    }
    completion = {
        "second_digits": seconds,
        "minute_digits": minutes,
        "hour_digits": hours,
        "seconds": (seconds >> 4) * 10 + (seconds & 15),
        "minutes": (minutes >> 4) * 10 + (minutes & 15),
        "hours": (hours >> 4) * 10 + (hours & 15),
        "seq": seq,
        "kind": kind,
        "source": source,
        "destination": destination,
        "code": code,
        "inline": inline,
        "status": status,
    }
    return {"body": {"completion": completion}, "next_type": next_type, "next_length": next_length}


def encode_mailbox(fields: Fields) -> bytes:
    ((name, mail),) = fields["body"].items()
    status = mail["status"]
    if name != "completion" or not MAILBOX_KEYS.issuperset(fields):
        raise BadFrameError("fields")
    if not COMPLETION_KEYS.issuperset(mail) or mail.get("kind", 0xD4) != 0xD4 or status.keys() != STATUS_KEYS:
        raise BadFrameError("fields")
    bits, state = 0, status["state"]
    for place, flag in enumerate(FLAGS):
        bit = status[flag]
        if bit not in (0, 1):
            raise BadFrameError(flag)
        bits |= bit << place
    source, destination, inline = mail["source"], mail["destination"], mail["inline"]
    if len(source) != 4 or len(destination) != 4 or len(inline) > 6 or not 0 <= state <= 15:
        raise BadFrameError("length")
    seconds, minutes, hours = mail["seconds"], mail["minutes"], mail["hours"]
    digits = TO_BCD[seconds], TO_BCD[minutes], TO_BCD[hours]
    if not DIGIT_KEYS.isdisjoint(mail) and digits != tuple(mail[name] for name in DIGITS):
        raise BadFrameError("digits")
    data: bytes = MAILBOX_OUT.pack(
        b"\x1bM",
        *digits,
        mail["seq"],
        0xD4,
        source,
        destination,
        b"\x01\x01",
        mail.get("code", 0),
        inline,
        status["control_program"],
        status["level"],
        status["sweep"],
        bits | state << 12,
        b"\x17",
        fields.get("next_type", 0),
        fields.get("next_length", 0),
    )
    return data + bytes((rotating_sum(data),))

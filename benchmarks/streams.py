"""Streams of mixed frames with noise between them, reproducible for a given size."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from benchmarks.cases import codec_of
from framekit.codec.codec import Codec

NOISE = 0.01
"""Noise bytes for every byte of frames."""

LONGEST_PIECE = 512
"""Longest piece in bytes; pieces have 1 to this size, like those of a port."""

Fields = dict[str, Any]
Make = Callable[[random.Random], Fields]


@dataclass(frozen=True, slots=True)
class Kind:
    """The protocol of a stream, and its frames, each with a function for its values."""

    name: str
    protocol: str
    frames: tuple[tuple[str, Make], ...]

    @property
    def codec(self) -> Codec:
        return codec_of(self.protocol)


def _registers(choose: random.Random) -> Fields:
    values = choose.randbytes(2 * choose.choice((1, 2, 10, 20, 125)))
    return {"station": choose.randrange(1, 248), "pdu": {"read_holding_reply": {"values": values}}}


def _bits(choose: random.Random) -> Fields:
    return {"station": choose.randrange(1, 248), "pdu": {"read_coils_reply": {"values": choose.randbytes(4)}}}


def _written(choose: random.Random) -> Fields:
    pdu = {"write_registers_reply": {"address": choose.randrange(1000), "count": 10}}
    return {"station": choose.randrange(1, 248), "pdu": pdu}


def _refused(choose: random.Random) -> Fields:
    return {"station": choose.randrange(1, 248), "pdu": {"exception": {"function": 3, "code": 2}}}


def _packet(choose: random.Random) -> Fields:
    data = choose.randbytes(choose.choice((2, 8, 40, 236)))
    return {"packet": {"reply": {"dst": 9, "src": 1, "cmd": 15, "tns": choose.randrange(65536), "data": data}}}


def _nothing(choose: random.Random) -> Fields:
    return {}


def _variables(choose: random.Random) -> Fields:
    values = [{"data": choose.randbytes(choose.choice((1, 2, 4)))} for _ in range(choose.randrange(1, 9))]
    return {"station": choose.randrange(32), "command": "r", "values": values}


def _block(choose: random.Random) -> Fields:
    return {
        "station": choose.randrange(32),
        "command": "r",
        "values": [{"data": choose.randbytes(2 * choose.randrange(1, 60))}],
    }


KINDS = (
    Kind(
        "Modbus RTU, replies",
        "modbus-rtu",
        (("reply_adu", _registers), ("reply_adu", _bits), ("reply_adu", _written), ("reply_adu", _refused)),
    ),
    Kind("DF1, packets and responses", "df1", (("message", _packet), ("ack", _nothing), ("enq", _nothing))),
    Kind("MLDP, replies", "mldp", (("read_individual_reply", _variables), ("read_continuous_reply", _block))),
)


@dataclass(frozen=True, slots=True)
class Sample:
    """A stream, and its frames in order: name and bytes of each."""

    stream: bytes
    frames: tuple[tuple[str, bytes], ...]

    def pieces(self) -> Iterator[bytes]:
        """Yield the stream in random pieces."""
        choose, place = random.Random(1), 0
        while place < len(self.stream):
            size = choose.randrange(1, LONGEST_PIECE + 1)
            yield self.stream[place : place + size]
            place += size


def sample(kind: Kind, size: int) -> Sample:
    """Return about `size` bytes of the kind's frames, all equally frequent, sometimes with 1 to 8 bytes of noise."""
    choose, codec = random.Random(0), kind.codec
    made = []
    for _ in range(2000):
        name, make = choose.choice(kind.frames)
        made.append((name, codec.encode(name, make(choose))))
    parts, frames, length, noise = [], [], 0, 0
    while length < size:
        frame = choose.choice(made)
        frames.append(frame)
        parts.append(frame[1])
        length += len(frame[1])
        if noise < NOISE * length:
            parts.append(choose.randbytes(choose.randrange(1, 9)))
            noise += len(parts[-1])
    return Sample(b"".join(parts), tuple(frames))

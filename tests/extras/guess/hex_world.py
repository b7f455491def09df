"""A recording of a polled meter, for the page of unknown lines: by sessions, over sockets, in a browser."""

from __future__ import annotations

import random
import struct
from pathlib import Path

from framekit.codec.checks import compute
from framekit.definition.model.checks import ready_methods
from framekit.extras.guess.draft import NamedGuess, write_definition
from framekit.extras.guess.hex_session import HexBoard, HexSession
from framekit.extras.guess.hex_table import guessed_table
from framekit.extras.guess.model import HeardBytes
from framekit.extras.guess.recordings import guess
from framekit.extras.web.access import Access

TOKEN = "a-token-of-tests"
CHECK = ready_methods()["crc16-modbus"]


def framed(data: bytes) -> bytes:
    return data + compute(CHECK, data).to_bytes(2, "little")


def polled(count: int = 40) -> list[HeardBytes]:
    """Return polls of two meters, whose replies hold a rising float and a status byte; after ten polls comes noise."""
    rng, chunks = random.Random(11), list[HeardBytes]()
    for at in range(count):
        head = bytes([0xA5, rng.choice([3, 4])])
        reply = struct.pack(">f", 20 + at / 4) + bytes([rng.choice([0, 1, 0x80])])
        now = at * 500_000_000
        chunks.append(HeardBytes(now, "out", framed(head + bytes([rng.randrange(9), 0x10]))))
        chunks.append(HeardBytes(now + 20_000_000, "in", framed(head + reply)))
        if at == 10:
            chunks.append(HeardBytes(now + 200_000_000, "in", b"\x13\x37\x00"))
    return chunks


def hex_text(chunks: list[HeardBytes]) -> str:
    """Return the recording as the text of a hex file."""
    ways = {"out": ">", "in": "<", "": ""}
    return "".join(f"{(chunk.time or 0) / 1e9:.3f} {ways[chunk.direction]} {chunk.data.hex(' ')}\n" for chunk in chunks)


class HexPage:
    """The hex page of the recording, and the file of its definition."""

    def __init__(self, folder: Path) -> None:
        found = guess(polled())
        self.path = folder / "meter.yaml"
        write_definition(found, self.path, "meter.txt")
        self.names = NamedGuess(found, "meter", "meter.txt", self.path)
        self.board = HexBoard("meter.txt", guessed_table(found), found.statements, self.names)

    def session(self) -> HexSession:
        return self.board.session(Access(TOKEN), "test:1")

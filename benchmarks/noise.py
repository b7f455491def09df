"""Noise that is expensive for a channel: random and bred bytes for every shipped protocol and role, with their costs.

`python -m benchmarks.noise [--seconds S] [PROTOCOL …]` searches for more expensive bytes and prints them. The search
counts calls, which do not depend on the load of the machine; the printed times are processor times.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from random import Random
from typing import Any

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.sources import shipped_definitions
from framekit.link.engine import Engine
from framekit.link.frame_table import FrameTable
from framekit.link.services.client import ServiceClient
from framekit.transport.clock import LONGEST, MOST
from framekit.transport.clock import PIECE as WORK

PIECE = 4096
"""Number of bytes that arrive at once; also the bytes that still arrive on a connection broken by noise."""

SMALL = 64
"""Size of small pieces in bytes."""

PAUSE = 2_000_000
"""Pause between small pieces (ns)."""

QUIET_AGAIN = 20_000_000
"""Pause between pieces, all small, if skipping until a silence follows a bad frame (ns)."""

BLOCK = 1500
"""Size of a bred block in bytes; it is repeated."""

ADDRESSES = {
    "modbus": "40001",
    "ge-rtu": "40001",
    "mldp": "D100",
    "df1": "N7:0",
    "snp": "%R1",
    "srtp": "%R1",
    "ccm": "%R1",
}
"""Read address of a client, by prefix of the protocol name; the clients of all other protocols only listen."""
STATIONS: dict[str, Any] = {"snp": ("A", ""), "snp-x": (b"A".ljust(8, b"\0"), bytes(8)), "srtp": (None, None)}


@dataclass(frozen=True, slots=True)
class Link:
    """A role of a protocol."""

    protocol: str
    role: str | None

    def __str__(self) -> str:
        return f"{self.protocol} {self.role or 'frames'}"


@cache
def compiled(name: str) -> tuple[Protocol, Codec]:
    protocol = load_protocol(name)
    return protocol, compile_protocol(protocol)


def shipped() -> list[str]:
    """Return every shipped protocol with a line of its own."""
    found = [
        file.stem for file in shipped_definitions() if f"protocol: {file.stem}\n" in file.read_text(encoding="utf-8")
    ]
    return [name for name in found if compiled(name)[0].frames]


def links(names: list[str]) -> list[Link]:
    return [Link(name, role) for name in names for role in list(compiled(name)[0].roles) or [None]]


class Line:
    """A side of a link that receives noise; a client waits for the reply to a read."""

    def __init__(self, link: Link) -> None:
        self.link = link
        protocol, codec = compiled(link.protocol)
        self.station, own = STATIONS.get(link.protocol, (3, 1))
        self.engine = Engine(protocol, codec, link.role, own=own, monitor=lambda seen: None)
        self.client = ServiceClient(protocol, codec, self.engine)
        known = (text for name, text in ADDRESSES.items() if link.protocol.startswith(name))
        self.address = next(known, "") if link.role in ("client", "master") else ""
        self.silence = QUIET_AGAIN if protocol.receiver.resync == "after_quiet" else 0
        self.now = 1_000_000_000
        self.busy = False
        self.engine.opened(0)

    def hear(self, data: bytes, piece: int = PIECE) -> None:
        """Receive noise in pieces, with pauses between small pieces.

        The client requests again when its exchange is over. If skipping until a silence follows a bad frame, silences
        are inserted, so the search for frames restarts. If a bad frame breaks the connection, the next `PIECE` comes
        over a new connection.
        """
        piece = SMALL if self.silence else piece
        pause = self.silence or (PAUSE if piece <= SMALL else 1000)
        for start in range(0, len(data), piece):
            if self.engine.receiver.broken and start % PIECE == 0:
                self.engine.closed(self.now, "out of step")
                self.engine.opened(self.now)
            if self.address and not self.busy and not self.engine.receiver.broken:
                self.ask()
            self.now += pause
            while (due := self.engine.deadline) <= self.now:
                self.engine.tick(due)
            self.engine.receive(data[start : start + piece], self.now)

    def ask(self) -> None:
        self.busy = True
        self.client.read(self.address, station=self.station, now=self.now, on_done=self._over)
        self.engine.sent(self.now)

    def _over(self, result: object) -> None:
        self.busy = False

    @property
    def good(self) -> int:
        return self.engine.counters.received


def seconds(link: Link, data: bytes, piece: int = PIECE) -> float:
    """Return the processor time per byte."""
    line = Line(link)
    begin = time.process_time()
    line.hear(data, piece)
    return (time.process_time() - begin) / len(data)


def turn(link: Link, data: bytes) -> float:
    """Return the longest turn of a loop in seconds: the most bytes that are handled at once, after other pieces."""
    lines, times = [Line(link) for _ in range(5)], []
    for line in lines:
        if line.address:
            line.ask()
        begin = time.process_time()
        line.hear(data[: MOST - WORK])
        times.append(time.process_time() - begin)
    return LONGEST / 1e9 + min(times)


def calls(link: Link, data: bytes, piece: int = PIECE) -> float:
    """Return function calls per byte; 0 if the bytes contain many good frames, since these are not noise."""
    line, count = Line(link), 0

    def counted(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(counted)
    try:
        line.hear(data, piece)
    finally:
        sys.setprofile(None)
    return 0 if line.good * 200 > len(data) else count / len(data)


# ---- noise ------------------------------------------------------------------------------------------------


@cache
def frames_of(name: str) -> list[bytes]:
    """Return frames of the protocol, as many as can be drawn."""
    protocol, codec = compiled(name)
    sampler = Sampler(codec, Line(links([name])[0]).engine.scope)
    return [sample.data for frame in protocol.frames for sample in sampler.samples(frame, 4, 20) if sample.data]


@cache
def with_wrong_checks(name: str) -> list[bytes]:
    """Return the shortest frames that a receiver looks for, each repeated with its last or last but one byte wrong."""
    sampler, table = Sampler(compiled(name)[1], Line(links([name])[0]).engine.scope), _table(name)
    found = {}
    for frame in table.on_line:
        drawn = [sample.data for sample in sampler.samples(frame, 10, 40) if len(sample.data) > 1]
        for data in sorted(drawn, key=len)[:1]:
            found[data[:-1] + bytes([data[-1] ^ 0x55])] = None
            found[data[:-2] + bytes([data[-2] ^ 0x55, data[-1]])] = None
    return [(data * BLOCK)[:BLOCK] for data in found]


def _table(name: str) -> FrameTable:
    return Line(links([name])[0]).engine.receiver.table


def parts(name: str, choose: Random) -> Iterator[bytes]:
    """Yield fragments: headers, frames with a damaged end, repeated starts, counts, delimiters."""
    frames = frames_of(name) or [b"\0"]
    while True:
        data = choose.choice(frames)
        kind = choose.randrange(7)
        if kind == 0:
            yield data[: choose.randrange(1, min(len(data), 8) + 1)]
        elif kind == 1:
            yield data[:-1] + bytes([data[-1] ^ choose.randrange(1, 256)])
        elif kind == 2:
            yield data[:1] * choose.randrange(1, 60)
        elif kind == 3:
            yield data[-3:] * choose.randrange(1, 20)
        elif kind == 4:
            yield bytes([choose.choice((choose.randrange(256), 0, 1, 3, 0xFA, 0xFF))]) * choose.randrange(1, 5)
        elif kind == 5:
            yield data[: choose.randrange(1, min(len(data), 5) + 1)] * choose.randrange(1, 40)
        else:
            yield bytes(choose.choice(data) for _ in range(choose.randrange(1, 30)))


def drawn(name: str, choose: Random) -> bytes:
    """Return a block of noise; one block in three repeats a few fragments."""
    source, data = parts(name, choose), b""
    few = [next(source) for _ in range(choose.randrange(1, 4))] if choose.randrange(3) == 0 else []
    while len(data) < BLOCK:
        data += choose.choice(few) if few else next(source)
    return data[:BLOCK]


def changed(name: str, data: bytes, choose: Random) -> bytes:
    """Return the block with a replacement in one place."""
    place, part = choose.randrange(len(data)), next(parts(name, choose))
    kind = choose.randrange(3)
    if kind == 0:
        return (data[:place] + part + data[place + len(part) :])[:BLOCK]
    if kind == 1:
        size = choose.randrange(2, 300)
        return (data[place : place + size] * BLOCK)[:BLOCK]
    return (data[:place] + part * (BLOCK // len(part)) + data[place:])[:BLOCK]


def worst(link: Link, seconds_each: float, piece: int = PIECE) -> tuple[float, bytes]:
    """Return the most calls per byte found within that time for bytes in such pieces, and these bytes."""
    choose, until = Random(7), time.monotonic() + seconds_each
    first = with_wrong_checks(link.protocol) + [drawn(link.protocol, choose) for _ in range(12)]
    best = max((calls(link, data * 2, piece), data) for data in first)
    while time.monotonic() < until:
        fresh = choose.randrange(4) == 0
        data = drawn(link.protocol, choose) if fresh else changed(link.protocol, best[1], choose)
        best = max(best, (calls(link, data * 2, piece), data))
    return best


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.noise", description="searches for costly noise")
    parser.add_argument("protocols", nargs="*", metavar="PROTOCOL", help="all shipped ones without")
    parser.add_argument("--seconds", type=float, default=20, help="for each role of a protocol and size of pieces")
    parser.add_argument("--bytes", action="store_true", help="print the worst bytes too")
    arguments = parser.parse_args()
    for link in links(arguments.protocols or shipped()):
        random_bytes = Random(1).randbytes(65536)
        for piece in (PIECE, SMALL):
            count, data = worst(link, arguments.seconds, piece)
            took, usual = (
                min(seconds(link, content, piece) for _ in range(3)) for content in (data * 20, random_bytes)
            )
            print(
                f"{link!s:<22}{piece:>5} random {1e6 * usual:5.2f} µs   worst {1e6 * took:5.2f} µs, {count:.1f} calls",
                flush=True,
            )
            if arguments.bytes:
                print(f"    {data[:300].hex()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

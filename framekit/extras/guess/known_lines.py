"""Shipped protocols tried on an unknown line: those whose frames have checks, so that other lines are seldom mistaken
for them.

Loading and compiling all of them takes seconds. `frames/lines.json` lists those with checks and the first bytes of
their frames; only definitions whose first bytes occur are loaded. `python -m framekit.extras.guess.known_lines` writes
it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from framekit.codec.codec import compile_protocol
from framekit.codec.python.facts import leading
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.frames import flat
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check
from framekit.definition.problems import DefinitionError
from framekit.definition.sources import shipped_definitions, shipped_folder
from framekit.extras.guess.recordings import LEAST_FRAMES, NEARLY_ALL, HeardBytes, listen
from framekit.link.events import Seen
from framekit.link.frame_table import table_of

INDEX = "lines.json"
MOST_TRIED = 4096
"""Number of bytes tried with each definition."""

PIECES = 0.25
FAR_MORE = 3.0
"""Share of pieces that must begin with the first bytes of a protocol; or the factor by which these must exceed
chance.
"""


@dataclass(frozen=True, slots=True)
class KnownProtocol:
    """A definition that reads a line: its good frames, their bytes, all bytes, and the number of files of the
    definition.
    """

    name: str
    frames: int
    covered: int
    of: int
    files: int = 1


def known_protocols(chunks: Sequence[HeardBytes]) -> list[KnownProtocol]:
    """Return the shipped definitions with checks that read nearly all of a line, the best first.

    Of two that read the same amount, the definition based on fewer files comes first: others are derived from it.
    """
    few = _first_of(chunks, MOST_TRIED)
    index: dict[str, list[str]] = json.loads((shipped_folder("frames") / INDEX).read_text("utf-8"))
    found: list[KnownProtocol] = []
    for path in shipped_definitions():
        if not _may_be(index.get(path.name, []), few):
            continue
        try:
            protocol = load_protocol(path)
            ways: tuple[Literal["in", "out"], ...] = (
                ("out", "in") if len({one.direction for one in few}) > 1 else ("out",)
            )
            found += [_explained(protocol, few, way) for way in ways]
        except (DefinitionError, ValueError):
            continue
    likely = [one for one in found if one.covered >= NEARLY_ALL * one.of and one.frames >= LEAST_FRAMES]
    best: dict[str, KnownProtocol] = {}
    for one in sorted(likely, key=lambda one: one.covered):
        best[one.name] = one
    return sorted(best.values(), key=lambda one: (-one.covered, one.files))


def _may_be(starts: Sequence[str], chunks: Sequence[HeardBytes]) -> bool:
    """Return whether the first bytes of a protocol occur often enough at the begin of pieces, or far more often than by
    chance.
    """
    if not starts:
        return False
    known = tuple(bytes.fromhex(start) for start in starts)
    ways = dict.fromkeys(chunk.direction for chunk in chunks)
    heard = [b"".join(chunk.data for chunk in chunks if chunk.direction == way) for way in ways]
    often = sum(data.count(start) for start in known for data in heard)
    by_luck = sum(map(len, heard)) * sum(256.0 ** -len(start) for start in known)
    first = sum(chunk.data.startswith(known) for chunk in chunks)
    return often >= LEAST_FRAMES and (first >= PIECES * len(chunks) or often >= FAR_MORE * by_luck)


def _explained(protocol: Protocol, chunks: Sequence[HeardBytes], client: Literal["in", "out"]) -> KnownProtocol:
    """Read a line with a definition and return the result."""
    good: list[bytes] = []

    def monitor(seen: Seen) -> None:
        if seen.kind == "frame":
            good.append(seen.raw)

    both = len({chunk.direction for chunk in chunks}) > 1
    listen(protocol, chunks, client if both else None, monitor)
    whole = sum(len(chunk.data) for chunk in chunks)
    return KnownProtocol(protocol.name, len(good), sum(map(len, good)), whole, len(protocol.sources))


def _first_of(chunks: Sequence[HeardBytes], most: int) -> list[HeardBytes]:
    found, size = [], 0
    for chunk in chunks:
        found.append(chunk)
        size += len(chunk.data)
        if size >= most:
            break
    return found


# ---- the index --------------------------------------------------------------------------------------------------


def starts_of(path: Path) -> list[str]:
    """Return the first bytes of the frames of a definition, as hex digits; '' for any bytes.

    The list is empty if frames have no checks, or do not occur on a line.
    """
    protocol = load_protocol(path)
    if protocol.kind == "application":
        return []
    frames = [protocol.frames[name] for name in table_of(protocol, compile_protocol(protocol)).on_line]
    if not all(any(isinstance(segment, Check) for segment in flat(frame.segments)) for frame in frames):
        return []
    return sorted({leading(frame.segments).hex().upper() for frame in frames})


def index_text() -> str:
    """Return the text of the index."""
    paths = [path for path in shipped_definitions() if path.name.count(".") == 1]
    rows = {path.name: starts for path in paths if (starts := starts_of(path))}
    return json.dumps(rows, indent=1) + "\n"


if __name__ == "__main__":
    (shipped_folder("frames") / INDEX).write_text(index_text(), "utf-8")

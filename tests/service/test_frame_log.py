"""The log of a frame monitor: results, filters, fields with their offsets, and the size limit."""

from __future__ import annotations

import pytest

from framekit.api.monitor import FrameFilter, FrameLog, ascii_of, result_of
from framekit.definition.load.protocol import load_protocol
from framekit.link.events import Seen

ASK = bytes.fromhex("05 32 30 72 53 53 30 31 30 36 25 4D 57 31 30 30 04 41 34")
GOOD = Seen("out", "frame", 5, ASK, "read_individual")
BAD = Seen("in", "bad", 6, ASK[:-1] + b"5", "read_individual", reason="check", place=17, segment="check")
NOISE = Seen("in", "noise", 7, b"\xff\xfe")


def log(kept: int = 100) -> FrameLog:
    made = FrameLog({2: load_protocol("third-party-plc")}, kept=kept)
    made.know(1, load_protocol("mldp"), "client", {})
    made.add(1, GOOD)
    made.add(1, BAD)
    made.add(1, NOISE)
    made.add(2, Seen("out", "frame", 8, b"\x06", "IMM.RESPONSE"))
    made.add(2, Seen("", "closed", 9, reason="gone"))
    return made


def test_the_processing_result() -> None:
    results = [entry.result for entry in log().since(0)]
    assert results == ["mldp client", "unknown", "unknown", "user-defined", ""]
    assert result_of(load_protocol("mldp"), GOOD) == "mldp client"
    assert result_of(load_protocol("mldp"), Seen("in", "frame", 1, b"", "refused")) == "mldp server"


@pytest.mark.parametrize(
    ("wanted", "numbers"),
    [
        (FrameFilter(), [1, 2, 3, 4, 5]),
        (FrameFilter(channel=2), [4, 5]),
        (FrameFilter(bad_only=True), [2, 3]),
        (FrameFilter(frame="imm"), [4]),
        (FrameFilter(text="%mw100"), [1, 2]),
        (FrameFilter(text="ff fe"), [3]),
        (FrameFilter(text="check"), [2]),
        (FrameFilter(channel=1, text="gone"), []),
    ],
)
def test_filters(wanted: FrameFilter, numbers: list[int]) -> None:
    assert [entry.number for entry in log().chosen(wanted)] == numbers


def test_old_entries_are_dropped_and_counted() -> None:
    made = log(kept=2)
    assert [entry.number for entry in made.since(0)] == [4, 5]
    assert made.dropped == 3
    assert made.entry(3) is None
    found = made.entry(5)
    assert found is not None
    assert found.seen.kind == "closed"
    assert made.entry(6) is None
    assert made.counts == {"frame": 2, "bad": 1, "noise": 1, "closed": 1}


def test_the_fields_of_a_frame_with_their_places() -> None:
    made = log()
    first = made.entry(1)
    assert first is not None
    rows = {row.path: row for row in made.fields(first)}
    assert (rows["station"].offset, rows["station"].data, rows["station"].value) == (1, b"20", "32")
    assert next(row for row in rows.values() if row.path.endswith("name")).data == b"%MW100"
    bad = made.entry(2)
    assert bad is not None
    assert {row.path for row in made.fields(bad)} >= {"station"}
    noise = made.entry(3)
    assert noise is not None
    assert made.fields(noise) == []


def test_ascii() -> None:
    assert ascii_of(b"\x05ab \x7f\xff") == "·ab ··"

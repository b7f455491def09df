"""Compare two recordings: replies to equal requests differ; other protocols and other kinds of frames are reported."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from framekit.cli.main import main
from framekit.codec.checks import compute
from framekit.definition.model.checks import ready_methods
from framekit.extras.guess.differences import definition_differences, differences
from framekit.extras.guess.model import HeardBytes
from tests.extras.guess.test_kinds import meter

MODBUS = ready_methods()["crc16-modbus"]


def registers(level: int, seed: int, extra: bool = False, count: int = 20) -> list[HeardBytes]:
    """Return a recording of two stations and three requests in turn.

    One register is the level, the others are noise.
    """
    rng, found = random.Random(seed), list[HeardBytes]()
    polls = [(17, 4, 16, 3), (17, 3, 100, 2), (18, 4, 16, 2), *[(17, 1, 0, 8)] * extra]
    for at in range(count):
        for step, (station, function, first, number) in enumerate(polls):
            words = [1600 + rng.randrange(20) for _ in range(number)]
            if (station, first) == (17, 16):
                words[0] = level
            body = b"".join(word.to_bytes(2, "big") for word in words) if function != 1 else bytes([rng.randrange(256)])
            request = bytes([station, function, 0, first, 0, number])
            now = (at * 10 + 2 * step) * 50_000_000
            for later, (way, text) in enumerate(
                (("out", request), ("in", bytes([station, function, len(body)]) + body))
            ):
                code = compute(MODBUS, text).to_bytes(2, "little")
                found.append(HeardBytes(now + later * 30_000_000, way, text + code))  # type: ignore[arg-type]
    return found


def test_replies_to_equal_requests_are_compared() -> None:
    rows = differences(registers(1607, 1), registers(4000, 2))
    assert [(row.offset, row.first, row.second) for row in rows] == [(3, "06", "0F"), (4, "47", "A0")]
    assert all("(asked 11 04 00 10 00 03)" in row.frame for row in rows)
    assert differences(registers(1607, 1), registers(1607, 2)) == []


def test_with_a_definition_replies_to_equal_requests_are_compared() -> None:
    rows = definition_differences("modbus-rtu", registers(1607, 1), registers(4000, 2))
    assert [(row.offset, row.first, row.second) for row in rows] == [(3, "06", "0F"), (4, "47", "A0")]
    assert {row.frame for row in rows} == {"reply_adu (asked station=17 function=4 address=16 count=3)"}
    assert definition_differences("modbus-rtu", registers(1607, 1), registers(1607, 2)) == []


def test_a_counter_in_requests_does_not_part_them() -> None:
    rows = differences(meter(40, 215, 2, 1), meter(200, 3000, 500, 4))
    assert [(row.offset, row.first, row.second) for row in rows] == [(4, "00", "09 to 0D, 5 values")]


def test_what_one_recording_has_alone_is_told() -> None:
    rows = definition_differences("modbus-rtu", registers(1607, 1), registers(1607, 2, extra=True))
    assert ("none", "20 frames") in [(row.first, row.second) for row in rows if row.field == "all of it"]
    rows = differences(registers(1607, 1), registers(1607, 2, extra=True))
    assert ("none", "20 frames") in [(row.first, row.second) for row in rows if row.field == "all of it"]


def test_other_protocols_are_told() -> None:
    (row,) = differences(registers(1607, 1), meter(40, 215, 2, 1))
    assert (row.frame, row.field, row.first) == ("all frames", "another protocol", "crc16-modbus")


def test_a_definition_that_reads_one_recording_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, chunks in (("one", registers(1607, 1)), ("two", meter(40, 215, 2, 1))):
        lines = [f"{'>' if chunk.direction == 'out' else '<'} {chunk.data.hex(' ')}\n" for chunk in chunks]
        (tmp_path / name).write_text("".join(lines), "utf-8")
    words = ["diff", str(tmp_path / "one"), str(tmp_path / "two"), "--with", "modbus-rtu", "--json"]
    assert main(words) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {(row["frame"], row["second"]) for row in rows} == {("request_adu", "none"), ("reply_adu", "none")}


def test_values_that_are_mostly_greater_differ() -> None:
    """Ranges that overlap at their ends differ; noise does not differ, nor do values that only increase."""

    def recording(base: int, seed: int) -> list[HeardBytes]:
        rng, found = random.Random(seed), []
        for at in range(40):
            text = bytes([0xA5, 9, base + rng.randrange(40), rng.randrange(256), 3 * at + 20 * (base > 60)])
            found.append(HeardBytes(at * 100_000_000, "in", text + compute(MODBUS, text).to_bytes(2, "little")))
        return found

    assert [difference.offset for difference in differences(recording(50, 1), recording(85, 2))] == [2]
    assert differences(recording(50, 1), recording(52, 2)) == []

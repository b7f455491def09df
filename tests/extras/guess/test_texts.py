"""Text fields of a guess, and the fields of a definition that differ between two recordings."""

from __future__ import annotations

import json
import random
import re
from pathlib import Path

import pytest

from framekit.cli.main import main
from framekit.codec.checks import compute
from framekit.definition.model.checks import ready_methods
from framekit.extras.guess.draft import drafted
from framekit.extras.guess.guess import guess
from framekit.extras.guess.model import HeardBytes


def fields_of(frames: list[bytes]) -> list[tuple[str, int, int, str]]:
    found = guess([HeardBytes(None, "", frame) for frame in frames])
    return [(field.name, field.offset, field.size, field.kind) for kind in found.kinds for field in kind.fields]


def meters(count: int) -> list[bytes]:
    return [b"\x02T1 %+06.1f C\x03" % (20 + at * at % 97 / 10) for at in range(count)]


def test_digits_beside_each_other_are_one_text() -> None:
    assert fields_of(meters(40)) == [
        ("start", 0, 1, "constant"), ("constant_1", 1, 3, "text"), ("text_1", 4, 6, "text"),
        ("constant_2", 10, 1, "text"), ("end", -2, 2, "constant"),
    ]  # fmt: skip


def test_what_is_printable_by_luck_is_no_text() -> None:
    rng = random.Random(5)
    frames = [bytes([0xA5, 0x41, rng.choice(b"ab"), rng.randrange(256), 0x5A]) for _ in range(40)]
    assert not [field for field in fields_of(frames) if field[3] == "text"]


def test_text_of_varying_size_is_written_as_text() -> None:
    rng, chunks = random.Random(6), []
    for _ in range(60):
        text = b"name " + bytes(rng.choice(b"abcdefgh") for _ in range(rng.choice([3, 5, 8])))
        frame = bytes([0xA5, len(text), rng.randrange(4)]) + text
        chunks.append(HeardBytes(None, "", frame + bytes([sum(frame) & 0xFF])))
    draft = drafted(guess(chunks), "names", "heard.txt")
    assert draft.problems == ()
    assert '{field: data, type: ascii, size: "length - 5"}' in draft.text
    assert "{field: constant_1, type: ascii, size: 5}  # always 'name '" in draft.text
    assert 'constant_1: "name "' in draft.vectors


def test_text_before_the_end_mark_ends_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A damaged frame ends at its mark, and does not delay the next frame."""
    rng = random.Random(7)
    chunks = []
    for at in range(40):
        chunks += [
            HeardBytes(None, "out", b"?%02d\r" % (at % 3)),
            HeardBytes(None, "in", b"!%d,%d\r" % (rng.randrange(9999), rng.randrange(99))),
        ]
    draft = drafted(guess(chunks), "lines", "heard.txt")
    assert draft.problems == ()
    assert "type: ascii, end: [0D]}" in draft.text and "size: rest" not in draft.text
    (tmp_path / "lines.yaml").write_text(draft.text, "utf-8")
    heard = b"!12,3\rX7,4\r!9,5\r"
    event = {"event": "data", "time_ns": 1, "channel": 1, "direction": "in", "bytes": heard.hex(" ")}
    capture = "\n".join(map(json.dumps, ({"capture": "framekit", "version": 1}, event)))
    (tmp_path / "heard.jsonl").write_text(capture + "\n", "utf-8")
    main(["decode", "--capture", str(tmp_path / "heard.jsonl"), str(tmp_path / "lines.yaml")])
    assert len(re.findall("told ", capsys.readouterr().out)) == 2


def asked_and_told(level: int, count: int) -> str:
    """Return polls of two registers: the level, and a counter."""

    def line(way: str, data: bytes) -> str:
        return f"{way} {(data + compute(ready_methods()['crc16-modbus'], data).to_bytes(2, 'little')).hex(' ')}\n"

    pairs = [
        line(">", bytes([3, 3, 0, 0, 0, 2])) + line("<", bytes([3, 3, 4, 0, level, 0, at])) for at in range(count)
    ]  # fmt: skip
    return "".join(pairs)


def test_fields_of_a_definition_that_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "cold").write_text(asked_and_told(215, 4), "utf-8")
    (tmp_path / "warm").write_text(asked_and_told(240, 7), "utf-8")
    words = ["diff", str(tmp_path / "cold"), str(tmp_path / "warm"), "--with", "modbus-rtu"]
    assert main(words) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert rows == [["reply_adu", "4", "pdu.read_holding_reply.values[1]", "D7", "F0"]]
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["field"] == "pdu.read_holding_reply.values[1]"
    assert main(["diff", str(tmp_path / "cold"), str(tmp_path / "cold"), "--with", "modbus-rtu"]) == 0
    assert capsys.readouterr().out == "no field differs\n"
    assert main(["diff", str(tmp_path / "cold"), str(tmp_path / "warm"), "--with", "nothing.yaml"]) == 2
    assert "there is no file 'nothing.yaml'" in capsys.readouterr().err


def test_numbers_that_count_are_no_difference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    definition = "protocol: own\nframes:\n  tell: {body: [{const: A5}, {field: n, type: u8}, {field: mode, type: u8, values: {1: off, 2: on}}, {text: Z}]}\n"  # noqa: E501
    (tmp_path / "own.yaml").write_text(definition, "utf-8")
    for name, first, mode in (("one", 10, 1), ("two", 90, 2)):
        frames = [bytes([0xA5, first + at, mode, 0x5A]).hex() for at in range(6)]
        (tmp_path / name).write_text("\n".join(frames), "utf-8")
    assert main(["diff", str(tmp_path / "one"), str(tmp_path / "two"), "--with", str(tmp_path / "own.yaml")]) == 0
    rows = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()[1:]]
    assert rows == ["tell 2 mode 1 (off) 2 (on)"]

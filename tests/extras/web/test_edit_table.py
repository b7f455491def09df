"""Tables of the editor: blocks and points as rows; changes keep comments, quotes and the order of keys."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
from extras.web.edit_world import answer_of, written

RUN = """# the plant
run: plant   # a name
memory: masterlogic
channels:
  1: {port: "sim:x", protocol: modbus-rtu, station: 1}
blocks:
  # first the levels
  0: {read: "40001", channel: 1, count: 2, into: MW0, every: 1 s}   # two words
  1:
    write: [40003, 40004]   # both
    station: 2
    from: [MW1, MW2]
    when: MW10.2

  # the last one
  2: {call: identify, with: {a: 1}, every: 1 min}
points:
  level: {address: "40001", unit: mm}   # of the tank
"""
BLOCKS = ["blocks"]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return written(tmp_path, RUN, "plant.run.yaml")


def applied(text: str, answer: dict[str, Any]) -> str:
    """Return a text after the edits of an answer."""
    assert "why" not in answer, answer
    units = text.encode("utf-16-le")
    for begin, end, inserted in sorted(answer["edits"], reverse=True):
        units = units[: 2 * begin] + inserted.encode("utf-16-le") + units[2 * end :]
    return units.decode("utf-16-le")


def changed(path: Path, row: str, key: str, value: str, old: str = "", *, text: str = RUN, where: Any = BLOCKS) -> str:
    return applied(text, answer_of("change", path, text, where=where, row=row, key=key, old=old, value=value))


def refused(path: Path, row: str, key: str, value: str, old: str = "", *, text: str = RUN, where: Any = BLOCKS) -> str:
    return str(answer_of("change", path, text, where=where, row=row, key=key, old=old, value=value)["why"])


def test_rows_of_blocks_and_points(path: Path) -> None:
    blocks, points = answer_of("look", path)["tables"]
    assert (blocks["where"], points["where"]) == (["blocks"], ["points"])
    titles = [title for title, _ in blocks["columns"]]
    first, second, third = blocks["rows"]
    assert dict(zip(titles, first["cells"], strict=True)) == {
        "Kind and address": ["read", "40001", True], "Channel": ["channel", "1", True], "Station": ["", "", True],
        "Size": ["count", "2", True], "Own address": ["into", "MW0", True], "Condition": ["every", "1 s", True],
        "Unless": ["", "", True], "Name": ["", "", True],
    }  # fmt: skip
    assert (second["name"], second["line"], second["cells"][0]) == ("1", 9, ["write", "[40003, 40004]", True])
    assert third["other"] == "with: {a: 1}"
    assert points["rows"][0]["cells"][0] == ["address", "40001", True]


@pytest.mark.parametrize(
    ("row", "key", "old", "value", "before", "after"),
    [
        ("0", "count", "count", "4", "count: 2", "count: 4"),
        ("0", "read", "read", "40007", '"40001", channel', '"40007", channel'),
        ("0", "write", "read", "40007", '{read: "40001"', '{write: "40007"'),
        ("0", "station", "", "3", "every: 1 s}", "every: 1 s, station: 3}"),
        ("0", "into", "into", "%MW4", "into: MW0", 'into: "%MW4"'),
        ("0", "into", "into", "[MW1, MW2]", "into: MW0", "into: [MW1, MW2]"),
        ("0", "when", "every", "a: b # c, d", "every: 1 s", 'when: "a: b # c, d"'),
        ("0", "count", "count", "", ", count: 2", ""),
        ("0", "read", "read", "", 'read: "40001", ', ""),
        ("0", "every", "every", "", ", every: 1 s", ""),
        ("1", "station", "station", "5", "station: 2", "station: 5"),
        ("1", "write", "write", "40003", "[40003, 40004]   # both", "40003   # both"),
        ("1", "count", "", "2", "when: MW10.2\n", "when: MW10.2\n    count: 2\n"),
        ("1", "station", "station", "", "    station: 2\n", ""),
        ("1", "every", "when", "1 s", "when: MW10.2", "every: 1 s"),
        ("3", "read", "", "40009", "every: 1 min}\n", "every: 1 min}\n  3: {read: 40009}\n"),
    ],
)
def test_a_change_replaces_only_its_characters(
    path: Path, row: str, key: str, old: str, value: str, before: str, after: str
) -> None:
    assert RUN.count(before) == 1
    assert changed(path, row, key, value, old) == RUN.replace(before, after)


def test_a_row_after_a_block_of_lines_follows_it(path: Path) -> None:
    text = RUN[: RUN.index("\n  # the last one")] + "\n"
    assert changed(path, "2", "read", "40001", text=text) == text.replace(
        "when: MW10.2\n", "when: MW10.2\n  2: {read: 40001}\n"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("run: a\n", "run: a\nblocks:\n  0: {read: M1}\n"),
        ("run: a", "run: a\nblocks:\n  0: {read: M1}"),
        ("run: a\nblocks:\n", "run: a\nblocks:\n  0: {read: M1}\n"),
        ("run: a\nblocks:   # none\nset: {M1: 2}\n", "run: a\nblocks:   # none\n  0: {read: M1}\nset: {M1: 2}\n"),
        ("run: a\nblocks: {}\n", "run: a\nblocks: {0: {read: M1}}\n"),
        ("run: a\nblocks: {1: {read: M2}}\n", "run: a\nblocks: {1: {read: M2}, 0: {read: M1}}\n"),
    ],
)  # fmt: skip
def test_the_first_row_of_a_section(path: Path, text: str, expected: str) -> None:
    assert changed(path, "0", "read", "M1", text=text) == expected


def test_points_of_a_file_and_of_a_set(path: Path, tmp_path: Path) -> None:
    points = written(tmp_path, "points: a\nvalues:\n  x: {address: M1}  # one\n", "a.points.yaml")
    text = points.read_text("utf-8")
    assert changed(points, "y", "address", "M2", text=text, where=["values"]) == text + "  y: {address: M2}\n"
    sets = "run: a\nsets:\n  2:\n    blocks:\n      5: {read: M1}   # 😀\n"
    assert changed(path, "5", "read", "M7", "read", text=sets, where=["sets", "2", "blocks"]) == sets.replace(
        "M1", "M7"
    )


def test_a_row_is_removed_with_its_line(path: Path) -> None:
    answer = answer_of("remove", path, where=BLOCKS, row="1")
    begin, end = RUN.index("  1:\n    write"), RUN.index("\n  # the last one")
    assert applied(RUN, answer) == RUN[:begin] + RUN[end:]
    assert "no row '7'" in answer_of("remove", path, where=BLOCKS, row="7")["why"]
    assert "last row" in answer_of("remove", path, where=["points"], row="level")["why"]


def test_what_a_table_cannot_write_is_refused(path: Path) -> None:
    assert "write a list as" in refused(path, "0", "into", "[MW1", "into")
    assert "on one line" in refused(path, "0", "into", "a\nb", "into")
    assert "no value of the table" in refused(path, "0", "secret", "1")
    assert "no value of the table" in refused(path, "0", "into", "x" * 400, "into")
    assert "no such table" in refused(path, "0", "read", "M1", where=["channels"])
    assert "'every' already" in refused(path, "0", "every", "2 s", "into")
    assert "the only value" in refused(path, "0", "read", "", "read", text="run: a\nblocks: {0: {read: M1}}\n")
    assert "no mapping" in refused(path, "0", "read", "M1", text="run: a\nblocks: {0: }\n")
    assert "correct the errors" in refused(path, "0", "read", "M1", text="run: [")
    assert "write a value" in refused(path, "9", "read", " ")


def test_hostile_values_change_nothing_else(path: Path) -> None:
    values = ["}", "a, b: c", "'", '"', "&a", "*a", "!x", "|", ">", "- a", "? a", "%", "@x", "`x", "#", "a #b", "a: b",
              "{a: 1}", "{a: 1}, b: 2", "[1], x: 2", "~", "\\", "\u2028", "😀", "null", "0x10", "a  b"]  # fmt: skip
    for value in values:
        answer = answer_of("change", path, where=BLOCKS, row="0", key="into", old="into", value=value)
        if "why" in answer:
            continue
        text = applied(RUN, answer)
        found = next(table for table in answer_of("look", path, text)["tables"] if table["where"] == BLOCKS)
        assert len(found["rows"]) == 3
        cells = found["rows"][0]["cells"]
        assert cells[4][:2] == ["into", value]
        assert cells[5] == ["every", "1 s", True]


def test_many_changes_in_a_row_keep_every_comment(path: Path) -> None:
    random_, text = random.Random(4), RUN
    keys = ("station", "count", "into", "every", "unless", "name")
    for number in range(60):
        row, key = random_.choice("0123"), random_.choice(keys)
        value = random_.choice(["", "1", "[MW1, MW2]", "a, b", "%MW4"])
        rows = next(table for table in answer_of("look", path, text)["tables"] if table["where"] == BLOCKS)["rows"]
        present = {cell[0] for shown_row in rows if shown_row["name"] == row for cell in shown_row["cells"]}
        old = key if key in present else ""
        answer = answer_of("change", path, text, where=BLOCKS, row=row, key=key, old=old, value=value)
        if "why" not in answer:
            text = applied(text, answer)
        for comment in (
            "# the plant",
            "# a name",
            "# first the levels",
            "# two words",
            "# both",
            "# the last one",
            "# of the tank",
        ):
            assert comment in text, number
    assert text != RUN

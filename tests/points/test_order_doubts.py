"""Points whose words are probably read in the wrong order: the value stays, and a trouble has both numbers."""

from __future__ import annotations

from pathlib import Path

import pytest
from points.test_points import run_of

from framekit.memory.views import view_of
from framekit.memory.word_order import likely_with_reversed_words, order_of, reversed_view

HEAT = '"40001": [0x42F6, 0xE979]'
"""123.456 as float32, high word first."""


def doubts_after(folder: Path, points: str, values: str, time: str = "3 s") -> list[str]:
    """Return the reasons of the troubles after a time; all values are good."""
    run = run_of(folder, points, values)
    run.run_for(time)
    assert {value.quality for value in run.points.now()} == {"good"}
    found = [str(trouble) for trouble in run.status().troubles]
    assert run.problems == []  # a doubt is no failure of the run
    run.stop()
    return found


def test_a_float_in_the_wrong_order_is_reported_with_both_numbers(tmp_path: Path) -> None:
    point = 'heat: {channel: 1, address: "40001", type: float32, unit: kW}'
    assert doubts_after(tmp_path, point, HEAT) == [
        "order of words: heat reads -1.8833671e+25 kW, with order: ABCD it would be 123.456 kW – "
        "if that is the right value, write the order into the point"
    ]


@pytest.mark.parametrize(
    ("point", "values"),
    [
        ('heat: {channel: 1, address: "40001", type: float32, order: ABCD}', HEAT),
        ('small: {channel: 1, address: "40001", type: float32, order: ABCD}', '"40001": [0x3089, 0x705F]'),
        ('zero: {channel: 1, address: "40001", type: float32}', '"40001": [0, 0]'),
        ('count: {channel: 1, address: "40001", type: uint32, order: CDAB}', '"40001": [0, 3]'),
        ('count: {channel: 1, address: "40001", type: uint32}', '"40001": [3, 0]'),
        ('count: {channel: 1, address: "40001", type: uint32}', '"40001": [1, 3]'),
        ('word: {channel: 1, address: "40001"}', '"40001": [3]'),
        ('digits: {channel: 1, address: "40001", type: bcd32}', '"40001": [0, 3]'),
    ],
    ids=["right", "also-uncommon", "zero", "order-given", "low-word", "both-words", "one-word", "bcd"],
)  # fmt: skip
def test_no_doubt_about_other_values(tmp_path: Path, point: str, values: str) -> None:
    assert doubts_after(tmp_path, point, values) == []


def test_a_small_whole_number_in_the_high_word_is_in_doubt_without_order(tmp_path: Path) -> None:
    point = 'count: {channel: 1, address: "40001", type: uint32, scale: 0.1, unit: h}'
    assert doubts_after(tmp_path, point, '"40001": [0, 3]')[0].startswith(
        "order of words: count reads 19660.8 h, with order: ABCD it would be 0.3 h – "
    )


def test_one_trouble_names_all_points(tmp_path: Path) -> None:
    points = "\n".join(
        f'heat{number}: {{channel: 1, address: "{40001 + 2 * number}", type: float32}}' for number in range(5)
    )
    values = ", ".join(f'"{40001 + 2 * number}": [0x42F6, 0xE979]' for number in range(5))
    (reason,) = doubts_after(tmp_path, points, values)
    assert reason.count("it would be 123.456") == 3 and "; and 2 more – if" in reason


def test_the_doubt_ends_after_many_common_values(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'heat: {channel: 1, address: "40001", type: float32}', HEAT)
    run.run_for("3 s")
    assert len(run.status().troubles) == 1
    store = run.simulated[0][1]
    counts = []
    for number in range(24):
        store.memory.area("holding").write("word", 0, [number, 0x42F6])
        run.run_for("1 s")
        counts.append(len(run.status().troubles))
    run.stop()
    assert counts[:18] == [1] * 18 and counts[-1] == 0


@pytest.mark.parametrize(
    ("type_", "order", "number", "other"),
    [
        ("float32", "ABCD", -1.8833671224316946e25, 123.45600128173828),
        ("float64", "CDAB", 8.087e-320, 1.0),
        ("float32", "CDAB", 123.456, None),
        ("int64", "DCBA", 7 << 48, 7),
        ("uint32", "CDAB", 0, None),
    ],
)
def test_a_number_is_likely_with_its_words_reversed(type_: str, order: str, number: float, other: float | None) -> None:
    view = view_of(type_, order)
    assert likely_with_reversed_words(view, number) == other
    assert order_of(view) == order and order_of(reversed_view(reversed_view(view))) == order

"""Words of messages: lists, near misses, times for people."""

from __future__ import annotations

import pytest

from framekit.definition.problems import is_nearly, listed
from framekit.definition.times import NEVER, readable_time


def test_lists_of_things() -> None:
    assert (listed(["a"]), listed([1, 2]), listed(("a", "b", "c"))) == ("a", "1 and 2", "a, b and c")


@pytest.mark.parametrize(
    ("word", "other", "nearly"),
    [("station", "staton", True), ("station", "station", False), ("station", "stations", False),
     ("values", "value", True), ("into", "from", False), ("from", "form", True)],
)  # fmt: skip
def test_near_misses(word: str, other: str, nearly: bool) -> None:
    assert is_nearly(word, other) is nearly


@pytest.mark.parametrize(
    ("time", "text"),
    [(12_499_996, "12.5 ms"), (319_270_829, "319.271 ms"), (1_250_000_000, "1.25 s"), (2_000, "0.002 ms"), (0, "0 ms"),
     (3_600_000_000_000, "3600 s"), (NEVER, "never")],
)  # fmt: skip
def test_times_for_people(time: int, text: str) -> None:
    assert readable_time(time) == text

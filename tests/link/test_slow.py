"""Warnings about stations that answer after the time limit."""

from __future__ import annotations

import pytest

from framekit.link.slow import NO_PROMPT, REMEMBERED, WELL, WELL_TIME, Prompt, SlowStation, SlowStations

SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("station", "seconds", "limit", "text"),
    [
        (7, 3.5007, "reply_timeout", "station 7 answers after 3.5 s: set reply_timeout to 4 s or more"),
        (7, 0.13, "reply_timeout", "station 7 answers after 130 ms: set reply_timeout to 150 ms or more"),
        ("A", 20, "t_max", "station A answers after 20 s: set t_max to 25 s or more"),
        (None, 1.5, "reply_timeout", "the other side answers after 1.5 s: set reply_timeout to 2 s or more"),
        (b"", 9.5, "", "the other side answers after 9.5 s: its time limit has to be 15 s or more"),
    ],
)
def test_the_sentence(station: object, seconds: float, limit: str, text: str) -> None:
    assert str(SlowStation(station, int(seconds * SECOND), limit)) == text


def test_a_slow_station_is_reported_once_and_again_when_its_time_changes_and_when_it_is_well() -> None:
    reports: list[tuple[int, bool]] = []
    slow = SlowStations()
    slow.on_change = lambda station, is_slow: reports.append((station.time // SECOND, is_slow))
    for at, seconds in enumerate((4, 4, 3, 5, 8, 4, 8, 9, 8)):
        slow.answered_late(7, seconds * SECOND, "reply_timeout", at * SECOND)
    assert reports == [(4, True), (8, True)]
    for _ in range(WELL + 5):
        slow.answered_in_time(7, 30 * SECOND)
        slow.answered_in_time(8, 30 * SECOND)
    assert [station.time for station in slow.present] == [8 * SECOND] and slow.number == 1
    slow.answered_in_time(7, 8 * SECOND + WELL_TIME)
    assert reports == [(4, True), (8, True), (8, False)] and slow.number == 0


def test_a_station_that_is_slow_again_after_an_hour_is_reported_again() -> None:
    reports: list[bool] = []
    slow = SlowStations()
    slow.on_change = lambda station, is_slow: reports.append(is_slow)
    for begin in (0, 600 * SECOND, 600 * SECOND + WELL_TIME + REMEMBERED):
        slow.answered_late(7, SECOND, "reply_timeout", begin)
        for _ in range(WELL):
            slow.answered_in_time(7, begin + WELL_TIME)
    assert reports == [True, False, True, False] and slow.number == 0


ADVICE = "station 7 answers after 1 s: set t to 1.5 s or more"
JUST_LATE = f"{ADVICE}; if that does not help, a gateway or an adapter keeps replies"
KEPT = "station 7 answers only when it is asked again: a longer t does not help, a gateway or an adapter keeps replies"


@pytest.mark.parametrize(
    ("prompts", "reported"),
    [
        ([Prompt("request", True)] * 6, [JUST_LATE]),
        ([Prompt("request", True)] * 3 + [Prompt("request", False)] * 3, [JUST_LATE, KEPT]),
        ([Prompt("request", False)] * 6, [KEPT]),
        ([Prompt("request", False), Prompt("request", False), NO_PROMPT] * 2, [ADVICE]),
        ([NO_PROMPT] + [Prompt("request", False)] * 9, [ADVICE]),
        ([NO_PROMPT] + [Prompt("request", False)] * 10, [ADVICE, KEPT]),
    ],
    ids=["just after the limit", "pauses show it", "after pauses", "not in sequence", "in doubt", "many"],
)  # fmt: skip
def test_replies_that_come_with_the_next_request(prompts: list[Prompt], reported: list[str]) -> None:
    reports: list[str] = []
    slow = SlowStations()
    slow.on_change = lambda station, is_slow: reports.append(str(station))
    for at, prompt in enumerate(prompts):
        slow.answered_late(7, SECOND, "t", at * SECOND, prompt)
    assert reports == reported

"""What is said of stations that answer after the time limit."""

from __future__ import annotations

import pytest

from framekit.link.slow import WELL, SlowStation, SlowStations

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
    for seconds in (4, 4, 3, 5, 8, 8):
        slow.answered_late(7, seconds * SECOND, "reply_timeout")
    assert reports == [(4, True), (8, True)]
    for _ in range(WELL - 1):
        slow.answered_in_time(7)
        slow.answered_in_time(8)
    assert [one.time for one in slow.present] == [8 * SECOND] and slow
    slow.answered_in_time(7)
    assert reports == [(4, True), (8, True), (8, False)] and not slow

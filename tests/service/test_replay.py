"""Captured bytes sent again, with their times or without, on the virtual clock."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from framekit.api.monitor import Replay
from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault
from framekit.transport.clock import VirtualClock
from framekit.transport.port import LineEvent
from framekit.transport.simulated_line import SimulatedLine

MS = 1_000_000
LINE = LineFormat(9600)
EVENTS = [
    LineEvent("data", 500 * MS, "out", b"first"),
    LineEvent("data", 520 * MS, "in", b"answer"),
    LineEvent("break", 530 * MS, "out"),
    LineEvent("data", 1500 * MS, "out", b"second"),
    LineEvent("data", 1502 * MS, "out", b"third"),
]


class Hearing:
    """The other end of the line: records bytes with the time of their first bit (ms since the start of the replay)."""

    def __init__(self) -> None:
        self.heard: list[tuple[float, bytes]] = []
        self.port: object = None

    def opened(self, now: int) -> None: ...

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self.heard.append((round((now - len(data) * LINE.character_time) / MS, 1), data))

    def line_break(self, now: int) -> None: ...

    def sent(self, now: int) -> None: ...

    def closed(self, now: int, reason: str) -> None: ...

    def control(self, lines: Mapping[str, bool], now: int) -> None: ...


def replayed(**options: object) -> tuple[list[tuple[float, bytes]], Replay, list[str]]:
    clock = VirtualClock()
    line = SimulatedLine(clock, LINE)
    hearing, ends = Hearing(), list[str]()
    line.port("other").open(hearing)
    replay = Replay(EVENTS, line.port("mine"), clock, ends.append, **options)  # type: ignore[arg-type]
    replay.start()
    clock.run_for(10_000 * MS)
    return hearing.heard, replay, ends


def test_at_the_times_it_was_sent() -> None:
    """`third` was written during the transmission of `second`, so it follows without a pause."""
    heard, replay, ends = replayed()
    assert heard == [(0, b"first"), (1000, b"second"), (round(1000 + 6 * LINE.character_time / MS, 1), b"third")]
    assert ends == [""]
    assert (replay.pieces, replay.pieces_sent, replay.bytes_sent) == (3, 3, 16)


def test_ten_times_faster() -> None:
    assert [time for time, _ in replayed(speed_up=10)[0]][:2] == [0, 100]


def test_as_fast_as_it_goes() -> None:
    heard, replay, _ = replayed(speed_up=None)
    assert b"".join(data for _, data in heard) == b"firstsecondthird"
    assert replay.ended_at - replay.began == 16 * LINE.character_time


def test_the_other_direction_begins_with_the_first_bit() -> None:
    assert [data for _, data in replayed(direction="in")[0]] == [b"answer"]


@pytest.mark.parametrize("stop_after", [0, 100 * MS])
def test_stopped(stop_after: int) -> None:
    clock = VirtualClock()
    ends: list[str] = []
    replay = Replay(EVENTS, SimulatedLine(clock, LINE).port("mine"), clock, ends.append)
    replay.start()
    clock.run_for(stop_after)
    replay.stop()
    clock.run_for(10_000 * MS)
    assert ends == ["stopped"]
    assert replay.pieces_sent <= 1

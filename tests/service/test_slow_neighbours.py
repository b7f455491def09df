"""A slow station and its neighbours on one line: how long the neighbours are without values, and no value is wrong."""

from __future__ import annotations

from itertools import pairwise, product
from pathlib import Path

import pytest
from spread import spread

from framekit.run.block_state import BlockState
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
FIRST = {"modbus-rtu": "40001", "modbus-ascii": "40001", "mldp": "D1", "ge-rtu": "40001"}
SLOW_FROM = 20
"""Time at which station 2 becomes slow (s)."""


class Line:
    """Three stations with places far apart, each with a value of its own; all points are read once a second."""

    def __init__(
        self, folder: Path, protocol: str, faults: str, places: int, params: str = "reply_timeout: 1 s", line: str = ""
    ) -> None:  # fmt: skip
        first = FIRST[protocol]
        stem, number = first.rstrip("0123456789"), int(first.lstrip("D"))
        addresses = [f"{stem}{number + 500 * place}" for place in range(places)]
        self.held: dict[str, int] = {}
        points = ""
        for station in (1, 2, 3):
            values = {address: 1000 * station + place for place, address in enumerate(addresses)}
            listed = ", ".join(f'"{address}": {value}' for address, value in values.items())
            text = f"device: d{station}\nprotocol: {protocol}\nstation: {station}\nmemory: {{set: {{{listed}}}}}\n"
            if station == 2 and faults:
                text += f"faults: {{seed: 2, rules: [{faults}]}}\n"
            (folder / f"d{station}.device.yaml").write_text(text)
            for place, (address, value) in enumerate(values.items()):
                name = f"p{station}_{place}"
                self.held[name] = value
                points += f'  {name}: {{channel: 1, station: {station}, address: "{address}", every: 1 s}}\n'
        port = ",".join(f"d{station}.device.yaml" for station in (1, 2, 3))
        path = folder / "r.run.yaml"
        path.write_text(
            f'run: r\nchannels:\n  1: {{port: "sim:{port}", protocol: {protocol}, '
            f"params: {{{params}}}, faults: {{seed: 3, rules: [{line}]}}}}\npoints:\n{points}"
        )
        self.clock = VirtualClock()
        self.good: dict[str, list[int]] = {name: [0] for name in self.held}
        """Times of good values, by point."""
        self.wrong: list[str] = []
        self.service = RunService(load_run(path), self.clock, on_end=self._ended)
        self.service.start()

    def _ended(self, state: BlockState, ok: bool) -> None:
        if ok:
            self.good[state.block.name].append(self.clock.now())

    def run_until(self, time: float) -> None:
        while self.clock.now() < time * SECOND:
            self.clock.run_for(SECOND)
            for point in self.service.points.table:
                if point.value is not None and point.value != self.held[point.name]:
                    self.wrong.append(f"{self.clock.now() / SECOND} {point.name}: {point.value}")

    def old(self, station: int, most: float, end: float) -> float:
        """Return the part of the time in which the last value of a point of a station is older than `most` (s)."""
        points = [times for name, times in self.good.items() if name.startswith(f"p{station}_")]
        gaps = [later - earlier for times in points for earlier, later in pairwise([*times, int(end * SECOND)])]
        return sum(max(0.0, gap / SECOND - most) for gap in gaps) / (end * len(points))

    def gap(self, station: int, begin: float, end: float) -> float:
        """Return the longest time between two values of a point of a station, in a span of time (s)."""
        gaps = [0]
        for name, times in self.good.items():
            if name.startswith(f"p{station}_"):
                inside = [time for time in times if begin * SECOND <= time <= end * SECOND]
                gaps += [
                    later - earlier for earlier, later in pairwise([int(begin * SECOND), *inside, int(end * SECOND)])
                ]
        return max(gaps) / SECOND


def test_neighbours_of_a_slow_station_wait_for_one_exchange_with_it(tmp_path: Path) -> None:
    """The device answers one request after the other, 2.5 time limits late: the third request gets a reply.

    A late reply collides with the reply of a neighbour now and then; its request is then open, as it has no reply.
    """
    line = Line(tmp_path, "modbus-rtu", f"{{fault: delay, time: 2500 ms, from: {SLOW_FROM} s}}", 1)
    line.run_until(320)
    assert line.wrong == []
    for neighbour in (1, 3):
        assert line.gap(neighbour, 10, 320) < 4, "a period of 1 s, and the exchange of 2.5 s; it was 23 s"
        assert len(line.good[f"p{neighbour}_0"]) > 260, "it was 137 and 205"
    assert len(line.good["p2_0"]) > 35


@pytest.mark.parametrize(("timeout", "before"), [("1 s", 25), ("3 s", 20)])
def test_rare_faults_of_a_line_cost_few_values(tmp_path: Path, timeout: str, before: int) -> None:
    """One reply in 500 comes 2.5 s late, one is lost, and one is damaged.

    A proof with one or two open requests takes few quick replies, and a lost reply is not taken for a very late one.
    """
    kinds = "{fault: delay, time: 2500 ms", "{fault: no_reply", "{fault: wrong_check"
    faults = ", ".join(f"{kind}, rate: 1/500}}" for kind in kinds)
    line = Line(tmp_path, "modbus-rtu", "", 4, f"reply_timeout: {timeout}", faults)
    line.run_until(1200)
    assert line.wrong == []
    for station in (1, 2, 3):
        old = line.old(station, 3, 1200)
        assert old <= 0.1, f"a tenth of the time without a value of the last 3 s; it was {before} %"


ROWS = list(product(FIRST, (1.2, 1.5, 2.5, 3.5, 6.5, 20), (0, 2), (1, 3), ("", ", rate: 10 %")))


@pytest.mark.parametrize(("protocol", "times", "retries", "places", "rate"), spread(ROWS, 24))
def test_a_slow_station_costs_its_neighbours_its_tries(
    protocol: str, times: float, retries: int, places: int, rate: str, tmp_path: Path
) -> None:
    """A proof takes some time limits more. Later or single late replies cost more, now and then."""
    well = SLOW_FROM + 120
    rule = f"{{fault: delay, time: {int(1000 * times)} ms, from: {SLOW_FROM} s, until: {well} s{rate}}}"
    line = Line(tmp_path, protocol, rule, places, f"reply_timeout: 1 s, retries: {retries}")
    line.run_until(well + 60)
    assert line.wrong == []
    for neighbour in (1, 3):
        most = 1 + (1 + retries) + 8 if times <= 3.5 and places == 1 and not rate else 60
        assert line.gap(neighbour, 10, well + 60) < most
    assert line.gap(2, well + 30, well + 60) < 15, "right values 30 s after the device is well, and then again"

"""A process that stalls reads replies late and together, after the time limits are over: no wrong value is stored.

The machine may be busy, or suspended, in any phase of an exchange. A time limit ends only when the port has no unread
bytes, so a reply that arrived in time is taken, and a late reply is known to be late.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache, partial
from itertools import product
from pathlib import Path
from random import Random
from typing import Any

import pytest
from service.late_world import LINES, MS, SECOND, LateWorld, OverlappingPort
from service.stalled_process import Plan, StalledClock, StalledPort, once
from spread import WHOLE, many, spread

from framekit.link.services.client import TransferResult
from framekit.run.model import Channel, FaultRule
from framekit.runfile.devices import Device
from framekit.runfile.run_file import load_run
from framekit.service import channel as channels
from framekit.service.client import Polling
from framekit.service.device import DeviceService, stores_of
from framekit.service.run import RunService
from framekit.transport.clock import Clock, VirtualClock
from framekit.transport.port import Port
from framekit.transport.simulated_line import SimulatedLine

NAMES = ("modbus-rtu", "mldp", "ge-rtu")
LATE = (0, 0.5, 1.5, 6.5, 20)
"""How late three replies in ten are (of a run one in ten), in time limits."""
STALLS = (0.1, 0.4, 1, 2, 5, 20, 60)
"""Durations of the stall (s)."""
ROOMS = (1, 4, 64)
"""Largest number of bytes that a read returns: with few bytes, stalls occur between two reads of one frame."""
MANY = int(os.environ.get("FRAMEKIT_EXCHANGES") or many(600, 2000))


def some_late(times: float, seed: int, share: float = 0.3) -> Callable[[int], int]:
    random = Random(seed)
    return lambda now: int(times * SECOND) if random.random() < share else 0


def world_of(name: str, late: float, retries: int, is_network: bool, stalls: Plan, **more: Any) -> LateWorld:
    return LateWorld(
        name, lateness=some_late(late, 5), stalls=stalls, is_network=is_network, retries=retries,
        reply_timeout=SECOND, **more,
    )  # fmt: skip


@cache
def interactions(name: str, late: float, retries: int, is_network: bool, room: int = 64) -> int:
    """Return the number of places for a stall in the first eight exchanges."""
    world = world_of(name, late, retries, is_network, lambda number: 0, room=room)
    world.exchanges(8)
    assert world.wrong == [] and world.process.interactions >= 40
    return world.process.interactions


def check(
    name: str, late: float, retries: int, is_network: bool, number: int, stall: float, reads_first: bool, room: int
) -> None:
    plan = once(number, int(stall * SECOND))
    world = world_of(name, late, retries, is_network, plan, reads_first=reads_first, room=room)
    world.exchanges(10)
    assert world.wrong == []
    assert set(world.outcomes) <= {"ok", "no_reply"}
    assert late or set(world.outcomes) == {"ok"}, "a reply that arrived in time is no late reply"


CASES = list(product(NAMES, LATE, (0, 2), (False, True), STALLS, (False, True), ROOMS))


@pytest.mark.parametrize(
    ("name", "late", "retries", "is_network", "stall", "reads_first", "room"), spread(CASES, 4, part=47)
)
def test_a_stall_stores_nothing_wrong(
    name: str, late: float, retries: int, is_network: bool, stall: float, reads_first: bool, room: int
) -> None:
    for number in range(1 + CASES.index((name, late, retries, is_network, stall, reads_first, room)) % 7,
                        interactions(name, late, retries, is_network, room), 7):  # fmt: skip
        check(name, late, retries, is_network, number, stall, reads_first, room)


@pytest.mark.long
@pytest.mark.parametrize(("name", "is_network"), list(product(NAMES, (False, True))))
def test_no_stall_in_any_phase_stores_anything_wrong(name: str, is_network: bool) -> None:
    """Each 61st phase, in each case other phases; each phase if the whole is asked for."""
    step = many(61, 1)
    for case, (late, retries, stall, reads_first) in enumerate(product(LATE, (0, 2), STALLS, (False, True))):
        room = ROOMS[case % 4 % 3]
        for number in range(1 + case % step, interactions(name, late, retries, is_network, room), step):
            check(name, late, retries, is_network, number, stall, reads_first, room)


@pytest.mark.long
@pytest.mark.parametrize(("name", "late"), list(product(NAMES, LATE)))
def test_many_stalls_store_nothing_wrong(name: str, late: float) -> None:
    for retries, is_network, reads_first in product((0, 2), (False, True), (False, True)):
        random = Random(f"{name} {late}")

        def plan(number: int, random: Random = random) -> int:
            return int(random.choice(STALLS) * SECOND) if random.random() < 0.02 else 0

        world = world_of(name, late, retries, is_network, plan, reads_first=reads_first)
        world.exchanges(MANY // 8)
        assert world.wrong == []
        assert set(world.outcomes) <= {"ok", "no_reply", "late_replies"}


@pytest.mark.parametrize(("name", "room"), list(product(NAMES, ROOMS)))
def test_a_reply_that_arrived_during_a_stall_is_in_time(name: str, room: int) -> None:
    """It is neither late, nor is its request repeated, however long the stall was."""
    for number in range(1, interactions(name, 0, 2, True, room)):
        world = world_of(name, 0, 2, True, once(number, 60 * SECOND), room=room)
        world.exchanges(8)
        counters = world.service.engine.counters
        assert (counters.late, counters.repeated) == (0, 0) and set(world.outcomes) == {"ok"}


READ_IN_PIECES = (*NAMES, "modbus-ascii")


@pytest.mark.parametrize(
    ("name", "is_network", "stall", "room"), spread(product(READ_IN_PIECES, (False, True), STALLS, ROOMS), 4, part=5)
)
def test_a_stall_between_two_reads_of_a_frame_damages_no_frame(
    name: str, is_network: bool, stall: float, room: int
) -> None:
    """The rest of the frame waits in the port: that it is read late is no evidence of a pause on the line."""

    def world_with(plan: Plan) -> LateWorld:
        world = LateWorld(name, lateness=lambda now: 0, stalls=plan, is_network=is_network, room=room)
        world.exchanges(6)
        return world

    places = world_with(lambda number: 0).process.interactions
    for number in range(1, places, 1 + places // 30):
        world = world_with(once(number, int(stall * SECOND)))
        counters = world.service.engine.counters
        assert (counters.bad, counters.noise_bytes) == (0, 0) and set(world.outcomes) == {"ok"}, number


@pytest.mark.parametrize("name", ("modbus-rtu", "ge-rtu"))
def test_a_frame_that_stops_is_damaged_although_the_port_has_no_exact_times(name: str) -> None:
    """The alarm of the gap rings while the port is empty: the loop has observed the pause."""
    broken = FaultRule(kind="truncate", begin=2 * SECOND, end=60 * SECOND)
    world = LateWorld(name, broken, stalls=lambda number: 0, retries=0, reply_timeout=5 * SECOND, watched=True)
    assert world.exchange() == "ok"
    world.clock.run_until(3 * SECOND)
    assert world.exchange() == "damaged_reply"
    (bad,) = [seen for seen in world.seen if seen.kind == "bad"]
    assert bad.at < 3.2 * SECOND


@pytest.mark.parametrize(("name", "late", "stall"), spread(product(NAMES, LATE, STALLS), 4, part=3))
def test_after_a_stall_the_loop_reads_first_where_the_port_does_not_know_of_unread_bytes(
    name: str, late: float, stall: float
) -> None:
    for number in range(1 + int(10 * stall) % 5, interactions(name, late, 0, True), 5):
        world = world_of(name, late, 0, True, once(number, int(stall * SECOND)))
        (port,) = world.process.ports
        port.knows_unread = False
        world.exchanges(10)
        assert world.wrong == []


def test_a_time_limit_ends_in_spite_of_bytes_that_come_without_end() -> None:
    """A port that always has unread bytes, such as under a flood, delays no time limit for long."""
    lost = FaultRule(kind="no_reply", begin=2 * SECOND, end=60 * SECOND)
    world = LateWorld("modbus-rtu", lost, stalls=lambda number: 0, retries=0, reply_timeout=SECOND)
    assert world.exchange() == "ok"
    world.clock.run_until(3 * SECOND)
    (port,) = world.process.ports
    port.never_empty = True
    assert world.exchange() == "no_reply" and world.clock.now() < 5 * SECOND


def note_wrong(wrong: list[TransferResult], value: int, result: TransferResult) -> None:
    """Note a result that has another value than this."""
    if result.ok and list(result.values) != [value]:
        wrong.append(result)


def test_polling_stores_nothing_wrong() -> None:
    for number, late, stall in product(range(1, 80, 9), (1.5, 6.5), (0.4, 5, 60)):
        world = world_of("modbus-rtu", late, 0, True, once(number, int(stall * SECOND)))
        wrong: list[TransferResult] = []
        polls = []
        for at, place in enumerate(world.line.places[:4]):
            memory_place = world.places[at]
            world.device.memory.write(memory_place.area, memory_place.unit, memory_place.start, [1001 + at])

            polls.append(Polling(
                world.service, place, station=3, unit=None, count=1, every=300 * MS,
                on_result=partial(note_wrong, wrong, 1001 + at),
            ))  # fmt: skip
            polls[-1].start()
        world.clock.run_for(100 * SECOND)
        assert wrong == [] and world.process.interactions > 80


# ---- runs: blocks, points, jobs and single reads on one channel -----------------------------------------------------

DEVICES = {
    "modbus-rtu": ("", "{set: {40001: VALUES}}"),
    "ge-rtu": ("", "{set: {40001: VALUES}}"),
    "mldp": ("", "{profile: masterlogic, set: {D100: VALUES}}"),
}
RUN = """\
run: r
memory: masterlogic
dead: no
jobs: {profile: ge-channels, status: P0}
channels:
  1: {port: "sim:d.device.yaml", protocol: NAME, station: 3, params: {reply_timeout: 1 s, retries: RETRIES}}
blocks:
  0: {read: "AT0", into: D0, every: 500 ms}
  1: {read: "AT1", into: D1, every: 700 ms}
  2: {read: "AT2", into: D2, every: 900 ms, count: 2}
  9: {job: 5, read: "AT4", count: 1, into: D4, channel: 1, every: 600 ms, status: D20, once: yes}
points:
  fifth: {channel: 1, address: "AT5", every: 800 ms}
  sixth: {channel: 1, address: "AT6", every: 1100 ms}
"""


class StalledRun:
    """A run on one channel, whose process stalls; the device has the value 1001 at the first place, then 1002 …"""

    def __init__(self, folder: Path, name: str, late: float, retries: int, is_network: bool, plan: Plan) -> None:
        self.clock = VirtualClock()
        self.process = StalledClock(self.clock, plan)
        self.is_network, self.lateness = is_network, some_late(late, 7, 0.1)
        self.places = LINES[name].places
        more, memory = DEVICES[name]
        values = memory.replace("VALUES", str([1001 + at for at in range(7)]))
        (folder / "d.device.yaml").write_text(f"device: d\nprotocol: {name}\nstation: 3\nmemory: {values}\n{more}")
        text = RUN.replace("NAME", name).replace("RETRIES", str(retries))
        for at, place in enumerate(self.places):
            text = text.replace(f"AT{at}", place)
        (folder / "r.run.yaml").write_text(text)
        self.wrong: list[str] = []
        self.service = RunService(load_run(folder / "r.run.yaml"), self.process)  # type: ignore[arg-type]
        self.service.start()
        self.clock.run_for(10 * MS)
        self.process.is_armed = True
        self.reads = 0
        self._read()

    def port_for(self, channel: Channel, devices: list[Device], clock: Clock) -> tuple[Port, list[DeviceService]]:
        line = SimulatedLine(self.clock, channel.line)
        (store,) = stores_of(devices, self.clock, None)
        port = OverlappingPort(line.port("d"), self.clock, self.lateness)
        device = DeviceService(store.device, port, self.clock, channel.line, store=store)
        return StalledPort(line.port("channel 1"), self.process, self.is_network), [device]

    def _read(self) -> None:
        """Read a single place by the client of the channel, and again after a while."""
        channel = self.service.channels[1]
        assert channel.client is not None
        client, place = channel.client, self.reads % 7

        def done(result: TransferResult) -> None:
            if result.ok and list(result.values) != [1001 + place]:
                self.wrong.append(f"read of {place}: {result.values}")

        channel.driver.do(lambda now: client.read(self.places[place], station=3, now=now, on_done=done).commands)
        self.reads += 1
        self.process.call_at(self.clock.now() + 650 * MS, self._read)

    def check(self) -> int:
        """Return the number of values that are stored, after a comparison with those of the device."""
        stored = 0
        for at, value in enumerate(self.service.memory.read("D", "word", 0, 5)):
            stored += value != 0
            if value not in (0, 1001 + at):
                self.wrong.append(f"D{at} is {value}")
        for name, at in (("fifth", 5), ("sixth", 6)):
            value = self.service.points.table[name].value
            stored += value is not None
            if value not in (None, 1001 + at):
                self.wrong.append(f"point {name} is {value}")
        assert self.wrong == []
        return stored


@pytest.fixture
def stalled_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., StalledRun]:
    def make(*settings: Any) -> StalledRun:
        run = StalledRun.__new__(StalledRun)
        monkeypatch.setattr(channels, "port_for", run.port_for)
        run.__init__(tmp_path, *settings)  # type: ignore[misc]
        return run

    return make


RUNS = list(product(NAMES, (1.5, 6.5, 20), (0, 2), (False, True), STALLS))


@pytest.mark.parametrize(("name", "late", "retries", "is_network", "stall"), spread(RUNS, 4, part=17))
def test_blocks_points_jobs_and_reads_store_nothing_wrong(
    stalled_run: Callable[..., StalledRun], name: str, late: float, retries: int, is_network: bool, stall: float
) -> None:
    check_runs(stalled_run, name, late, retries, is_network, stall, 97)


def check_runs(
    stalled_run: Callable[..., StalledRun], name: str, late: float, retries: int, is_network: bool, stall: float,
    step: int,
) -> None:  # fmt: skip
    total = 0
    for number in range(1, 400, step):
        run = stalled_run(name, late, retries, is_network, once(number, int(stall * SECOND)))
        for _ in range(20):
            run.clock.run_for(5 * SECOND)
            stored = run.check()
        assert run.process.interactions > 400
        total += stored
    assert total >= 2 * len(range(1, 400, step))


@pytest.mark.long
@pytest.mark.skipif(not WHOLE, reason="hours: set FRAMEKIT_WHOLE")
@pytest.mark.parametrize("name", NAMES)
def test_no_stall_of_a_run_stores_anything_wrong(stalled_run: Callable[..., StalledRun], name: str) -> None:
    for late, retries, is_network, stall in product((1.5, 6.5, 20), (0, 2), (False, True), STALLS):
        check_runs(stalled_run, name, late, retries, is_network, stall, 41)

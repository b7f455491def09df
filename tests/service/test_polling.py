"""Polls: values of every reply, times, errors, and the exchanges of other callers meanwhile, on the virtual clock."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise

import pytest
from service.fault_world import LINKS, Link
from service.poll_world import MS, SECOND, ByHand, OnLine, PollResults

from framekit.link.services.client import TransferResult
from framekit.service.client import LEAST_PAUSE, Polling

LINES = [link for link in LINKS if link.protocol != "third-party-plc"]
WAYS = pytest.mark.parametrize("at_once", [True, False], ids=["at once", "later"])


@pytest.fixture(params=["unwatched", "watched"])
def watched(request: pytest.FixtureRequest) -> bool:
    return bool(request.param == "watched")


# ---- values -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", LINES, ids=str)
def test_every_reply_has_what_the_device_held(link: Link, watched: bool) -> None:
    world = OnLine(link, watched=watched)
    chance = random.Random(str(link))
    held: list[tuple[int, ...]] = []
    results = PollResults()

    def change() -> None:
        values = [chance.choice((0, 1, 0x0D, 0x1003, 0x7FFF, chance.getrandbits(15))) for _ in range(4)]
        world.put(values)
        held.append(tuple(values))

    class Changing(PollResults):
        """Change the device's values with every reply, so the next reply must differ."""

        def numbers(self, values: tuple[int, ...]) -> None:
            super().numbers(values)
            change()

    change()
    polling, results = world.poll(link.address, 4, station=link.station, results=Changing())
    world.until(lambda: len(results.values) + len(results.failures) >= 12)
    polling.stop()
    assert results.failures == []
    assert results.values == held[: len(results.values)]
    if watched:
        assert sum(seen.kind == "frame" for seen in world.seen) >= 24, "everything is shown"
    read = world.read(link.address, 4, station=link.station)
    world.until(lambda: bool(read))
    assert tuple(read[0].values) == held[-1]


@WAYS
@pytest.mark.parametrize("protocol", ["modbus-tcp", "modbus-rtu", "modbus-ascii"])
def test_bits(protocol: str, at_once: bool, watched: bool) -> None:
    world = ByHand(protocol, at_once=at_once, watched=watched)
    _polling, results = world.poll("00003", 11, station=1)
    chance, held = random.Random(3), []
    for _ in range(10):
        bits = [chance.getrandbits(1) for _ in range(16)]
        world.memory.write("coil", "bit", 0, bits)
        held.append(tuple(bits[2:13]))
        world.answer()
    assert (results.values, results.failures) == (held, [])


@WAYS
def test_what_a_reply_has_is_what_a_read_gives(at_once: bool) -> None:
    world = ByHand("modbus-tcp", at_once=at_once)
    polling, results = world.poll("40001", 3, station=1)
    for number in range(6):
        world.put(number, 0xFFFF - number, 7 * number)
        world.answer()
    polling.stop()
    world.answer()
    read = world.read("40001", 3, station=1)
    world.answer()
    assert results.values[-1] == tuple(read[0].values) == (5, 0xFFFA, 35)


def test_units_of_another_size_than_the_registers() -> None:
    world = ByHand("modbus-tcp")
    _, results = world.poll("40001", 2, station=1, unit="dword")
    for number in range(4):
        world.put(number, 1, 2, 3)
        world.answer()
    read = world.read("40001", 2, station=1)
    world.put(9, 1, 2, 3)
    world.answer()
    world.answer()
    assert results.values[:4] == [(0x10000 + number, 0x30002) for number in range(4)]
    assert results.values[4:] == [(0x10009, 0x30002)] and read[0].values == [9, 1]


# ---- times ------------------------------------------------------------------------------------------------------


@WAYS
def test_a_read_begins_so_long_after_the_one_before(at_once: bool, watched: bool) -> None:
    world = ByHand("modbus-tcp", at_once=at_once, watched=watched)
    _, results = world.poll("40001", 1, station=1, every=250 * MS)
    for number in range(8):
        world.put(number)
        world.clock.run_for(40 * MS)
        world.answer()
        assert len(world.port.written) == number + 1, "not before its time"
        world.clock.run_for(210 * MS)
    assert {later - sooner for sooner, later in pairwise(world.port.times)} == {250 * MS}
    assert results.values == [(number,) for number in range(8)]


def test_where_a_reply_takes_longer_the_next_read_begins_at_once() -> None:
    world = ByHand("modbus-tcp")
    world.poll("40001", 1, station=1, every=250 * MS)
    for _ in range(6):
        world.clock.run_for(700 * MS)
        came = len(world.port.written)
        world.answer()
        assert len(world.port.written) == came + 1


@WAYS
@pytest.mark.parametrize("every", [0, 30 * MS, 3 * SECOND])
def test_a_dead_line_is_not_asked_without_end(every: int, at_once: bool) -> None:
    """Without a reply: the time limit of 1 s, and then a pause; the interval of two reads counts from their starts."""
    world = ByHand("modbus-tcp", at_once=at_once)
    _, results = world.poll("40001", 1, station=1, every=every)
    for number in range(3):
        world.put(number)
        world.answer()
        world.clock.run_for(every)
    answered = len(world.port.written) - 1
    world.clock.run_for(30 * SECOND)
    apart = max(every, SECOND + LEAST_PAUSE)
    silent = world.port.times[answered:]
    assert {later - sooner for sooner, later in pairwise(silent)} == {apart}
    assert set(results.outcomes) == {"no_reply"}
    world.put(77)
    world.clock.run_for(apart)
    world.answer()
    world.clock.run_for(every)
    world.answer()
    assert results.values[-2:] == [(77,), (77,)]


def test_a_refusal_is_asked_again_after_a_pause() -> None:
    world = ByHand("modbus-tcp")
    _, results = world.poll("40001", 1, station=1)
    for number in range(4):
        world.put(number)
        world.answer()
    for _ in range(3):
        came = len(world.port.written)
        world.come(world.asked[:4] + b"\0\3\1\x83\2")
        assert len(world.port.written) == came
        world.clock.run_for(LEAST_PAUSE - 1)
        assert len(world.port.written) == came
        world.clock.run_for(1)
        assert len(world.port.written) == came + 1
    world.answer()
    assert [(failure.outcome, failure.code) for failure in results.failures] == [("refused", 2)] * 3
    assert results.values == [(0,), (1,), (2,), (3,), (3,)]


# ---- replies that are not what is waited for ---------------------------------------------------------------------


def _wrong_number(reply: bytes) -> tuple[bytes, ...]:
    return (bytes([reply[0], reply[1] ^ 1]) + reply[2:],)


def _one_more(reply: bytes) -> tuple[bytes, ...]:
    """Return a good frame with one register more than requested."""
    return (reply[:4] + (int.from_bytes(reply[4:6], "big") + 2).to_bytes(2, "big") + reply[6:8]
            + bytes([reply[8] + 2]) + reply[9:] + b"\xAB\xCD",)  # fmt: skip


def _one_less(reply: bytes) -> tuple[bytes, ...]:
    return (reply[:4] + (int.from_bytes(reply[4:6], "big") - 2).to_bytes(2, "big") + reply[6:8]
            + bytes([reply[8] - 2]) + reply[9:-2],)  # fmt: skip


BAD: dict[str, tuple[Callable[[bytes], tuple[bytes, ...]], set[str]]] = {
    "nothing": (lambda reply: (), {"no_reply"}),
    "another number": (_wrong_number, {"no_reply"}),
    "a register more": (_one_more, {"unfit_reply"}),
    "a register less": (_one_less, {"unfit_reply"}),
    "another station": (lambda reply: (reply[:6] + b"\2" + reply[7:],), {"no_reply"}),
    "another function": (lambda reply: (reply[:7] + b"\4" + reply[8:],), {"no_reply"}),
    "a byte is missing": (lambda reply: (reply[:-1],), {"no_reply", "closed"}),
}


@WAYS
@pytest.mark.parametrize("known", [0, 1, 4], ids=["at first", "second", "known"])
@pytest.mark.parametrize("what", BAD)
def test_no_bad_reply_is_taken_and_values_are_right_afterwards(
    what: str, known: int, at_once: bool, watched: bool
) -> None:
    make, outcomes = BAD[what]
    world = ByHand("modbus-tcp", at_once=at_once, watched=watched)
    _, results = world.poll("40001", 2, station=1)
    for number in range(known):
        world.put(number, 2 * number)
        world.answer()
    right = len(results.values)
    world.put(0x1111, 0x2222)
    for _ in range(3):
        world.come(*make(world.reply()))
        world.clock.run_for(5 * SECOND if "no_reply" in outcomes else 0)
        if what == "a byte is missing":
            break
        world.clock.run_for(LEAST_PAUSE)
    assert len(results.values) == right == known
    assert results.failures and set(results.outcomes) <= outcomes
    world.clock.run_for(10 * SECOND)
    for number in range(4):
        world.put(number, 500 + number)
        world.answer()
        world.clock.run_for(0)
    assert results.values[-2:] == [(2, 502), (3, 503)]


@WAYS
@pytest.mark.parametrize("protocol", ["modbus-tcp", "modbus-rtu", "modbus-ascii"])
@pytest.mark.parametrize("pieces", ["two", "byte by byte"])
def test_replies_in_pieces(protocol: str, pieces: str, at_once: bool, watched: bool) -> None:
    world = ByHand(protocol, at_once=at_once, watched=watched)
    _, results = world.poll("40001", 2, station=1)
    held = []
    for number in range(8):
        world.put(number, 0x0D0A)
        held.append((number, 0x0D0A))
        reply = world.reply()
        if number % 3 != 1:
            world.come(reply)
        elif pieces == "two":
            world.come(reply[:5], reply[5:])
        else:
            world.come(*(bytes([byte]) for byte in reply))
    assert (results.values, results.failures) == (held, [])


@WAYS
def test_two_replies_in_one_piece_are_not_both_taken(at_once: bool, watched: bool) -> None:
    world = ByHand("modbus-tcp", at_once=at_once, watched=watched)
    _, results = world.poll("40001", 1, station=1)
    for number in range(6):
        world.put(number)
        reply = world.reply()
        world.come(reply + reply if number in (2, 4) else reply)
    world.clock.run_for(2 * SECOND)
    assert results.values[:3] == [(0,), (1,), (2,)]
    assert sorted(set(results.values)) == [(number,) for number in range(6)]
    assert len(results.values) == 6 and results.failures != [], "only the silence at the end"
    assert set(results.outcomes) == {"no_reply"}


def test_a_reply_that_comes_late_is_not_that_of_the_next_request() -> None:
    world = ByHand("modbus-tcp")
    _, results = world.poll("40001", 1, station=1)
    for number in range(4):
        world.put(number)
        world.answer()
    world.put(99)
    late = world.reply()
    world.clock.run_for(SECOND + LEAST_PAUSE)
    assert results.outcomes == ["no_reply"]
    world.put(5)
    world.come(late, world.reply())
    assert results.values[-1] == (5,) and (99,) not in results.values


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("protocol", ["modbus-tcp", "modbus-rtu", "modbus-ascii"])
def test_whatever_comes_no_value_is_told_that_the_device_has_not_held(protocol: str, seed: int, watched: bool) -> None:
    """Pieces, duplicates, noise and damage at random. On TCP, which has no check code, data are not damaged.

    In frames without numbers, a reply after a failure is confirmed by an equal reply. The values change with each reply
    here, so few replies are confirmed. After the faults the values are constant; at most 21 time-outs later, each
    request returns them again.
    """
    world = ByHand(protocol, at_once=seed % 2 == 0, watched=watched)
    chance = random.Random(seed)
    _, results = world.poll("40001", 2, station=1)
    held = {(0, 0)}
    for number in range(120):
        values = (number, chance.getrandbits(16))
        world.put(*values)
        held.add(values)
        reply = world.reply()
        kind = chance.choice("......pdxn ")
        cut = chance.randrange(1, len(reply)) if reply else 0
        if kind == "p":
            world.come(reply[:cut], reply[cut:])
        elif kind == "d":
            world.come(reply + reply[:cut])
        elif kind == "x" and reply:
            most = 9 if protocol == "modbus-tcp" else len(reply)
            damaged = bytearray(reply)
            damaged[chance.randrange(most)] ^= 1 << chance.randrange(8)
            world.come(bytes(damaged))
        elif kind == "n":
            world.come(chance.randbytes(3))
        elif kind == ".":
            world.come(reply)
        if chance.random() < 0.2 or kind != ".":
            world.clock.run_for(3 * SECOND)
    assert set(results.values) <= held
    assert len(results.values) > (30 if protocol == "modbus-tcp" else 15)
    world.clock.run_for(10 * SECOND)
    world.put(4711, 815)
    requests, known, failed, counts = 0, len(results.values), len(results.failures), []
    for _ in range(300):  # 30 time-outs of 1 s, of which open requests last 21
        if len(world.port.written) > requests:
            requests = len(world.port.written)
            world.come(world.reply())
        world.clock.run_for(100 * MS)
        counts.append(len(results.values))
    assert set(results.values[known:]) == {(4711, 815)}
    assert len(results.failures) == failed
    assert counts[-1] - counts[-51] == 50, "in step again: each request brings a value"


# ---- stopping ---------------------------------------------------------------------------------------------------


def _is_over(world: ByHand, polling: Polling, results: PollResults) -> None:
    """Assert that the poll reports and requests no more, and that other callers are served."""
    values, failures = list(results.values), list(results.failures)
    world.clock.run_for(5 * SECOND)
    requests = len(world.port.written)
    polling.stop()
    world.clock.run_for(5 * SECOND)
    assert not polling.is_running
    assert len(world.port.written) == requests
    world.put(4711)
    read = world.read("40001", 1, station=1)
    world.answer()
    assert [reading.values for reading in read] == [[4711]]
    world.clock.run_for(5 * SECOND)
    assert (results.values, results.failures) == (values, failures)


@WAYS
@pytest.mark.parametrize("known", [0, 1, 5])
@pytest.mark.parametrize("every", [0, 200 * MS])
def test_stopped_while_a_reply_is_waited_for(known: int, every: int, at_once: bool) -> None:
    world = ByHand("modbus-tcp", at_once=at_once)
    polling, results = world.poll("40001", 1, station=1, every=every)
    for _ in range(known):
        world.answer()
        world.clock.run_for(every)
    assert len(world.port.written) == known + 1
    polling.stop()
    polling.stop()
    world.put(1)
    late = world.reply()
    read = world.read("40001", 1, station=1)
    assert len(world.port.written) == known + 1, "the reply that is on its way is waited for"
    world.come(late)
    world.put(2)
    world.answer()
    assert [reading.values for reading in read] == [[2]]
    _is_over(world, polling, results)


@WAYS
def test_stopped_while_it_waits_for_its_time(at_once: bool) -> None:
    world = ByHand("modbus-tcp", at_once=at_once)
    polling, results = world.poll("40001", 1, station=1, every=SECOND)
    for _ in range(3):
        world.answer()
        world.clock.run_for(SECOND)
    world.answer()
    polling.stop()
    assert len(results.values) == 4
    _is_over(world, polling, results)


class StopsIn(PollResults):
    """A recorder that stops its poll at the value or failure of this number."""

    polling: Polling

    def __init__(self, number: int) -> None:
        super().__init__()
        self._number = number

    def result(self, result: TransferResult) -> None:
        super().result(result)
        self._stop()

    def numbers(self, values: tuple[int, ...]) -> None:
        super().numbers(values)
        self._stop()

    def _stop(self) -> None:
        if len(self.values) + len(self.failures) == self._number:
            self.polling.stop()
            self.polling.stop()


@WAYS
@pytest.mark.parametrize("number", [1, 2, 6])
@pytest.mark.parametrize("every", [0, 200 * MS])
def test_stopped_from_its_callback(number: int, every: int, at_once: bool, watched: bool) -> None:
    world = ByHand("modbus-tcp", at_once=at_once, watched=watched)
    results = StopsIn(number)
    results.polling, _ = world.poll("40001", 1, station=1, every=every, results=results)
    for _ in range(number):
        world.answer()
        world.clock.run_for(every)
    assert len(results.values) == len(world.port.written) == number
    _is_over(world, results.polling, results)


def test_stopped_from_the_callback_of_a_failure() -> None:
    world = ByHand("modbus-tcp")
    results = StopsIn(1)
    results.polling, _ = world.poll("40001", 1, station=1, results=results)
    world.clock.run_for(5 * SECOND)
    assert results.outcomes == ["no_reply"] and len(world.port.written) == 1
    _is_over(world, results.polling, results)


def test_what_cannot_be_asked_is_not_begun() -> None:
    world = ByHand("modbus-tcp")
    with pytest.raises(ValueError, match="is not an address"):
        world.poll("4x", 1, station=1)
    world.clock.run_for(SECOND)
    _polling, results = world.poll("40001", 1, station=1)
    for _ in range(3):
        world.answer()
    assert len(results.values) == 3, "the one that failed to begin holds nothing back"


# ---- others at the same time --------------------------------------------------------------------------------------


@WAYS
def test_two_polls_and_reads_and_writes_in_between(at_once: bool, watched: bool) -> None:
    world = ByHand("modbus-tcp", at_once=at_once, watched=watched)
    world.memory.write("holding", "word", 0, list(range(100, 120)))
    _, first = world.poll("40001", 2, station=1)
    _, second = world.poll("40011", 3, station=1)
    for number in range(40):
        if number == 10:
            read = world.read("40006", 1, station=1)
        if number == 20:
            written = world.write("40011", [7], station=1)
        world.answer()
    assert set(first.values) == {(100, 101)}
    assert second.values[0] == (110, 111, 112) and second.values[-1] == (7, 111, 112)
    assert [reading.values for reading in read] == [[105]]
    assert [result.ok for result in written] == [True]
    assert abs(len(first.values) - len(second.values)) <= 1, "one after the other"
    assert first.failures == second.failures == []


def test_when_one_of_two_polls_ends_the_other_goes_on() -> None:
    world = ByHand("modbus-tcp")
    one, first = world.poll("40001", 1, station=1)
    _, second = world.poll("40002", 1, station=1)
    for number in range(6):
        world.put(number, 1000 + number)
        world.answer()
    one.stop()
    for number in range(10, 16):
        world.put(number, 1000 + number)
        world.answer()
    assert len(first.values) == 3
    assert second.values[-3:] == [(1013,), (1014,), (1015,)]


def test_a_poll_begun_in_the_callback_of_another() -> None:
    world = ByHand("modbus-tcp")
    later: list[PollResults] = []

    class Begins(PollResults):
        def numbers(self, values: tuple[int, ...]) -> None:
            super().numbers(values)
            if len(self.values) == 3:
                later.append(world.poll("40002", 1, station=1)[1])

    _, results = world.poll("40001", 1, station=1, results=Begins())
    for number in range(10):
        world.put(number, 1000 + number)
        world.answer()
    assert results.values[:3] == [(0,), (1,), (2,)]
    assert later[0].values and later[0].values[0][0] in range(1003, 1006)
    assert not results.failures and not later[0].failures


def test_a_write_in_the_callback_goes_out_before_the_next_read() -> None:
    world = ByHand("modbus-tcp")
    ended: list[list[TransferResult]] = []

    class Writes(PollResults):
        def numbers(self, values: tuple[int, ...]) -> None:
            super().numbers(values)
            if len(self.values) == 3:
                ended.append(world.write("40001", [55], station=1))

    _, results = world.poll("40001", 1, station=1, results=Writes())
    for _ in range(8):
        world.answer()
    assert [result.ok for result in ended[0]] == [True]
    assert results.values[:3] == [(0,), (0,), (0,)] and set(results.values[3:]) == {(55,)}


# ---- parameters, connections ------------------------------------------------------------------------------------


@WAYS
def test_parameters_may_change_meanwhile(at_once: bool) -> None:
    world = ByHand("modbus-tcp", at_once=at_once)
    _, results = world.poll("40001", 1, station=1)
    for number in range(4):
        world.put(number)
        world.answer()
    scope = world.service.engine.scope
    scope.set("reply_timeout", 3 * SECOND)
    for number in range(4, 8):
        world.put(number)
        world.answer()
    assert results.values == [(number,) for number in range(8)]
    world.clock.run_for(3 * SECOND - 1)
    assert results.failures == []
    world.clock.run_for(1)
    assert results.outcomes == ["no_reply"]
    back = scope.override({"reply_timeout": 10 * MS})
    world.clock.run_for(LEAST_PAUSE + 10 * MS)
    assert results.outcomes == ["no_reply"] * 2
    back()


@WAYS
@pytest.mark.parametrize("when", ["waiting", "pausing"])
def test_a_connection_lost_and_found(when: str, at_once: bool, watched: bool) -> None:
    world = ByHand("modbus-tcp", at_once=at_once, watched=watched)
    polling, results = world.poll("40001", 1, station=1, every=0 if when == "waiting" else 100 * MS)
    for number in range(4):
        world.put(number)
        world.answer()
        world.clock.run_for(0 if when == "waiting" else 100 * MS)
    if when == "pausing":
        world.answer()
    before = len(results.values)
    events = world.port.events
    assert events is not None
    events.closed(world.clock.now(), "pulled")
    world.clock.run_for(300 * MS)
    assert set(results.outcomes) == {"closed"} and 1 <= len(results.failures) <= 4
    requests = len(world.port.written)
    world.clock.run_for(700 * MS)
    assert len(world.port.written) == requests + 1, "the connection is there again, and the read goes out once"
    for number in range(10, 15):
        world.put(number)
        world.answer()
        world.clock.run_for(0 if when == "waiting" else 100 * MS)
    assert results.values[before:] == [(number,) for number in range(10, 15)]
    assert set(results.outcomes) == {"closed"}
    assert polling.is_running


def test_a_device_that_goes_and_comes_back_on_a_serial_line() -> None:
    link = next(link for link in LINES if link.protocol == "modbus-rtu")
    world = OnLine(link)
    world.put([1, 2])
    polling, results = world.poll(link.address, 2, station=link.station)
    world.until(lambda: len(results.values) == 5)
    world.device.stop()
    world.until(lambda: len(results.failures) == 3)
    assert set(results.outcomes) == {"no_reply"}
    world.put([3, 4])
    world.device.start()
    world.until(lambda: (3, 4) in results.values)
    polling.stop()


def test_a_stopped_service_ends_what_is_under_way(watched: bool) -> None:
    world = ByHand("modbus-tcp", watched=watched)
    polling, results = world.poll("40001", 1, station=1)
    for _ in range(3):
        world.answer()
    polling.stop()
    world.service.stop()
    world.clock.run_for(10 * SECOND)
    assert results.failures == [] and len(results.values) == 3

"""Sessions with acknowledged messages, and sessions without, on the bit-exact line at 19200 baud, whole and damaged."""

from __future__ import annotations

from typing import Any

import pytest
from line_faults import Faults
from spread import TRANSFERS
from transfer_world import TransferWorld

from framekit.link.services.client import TransferResult

PLACES = {"R1": 1024, "R1501": 40, "I1": 256, "Q17": 64, "M35": 77}
STATIONS = {"snp": "33101A", "snp-x": b"ABCDEF\0\0"}


def world(protocol: str, faults: Faults | None = None, **params: Any) -> TransferWorld:
    station = STATIONS[protocol]
    if protocol == "snp":
        params.setdefault("privilege", 2)
    return TransferWorld(
        protocol, "master", "slave", server_own=station, station=station, faults=faults, params=params
    )  # fmt: skip


@pytest.mark.parametrize("protocol", STATIONS)
@pytest.mark.parametrize("count", TRANSFERS)
def test_transfers_up_to_2_kb(protocol: str, count: int) -> None:
    transfers = world(protocol)
    transfers.mixed(count, PLACES, longest=1024)
    assert transfers.wrong == []
    assert transfers.outcomes == {"ok": count}


@pytest.mark.parametrize("count", TRANSFERS)
def test_messages_are_hit_and_most_transfers_succeed(count: int) -> None:
    """A message of 208 characters has 2,288 bits: with one wrong bit in 3,000, every second message is damaged."""
    transfers = world("snp", Faults(bit_errors=1 / 3000, seed=5), own_data_size=200, retries=8)
    transfers.mixed(count, PLACES, longest=1024)
    assert transfers.wrong == []
    assert transfers.outcomes.total() == count
    assert transfers.outcomes["ok"] > 0.9 * count
    naks = transfers.engine.scope.get("naks_sent") + transfers.server.scope.get("naks_sent")
    assert naks > 0.7 * count, "on the whole most transfers needed a repeat"


def test_short_messages_are_never_repeated_and_never_wrong() -> None:
    transfers = world("snp-x", Faults(bit_errors=1 / 15000, seed=5))
    transfers.mixed(300, PLACES, longest=1024)
    assert transfers.wrong == []
    assert transfers.outcomes.total() == 300
    assert 240 < transfers.outcomes["ok"] < 300


class Bench:
    """A master that calls services, and a slave with accessible state."""

    def __init__(self, **params: Any) -> None:
        self.world = world("snp", **params)

    def call(self, service: str, **arguments: Any) -> TransferResult:
        there = self.world
        return there.do(lambda **keys: there.client.call(service, arguments, station=there.station, **keys))

    def ok(self, service: str, **arguments: Any) -> dict[str, Any]:
        result = self.call(service, **arguments)
        assert result.ok, (service, result.outcome, result.code)
        return dict(result.gives)

    @property
    def device(self) -> Any:
        return self.world.server.scope


def test_status_names_and_time() -> None:
    bench = Bench()
    status = bench.ok("short_status")
    assert status["status"] == {"programs": 0, "programmers": 0, "program_0": 0, "window_open": 0}
    assert status["plc"] | {"level": 2, "state": 2, "sweep": 39} == status["plc"]
    assert bench.ok("program_names")["names"] == {"programs": 1, "names": [{"name": ""}]}
    bench.device.set("program", "ESS331")
    assert bench.ok("program_names")["names"]["names"] == [{"name": "ESS331"}]
    controller = bench.ok("controller_id")["controller"]
    assert (controller["id"], controller["major"], controller["minor"]) == ("33101A", 16, 35)
    bench.ok("set_time", second=59, minute=48, hour=10, day=4, month=5, year=90, weekday=1)
    time = bench.ok("get_time")["time"]
    assert (time["hour"], time["day"], time["month"], time["year"], time["weekday"]) == (10, 4, 5, 90, 6)
    bench.ok("set_time", mode="date", day=10, month=5, year=90)
    time = bench.ok("get_time")["time"]
    assert (time["hour"], time["day"], time["weekday"]) == (10, 10, 5)
    assert bench.call("set_time", hour=24).code == 0x05F4


FAULT = {"rack": 0, "slot": 3, "unit": 0, "group": 18, "action": 2, "code": 7} | dict.fromkeys(
    ("second", "minute", "hour", "day", "month", "year"), 1
)


def test_faults_state_and_who_may() -> None:
    bench = Bench()
    for service in ("clear_plc_faults", "clear_io_faults"):
        assert bench.call(service).code == 0x05F1, "only for the programmer"
    assert bench.call("set_state", state=0).code == 0x05F1
    bench.device.set("plc_faults", [FAULT, FAULT | {"slot": 4}])
    status = bench.ok("short_status")["plc"]
    assert (status["plc_fault"], status["plc_fault_news"], status["io_fault_news"]) == (1, 1, 0)
    table = bench.ok("plc_faults")["faults"]
    assert [fault["slot"] for fault in table["faults"]] == [3, 4]
    assert table["present"] == 2
    assert [fault["slot"] for fault in bench.ok("plc_faults", first=1, wanted=5)["faults"]["faults"]] == [4]
    assert bench.ok("short_status")["plc"]["plc_fault_news"] == 0, "it has been read"
    bench.ok("logon")
    assert bench.ok("short_status")["plc"]["programmer"] == 1
    assert bench.call("set_state", state=0).code == 0x05F2, "not with faults"
    bench.ok("clear_plc_faults")
    status = bench.ok("short_status")["plc"]
    assert (status["plc_fault"], status["plc_fault_news"]) == (0, 1), "cleared since this master read it"
    assert bench.ok("plc_faults")["faults"]["faults"] == []
    assert bench.ok("short_status")["plc"]["plc_fault_news"] == 0
    bench.device.set("program_invalid", 1)
    assert bench.call("set_state", state=0).code == 0x05F2, "nor with an invalid program"
    bench.device.set("program_invalid", 0)
    bench.ok("set_state", state=0)
    assert bench.device["plc_state"] == 0
    assert bench.call("set_state", state=1).code == 0x05F6
    assert bench.call("set_id", id="33101A").code == 0x0203, "level 3 is needed"
    bench.device.set_entry("passwords", 3, "SECRET")
    assert bench.call("change_level", level=3).code == 0x05F5
    assert bench.ok("change_level", level=3, password="SECRET") == {"level": 3}
    assert bench.ok("change_level", level=255, password="SECRET") == {"level": 3}
    assert bench.call("set_id", id="TOOLONG").code == 0x05F4
    bench.ok("set_id", id="33101B")
    assert bench.ok("controller_id")["controller"]["id"] == "33101B"


def test_one_bit_is_toggled() -> None:
    bench = Bench()
    memory = bench.world.memory
    bench.ok("toggle", memory="M", point=5)
    assert memory.read("M", "bit", 3, 3) == [0, 1, 0]
    bench.ok("toggle", memory="M", point=5)
    assert memory.read("M", "bit", 4, 1) == [0]
    assert bench.call("toggle", memory="M", table=".force", point=5).code == 0x0203, "overrides need level 3"
    bench.ok("change_level", level=3)
    bench.ok("toggle", memory="M", table=".force", point=5)
    assert memory.read("M.force", "bit", 4, 1) == [1]


@pytest.mark.parametrize("family", ["90-30", "90-70"])
def test_datagrams_from_beginning_to_end(family: str) -> None:
    bench = Bench(family=family)
    bench.world.memory.write("R", "word", 4, [0x2219, 0x1205])
    assert bench.call("establish", area_size=16).code == 0x05DE
    assert bench.call("establish", area_size=20, type=2).code == 0x05D7
    number = bench.ok("establish", area_size=20)["id"]["id"]
    bench.ok("define_datagram", id=number, points=[{"selector": 8, "offset": 4, "length": 2}])
    values = bench.ok("update_datagram", id=number)["values"]
    assert values["values"] == bytes.fromhex("19 22 05 12")
    assert bench.call("update_datagram", id=number, type=0x81).code == 0x05DD
    bench.ok("cancel_datagram", id=255)
    assert bench.call("update_datagram", id=number).code == 0x05DD


def test_a_program_is_stored_and_loaded() -> None:
    bench = Bench(privilege=3)
    logic = bytes(range(131))
    assert bench.call("program_load").code == 0x05F1
    bench.ok("logon")
    bench.ok("program_store", block=logic)
    bench.ok("program_store", block_type=5, block=logic * 10)
    assert bench.ok("program_load") == {"block": logic}
    assert bench.ok("program_load", block_type=5) == {"block": logic * 10}
    assert bench.call("program_load", block_type=1).code == 0x05BC


def test_task_and_block_memory_of_the_large_family() -> None:
    transfers = world("snp", family="90-70", task="STAT_1", block="SUB1")

    def done(method: Any, *arguments: Any, **options: Any) -> TransferResult:
        return transfers.do(lambda **keys: method(*arguments, station=transfers.station, **options, **keys))

    for address in ("P39", "L9"):
        assert done(transfers.client.write, address, [0x4A9B, 0x3463, 0x1ACB, 0x91D4, 0x8BC3]).ok
        assert done(transfers.client.read, address, count=5).values == [0x4A9B, 0x3463, 0x1ACB, 0x91D4, 0x8BC3]
        assert done(transfers.client.read, address, count=2).values == [0x4A9B, 0x3463]


@pytest.mark.parametrize("protocol", STATIONS)
@pytest.mark.parametrize("area", ["I", "Q", "T", "M", "SA", "SB", "SC", "G"])
def test_points_bytes_and_masks(protocol: str, area: str) -> None:
    """Points that are not aligned to bytes are written separately; the same memory is read as bytes."""
    transfers = world(protocol)

    def done(method: Any, *arguments: Any, **options: Any) -> TransferResult:
        return transfers.do(lambda **keys: method(*arguments, station=transfers.station, **options, **keys))

    transfers.memory.write(area, "bit", 0, [1] * 32)
    assert done(transfers.client.write, f"{area}11", [0] * 11).ok
    assert transfers.memory.read(area, "bit", 0, 32) == [1] * 10 + [0] * 11 + [1] * 11
    assert done(transfers.client.read, f"%{area}9", count=14).values == [1, 1] + [0] * 11 + [1]
    assert done(transfers.client.read, f"{area}1", count=4, unit="byte").values == [0xFF, 0x03, 0xE0, 0xFF]
    assert done(transfers.client.write, f"{area}9", [0x55], unit="byte").ok
    assert transfers.memory.read(area, "bit", 8, 8) == [1, 0] * 4


def test_a_lost_session_is_opened_anew() -> None:
    transfers = world("snp")

    def read() -> TransferResult:
        return transfers.do(lambda **keys: transfers.client.read("R1", station=transfers.station, **keys))

    assert read().ok
    transfers.drivers[0].do(transfers.server.line_break)
    assert read().outcome == "no_acknowledge"
    assert read().ok

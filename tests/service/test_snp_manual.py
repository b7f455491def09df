"""A simulated SNP slave by GFK-0529C: refusals and stored data of datagrams, identity, tasks, blocks, families."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from transfer_world import TransferWorld

import framekit
from framekit.link.services.client import TransferResult
from framekit.runfile.devices import load_devices
from framekit.service.device import DeviceStore
from framekit.transport.clock import VirtualClock

STATION = "33101A"
SECOND = 1_000_000_000


class Slave:
    """A master and a slave on a virtual line; `device` is the state of the slave."""

    def __init__(self, **params: Any) -> None:
        params = {"privilege": 2} | params
        self.world = TransferWorld("snp", "master", "slave", server_own=STATION, station=STATION, params=params)
        self.device = self.world.server.scope

    def call(self, service: str, **arguments: Any) -> TransferResult:
        client = self.world.client
        return self.world.do(lambda **keys: client.call(service, arguments, station=STATION, **keys))

    def ok(self, service: str, **arguments: Any) -> dict[str, Any]:
        result = self.call(service, **arguments)
        assert result.ok, (service, result.outcome, result.code)
        return dict(result.gives)

    def read(self, address: str, count: int = 1) -> TransferResult:
        client = self.world.client
        return self.world.do(lambda **keys: client.read(address, count=count, station=STATION, **keys))


def point(selector: int, offset: int, length: int) -> dict[str, int]:
    return {"selector": selector, "offset": offset, "length": length}


@pytest.mark.parametrize("use_break", [True, False])
def test_a_datagram_is_updated_in_real_time_with_and_without_break(use_break: bool) -> None:
    slave = Slave(use_break=use_break)
    slave.world.memory.write("I", "bit", 0, [1, 1, 1, 0, 0, 0, 0, 1])
    slave.ok("establish", type=0x81, area_size=18)
    slave.ok("define_datagram", id=1, type=0x81, points=[point(16, 0, 2)])
    assert slave.ok("realtime_datagram", id=1)["values"]["values"] == b"\x87\x00"
    assert slave.call("update_datagram", id=1).code == 0x05DD, "a new session: the type is that of Establish"
    assert slave.ok("update_datagram", id=1, type=0x81)["values"]["values"] == b"\x87\x00"


@pytest.mark.parametrize(("password", "code"), [("", None), ("SECRET", 0x0201)])
def test_a_real_time_update_of_a_90_70_has_the_level_that_needs_no_password(password: str, code: int | None) -> None:
    """A14: the implied Attach begins at level 0, and the service needs level 1."""
    slave = Slave(family="90-70", privilege=1)
    slave.ok("establish", type=0x81, area_size=18)
    slave.ok("define_datagram", id=1, type=0x81, points=[point(16, 0, 2)])
    slave.device.set_entry("passwords", 1, password)
    result = slave.call("realtime_datagram", id=1)
    assert result.code == code and result.ok == (code is None)


FIVE = [point(8, 4, 5), point(20, 2, 4), point(76, 2, 3), point(70, 81, 6), point(22, 4, 4)]


@pytest.mark.parametrize(
    ("family", "size", "points", "code"),
    [
        ("90-30", 52, FIVE, None),  # the example of page 6-81: 12 + 20 + 10 + 4 + 1 + 1 + 4
        ("90-30", 51, FIVE, 0x05D6),
        ("90-30", 30, [point(70, 19, 8)], 0x05D8),  # a bit point across a byte
        ("90-30", 30, [point(70, 16, 8)], None),
        ("90-30", 30, [point(70, 0, 16)], 0x05D8),
        ("90-30", 30, [point(8, 0, 0)], 0x05D8),
        ("90-30", 30, [point(99, 0, 1)], 0x05DB),
        ("90-30", 30, [point(4, 0, 1)], 0x05DB),  # %P
        ("90-70", 30, [point(4, 0, 1)], None),
        ("90-70", 30, [point(70, 0, 1)], 0x05DB),  # points of bits: 90-30 only
    ],
)
def test_points_that_a_datagram_cannot_have_are_refused(
    family: str, size: int, points: list[dict[str, int]], code: int | None
) -> None:
    slave = Slave(family=family)
    number = slave.ok("establish", area_size=size)["id"]["id"]
    assert slave.call("define_datagram", id=number, points=points).code == code
    if code is not None:
        assert slave.ok("update_datagram", id=number)["values"]["values"] == b"", "nothing of it was kept"


@pytest.mark.parametrize(
    ("family", "name", "code"),
    [("90-30", "ABCDEF", None), ("90-30", "ABCDEF0", 0x05F4), ("90-30", "XYZ", 0x05F4),
     ("90-70", "ABC-xyz", None), ("90-70", "ABC-wxyz", 0x05F4)],
)  # fmt: skip
def test_the_identity_of_each_family(family: str, name: str, code: int | None) -> None:
    slave = Slave(family=family, privilege=3)
    slave.ok("logon")
    assert slave.call("set_id", id=name).code == code
    assert slave.device["cpu_id"] == (STATION if code else name)


def test_release_1_needs_higher_levels() -> None:
    slave = Slave(release_1=True)
    assert slave.call("set_time").code == 0x0203
    slave.ok("change_level", level=3)
    slave.ok("set_time")
    slave.ok("logon")
    assert slave.call("set_id", id="A1").code == 0x0204
    slave.ok("change_level", level=4)
    slave.ok("set_id", id="A1")


def test_a_90_70_says_to_which_program_its_master_is_logged_in() -> None:
    slave = Slave(family="90-70", task="STAT_1")
    slave.device.set("program", "STAT_1")
    first = slave.ok("short_status")
    assert (first["plc"]["control_program"], first["plc"]["programmer"]) == (-1, 1)
    assert first["status"] == {"programs": 1, "programmers": 0, "program_0": 0, "window_open": 0}
    slave.ok("logon")
    slave.device.set("window_open", 1)
    second = slave.ok("short_status")
    assert second["plc"]["control_program"] == 0
    assert second["status"] == {"programs": 1, "programmers": 1, "program_0": 2, "window_open": 1}
    slave.ok("logon", mode="logout")
    assert slave.ok("short_status")["plc"]["control_program"] == -1


def test_the_controller_says_the_sums_of_its_blocks() -> None:
    slave = Slave(family="90-70")
    assert slave.ok("controller_id")["controller"]["major"] == 12
    totals = {
        "blocks": 2, "blocks_length": 70000, "blocks_sum": 3, "blocks_crc": 4, "config_length": 5, "config_sum": 6,
        "config_crc": 7,
    }  # fmt: skip
    slave.device.set("totals", totals)
    controller = slave.ok("controller_id")["controller"]
    assert {name: controller[name] for name in totals} == totals


BLOCKS = """device: large
protocol: snp
station: 33101A
params: {family: 90-70}
state:
  program: {initial: "'STAT_1'"}
  blocks: {initial: [{name: SUB1}, {name: SUB2}]}
memory: {sizes: {SUB1.L1: 100, SUB2.L1: 50}, set: {SUB1.L9: 5, SUB2.%L9: 6}}
"""


def datagrams_of_two_ports(keep: bool) -> tuple[list[int], list[int | None]]:
    """Return the numbers of datagrams that two ports of a processor establish at once, and the codes of their updates.

    First both are updated, then that of port 0 from port 1, then both after port 1 has cancelled all its own.
    """
    params = {"use_break": False}
    with framekit.serve(
        "snp", "tcp-listen://127.0.0.1:0", station=STATION, params=params | {"keep_datagrams": keep}
    ) as server, framekit.connect("snp", server.port, station=STATION, params=params) as first, framekit.connect(
        "snp", server.port, station=STATION, params=params
    ) as second:  # fmt: skip
        numbers = [client.call("establish", {"area_size": 30})["id"]["id"] for client in (first, second)]

        def code(client: framekit.Client, number: int) -> int | None:
            try:
                client.call("update_datagram", {"id": number})
            except framekit.RefusedError as error:
                return error.code
            return None

        codes = [code(first, numbers[0]), code(second, numbers[1]), code(second, numbers[0])]
        second.call("cancel_datagram", {"id": 255})
        return numbers, [*codes, code(first, numbers[0]), code(second, numbers[1])]


def test_ports_of_a_processor_have_normal_datagrams_of_their_own() -> None:
    numbers, codes = datagrams_of_two_ports(keep=False)
    assert len(set(numbers)) == 2
    assert codes == [None, None, 0x05DD, None, 0x05DD]


def test_a_cmm311_keeps_datagrams_and_cancels_those_of_both_ports() -> None:
    _, codes = datagrams_of_two_ports(keep=True)
    assert codes == [None, None, None, 0x05DD, 0x05DD]
    slave = Slave(keep_datagrams=True)
    number = slave.ok("establish", area_size=30)["id"]["id"]
    slave.ok("establish", type=0x81, area_size=30)
    slave.ok("realtime_datagram", id=number + 1)  # ends the session
    slave.ok("update_datagram", id=number)


def test_a_datagram_reads_the_l_of_its_program_block(tmp_path: Path) -> None:
    (tmp_path / "large.device.yaml").write_text(BLOCKS, encoding="utf-8")
    params = {"family": "90-70", "privilege": 2}
    with framekit.connect("snp", f"sim:{tmp_path / 'large.device.yaml'}", station=STATION, params=params) as client:
        number = client.call("establish", {"area_size": 40})["id"]["id"]
        points = [point(0x00, 8, 1), point(0x08, 0, 1)]
        with pytest.raises(framekit.RefusedError, match="0x05D5: block name in datagram invalid"):
            client.call("define_datagram", {"id": number, "points": points, "program_block": "SUB3"})
        for block, word in (("SUB1", 5), ("SUB2", 6)):
            client.call("define_datagram", {"id": number, "points": points, "program_block": block})
            values = client.call("update_datagram", {"id": number})["values"]["values"]
            assert values == bytes((word, 0, 0, 0))


def test_program_blocks_have_l_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "large.device.yaml").write_text(BLOCKS, encoding="utf-8")
    store = DeviceStore(load_devices(tmp_path / "large.device.yaml", tmp_path)[0], VirtualClock())
    assert store.memory.read("L.SUB1", "word", 8, 1) == [5]
    assert store.memory.read("L.SUB2", "word", 8, 1) == [6]


def test_names_of_tasks_and_blocks_are_judged() -> None:
    slave = Slave(family="90-70", task="OTHER", block="SUB9")
    assert slave.read("P1").ok, "there is no program to compare the name with"
    slave.device.set("program", "STAT_1")
    assert slave.read("P1").code == 0x05F8
    assert slave.read("L1").code == 0x05F8
    slave = Slave(family="90-70", task="STAT_1", block="SUB9")
    slave.device.set("program", "STAT_1")
    assert slave.read("P1").ok
    assert slave.read("L1").ok, "no names of blocks are known"
    slave.device.set("blocks", [{"name": "SUB1"}])
    assert slave.read("L1").code == 0x05BD
    assert slave.read("SUB2.L1").code == 0x05BD


def test_a_90_70_has_blocks_of_8_kb_and_no_idle_limit_of_its_own() -> None:
    slave = Slave(family="90-70", negotiate=False)
    slave.ok("short_status")
    assert slave.device["t3p"] == 0
    assert slave.device["data_size"] == 8192


def test_a_slave_that_prepares_for_long_keeps_the_link_alive() -> None:
    """T5 of the CMM (Table 44): without it, the master gives up after T3 prime."""
    slave = Slave(preparation=25 * SECOND, own_t5=4 * SECOND)
    assert slave.ok("short_status")["plc"]["level"] == 2
    assert slave.call("short_status").ok
    slave = Slave(preparation=25 * SECOND, privilege=0)
    assert slave.call("short_status").outcome == "link_idle"


def counts(slave: Slave) -> list[int]:
    """Return the slave's diagnostic status words after the last ACK: status, good, errors, aborts, breaks."""
    slave.world.clock.run_for(SECOND // 10)
    return [slave.device[name] for name in ("last_status", "good_count", "error_count", "abort_count", "breaks")]


def test_a_slave_counts_what_its_diagnostic_status_words_show() -> None:
    slave = Slave(privilege=0)
    assert slave.read("%R1").ok
    assert counts(slave) == [0, 1, 0, 0, 1]
    assert slave.call("set_state", state=0).code == 0x0202
    assert counts(slave) == [0x0202, 1, 1, 0, 1]
    assert slave.call("update_datagram", id=9).code == 0x05DD
    assert counts(slave) == [0xDD05, 1, 2, 0, 1], "the minor code is in the high byte"
    slave.world.clock.run_for(30 * SECOND)
    assert slave.read("%R1").ok
    assert counts(slave)[1:4] == [2, 2, 0], "a break between sessions is no abort"


def test_a_slave_counts_a_request_that_a_break_aborts() -> None:
    slave = Slave(preparation=2 * SECOND)
    slave.ok("short_status")
    before = counts(slave)
    world, results = slave.world, []
    world.drivers[1].do(
        lambda now: world.client.call("short_status", {}, station=STATION, now=now, on_done=results.append).commands
    )
    world.clock.run_for(SECOND)
    world.drivers[0].do(lambda now: world.server.line_break(now))
    after = counts(slave)
    assert after[0] == 0x330C and after[3] == before[3] + 1 and after[4] == before[4] + 1


def test_the_port_of_a_cmm_stays_at_level_2_and_takes_any_password() -> None:
    slave = Slave(cmm_port=True, privilege=0, login=False)
    slave.device.set_entry("passwords", 2, "SECRET")
    assert slave.ok("change_level", level=4, password="WRONG") == {"level": 2}
    assert slave.ok("change_level", level=0)["level"] == 2
    assert slave.read("%R1").ok and slave.ok("toggle", memory="M", point=1) == {}


@pytest.mark.parametrize(
    ("service", "arguments", "code"),
    [
        ("logon", {}, 0x0D40),
        ("set_id", {"id": "A1"}, 0x0D40),
        ("set_state", {"state": 2}, 0x0D40),
        ("clear_plc_faults", {}, 0x0D40),
        ("program_load", {}, 0x0D40),
        ("toggle", {"memory": "M.force", "point": 1}, 0x0D40),
        ("define_datagram", {"id": 1, "points": [point(8, 0, 1)] * 33}, 0x0D43),
    ],
)
def test_what_the_port_of_a_cmm_refuses(service: str, arguments: dict[str, Any], code: int) -> None:
    slave = Slave(cmm_port=True, privilege=0)
    slave.ok("establish", area_size=250)
    assert slave.call(service, **arguments).code == code


def test_the_port_of_a_cmm_gives_2048_bytes_at_once() -> None:
    assert Slave(cmm_port=True, privilege=0).read("%R1", 1024).ok
    slave = Slave(cmm_port=True, privilege=0, max_bytes=4096)
    assert slave.read("%R1", 1025).code == 0x0D42
    assert slave.read("%M1", 2048 * 8 + 1).code == 0x0D42


@pytest.mark.parametrize(("timeouts", "t2", "t3p"), [("usual", 1, 10), ("long", 2, 10), ("none", 0, 0)])
def test_selections_of_time_outs(timeouts: str, t2: int, t3p: int) -> None:
    slave = Slave(timeouts=timeouts, privilege=0)
    assert (slave.device["own_t2"], slave.device["own_t3p"]) == (t2 * SECOND, t3p * SECOND)

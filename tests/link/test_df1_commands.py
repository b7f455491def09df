"""The command set on two engines with a virtual full-duplex line: every service, family by family."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
from link.link_world import SECOND, Side, compiled
from shipped import file_of

from framekit.link.events import Command
from framekit.link.scope import Scope
from framekit.link.services.client import Done, ServiceClient, TransferResult
from framekit.link.services.rows import Planner, RowPlan
from framekit.link.services.server import MemoryServer
from framekit.link.values import read_layout
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

NODE = 5


@cache
def text() -> str:
    return file_of("df1.yaml").read_text(encoding="utf-8")


class Pair:
    """A computer, node 0, and a processor, node 5; both have the parameter of the family."""

    def __init__(self, processor: str, **params: Any) -> None:
        protocol, codec = compiled(text())
        self.memory = DeviceMemory(memory_of(protocol)[0])
        server = MemoryServer(protocol, codec, self.memory)
        params = {"processor": processor, **params}
        self.device = Side(text(), "full", own=NODE, server=server, params={**params, "node": NODE})
        self.asking = Side(text(), "full", own=0, params=params, ask=lambda *given: self.client.ask(*given))
        self.client = ServiceClient(protocol, codec, self.asking.engine)

    @property
    def state(self) -> Any:
        return self.device.engine.scope

    def call(self, service: str, params: dict[str, Any] | None = None, **arguments: Any) -> TransferResult:
        return self.until_done(
            lambda done: (
                self.client.call(
                    service, arguments, station=NODE, params=params, now=self.asking.now, on_done=done
                ).commands
            )
        )

    def until_done(self, begin: Callable[[Done], list[Command]]) -> TransferResult:
        results: list[TransferResult] = []
        self.asking.do(begin(results.append))
        end = self.asking.now + 600 * SECOND
        sides = (self.asking, self.device)
        while not results and self.asking.now < end:
            for side, peer in (sides, sides[::-1]):
                for data in side.taken():
                    peer.do(peer.engine.receive(data, peer.now))
            at = min(end, *(side.next_time() for side in sides))
            for side in sides:
                side.run(at - side.now)
        assert len(results) == 1
        return results[0]

    def gives(self, service: str, **arguments: Any) -> Any:
        """Call a service, which must succeed, and return its only result."""
        result = self.call(service, **arguments)
        assert result.ok, (service, result)
        (value,) = result.gives.values()
        return value

    def done(self, service: str, **arguments: Any) -> None:
        result = self.call(service, **arguments)
        assert result.ok, (service, result)

    def refused(self, service: str, **arguments: Any) -> int:
        result = self.call(service, **arguments)
        assert not result.ok and result.code is not None, (service, result)
        return result.code


# ---- diagnostics ---------------------------------------------------------------------------------------------


def test_echo_and_link_settings() -> None:
    pair = Pair("slc")
    assert pair.gives("echo", data=b"\xaa\x10\x55") == b"\xaa\x10\x55"
    pair.done("set_link", address=12)
    assert pair.gives("read_link") == 12
    other = Pair("plc2")
    other.done("set_variables", cycles=200, naks=5, enqs=7)
    assert (other.state["ack_timeout"], other.state["nak_limit"], other.state["enq_limit"]) == (5 * SECOND, 5, 7)
    other.done("set_timeout", cycles=40)
    other.done("set_naks", naks=2)
    other.done("set_enqs", enqs=4)
    assert (other.state["ack_timeout"], other.state["nak_limit"], other.state["enq_limit"]) == (SECOND, 2, 4)


@pytest.mark.parametrize(
    ("processor", "expected"),
    [
        (
            "slc",
            {"family": "slc", "processor_name": "SLC 5/04", "interface": "DF1 full duplex", "mode": 6, "owner": 0x3F},
        ),
        ("micrologix", {"family": "slc", "processor_name": "MicroLogix 1000"}),
        ("plc5", {"family": "plc5", "processor_name": "PLC-5/40", "mode": 6, "memory_size": 16384, "node": NODE}),
        ("plc5_250", {"family": "plc5_250", "mode": 6, "node": NODE}),
        ("plc3", {"family": "plc3", "port": "RS-232", "unused_memory": 8192}),
        ("plc2", {"family": "plc2_module", "module_name": "1771-KG", "processor_name": "PLC-2"}),
        ("plc1774", {"family": "plc2_module", "module_name": "1771-KA, KA2, 1774-KA", "processor_name": "PLC"}),
    ],
)
def test_status_of_every_family(processor: str, expected: dict[str, Any]) -> None:
    status = Pair(processor).gives("status")
    assert {name: status[name] for name in expected} == expected


def test_counters_are_read_by_name() -> None:
    octets = "0B00 0500 0600 0100 0200 0300 0900 0400 0000 0700 0100 0800 0A00 0B00"
    counters = decoded("counter_block", bytes.fromhex(octets), module="slc_df1")
    assert (counters["sent"], counters["received"], counters["duplicates"], counters["modem_lost"]) == (5, 6, 7, 10)
    assert (counters["cts"], counters["rts"], counters["dcd"]) == (1, 1, 1)
    assert counters["normal_last_scan"] == 300_000_000


# ---- modes and resources ---------------------------------------------------------------------------------------


def test_modes() -> None:
    slc = Pair("slc")
    slc.done("change_mode", mode="test_single_scan")
    assert slc.gives("status")["mode"] == 8
    micro = Pair("micrologix")
    micro.done("change_mode", mode="program")
    assert micro.gives("status")["mode"] == 1
    micro.done("change_mode", mode="run")
    assert micro.gives("status")["mode"] == 6
    plc5 = Pair("plc5")
    plc5.done("change_mode", mode="remote_test")
    plc5.done("change_mode", mode="no_change")
    assert plc5.gives("status")["mode"] == 5
    plc5.state.set("processor_mode", 2)
    assert plc5.refused("change_mode", mode="program") == 0xF00B


def test_forces_memory_and_compatibility_file() -> None:
    pair = Pair("slc")
    pair.state.set("forces", 3)
    pair.done("disable_forces")
    assert pair.state["forces"] == 1
    assert pair.refused("initialize_memory") == 0xF00E
    pair.done("change_mode", mode="program")
    pair.done("initialize_memory")
    assert pair.state["initialized"] == 1
    plc5 = Pair("plc5")
    plc5.done("set_compatibility_file", node_address=0, file=17)
    assert plc5.state["compatibility"][0] == 17


def test_edit_resource_and_ports() -> None:
    pair = Pair("slc")
    assert pair.refused("apply_ports") == 0xF00B
    pair.done("get_edit_resource")
    assert pair.gives("status")["owner"] == 0
    pair.done("apply_ports", ports=[0, 1])
    assert pair.state["ports_applied"] == [0, 1]
    pair.done("return_edit_resource")
    pair.state.set("edit_owner", 9)
    assert pair.call("get_edit_resource").meaning == "another node is program owner"
    pair.done("command_list", commands=b"\x01\x02")
    assert pair.state["commands_listed"] == b"\x01\x02"


def test_what_a_processor_does_not_execute_it_refuses() -> None:
    assert Pair("slc").refused("disable_outputs") == 0x10
    assert Pair("plc2").refused("get_edit_resource") == 0x10
    assert Pair("plc5").refused("shutdown") == 0x10


# ---- data commands that READ and WRITE do not use ----------------------------------------------------------------


@pytest.mark.parametrize(("processor", "file"), [("plc2", "PLC2"), ("slc", "file9"), ("micrologix", "file7")])
def test_the_compatibility_file(processor: str, file: str) -> None:
    pair = Pair(processor, byte_addresses=True)
    pair.done("unprotected_write", address=4, data=b"\x34\x12\x78\x56")
    assert pair.gives("unprotected_read", address=4, size=4) == b"\x34\x12\x78\x56"
    assert pair.memory.read(file, "byte", 4, 4) == [0x34, 0x12, 0x78, 0x56]


def test_words_of_the_compatibility_file() -> None:
    """Compatibility file 2.1: an SLC counts words unless S:2/8 is set (`byte_addresses`)."""
    for given, byte in (({}, 6), ({"byte_addresses": True}, 3)):
        pair = Pair("slc", **given)
        pair.done("unprotected_write", address=3, data=b"\x34\x12")
        assert pair.memory.read("file9", "byte", byte, 2) == [0x34, 0x12]
        assert pair.gives("unprotected_read", address=3, size=2) == b"\x34\x12"


def test_the_compatibility_file_of_a_plc5_is_that_of_the_sender() -> None:
    pair = Pair("plc5")
    pair.done("set_compatibility_file", node_address=0, file=7)
    pair.done("unprotected_write", address=0, data=b"\x01\x02")
    assert pair.memory.read("file7", "word", 0, 1) == [0x0201]


def test_the_compatibility_file_of_a_plc3_has_the_octal_number_of_the_sender() -> None:
    pair = Pair("plc3", node=8)
    pair.done("unprotected_write", address=0, data=b"\x01\x02")
    assert pair.memory.read("file10", "word", 0, 1) == [0x0201]


def test_a_plc3_refuses_odd_addresses_and_sizes() -> None:
    """The list of 2.8: STS 10; 30 after a shutdown."""
    pair = Pair("plc3")
    for kind in ("protected_write", "unprotected_write"):
        assert pair.refused(kind, address=3, data=b"\x01\x02") == 0x10
        assert pair.refused(kind, address=2, data=b"\x01") == 0x10
    assert pair.refused("unprotected_read", address=3, size=2) == 0x10
    assert pair.refused("unprotected_read", address=2, size=3) == 0x10
    assert pair.refused("file_write_words", file=7, data=b"\x01\x02\x03") == 0x10
    assert pair.refused("file_write_words", file=7, data=b"") == 0x10
    assert pair.refused("word_range_read", file=7, element=0, words=0) == 0x10
    pair.done("upload_request")
    pair.done("shutdown")
    assert pair.refused("unprotected_read", address=2, size=2) == 0x30
    assert pair.refused("word_range_read", file=7, element=0, words=1) == 0x30
    pair.done("restart_request")
    pair.done("unprotected_write", address=2, data=b"\x01\x02")


@pytest.mark.parametrize("kind", ["protected", "unprotected"])
def test_bits_and_protected_writes(kind: str) -> None:
    pair = Pair("plc2")
    pair.memory.write("PLC2", "byte", 8, [0xF0, 0x81])
    pair.done(f"{kind}_bits", blocks=[{"address": 8, "set": 1, "reset": 0x80}, {"address": 9, "set": 0, "reset": 1}])
    assert pair.memory.read("PLC2", "byte", 8, 2) == [0x71, 0x80]


def test_protected_commands_stay_in_their_window() -> None:
    pair = Pair("plc2")
    pair.state.set("open_from", 16)
    pair.state.set("open_to", 32)
    pair.done("protected_write", address=30, data=b"\x01\x02")
    assert pair.refused("protected_write", address=31, data=b"\x01\x02") == 0x50
    assert pair.refused("protected_bits", blocks=[{"address": 15, "set": 1, "reset": 0}]) == 0x50


def test_words_typed_values_and_masks() -> None:
    pair = Pair("plc5")
    pair.done("word_range_write", file=7, element=3, data=b"\x34\x12\x78\x56")
    assert pair.gives("word_range_read", file=7, element=3, words=2) == b"\x34\x12\x78\x56"
    pair.done("typed_write", file=7, element=0, data=b"\xff\x00\x0f\x00")
    values = pair.gives("typed_read", file=7, element=0, count=2)
    assert (values["element_id"], values["values"]) == (4, b"\xff\x00\x0f\x00")
    pair.done("read_modify_write", sets=[{"file": 7, "element": 0, "and_mask": 0xFFF0, "or_mask": 0x100}])
    assert pair.memory.read("file7", "word", 0, 1) == [0x01F0]
    section = pair.gives("section_size", file=4)
    assert (section["size"], section["count"]) == (3000, 1000)


def test_masks_change_words_of_elements_of_several_words() -> None:
    pair = Pair("plc5")
    pair.done("read_modify_write", sets=[{"file": 14, "element": 2, "sub": 1, "and_mask": 0xFFFF, "or_mask": 0x8000}])
    assert pair.memory.read("file14", "word", 0, 14) == [0] * 13 + [0x8000]


def test_words_with_masks_of_their_own_size() -> None:
    pair = Pair("plc5_250")
    pair.memory.write("file7", "word", 1, [0x00FF])
    sets = [{"area": 2, "section": 1, "file": 7, "element": 1, "mask_size": 2, "and_mask": 0x0F0F, "or_mask": 0x8000}]
    assert pair.gives("read_modify_write_n", sets=sets) == b"\x0f\x80"
    assert pair.refused("read_modify_write_n", sets=[{**sets[0], "mask_size": 4}]) == 0xF012
    section = pair.gives("section_size", file=7)
    assert (section["size"], section["write_privilege"]) == (1000, 1)


def test_logical_commands_with_two_and_three_fields() -> None:
    pair = Pair("slc")
    pair.done("logical_write_3", file=7, file_type=0x89, element=2, data=b"\x11\x22")
    pair.done("logical_write_2", file=7, file_type=0x89, element=3, data=b"\x33\x44")
    assert pair.gives("logical_read_3", file=7, file_type=0x89, element=2, size=4) == b"\x11\x22\x33\x44"
    assert pair.gives("logical_read_2", file=7, file_type=0x89, element=3, size=2) == b"\x33\x44"
    pair.done("logical_write_masked", file=7, file_type=0x89, element=2, mask=0xFF00, value=0xAB00)
    assert pair.memory.read("file7", "word", 2, 1) == [0xAB11]
    assert pair.refused("logical_write_3", file=7, file_type=0x55, element=2, data=b"\x11\x22") == 0xF006


def test_program_files_are_opened_read_written_and_closed() -> None:
    pair = Pair("slc")
    tag = pair.gives("open_file", file=0, protection=3)
    pair.done("file_write", tag=tag, offset=2, data=b"\x01\x02\x03\x04")
    assert pair.gives("file_read", tag=tag, offset=1, size=6) == b"\0\0\x01\x02\x03\x04"
    pair.done("close_file", tag=tag)
    assert pair.refused("file_read", tag=tag, size=2) == 0xF012
    pair.memory.write("file7", "word", 0, [1, 2, 3])
    tag = pair.gives("open_file", file=7, file_type=0x89)
    assert pair.gives("file_read", tag=tag, offset=1, size=4, file_type=0x89) == b"\x02\0\x03\0"
    assert pair.refused("file_write", tag=tag, data=b"\0\0") == 0xF00B


# ---- procedures ------------------------------------------------------------------------------------------------


def part(address: int, data: bytes) -> bytes:
    """Return a part of an image in the format of an upload."""
    return address.to_bytes(4, "little") + len(data).to_bytes(4, "little") + data


def filled(pair: Pair, seed: int = 7) -> bytes:
    """Fill the physical memory of a device; return its content."""
    memory = bytes((place * seed + (place >> 8)) & 0xFF for place in range(16384))
    pair.state.set("physical", memory)
    return memory


def test_a_plc2_is_uploaded_and_downloaded() -> None:
    pair = Pair("plc2")
    memory = filled(pair)
    assert pair.refused("physical_read", address=0, size=10) == 0x70
    image = pair.gives("upload", size=300)
    assert image == part(0, memory[:300]) and pair.state["transfer_kind"] == 0
    pair.done("download", image=part(10, b"\xaa" * 200) + part(1000, b"\x10" * 3), words=512)
    assert pair.state["physical"][10:210] == b"\xaa" * 200 and pair.state["physical"][1000:1003] == b"\x10" * 3
    assert (pair.state["table_size"], pair.state["scanning"], pair.state["transfer_kind"]) == (1024, 1, 0)
    assert pair.refused("set_table_size", size=1024) == 0x70


def test_a_plc3_is_uploaded_and_downloaded() -> None:
    pair = Pair("plc3", block_size=238)
    memory = filled(pair)
    assert pair.refused("plc3_read_physical", address=0, size=10) == 0xF00B
    assert pair.gives("upload") == part(0, memory) and not pair.state["shut_down"]
    pair.done("download", image=part(100, b"\xaa" * 300))
    assert pair.state["physical"][200:500] == b"\xaa" * 300
    assert (pair.state["shut_down"], pair.state["transfer_owner"]) == (0, 0xFF)


def test_a_plc5_is_uploaded_by_its_lists_of_segments() -> None:
    pair = Pair("plc5", block_size=238)
    memory = filled(pair)
    lists = "02 00 00 00 00 0D 00 00 00 00 0A 00 00 FF 0B 00 00 01 00 0A 00 00 7F 0A 00 00"
    pair.state.set("segment_lists", bytes.fromhex(lists))
    assert pair.gives("upload") == part(0, memory[:14]) + part(0xA00, memory[0xA00:0xC00])
    assert pair.state["transfer_owner"] == 0xFF
    pair.done("download", image=part(0xA00, b"\x55" * 500))
    assert pair.state["physical"][0xA00:0xBF4] == b"\x55" * 500
    assert pair.gives("status")["mode"] == 4
    assert pair.refused("read_physical", address=0, size=2) == 0xF00B


def test_an_old_plc5_is_uploaded_in_fixed_blocks() -> None:
    pair = Pair("plc5", transfer="blocks")
    memory = filled(pair)
    assert pair.gives("upload") == part(0, memory[:14]) + part(0xA00, memory[0xA00:0x3FF0])
    pair.done("download", image=part(0, b"\x01" * 14))
    assert pair.state["physical"][:16] == b"\x01" * 14 + memory[14:16]
    assert pair.gives("status")["family"] == "plc5_15"


class SlowPair(Pair):
    """A pair on a line that takes 400 ms for each transmission; `asked` are the functions of commands 0F."""

    def until_done(self, begin: Callable[[Done], list[Command]]) -> TransferResult:
        results: list[TransferResult] = []
        self.asked: list[int] = []
        self.asking.do(begin(results.append))
        sides = (self.asking, self.device)
        while not results:
            for side, peer in (sides, sides[::-1]):
                for data in side.taken():
                    for one in sides:
                        one.run(400_000_000)
                    packet = data[2:].replace(b"\x10\x10", b"\x10")
                    if side is self.asking and packet[2:3] == b"\x0f":
                        self.asked.append(packet[6])
                    peer.do(peer.engine.receive(data, peer.now))
            for side in sides:
                side.run(0)
        return results[0]


def test_a_slow_upload_of_an_old_plc5_renews_its_request() -> None:
    """The request lapses after 90 s (3.8, 3.9)."""
    pair = SlowPair("plc5", transfer="blocks")
    memory = filled(pair)
    assert pair.gives("upload") == part(0, memory[:14]) + part(0xA00, memory[0xA00:0x3FF0])
    assert pair.asked.count(0x17) == 1 + 107 + 1
    assert pair.asked.count(0x53) == 4


def test_an_slc_is_uploaded_and_downloaded() -> None:
    for kind in ("modular", "fixed"):
        pair = Pair("slc", slc_kind=kind)
        directory = b"\x40\x00" + bytes(range(2, 64))
        words = bytes(range(256)) * 2
        image = part(0, directory) + part(2 << 24 | 0x89 << 16 | 7, words) + part(4 << 24 | 0x8A << 16 | 8, words[:40])
        more = {"ports": [0], "commands": b"\x01"} if kind == "modular" else {}
        pair.done("download", image=image, **more)
        assert pair.state["directory"][:64] == directory and pair.memory.read("file8", "byte", 0, 4) == [0, 1, 2, 3]
        assert (pair.state["edit_owner"], pair.gives("status")["mode"]) == (0xFF, 1)
        files = [
            {"file": 7, "file_type": 0x89, "elements": 256, "element_size": 2},
            {"file": 8, "file_type": 0x8A, "elements": 10, "element_size": 4},
        ]
        assert pair.gives("upload", directory_size=64, files=files) == image
        assert not pair.state["open_files"]


def test_a_transfer_that_fails_gives_the_privilege_back() -> None:
    pair = Pair("plc5")
    result = pair.call("download", image=part(16380, b"\0" * 10))
    assert (result.outcome, result.cause) == ("transfer_failed", "transaction size and address too large")
    assert pair.state["transfer_owner"] == 0xFF
    pair.state.set("transfer_owner", 3)
    result = pair.call("upload")
    assert (result.outcome, result.cause) == ("refused", "access denied")


# ---- names of status codes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "service", "arguments", "meaning"),
    [
        ("common", "disable_outputs", {}, "illegal command or format"),
        ("plc2", "disable_outputs", {}, "wrong command, function, or size of command or reply"),
        ("plc3", "disable_outputs", {}, "wrong format, size or address of the command"),
        (
            "plc3",
            "protected_write",
            {"address": 1, "data": b"\1"},
            "address missing or odd, or an odd number of data octets",
        ),
        ("plc3", "unprotected_bits", {"blocks": []}, "data are no multiple of 4 octets"),
        ("common", "apply_ports", {}, "access denied"),
        ("dh485", "apply_ports", {}, "access denied, privilege violation"),
        ("plc3", "apply_ports", {}, "no access"),
    ],
)
def test_codes_are_named_as_the_kind_of_node_means_them(
    names: str, service: str, arguments: dict[str, Any], meaning: str
) -> None:
    assert Pair("slc").call(service, {"status_names": names}, **arguments).meaning == meaning


def test_what_an_error_reply_tells_more() -> None:
    for tail, meaning in (
        ("1B 09", "another node is program owner (node 9)"),
        ("1A", "file open, another node owns it"),
        ("12 07 00 2C 01", "invalid parameter or data (file 7, element 300)"),
        ("12", "invalid parameter or data"),
        ("99", ""),
    ):
        pair = Pair("slc")
        results: list[TransferResult] = []
        options: dict[str, Any] = {"station": NODE, "now": 0, "on_done": results.append}
        pair.asking.do(pair.client.call("get_edit_resource", {}, **options).commands)
        pair.asking.run(SECOND // 10)
        pair.asking.gets(b"\x10\x06")
        packet = bytes.fromhex("00 05 4F F0 01 00" + tail)
        pair.asking.gets(b"\x10\x02" + packet + b"\x10\x03" + crc16(packet + b"\x03"))
        pair.asking.run(SECOND // 10)
        assert [result.meaning for result in results] == [meaning]


def crc16(data: bytes) -> bytes:
    """Return the CRC of the link."""
    register = 0
    for octet in data:
        register ^= octet
        for _ in range(8):
            register = register >> 1 ^ (0xA001 if register & 1 else 0)
    return register.to_bytes(2, "little")


# ---- blocks of octets by module and family -------------------------------------------------------------------------


def decoded(layout: str, octets: bytes, **params: Any) -> Any:
    protocol, codec = compiled(text())
    return read_layout(codec.layouts[layout][1], octets, Scope(protocol, role="full", own=0, params=params))


@pytest.mark.parametrize(
    ("module", "places"),
    [
        ("micrologix_df1", {"sent": (2, 2), "enqs_sent": (8, 2), "no_memory": (16, 2), "framing_errors": (20, 2)}),
        ("plc5", {"received": (4, 2), "naks_sent": (16, 2), "characters_dropped": (20, 2), "modem_lost": (24, 2)}),
        (
            "kf2_dh",
            {
                "send_attempts": (21, 2),
                "acks_passed": (27, 1),
                "received": (34, 2),
                "naks_sent": (38, 1),
                "eots_sent": (50, 1),
                "dcd_timeouts": (54, 1),
            },
        ),
        (
            "kf2_dh_plus",
            {"send_attempts": (35, 2), "not_for_node": (63, 1), "eots_sent": (64, 1), "dcd_timeouts": (68, 1)},
        ),
        (
            "kg",
            {
                "send_attempts": (0, 2),
                "not_sent": (11, 1),
                "polls_seen": (29, 1),
                "eots_sent": (30, 1),
                "to_line": (35, 1),
                "initiated": (42, 2),
                "replies_received": (48, 2),
                "resyncs": (51, 1),
            },
        ),
        ("kfc", {"received": (0, 2), "line_errors": (9, 1), "net_sent": (14, 2)}),
        (
            "ka_1775",
            {
                "commands_sent": (29, 2),
                "undeliverable": (45, 1),
                "ack_timeout": (46, 2),
                "enq_limit": (49, 1),
                "enqs_now": (51, 1),
            },
        ),
        ("dh485", {"received": (0, 2), "bad_packets": (8, 1), "illegal_type": (9, 1)}),
        ("dh485_long", {"crc_errors": (10, 1), "unexpected_characters": (14, 1)}),
        ("kt_dh_plus", {"duplicate_tokens": (9, 1), "sent": (22, 2), "replies_lost": (34, 1), "active_nodes": (35, 1)}),
        ("kp5_dh_plus", {"token_timeouts": (9, 1), "sent": (21, 2), "active_nodes": (34, 1)}),
        ("ka_dh_plus", {"duplicate_nodes": (10, 1), "sent": (23, 2), "active_nodes": (36, 1)}),
        ("ka_dh", {"bad_crc": (12, 1), "sent": (17, 2), "replies_lost": (29, 1)}),
        ("s5_dh_plus", {"undelivered": (4, 1), "node_recoveries": (16, 1), "dead_timeouts": (17, 2)}),
        ("slc_dh_plus", {"received": (0, 2), "network_dead": (10, 2), "bad_packets": (32, 2), "sdn_received": (62, 2)}),
        (
            "plc5_dh_plus",
            {"sent": (2, 2), "claims_won": (12, 2), "sda_timeouts": (44, 2), "solicit_rotations": (60, 2)},
        ),
        (
            "plc5_e_dh_plus",
            {"ack_timeouts": (0, 1), "retries": (7, 1), "adapter_timeouts": (30, 1), "replies_lost": (31, 1)},
        ),
        ("plc5_250_dh_plus", {"sent": (0, 2), "undelivered": (4, 1), "bad_crc": (13, 1), "dead_timeouts": (17, 1)}),
        (
            "ka_1771",
            {
                "ack_bad_crc": (0, 1),
                "no_receive_buffer": (11, 1),
                "sent": (17, 2),
                "commands_received": (23, 2),
                "resyncs": (28, 1),
                "replies_lost": (30, 1),
            },
        ),
        ("kc_1771", {"acks_received": (21, 2), "naks_sent": (27, 2), "replies_lost": (29, 1), "enq_preset": (32, 1)}),
        (
            "ka3_dh_plus",
            {"duplicate_nodes": (10, 1), "active_nodes": (36, 1), "breaks": (37, 1), "edits_timed_out": (42, 1)},
        ),
        (
            "ka5_dh_plus",
            {
                "ack_timeouts": (1, 1),
                "bad_crc": (15, 1),
                "nak_no_memory_sent": (18, 1),
                "received": (25, 2),
                "active_nodes": (36, 1),
            },
        ),
        ("ka5_dh485", {"received": (0, 2), "ack_timeouts": (4, 1), "failures": (5, 1), "bad_packets": (8, 1)}),
    ],
)
def test_counters_stand_where_the_manual_says(module: str, places: dict[str, tuple[int, int]]) -> None:
    protocol, _ = compiled(text())
    octets = bytes(range(1, 1 + int(protocol.tables["counter_sizes"].entries[module])))
    counters = decoded("counter_block", octets, module=module)
    for name, (offset, size) in places.items():
        assert counters[name] == int.from_bytes(octets[offset : offset + size], "little"), name
    assert not counters.get("more")
    assert decoded("counter_block", octets + b"\xee", module=module)["more"] == b"\xee"


@pytest.mark.parametrize(
    ("module", "places"),
    [
        (
            "kf2_dh",
            {"ack_bad_crc": (0, 1), "false_polls": (7, 1), "aborted": (16, 1), "sent": (17, 2), "received": (19, 2)},
        ),
        ("kf2_dh_plus", {"ack_bad_crc": (0, 1), "bad_crc": (13, 1), "commands_sent": (25, 2), "active_nodes": (34, 1)}),
        ("ka_1775", {"ack_when_not_master": (8, 1), "sent": (17, 2), "replies_sent": (27, 2)}),
    ],
)
def test_counters_of_the_network_of_a_module_with_two_links(module: str, places: dict[str, tuple[int, int]]) -> None:
    protocol, _ = compiled(text())
    octets = bytes(range(1, 1 + int(protocol.tables["counter_sizes"].entries[module])))
    network = decoded("counter_block", octets, module=module)["network"]
    for name, (offset, size) in places.items():
        assert network[name] == int.from_bytes(octets[offset : offset + size], "little"), name


def test_a_plc_5_with_ethernet_counts_words_high_byte_first_and_racks_in_lists() -> None:
    counters = decoded("counter_block", bytes(range(32)), module="plc5_e_dh_plus")
    assert (counters["sent"], counters["replies_sent"]) == (0x0809, 0x1011)
    assert counters["rack_timeouts"] == [18, 19, 20]
    assert counters["rack_retries"] == [27, 28, 29]


@pytest.mark.parametrize(
    ("octets", "expected"),
    [
        (
            "00 EE 1F 1A 05 35 30 30 20 20 20 20 20 20 20 20 01 00 66 80 34 12 10 FC",
            {
                "family": "slc",
                "processor_name": "SLC 500 fixed",
                "interface": "DH485",
                "release": 5,
                "name": "500",
                "major_error": 1,
                "mode": 6,
                "forces_active": 1,
                "forces_installed": 1,
                "first_pass": 1,
                "program_id": 0x1234,
                "ram": 16,
                "owner": 0x3F,
            },
        ),
        (
            "40 EE 31 5B 20 35 2F 30 34 20 20 20 20 20 20 20 00 00 3E 00 00 00 14 F8",
            {
                "testing_edits": 1,
                "processor_name": "SLC 5/04",
                "interface": "DH+",
                "series": 1,
                "mode": 0x1E,
                "owner": 0x3E,
            },
        ),
        (
            "00 FE 2C 00 21 31 37 34 37 2D 4B 45 20 20 20 20 00 00 00 00 00 00 00 00",
            {"family": "dh485_module", "name": "1747-KE", "revision": 1, "series": 1},
        ),
        (
            "8A BB 00 40 00 00 22 07 FD 01 0A 00 03 00 11 02 00",
            {
                "family": "plc5_15",
                "mode": 2,
                "fault": 1,
                "edits": 1,
                "memory_size": 0x4000,
                "node": 7,
                "data_files": 10,
                "program_files": 3,
                "forces_active": 1,
                "forces_present": 1,
                "protect": 2,
                "not_double_density": 1,
                "adapter": 0,
            },
        ),
        (
            "06 EB 13 00 40 00 00 22 07 09 66 0A 00 03 00 00 00 00",
            {"adapter": 1, "upper_half_of_group_4": 1, "half_rack": 1, "dh_plus_115k": 1, "not_double_density": 0},
        ),
        (
            "06 EB 31 00 40 00 00 22 07 FD 01 0A 00 03 00 02 00 00",
            {"family": "plc5", "processor_name": "PLC-5/11", "mode": 6, "sub_revision": 1},
        ),
        (
            "06 EB 4A 00 40 00 00 22 07 FD 01 0A 00 03 00 02 00 00 "
            "01 02 00 03 00 1E 00 0F 00 0C 00 15 00 0B 00 CC 07 04",
            {"processor_name": "PLC-5/20E", "hold_file": 2, "edit_second": 30, "edit_year": 1996, "port": 4},
        ),
        (
            "22 DE 07 19 05 01 00 02 00 03 00",
            {
                "family": "plc5_250",
                "mode": 2,
                "off_line": 1,
                "forces": 1,
                "edit_resource": 1,
                "outputs_reset": 1,
                "node": 5,
                "change_counter_3": 3,
            },
        ),
        (
            "22 07 10 01 00 00 34 12 41 00 01 00 A8 2F 02 00 00 00",
            {
                "family": "plc3",
                "mode": 2,
                "is_shut_down": 1,
                "context": 1,
                "thumbwheel": 1,
                "counters_address": 0x1234,
                "revision": 1,
                "series": 2,
                "unused_memory": 0x012FA8,
                "memory_words": 0x020000,
            },
        ),
        (
            "12 13 00 01 00 00 00 02 22 07",
            {
                "family": "plc2_module",
                "mode": 2,
                "transfer_mode": 1,
                "module_name": "1771-KE, KF, 1770-KF2",
                "processor_name": "PLC-2",
                "program_start": 256,
                "counters_address": 0x200,
                "options": 7,
            },
        ),
        (
            "02 ED 20 00 01 00 00 00 02 22 07",
            {"family": "ka3_1785", "module_name": "1785-KA3", "processor_name": "PLC-2/17", "counters_address": 0x200},
        ),
        (
            "02 ED 20 00 01 00 00 00 02 22 58 05 0A",
            {
                "other_plc2": 0,
                "protected_commands": 1,
                "unprotected_commands": 1,
                "physical_writes": 1,
                "sends_unprotected": 0,
                "terminal_connected": 1,
                "terminal_edits_by_link": 0,
                "terminal_edits": 1,
                "io_racks": 2,
                "was_forced": 1,
            },
        ),
        (
            "00 FE 19 00 00 01 00 02 21 05",
            {
                "family": "ke_1785",
                "node_table": 0x100,
                "counters_address": 0x200,
                "revision": 1,
                "series": 1,
                "options": 5,
                "rate_57600": 0,
                "dsr": 1,
                "switches": 0x1F,
            },
        ),
        ("00 FE 19 00 00 03 00 04", {"family": "ke_1785", "node_table": 0x300, "counters_address": 0x400}),
        (
            "00 EE 10 10 00 01 00 02 21 00 00 03",
            {"family": "ka_1785", "other_counters_address": 0x100, "counters_address": 0x200, "node_table": 0x300},
        ),
        (
            "01 EE 10 10 00 01 00 02 21 32 00 03",
            {
                "on_line": 1,
                "dh_rate_undefined": 0,
                "dh_plus_rate_undefined": 1,
                "redundancy_switch": 1,
                "is_primary": 1,
            },
        ),
        ("00 EE 30 2F 00 01 00 02 21 00 00 03", {"family": "ka5_1785", "counters_address": 0x200}),
        (
            "EE 30 2F 21 31 37 38 35 2D 4B 41 35 00 00 00 00 00 00 00 00 00 00 00",
            {"family": "ka5_1785_dh485", "processor_type": 0x2F, "revision": 1, "series": 1, "name": "1785-KA5"},
        ),
        (
            "00 EE 1A 17 00 00 00 01 00 02 21 32",
            {"family": "kp5_1779", "node_table": 0x100, "counters_address": 0x200, "rate": 230400, "route_updates": 3},
        ),
        (
            "00 FE 1B 00 00 00 44 41 03 00 20 20 20 20 20 20 20 20",
            {"family": "kt_1784", "counters_address": 0x4144, "revision": 3},
        ),
        (
            "01 98 10 09 05 90 00 02 21 00",
            {
                "family": "ka_1773",
                "dh_protected_disabled": 1,
                "dh_unprotected_disabled": 0,
                "dh_node": 9,
                "no_parity": 1,
                "rate": 4800,
                "embedded_disabled": 1,
                "full_duplex": 1,
                "counters_address": 0x200,
                "revision": 1,
                "series": 1,
            },
        ),
        # option switches of the modules of a PLC-2: the 1771-KA2 (series B and on) has the opposite bits of the 1771-KA
        (
            "02 11 00 01 00 00 00 02 00 D8",
            {"rate_57600": 1, "other_plc2": 1, "protected_commands": 0, "physical_writes": 0, "sends_unprotected": 0},
        ),
        (
            "02 11 00 01 00 00 00 02 20 DB",
            {"rate_57600": 1, "other_plc2": 0, "protected_commands": 1, "physical_writes": 1, "sends_unprotected": 1},
        ),
        (
            "02 01 00 01 00 40 00 02 20 30",
            {"unprotected_commands": 1, "physical_writes": 1, "port_a": 1, "outputs_off": 1, "rate_57600": 1},
        ),
        ("00 F3 00 00 00 00 00 02 60 A8", {"rate_57600": 1, "sw2": 0x0A}),
        (
            "02 14 00 01 00 00 00 02 00 D9",
            {"half_duplex": 1, "physical_writes": 0, "embedded_responses": 1, "even_parity": 1, "rate": 9600},
        ),
        (
            "02 14 00 01 00 00 00 02 20 EA",
            {"first_module": 1, "crc": 0, "embedded_responses": 1, "half_duplex": 0, "even_parity": 0, "rate": 19200},
        ),
        (
            "02 14 00 01 00 00 00 02 20 19",
            {"line_options": 7, "crc": 1, "embedded_responses": 0, "half_duplex": 1, "even_parity": 0, "rate": 110},
        ),
        (
            "02 15 00 01 00 00 00 02 00 C9",
            {"line_options": 3, "crc": 1, "embedded_responses": 1, "half_duplex": 1, "rate": 9600},
        ),
        (
            "00 EE 34 58 00 4D 49 43 52 4F 20 20 20 20 20 20 00 00 06 11 00 00 08 FC",
            {"processor_name": "MicroLogix 1000", "fault_override": 1, "always_run": 1, "halted": 0, "ram": 8},
        ),
    ],
)
def test_status_replies_say_themselves_whose_they_are(octets: str, expected: dict[str, Any]) -> None:
    status = decoded("processor_status", bytes.fromhex(octets))
    assert {name: status[name] for name in expected} == expected


def test_a_1773_ka_has_the_status_of_eight_controllers() -> None:
    group = bytes(range(1, 14))
    status = decoded("processor_status", bytes.fromhex("03 98 00 00 00 00 00 02 21 00") + group * 2 + bytes(13) * 6)
    assert len(status["controllers"]) == 8
    first = status["controllers"][0]
    assert (first["program_id"], first["error_address"], first["mode"], first["used_end"]) == (1, 0x0807, 9, 0x0D0C)


def test_a_read_is_planned_once_and_its_packets_are_new_every_time(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = Pair("slc")
    plans: list[str] = []
    real = Planner.plan

    def plan(planner: Planner, service: str, *given: Any, **more: Any) -> RowPlan:
        plans.append(service)
        return real(planner, service, *given, **more)

    monkeypatch.setattr(Planner, "plan", plan)
    for value in range(5):
        pair.memory.write("file7", "word", 0, [value])
        result = pair.until_done(
            lambda done: pair.client.read("N7:0", station=NODE, count=1, now=pair.asking.now, on_done=done).commands
        )
        assert (result.ok, result.values) == (True, [value]), result
    assert plans == ["read"]

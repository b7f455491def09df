"""Counters of a simulated processor, and its answer to the command that reads them."""

from __future__ import annotations

from typing import Any

import pytest
from link.link_world import SECOND, Side
from link.test_df1_commands import Pair, text

BROKEN = bytes.fromhex("10 02 05 00 06 00 01 00 03 10 03 00 00")


@pytest.mark.parametrize(
    ("processor", "expected"),
    [
        # five reads before: their replies are acknowledged, the reply with the counters is not sent yet
        ("slc", {"sent": 5, "received": 6, "undelivered": 0, "retried": 0, "bad_packets": 0, "duplicates": 0}),
        ("micrologix", {"sent": 5, "received": 6, "enqs_received": 0, "no_memory": 0}),
        ("plc5", {"sent": 5, "received": 6, "naks_sent": 0}),
        ("plc5_250", {"sent": 5, "received": 6}),
        ("plc3", {"replies_sent": 5, "commands_received": 6, "acks_received": 5, "acks_sent": 6, "nak_limit": 3}),
        ("plc2", {"send_attempts": 5, "acknowledged": 5, "acks_received": 5, "received": 6, "acks_sent": 6}),
    ],
)
def test_a_processor_counts_its_messages(processor: str, expected: dict[str, int]) -> None:
    pair = Pair(processor)
    for number in range(5):
        pair.done("echo", data=bytes([number]))
    counters = pair.gives("read_counters")
    assert {name: counters[name] for name in expected} == expected


def test_a_processor_counts_what_goes_wrong_on_its_line() -> None:
    pair = Pair("micrologix")
    pair.done("echo", data=b"\1")
    pair.device.do(pair.device.engine.receive(BROKEN, pair.device.now))
    pair.device.run(1_000_000_000)
    pair.device.do(pair.device.engine.receive(b"\x10\x05", pair.device.now))
    pair.device.taken()
    counters = pair.gives("read_counters")
    assert (counters["bad_packets"], counters["enqs_received"], counters["received"]) == (1, 1, 2)
    assert Pair("plc5").gives("read_counters")["bad_packets"] == 0


def test_counters_are_reset() -> None:
    pair = Pair("slc")
    for number in range(3):
        pair.done("echo", data=bytes([number]))
    pair.done("reset_counters")
    counters = pair.gives("read_counters")
    assert (counters["sent"], counters["received"]) == (1, 1)  # the reply to the reset, and the command that reads


def test_a_module_with_two_links_counts_on_the_serial_one() -> None:
    for module in ("kf2_dh", "kf2_dh_plus"):
        pair = Pair("plc2", module=module)
        pair.done("echo", data=b"\1")
        counters = pair.gives("read_counters")
        assert (counters["acknowledged"], counters["received"]) == (1, 2)
        assert counters["network"]["sent"] == 0


def test_a_part_of_the_counters_is_read() -> None:
    pair = Pair("plc2")
    pair.done("echo", data=b"\1")
    assert part(pair, 2, 2) == b"\1\0"  # messages acknowledged, the two octets at offset 2
    pair = Pair("plc5")
    pair.done("echo", data=b"\1")
    assert part(pair, 77, 4)[2:] == b"\1\0"  # a PLC-5 does not look at the address


def part(pair: Pair, address: int, size: int) -> bytes:
    result = pair.call("read_counters", params={"module": "octets"}, address=address, size=size)
    assert result.ok, result
    value: dict[str, Any] = dict(result.gives["counters"])
    return bytes(value["more"])


def test_an_slc_has_counters_at_address_0_only() -> None:
    assert Pair("slc").refused("read_counters", address=2) == 0x10


def test_a_module_without_a_line_of_ours_answers_from_its_state() -> None:
    pair = Pair("slc", module="slc_dh_plus")
    pair.state.set("counters", bytes(range(1, 65)) + bytes(180))
    assert pair.gives("read_counters")["sent"] == 0x0403
    pair.done("reset_counters")
    assert pair.gives("read_counters")["sent"] == 0


def test_a_master_measures_the_passes_of_its_poll_lists() -> None:
    lists = {"normal_nodes": [1, 2], "priority_nodes": [7], "ack_timeout": SECOND, "poll_tries": 1}
    master = Side(text(), "master", own=0, params=lists)
    for _ in range(100):
        master.run(SECOND // 10)
    scope = master.engine.scope
    assert (scope["priority_longest"], scope["normal_longest"]) == (10, 20), "no node answers, 1 s each"
    assert (scope["priority_scan"], scope["normal_scan"]) == (0, 0), "then they are inactive"

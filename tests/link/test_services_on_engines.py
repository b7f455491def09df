"""Clients and servers of the shipped protocols on two engines with a virtual line: frames and times."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link.link_world import MS, SECOND, Side, compiled
from link.test_serving import MALFORMED, with_check
from shipped import file_of

from framekit.link.services.client import ServiceClient, TransferResult
from framekit.link.services.server import MemoryServer
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

PROTOCOLS = ["mldp", "modbus-rtu", "modbus-ascii", "modbus-tcp"]


class Pair:
    """A client and a device of one protocol."""

    def __init__(self, name: str) -> None:
        text = file_of(f"{name}.yaml").read_text(encoding="utf-8")
        protocol, codec = compiled(text)
        self.memory = DeviceMemory(memory_of(protocol)[0])
        self.device = Side(text, "server", own=1, server=MemoryServer(protocol, codec, self.memory))
        self.asking = Side(text, "client")
        self.client = ServiceClient(protocol, codec, self.asking.engine)

    def do(self, method: str, *arguments: Any, time: int = 20 * SECOND, **options: Any) -> TransferResult:
        results: list[TransferResult] = []
        options = {"station": 1, **options, "now": self.asking.now, "on_done": results.append}
        self.asking.do(getattr(self.client, method)(*arguments, **options).commands)
        end = self.asking.now + time
        while not results and self.asking.now < end:
            self.pass_on()
            sides = (self.asking, self.device)
            at = min(end, *(side.next_time() for side in sides))
            for side in sides:
                side.run(at - side.now)
        self.pass_on()
        assert len(results) == 1
        return results[0]

    def pass_on(self) -> None:
        """Deliver the transmissions of each side to the other."""
        for side, peer in ((self.asking, self.device), (self.device, self.asking)):
            for data in side.taken():
                peer.do(peer.engine.receive(data, peer.now))


def word(name: str, place: int) -> str:
    return f"%DW{place}" if name == "mldp" else f"4{place + 1:05}"


def bit(name: str, place: int) -> str:
    return f"%MX{place}" if name == "mldp" else f"0{place + 1:05}"


@pytest.mark.parametrize("name", PROTOCOLS)
def test_words_and_bits_there_and_back(name: str) -> None:
    pair = Pair(name)
    values = [(place * 7919) & 0xFFFF for place in range(150)]
    assert pair.do("write", word(name, 5), values).written == 150
    result = pair.do("read", word(name, 5), count=150)
    assert result.values == values and result.exchanges == (3 if name == "mldp" else 2)
    bits = [1, 0, 0, 1, 1, 1, 0, 1, 1, 0, 1]
    assert pair.do("write", bit(name, 3), bits).ok
    assert pair.do("read", bit(name, 1), count=15).values == [0, 0, *bits, 0, 0]


@pytest.mark.parametrize("name", PROTOCOLS)
def test_lists_refusals_and_stations(name: str) -> None:
    pair = Pair(name)
    addresses = [word(name, place) for place in (9, 3, 1, 4)]
    assert pair.do("write_variables", addresses, [1, 2, 3, 4]).written == 4
    assert pair.do("read_variables", addresses).values == [1, 2, 3, 4]
    if name == "mldp":
        refused = pair.do("write", "F1", [1])
        assert (refused.outcome, refused.code, refused.meaning) == ("refused", 0x1132, "unknown area letter")
        assert refused.raw == b"\x1501wSB1132\x034C"


def test_a_device_that_is_not_there_fails_the_transfer_in_time() -> None:
    pair = Pair("mldp")
    result = pair.do("read", "M1", station=7)
    assert (result.ok, result.outcome, result.exchanges, result.values) == (False, "no_reply", 1, [])
    assert pair.do("read", "M1").ok


def test_everybody_is_written_and_nobody_answers() -> None:
    pair = Pair("modbus-rtu")
    result = pair.do("write", "40003", [7, 8], station=0)
    assert result.ok and result.written == 2
    assert pair.memory.read("holding", "word", 2, 2) == [7, 8]
    assert pair.do("read", "40003", station=0).outcome == "unfit_reply"


def test_a_changed_byte_count_is_never_stored() -> None:
    """The device answers with a good frame that has fewer bytes than requested."""
    pair = Pair("modbus-tcp")
    pair.memory.write("holding", "word", 0, [1, 2, 3])
    results: list[TransferResult] = []
    pair.asking.do(pair.client.read("40001", count=3, station=1, now=0, on_done=results.append).commands)
    pair.asking.run(MS)
    ((_, sent),) = pair.asking.sent
    pair.asking.gets(sent[:4] + b"\0\7" + sent[6:7] + bytes.fromhex("03 04 00 01 00 02"), whole=True)
    pair.asking.run(SECOND)
    assert [(result.ok, result.outcome, result.values) for result in results] == [(False, "unfit_reply", [])]


@given(st.sampled_from(PROTOCOLS), st.data())
@settings(max_examples=12, deadline=None)
def test_any_range_there_and_back(name: str, data: st.DataObject) -> None:
    pair = Pair(name)
    of_bits = data.draw(st.booleans())
    start = data.draw(st.integers(0, 5000))
    values = data.draw(st.lists(st.integers(0, 1 if of_bits else 0xFFFF), min_size=1, max_size=40 if of_bits else 140))
    address = (bit if of_bits else word)(name, start)
    assert pair.do("write", address, values).ok
    assert pair.do("read", address, count=len(values)).values == values


@pytest.mark.parametrize(("code", "text"), MALFORMED)
def test_malformed_requests_are_answered_on_the_line(code: int, text: str) -> None:
    raw = with_check(text)
    pair = Pair("mldp")
    pair.device.gets(raw, whole=True)
    pair.device.run(SECOND)
    expected = [with_check(f"{text[:5]}{code:04X}", "\x15", "\x03")] if len(raw) <= 256 else []
    assert pair.device.taken() == expected

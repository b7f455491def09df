"""Addresses of every processor family: the bytes of READ and WRITE, and their execution by a simulated processor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from link.link_world import SECOND
from link.test_df1_commands import NODE
from link.test_df1_commands import Pair as Commands
from spread import spread

from framekit.link.addresses import AddressError
from framekit.link.events import Command
from framekit.link.services.client import Done, TransferResult
from framekit.link.services.rows import ServiceError
from framekit.memory.memory import unit_bits


class Pair(Commands):
    """A pair with READ and WRITE; `sent` are the requests on the line, without header and frame."""

    def __init__(self, processor: str, **params: Any) -> None:
        super().__init__(processor, **params)
        self.sent: list[bytes] = []

    def _finish(self, results: list[TransferResult]) -> TransferResult:
        end = self.asking.now + 600 * SECOND
        sides = (self.asking, self.device)
        while not results and self.asking.now < end:
            for side, peer in (sides, sides[::-1]):
                for data in side.taken():
                    if side is self.asking and data.startswith(b"\x10\x02"):
                        self.sent.append(data[2:-4].replace(b"\x10\x10", b"\x10")[2:])
                    peer.do(peer.engine.receive(data, peer.now))
            at = min(end, *(side.next_time() for side in sides))
            for side in sides:
                side.run(at - side.now)
        return results[0]

    def read(self, address: str, count: int = 1, **params: Any) -> TransferResult:
        results: list[TransferResult] = []
        options = {"station": NODE, "params": params, "now": self.asking.now, "on_done": results.append}
        self.asking.do(self.client.read(address, count=count, **options).commands)
        return self._finish(results)

    def write(self, address: str, values: list[int], **params: Any) -> TransferResult:
        results: list[TransferResult] = []
        options = {"station": NODE, "params": params, "now": self.asking.now, "on_done": results.append}
        self.asking.do(self.client.write(address, values, **options).commands)
        return self._finish(results)

    def until_done(self, begin: Callable[[Done], list[Command]]) -> TransferResult:
        results: list[TransferResult] = []
        self.asking.do(begin(results.append))
        return self._finish(results)

    def commands(self) -> list[str]:
        """Return CMD and the bytes after the transaction number, for all transmissions since the last call."""
        found = [f"{data[0]:02X} {data[4:].hex(' ').upper()}".strip() for data in self.sent]
        self.sent.clear()
        return found


ASCII = {"addressing": "logical_ascii"}
WORDS = {"data_commands": "word_range"}

READS = [
    # SLC 500, MicroLogix: size, file, type, element, sub-element (3.7; D3, D6)
    ("slc", "N7:0", 10, {}, ["0F A2 14 07 89 00 00"]),
    ("slc", "N10:300", 1, {}, ["0F A2 02 0A 89 FF 2C 01 00"]),
    ("slc", "B3:1/5", 1, {}, ["0F A2 02 03 85 01 00"]),
    ("slc", "B3/21", 1, {}, ["0F A2 02 03 85 01 00"]),
    ("slc", "T4:2.ACC", 1, {}, ["0F A2 02 04 86 02 02"]),
    ("slc", "T4:2.DN", 1, {}, ["0F A2 02 04 86 02 00"]),
    ("slc", "C5:1/CU", 1, {}, ["0F A2 02 05 87 01 00"]),
    ("slc", "C5:1", 2, {}, ["0F A2 0C 05 87 01 00"]),
    ("slc", "R6:3.POS", 1, {}, ["0F A2 02 06 88 03 02"]),
    ("slc", "F8:1", 1, {}, ["0F A2 04 08 8A 01 00"]),
    ("slc", "ST9:0", 1, {}, ["0F A2 54 09 8D 00 00"]),
    ("slc", "A10:4", 1, {}, ["0F A2 02 0A 8E 04 00"]),
    ("micrologix", "L11:2", 1, {}, ["0F A2 04 0B 91 02 00"]),
    ("slc", "S:1/15", 1, {}, ["0F A2 02 02 84 01 00"]),
    ("slc", "I:3.1/12", 1, {}, ["0F A2 02 01 8C 03 01"]),
    ("slc", "O:2", 1, {}, ["0F A2 02 00 8B 02 00"]),
    ("slc", "N7:0", 150, {}, ["0F A2 EC 07 89 00 00", "0F A2 40 07 89 76 00"]),
    # PLC-5: typed reads, logical binary (B5, B7, B8; D7)
    ("plc5", "N7:30", 10, {}, ["0F 68 00 00 0A 00 07 00 07 1E 0A 00"]),
    ("plc5", "T4:2.ACC", 1, {}, ["0F 68 00 00 01 00 0F 00 04 02 02 01 00"]),
    ("plc5", "T4:2", 1, {}, ["0F 01 00 00 03 00 07 00 04 02 06"]),
    ("plc5", "I:017", 1, {}, ["0F 68 00 00 01 00 07 00 01 0F 01 00"]),
    ("plc5", "I:017/12", 1, {}, ["0F 01 00 00 01 00 07 00 01 0F 02"]),
    ("plc5", "B3:300", 1, {}, ["0F 68 00 00 01 00 07 00 03 FF 2C 01 01 00"]),
    ("plc5", "N7:0", 150, {}, ["0F 68 00 00 96 00 07 00 07 00 75 00", "0F 68 75 00 96 00 07 00 07 00 21 00"]),
    # the same by words (B17, D9), and as text (B12)
    ("plc5", "N7:30", 10, WORDS, ["0F 01 00 00 0A 00 07 00 07 1E 14"]),
    ("plc5", "F8:2", 1, WORDS, ["0F 01 00 00 02 00 07 00 08 02 04"]),
    ("plc5", "N10:360", 1, ASCII, ["0F 68 00 00 01 00 00 24 4E 31 30 3A 33 36 30 00 01 00"]),
    ("plc5", "T4:2.PRE", 1, ASCII, ["0F 68 00 00 01 00 00 24 54 34 3A 32 2E 50 52 45 00 01 00"]),
    ("plc5", "I:007", 1, ASCII | WORDS, ["0F 01 00 00 01 00 00 24 49 31 3A 30 30 37 00 02"]),
    # PLC-3: flags and levels, by words
    ("plc3", "E3.1.8.10.0.4", 2, {}, ["0F 01 00 00 02 00 2C 08 0A 04 04"]),
    ("plc3", "B10:0", 1, {}, ["0F 01 00 00 01 00 2C 08 0A 00 02"]),
    ("plc3", "N0:0", 1, ASCII, ["0F 01 00 00 01 00 00 24 4E 30 3A 30 00 02"]),
    # PLC-2: byte addresses (B31)
    ("plc2", "011", 1, {}, ["01 12 00 02"]),
    ("plc1774", "020", 2, {}, ["01 20 00 04"]),
    ("plc2", "020/17", 1, {}, ["01 20 00 02"]),
    # PLC-5/250: module and levels (B9)
    ("plc5_250", "1N5:300", 1, {}, ["0F 68 00 00 01 00 3F 1F 02 00 01 05 FF 2C 01 01 00"]),
    ("plc5_250", "N7:3", 1, {}, ["0F 68 00 00 01 00 3F 00 02 00 01 07 03 01 00"]),
    ("plc5_250", "1T4:2.ACC", 1, {}, ["0F 68 00 00 01 00 7F 1F 02 00 05 04 02 04 01 00"]),
    ("plc5_250", "C5:1.PRE", 1, {}, ["0F 68 00 00 01 00 7F 00 02 00 06 05 01 05 01 00"]),
]


@pytest.mark.parametrize(("processor", "address", "count", "params", "requests"), spread(READS, 3))
def test_a_read_sends_the_right_command(
    processor: str, address: str, count: int, params: dict[str, Any], requests: list[str]
) -> None:
    pair = Pair(processor, **params)
    result = pair.read(address, count)
    assert result.outcome in ("", "refused", "unfit_reply"), result  # the simulated file 5 holds counters
    assert pair.commands() == requests


BOTH_WAYS = [
    ("slc", {}, "N7:5", [1, 2, 3]),
    ("slc", {}, "B3:1/5", [1]),
    ("slc", {}, "B3/21", [1]),
    ("slc", {}, "T4:2.ACC", [99]),
    ("slc", {}, "F8:1", [0x447A0000]),
    ("slc", {}, "S:1/15", [1]),
    ("slc", {}, "C5:3.CU", [1]),
    ("slc", {}, "I:3.1", [7]),
    ("slc", {"bit_writes": "read_modify_write"}, "B3:1/5", [1]),
    ("slc", {"float_order": "high_word_first"}, "F8:1", [0x447A0000]),
    ("micrologix", {}, "L11:2", [70000]),
    ("plc5", {}, "N7:30", [5, 6]),
    ("plc5", {}, "T4:2.ACC", [12]),
    ("plc5", {}, "F8:3", [0x447A0000]),
    ("plc5", {}, "I:017/12", [1]),
    ("plc5", {}, "T4:1/DN", [1]),
    ("plc5", {}, "PD13:1.SP", [0x447A0000]),
    ("plc5", {}, "BT14:2.DLEN", [3]),
    ("plc5", WORDS, "N7:30", [5, 6]),
    ("plc5", WORDS, "F8:3", [0x447A0000, 0xC0400000]),
    ("plc5", WORDS, "T4:2.PRE", [8]),
    ("plc5", {"bit_writes": "read_modify_write"}, "N7:3/4", [1]),
    ("plc5", ASCII, "N10:30", [5, 6]),
    ("plc5", ASCII | WORDS, "F8:1", [3]),
    ("plc5", ASCII | WORDS, "N7:0", [9] * 200),
    ("plc3", {}, "E3.1.8.10.0.4", [7, 8]),
    ("plc3", {}, "E3.1.8.10.0.4/12", [1]),
    ("plc3", {}, "B10:3", [1]),
    ("plc3", {"bit_writes": "read_modify_write"}, "E3.1.8.10.0.4/12", [1]),
    ("plc3", ASCII, "N7:0", [4]),
    ("plc2", {}, "020", [0x1234, 5]),
    ("plc2", {}, "020/17", [1]),
    ("plc2", {"bit_writes": "read_modify_write"}, "020/17", [1]),
    ("plc5_250", {}, "1N7:30", [4]),
    ("plc5_250", {}, "N7:30", [4, 5]),
    ("plc5_250", {}, "F8:30", [0x447A0000]),
    ("plc5_250", {}, "1T4:2.ACC", [12]),
    ("plc5_250", {}, "C5:1.PRE", [13]),
]


@pytest.mark.parametrize(("processor", "params", "address", "values"), spread(BOTH_WAYS, 3))
def test_what_is_written_is_read(processor: str, params: dict[str, Any], address: str, values: list[int]) -> None:
    pair = Pair(processor, **params)
    result = pair.write(address, values)
    assert result.ok, result
    result = pair.read(address, len(values))
    assert result.ok, result
    assert result.values == values


@pytest.mark.parametrize(
    ("processor", "address", "params", "requests"),
    [
        ("slc", "N7:30/3", {}, ["0F AB 02 07 89 1E 00 08 00 08 00"]),  # C12
        ("slc", "N7:30/3", {"bit_writes": "read_modify_write"}, ["0F A2 02 07 89 1E 00", "0F AA 02 07 89 1E 00 08 00"]),
        ("plc5", "N7:0/15", {}, ["0F 26 07 00 07 00 FF 7F 00 80"]),
        ("plc5", "N7:0/15", {"bit_writes": "read_modify_write"},
         ["0F 01 00 00 01 00 07 00 07 00 02", "0F 00 00 00 01 00 07 00 07 00 00 80"]),
        ("plc3", "E3.1.8.10.0.4/12", {}, ["0F 02 2C 08 0A 04 00 04 00 00"]),
        ("plc2", "020/17", {}, ["05 21 00 80 00"]),
    ],
)  # fmt: skip
def test_one_bit_is_written_with_masks_or_by_its_word(
    processor: str, address: str, params: dict[str, Any], requests: list[str]
) -> None:
    pair = Pair(processor, **params)
    assert pair.write(address, [1]).ok
    assert pair.commands() == requests


def test_a_bit_leaves_the_others_of_its_word_alone() -> None:
    for how in ("masked", "read_modify_write"):
        for processor, address, memory in (("slc", "N7:2/3", "file7"), ("plc5", "N7:2/3", "file7")):
            pair = Pair(processor, bit_writes=how)
            pair.memory.write(memory, "word", 2, [0xA5A0])
            assert pair.write(address, [1]).ok
            assert pair.memory.read(memory, "word", 2, 1) == [0xA5A8]
            assert pair.write("N7:2/5", [0]).ok
            assert pair.memory.read(memory, "word", 2, 1) == [0xA588]


def test_members_of_a_plc5_250_are_words_of_their_element() -> None:
    """Levels 3 and 4 of a timer, 5 and 6 of a counter (4.4)."""
    pair = Pair("plc5_250")
    for address, value in (("T4:2.PRE", 1), ("T4:2.ACC", 2), ("C5:2.PRE", 3), ("C5:2.ACC", 4)):
        assert pair.write(address, [value]).ok
    assert pair.memory.read("file4", "word", 6, 6) == [0, 1, 2, 0, 0, 0]
    assert pair.memory.read("file5", "word", 6, 6) == [0, 3, 4, 0, 0, 0]


def test_named_commands_of_a_plc5_250_have_its_levels() -> None:
    """Level 1 is 2, data; level 3 the section (4.4)."""
    pair = Pair("plc5_250")
    pair.done("word_range_write", file=7, element=3, data=b"\x34\x12\x78\x56")
    assert pair.gives("word_range_read", file=7, element=4, words=1) == b"\x78\x56"
    pair.done("typed_write", file=7, element=3, data=b"\x01\x00")
    assert pair.gives("typed_read", file=7, element=3, count=1)["values"] == b"\x01\x00"
    assert pair.gives("section_size", file=7)["size"] == 1000
    place = "3F 00 02 00 01 07"
    assert pair.commands() == [
        f"0F 00 00 00 02 00 {place} 03 34 12 78 56", f"0F 01 00 00 01 00 {place} 04 02",
        f"0F 67 00 00 01 00 {place} 03 42 01 00", f"0F 68 00 00 01 00 {place} 03 01 00", f"0F 29 {place} 00",
    ]  # fmt: skip
    pair = Pair("plc3")
    pair.gives("section_size", file=10)
    assert pair.commands() == ["0F 29 2C 08 0A 00"]


def test_floats_have_the_high_word_first_by_word_range_commands() -> None:
    pair = Pair("plc5", **WORDS)
    assert pair.write("F8:1", [0x447A0000]).ok
    assert pair.commands() == ["0F 00 00 00 02 00 07 00 08 01 7A 44 00 00"]
    assert pair.memory.read("file8", "dword", 1, 1) == [0x447A0000]
    typed = Pair("plc5")
    assert typed.write("F8:1", [0x447A0000]).ok
    assert typed.commands() == ["0F 67 00 00 01 00 07 00 08 01 94 08 00 00 7A 44"]
    swapped = Pair("slc", float_order="high_word_first")
    assert swapped.write("F8:1", [0x447A0000]).ok
    assert swapped.commands() == ["0F AA 04 08 8A 01 00 7A 44 00 00"]


WHOLE = {"F8": 32, "L11": 32, "N7": 16, "T4": 48, "R6": 48}
"""Widths of elements."""


@pytest.mark.parametrize(
    ("processor", "file", "unit", "count"),
    [
        ("slc", "F8", "bit", 32), ("slc", "F8", "bit", 3), ("slc", "L11", "bit", 20), ("slc", "F8", "word", 2),
        ("slc", "T4", "bit", 48), ("slc", "T4", "word", 5), ("slc", "N7", "dword", 1), ("slc", "N7", "byte", 3),
        ("plc5", "T4", "word", 5), ("plc5", "R6", "word", 3), ("plc5", "T4", "bit", 48), ("plc5", "N7", "dword", 1),
    ],
)  # fmt: skip
def test_parts_of_elements_are_those_of_the_elements(processor: str, file: str, unit: str, count: int) -> None:
    width, bits = WHOLE[file], unit_bits(unit)
    content = int.from_bytes(bytes(range(1, 1 + 3 * width // 8)), "little")
    elements = [content >> width * number & (1 << width) - 1 for number in range(3)]
    pair = Pair(processor)
    assert pair.write(f"{file}:0", elements).ok
    results: list[TransferResult] = []
    options: dict[str, Any] = {"station": NODE, "now": pair.asking.now, "on_done": results.append}
    pair.asking.do(pair.client.read(f"{file}:1", unit=unit, count=count, **options).commands)
    parts = [content >> width + bits * number & (1 << bits) - 1 for number in range(count)]
    assert pair._finish(results).values == parts


@pytest.mark.parametrize("address", ["F8:1/3", "L11:1/0", "ST9:1/5"])
def test_bits_that_no_command_writes_are_refused(address: str) -> None:
    with pytest.raises(ServiceError, match="no request can write"):
        Pair("slc").write(address, [1])


def test_places_know_what_they_hold() -> None:
    grammar = Pair("plc5").client.grammar
    types = {text: grammar.parse(text).type for text in ("F8:1", "F8:1/3", "N7:0", "N7:0/3", "PD13:1.SP", "PD13:1")}
    assert types == {
        "F8:1": "float32", "F8:1/3": None, "N7:0": "int16", "N7:0/3": None, "PD13:1.SP": "float32", "PD13:1": None,
    }  # fmt: skip
    assert Pair("slc").client.grammar.parse("L11:1").type == "int32"
    assert grammar.parse("F8:1", "word").type is None


@pytest.mark.parametrize(
    ("processor", "says"),
    [
        ("slc", "write it like O:2.1, I:10, B3/1, S2:2/1; areas: O, I, S, B, "),
        ("plc5", "write it like O:012, I:10, B3/1, S2:2/1; areas: O, I, S, B, "),
        ("plc3", "write it like @symbol, B:10, E1.1.1.1.1.1; areas: B, E, SYM"),
        ("plc2", "write it like 001; areas: PLC2"),
    ],
)
def test_what_is_no_address_is_answered_with_those_of_the_family(processor: str, says: str) -> None:
    with pytest.raises(AddressError) as error:
        Pair(processor).read("X7")
    assert f"'X7' is not an address – {says}" in str(error.value)


@pytest.mark.parametrize(
    ("processor", "address"),
    [
        ("slc", "I:017"),
        ("slc", "1N5:3"),
        ("plc5", "020"),
        ("slc", "E3.1.8.10.0.4"),
        ("plc2", "N7:0"),
        ("plc5", "I:3.1"),
    ],
)
def test_an_address_of_another_family_is_refused(processor: str, address: str) -> None:
    with pytest.raises(ServiceError, match="no request can read"):
        Pair(processor).read(address)


@pytest.mark.parametrize("address", ["B3:1/16", "N7:0/99", "T4:2.ACC/16", "I:3/17"])
def test_a_word_has_no_bit_16(address: str) -> None:
    with pytest.raises(ValueError, match="is not an address"):
        Pair("slc").read(address)


def test_symbols_of_a_plc3() -> None:
    pair = Pair("plc3")
    pair.read("@MOTOR", 3)
    assert pair.commands() == ["0F 01 00 00 03 00 00 4D 4F 54 4F 52 00 06"]


def test_blocks_of_words_of_a_plc3_file() -> None:
    pair = Pair("plc3")
    pair.done("file_write_words", file=7, offset=2, data=b"\x01\x02\x03\x04")
    assert pair.gives("file_read_words", file=7, offset=3, words=1) == b"\x03\x04"
    pair.done("bit_write", file=7, word=2, set=0x8000, reset=0x0001)
    assert pair.memory.read("file7", "word", 2, 1) == [0x8200]


def with_symbols() -> Pair:
    pair = Pair("plc3")
    pair.state.set("symbols", [{"name": "MOTOR", "file": 7, "word": 4}, {"name": "LINE_12", "file": 9, "word": 0}])
    pair.memory.write("file7", "word", 4, [77, 78])
    return pair


def test_a_simulated_plc3_knows_symbols() -> None:
    pair = with_symbols()
    result = pair.read("@MOTOR", 2)
    assert result.ok and result.values == [77, 78]
    assert pair.write("@LINE_12", [5, 6, 7]).ok
    assert pair.memory.read("file9", "word", 0, 3) == [5, 6, 7]


def test_a_symbol_that_a_simulated_plc3_does_not_know() -> None:
    pair = with_symbols()
    assert pair.read("@PUMP").code == 0xF004
    assert pair.write("@PUMP", [1]).code == 0xF004
    assert pair.memory.read("file7", "word", 4, 2) == [77, 78]

"""Addresses: every notation of the specifications, its meaning, refused texts, and formatting a place as text."""

from __future__ import annotations

from contextlib import suppress
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link.service_loop import FRAMES, Loop

from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.link.addresses import MOST_KNOWN, Address, AddressError, AddressGrammar, FormMatcher
from framekit.memory.profile import load_profile

FILES = """
protocol: files
tables:
  timer_members: {CTL: 0, PRE: 1, ACC: 2}
  no_members: {}
areas:
  N:  {code: 0x89, unit: word, file: 7, element: 2, members: no_members}
  B:  {code: 0x85, unit: word, file: 3, element: 2, members: no_members}
  T:  {code: 0x86, unit: 6 bytes, file: 4, element: 6, members: timer_members}
  ST: {code: 0x8D, unit: 84 bytes, size: 10, file: 9, element: 84, members: no_members}
  S:  {code: 0x84, unit: word, file: 2, element: 2, members: no_members}
  OCT: {unit: word, file: 0, element: 2, members: no_members}
addresses:
  - {form: "{area}[{file:dec}]:{element:dec}.{member}/{bit:dec:1-2}", unit: bit,
     file: "either(file, area.file)", sub: "area.members[member]", start: element * area.element * 8 + sub * 16 + bit}
  - {form: "{area}[{file:dec}]:{element:dec}.{member}", unit: word,
     file: "either(file, area.file)", sub: "area.members[member]", start: element * area.element // 2 + sub}
  - {form: "{area}[{file:dec}]:{element:dec}/{bit:dec:1-2}", unit: bit,
     file: "either(file, area.file)", sub: 0, start: element * area.element * 8 + bit}
  - {form: "B[{file:dec}]/{number:dec}", area: B, unit: bit, file: "either(file, 3)", start: number}
  - {form: "{area}[{file:dec}]:{element:dec}",
     file: "either(file, area.file)", sub: 0, start: element}
  - {form: "{word:oct:3-6}", area: OCT, start: word}
frames:
  any: {body: [{field: x, type: u8}]}
"""

REGISTERS = """
protocol: registers
areas:
  R:  {code: {word: 1}, first: 1, size: 2048}
  AI: {code: {word: 2}, first: 1, size: 64}
  I:  {code: {bit: 2, byte: 3}, first: 1, size: 512}
  RAW: {code: {byte: 6}, first: 0, size: 256}
addresses:
  - {form: "%{area}{number:dec}", start: number - area.first}
  - {form: "{area}{number:dec}", start: number - area.first}
frames:
  any: {body: [{field: x, type: u8}]}
"""

BASES = """
protocol: bases
areas:
  D: {unit: word, size: 1000, base: dec}
  W: {unit: word, size: 1000, base: hex}
  X: {unit: bit, size: 512, base: hex}
  DX: {unit: bit, size: 512, base: oct}
  NO: {unit: bit, size: 512}
addresses:
  - {form: "{area}{word:base:1-4}.{bit:hex:1}", unit: bit, start: word * 16 + bit}
  - {form: "{area}{start:base:1-4}", case: any}
frames:
  any: {body: [{field: x, type: u8}]}
"""

TEXTS = {"files": FILES, "registers": REGISTERS, "bases": BASES}


@cache
def grammar(name: str) -> AddressGrammar:
    if name == "masterlogic":
        profile = load_profile("masterlogic")
        return AddressGrammar(profile.addresses, profile.areas, profile.tables)
    protocol = load_protocol_text(TEXTS[name], name) if name in TEXTS else load_protocol(name, FRAMES)
    return AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)


def place(name: str, text: str, unit: str | None = None) -> tuple[str, str, int]:
    address = grammar(name).parse(text, unit)
    return address.area, address.unit, address.start


@pytest.mark.parametrize(
    ("text", "area", "unit", "start"),
    [
        ("%MW100", "M", "word", 100),
        ("%MW020", "M", "word", 20),
        ("%PW001", "P", "word", 1),
        ("%DW000", "D", "word", 0),
        ("%MX17", "M", "bit", 17),
        ("%MB7", "M", "byte", 7),
        ("%MD50", "M", "dword", 50),
        ("%ML3", "M", "lword", 3),
        ("%WW7", "ZR", "word", 7),
        ("%RW7", "R", "word", 7),
        ("%SW127", "S", "word", 127),
        ("%mw100", "M", "word", 100),
        ("%wX7", "ZR", "bit", 7),
        ("m100", "M", "word", 100),
        ("M100", "M", "word", 100),
        ("M0100", "M", "word", 100),
        ("M00000", "M", "bit", 0),
        ("M00002", "M", "bit", 2),
        ("P00100", "P", "bit", 160),
        ("P0000A", "P", "bit", 10),
        ("P0000a", "P", "bit", 10),
        ("L00625", "L", "word", 625),
        ("L006251", "L", "bit", 10001),
        ("ZR5", "ZR", "word", 5),
        ("ZR000051", "ZR", "bit", 81),
        ("R5", "R", "word", 5),
        ("  M100 ", "M", "word", 100),
    ],
)
def test_names_of_the_ascii_protocol(text: str, area: str, unit: str, start: int) -> None:
    assert place("mldp", text) == (area, unit, start)


def test_a_place_in_small_letters_is_printed_as_its_form_has_it() -> None:
    known = grammar("mldp")
    assert known.print(known.parse("%mw100")) == "%MW100"


@pytest.mark.parametrize("text", ["%\u017fw1", "m\u0661"])
def test_only_the_letters_a_to_z_have_a_case(text: str) -> None:
    with pytest.raises(AddressError):
        grammar("mldp").parse(text)


@pytest.mark.parametrize(
    ("text", "area", "unit", "start"),
    [
        ("MW10.2", "M", "bit", 162),
        ("%TW01.0", "T", "bit", 16),
        ("D00010.A", "D", "bit", 170),
        ("M10.2", "M", "bit", 162),
        ("F00093", "F", "bit", 147),
        ("F0009A", "F", "bit", 154),
        ("MX1000", "M", "bit", 1000),
        ("PW200", "P", "word", 200),
        ("%MW250", "M", "word", 250),
        ("WW7", "ZR", "word", 7),
        ("ZR7", "ZR", "word", 7),
        ("W7", "ZR", "word", 7),
    ],
)
def test_places_of_the_own_memory(text: str, area: str, unit: str, start: int) -> None:
    assert place("masterlogic", text) == (area, unit, start)


@pytest.mark.parametrize(
    ("text", "area", "unit", "start"),
    [
        ("00001", "coil", "bit", 0),
        ("065536", "coil", "bit", 65535),
        ("10001", "input", "bit", 0),
        ("30010", "input_register", "word", 9),
        ("40010", "holding", "word", 9),
        ("49999", "holding", "word", 9998),
        ("400010", "holding", "word", 9),
        ("holding:9", "holding", "word", 9),
        ("holding:0x1F", "holding", "word", 31),
        ("input_register:0", "input_register", "word", 0),
    ],
)
def test_modicon_numbers(text: str, area: str, unit: str, start: int) -> None:
    assert place("modbus-rtu", text) == (area, unit, start)


@pytest.mark.parametrize(
    ("text", "area", "unit", "start", "parts"),
    [
        ("N7:0", "N", "word", 0, {"file": 7, "element": 0, "sub": 0}),
        ("N12:5", "N", "word", 5, {"file": 12, "element": 5, "sub": 0}),
        ("N:5", "N", "word", 5, {"file": 7, "element": 5, "sub": 0}),
        ("N7:1/3", "N", "bit", 19, {"file": 7, "element": 1, "sub": 0, "bit": 3}),
        ("T4:2", "T", "6 bytes", 2, {"file": 4, "element": 2, "sub": 0}),
        ("T4:2.ACC", "T", "word", 8, {"file": 4, "element": 2, "sub": 2, "member": "ACC"}),
        ("T4:2.CTL/13", "T", "bit", 109, {"file": 4, "element": 2, "sub": 0, "member": "CTL", "bit": 13}),
        ("B3/17", "B", "bit", 17, {"file": 3, "number": 17}),
        ("B/17", "B", "bit", 17, {"file": 3, "number": 17}),
        ("ST9:1", "ST", "84 bytes", 1, {"file": 9, "element": 1, "sub": 0}),
        ("S:1", "S", "word", 1, {"file": 2, "element": 1, "sub": 0}),
        ("017", "OCT", "word", 15, {"word": 15}),
    ],
)
def test_files_elements_and_members(text: str, area: str, unit: str, start: int, parts: dict[str, object]) -> None:
    address = grammar("files").parse(text)
    assert (address.area, address.unit, address.start) == (area, unit, start)
    assert {name: address.parts[name] for name in parts} == parts


@pytest.mark.parametrize(
    ("text", "unit", "found"),
    [
        ("%R3", None, ("R", "word", 2)),
        ("R3", None, ("R", "word", 2)),
        ("%AI1", None, ("AI", "word", 0)),
        ("%I9", None, ("I", "bit", 8)),
        ("%I9", "byte", ("I", "byte", 1)),
        ("%R3", "dword", ("R", "dword", 1)),
        ("RAW0", None, ("RAW", "byte", 0)),
    ],
)
def test_numbers_that_begin_where_the_area_says(text: str, unit: str | None, found: tuple[str, str, int]) -> None:
    assert place("registers", text, unit) == found


@pytest.mark.parametrize(
    ("text", "area", "unit", "start"),
    [
        ("D100", "D", "word", 100), ("W1A", "W", "word", 0x1A), ("x1f", "X", "bit", 0x1F), ("DX17", "DX", "bit", 0o17),
        ("D10.F", "D", "bit", 175), ("W10.F", "W", "bit", 271),
    ],
)  # fmt: skip
def test_one_form_for_areas_that_count_in_other_bases(text: str, area: str, unit: str, start: int) -> None:
    assert place("bases", text) == (area, unit, start)
    if "." not in text:
        assert grammar("bases").print(Address(area, unit, start)) == text.upper()


@pytest.mark.parametrize("text", ["D1A", "DX8", "NO1", "X2G"])
def test_digits_of_another_base_are_no_number(text: str) -> None:
    with pytest.raises(AddressError, match="is not an address"):
        place("bases", text)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("mldp", "%XW1", "'%XW1' is not an address – write it like P10, %MW10, K00011, T10; areas: P"),
        ("mldp", "%ZR5", "areas: P, M, K"),
        ("mldp", "MX", "did you mean 'M'"),
        ("mldp", "", "is not an address"),
        ("mldp", "M2048", "M2048 is not in area M, which has word 0 to 2047"),
        ("mldp", "%MX32768", "%MX32768 is not in area M, which has bit 0 to 32767"),
        ("modbus-rtu", "00000", "00000 is not in area coil, which has 00001 to "),
        ("srtp", "%R0", "%R0 is not in area R, which has %R1 to %R32640"),
        ("modbus-rtu", "50001", "is not an address"),
        ("files", "T4:2.FOO", "is not an address"),
        ("files", "ST9:10", "which has 84 bytes 0 to 9"),
        ("files", "018", "is not an address"),
    ],
)
def test_what_is_no_address_is_refused_in_words(name: str, text: str, says: str) -> None:
    with pytest.raises(AddressError) as error:
        grammar(name).parse(text)
    assert says in str(error.value)


def test_a_place_that_is_not_at_a_multiple_of_the_unit_is_refused() -> None:
    with pytest.raises(AddressError, match="not at the start of a dword"):
        grammar("mldp").parse("M101", "dword")
    with pytest.raises(AddressError, match="is not a unit"):
        grammar("mldp").parse("M101", "page")


def test_unchecked_places_may_be_beyond_the_area() -> None:
    address = grammar("mldp").parse("%MW5000", check=False)
    assert address.start == 5000
    assert grammar("modbus-rtu").parse("00000", check=False).start == -1


def test_a_range_that_ends_beyond_the_area_is_refused() -> None:
    rules = grammar("mldp")
    rules.check(rules.parse("M2040"), 8)
    with pytest.raises(AddressError, match="9 × word from M2040"):
        rules.check(rules.parse("M2040"), 9)


@pytest.mark.parametrize(
    ("name", "text", "elements", "found"),
    [
        ("mldp", "M100", 60, "%MW160"),
        ("mldp", "M0000F", 1, "%MX16"),
        ("mldp", "ZR7", 1, "%WW8"),
        ("modbus-rtu", "40010", 125, "40135"),
        ("modbus-rtu", "holding:9", 0, "40010"),
        ("registers", "R3", 2, "%R5"),
        ("masterlogic", "M100", 1, "%MW101"),
    ],
)
def test_the_text_of_places_further_on(name: str, text: str, elements: int, found: str) -> None:
    rules = grammar(name)
    moved = rules.advance(rules.parse(text), elements)
    assert moved.text == rules.print(moved) == found
    assert rules.parse(found).start == rules.parse(text).start + elements


def test_a_place_that_no_form_shows_says_so() -> None:
    with pytest.raises(AddressError, match="cannot be written"):
        grammar("mldp").print(Address("T", "6 bytes", 1))
    assert not grammar("mldp").can_print("T", "6 bytes")
    assert grammar("mldp").can_print("ZR", "lword")


@given(
    st.sampled_from(["P", "M", "L", "R", "ZR"]), st.sampled_from(["bit", "byte", "word", "dword", "lword"]), st.data()
)
def test_printed_addresses_mean_the_same_place(area: str, unit: str, data: st.DataObject) -> None:
    rules = grammar("mldp")
    size = rules.areas[area].size * 16 // Address(area, unit, 0).unit_bits
    start = data.draw(st.integers(0, size - 1))
    text = rules.print(Address(area, unit, start))
    found = rules.parse(text)
    assert (found.area, found.unit, found.start) == (area, unit, start)


@given(st.text(alphabet="%PMZRDXWB:./0123456789AF", max_size=9))
def test_any_text_is_a_place_or_an_address_error(text: str) -> None:
    for name in ("mldp", "masterlogic", "files"):
        try:
            address = grammar(name).parse(text)
        except AddressError:
            continue
        grammar(name).check(address)


def test_a_column_of_width_0_leaves_an_area_out_of_a_form() -> None:
    areas = "areas: {D: {unit: word, size: 300, dec: 6, hex: 0}, W: {unit: word, size: 300, dec: 0, hex: 5}}\n"
    forms = 'addresses: [{form: "{area}{start:dec:1-dec}"}, {form: "{area}{start:hex:1-hex}"}]\n'
    protocol = load_protocol_text(f"protocol: columns\n{areas}{forms}frames: {{any: {{body: [{{const: 01}}]}}}}\n")
    grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
    assert [grammar.parse(text).start for text in ("D10", "W10", "WFF")] == [10, 16, 255]
    assert [grammar.print(Address(area, "word", 26)) for area in "DW"] == ["D26", "W1A"]
    with pytest.raises(AddressError):
        grammar.parse("DFF")


def test_a_text_is_taken_apart_once_and_no_more_are_kept_than_there_is_room_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    protocol = load_protocol_text(REGISTERS, "registers", FRAMES)
    grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
    read: list[str] = []
    real = FormMatcher.match
    monkeypatch.setattr(FormMatcher, "match", lambda form, text: read.append(text) or real(form, text))
    assert [grammar.parse("%R10").start for _ in range(3)] == [9, 9, 9]
    assert read == ["%R10"]
    for number in range(3 * MOST_KNOWN):
        with suppress(AddressError):
            grammar.parse(f"%R{number}x", check=False)
        assert len(grammar._read_before) <= MOST_KNOWN
    assert grammar.parse("%R10").start == 9


ONE_PLACE = """
protocol: one
station: {type: none}
groups: {request: {from: client, head: [{const: STX}]}}
frames:
  GET: {group: request, body: [{text: G}]}
  SET: {group: request, body: [{text: S}, {data: d, size: 2}]}
  TOLD: {from: server, body: [{const: SOH}, {data: d, size: 2}]}
  OK: {from: server, body: [{const: ACK}]}
areas: {SP: {unit: word, size: 9}}
addresses: [{form: "SP", area: SP, start: 4}]
services:
  read: [{areas: [SP], limit: {count: 1}, request: {GET: {}}, reply: {TOLD: {d: data}}}]
  write: [{areas: [SP], limit: {count: 1}, request: {SET: {d: data}}, reply: {OK: {}}}]
"""


def test_a_server_knows_the_only_place_that_an_area_has() -> None:
    loop = Loop(ONE_PLACE)
    assert loop.do("write", "SP", [7]).ok and loop.memory.read("SP", "word", 4, 1) == [7]
    assert loop.do("read", "SP").values == [7]

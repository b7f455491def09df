"""The shipped profile compared with the Snet notes: sizes, notations, system bits, words of blocks.

The test reads addresses by regular expressions made from all forms at once, so a text with two meanings is detected.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from framekit.definition.model.services import AddressForm, FormPart, Literally, Maybe
from framekit.memory.clock_bits import SystemBits
from framekit.memory.memory import AccessError
from framekit.memory.profile import MemoryProfile, ProfileArea, load_profile

DIGITS = {10: "[0-9]", 16: "[0-9A-F]"}
SECOND = 1_000_000_000


@cache
def profile() -> MemoryProfile:
    return load_profile("masterlogic")


def pattern(parts: Iterable[Literally | FormPart | Maybe], area: ProfileArea) -> str:
    return "".join(_piece(part, area) for part in parts)


def _piece(part: Literally | FormPart | Maybe, area: ProfileArea) -> str:
    if isinstance(part, Literally):
        return re.escape(part.text)
    if isinstance(part, Maybe):
        return f"(?:{pattern(part.parts, area)})?"
    if part.what == "number":
        least, most = (area.columns[end] if isinstance(end, str) else end for end in (part.least, part.most))
        width = "+" if most is None else f"{{{least},{most}}}"
        return f"(?P<{part.name}>{DIGITS[part.base]}{width})"
    if part.what == "unit":
        return f"(?P<unit>[{''.join(map(str, profile().tables['unit_names'].entries))}])"
    return re.escape(area.name if part.what == "area" else str(area.columns.get(part.name, area.name)))


@cache
def patterns() -> list[tuple[re.Pattern[str], AddressForm, ProfileArea]]:
    return [
        (re.compile(pattern(form.parts, area)), form, area)
        for form in profile().addresses
        for area in profile().areas.values()
    ]


def meanings(text: str) -> set[tuple[str, str, int]]:
    """Return area, unit and start for every form that fits the text."""
    found = set()
    for compiled, form, area in patterns():
        match = compiled.fullmatch(text)
        if match is None:
            continue
        groups = match.groupdict()
        unit = str(profile().tables["unit_names"].entries[groups["unit"]]) if form.units_table else form.unit
        numbers = {name: int(groups[name], 16 if name == "bit" else 10) for name in groups if name != "unit"}
        start = form.results["start"].text if "start" in form.results else "start"
        found.add((area.name, unit or area.unit, eval(start, {}, numbers)))
    return found


@pytest.mark.parametrize(
    ("text", "area", "unit", "start"),
    [
        ("%MW100", "M", "word", 100),
        ("%MX17", "M", "bit", 17),
        ("%PB3", "P", "byte", 3),
        ("%DD2", "D", "dword", 2),
        ("%RL1", "R", "lword", 1),
        ("%WW7", "ZR", "word", 7),
        ("%DW000", "D", "word", 0),
        ("MW100", "M", "word", 100),
        ("MX1000", "M", "bit", 1000),
        ("PW4", "P", "word", 4),
        ("WW65535", "ZR", "word", 65535),
        ("M0", "M", "word", 0),
        ("M100", "M", "word", 100),
        ("M0100", "M", "word", 100),
        ("P0100", "P", "word", 100),
        ("L00625", "L", "word", 625),
        ("ZR5", "ZR", "word", 5),
        ("M00000", "M", "bit", 0),
        ("M00002", "M", "bit", 2),
        ("M00100", "M", "bit", 160),
        ("P00100", "P", "bit", 160),
        ("P0000A", "P", "bit", 10),
        ("C0000F", "C", "bit", 15),
        ("F00093", "F", "bit", 9 * 16 + 3),
        ("F0009D", "F", "bit", 9 * 16 + 13),
        ("L006250", "L", "bit", 10000),
        ("ZR00001F", "ZR", "bit", 31),
        ("MW10.2", "M", "bit", 162),
        ("%MW10.2", "M", "bit", 162),
        ("TW01.0", "T", "bit", 16),
        ("PW4.1", "P", "bit", 65),
        ("%WW1.F", "ZR", "bit", 31),
        ("M10.A", "M", "bit", 170),
        ("D00010.0", "D", "bit", 160),
    ],
)
def test_notations_of_the_notes(text: str, area: str, unit: str, start: int) -> None:
    assert meanings(text) == {(area, unit, start)}


@pytest.mark.parametrize(
    "text", ["M000000", "M0000G", "%M100", "X100", "%ZW1", "MW10.10", "MW10.G", "M", "%MW", "C00A", "mw1"]
)
def test_what_is_no_address(text: str) -> None:
    assert meanings(text) == set()


@given(
    st.sampled_from(["P", "M", "K", "T", "C", "F", "L", "N", "D", "R", "ZR", "W", "Z"]),
    st.sampled_from(["", "X", "B", "W", "D", "L"]),
    st.integers(0, 7).flatmap(lambda n: st.text("0123456789", min_size=n, max_size=n)),
    st.sampled_from(["", "A", "F", ".0", ".A", ".10"]),
    st.booleans(),
)
def test_no_text_has_two_meanings(area: str, unit: str, digits: str, end: str, percent: bool) -> None:
    found = meanings(f"{'%' if percent else ''}{area}{unit}{digits}{end}")
    assert len(found) <= 1


def test_only_one_form_is_printed() -> None:
    assert [form.text for form in profile().addresses if form.wire] == ["%{area.wire}{unit}{start:dec}"]


def test_areas_of_the_notes() -> None:
    sizes = {area.name: area.size for area in profile().areas.values()}
    assert sizes == dict.fromkeys("PMKTCF", 2048) | {
        "L": 11264, "N": 21504, "D": 32768, "R": 32768, "ZR": 65536, "S": 128,
    }  # fmt: skip
    assert [area.name for area in profile().areas.values() if area.access == "read"] == ["F"]
    assert all(len(str(area.size - 1)) <= int(str(area.columns["digits"])) for area in profile().areas.values())
    memory = profile().create()
    assert memory.area("W") is memory.area("ZR")
    with pytest.raises(AccessError):
        memory.write("F", "word", 9, [1])


def test_words_of_blocks_of_the_notes() -> None:
    status, settings = profile().flags["status"], profile().flags["settings"]
    assert (status.area, status.base(1, 0), status.base(1, 1)) == ("L", 625, 631)
    assert status.base(3, 7) == 625 + 6 * (64 * 2 + 7)
    assert (settings.area, settings.base(1, 0), settings.base(8, 63)) == ("N", 0, 41 * 511)
    for words in (status, settings):
        taken = [(item.word + at, item.bit) for item in words.items.values() for at in range(item.words)]
        assert len(taken) == len(set(taken))
        assert {word for word, _ in taken} == set(range(words.words))


def test_system_bits_of_the_notes() -> None:
    def locate(text: str) -> tuple[str, int]:
        ((area, unit, start),) = meanings(text)
        return area, start if unit == "bit" else 16 * start

    memory = profile().create()
    bits = SystemBits(memory, profile(), locate)
    bits.start(0)
    assert memory.read("F", "word", 9) == [0x0A00]  # always on, first scan
    bits.update(SECOND)
    assert memory.read("F", "word", 9) == [0x120F]  # the clocks up to 1 s rise together
    bits.update(60 * SECOND)
    assert memory.read("F", "word", 9) == [0x12FF]

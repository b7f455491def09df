from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from framekit.memory.memory import Area, DeviceMemory, MemoryRangeError, UnknownAreaError

WORDS = 16


def small_memory() -> DeviceMemory:
    return DeviceMemory(
        [
            Area("M", size=WORDS, aliases=["relays"]),
            Area("Q", size=13, unit="bit"),
            Area("F", size=4, access="read"),
        ]
    )


def test_areas_are_found_by_name_and_alias() -> None:
    memory = small_memory()
    memory.write("relays", "word", 2, [7])
    assert memory.read("M", "word", 2) == [7]
    assert memory.area("relays") is memory.areas["M"]
    assert "relays" in memory and "X" not in memory
    assert [area.name for area in memory] == ["M", "Q", "F"]
    memory.write_bytes("M", 0, b"\x34\x12")
    assert memory.read_bytes("M", 0, 2) == b"\x34\x12"
    with pytest.raises(UnknownAreaError, match=r"no area 'relay' – did you mean 'relays'"):
        memory.read("relay", "word", 0)
    with pytest.raises(ValueError, match="two areas of the memory are named B"):
        DeviceMemory([Area("A", size=1, aliases=["B"]), Area("B", size=1)])


# --- watches


@st.composite
def word_writes(draw: st.DrawFn) -> tuple[str, int, list[int]]:
    unit, width = draw(st.sampled_from([("bit", 1), ("byte", 8), ("word", 16), ("dword", 32)]))
    size = WORDS * 16 // width
    start = draw(st.integers(0, size - 1))
    values = st.lists(st.integers(0, min(3, (1 << width) - 1)), max_size=min(size - start, 40))
    return unit, start, draw(values)


@st.composite
def watched(draw: st.DrawFn) -> tuple[int, int, int]:
    first = draw(st.integers(0, WORDS - 1))
    mask = draw(st.sampled_from([0xFFFF, 0x0001, 0x0100, 0x0FF0]))
    return first, draw(st.integers(1, WORDS - first)), mask


@given(st.lists(watched(), max_size=5), st.lists(word_writes(), max_size=10))
def test_each_watch_hears_once_of_each_write_that_changes_its_bits(
    ranges: list[tuple[int, int, int]], history: list[tuple[str, int, list[int]]]
) -> None:
    memory = small_memory()
    area = memory.area("M")
    heard: list[tuple[int, int, int]] = []
    for number, (first, count, mask) in enumerate(ranges):
        memory.watch("M", first, count, lambda _, word, words, number=number: heard.append((number, word, words)), mask)
    for unit, start, values in history:
        before = area.read("word", 0, WORDS)
        heard.clear()
        area.write(unit, start, values)
        after = area.read("word", 0, WORDS)
        expected = []
        for number, (first, count, mask) in enumerate(ranges):
            changed = [word for word in range(first, first + count) if (before[word] ^ after[word]) & mask]
            if changed:
                expected.append((number, changed[0], changed[-1] - changed[0] + 1))
        assert heard == expected


def test_the_data_are_in_when_a_watch_is_called() -> None:
    memory = small_memory()
    seen = []
    memory.watch("relays", 3, 1, lambda area, word, count: seen.append((area.name, area.read("word", word), count)))
    memory.write("M", "bit", 3 * 16 + 5, [1])
    memory.area("M").write_bits(3 * 16 + 5, 1, b"\x01")
    memory.area("M").write_bits(3 * 16, 6, b"\x21")
    assert seen == [("M", [0x20], 1), ("M", [0x21], 1)]


def test_cancelled_watches_are_silent() -> None:
    memory = small_memory()
    heard: list[str] = []
    second = None

    def first_called(*_: object) -> None:
        heard.append("first")
        assert second is not None
        second.cancel()

    first = memory.watch("M", 0, 2, first_called)
    second = memory.watch("M", 0, 1, lambda *_: heard.append("second"))
    third = memory.watch("M", 1, 1, lambda *_: heard.append("third"))
    memory.write("M", "word", 0, [1, 1])
    assert heard == ["first", "third"]
    assert not second.active and first.active
    second.cancel()
    first.cancel()
    memory.write("M", "word", 0, [2, 2])
    assert heard == ["first", "third", "third"]
    third.cancel()
    memory.write("M", "word", 0, [3, 3])
    assert len(heard) == 3


def test_a_callback_may_write_and_may_watch() -> None:
    memory = small_memory()
    later: list[int] = []

    def copy(area: Area, word: int, _: int) -> None:
        area.write("word", 9, area.read("word", word))
        memory.watch("M", 0, 1, lambda *_: later.append(1))

    memory.watch("M", 9, 1, lambda area, *_: later.append(area.read("word", 9)[0]))
    memory.watch("M", 0, 1, copy).area.write("word", 0, [5])
    assert later == [5]  # a watch added meanwhile is called for the next write only


def test_watches_on_half_words_and_beyond_the_end() -> None:
    memory = small_memory()
    heard: list[tuple[int, int]] = []
    odd = DeviceMemory([Area("B", size=5, unit="byte")])
    odd.watch("B", 2, 1, lambda _, word, count: heard.append((word, count)))
    odd.write("B", "byte", 3, [1, 1])
    odd.write("B", "byte", 0, [1, 1, 1, 1])
    assert heard == [(2, 1)]
    for first, count in ((WORDS, 1), (0, WORDS + 1), (-1, 1), (0, 0)):
        with pytest.raises(MemoryRangeError):
            memory.watch("M", first, count, lambda *_: None)

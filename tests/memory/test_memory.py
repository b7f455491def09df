from __future__ import annotations

import zlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from framekit.memory.memory import Area, DeviceMemory, MemoryRangeError, SnapshotError, UnknownAreaError

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
    there = WORDS * 16 // width
    start = draw(st.integers(0, there - 1))
    values = st.lists(st.integers(0, min(3, (1 << width) - 1)), max_size=min(there - start, 40))
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
    assert later == [5]  # the watch made meanwhile hears of the next write only


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


# --- snapshots

contents = st.fixed_dictionaries(
    {
        "M": st.binary(min_size=2 * WORDS, max_size=2 * WORDS),
        "Q": st.integers(0, (1 << 13) - 1).map(lambda bits: bits.to_bytes(2, "little")),
        "F": st.binary(min_size=8, max_size=8),
    }
)


@given(contents)
def test_a_saved_memory_comes_back(tmp_path_factory: pytest.TempPathFactory, content: dict[str, bytes]) -> None:
    path = tmp_path_factory.mktemp("memory") / "state"
    memory = small_memory()
    memory.restore(content)
    assert memory.snapshot() == content
    memory.save(path)
    other = small_memory()
    other.write("M", "word", 0, [0xFFFF])
    other.load(path)
    assert other.snapshot() == content
    assert [entry.name for entry in path.parent.iterdir()] == ["state"]


def test_restoring_and_resetting_call_watches() -> None:
    memory = small_memory()
    memory.write("M", "word", 3, [9])
    memory.write("F", "word", 0, [1], force=True)
    full = memory.snapshot()
    heard: list[tuple[str, int, int]] = []
    memory.watch("M", 0, WORDS, lambda area, word, count: heard.append((area.name, word, count)))
    memory.reset()
    assert not any(any(data) for data in memory.snapshot().values())
    memory.restore(full)
    memory.restore(full)
    assert heard == [("M", 3, 1), ("M", 3, 1)]


def test_a_snapshot_of_another_shape_changes_nothing(tmp_path: Path) -> None:
    memory = small_memory()
    memory.write("M", "word", 0, [1])
    before = memory.snapshot()
    with pytest.raises(SnapshotError, match="differs in F, M"):
        memory.restore({"M": b"", "Q": bytes(2)})
    others = {
        "area M is 8 × word there and 16 × word here": [Area("M", size=8)],
        "area M is 32 × byte there and 16 × word here": [Area("M", size=32, unit="byte")],
        "area Q is not there and 13 × bit here": [Area("M", size=WORDS)],
        "area X is 1 × word there and not here": [*small_memory(), Area("X", size=1)],
        "another order": [*reversed(list(small_memory()))],
    }
    for message, areas in others.items():
        DeviceMemory(areas).save(tmp_path / "other")
        with pytest.raises(SnapshotError, match=message):
            memory.load(tmp_path / "other")
    assert memory.snapshot() == before


@given(st.data())
def test_a_damaged_file_is_refused_or_read_right(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = tmp_path_factory.mktemp("memory") / "state"
    memory = small_memory()
    memory.write("M", "word", 0, list(range(WORDS)))
    memory.save(path)
    good, before = path.read_bytes(), memory.snapshot()
    at = data.draw(st.integers(0, len(good) - 1))
    damaged = data.draw(
        st.sampled_from([good[:at], good + b"x", good[:at] + bytes([good[at] ^ 0x10]) + good[at + 1 :]])
    )
    path.write_bytes(damaged)
    other = small_memory()
    try:
        other.load(path)
    except SnapshotError:
        assert other.snapshot() == small_memory().snapshot()
    else:
        assert other.snapshot() == before


def test_a_file_unpacks_to_no_more_than_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "state"
    memory = small_memory()
    memory.save(path)
    head = b"\n".join(path.read_bytes().split(b"\n")[:2]) + b"\n"
    path.write_bytes(head + zlib.compress(bytes(10_000_000)))
    with pytest.raises(SnapshotError, match="damaged"):
        memory.load(path)
    path.write_bytes(head.split(b"\n")[0] + b"\n" + b"[" * 100_000)
    with pytest.raises(SnapshotError, match="damaged"):
        memory.load(path)


def test_saving_replaces_the_old_file_or_leaves_it(tmp_path: Path) -> None:
    path = tmp_path / "state"
    memory = small_memory()
    memory.save(path)
    memory.write("M", "word", 0, [4])
    memory.save(path)
    other = small_memory()
    other.load(path)
    assert other.read("M", "word", 0) == [4]
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(OSError):
        memory.save(folder)  # a folder cannot be replaced by a file
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["folder", "state"]

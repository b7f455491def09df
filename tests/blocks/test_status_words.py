"""Status words of blocks in memory: every completion is one pulse; counters and errors as specified; settings."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace

import pytest

from framekit.definition.model.sections import StationType
from framekit.definition.problems import NOWHERE
from framekit.definition.times import NEVER
from framekit.memory.memory import Area, DeviceMemory
from framekit.memory.profile import BlockItem, BlockWords, load_profile
from framekit.run.block_state import BlockStatus, ErrorCode, Failure
from framekit.run.block_words import (
    BlockSettings,
    SettingError,
    StatusWords,
    check_items,
)
from framekit.run.model import RunModel
from framekit.runfile.run_file import load_run

SCAN = 10_000_000


class Shown:
    """The masterlogic status words, with a watch on the first word of set 1, block 0."""

    def __init__(self) -> None:
        profile = load_profile("masterlogic")
        self.memory = profile.create()
        self.words = StatusWords(self.memory, profile.flags.values(), SCAN)
        self.edges: list[int] = []
        self.counts: list[int] = []
        self.memory.watch("L", 625, 1, self._changed)

    def completed(self, status: BlockStatus, ok: bool, now: int) -> None:
        self.words.completed((status.set, status.block), status, ok, now)

    def _changed(self, *_: object) -> None:
        self.edges.append(self.memory.read("L", "word", 625)[0])
        self.counts.append(self.memory.read("L", "dword", 627 // 2)[0] if 627 % 2 == 0 else self.dword(627))

    def dword(self, word: int) -> int:
        low, high = self.memory.read("L", "word", word, 2)
        return low | high << 16


def status(done: int, failed: int = 0, failure: Failure | None = None, number: int = 0, set_: int = 1) -> BlockStatus:
    return BlockStatus(
        set=set_, block=number, started=done + failed, done=done, failed=failed, last_failure=failure
    )  # fmt: skip


def test_a_normal_completion() -> None:
    shown = Shown()
    shown.completed(status(1), True, 0)
    assert shown.memory.read("L", "word", 625, 6) == [1, 0, 1, 0, 0, 0]
    assert shown.edges == [1] and shown.counts == [1], "the count is there before the pulse"
    assert shown.words.deadline == SCAN
    shown.words.tick(SCAN - 1)
    assert shown.edges == [1]
    shown.words.tick(SCAN)
    assert shown.edges == [1, 0] and shown.words.deadline == NEVER


def test_an_abnormal_completion_and_the_next_normal_one() -> None:
    shown = Shown()
    refused = Failure(outcome="refused", device_code=0x1332, meaning="blocks of different types")
    shown.completed(status(0, 1, refused), False, 0)
    assert shown.memory.read("L", "word", 625, 6) == [2, 0x1332, 0, 0, 1, 0]
    shown.completed(status(0x12345, 1, refused), True, SCAN)
    assert shown.memory.read("L", "word", 625, 6) == [1, 0x1332, 0x2345, 1, 1, 0], "STATUS is of the last failure"


def test_every_completion_is_one_rising_edge_of_one_bit() -> None:
    shown, chance, now, wanted, done, failed = Shown(), random.Random(7), 0, [], 0, 0
    for _ in range(300):
        now += chance.choice([0, 1, SCAN // 2, SCAN, 3 * SCAN])
        if shown.words.deadline <= now and chance.random() < 0.7:
            shown.words.tick(now)
        ok = chance.random() < 0.5
        done, failed = done + ok, failed + (not ok)
        shown.completed(status(done, failed, Failure(outcome="no_reply")), ok, now)
        wanted.append(1 if ok else 2)
    shown.words.tick(now + SCAN)
    before, rises = 0, []
    for word in shown.edges:
        rises += [bit for bit in (1, 2) if word & bit and not before & bit]
        assert word in (0, 1, 2)
        before = word
    assert rises == wanted and before == 0


def test_bits_and_words_of_others_stay() -> None:
    shown = Shown()
    shown.memory.write("L", "word", 624, [0xFFFF, 0x8000])
    shown.memory.write("L", "word", 631, [0xFFFF])
    shown.completed(status(1), True, 0)
    shown.words.tick(SCAN)
    assert shown.memory.read("L", "word", 624, 2) == [0xFFFF, 0x8000]
    assert shown.memory.read("L", "word", 631) == [0xFFFF]


def test_sets_and_blocks_beyond_the_words_are_not_shown() -> None:
    shown = Shown()
    before = shown.memory.snapshot()
    shown.completed(status(1, number=64), True, 0)
    shown.completed(status(1, set_=9), True, 0)
    assert shown.memory.snapshot() == before and shown.words.deadline == NEVER
    shown.completed(status(1, number=63, set_=8), True, 0)
    assert shown.memory.read("L", "word", 625 + 6 * 511, 3) == [1, 0, 1]


def test_a_profile_may_show_more() -> None:
    items = {
        "running": BlockItem(0, bit=3),
        "reason": BlockItem(1),
        "device_code": BlockItem(2, words=2, unit="dword"),
        "started_count": BlockItem(4),
    }
    section = BlockWords(name="mine", area="S", first=2, words=5, sets=1, blocks=2, items=items, at=NOWHERE)
    memory = DeviceMemory([Area("S", size=12, access="read")])
    words = StatusWords(memory, [section], SCAN)
    failure = Failure(outcome="refused", device_code=0x1_0002)
    words.show((1, 1), BlockStatus(set=1, block=1, started=70_000, done=69_998, failed=1, last_failure=failure))
    assert memory.read("S", "word", 7, 5) == [8, ErrorCode.REFUSED, 2, 1, 70_000 & 0xFFFF]
    words.completed((1, 1), status(1, number=1), True, 0)
    assert words.deadline == NEVER, "without pulses nothing is to be ended"
    words.forget((1, 1))
    assert memory.read("S", "word", 0, 12) == [0] * 12


# ---- settings -------------------------------------------------------------------------------------------------

RUN = """
run: settings
memory: masterlogic
channels:
  1: {port: "loop://", protocol: mldp, station: 4}
  2: {port: "loop://", protocol: third-party-plc}
blocks:
  0: {read: M0100, count: 10, into: D100, station: 2, channel: 1, once: yes}
  1: {read: [M1, M2], into: [D1, D2], channel: 1, once: yes}
  2: {write: "%MW300", from: D32760, count: 2, station: M5, channel: 1, once: yes}
  3: {send: WR.REQ, channel: 2, data: {payload: M0}, once: yes}
  4: {receive: RD.DATA, channel: 2, data: {payload: M100}}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunModel:
    path = tmp_path_factory.mktemp("settings") / "settings.run.yaml"
    path.write_text(RUN, encoding="utf-8")
    return load_run(path)


def settings_of(run: RunModel) -> tuple[DeviceMemory, BlockSettings]:
    memory = run.memory.create()
    settings = BlockSettings(memory, run.memory.flags.values())
    for block in run.blocks:
        settings.show(block, run.channels[block.channel].protocol)
    return memory, settings


def text(words: list[int]) -> str:
    return b"".join(word.to_bytes(2, "little") for word in words).decode().rstrip("\0")


def test_settings_are_shown(run: RunModel) -> None:
    memory, settings = settings_of(run)
    assert memory.read("N", "word", 0) == [2] and memory.read("N", "word", 41) == [4]
    assert text(memory.read("N", "word", 1, 4)) == "M0100" and memory.read("N", "word", 5) == [10]
    assert [text(memory.read("N", "word", 41 + at, 4)) for at in (1, 6, 11)] == ["M1", "M2", ""]
    assert [memory.read("N", "word", 41 + at)[0] for at in (5, 10, 15)] == [1, 1, 0]
    assert text(memory.read("N", "word", 2 * 41 + 21, 4)) == "%MW300" and memory.read("N", "word", 2 * 41 + 25) == [2]
    assert memory.read("N", "word", 3 * 41 + 25) == [44] and memory.read("N", "word", 4 * 41 + 5) == [24]
    assert all(settings.effective(block) is block for block in run.blocks), "nothing was changed"


def test_a_changed_station_word_redirects_the_next_exchange(run: RunModel) -> None:
    memory, settings = settings_of(run)
    memory.write("N", "word", 0, [7])
    assert settings.effective(run.blocks[0]).station == 7
    memory.write("N", "word", 0, [2])
    assert settings.effective(run.blocks[0]) is run.blocks[0]
    protocol = run.channels[1].protocol
    settings.show(run.blocks[0], replace(protocol, station=StationType(limits=(0, 31))))
    memory.write("N", "word", 0, [77])
    with pytest.raises(SettingError, match=r"station 77 in N word 0 is not in 0\.\.31"):
        settings.effective(run.blocks[0])


def test_a_changed_size_counts_where_it_can(run: RunModel) -> None:
    memory, settings = settings_of(run)
    memory.write("N", "word", 5, [60])
    assert settings.effective(run.blocks[0]).count == 60
    memory.write("N", "word", 5, [0])
    with pytest.raises(SettingError, match="moves nothing"):
        settings.effective(run.blocks[0])
    memory.write("N", "word", 41 + 5, [9])
    assert settings.effective(run.blocks[1]) is run.blocks[1], "a single variable is one element"
    memory.write("N", "word", 2 * 41 + 25, [8])
    assert settings.effective(run.blocks[2]).count == 8
    memory.write("N", "word", 2 * 41 + 25, [9])
    with pytest.raises(SettingError, match="no room from D32760 on"):
        settings.effective(run.blocks[2])
    memory.write("N", "word", 1, [int.from_bytes(b"P0", "little")])
    memory.write("N", "word", 5, [10])
    assert settings.effective(run.blocks[0]).targets == ("P0100",)
    memory.write("N", "word", 1, [0x4141])
    with pytest.raises(SettingError, match="'AA100' in N word 1: 'AA100' is not an address"):
        settings.effective(run.blocks[0])


def test_a_station_from_elsewhere_is_shown(run: RunModel) -> None:
    memory, settings = settings_of(run)
    memory.write("M", "word", 5, [11])
    assert settings.effective(run.blocks[2]) is run.blocks[2]
    assert memory.read("N", "word", 2 * 41) == [11]
    memory.write("N", "word", 2 * 41, [3])
    assert settings.effective(run.blocks[2]) is run.blocks[2]
    assert memory.read("N", "word", 2 * 41) == [11], "it comes from M5"


def test_a_block_that_is_no_more_leaves_free_memory(run: RunModel) -> None:
    memory, settings = settings_of(run)
    settings.forget((1, 0))
    assert memory.read("N", "word", 0, 41) == [0] * 41
    memory.write("N", "word", 0, [9])
    assert settings.effective(run.blocks[0]) is run.blocks[0]


def test_items_that_no_block_has() -> None:
    section = BlockWords(
        name="s", area="L", first=0, words=1, sets=1, blocks=1, items={"doen": BlockItem(0)}, at=NOWHERE
    )
    (problem,) = check_items([section])
    assert "'doen' in 's' is nothing a block has" in problem.what and "done" in problem.todo
    assert list(check_items(load_profile("masterlogic").flags.values())) == []


# ---- words that are written late ----------------------------------------------------------------------------------


class Late:
    """The masterlogic status words with a clock set by the test; they are written when they are read."""

    def __init__(self) -> None:
        profile = load_profile("masterlogic")
        self.memory = profile.create()
        self.time = 0
        self.woken = 0
        self.words = StatusWords(self.memory, profile.flags.values(), SCAN, lambda: self.time, self._wake)

    def _wake(self) -> None:
        self.woken += 1

    def ended(self, done: int, ok: bool = True, number: int = 0) -> None:
        self.words.completed((1, number), status(done, number=number), ok, self.time)


LOOKS = {
    "words": lambda memory: memory.read("L", "word", 625)[0] & 1,
    "a bit": lambda memory: int(memory.area("L").read_bit(625 * 16)),
    "bits": lambda memory: memory.area("L").read_bits(625 * 16, 1)[0],
    "numbers at a bit": lambda memory: memory.area("L").read_from(625 * 16, "bit")[0],
    "bytes": lambda memory: memory.read_bytes("L", 1250, 1)[0] & 1,
    "the whole": lambda memory: memory.snapshot()["L"][1250] & 1,
}


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
def test_late_words_are_right_whenever_they_are_looked_at(look: Callable[[DeviceMemory], int]) -> None:
    late = Late()
    late.time = 5
    late.ended(1)
    assert late.words.deadline == NEVER, "no timer ends the pulse"
    late.time = 5 + SCAN - 1
    assert look(late.memory) == 1
    late.time += 1
    assert look(late.memory) == 0
    late.ended(2)
    late.time += SCAN
    assert look(late.memory) == 0, "a pulse that begins and ends between two looks"
    assert late.memory.read("L", "word", 627) == [2]


def test_functions_that_read_late_words_ask_at_each_call() -> None:
    late = Late()
    area = late.memory.area("L")
    read, first, holds = area.bytes_reader(1250, 6), area.byte_reader(1250), area.holder(1250, b"\x01")
    write = area.bytes_writer(1254, 2)
    assert (read(), first(), holds()) == (bytes(6), 0, False)
    late.ended(3)
    assert (read(), first(), holds()) == (b"\x01\x00\x00\x00\x03\x00", 1, True)
    late.ended(4)
    write(b"\x63\x00")
    assert late.memory.read("L", "word", 625, 3) == [1, 0, 99], "written after the words that were late"


def test_a_write_does_not_get_lost_under_late_words() -> None:
    late = Late()
    late.ended(3)
    late.memory.write("L", "word", 627, [99], force=True)
    assert late.memory.read("L", "word", 627) == [99]
    late.ended(4)
    assert late.memory.read("L", "word", 627) == [4]


def test_a_watch_makes_words_prompt() -> None:
    late = Late()
    late.ended(1)
    seen: list[int] = []
    late.memory.watch("L", 625, 1, lambda *_: seen.append(late.memory.read("L", "word", 625)[0]))
    assert (seen, late.woken, late.words.deadline) == ([], 1, SCAN), "the pulse that is on ends by itself"
    late.time = SCAN
    late.words.tick(SCAN)
    late.ended(2)
    assert seen == [0, 1]


def test_a_block_that_is_no_more_leaves_no_late_words() -> None:
    late = Late()
    late.ended(3)
    late.words.forget((1, 0))
    assert late.memory.read("L", "word", 625, 6) == [0] * 6

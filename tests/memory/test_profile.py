from __future__ import annotations

from pathlib import Path

import pytest

from framekit.definition.nodes import Mapping, read_nodes
from framekit.definition.problems import DefinitionError, Position
from framekit.memory.memory import AccessError
from framekit.memory.profile import MemoryProfile, load_profile, load_profile_node

GOOD = """\
memory: bench
about: two areas
areas:
  M: {unit: word, size: 0x10, digits: 4, aliases: [relays, flags]}
  T: {unit: 6 bytes, size: 3, access: read, wire: "'T'"}
addresses:
  - {form: "{area}{start:dec}"}
scan: 5 ms
clocks: {M00000: 1 s}
fixed: {M00001: on, M00002: every_scan}
flags:
  ready: M00003
  status:
    {area: M, first: 2, words: 3, sets: 2, blocks: 2, items: {done: {word: 0, bit: 1}, count: {word: 1, unit: dword}}}
"""


def write(folder: Path, text: str, name: str = "bench") -> Path:
    path = folder / f"{name}.memory.yaml"
    path.write_text(text)
    return path


def test_a_profile_says_all_there_is_to_a_memory(tmp_path: Path) -> None:
    profile = load_profile(write(tmp_path, GOOD))
    assert (profile.name, profile.about, profile.scan) == ("bench", "two areas", 5_000_000)
    relays, timers = profile.areas["M"], profile.areas["T"]
    assert (relays.size, relays.element_bits, relays.columns) == (16, 16, {"digits": 4})
    assert relays.aliases == ("relays", "flags")
    assert (timers.element_bits, timers.access, timers.columns) == (48, "read", {"wire": "T"})
    assert [(clock.address, clock.period) for clock in profile.clocks] == [("M00000", 1_000_000_000)]
    assert [(bit.address, bit.kind) for bit in profile.fixed] == [("M00001", "on"), ("M00002", "every_scan")]
    assert [form.text for form in profile.addresses] == ["{area}{start:dec}"]
    assert {name: flag.address for name, flag in profile.named.items()} == {"ready": "M00003"}
    memory = profile.create()
    memory.write("flags", "word", 15, [1])
    assert memory.read("M", "word", 15) == [1]
    with pytest.raises(AccessError):
        memory.write("T", "6 bytes", 2, [1])


def test_words_of_blocks_follow_each_other(tmp_path: Path) -> None:
    status = load_profile(write(tmp_path, GOOD)).flags["status"]
    assert [status.base(number, block) for number in (1, 2) for block in (0, 1)] == [2, 5, 8, 11]
    assert status.items["count"].words == 2
    for number, block in ((0, 0), (3, 0), (1, 2), (1, -1)):
        with pytest.raises(ValueError, match="sets are 1 to 2, blocks 0 to 1"):
            status.base(number, block)


def test_names_are_looked_for_beside_the_file_and_among_the_shipped(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    assert load_profile("bench", tmp_path).name == "bench"
    assert load_profile("bench.memory.yaml", tmp_path).name == "bench"
    assert load_profile("masterlogic", tmp_path).name == "masterlogic"
    write(tmp_path, GOOD, "masterlogic")
    assert load_profile("masterlogic", tmp_path).name == "bench"
    at = Position("run.yaml", 2, 9)
    with pytest.raises(DefinitionError, match=r"run.yaml:2:9: .* no memory profile 'benhc' – did you mean 'bench'"):
        load_profile("benhc", tmp_path, at)
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "link.memory.yaml").symlink_to(tmp_path / "bench.memory.yaml")
    for name in ("../bench", "/etc/passwd", "~/x", "", "..\\bench"):
        with pytest.raises(DefinitionError, match="leaves the folder"):
            load_profile(name, inner)
    with pytest.raises(DefinitionError, match="no memory profile 'link'"):
        load_profile("link", inner)


def in_place(folder: Path, text: str) -> MemoryProfile:
    path = folder / "run.yaml"
    path.write_text(text)
    root = read_nodes(path)
    assert isinstance(root, Mapping)
    node = root.get("memory")
    assert isinstance(node, Mapping)
    return load_profile_node(node, folder)


def test_a_profile_written_in_place(tmp_path: Path) -> None:
    profile = in_place(tmp_path, "memory:\n  areas: {M: {size: 8}}\n  set: {M0: 1}\n")
    assert (profile.name, profile.areas["M"].unit, profile.scan) == ("", "word", 10_000_000)
    assert [form.text for form in profile.addresses] == ["{area}{start:dec}"]
    assert profile.create().read("M", "word", 0, 8) == [0] * 8


def test_a_profile_written_in_place_on_top_of_another(tmp_path: Path) -> None:
    areas = "areas: {D: {size: 20000}, X: {unit: byte, size: 3}}"
    small = in_place(tmp_path, f"memory:\n  profile: masterlogic\n  {areas}\n  clocks: {{F00093: 2 s}}\n")
    whole = load_profile("masterlogic")
    assert (small.name, small.areas["D"].size, small.areas["D"].columns) == ("masterlogic", 20000, {"digits": 5})
    assert set(small.areas) == {*whole.areas, "X"}
    assert [form.text for form in small.addresses] == [form.text for form in whole.addresses]
    assert {clock.period for clock in small.clocks if clock.address == "F00093"} == {2_000_000_000}
    assert len(small.clocks) == len(whole.clocks)
    with pytest.raises(DefinitionError, match=r"run.yaml:2:12: there is no memory profile 'masterlogik'"):
        in_place(tmp_path, "memory:\n  profile: masterlogik\n")
    with pytest.raises(DefinitionError, match="no areas"):
        in_place(tmp_path, "memory:\n  set: {M0: 1}\n")


def test_a_file_of_something_else(tmp_path: Path) -> None:
    for text in ("- M\n- P\n", GOOD.replace("areas:", "area:", 1)):
        with pytest.raises(DefinitionError, match="bench"):
            load_profile(write(tmp_path, text))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("size: 0x10", "size: 0", "0"),
        ("size: 0x10", "sise: 16", "size"),
        ("access: read", "acess: read", "acess"),
        ("access: read", "access: write", "write"),
        ("6 bytes", "6 bits", "6 bits"),
        ("aliases: [relays, flags]", "aliases: [T]", "two areas are named 'T'"),
        ("{M00000: 1 s}", "{M00000: 1 sec}", "1 sec"),
        ("{M00000: 1 s}", "{M00000: 1 us}", "1 ms or more"),
        ("{M00000: 1 s}", "{M00000: never}", "1 ms or more"),
        ("scan: 5 ms", "scan: 0 ms", "1 ms or more"),
        ("M00001: on", "M00001: always", "always"),
        ("area: M,", "area: K,", "no area 'K'"),
        ("blocks: 2", "blocks: 3", "reaches to word 19, beyond the end of area M"),
        ("{word: 0, bit: 1}", "{word: 3, bit: 1}", "beyond the 3 words"),
        ("{word: 0, bit: 1}", "{bit: 1}", "word"),
        ("sets: 2, ", "", "sets"),
        ("about: two areas", "about: [two, areas]", "single|string|text|about"),
        ("scan: 5 ms", "tables: {x: 5}", "mapping|object|table"),
        ("{word: 0, bit: 1}", "{word: 0, bit: 16}", "no bit 16|maximum of 15"),
        ("{word: 1, unit: dword}", "{word: 2, unit: dword}", "beyond the 3 words"),
        ("{word: 1, unit: dword}", "{word: 1, unit: byte}", "byte"),
        ("areas:", "areas: 7\nflags_: ", "areas|flags_|a mapping"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    path = write(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(DefinitionError, match=message) as caught:
        load_profile(path)
    line = GOOD[: GOOD.index(old)].count("\n") + 1
    places = [(problem.at.file, problem.at.line) for problem in caught.value.problems]
    assert (str(path), line) in places or (str(path), line - 1) in places or (str(path), line + 1) in places


def test_areas_that_outlast_a_restart(tmp_path: Path) -> None:
    assert [area.name for area in load_profile("masterlogic").areas.values() if area.retained] == ["K", "R", "ZR"]

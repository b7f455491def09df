"""Arguments of calls that are not single values: lists of records and files, in runs and on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.cli.main import main
from framekit.definition.problems import DefinitionError
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
PLC = """device: plc
protocol: snp
station: 33101A
memory: {set: {R5: [0x2219, 0x1205], I82: [1, 0, 1]}}
"""


def run_text(*blocks: str, params: str = "") -> str:
    lines = "".join(f"  {number}: {{{block}, channel: 1}}\n" for number, block in enumerate(blocks))
    channel = f'{{port: "sim:plc.device.yaml", protocol: snp, station: 33101A{params}}}'
    return f"run: calls\nmemory: ge-90-30\nchannels:\n  1: {channel}\nblocks:\n{lines}"


def at_work(folder: Path, text: str, seconds: int = 3) -> RunService:
    """Return the service of a run after some seconds of virtual time."""
    (folder / "plc.device.yaml").write_text(PLC, encoding="utf-8")
    path = folder / "calls.run.yaml"
    path.write_text(text, encoding="utf-8")
    clock = VirtualClock()
    service = RunService(load_run(path), clock)
    service.start()
    clock.run_for(seconds * SECOND)
    return service


def problems(folder: Path, text: str) -> list[str]:
    (folder / "plc.device.yaml").write_text(PLC, encoding="utf-8")
    path = folder / "calls.run.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DefinitionError) as raised:
        load_run(path)
    return [
        f"{problem.at.line}:{problem.at.column}: {problem.what} – {problem.todo}" for problem in raised.value.problems
    ]


POINTS = "[{selector: 8, offset: 4, length: 2}, {selector: 0x10, offset: 10, length: 1}]"


def test_a_datagram_is_established_defined_and_updated_in_one_session(tmp_path: Path) -> None:
    """A normal datagram exists as long as its session, which all blocks of a channel share."""
    service = at_work(
        tmp_path,
        run_text(
            "call: establish, with: {area_size: 25}, into: {id.id: '%R1'}, once: yes",
            f"call: define_datagram, with: {{id: 1, points: {POINTS}}}, when: block 0 done",
            "call: update_datagram, with: {id: 1}, into: {values.values: '%R100'}, size: {values.values: 6},"
            " when: block 1 done",
        ),
    )
    assert [(status.done, status.failed, status.last_failure) for status in service.status()] == [(1, 0, None)] * 3
    assert service.memory.read("R", "word", 0, 1) == [1]
    assert service.memory.read("R", "word", 99, 3) == [0x2219, 0x1205, 0x000A]


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ("[{selector: 8, ofset: 4, length: 2}]", "there is no field 'ofset' – did you mean 'offset'?"),
        ("[{selector: x, offset: 4, length: 2}]", "'x' is not a whole number – write it like 10 or 0x0A"),
        ("[{selector: 8, offset: 4}]", "'length' is missing – add length: VALUE"),
        ("[{selector: 8, offset: 4, length: 300}]", "300 does not fit: 'length' holds 0 to 255 – correct it"),
        ("[{selector: 8, offset: 4, length: 1, fits: 1}]", "'fits' is computed – leave it out"),
        ("[5, {selector: 8, offset: 4, length: 1}]", "write {NAME: value} with some of selector, offset, length"),
    ],
)  # fmt: skip
def test_wrong_records_are_reported_at_their_place(tmp_path: Path, points: str, expected: str) -> None:
    found = problems(tmp_path, run_text(f"call: define_datagram, with: {{id: 1, points: {points}}}, once: yes"))
    assert len(found) == 1
    assert found[0].startswith("6:")
    assert found[0].endswith(expected)


PROGRAMMER = ", params: {privilege: 3, login: yes}"


def test_a_program_comes_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "logic.bin").write_bytes(bytes(range(131)))
    service = at_work(
        tmp_path,
        run_text(
            "call: program_store, with: {block: {file: logic.bin}}, once: yes",
            "call: program_load, into: {block: '%R1'}, size: {block: 132}, when: block 0 done",
            params=PROGRAMMER,
        ),
    )
    assert [(status.done, status.failed, status.last_failure) for status in service.status()] == [(1, 0, None)] * 2
    assert service.memory.read("R", "word", 0, 3) == [0x0100, 0x0302, 0x0504]


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        ("{file: none.bin}", "'none.bin' cannot be read: No such file or directory – check its name and folder"),
        ("{file: ../../secret}", "'../../secret' leaves the run's folder – "),
        ("{fiel: a.bin}", "bytes have no 'fiel' – write {file: NAME}"),
        ("{}", "no file is named – write {file: NAME}"),
    ],
)
def test_files_that_cannot_be_read(tmp_path: Path, block: str, expected: str) -> None:
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    found = problems(folder, run_text(f"call: program_store, with: {{block: {block}}}, once: yes", params=PROGRAMMER))
    assert len(found) == 1
    assert f": {expected}" in found[0]


def called(folder: Path, *words: str, state: str = "") -> int:
    (folder / "plc.device.yaml").write_text(PLC + state, encoding="utf-8")
    line = ["--port", f"sim:{folder / 'plc.device.yaml'}", "--station", "33101A", "--param", "privilege=3"]
    return main(["call", "snp", *words, *line, "--param", "login=yes"])


@pytest.mark.long
def test_the_command_line_stores_and_loads_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, copy = tmp_path / "logic.bin", tmp_path / "copy.bin"
    source.write_bytes(b"\x01\x02\x03")
    state = "state: {program_blocks: {initial: {0: 01 02 03}}}\n"
    assert called(tmp_path, "program_store", f"block=@{source}", state=state) == 0
    assert called(tmp_path, "program_load", "--save", f"block={copy}", state=state) == 0
    assert copy.read_bytes() == b"\x01\x02\x03"
    capsys.readouterr()
    for words, message in (
        (["program_load", "--save", f"block={copy}"], f"--save: {copy} is there already – name another file"),
        (["program_load", "--save", f"blocks={tmp_path / 'x'}"], "--save: there is no result 'blocks' – known: block"),
        (["short_status", "--save", f"status.programs={tmp_path / 'x'}"], "'status.programs' is no result of bytes"),
        (["program_store", "block=@nowhere.bin"], "nowhere.bin: there is no such file"),
    ):
        assert called(tmp_path, *words, state=state if words[0] == "program_load" else "") != 0
        assert message in capsys.readouterr().err

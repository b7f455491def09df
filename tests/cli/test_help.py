"""The help of the command line: groups of verbs, working examples, and hints for words of other programs."""

from __future__ import annotations

import itertools
import shlex
import shutil
from pathlib import Path

import pytest
from docs.pages import ROOT

from framekit.cli.main import main
from framekit.cli.other_words import LETTERS_MEANT, OPTIONS_MEANT, VERBS_MEANT
from framekit.cli.verb_table import GROUPS, VERBS, examples_of

IN_THE_TEST = {
    "/dev/ttyUSB0": "loop://",
    "broker.local": "127.0.0.1:1",
    "tcp://{host}": "tcp://{host}:1",
    "10.0.0.0/28": "127.0.0.1/32",
    "tcp-listen://127.0.0.1:5020": "tcp-listen://127.0.0.1:0",
}
"""Words of examples that need hardware or a server, and their substitutes."""
ONE_EXCHANGE = ("read", "write", "call", "scan")
ENDLESS = ("edit", "serve", "monitor", "record", "run")
STATUS = {
    "framekit scan tcp://{host} modbus-tcp --hosts 10.0.0.0/28 --stations 1 --json": 3,  # a port without a listener
    "framekit fleet broker.local": 1,  # no broker is present
    "framekit fleet broker.local --watch --for 10s": 1,
    "framekit record /dev/ttyUSB0 --try --speeds 9600,19200": 1,  # a silent line
}
LINE = """run: line
channels: {1: {port: "sim:remote-io-1.device.yaml", protocol: modbus-rtu, station: 1}}
points: {door: {channel: 1, address: "1000N"}}
"""
METER = """run: meter
channels: {1: {port: "sim:oven.device.yaml", protocol: modbus-tcp, station: 1}}
points: {temperature: {channel: 1, address: "40001"}}
sinks: [{sqlite: meter.db}]
"""


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of examples, with recordings and files of other programs."""
    folder = tmp_path_factory.mktemp("help") / "examples"
    shutil.copytree(ROOT / "examples", folder)
    (folder / "meter.run.yaml").write_text(METER, "utf-8")
    (folder / "registers.csv").write_text("name,address,type\nlevel,0,u16\n", "utf-8")
    (folder / "psu.proto").write_text('Terminator = LF;\nread { out "V?"; in "%f"; }\n', "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["run", "meter.run.yaml", "--virtual", "--for", "3s"]) == 0
        for name, number in (("line", "3"), ("off", "3"), ("on", "4")):
            (folder / f"{name}.run.yaml").write_text(LINE.replace("N", number), "utf-8")
            assert main(["run", f"{name}.run.yaml", "--virtual", "--for", "9s", "--capture", f"{name}.jsonl"]) == 0
    return folder


def ended_with(words: list[str]) -> int:
    try:
        return main(words)
    except SystemExit as end:
        return int(end.code or 0)


def test_every_verb_belongs_to_a_group_and_has_two_examples() -> None:
    assert sum(map(len, GROUPS.values())) == len(VERBS)
    for verb in VERBS:
        examples = examples_of(verb)
        assert len(set(examples)) == 2
        assert all(example.startswith(f"framekit {verb} ") or example == f"framekit {verb}" for example in examples)


@pytest.mark.parametrize("words", [["--help"], ["-h"], ["help"]])
def test_the_overview_has_groups_examples_and_the_place_of_the_docs(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended_with(words) == 0
    out = capsys.readouterr().out
    assert all(f"\n{group}:\n" in out for group in GROUPS)
    assert all(f"\n  {verb} " in out for verb in VERBS)
    assert out.count("\n  framekit ") == 3 and "docs/cli.md" in out


@pytest.mark.parametrize("verb", VERBS)
def test_the_help_of_a_verb_ends_with_its_examples(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert ended_with(["help", verb]) == 0
    out = capsys.readouterr().out
    assert ended_with([verb, "--help"]) == 0
    assert capsys.readouterr().out == out
    assert out.splitlines()[-3:] == ["Examples:", *(f"  {example}" for example in examples_of(verb))]


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize("example", [example for verb in VERBS for example in examples_of(verb)])
def test_examples_work(
    example: str, examples: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(examples)
    if example.startswith("framekit completion"):
        pytest.importorskip("shtab")
    _, verb, *words = shlex.split(example)
    here = IN_THE_TEST | ({"/dev/ttyUSB0": "sim:remote-io-1.device.yaml"} if verb in ONE_EXCHANGE else {})
    words = [verb, *(here.get(word, word) for word in words)]
    if verb in ENDLESS and "--for" not in words and "--try" not in words:
        words += ["--for", "50ms"]
    if verb == "edit":
        words = [word for word in words if word not in ("--web", "8041")] + ["--web", "0"]
    if "--every" in words:
        words += ["--times", "1"]
    if verb == "demo" and "--fast" not in words:
        words.append("--fast")
    if words[:2] == ["loopback", "loop://"]:
        words += ["--speeds", "115200"]
    assert ended_with(words) == STATUS.get(example, 0), capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["poll"], "write framekit read with --every"),
        (["log"], "framekit run carries out a run file"),
        (["list"], "framekit frames lists the protocols"),
        (["simulate"], "framekit serve simulates a device"),
        (["decode-frame"], "framekit decode reads the bytes of a frame"),
        (["points", "import"], "framekit import makes points"),
        (["help", "poll"], "write framekit read with --every"),
        (["read", "modbus-rtu", "--port", "x", "40001", "--baudrate", "9600"], "write --speed"),
        (["read", "modbus-rtu", "--port", "x", "--address", "40001"], "write addresses without an option"),
        (["read", "-m", "rtu", "-a", "1", "-r", "1", "-c", "3", "-b", "9600", "x"], "'-a' – write --station"),
        (["read", "modbus-rtu", "--port", "x", "-0", "40001"], "such as holding:0"),
        (["encode", "modbus-rtu", "x", "--set", "a=1"], "write --param NAME=VALUE"),
        (["run", "x.run.yaml", "-a"], "there is no option '-a'\n"),
        (["monitor", "modbus-rtu", "--port", "x", "-b", "9600"], "write --speed"),
        (["serve", "modbus-rtu", "--port", "x", "-a", "1"], "write --station"),
        (["scan", "x", "modbus-rtu", "-b", "9600"], "write --speeds"),
        (["read", "modbus-rtu", "--port", "x", "-r", "1"], "such as 40001 or holding:0x10"),
        (["read", "modbus-rtu", "--port", "x", "-c", "3", "40001"], "write -n"),
        (["read", "modbus-rtu", "--port", "x", "-a1", "40001"], "'-a1' – write --station"),
        (
            ["read", "modbus-rtu", "40001"],
            "missing: --port – for example: framekit read modbus-rtu --port /dev/ttyUSB0",
        ),
        (["scan", "modbus-rtu", "--port", "x"], "write the port first: framekit scan PORT PROTOCOL"),
        (["scan", "modbus-rtu", "sim:x.yaml"], "write the port first: framekit scan sim:x.yaml modbus-rtu"),
    ],
)
def test_words_of_other_programs_lead_to_those_of_framekit(
    words: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended_with(words) == 2
    (line,) = capsys.readouterr().err.splitlines(keepends=True)
    assert hint in line


def test_words_of_other_programs_are_no_words_of_framekit() -> None:
    assert not VERBS_MEANT.keys() & VERBS.keys()
    assert all(verb in VERBS for hint in VERBS_MEANT.values() for verb in named(hint))
    assert all(hint for hint in (*OPTIONS_MEANT.values(), *LETTERS_MEANT.values()))


def named(hint: str) -> list[str]:
    """Return the verbs that a hint names."""
    words = hint.replace(",", "").split()
    return [after for word, after in itertools.pairwise(words) if word == "framekit" and after[0] != "-"]


@pytest.mark.parametrize("option", ["-1", "-0"])
def test_negative_numbers_are_written(option: str, capsys: pytest.CaptureFixture[str], examples: Path) -> None:
    port = f"sim:{examples / 'remote-io-1.device.yaml'}"
    words = ["write", "modbus-rtu", "--port", port, "--station", "1", "40010", option]
    words += ["--type", "int16"]
    assert ended_with(words) == 0, capsys.readouterr()

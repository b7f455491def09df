"""The table of exit codes in docs/cli/exit-status.md is complete: every verb is listed, and every listed code occurs.

With `--json`, every one of these errors is a JSON object.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest

from framekit.cli.common import PortError, VerbError, WordsError
from framekit.cli.main import main
from framekit.cli.verb_table import VERBS

PAGE = Path(__file__).parents[2] / "docs" / "cli" / "exit-status.md"

FILES = {
    "bad.yaml": "protocol: bad\nline: {kind: nothing}\n",
    "own.yaml": "protocol: own\nline: {kind: stream}\nframes: {one: {body: [{const: 01}, {field: value, type: u8}]}}\n",
    "own.vectors.yaml": "vectors: own\nframes:\n  - {name: wrong, frame: one, bytes: 01 02, values: {value: 3}}\n",
    "bad.run.yaml": "run: bad\nmemory: nothing\nchannels: {}\n",
    "gone.run.yaml": "run: gone\nchannels: {1: {port: 'tcp://127.0.0.1:1', protocol: modbus-tcp, station: 1}}\n"
    "points: {a: {channel: 1, address: '40001'}}\n",
    "d.device.yaml": "device: d\nprotocol: own.yaml\n",
    "m.device.yaml": "device: m\nprotocol: modbus-tcp\nstation: 1\n",
    "hex.txt": "05 06\n",
    "x.proto": "05 06\n",
    "names.csv": "a,b\n1,2\n",
}
GONE = "tcp://127.0.0.1:1"
"""A port without a listener."""

DEVICE = ["modbus-tcp", "--port", "sim:m.device.yaml", "--station", "1"]
NO_DEVICE = ["modbus-tcp", "--port", GONE, "--station", "1"]
CASES: dict[tuple[str, int], list[str]] = {
    ("demo", 2): ["--slow"],
    ("check", 1): ["bad.yaml"],
    ("check", 2): ["none.yaml"],
    ("encode", 1): ["bad.yaml", "one"],
    ("encode", 2): ["own.yaml", "two"],
    ("decode", 1): ["own.yaml", "02"],
    ("decode", 2): ["own.yaml", "xx"],
    ("frames", 1): ["bad.yaml"],
    ("frames", 2): ["none.yaml"],
    ("generate", 1): ["python", "bad.yaml"],
    ("generate", 2): ["python", "none.yaml"],
    ("test", 1): ["own.yaml"],
    ("test", 2): ["none.yaml"],
    ("edit", 1): ["own.yaml", "--web", "192.0.2.1:8040"],
    ("edit", 2): ["hex.txt"],
    ("read", 1): ["bad.yaml", "--port", GONE, "--station", "1", "M1"],
    ("read", 2): [*DEVICE, "Q1"],
    ("read", 3): [*NO_DEVICE, "40001"],
    ("write", 1): ["bad.yaml", "--port", GONE, "--station", "1", "M1", "1"],
    ("write", 2): [*DEVICE, "30001", "1"],
    ("write", 3): [*NO_DEVICE, "40001", "1"],
    ("call", 1): [*DEVICE, "exchange_words", "address=65535", "count=2", "write_address=1", "values=0001"],
    ("call", 2): [*DEVICE, "nothing"],
    ("call", 3): [*NO_DEVICE, "identify"],
    ("scan", 1): [GONE, "bad.yaml"],
    ("scan", 2): ["tcp://{host}", "modbus-tcp"],
    ("scan", 3): [GONE, "modbus-tcp"],
    ("commreq", 2): ["ccm", "5", "0", "8"],
    ("commreq", 3): ["ccm", "--port", GONE, "6101", "1", "1", "1", "2", "1"],
    ("run", 1): ["bad.run.yaml"],
    ("run", 2): ["none.run.yaml"],
    ("run", 3): ["gone.run.yaml", "--for", "1s"],
    ("fleet", 1): ["127.0.0.1:1"],
    ("fleet", 2): [":x"],
    ("serve", 1): ["bad.yaml", "--port", "pty:"],
    ("serve", 2): ["m.device.yaml", "--port", "tcp://127.0.0.1:0", "--station", "999"],
    ("serve", 3): ["m.device.yaml", "--port", "tcp://192.0.2.1:1"],
    ("monitor", 1): ["bad.yaml", "--port", GONE],
    ("monitor", 2): ["own.yaml", "--port", GONE, "--speed", "0"],
    ("monitor", 3): ["own.yaml", "--port", GONE],
    ("record", 1): [GONE, "-o", "none/line.jsonl"],
    ("record", 2): [GONE, "--quiet"],
    ("record", 3): [GONE],
    ("guess", 1): ["names.csv"],
    ("guess", 2): ["none"],
    ("diff", 1): ["hex.txt", "names.csv"],
    ("diff", 2): ["hex.txt", "none"],
    ("replay", 1): ["hex.txt", "--port", GONE],
    ("replay", 2): ["none", "--port", GONE],
    ("replay", 3): ["seen.jsonl", "--port", GONE],
    ("loopback", 1): [GONE, "--speeds", "9600"],
    ("loopback", 2): ["sim:loop", "--speeds", "x"],
    ("history", 1): ["bad.run.yaml"],
    ("history", 2): ["none.run.yaml"],
    ("new", 1): ["protocol", "own", "-o", "hex.txt/own"],
    ("new", 2): ["protocol", "a b"],
    ("import", 1): ["x.proto"],
    ("import", 2): ["none.proto"],
    ("schema", 1): ["run", "-o", "hex.txt/run.json"],
    ("schema", 2): ["nothing"],
    ("completion", 1): ["bash"],
    ("completion", 2): ["cmd"],
}
"""(verb, exit code): a command that ends with this code.

`commreq` with 1 is tested in docs/cli/commreq.md and with the verb.
"""

WITH_JSON = {
    "encode", "decode", "read", "write", "call", "scan", "commreq", "run", "fleet", "serve", "monitor", "record",
    "guess", "diff", "replay",
}  # fmt: skip
"""Verbs with `--json` whose errors are objects. `check`, `test` and `loopback` print their findings as without it."""


def table() -> dict[str, dict[int, str]]:
    """Return the exit codes of each verb in the table of the page."""
    rows = re.findall(r"^\| `(\w+)` \| (.*) \| (.*)\|$", PAGE.read_text("utf-8"), re.M)
    return {verb: {code: text for code, text in ((1, one), (3, three)) if text.strip()} for verb, one, three in rows}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, "utf-8")
    event = {"event": "data", "time_ns": 1, "channel": 1, "direction": "out", "bytes": "01 02"}
    lines = ({"capture": "framekit", "version": 1}, event)
    (tmp_path / "seen.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines), "utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FRAMEKIT_CACHE", str(tmp_path.parent / "cache-of-statuses"))
    return tmp_path


def ended_with(words: list[str]) -> int:
    try:
        return main(words)
    except SystemExit as end:
        return int(end.code or 0)


def test_every_verb_stands_in_the_table_and_every_code_is_tried() -> None:
    assert list(table()) == list(VERBS)
    documented = {(verb, code) for verb, codes in table().items() for code in codes}
    tested = {(verb, code) for verb, code in CASES if code != 2}
    assert documented - tested == {("commreq", 1)}
    assert tested <= documented
    assert {verb for verb, code in CASES if code == 2} == set(VERBS)
    assert {kind.status for kind in (VerbError, WordsError, PortError)} == {1, 2, 3}


@pytest.mark.parametrize(("verb", "code"), CASES)
def test_verbs_end_with_these_codes(
    verb: str, code: int, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if (verb, code) == ("completion", 1):
        monkeypatch.setitem(sys.modules, "shtab", None)
    words = [verb, *CASES[verb, code], *(["--json"] if verb in WITH_JSON else [])]
    assert ended_with(words) == code
    output = capsys.readouterr()
    assert "Traceback" not in output.err
    if verb not in WITH_JSON:
        return
    errors = [record for record in map(json.loads, output.out.splitlines()) if "error" in record]
    assert len(errors) == 1
    assert errors[0]["message"] in output.err
    if code == 2:
        assert errors[0]["error"] in ("command_line", "definition")
    elif CASES[verb, code][0] == "bad.yaml":
        assert (errors[0]["error"], errors[0]["problems"][0]["line"]) == ("definition", 2)


def test_a_word_that_no_verb_knows_is_an_object_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert ended_with(["read", "modbus-tcp", "--jsn", "--json", "--port", GONE, "40001"]) == 2
    error = json.loads(capsys.readouterr().out)
    assert error == {
        "error": "command_line",
        "message": "there is no option '--jsn' – did you mean '--json' or '--own'?",
    }

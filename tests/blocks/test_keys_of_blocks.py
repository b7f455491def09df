"""Every key of a block with every instruction: the key has an effect, or an error is reported."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from framekit.runfile.run_file import read_run

SCHEMA = Path(__file__).parents[2] / "schemas" / "run.schema.json"
KEYS = json.loads(SCHEMA.read_text(encoding="utf-8"))["$defs"]["block"]["properties"].keys()

BASE = {
    "read": "read: M0, into: M300, channel: 2",
    "write": "write: M0, from: M0, channel: 2",
    "send": "send: WR.REQ, data: {payload: M0}, channel: 1",
    "receive": "receive: RD.DATA, data: {payload: M100}, channel: 1",
    "call": "call: loopback, channel: 4",
    "command": "command: M400, channel: 3",
}
VALUES = {
    "job": "1", "report": "M1", "abort": "1", "inspect": "1", "host": "10.0.0.1", "times": "1", "late": "1 s",
    "status": "M10", "with": "{data: 1}", "station": "1", "type": "word", "count": "1", "into": "M500", "from": "M500",
    "data": "{payload: M0}", "size": "{payload: 32}", "values": "{payload: 1}", "every": "1 s", "phase": "1 s",
    "when": "M1 == 1", "while": "M1 == 1", "on_change": "M1", "words": "1", "once": "yes", "after": "1 s",
    "unless": "M1 == 1", "repeat": "1", "priority": "1", "retries": "1", "timeout": "1 s", "params": "{}",
    "merge": "no", "addresses": "[M0]", "enabled": "no", "commands": "commreq-ccm", "fault": "M00201", "name": "some",
    "about": "some",
}  # fmt: skip
ALL = {"name", "about", "unless", "repeat", "enabled"}
STARTED = {*ALL, "every", "when", "while", "on_change", "once", "after", "priority", "params"}
ASKING = {*STARTED, "station", "retries", "timeout"}
EFFECT = {
    "read": {*ASKING, "type", "count", "merge"},
    "write": {*ASKING, "type", "count"},
    "send": {*STARTED, "size", "values"},
    "receive": {*ALL, "size"},
    "call": {*ASKING, "with", "from", "into", "size", "addresses", "type", "count"},
    "command": {*ASKING, "commands", "fault"},
}
HEAD = """run: keys
memory: masterlogic
commands: commreq-ccm
channels:
  1: {port: /dev/ttyS1, protocol: third-party-plc}
  2: {port: /dev/ttyS2, protocol: mldp, station: 2}
  3: {port: /dev/ttyS3, protocol: ccm, station: 1, own: 5}
  4: {port: /dev/ttyS4, protocol: modbus-rtu, station: 1}
blocks:
"""


@pytest.mark.parametrize("instruction", BASE)
def test_a_key_has_an_effect_or_is_told(instruction: str, tmp_path: Path) -> None:
    base = BASE[instruction]
    used = {part.partition(":")[0].strip() for part in base.split(", ")}
    keys = [key for key in KEYS if key not in used and key not in BASE]
    started = "" if instruction == "receive" else ", once: yes"
    starts = ["" if key == "once" else started for key in keys]
    lines = [f"  {at}: {{{base}{starts[at]}, {key}: {VALUES[key]}}}\n" for at, key in enumerate(keys)]
    path = tmp_path / "keys.run.yaml"
    path.write_text(HEAD + "".join(lines), encoding="utf-8")
    first = HEAD.count("\n") + 1
    messages: dict[str, list[str]] = {}
    for problem in read_run(path).problems:
        if not problem.warning and " already" not in problem.what:
            messages.setdefault(keys[problem.at.line - first], []).append(problem.what)
    assert {key: messages.get(key) for key in keys if key not in EFFECT[instruction] and key not in messages} == {}
    in_vain = {key: what for key, what in messages.items() if any("has no effect" in message for message in what)}
    assert in_vain.keys().isdisjoint(EFFECT[instruction])

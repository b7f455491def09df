"""Completions of the editor: keys and words of the schemas, names of the file, also in texts that are not yet YAML."""

from __future__ import annotations

from pathlib import Path

import pytest
from extras.web.edit_world import LAMP, answer_of, written

SEQUENCE = """
sequences:
  ask_lamp:
    steps:
      - step: first
        send: SWITCH
        receive:
          - {frame: STATE, then: second}
        on_timeout: resend
      - step: second
"""


def offered(path: Path, text: str) -> list[str]:
    """Return the words offered at the sign § in a text."""
    before, _, after = text.partition("§")
    found = answer_of("complete", path, before + after, offset=len(before.encode("utf-16-le")) // 2)
    return [word for word, _, _ in found["words"]]


@pytest.fixture
def lamp(tmp_path: Path) -> Path:
    return written(tmp_path)


@pytest.mark.parametrize(
    ("text", "first", "without"),
    [
        ("pro§", ["protocol"], "frames"),
        ("protocol: a\nfra§\n", ["frames", "framekit"], "protocol"),
        ("protocol: a\nframes:\n  A:\n    §\n", ["group", "from"], "protocol"),
        ("protocol: a\nframes:\n  A:\n    from: §\n", ["client", "server", "both", "none"], "from"),
        ("protocol: a\nframes:\n  A:\n    body:\n      - {fie§}\n", ["field"], "type"),
        ("protocol: a\nframes:\n  A:\n    body:\n      - {field: x, §}\n", ["type"], "field"),
        ("protocol: a\nframes:\n  A:\n    body:\n      - {field: x, ty§\n  B: {}\n", ["type"], "field"),
        ("protocol: a\nframes:\n  A:\n    body:\n      - {field: x, type: u1§}\n", ["u16"], "f32"),
        ("protocol: a\nframes:\n  A:\n    body:\n      - {check: crc16-mod§}\n", ["crc16-modbus"], "sum8"),
        ("protocol: a\nline: {ki§nd: serial}\n", ["kind"], "speed"),
        ("run: a\nchannels:\n  1:\n    po§\n", ["port"], "protocol"),
        ("run: a\nblocks:\n  1: {wri§}\n", ["write"], "read"),
        ("run: a\nblocks:\n  1: {read: M1, eve§}\n", ["every"], "write"),
        ("device: a\nbehave:\n  M1: {sin§}\n", ["sine"], "ramp"),
        ("points: a\nvalues:\n  x: {typ§}\n", ["type"], "address"),
    ],
)  # fmt: skip
def test_words_of_the_schemas(lamp: Path, text: str, first: list[str], without: str) -> None:
    words = offered(lamp, text)
    assert words[: len(first)] == first
    assert without not in words


def test_what_a_word_means_and_inserts(lamp: Path) -> None:
    text = "protocol: a\nframes:\n  A:\n    fro"
    found = answer_of("complete", lamp, text, offset=len(text))
    assert found == {
        "from": len(text) - 3, "words": [["from", "Who sends it: client, server, both, or none.", "from: "]]
    }  # fmt: skip


@pytest.mark.parametrize(
    ("place", "names"),
    [
        ("        send: §", ["SWITCH", "STATE"]),
        ("        send: {§}", ["SWITCH", "STATE"]),
        ("        receive:\n          - {frame: §}", ["SWITCH", "STATE"]),
        ("        call: §", ["ask_lamp"]),
        ("        then: §", ["next", "end", "again", "restart", "resend", "first", "second"]),
    ],
)
def test_names_of_the_file(lamp: Path, place: str, names: list[str]) -> None:
    words = offered(lamp, LAMP + SEQUENCE + place + "\n")
    assert [word for word in words if word in names] == names


def test_names_of_bases_and_of_protocols(lamp: Path, tmp_path: Path) -> None:
    path = written(tmp_path, "", "hall.run.yaml")
    run = 'run: hall\nchannels:\n  1: {port: "sim:x", protocol: lamp.yaml}\n'
    assert offered(path, run + "blocks:\n  1: {send: §}\n") == ["SWITCH", "STATE"]
    assert offered(path, run + "blocks:\n  1: {read: M1, channel: §}\n") == ["1"]
    assert "lamp.yaml" in offered(path, "run: hall\nchannels:\n  1: {protocol: §}\n")
    assert "modbus-rtu" in offered(path, "run: hall\nchannels:\n  1: {protocol: mod§}\n")
    base = "protocol: other\nextends: lamp\nsequences: {a: {steps: [{step: x, send: §}]}}\n"
    assert "SWITCH" in offered(written(tmp_path, "", "other.yaml"), base)


@pytest.mark.parametrize(
    "text", ["protocol: a # fr§", "protocol: 'a§'", 'protocol: "a§', "[[[[ {{§", "a: b: c§: d", "\t§", "§" * 2]
)
def test_where_no_word_fits_none_is_offered_or_words_of_the_start(lamp: Path, text: str) -> None:
    assert set(offered(lamp, text)) <= {"protocol", "application"}


def test_offsets_count_as_a_browser_does(lamp: Path) -> None:
    assert offered(lamp, "protocol: a\nabout: 😀😀\nfram§") == ["frames", "framekit"]


def test_a_prefix_comes_before_other_matches(lamp: Path) -> None:
    words = offered(lamp, "protocol: a\nframes:\n  A:\n    body:\n      - {field: x, type: 16§}\n")
    assert {"u16", "i16"} <= set(words) and all("16" in word for word in words)

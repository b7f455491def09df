"""Colours and progress lines: shown on terminals only."""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from framekit.cli.common import ProgressLine, has_colours, json_line, painted
from framekit.cli.main import main
from framekit.cli.terminal import harmless

OWN = "protocol: own\nline: {kind: stream}\nframes:\n  one: {body: [{const: 01}, {field: value, type: u8}]}\n"
CASES = "vectors: own\nframes:\n  - {frame: one, bytes: 01 02, values: {value: 2}}\n"


class Terminal(io.StringIO):
    """A stream that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


# ---- colours ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "coloured"),
    [({}, True), ({"NO_COLOR": "1"}, False), ({"NO_COLOR": ""}, True), ({"TERM": "dumb"}, False)],
)
def test_colours_on_a_terminal(settings: Mapping[str, str], coloured: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    assert has_colours(Terminal()) is coloured
    assert not has_colours(io.StringIO())
    assert painted("bad", "red", Terminal()) == ("\x1b[31mbad\x1b[0m" if coloured else "bad")
    assert painted("bad", "red", io.StringIO()) == painted("bad", None, Terminal()) == "bad"


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_verbs_have_colours_on_a_terminal_and_nowhere_else(
    stream: type[io.StringIO], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.yaml").write_text(OWN, "utf-8")
    (tmp_path / "own.vectors.yaml").write_text(CASES, "utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    output, errors = stream(), stream()
    with redirect_stdout(output), redirect_stderr(errors):
        assert (main(["test", "own.yaml"]), main(["decode", "own.yaml", "02"])) == (0, 1)
    text, error_text = output.getvalue(), errors.getvalue()
    if stream is Terminal:
        assert "\x1b[32mok      \x1b[0mframe: one" in text
        assert "\x1b[31mframekit decode\x1b[0m: no frame fits" in error_text
    else:
        assert "ok      frame: one" in text
        assert "\x1b" not in text + error_text


# ---- how far it is ----------------------------------------------------------------------------------------------


def test_long_work_has_a_line_that_goes_when_it_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    terminal, reported = Terminal(), threading.Event()

    def says() -> str:
        reported.set()
        return "7 of 9 cases"

    with ProgressLine("test", says, stream=terminal, after=0):
        assert reported.wait(60)
    lines = terminal.getvalue().split("\r")
    assert "test: 0 s, 7 of 9 cases" in lines
    assert lines[-1] == "" and lines[-2].isspace()
    assert "\n" not in terminal.getvalue()


def test_short_work_has_none_and_no_other_stream_has_one(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal, pipe = Terminal(), io.StringIO()
    monkeypatch.setenv("TERM", "xterm")
    with ProgressLine("test", stream=terminal):
        pass
    monkeypatch.setenv("TERM", "dumb")
    with ProgressLine("test", stream=terminal, after=0), ProgressLine("test", stream=pipe, after=0):
        assert not [thread for thread in threading.enumerate() if thread.name == "tells how far it is"]
    assert terminal.getvalue() == pipe.getvalue() == ""


def test_cases_tell_how_many_are_done(tmp_path: Path) -> None:
    from framekit.api.vectors import run_vectors

    (tmp_path / "own.yaml").write_text(OWN, "utf-8")
    (tmp_path / "own.vectors.yaml").write_text(CASES + CASES.splitlines()[2] + "\n", "utf-8")
    counts: list[tuple[int, int]] = []
    assert len(run_vectors(tmp_path / "own.yaml", None, lambda done, of: counts.append((done, of)))) == 2
    assert counts == [(1, 2), (2, 2)]


# ---- text of devices and files --------------------------------------------------------------------------------------

EVIL = "\x1b]0;owned\x07\x9b2J\r\u202e"
SHOWN = r"\x1b]0;owned\x07\x9b2J\r\u202e"
DEVICE = """device: t
protocol: modbus-tcp
station: 1
memory: {set: {"40001": [0x1b5d, 0x303b, 0x7077, 0x6e07, 0x0d00]}}
"""
RUN = """run: t
channels:
  1: {port: "sim:t.device.yaml", protocol: modbus-tcp, station: 1}
points:
  esc: {channel: 1, address: "40001", type: string, size: 10}
sinks:
  - {sqlite: t.db}
"""


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_text_of_a_device_is_shown_and_never_obeyed(
    stream: type[io.StringIO], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "t.device.yaml").write_text(DEVICE, "utf-8")
    (tmp_path / "t.run.yaml").write_text(RUN, "utf-8")
    monkeypatch.chdir(tmp_path)
    output = stream()
    with redirect_stdout(output), redirect_stderr(output):
        station = ["--port", "sim:t.device.yaml", "--station", "1"]
        main(["read", "modbus-tcp", *station, "40001", "--type", "string", "-n", "10"])
        main(["run", "t.run.yaml", "--virtual", "--for", "3s"])
        main(["history", "t.run.yaml"])
    text = output.getvalue()
    assert text.count(r"\x1b]0;pwn\x07\r") == 3, text
    assert not set(text) & set("\x1b\x07\r"), text


@pytest.mark.parametrize("verb", ["check", "decode", "monitor"])
def test_no_text_of_a_command_line_or_a_file_reaches_a_terminal_raw(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    output = Terminal()
    with redirect_stdout(output), redirect_stderr(output):
        more = {"decode": ["00"], "monitor": ["--port", "x"]}.get(verb, [])
        main([verb, f"{EVIL}.yaml", *more])
    assert SHOWN in output.getvalue()
    assert not set(output.getvalue()) & set("\x07\x9b\r\u202e"), output.getvalue()


def test_a_guarded_terminal_keeps_lines_spaces_and_own_colours() -> None:
    kept = "one\ttwo\nthree\u00a0four \x1b[31mred\x1b[0m é 中"
    assert harmless(kept) == kept
    assert harmless(EVIL) == SHOWN
    assert harmless("\x1b[5mblink\x1b[2J") == r"\x1b[5mblink\x1b[2J"


def test_json_is_of_visible_characters_and_the_same_value() -> None:
    line = json_line({EVIL: ["\ud800", "\U000e0041", "é"]})
    assert line.isprintable() and json.loads(line) == {EVIL: ["\ud800", "\U000e0041", "é"]}

"""`framekit run` shows values: a line per change, a table on a terminal, and frames only on request."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from framekit import VirtualRun
from framekit.api.run import loaded
from framekit.cli.common import table
from framekit.cli.live_output import QueuedStream
from framekit.cli.main import main
from framekit.cli.run_output import TextOutput
from framekit.cli.run_values import TABLE_HEAD, ValueChanges, ValueTable, _fitting, draws
from framekit.cli.terminal import GuardedTerminal
from framekit.link.events import Seen

DEVICE = """device: tank
protocol: modbus-rtu
station: 1
memory: {set: {40001: [215, 3, 7]}}
behave:
  "40001": {counter: 1, start: 21.5, every: 1 s, type: int16, scale: 0.1}
faults: {rules: [{fault: no_reply, from: 1500 ms, until: 2600 ms}]}
"""
RUN = """run: tank
memory: masterlogic
channels:
  1: {port: "sim:tank.device.yaml", protocol: modbus-rtu, station: 1, timeout: 100 ms, retries: 0}
"""
POINTS = """points:
  level: {channel: 1, address: "40001", scale: 0.1, unit: cm, decimals: 2}
  state: {channel: 1, address: "40002", enum: {3: "on"}}
"""
BLOCKS = """blocks:
  0: {read: "40001", count: 3, into: M100, every: 1 s}
  1: {write: "40010", from: M200, every: 1 s}
"""


@pytest.fixture
def tank(tmp_path: Path) -> Callable[[str], Path]:
    def written(more: str) -> Path:
        (tmp_path / "tank.device.yaml").write_text(DEVICE, encoding="utf-8")
        (tmp_path / "tank.run.yaml").write_text(RUN + more, encoding="utf-8")
        return tmp_path / "tank.run.yaml"

    return written


def lines(capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> list[str]:
    assert main(["run", *words]) == status
    return capsys.readouterr().out.splitlines()


def test_a_line_for_each_change_of_a_point(tank: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    shown = lines(capsys, str(tank(POINTS)), "--virtual", "--for", "3500ms")
    changes = [line.split(maxsplit=1)[1] for line in shown[: shown.index("")]]
    assert changes[:4] == ["ch 1   open", "level  21.50 cm", "state  on", "level  22.50 cm"]
    (failure,) = [line for line in changes if "failed" in line]
    assert failure == "level, state  failed: no_reply"
    assert changes[-2:] == ["level  24.50 cm", "state  on"]
    assert not any("_adu" in line for line in shown)
    assert "level  24.50  cm    good" in shown


def test_a_run_without_points_shows_the_data_of_its_blocks(
    tank: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    shown = lines(capsys, str(tank(BLOCKS)), "--virtual", "--for", "3500ms")
    changes = [line.split(maxsplit=1)[1] for line in shown[1 : shown.index("")]]
    assert changes[:2] == ["READ 40001   M100 00E1 0003 0007", "WRITE 40010  done"]
    assert changes[2:4] == ["READ 40001   failed: no_reply", "WRITE 40010  failed: no_reply"]
    assert changes[4] == "READ 40001   M100 00F5 0003 0007"


def test_the_same_as_json(tank: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    shown = [json.loads(line) for line in lines(capsys, str(tank(POINTS)), "--virtual", "--for", "1500ms", "--json")]
    values = [line for line in shown if line["event"] == "value"]
    assert values[0] | {"time": 0} == {
        "event": "value", "time": 0, "point": "level", "value": 21.5, "unit": "cm", "quality": "good", "reason": "",
    }  # fmt: skip
    assert "frame" not in {line["event"] for line in shown}
    shown = [json.loads(line) for line in lines(capsys, str(tank(BLOCKS)), "--virtual", "--for", "1200ms", "--json")]
    (first, *_) = [line for line in shown if line["event"] == "value"]
    assert (first["block"], first["stored"], first["quality"]) == (0, {"M100": "00E1 0003 0007"}, "good")


def test_frames_are_shown_with_the_values_in_the_order_of_time(
    tank: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    shown = lines(capsys, str(tank(POINTS)), "--virtual", "--for", "1200ms", "--frames")
    events = shown[: shown.index("")]
    times = [float(line.split()[0]) for line in events]
    assert times == sorted(times)
    request, reply, value = (next(n for n, line in enumerate(events) if what in line) for what in ("→", "←", "level"))
    assert request < reply < value


def test_quiet_shows_nothing_but_trouble(tank: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert lines(capsys, str(tank(POINTS)), "--virtual", "--for", "3s", "--quiet") == []
    shown = lines(capsys, str(tank(POINTS)), "--virtual", "--for", "3s", "--quiet", "--json")
    assert {json.loads(line)["event"] for line in shown} <= {"run_trouble"}


def test_values_of_an_edited_run(tank: Callable[[str], Path]) -> None:
    path = tank(BLOCKS)
    with VirtualRun(path) as run:
        changes = ValueChanges(run, lambda block: block.what, lambda: None)
        path.write_text(RUN + BLOCKS + '  2: {read: "40002", into: M300, every: 100 ms}\n', encoding="utf-8")
        run.edit(loaded(path), lambda edit: changes.know(edit.run))
        run.run_for("500 ms")
        assert any("M300 0003" in line for _, line in changes.lines(changes.take()))


class Terminal(io.StringIO):
    """A terminal that keeps the written text."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def test_the_table_is_drawn_in_place_and_lines_are_printed_above(
    tank: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("LINES", "6")
    terminal = Terminal()
    stream = QueuedStream(GuardedTerminal(terminal), "standard output", lambda number, reason: "", None)  # type: ignore[arg-type]
    drawings: list[list[str]] = []
    monkeypatch.setattr(stream, "draw", drawings.append)
    with VirtualRun(tank(POINTS)) as run:
        changes = ValueChanges(run, lambda block: block.what, lambda: None)
        ValueTable(run, changes, stream)
        run.run_for("2400 ms")
    title, blank, head, row, more = drawings[-1]
    assert (title, blank) == ("run tank, 2 s – Ctrl-C ends it", "")
    assert head.split() == ["point", "value", "unit", "quality", "changed"]
    assert row.split() == ["level", "22.50", "cm", "failed:", "no_reply", "0", "s", "ago"]
    assert more == "… and 1 more point: --screen shows all"


def test_a_long_reason_leaves_room_for_the_other_columns() -> None:
    row = ("level", "-", "cm", f"failed: {'no connection ' * 20}", "12 s ago")
    fitted, good = _fitting([row, ("state", "on", "", "good", "1 s ago")], 60)
    assert good == ("state", "on", "", "good", "1 s ago")
    assert len(table([fitted, good], TABLE_HEAD).split("\n")[1]) == 60
    assert fitted[3].endswith("…") and fitted[4] == "12 s ago"
    assert _fitting([row], 20)[0][3] == "failed: no …"


def test_the_same_failure_to_open_a_port_is_one_line(
    tank: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    output = TextOutput(loaded(tank(POINTS)))
    with VirtualRun(tank(POINTS)) as run:
        output.watches(run)
        take = output.tape.of(1)
        for kind, reason in (("closed", "a"), ("closed", "a"), ("open", ""), ("closed", "a"), ("closed", "b")):
            take(Seen("", kind, run.now, reason=reason))
            output.catch_up()
    shown = [line.split()[3:] for line in capsys.readouterr().out.splitlines()]
    assert shown == [["closed", "a"], ["open"], ["closed", "a"], ["closed", "b"]]


def test_a_drawing_is_replaced_and_makes_room_for_lines() -> None:
    terminal = Terminal()
    stream = QueuedStream(GuardedTerminal(terminal), "standard output", lambda number, reason: "", None)  # type: ignore[arg-type]
    stream.write("begin\n")
    for step in (
        lambda: stream.draw(["a", "b"]),
        lambda: stream.write("hostile \x1b[2J\n"),
        lambda: stream.draw(["c"]),
    ):
        with stream._queue.change:
            assert stream._queue.change.wait_for(lambda: not stream._queue.waiting, 60)
        step()
    stream.close()
    on, off = "\x1b[?7l", "\x1b[?7h"
    assert terminal.getvalue() == (f"begin\n{on}a\r\nb\r\n{off}\r\x1b[2A\x1b[Jhostile \\x1b[2J\n{on}c\r\n{off}")


@pytest.mark.parametrize(("term", "expected"), [("xterm", True), ("dumb", False)])
def test_which_terminals_draw(monkeypatch: pytest.MonkeyPatch, term: str, expected: bool) -> None:
    monkeypatch.setenv("TERM", term)
    assert draws(Terminal()) is expected
    assert draws(io.StringIO()) is False


def test_the_demonstration(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--fast"]) == 0
    out = capsys.readouterr().out
    assert "setpoint  62.5 °C" in out
    assert "failed: no_reply" in out and out.rindex("flow") > out.index("failed")
    assert out.count("field  ") == 3 and out.count("check  ") == 3
    run, read, help_ = (line.split()[1:] for line in out.partition("Try next:\n")[2].splitlines()[1::2])
    assert main([*run, "--virtual", "--for", "2s"]) == 0
    assert main(read) == 0
    with pytest.raises(SystemExit, match="0"):
        main(help_)

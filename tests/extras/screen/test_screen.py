"""The live display, driven by textual's own pilot on simulated time, and once as a process in a terminal."""

from __future__ import annotations

import argparse
import asyncio
import errno
import shutil
import subprocess
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from framekit.api.monitor import FrameFilter, parse_filter
from framekit.cli.main import main
from framekit.cli.parser import build_parser
from framekit.cli.run_verb import RunSession, RunWatch
from framekit.cli.serve_verb import ServeSession, server_of
from framekit.link.events import Kind, Seen
from framekit.runfile.run_file import load_run
from framekit.sinks.files import LinesFile
from framekit.transport.pty_port import PtyPair

pytest.importorskip("textual")

from textual.events import Key
from textual.pilot import Pilot
from textual.widgets import DataTable, Input, Static
from textual.widgets.data_table import RowKey

from framekit.extras.screen.app import MonitorApp

EXAMPLES = Path(__file__).parents[3] / "examples"
SECOND = 1_000_000_000
PLC = EXAMPLES / "third-party-plc.run.yaml"


class Stepped(RunSession):
    """A run session whose simulated time moves only when the test says so."""

    def step(self, duration: int) -> None: ...

    def forward(self, duration: int) -> None:
        super().step(duration)


def arguments(*words: str, run: Path = PLC) -> argparse.Namespace:
    return build_parser("run").parse_args(["run", str(run), "--virtual", "--screen", *words])


def driven(
    test: Callable[[MonitorApp, Stepped, Pilot[None]], Coroutine[Any, Any, None]], *words: str, run: Path = PLC
) -> Stepped:
    """Run `test` on the app with a run in it."""
    given = arguments(*words, run=run)
    session = Stepped(load_run(run), RunWatch(given), virtual=True, duration=None, controlled=given.control)

    async def drive() -> None:
        app = MonitorApp(session)
        async with app.run_test(size=(140, 45)) as pilot:
            await test(app, session, pilot)

    asyncio.run(drive())
    return session


def column(app: MonitorApp, number: int) -> list[str]:
    table = app.frames
    return [str(table.get_row_at(row)[number]) for row in range(table.row_count)]


def text_of(app: MonitorApp, name: str) -> str:
    return str(app.query_one(name, Static).render())


def test_frames_blocks_and_load_of_a_run() -> None:
    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(3 * SECOND)
        app.draw()
        app.draw_status()
        await pilot.pause()
        frames = column(app, 6)
        assert "WR.REQ" in frames
        assert "RD.DATA" in frames
        assert set(column(app, 5)) == {"", "user-defined"}
        assert app.blocks.row_count == 3
        assert "ch 1 third-party-plc" in text_of(app, "#channels")
        assert "%" in text_of(app, "#channels")
        done = int(str(app.blocks.get_row_at(0)[5]))
        session.forward(3 * SECOND)
        app.draw_status()
        assert int(str(app.blocks.get_row_at(0)[5])) == done + 3

    session = driven(test)
    assert session.run is not None
    assert not session.run.running


POINTS = """run: meter
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
points:
  level: {channel: 1, address: "40001", unit: "[mm]", every: 1s}
  limit: {channel: 1, address: "40002", every: 1s}
"""
METER = """device: meter
protocol: modbus-tcp
station: 1
memory: {set: {"40002": [7]}}
behave: {"40001": {counter: 1}}
"""


def test_points_with_value_unit_and_quality(tmp_path: Path) -> None:
    (tmp_path / "meter.device.yaml").write_text(METER, "utf-8")
    (tmp_path / "meter.run.yaml").write_text(POINTS, "utf-8")

    def rows(app: MonitorApp) -> list[list[str]]:
        return [[str(cell) for cell in app.points.get_row_at(row)] for row in range(app.points.row_count)]

    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(SECOND // 2)
        app.draw_status()
        before = rows(app)
        assert [row[0] for row in before] == ["level", "limit"]
        assert before[1] == ["limit", "7", "", "good"]
        session.forward(10 * SECOND)
        app.draw_status()
        after = rows(app)
        assert int(after[0][1]) == int(before[0][1]) + 10
        assert after[0][2:] == ["[mm]", "good"]
        assert app.points.display

    driven(test, run=tmp_path / "meter.run.yaml")


def test_a_sink_that_cannot_write_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "meter.device.yaml").write_text(METER, "utf-8")
    (tmp_path / "meter.run.yaml").write_text(f"{POINTS}sinks: [{{csv: a.csv, every: 1 s}}]\n", "utf-8")

    def full(file: int, size: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(SECOND // 2)
        monkeypatch.setattr(LinesFile, "_put", full)
        session.forward(2 * SECOND)
        app.draw_status()
        await pilot.pause()
        assert f"! sink csv {tmp_path}/a.csv: No space left on device" in text_of(app, "#channels")
        monkeypatch.undo()
        session.forward(2 * SECOND)
        app.draw_status()
        await pilot.pause()
        assert "!" not in text_of(app, "#channels")

    driven(test, run=tmp_path / "meter.run.yaml")


def test_pause_and_going_on() -> None:
    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(SECOND)
        app.draw()
        count = app.frames.row_count
        assert count
        await pilot.press("space")
        session.forward(3 * SECOND)
        app.draw()
        assert app.frames.row_count == count
        assert "paused" in text_of(app, "#channels")
        await pilot.press("space")
        app.draw()
        assert app.frames.row_count > count
        numbers = [int(number) for number in column(app, 0)]
        assert numbers == list(range(1, len(numbers) + 1))  # no value was lost meanwhile

    driven(test)


def test_hex_and_ascii() -> None:
    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(SECOND)
        app.draw()
        assert any("57 52 34 34" in cell for cell in column(app, 7))
        await pilot.press("x")
        assert any("WR44" in cell for cell in column(app, 7))
        await pilot.press("x")
        assert any("57 52 34 34" in cell for cell in column(app, 7))

    driven(test)


@pytest.mark.long
def test_a_filter_and_its_end() -> None:
    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(5 * SECOND)
        app.draw()
        everything = app.frames.row_count
        await pilot.press("slash")
        app.query_one("#filter", Input).value = "ch:1 frame:rd.d"
        await pilot.press("enter")
        assert set(column(app, 6)) == {"RD.DATA"}
        session.forward(SECOND)
        app.draw()
        assert set(column(app, 6)) == {"RD.DATA"}
        await pilot.press("slash")
        await pilot.press("escape")
        assert app.filter_text == ""
        assert app.frames.row_count > everything
        await pilot.press("b")
        assert app.frames.row_count == 0  # no bad frame in this run
        assert "bad only" in text_of(app, "#channels")

    driven(test)


def test_a_run_is_controlled_by_a_key() -> None:
    async def command(app: MonitorApp, pilot: Pilot[None], text: str) -> None:
        await pilot.press("colon")
        app.query_one("#command", Input).value = text
        await pilot.press("enter")

    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(SECOND)
        assert session.run is not None
        first = session.run.blocks[0].id
        await command(app, pilot, f"disable {first}")
        assert not session.run.blocks[0].enabled
        await command(app, pilot, "fire 99")
        assert "there is no block 99" in text_of(app, "#about")
        assert not app.query_one("#command", Input).display and app.frames.has_focus
        await pilot.press("colon")
        await pilot.press("escape")
        assert not app.query_one("#command", Input).display and not session.is_over
        await command(app, pilot, "stop")
        assert session.is_over

    driven(test, "--control")


@pytest.mark.long
def test_brackets_from_the_line_and_from_people_are_no_markup() -> None:
    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(SECOND)
        app.draw()
        assert app.view is not None
        number = app.view.log.last_number
        seen = app.view.log.entry(number)
        assert seen is not None
        kinds: list[tuple[Kind, bytes]] = [("noise", b"[/x] [bold]y"), ("bad", b"[/x]")]
        for kind, raw in kinds:
            at = Seen(seen.seen.direction, kind, seen.seen.at, raw, reason="[/x]")
            app.view.log.add(seen.channel, at)
        await pilot.press("x")
        app.draw()
        await pilot.pause()
        assert column(app, 7)[-2:] == ["[/x] [bold]y", "[/x]"]
        assert "[/x]" in text_of(app, "#about")
        for key, name, text in (("slash", "#filter", "[/x]"), ("colon", "#command", "fire [/x]")):
            await pilot.press(key)
            app.query_one(name, Input).value = text
            await pilot.press("enter")
            await pilot.pause()
        assert "filter [/x]" in text_of(app, "#channels")
        assert "'fire [/x]' is no command" in text_of(app, "#about")

    driven(test, "--control")


def everything_that_comes(app: MonitorApp) -> list[Callable[[], object]]:
    """Return the calls of timers, messages and keys."""
    frames = app.frames
    highlighted = DataTable.RowHighlighted(frames, 0, RowKey("1"))
    submitted = [Input.Submitted(entry, "x") for entry in (app.filter_entry, app.command_entry)]
    return [
        app.go_on, app.draw, app.draw_status, app.refill, lambda: app.show_fields(1),
        lambda: app.on_data_table_row_highlighted(highlighted), lambda: app.on_key(Key("escape", None)),
        *(getattr(app, f"action_{name}") for name in ("pause", "switch_bytes", "bad_only", "follow", "find")),
        app.action_command,
        *(lambda text=text: app.on_input_submitted(text) for text in submitted),
    ]  # fmt: skip


@pytest.mark.long
def test_what_comes_while_the_widgets_go_one_by_one_does_not_end_the_display() -> None:
    kept: list[MonitorApp] = []

    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(SECOND)
        kept.append(app)
        for name in ("#channels", "#about", "#fields", "#blocks", "#filter", "#command", "#frames"):
            await app.query(name).remove()
            for call in everything_that_comes(app):
                call()
            session.forward(SECOND)

    driven(test, "--control")
    assert not kept[0].is_running
    drawn = kept[0]._drawn
    kept[0].go_on()
    assert kept[0]._drawn == drawn, "nothing is drawn any more, and no time passes"


def test_without_control_there_is_no_key_for_it() -> None:
    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        await pilot.press("colon")
        assert not app.query_one("#command", Input).display

    driven(test)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pretend that the output is a terminal."""
    monkeypatch.setattr("framekit.extras.screen.display.has_terminal", lambda: True)


def test_a_port_that_is_none_is_told(terminal: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "mldp", "--port", "nowhere:1", "--screen"]) == 2
    assert "is no port" in capsys.readouterr().err


@pytest.mark.long
def test_the_fields_of_the_selected_frame() -> None:
    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(SECOND)
        app.draw()
        await pilot.pause()
        place = column(app, 6).index("WR.REQ")
        app.frames.move_cursor(row=place)
        await pilot.pause()
        assert "WR.REQ" in text_of(app, "#about")
        rows = [list(map(str, app.fields.get_row_at(row))) for row in range(app.fields.row_count)]
        assert any(row[0] == "payload" and row[1] == "5" for row in rows)

    driven(test)


def test_a_capture_beside_the_display(tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"

    async def test(app: MonitorApp, session: Stepped, pilot: Pilot[None]) -> None:
        session.forward(SECOND)

    driven(test, "--capture", str(path))
    assert path.stat().st_size > 100


def test_the_syntax_of_filters() -> None:
    assert parse_filter("ch:2 frame:read 12 34", True) == FrameFilter(2, "read", True, "12 34")
    assert parse_filter("ch:x", False) == FrameFilter(None, "", False, "ch:x")


def test_without_textual_it_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "framekit.extras.screen.app", raising=False)
    monkeypatch.setitem(sys.modules, "textual.app", None)
    assert main(["run", str(PLC), "--virtual", "--screen"]) == 1
    assert "install framekit with the extra 'screen': pip install '.[screen]'" in capsys.readouterr().err


def test_a_port_that_is_not_there(terminal: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "r.run.yaml").write_text(
        "run: r\nmemory: masterlogic\nblocks: {}\n"
        "channels:\n  1: {port: 'tcp://nowhere:99999', protocol: mldp, station: 1}\n"
    )
    assert main(["run", str(tmp_path / "r.run.yaml"), "--screen"]) == 1
    assert capsys.readouterr().err


@pytest.mark.long
def test_without_a_terminal_it_says_so(tmp_path: Path) -> None:
    """Files and pipes get no escape codes."""
    words = [sys.executable, "-m", "framekit", "run", str(PLC), "--virtual", "--screen"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    wanted = "framekit run: the live display wants a terminal, and this is none – leave --screen out\n"
    assert done.stderr == wanted


@pytest.mark.skipif(shutil.which("tmux") is None, reason="tmux is not installed")
def test_in_a_terminal(tmp_path: Path) -> None:
    """In tmux: it draws frames, and `q` ends it with status 0."""
    socket = str(tmp_path / "tmux")
    program = f"{sys.executable} -m framekit run {PLC} --virtual --screen; echo ended $? >{tmp_path}/end"

    def tmux(*words: str) -> str:
        return subprocess.run(["tmux", "-S", socket, *words], capture_output=True, text=True, check=True).stdout

    tmux("new-session", "-d", "-x", "140", "-y", "40", program + f"; tmux -S {socket} wait-for -S over")
    try:
        for _ in range(2000):
            if "WR.REQ" in (shown := tmux("capture-pane", "-p")):
                break
        assert "WR.REQ" in shown
        assert "third-party-plc" in shown
        tmux("send-keys", "q")
        tmux("wait-for", "over")
    finally:
        subprocess.run(["tmux", "-S", socket, "kill-server"], capture_output=True, check=False)
    assert (tmp_path / "end").read_text() == "ended 0\n"


def test_served_devices_are_shown_with_what_they_answer() -> None:
    async def drive(session: ServeSession, pair: PtyPair) -> None:
        app = MonitorApp(session)
        async with app.run_test(size=(140, 45)) as pilot:
            while not session.is_open:
                await pilot.pause()
            with open(pair.second, "r+b", buffering=0) as client:
                client.write(b"\x0501rSB06%MW10001\x0492")
                while app.frames.row_count < 3:  # the first row is the opening of the port
                    await pilot.pause()
            app.draw_status()
            assert column(app, 6)[:3] == ["open", "read_continuous", "read_continuous_reply"]
            assert "mldp server" in column(app, 5)
            assert "ch 1 mldp station 1" in text_of(app, "#channels")

    with PtyPair() as pair:
        words = ["serve", "mldp", "--station", "1", "--port", pair.first, "--screen"]
        given = build_parser("serve").parse_args(words)
        session = ServeSession(server_of(given), None)
        asyncio.run(drive(session, pair))
    assert session.server.done == 1
    assert session.problems == []


def test_a_port_that_cannot_be_had_ends_the_display() -> None:
    given = build_parser("serve").parse_args(["serve", "mldp", "--station", "1", "--port", "/dev/none", "--screen"])
    session = ServeSession(server_of(given), None)

    async def drive() -> None:
        app = MonitorApp(session)
        async with app.run_test() as pilot:
            while not session.is_over:
                await pilot.pause()

    asyncio.run(drive())
    assert "/dev/none" in str(session.failure)

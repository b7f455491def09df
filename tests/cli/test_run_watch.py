"""`framekit run --watch` as a process: edits are applied or refused, automatically or on SIGHUP; the run continues."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from framekit.api import run as api_run
from framekit.api.run import FileWatch, content_of
from framekit.api.run import loaded as load_run
from framekit.cli.common import reasons_of
from framekit.cli.main import main
from framekit.cli.run_output import TextOutput
from framekit.definition.problems import DefinitionError, Position, Problem
from framekit.run.model import RunModel

DEVICE = "device: one\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: [11, 12]}}\n"
RUN = """run: watched
memory: masterlogic
channels:
  1: {port: "sim:one.device.yaml", protocol: modbus-rtu, station: 1}
blocks:
  0: {read: "40001", into: M0, every: 50 ms}
"""


class Process:
    """A running `framekit run --watch --json` that ends with the test."""

    def __init__(self, path: Path, *options: str) -> None:
        command = [
            sys.executable,
            "-m",
            "framekit",
            "run",
            str(path),
            "--watch",
            "--json",
            "--frames",
            "--for",
            "60s",
            *options,
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def until(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        assert self.process.stdout is not None
        for text in self.process.stdout:
            if wanted(line := json.loads(text)):
                return line
        raise AssertionError("the run has ended")

    def event(self, kind: str) -> dict[str, Any]:
        return self.until(lambda line: line["event"] == kind)


def replace_file(path: Path, text: str) -> None:
    """Replace the file by a new file, like an editor does."""
    path.with_suffix(".new").write_text(text, encoding="utf-8")
    os.replace(path.with_suffix(".new"), path)


@pytest.mark.long
def test_edits_of_a_run_that_goes_on(tmp_path: Path) -> None:
    (tmp_path / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
    path = tmp_path / "watched.run.yaml"
    path.write_text(RUN, encoding="utf-8")
    run = Process(path)
    try:
        run.event("frame")
        replace_file(path, RUN + '  1: {read: "40002", into: M1, every: 50 ms}\n')
        run.process.send_signal(signal.SIGHUP)
        assert run.event("edited") == {"event": "edited", "what": "block 1 new"}
        replace_file(path, RUN.replace("into: M0", "into: Q0"))
        (reason,) = run.event("refused")["reasons"]
        assert reason.startswith(f"{path}:6:") and "Q0" in reason
        run.event("frame")
        replace_file(path, RUN.replace("50 ms", "40 ms"))
        assert run.event("edited")["what"] == "block 1 gone, block 0 changed"
        run.until(lambda line: line["event"] == "frame" and line["direction"] == "in")
        run.process.send_signal(signal.SIGTERM)
        assert run.event("block")["started"] > 0
        assert run.process.wait(20) == 0
    finally:
        run.process.kill()
        run.process.communicate()


@pytest.mark.long
def test_an_edit_that_could_write_is_refused_where_the_run_only_reads(tmp_path: Path) -> None:
    (tmp_path / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
    path = tmp_path / "watched.run.yaml"
    path.write_text(RUN, encoding="utf-8")
    run = Process(path, "--read-only")
    try:
        run.event("frame")
        replace_file(path, RUN + '  1: {write: "40002", from: M1, every: 50 ms}\n')
        run.process.send_signal(signal.SIGHUP)
        (reason,) = run.event("refused")["reasons"]
        assert reason.startswith(f"{path}:7:3: block 1 writes into the other side, and this run only reads")
        run.event("frame")
    finally:
        run.process.kill()
        run.process.communicate()


@pytest.mark.parametrize("options", [("--watch",), ()])
def test_hanging_up_ends_a_run_that_does_not_watch_its_file(tmp_path: Path, options: tuple[str, ...]) -> None:
    (tmp_path / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
    path = tmp_path / "watched.run.yaml"
    path.write_text(RUN, encoding="utf-8")
    command = [sys.executable, "-m", "framekit", "run", str(path), "--json", "--frames", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            process.send_signal(signal.SIGHUP)
            if options:
                assert any(json.loads(line)["event"] == "edited" for line in process.stdout)
                process.send_signal(signal.SIGTERM)
            events = [json.loads(line)["event"] for line in process.stdout]
            assert process.wait(60) == 0 and "block" in events, "the summary"
        finally:
            process.kill()


def test_a_missing_file_and_a_refused_edit_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file is missing in two checks, reappears unchanged, and then is invalid."""
    monkeypatch.setattr("framekit.api.run.INTERVAL", 0.01)
    path = tmp_path / "a.run.yaml"
    path.write_text("run: [", encoding="utf-8")
    events: list[str] = []

    async def watched() -> None:
        refused = asyncio.Event()

        def missing(reason: str) -> None:
            events.append(reason)
            path.write_text(RUN if reason else "run: {", encoding="utf-8")

        def refuse(error: ValueError) -> None:
            events.append("refused")
            refused.set()

        known = content_of(path)
        path.unlink()
        files = FileWatch(path, known, lambda model: None, refuse, missing)
        task = asyncio.create_task(files.watch())
        await asyncio.wait_for(refused.wait(), 60)
        task.cancel()

    asyncio.run(watched())
    assert events[:2] == ["No such file or directory", ""] and events[-1] == "refused"


def test_nothing_is_reported_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file changes while its content is loaded, is loaded by hand while it is missing, and reappears."""
    monkeypatch.setattr("framekit.api.run.INTERVAL", 0.01)
    path = tmp_path / "a.run.yaml"
    path.write_text(RUN, encoding="utf-8")
    (tmp_path / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
    events: list[str] = []
    loads: list[str] = []

    def load(path: Path, text: str | None = None) -> RunModel:
        if not loads:
            replace_file(path, "run: [")
        loads.append("")
        return api_run_load(path, text)

    api_run_load = api_run.load_run
    monkeypatch.setattr(api_run, "load_run", load)

    async def watched() -> None:
        looks = asyncio.Queue[None]()

        def seen(path: Path) -> bytes | None:
            loop.call_soon_threadsafe(looks.put_nowait, None)
            return content_of(path)

        async def look(times: int) -> None:
            while not looks.empty():
                looks.get_nowait()
            for _ in range(times):
                await asyncio.wait_for(looks.get(), 60)

        loop = asyncio.get_running_loop()
        monkeypatch.setattr(api_run, "content_of", seen)
        files = FileWatch(
            path, b"", lambda model: events.append("changed"), lambda error: events.append("refused"), events.append
        )
        task = asyncio.create_task(files.watch())
        await look(8)
        assert events == ["changed", "refused"], "each content is tried once"
        path.unlink()
        files.look_now()
        await look(5)
        files.look_now()
        await look(5)
        assert events[2:] == ["No such file or directory"]
        replace_file(path, "run: [")
        await look(8)
        assert events[3:] == [""], "the content that was refused before"
        task.cancel()

    asyncio.run(watched())


def test_the_places_of_a_refused_edit_are_relative_to_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    at = Position(str(tmp_path / "a.run.yaml"), 3, 1)
    error = DefinitionError([Problem(at, "wrong", "mend it"), Problem(at, "odd", "", warning=True)])
    assert reasons_of(error) == ["a.run.yaml:3:1: wrong – mend it"]
    assert reasons_of(ValueError("no port")) == ["no port"]


def test_the_lines_of_a_refused_edit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
    (tmp_path / "a.run.yaml").write_text(RUN, encoding="utf-8")
    TextOutput(load_run(tmp_path / "a.run.yaml")).refused(["a.run.yaml:3:1: wrong"])
    assert capsys.readouterr().err == "a.run.yaml:3:1: wrong\nedit refused – the run goes on as before\n"


def test_simulated_time_cannot_be_watched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "x.run.yaml", "--virtual", "--for", "1s", "--watch"]) == 2
    assert "--watch is for runs in real time" in capsys.readouterr().err

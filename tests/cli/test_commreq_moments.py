"""Commands to jobs: events in the same turn of the event loop as the answer, and events while waiting for it."""

from __future__ import annotations

import argparse
import asyncio
import io
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from framekit.cli.parser import build_parser
from framekit.definition.load.protocol import load_protocol
from framekit.extras.commreq.commreq_verb import NO_ANSWER, JobCommands, carry_out_jobs
from framekit.extras.commreq.job_table import JobSlot, status_of


class Output:
    """An output that shows no changes of memory."""

    def meaning(self, data: bytes) -> tuple[str, None]:
        return data.decode(), None

    def content(self) -> dict[str, bytes]:
        return {}

    def changes(self, before: dict[str, bytes]) -> dict[str, list[int]]:
        return {}

    def show_changes(self, changes: dict[str, list[int]]) -> None:
        assert not changes

    def show(self, meaning: str, place: None, end: Any, before: dict[str, bytes]) -> None:
        print(meaning, "is answered")


PROFILE: Any = SimpleNamespace(words={"good": 1, "late": 2, "period": 3}, text_of=lambda word: "success")


def test_a_transfer_beside_the_answer_of_another_command(capsys: pytest.CaptureFixture[str]) -> None:
    async def at_work() -> int:
        given = argparse.Namespace(json=False)
        commands = JobCommands(None, PROFILE, None, given, None)  # type: ignore[arg-type]
        line: Any = SimpleNamespace(
            clock=SimpleNamespace(now=lambda: 0), carry_out=lambda data, answered: answered(None)
        )
        output: Any = Output()
        commands.line, commands.output = line, output
        asyncio.get_running_loop().call_soon(commands._transferred, status_of(JobSlot(5), PROFILE), None)
        return await commands._command(line, output, b"inspect")

    assert asyncio.run(at_work()) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("job 5") and lines[1:] == ["inspect is answered"]


def test_nobody_reads_any_more_while_a_command_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Unread(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    async def waits(self: JobCommands, *_: Any) -> int:
        asyncio.get_running_loop().call_soon(print, "an event")
        await self._until(lambda: False)
        return NO_ANSWER

    monkeypatch.setattr(JobCommands, "_command", waits)
    monkeypatch.setattr(sys, "stdout", Unread())
    device = tmp_path / "plc.device.yaml"
    device.write_text("device: plc\nprotocol: srtp\n", encoding="utf-8")
    words = ["commreq", "srtp", "--commands", "ge-channels", "--port", f"sim:{device}", "2003"]
    given = build_parser("commreq").parse_args(words)
    with pytest.raises(BrokenPipeError):
        carry_out_jobs(load_protocol("ge-channels"), load_protocol("srtp"), [b""], given)

"""What happens in the very turn of the loop in which a command to a job is answered is shown all the same."""

from __future__ import annotations

import argparse
import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from framekit.blocks.jobs.diagnosis import status_of
from framekit.blocks.jobs.slot import Slot
from framekit.cli.commreq_jobs import JobCommands


class Output:
    """Shows nothing of memory."""

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
        commands = JobCommands(None, PROFILE, None, argparse.Namespace(json=False))  # type: ignore[arg-type]
        line: Any = SimpleNamespace(
            clock=SimpleNamespace(now=lambda: 0), carry_out=lambda data, answered: answered(None)
        )
        output: Any = Output()
        commands.line, commands.output = line, output
        asyncio.get_running_loop().call_soon(commands._transferred, status_of(Slot(5), PROFILE), None)
        return await commands._command(line, output, b"inspect")

    assert asyncio.run(at_work()) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("job 5") and lines[1:] == ["inspect is answered"]

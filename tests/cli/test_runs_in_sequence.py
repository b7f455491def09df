"""Runs in sequence, as a fleet deploys files: each run knows the unfinished requests of the previous run."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from framekit.api.run import AsyncRun, RunModel
from framekit.cli.live_output import LiveOutput, live_output
from framekit.cli.run_output import TextOutput
from framekit.cli.run_verb import RealRun, RunWatch, Watched, add_run_arguments
from framekit.extras.fleet import gateway
from framekit.runfile.run_file import load_run

RUN = """\
run: r
memory: masterlogic
channels:
  1: {port: "sim:d.device.yaml", protocol: modbus-rtu, station: 3}
blocks:
  0: {read: "40001", into: D1, every: 1 s}
"""


class Gateways(AbstractContextManager["Gateways"]):
    """A gateway that replaces each run at once, `count` times."""

    def __init__(self, run: RunModel, count: int) -> None:
        self.over = asyncio.Event()
        self.next_run: RunModel | None = run
        self.count = count
        self.runs: list[Any] = []

    def __exit__(self, *error: object) -> None:
        """Leave the fleet."""

    def begins(self, run: AsyncRun) -> None:
        self.runs.append(run)

    def has_begun(self) -> None:
        if len(self.runs) == self.count:
            self.next_run = None
        self.over.set()


@pytest.fixture
def live() -> Iterator[LiveOutput]:
    with live_output(False) as found:
        yield found


@pytest.mark.long
def test_the_next_run_of_a_rolled_out_file_continues_the_lines(
    live: LiveOutput, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "d.device.yaml").write_text("device: d\nprotocol: modbus-rtu\nstation: 3\n")
    path = tmp_path / "r.run.yaml"
    path.write_text(RUN)
    parser = argparse.ArgumentParser()
    add_run_arguments(parser)
    arguments = parser.parse_args([str(path), "--quiet"])

    async def check() -> None:
        loaded = replace(load_run(path), fleet=cast(Any, "a fleet"))
        gateways = Gateways(loaded, 3)
        monkeypatch.setattr(gateway, "Gateway", lambda *given: gateways)
        real = RealRun(
            arguments, RunWatch(arguments), Watched(path, b""), lambda run: TextOutput(run, ()),
            TextOutput(loaded, ()), live,
        )  # fmt: skip
        await real.carry_out(loaded, None)
        assert len(gateways.runs) == 3
        assert len({id(run._service.lines.requests) for run in gateways.runs}) == 1

    asyncio.run(check())

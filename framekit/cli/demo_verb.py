"""`framekit demo`: a simulated device, its values, a fault that is overcome, and three frames with their fields."""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING, NamedTuple

from framekit.cli.common import ARROWS, near, run_in_loop, table

if TYPE_CHECKING:
    from framekit.api.monitor import FrameLog
    from framekit.api.rows import FrameEntry
    from framekit.api.run import RunCalls, RunModel
    from framekit.cli.run_output import TextOutput

SET_POINT = 62.5
"""The value that the demonstration writes (°C)."""


class Scene(NamedTuple):
    """A part of the demonstration."""

    text: str
    seconds: float
    action: Callable[[RunCalls], object] = lambda run: None
    """Done at its begin."""


SCENES = (
    Scene("The run reads four named values once a second, and shows each that changes:", 5),
    Scene(
        f"The run writes another set point, {SET_POINT} °C:", 3.9,
        lambda run: run.points["setpoint"].write(SET_POINT, who="the demonstration"),
    ),
    Scene("Now the device does not answer for four seconds. No old value is shown as if it were good:", 9),
)  # fmt: skip


def add_demo_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--fast", action="store_true", help="on simulated time: everything at once")


def run_demo(arguments: argparse.Namespace) -> int:
    from framekit.api.run import loaded
    from framekit.definition.sources import shipped_folder

    folder = shipped_folder("demo")
    run, device = folder / "heating.run.yaml", folder / "heating.device.yaml"
    model = loaded(run)
    (channel,) = model.channels.values()
    print(f"A heating controller with {channel.protocol.name} at {channel.line}, simulated: {_shown(device)}")
    print(f"Its values, by name: {_shown(run)}")
    log = _virtual(model) if arguments.fast else run_in_loop(_real(model))
    print("\nThree of the frames, with their fields:")
    for entry in _chosen(log):
        print(f"\n{_frame_text(log, entry)}")
    print("\nTry next:")
    command = "framekit" if which("framekit") else sys.argv[0]
    for about, words in (
        ("the same run, until Ctrl-C", f"run {_shown(run)}"),
        (
            "values of a device, once",
            f"read {channel.protocol.name} --port sim:{_shown(device)} --station 5 40001 -n 3",
        ),
        ("all verbs, by task", "--help"),
    ):
        print(f"  {about}:\n    {command} {words}")
    return 0


def _shown(file: Path) -> str:
    return near(str(file))


def _made(make: Callable[..., RunCalls], model: RunModel) -> tuple[RunCalls, TextOutput, FrameLog]:
    """Return the run, its output, and the log of its frames."""
    from framekit.api.monitor import FrameLog
    from framekit.api.run import view_of
    from framekit.cli.run_output import TextOutput

    log = FrameLog()
    run, output = make(model, monitor=log.add), TextOutput(model)
    view_of(run, log)
    output.watches(run)
    return run, output, log


def _begin(scene: Scene, run: RunCalls, output: TextOutput) -> None:
    output.catch_up()
    print(f"\n{scene.text}\n", flush=True)
    scene.action(run)


def _virtual(model: RunModel) -> FrameLog:
    from framekit.api.run import VirtualRun

    run, output, log = _made(VirtualRun, model)
    assert isinstance(run, VirtualRun)
    run.start()
    for scene in SCENES:
        _begin(scene, run, output)
        run.run_for(scene.seconds)
    output.catch_up()
    run.stop()
    return log


async def _real(model: RunModel) -> FrameLog:
    from framekit.api.run import AsyncRun

    run, output, log = _made(AsyncRun, model)
    assert isinstance(run, AsyncRun)
    async with run:
        for scene in SCENES:
            _begin(scene, run, output)
            await asyncio.sleep(scene.seconds)
        output.catch_up()
    return log


def _chosen(log: FrameLog) -> list[FrameEntry]:
    """Return three frames: the longest reply with its request, and the request of the rarest kind."""
    from framekit.api.monitor import FrameFilter
    from framekit.api.rows import meaning_of

    frames = [entry for entry in log.chosen(FrameFilter()) if entry.seen.kind == "frame"]
    at = max(range(1, len(frames)), key=lambda number: (frames[number].seen.direction == "in", _size(frames[number])))
    requests = [entry for entry in frames if entry.seen.direction == "out"]
    kinds = Counter(meaning_of(entry.seen) for entry in requests)
    return [frames[at - 1], frames[at], min(requests, key=lambda entry: kinds[meaning_of(entry.seen)])]


def _size(entry: FrameEntry) -> int:
    return len(entry.seen.raw)


def _frame_text(log: FrameLog, entry: FrameEntry) -> str:
    from framekit.api.rows import FIELD_HEAD, field_row, meaning_of

    title = f"{ARROWS[entry.seen.direction]} {meaning_of(entry.seen)}, {_size(entry)} bytes"
    return f"{title}\n{table([field_row(row) for row in log.fields(entry)], FIELD_HEAD)}"

"""A run of one file beside a device file, on simulated time: what tests of running runs begin with."""

from __future__ import annotations

from pathlib import Path

from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock


def started(folder: Path, run: str, device: str, clock: VirtualClock) -> RunService:
    """The run in `run`, started; `device` stands in `there.device.yaml` beside it."""
    (folder / "r.run.yaml").write_text(run, encoding="utf-8")
    (folder / "there.device.yaml").write_text(device, encoding="utf-8")
    service = RunService(load_run(folder / "r.run.yaml"), clock)
    service.start()
    return service

"""Start a run of one run file and one device file on simulated time."""

from __future__ import annotations

from pathlib import Path

from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock


def started(folder: Path, run: str, device: str, clock: VirtualClock) -> RunService:
    """Start the run `run` and return its service; `device` is written to `there.device.yaml` in the same folder."""
    (folder / "r.run.yaml").write_text(run, encoding="utf-8")
    (folder / "there.device.yaml").write_text(device, encoding="utf-8")
    service = RunService(load_run(folder / "r.run.yaml"), clock)
    service.start()
    return service

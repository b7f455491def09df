"""Load the run of `killed_run` in the process that others are forked from, so each of them starts at once."""

from __future__ import annotations

import asyncio
import tempfile
from pathlib import Path

import paho.mqtt.client  # noqa: F401 – every process uses it
from points.killed_run import write_files

from framekit.api.run import AsyncRun


async def _made(path: Path) -> None:
    AsyncRun(path).stop()


with tempfile.TemporaryDirectory() as folder:
    asyncio.run(_made(write_files(Path(folder), 1)))

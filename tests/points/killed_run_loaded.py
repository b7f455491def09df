"""Loads the run of `killed_run` once where processes are forked from, so that each of them begins at once."""

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

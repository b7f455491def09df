"""Describe the measuring machine: processor, system, and the versions of all compared packages."""

from __future__ import annotations

import os
import platform
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

COMPARED = ("construct", "kaitaistruct", "numpy", "pymodbus", "pyserial")


def machine() -> dict[str, str]:
    """Return names and values, for the table's head and the JSON."""
    return {
        "processor": f"{_processor()}, {os.cpu_count()} cores",
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "Python": platform.python_version(),
        **{name: _version(name) for name in ("framekit", *COMPARED)},
        "speed": f"a loop of plain Python in {1000 * _loop():.1f} ms",
        "load": " ".join(f"{load:.2f}" for load in os.getloadavg()),
    }


def _loop() -> float:
    """Return the processor time (s) of fixed work, since machines differ, and one machine at different times."""
    times = []
    for _ in range(15):
        begin, found = time.process_time(), dict[int, tuple[int, str]]()
        for number in range(60_000):
            found[number & 255] = number, str(number)
        times.append(time.process_time() - begin)
    return min(times)


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"

"""Start-up time of `framekit --version` and `framekit decode`, compared with `python -c pass`: CPU time.

Python's byte code of framekit is cached in a separate folder, like that of an installed package, and framekit caches
the compiled protocol. Both caches are filled before the first round.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measure import interleave
from benchmarks.row import Row, Target, slower

NAME = "Start of the command line, CPU time"
TARGET = "framekit --version ≤ 3 × python -c pass; framekit decode modbus-rtu … ≤ 6 ×"
REQUEST = "01 03 00 00 00 0A C5 CD"
COMMANDS = {
    "python -c pass": ["-c", "pass"],
    "framekit --version": ["-m", "framekit", "--version"],
    "framekit decode modbus-rtu …": ["-m", "framekit", "decode", "modbus-rtu", REQUEST],
}
BOUNDS = {"framekit --version": 3, "framekit decode modbus-rtu …": 6}


def run(rounds: int) -> list[Row]:
    with TemporaryDirectory() as folder:
        kept = {"PYTHONPYCACHEPREFIX": str(Path(folder) / "python"), "XDG_CACHE_HOME": str(Path(folder) / "cache")}
        environment = {**os.environ, **kept}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        commands = {name: _command(words, environment) for name, words in COMMANDS.items()}
        for command in commands.values():
            command()
        times = interleave(commands, rounds)
    plain = times["python -c pass"]
    return [
        slower(name, "python -c pass", times[name], plain, Target("at most", bound), 1e3)
        for name, bound in BOUNDS.items()
    ]


def _command(words: list[str], environment: dict[str, str]) -> Callable[[], float]:
    """Run the command; return its CPU seconds."""

    def measure() -> float:
        before = _children()
        subprocess.run([sys.executable, *words], env=environment, stdout=subprocess.DEVNULL, check=True)
        return _children() - before

    return measure


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

"""Each system call that writes, opens, renames, removes or syncs a file fails once, and from then on.

Afterwards a file has its old or its new content, losses were reported, and no call raised: as in SQLite's own tests
(sqlite.org/testing.html, I/O error testing). The calls fail in a preloaded library, so those of SQLite fail, too.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from points.fault_scenarios import SCENARIOS

TESTS = Path(__file__).parents[1]

pytestmark = pytest.mark.skipif(
    platform.system() != "Linux" or platform.libc_ver()[0] != "glibc" or shutil.which("cc") is None,
    reason="needs Linux, glibc and a C compiler",
)


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("faults") / "faults.so"
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-O1", "-o", path, TESTS / "system_faults.c", "-ldl"], check=True, timeout=120
    )
    return path


LEAST = {
    "cache": 6,
    "capture-pcap": 20,
    "capture-jsonl": 20,
    "csv": 20,
    "jsonl": 20,
    "csv-rotate": 40,
    "parquet": 33,
}
"""Least number of trials of a scenario; the others have more than 60."""
SHORT = ("cache", "capture-pcap", "csv-rotate")


@pytest.mark.parametrize(
    "name", [name if name in SHORT else pytest.param(name, marks=pytest.mark.long) for name in SCENARIOS]
)
def test_old_or_new_content_whatever_call_fails(library: Path, tmp_path: Path, name: str) -> None:
    script = Path(__file__).with_name("fault_scenarios.py")
    environment = {**os.environ, "LD_PRELOAD": str(library), "PYTHONPATH": str(TESTS.parent)}
    done = subprocess.run(
        [sys.executable, script, name, tmp_path], env=environment, capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    assert found["problems"] == []
    assert found["trials"] > LEAST.get(name, 60)

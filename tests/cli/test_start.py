"""The imports of the command line before it answers: the number of modules does not depend on the machine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

REQUEST = "01 03 00 00 00 0A C5 CD"
SLOW = {"asyncio", "dataclasses", "datetime", "decimal", "difflib", "email", "importlib.metadata", "inspect", "json",
        "shutil", "yaml"}  # fmt: skip
"""Slow modules that neither command needs."""


def imported(tmp_path: Path, *words: str) -> set[str]:
    """Return the modules that a command imports."""
    script = (
        "import sys, io; before = set(sys.modules); out, sys.stdout = sys.stdout, io.StringIO()\n"
        "from framekit.cli.main import main\n"
        f"assert main({list(words)}) == 0 and sys.stdout.getvalue()\n"
        "print(*sorted(set(sys.modules) - before), file=out)"
    )
    environment = {**os.environ, "FRAMEKIT_CACHE": str(tmp_path / "cache")}
    run = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def test_the_version_is_printed_without_the_parser(tmp_path: Path) -> None:
    found = imported(tmp_path, "--version")
    assert {name for name in found if name.startswith("framekit")} == {
        "framekit", "framekit.cli", "framekit.cli.main", "framekit.definition",
    }  # fmt: skip
    assert not found & {"argparse", "re", "typing", *SLOW}


def test_a_decoded_frame_needs_few_modules(tmp_path: Path) -> None:
    imported(tmp_path, "decode", "modbus-rtu", REQUEST)  # which fills the cache
    found = imported(tmp_path, "decode", "modbus-rtu", REQUEST)
    assert not found & SLOW
    assert {name for name in found if name.startswith("framekit")} == {
        "framekit", "framekit.cli", "framekit.cli.common", "framekit.cli.decode_verb", "framekit.cli.main",
        "framekit.cli.parser", "framekit.cli.terminal", "framekit.cli.verb_table", "framekit.codec",
        "framekit.codec.cache",
        "framekit.codec.errors", "framekit.codec.functions", "framekit.codec.shown", "framekit.definition",
        "framekit.definition.brought", "framekit.definition.installed", "framekit.definition.problems",
        "framekit.definition.sources", "framekit.table_of_extras",
    }  # fmt: skip
    assert len(found) <= 81, "each module costs about 0.3 ms"

"""Run the benchmarks and print their table; `--json FILE` also writes the figures.

`python -m benchmarks` runs all; `python -m benchmarks codecs receiver` runs the modules of this name in
`benchmarks/rows`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.machine import machine
from benchmarks.row import as_table
from benchmarks.rows import MODULES


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="framekit's speed as ratios")
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"which of {', '.join(MODULES)}; all without")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write machine, versions, medians and spread there")
    parser.add_argument("--rounds", type=int, default=15, help="interleaved rounds; the median counts")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.rows if name not in MODULES]
    if unknown:
        parser.error(f"there is no {unknown[0]}; there are {', '.join(MODULES)}")
    if arguments.rounds < 1:
        parser.error(f"{arguments.rounds} rounds measure nothing")
    if arguments.json is not None and not arguments.json.parent.is_dir():
        parser.error(f"there is no folder {arguments.json.parent}")
    measured_on = machine()
    print("\n".join(f"{name}: {value}" for name, value in measured_on.items()))
    found = [_run(name, arguments.rounds) for name in arguments.rows or MODULES]
    if arguments.json is not None:
        text = json.dumps({"machine": measured_on, "rounds": arguments.rounds, "benchmarks": found}, indent=1)
        arguments.json.write_text(text + "\n", encoding="utf-8")
    return 0


def _run(name: str, rounds: int) -> dict[str, Any]:
    """Print the table of a module, and return its figures."""
    module: Any = import_module(f"benchmarks.rows.{name}")
    begin = time.perf_counter()
    rows = module.run(rounds)
    took = time.perf_counter() - begin
    print(f"\n{module.NAME}\n  target: {module.TARGET} (measured in {took:.0f} s)\n{as_table(rows)}", flush=True)
    figures = [row.as_json() for row in rows]
    return {"module": name, "name": module.NAME, "target": module.TARGET, "rows": figures}


if __name__ == "__main__":
    sys.exit(main())

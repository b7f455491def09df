"""Runs every benchmark and prints its table; `--json FILE` writes the figures too."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks import codecs
from benchmarks.measure import machine


def main() -> None:
    parser = argparse.ArgumentParser(description="framekit's benchmarks: ratios against alternatives")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write machine, versions, medians and spread there")
    parser.add_argument("--rounds", type=int, default=15, help="interleaved rounds; the median counts")
    arguments = parser.parse_args()
    print(machine())
    results = codecs.run(arguments.rounds)
    print(codecs.as_table(results))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps({"machine": machine(), "codecs": results}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()

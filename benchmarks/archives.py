"""Captures to an archive: one process, one a core, a cluster of two workers, and the time that writing alone takes.

`python -m benchmarks.archives --frames 1000000 --captures 20` makes captures of Modbus requests and replies and prints
frames a second, by the wall clock. Each way is taken in turn, and its rows are counted.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.cases import codec_of
from benchmarks.rows.capture import requests_and_replies
from framekit.extras.archive.archive import archive


def made(folder: Path, count: int, frames: int) -> list[Path]:
    """Write captures, with the same frames in each."""
    data = b"".join(requests_and_replies(codec_of("modbus-rtu"), frames // count))
    paths = [folder / f"hour{number:04}.pcap" for number in range(count)]
    for path in paths:
        path.write_bytes(data)
    return paths


def written_again(table: Path, target: Path) -> int:
    """Write the rows of an archive again from memory; return the time (ns) that the library takes."""
    from pyarrow import parquet

    taken = 0
    for number, path in enumerate(sorted(table.iterdir())):
        read = parquet.read_table(path)
        began = time.perf_counter_ns()
        parquet.write_table(read, target / f"{number}.parquet", compression="zstd", row_group_size=50_000)
        taken += time.perf_counter_ns() - began
    return taken


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=200_000)
    parser.add_argument("--captures", type=int, default=8)
    parser.add_argument("--cluster", action="store_true", help="also a cluster of two workers on this machine")
    parser.add_argument("--cluster-only", action="store_true", help="nothing but that, for as many frames as one likes")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        paths = made(folder, words.captures, words.frames)

        def timed(name: str, work: Callable[[Path], Any]) -> float:
            target, began = folder / f"{name}.parquet", time.perf_counter()
            work(target)
            seconds = time.perf_counter() - began
            print(f"{name:12} {seconds:8.1f} s  {words.frames / seconds:10,.0f} frames a second", flush=True)
            return seconds

        def decoded(target: Path, **how: Any) -> None:
            done = sum(capture.counts["frame"] for capture in archive(paths, "modbus-rtu", target, **how))
            assert done == words.frames // words.captures * words.captures, done

        if not words.cluster_only:
            one = timed("one process", lambda target: decoded(target, jobs=1))
            every = timed("each core", decoded)
            print(f"{one / every:.2f} times faster")
        if words.cluster or words.cluster_only:
            from distributed import LocalCluster

            with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
                engine = cluster.scheduler_address.replace("tcp://", "dask://")
                timed("cluster", lambda target: decoded(target, engine=engine))
        again = folder / "again"
        again.mkdir()
        seconds = written_again(folder / f"{'cluster' if words.cluster_only else 'one process'}.parquet", again) / 1e9
        print(f"{'writing only':12} {seconds:8.1f} s  {words.frames / seconds:10,.0f} frames a second")


if __name__ == "__main__":
    main()

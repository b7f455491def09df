"""What the page costs: `python -m benchmarks.page [SECONDS]`, with chromium and chromium-driver.

A run with 8 channels of 64 blocks, each carried out once a second on simulated lines, and 2,000 points, each of which
changes ten times a second, is carried out by a process of its own, whose page a browser shows. Every millisecond of
processor time it is noted whether that went to the page: to its server, to what it sends, to the log of frames.
Printed is the processor time of a refresh, and what five of them a second are of a core, which is the same on a machine
that has other work; and how long the browser takes from a message until what it brought is on the screen.
"""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import FrameType
from typing import Any

from framekit.api.monitor import FrameLog
from framekit.api.run import AsyncRun, view_of
from framekit.extras.web.access import Access
from framekit.extras.web.board import VALUES_EVERY, WebBoard
from framekit.extras.web.server import WebServer
from framekit.extras.web.shown import shown_run

CHANNELS, BLOCKS, POINTS = 8, 64, 2_000
TURNS = 3
CHANGE_EVERY = 0.1
BEGINNING = 4.0
"""Seconds that are not counted: everything begins."""

DEVICE = """device: meter
protocol: modbus-tcp
station: 1
memory: {set: {"40001": [1, 2, 3, 4]}}
"""


def run_text() -> str:
    """The run file."""
    lines = ["run: large", "memory: masterlogic", "channels:"]
    lines += [
        f'  {number}: {{port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}}'
        for number in range(1, CHANNELS + 1)
    ]
    lines.append("sets:")
    for channel in range(1, CHANNELS + 1):
        lines += [f"  {channel}:", "    blocks:"]
        lines += [
            f'      {block}: {{read: "40001", channel: {channel}, count: 4, every: 1s, '
            f"into: D{4 * (BLOCKS * (channel - 1) + block)}}}"
            for block in range(BLOCKS)
        ]
    lines.append("points:")
    lines += [f"  p{number}: {{address: MW{number}, type: int16, unit: mm}}" for number in range(POINTS)]
    return "\n".join(lines) + "\n"


# ---- the process that is measured -----------------------------------------------------------------------------------


class PageSamples:
    """Notes, so often of processor time, whether that went to the page."""

    EVERY = 0.001
    ITS_OWN = ("/framekit/extras/web/", "/uvicorn/", "/websockets/", "/starlette/")

    def __init__(self) -> None:
        self.all = self.page = 0

    def begin(self) -> None:
        self.all = self.page = 0
        signal.signal(signal.SIGPROF, self._note)
        signal.setitimer(signal.ITIMER_PROF, self.EVERY, self.EVERY)

    def end(self) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.all += 1
        while frame is not None:
            code = frame.f_code
            of_log = code.co_filename.endswith("/api/monitor.py") and code.co_name == "add"
            if of_log or any(part in code.co_filename for part in self.ITS_OWN):
                self.page += 1
                return
            frame = frame.f_back


async def carry_out(path: Path, seconds: float) -> None:
    """Carries the run out; says where the page is, and then what was taken in so many seconds."""
    log = FrameLog()
    run = AsyncRun(path, monitor=log.add)
    server = WebServer("127.0.0.1", 0, Access())
    server.begin(WebBoard(shown_run(run, view_of(run, log))))
    samples = PageSamples()
    async with run:
        changing = asyncio.ensure_future(_change(run))
        print(json.dumps(server.url), flush=True)
        await asyncio.sleep(BEGINNING)
        board = server.page.board
        assert board is not None
        before, frames, used, began = board.values.round, log.last_number, time.process_time(), time.perf_counter()
        samples.begin()
        await asyncio.sleep(seconds)
        samples.end()
        found = {
            "used": time.process_time() - used,
            "passed": time.perf_counter() - began,
            "page": samples.page / max(1, samples.all),
            "refreshes": board.values.round - before,
            "frames": log.last_number - frames,
        }
        print(json.dumps(found), flush=True)
        await asyncio.to_thread(sys.stdin.readline)
        changing.cancel()
    await server.end()


async def _change(run: Any) -> None:
    """Every point changes."""
    number, due = 0, time.perf_counter()
    while True:
        number += 1
        run.memory.write("MW0", [(number * 7 + place) % 1000 for place in range(POINTS)])
        due += CHANGE_EVERY
        await asyncio.sleep(max(0.0, due - time.perf_counter()))


# ---- who measures ---------------------------------------------------------------------------------------------------


def measured(path: Path, page: Any, seconds: float) -> dict[str, Any]:
    """One turn, with the browser."""
    words = [sys.executable, "-m", "benchmarks.page", "--carry-out", str(path), str(seconds)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as there:
        assert there.stdout is not None
        page.open(json.loads(there.stdout.readline()))
        found: dict[str, Any] = json.loads(there.stdout.readline())
        drawn = "return [Number(document.body.dataset.mean), Number(document.body.dataset.drawn)]"
        found["mean"], found["most"] = page.run(drawn)
        there.communicate("\n")
    return found


def main(seconds: float) -> None:
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from web.chromium import browser

    with tempfile.TemporaryDirectory() as folder, browser() as page:
        (Path(folder) / "meter.device.yaml").write_text(DEVICE, "utf-8")
        path = Path(folder) / "large.run.yaml"
        path.write_text(run_text(), "utf-8")
        shares = []
        for turn in range(1, TURNS + 1):
            found = measured(path, page, seconds)
            each = found["used"] * found["page"] / max(1, found["refreshes"])
            shares.append(each / VALUES_EVERY)
            whole = found["used"] / found["passed"]
            print(
                f"turn {turn}: {found['refreshes']} refreshes in {found['passed']:.1f} s, {1000 * each:.1f} ms of "
                f"processor time each, {shares[-1]:.1%} of a core at {1 / VALUES_EVERY:.0f} a second; "
                f"the whole process took {whole:.1%}, {found['frames']} frames; on the screen after "
                f"{found['mean']:.0f} ms, {found['most']:.0f} ms at most",
                flush=True,
            )
        print(f"the page takes {sorted(shares)[len(shares) // 2]:.1%} of a core (the middle of {len(shares)} turns)")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--carry-out"]:
        asyncio.run(carry_out(Path(sys.argv[2]), float(sys.argv[3])))
    else:
        main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)

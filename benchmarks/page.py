"""Measure the page of a large run: `python -m benchmarks.page [SECONDS]`, with chromium and chromium-driver.

A process of its own carries out a run with 8 channels of 64 blocks, each once a second on simulated lines, and 2,000
points that change ten times a second; a browser shows its page. Every millisecond of processor time a signal notes
whether the page uses it: its server, its messages, the log of frames. The output for each turn: the processor time of
a refresh, the share of a core at five refreshes a second (which other work on the machine does not change), the longest
stop of the loop, and how much of it was work of the loop and how much its wait for a free core; the time that the
browser takes to draw a message, and the time from the change of a value until the browser shows it. Limits of the page:
25 % of a core, 200 ms for a refresh, 300 ms from change to screen.
"""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import FrameType
from typing import Any

from framekit.api.monitor import FrameLog
from framekit.api.run import AsyncRun, view_of
from framekit.cli.common import without_collecting
from framekit.extras.web.access import Access
from framekit.extras.web.board import VALUES_EVERY, WebBoard
from framekit.extras.web.server import WebServer
from framekit.extras.web.shown import shown_devices, shown_run

CHANNELS, BLOCKS, POINTS = 8, 64, 2_000
TURNS = 3
CHANGE_EVERY = 0.1
BEGINNING = 6.0
"""Seconds at the start that are not measured."""
TICK = 0.01
"""Interval in seconds of the task that measures stops of the loop."""
CLOCK = 30_000
"""Milliseconds after which the clock in point 0 begins again; the number fits into its word."""

DEVICE = """device: meter
protocol: modbus-tcp
station: 1
memory: {set: {"40001": [1, 2, 3, 4]}}
"""

WATCH = """window.ages = [];
let before = null;
const look = () => {
  const text = document.querySelector("#points .grid tr.row td:nth-child(2)")?.textContent.replace(/[^0-9]/g, "");
  if (text && text !== before) {
    if (before !== null) window.ages.push(((Date.now() - Number(text)) % CLOCK + CLOCK) % CLOCK);
    before = text;
  }
  requestAnimationFrame(look);
};
look();""".replace("CLOCK", str(CLOCK))
"""Script of the browser: compare the clock in the first row with the time, at every frame of the screen."""


def run_text() -> str:
    """Return the run file."""
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


# ---- the measured process -------------------------------------------------------------------------------------------


class PageSamples:
    """Counts of samples of the processor time: all, and those inside the page."""

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
    """Execute the run; print the address of the page, then the measurement over a number of seconds."""
    log = FrameLog()
    run = AsyncRun(path, monitor=log.add, offers_faults=True)
    server, view = WebServer("127.0.0.1", 0, Access()), view_of(run, log)
    board = WebBoard(shown_run(run, view))
    server.begin(board, WebBoard(shown_devices(run, view)))
    samples = PageSamples()
    with without_collecting():
        async with run:
            await _measured(run, server, board, log, samples, seconds)
    await server.end()


async def _measured(
    run: AsyncRun, server: WebServer, board: WebBoard, log: FrameLog, samples: PageSamples, seconds: float
) -> None:
    """Change the points while the page is measured; print the address, then the measurement."""
    changing = asyncio.ensure_future(_change(run))
    print(json.dumps(server.url), flush=True)
    await asyncio.to_thread(sys.stdin.readline)
    before, frames, used, began = board.values.round, log.last_number, time.process_time(), time.perf_counter()
    samples.begin()
    longest = await _longest_stop(began + seconds)
    samples.end()
    found = {
        "used": time.process_time() - used,
        "passed": time.perf_counter() - began,
        "page": samples.page / max(1, samples.all),
        "refreshes": board.values.round - before,
        "frames": log.last_number - frames,
        "stop": longest,
    }
    print(json.dumps(found), flush=True)
    await asyncio.to_thread(sys.stdin.readline)
    changing.cancel()


def _core_times() -> list[float]:
    """Return the seconds that this thread has run on a core, and that it has waited for one; zeros off Linux."""
    try:
        times = Path(f"/proc/self/task/{threading.get_native_id()}/schedstat").read_text("ascii")
    except OSError:
        return [0.0, 0.0]
    return [int(nanoseconds) / 1e9 for nanoseconds in times.split()[:2]]


async def _longest_stop(end: float) -> list[float]:
    """Return the longest time that a short sleep took too long, until a time; and its core times."""
    longest, now, cores = [0.0, 0.0, 0.0], time.perf_counter(), _core_times()
    while now < end:
        await asyncio.sleep(TICK)
        before, now = now, time.perf_counter()
        cores_before, cores = cores, _core_times()
        if now - before - TICK > longest[0]:
            longest = [now - before - TICK, *(after - at for after, at in zip(cores, cores_before, strict=True))]
    return longest


async def _change(run: Any) -> None:
    """Change every point at regular intervals; point 0 carries the clock in milliseconds."""
    number, due = 0, time.perf_counter()
    while True:
        number += 1
        values = [(number * 7 + place) % 1000 for place in range(POINTS)]
        values[0] = int(time.time() * 1000) % CLOCK
        run.memory.write("MW0", values)
        due += CHANGE_EVERY
        await asyncio.sleep(max(0.0, due - time.perf_counter()))


# ---- the measurement ------------------------------------------------------------------------------------------------


def measured(path: Path, page: Any, seconds: float) -> dict[str, Any]:
    """Return the measurement of one turn with the browser."""
    words = [sys.executable, "-m", "benchmarks.page", "--carry-out", str(path), str(seconds)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as measuring:
        assert measuring.stdout is not None and measuring.stdin is not None
        page.open(json.loads(measuring.stdout.readline()))
        time.sleep(BEGINNING)
        page.run(WATCH)
        measuring.stdin.write("\n")
        measuring.stdin.flush()
        found: dict[str, Any] = json.loads(measuring.stdout.readline())
        drawn = "return [Number(document.body.dataset.mean), Number(document.body.dataset.drawn)]"
        found["mean"], found["most"] = page.run(drawn)
        found["ages"] = sorted(page.run("return window.ages"))
        measuring.communicate("\n")
    return found


def main(seconds: float) -> None:
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from extras.web.chromium import browser

    with tempfile.TemporaryDirectory() as folder, browser() as page:
        (Path(folder) / "meter.device.yaml").write_text(DEVICE, "utf-8")
        path = Path(folder) / "large.run.yaml"
        path.write_text(run_text(), "utf-8")
        shares = []
        for turn in range(1, TURNS + 1):
            found = measured(path, page, seconds)
            each = found["used"] * found["page"] / max(1, found["refreshes"])
            shares.append(each / VALUES_EVERY)
            whole, ages = found["used"] / found["passed"], found["ages"]
            stop, worked, waited = (1000 * seconds for seconds in found["stop"])
            print(
                f"turn {turn}: {found['refreshes']} refreshes in {found['passed']:.1f} s, {1000 * each:.1f} ms of "
                f"processor time each, {shares[-1]:.1%} of a core at {1 / VALUES_EVERY:.0f} a second; the whole "
                f"process took {whole:.1%}, {found['frames']} frames, longest stop {stop:.0f} ms (worked "
                f"{worked:.0f} ms, waited {waited:.0f} ms for a core); "
                f"drawn in {found['mean']:.0f} ms, {found['most']:.0f} ms at most; from change to screen "
                f"{ages[len(ages) // 2]} ms, 95 % within {ages[len(ages) * 95 // 100]} ms, {ages[-1]} ms at most",
                flush=True,
            )
        print(f"the page takes {sorted(shares)[len(shares) // 2]:.1%} of a core (the middle of {len(shares)} turns)")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--carry-out"]:
        asyncio.run(carry_out(Path(sys.argv[2]), float(sys.argv[3])))
    else:
        main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)

"""Number of byte codes of an exchange of a READ block in `framekit run`, from the reply to the next request.

Byte codes do not depend on the machine. The clock advances by 0.1 ms per exchange only, so timers fire as often as on a
fast line.
"""

from __future__ import annotations

import asyncio
import io
import sys
from pathlib import Path
from typing import Any

import pytest
from service.test_functions_called import HandPort, codes_of, opened

from framekit.api.run import AsyncRun
from framekit.cli.run_output import TextOutput
from framekit.runfile.run_file import load_run
from framekit.transport.clock import AsyncioClock
from framekit.transport.schemes import SCHEMES, Scheme

MOST_WITHOUT_A_MONITOR = 3383
MOST_WITH_A_MONITOR = 4620
"""With the lines of frames and of changed values. Both are current values; asyncio's sockets add about 500 on TCP."""

RUN = """
run: reads
memory: masterlogic
channels: {1: {port: "hand:", protocol: modbus-tcp, station: 1}}
blocks:
  0: {read: "40001", count: 10, into: M0, once: yes}
  1: {read: "40001", count: 10, into: M20, when: [block 0 done, block 2 done]}
  2: {read: "40001", count: 10, into: M40, when: block 1 done}
"""
EXCHANGES = 50
STEP = 100_000


@pytest.mark.parametrize("is_shown", [False, True], ids=["quiet", "shown"])
def test_an_exchange_of_a_read_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_shown: bool
) -> None:  # fmt: skip
    ports: list[HandPort] = []
    time = 0

    def made(url: str, settings: Any, clock: AsyncioClock, wiring: Any) -> HandPort:
        ports.append(HandPort(clock))
        return ports[-1]

    monkeypatch.setitem(SCHEMES, "hand", Scheme(form="hand:", open=made))
    monkeypatch.setattr(AsyncioClock, "now", staticmethod(lambda: time))
    printed = io.StringIO()
    monkeypatch.setattr(sys, "stdout", printed)
    file = tmp_path / "r.run.yaml"
    file.write_text(RUN, encoding="utf-8")

    async def scenario() -> tuple[list[int], int]:
        nonlocal time
        loaded = load_run(file)
        output = TextOutput(loaded, with_frames=is_shown, quiet=not is_shown)
        run = AsyncRun(loaded, monitor=output.tape if is_shown else None)
        output.watches(run)
        run.start()
        while not ports:
            await asyncio.sleep(0)
        (port,) = ports
        await opened(port)
        while not port.written:
            time += STEP
            await asyncio.sleep(0.001)
        counts = []
        for number in range(EXCHANGES + 5):
            time += STEP
            if number == 5:
                output.catch_up()
            before = len(port.written)
            counts.append(codes_of(lambda: port.tell(port.reply())))
            assert len(port.written) == before + 1, "the end of each block starts the next"
        shown = codes_of(output.catch_up) // EXCHANGES
        await run.finish()
        return counts, shown

    counts, shown = asyncio.run(scenario())
    assert printed.getvalue().count("reply_adu") == (EXCHANGES + 5 if is_shown else 0)
    assert min(counts) + shown <= (MOST_WITH_A_MONITOR if is_shown else MOST_WITHOUT_A_MONITOR)

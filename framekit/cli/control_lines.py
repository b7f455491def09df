"""Lines on standard input that control a run: read in a thread of their own, carried out in the run's loop."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from framekit.cli.run_output import Output
    from framekit.service.run import RunService


def control(service: RunService, output: Output, stop: Callable[[], None]) -> None:
    """Begins to read; the end of the input ends the control, not the run. `stop` is called for the line `stop`."""
    from framekit.service.control import ControlError, carry_out

    loop = asyncio.get_running_loop()

    def take(line: str) -> None:
        if not service.running:
            return
        if line.strip().lower() == "stop":
            stop()
            return
        try:
            carry_out(service, line)
        except ControlError as error:
            output.warning(f"control: {error}")

    def read() -> None:
        with suppress(RuntimeError, OSError, ValueError):  # the loop, or the input, is closed: nobody listens any more
            for line in sys.stdin:
                loop.call_soon_threadsafe(take, line)

    threading.Thread(target=read, name="framekit-control", daemon=True).start()

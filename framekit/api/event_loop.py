"""The event loop of `framekit run`, `framekit serve` and the synchronous API: uvloop with the extra `fast`."""

from __future__ import annotations

import asyncio
import importlib
import importlib.util
import os
import sys

from framekit.api.errors import RequestError

LOOP_VARIABLE = "FRAMEKIT_LOOP"
"""Environment variable that chooses the loop: `asyncio` or `uvloop`; empty or missing: uvloop if installed."""


def new_event_loop() -> asyncio.AbstractEventLoop:
    """Return a new event loop of the chosen library. Raise RequestError if the choice is wrong or not installed."""
    chosen = os.environ.get(LOOP_VARIABLE, "")
    if chosen not in ("", "asyncio", "uvloop"):
        raise RequestError(f"{LOOP_VARIABLE}={chosen}: this is no event loop – known are asyncio and uvloop")
    is_present = sys.platform != "win32" and importlib.util.find_spec("uvloop") is not None
    if chosen == "uvloop" and not is_present:
        what = f"{LOOP_VARIABLE}=uvloop: uvloop is not installed (it does not exist for Windows)"
        raise RequestError(f"{what} – install framekit with the extra 'fast', or write asyncio")
    if chosen == "asyncio" or not is_present:
        return asyncio.new_event_loop()
    loop: asyncio.AbstractEventLoop = importlib.import_module("uvloop").new_event_loop()
    return loop

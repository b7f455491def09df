"""The event loop of `framekit run`, `framekit serve` and the synchronous API: uvloop with the extra `fast`."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


def new_event_loop() -> asyncio.AbstractEventLoop:
    """Return a new event loop: of uvloop if it is installed, or else of asyncio. On Windows it is always of asyncio."""
    if sys.platform != "win32":
        try:
            import uvloop
        except ImportError:
            pass
        else:
            loop: asyncio.AbstractEventLoop = uvloop.new_event_loop()
            return loop
    return asyncio.new_event_loop()


def run_in_loop(coroutine: Coroutine[Any, Any, T]) -> T:
    """Return the result of a coroutine, which runs in a new event loop, as `asyncio.run` does."""
    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        return runner.run(coroutine)

"""An output that nobody reads any more is the end of what prints in callbacks of a loop, not a fault to be told."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any


class Unread:
    """Watches a loop: `stop` is called when something could not be printed because nobody reads it; `error` is why."""

    def __init__(self, loop: asyncio.AbstractEventLoop, stop: Callable[[], None]) -> None:
        self.error: BrokenPipeError | None = None
        self._stop = stop
        loop.set_exception_handler(self._raised)

    def _raised(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if not isinstance(error, BrokenPipeError):
            loop.default_exception_handler(context)
            return
        self.error = error
        self._stop()

    def check(self) -> None:
        """Raises the error, if there was one."""
        if self.error is not None:
            raise self.error

"""What only terminals get: colours, and a line that tells how far long work has come. Files and pipes get neither."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Literal, TextIO

Colour = Literal["red", "green", "yellow"]
_CODES: dict[Colour, str] = {"red": "31", "green": "32", "yellow": "33"}

COLOUR_OF_KIND: dict[str, Colour] = {"bad": "red", "trouble": "red", "noise": "yellow"}
"""The colours of what is seen on a line; the others have none."""

SHOWN_AFTER = 2.0
"""Work that is over sooner has no line (s)."""
SHOWN_EVERY = 0.25
WIDEST = 78


def has_colours(stream: TextIO) -> bool:
    """Whether it is a terminal with colours, and the user wants them (NO_COLOR, https://no-color.org)."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or not stream.isatty():
        return False
    return sys.platform != "win32" or "WT_SESSION" in os.environ or "TERM" in os.environ


def painted(text: str, colour: Colour | None, stream: TextIO) -> str:
    """A text as it goes to a stream: in its colour, or as it is."""
    return text if colour is None or not has_colours(stream) else f"\x1b[{_CODES[colour]}m{text}\x1b[0m"


class ProgressLine:
    """While a `with` lasts: a line on a terminal that tells how far work has come, from `after` seconds on.

    `says`: what is told behind the time; it is called in another thread, and may be set at any time.
    """

    def __init__(
        self, what: str, says: Callable[[], str] = lambda: "", *, stream: TextIO | None = None,
        after: float = SHOWN_AFTER,
    ) -> None:  # fmt: skip
        self.says = says
        self._what = what
        self._stream = sys.stderr if stream is None else stream
        self._after = after
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> ProgressLine:
        if self._stream.isatty() and os.environ.get("TERM") != "dumb":
            self._thread = threading.Thread(target=self._show, daemon=True, name="tells how far it is")
            self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()

    def _show(self) -> None:
        began, wait, width = time.monotonic(), self._after, 0
        while not self._over.wait(wait):
            wait = SHOWN_EVERY
            said = self.says()
            text = f"{self._what}: {time.monotonic() - began:.0f} s{f', {said}' if said else ''}"[:WIDEST]
            self._stream.write("\r" + text.ljust(width))
            self._stream.flush()
            width = len(text)
        if width:
            self._stream.write("\r" + " " * width + "\r")
            self._stream.flush()

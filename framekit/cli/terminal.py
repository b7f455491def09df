"""The guard of terminals: text of devices and files reaches a terminal only as visible characters.

A terminal obeys control characters: they move its cursor, change its title, or answer in the name of the user. While a
verb runs, the guard replaces standard output and standard error if they are terminals, and writes control characters,
bidirectional marks and other invisible characters as escapes (`\\x1b`). Pipes and files get the text unchanged.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Iterator
from typing import Any, TextIO

_OWN_COLOURS = re.compile("(\x1b\\[(?:0|31|32|33)m)")
"""The colours that framekit writes itself (`painted`); they can do no harm."""


class GuardedTerminal:
    """A terminal that takes text, and writes each invisible character of it as an escape.

    Everything except writing is left to the terminal itself.
    """

    def __init__(self, terminal: TextIO) -> None:
        self.terminal = terminal

    def write(self, text: str) -> int:
        """Write the text with its invisible characters as escapes; return the length of the given text."""
        self.terminal.write(harmless(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.terminal, name)


def harmless(text: str) -> str:
    """Return the text with its invisible characters as escapes, apart from the own colours."""
    if text.isprintable():
        return text
    from framekit.definition.problems import visible

    parts = _OWN_COLOURS.split(text)
    return "".join(part if number % 2 else visible(part) for number, part in enumerate(parts))


def unguarded(stream: Any) -> Any:
    """Return the terminal of a guard, for the cursor movements of framekit itself; any other stream as it is."""
    return stream.terminal if isinstance(stream, GuardedTerminal) else stream


@contextlib.contextmanager
def guarded_terminals() -> Iterator[None]:
    """Guard standard output and standard error while the context lasts, where they are terminals."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = map(_guarded, before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def discard_unwritten() -> None:
    """Discard buffered text of standard streams that cannot be written: the end of the program would write it again."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if not stream.closed:
                stream.flush()
        except OSError:
            with contextlib.suppress(OSError):  # a stream without a file
                null = os.open(os.devnull, os.O_WRONLY)
                try:
                    os.dup2(null, stream.fileno())
                finally:
                    os.close(null)


def _guarded(stream: Any) -> Any:
    return GuardedTerminal(stream) if stream.isatty() and not isinstance(stream, GuardedTerminal) else stream

"""Messages of browsers, and their validation: the common part of all pages."""

from __future__ import annotations

import json
import re
from collections.abc import Awaitable, Callable, Iterator, Mapping
from typing import Any, Protocol

from framekit.definition.problems import visible
from framekit.extras.web.access import Access

LARGEST_MESSAGE = 16_384
"""Largest number of bytes of a message from a browser, on pages without texts of files."""
LONGEST_TEXT = 300
"""Largest number of characters of a text from a browser."""

LARGEST_NUMBER = 2**53
"""Largest number from a browser: up to it JavaScript has every whole number."""

Message = dict[str, Any]
Told = Mapping[str, Any]
Actions = Mapping[str, Callable[[Any, Told], Message | Awaitable[Message] | None]]
"""Requests of a browser: the action for each first key of a message."""


_ESCAPES = re.compile(r"\\u(?P<pair>d[89ab]..\\ud[c-f]..)|\\u(?P<sign>....)|\\.")


def as_text(message: Message) -> str:
    """Return a message as JSON whose texts have their invisible characters as escapes: texts of devices among them.

    A browser would obey bidirectional marks and show other words than the device sent.
    """
    text = json.dumps(message, allow_nan=False, separators=(",", ":"))
    return _ESCAPES.sub(_visible_escape, text) if "\\u" in text else text


def _visible_escape(escape: re.Match[str]) -> str:
    if escape["sign"] is None:
        return escape[0]
    sign = chr(int(escape["sign"], 16))
    shown = visible(sign)
    return escape[0] if shown == sign else json.dumps(shown)[1:-1]


class PageSession(Protocol):
    """The session of a browser."""

    @property
    def wrong_tokens(self) -> int:
        """Return the number of wrong tokens it has sent."""

    def hello(self) -> Message:
        """Return the first message to the browser."""

    def news(self) -> Iterator[Message]:
        """Yield the changes since the last call."""

    async def answer(self, told: Any) -> Message | None:
        """Execute a message and return the answer. Raises ValueError if it is no message of the page."""


class PageBoard(Protocol):
    """Content common to all browsers."""

    home: str
    """The file of the page."""
    largest_message: int
    """Largest number of bytes of a message from a browser."""

    @property
    def name(self) -> str:
        """Return the name of the page among the others of the same program."""

    def session(self, access: Access, who: str) -> PageSession:
        """Return a session for a browser."""

    async def go_on(self) -> None:
        """Do the work of the page while the server runs."""


async def answered(actions: Actions, told: Any) -> Message | None:
    """Execute the action that a message requests and return its answer. Raises ValueError if it is no message."""
    if not isinstance(told, dict) or not told:
        raise ValueError("this is no message")
    name = next(iter(told))
    action = actions.get(name)
    if action is None:
        raise ValueError("this is no message")
    found = action(told[name], told)
    return await found if isinstance(found, Awaitable) else found


def plain_text(given: Any) -> str:
    """Return a text of a message. Raises ValueError."""
    if not isinstance(given, str) or len(given) > LONGEST_TEXT:
        raise ValueError("this is no message")
    return given


def whole_number(given: Any) -> int:
    """Return a number of a message, 0 or more; `true` and 16.0 are refused. Raises ValueError."""
    if not isinstance(given, int) or isinstance(given, bool) or not 0 <= given <= LARGEST_NUMBER:
        raise ValueError("this is no message")
    return given

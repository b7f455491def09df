"""Messages of a browser, and what is refused as none: all that pages have in common."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Mapping
from typing import Any, Protocol

from framekit.web.access import Access

LONGEST_TEXT = 300
LARGEST_NUMBER = 2**53
"""Characters of a text that a browser sends; above this number not every whole one can be written in JavaScript."""

Message = dict[str, Any]
Told = Mapping[str, Any]
Actions = Mapping[str, Callable[[Any, Told], Message | Awaitable[Message] | None]]
"""What a browser may ask for, by the first word of its message."""


class PageSession(Protocol):
    """One browser."""

    @property
    def wrong_tokens(self) -> int:
        """So many it has given."""

    def hello(self) -> Message:
        """What it is told first."""

    def news(self) -> Iterator[Message]:
        """What it has not seen."""

    async def answer(self, told: Any) -> Message | None:
        """Does what it asks for. Raises ValueError for what is no message of the page."""


class PageBoard(Protocol):
    """What all browsers are shown. `home`: the file of the page."""

    home: str

    def session(self, access: Access, who: str) -> PageSession:
        """That of one browser."""

    async def go_on(self) -> None:
        """What has to be done as long as the page is there."""


async def answered(actions: Actions, told: Any) -> Message | None:
    """What the action says that a message asks for. Raises ValueError for what is no message."""
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
    """Return a number of a message, 0 or more: no true, and no 16.0. Raises ValueError."""
    if not isinstance(given, int) or isinstance(given, bool) or not 0 <= given <= LARGEST_NUMBER:
        raise ValueError("this is no message")
    return given

"""Describe the replies of an exchange that arrived and could not be used, for the message of its failure."""

from __future__ import annotations

import re

from framekit.link.arrivals import BadFrame

WRONG_CHECK = "wrong check code"
_COUNT = re.compile(r"\b(?:a reply|\d+ replies) arrived(?P<rest> and could not be used|,)?(?:, the last one| all\b)?")
"""The number of replies in the sentence of `UnusableReplies`, in the singular and in the plural."""


class UnusableReplies:
    """The unusable replies of one exchange: their number, and the fault of the last."""

    __slots__ = ("_checks", "_detail", "_known", "bad", "count", "is_reply")

    def __init__(self) -> None:
        self.count = 0
        """Number of replies that arrived and could not be used."""
        self.bad = 0
        """Number of these that were bad frames; the others answer another request."""
        self.is_reply = False
        """Whether the last of them was the reply to the request, but for its check code."""
        self._known = 0
        """Value of `count` at the last call of `take_new`."""
        self._checks = 0
        """Number of these with a wrong check code."""
        self._detail = ""

    def take_new(self) -> bool:
        """Return whether replies have come since the last call."""
        is_new, self._known = self.count > self._known, self.count
        return is_new

    def add_bad(self, bad: BadFrame, *, is_reply: bool) -> None:
        """Note a bad frame; `is_reply`: it is the reply to the request, but for its check code."""
        self.count += 1
        self.bad += 1
        self.is_reply = is_reply
        if bad.cause == "check":
            self._checks += 1
            self._detail = f"{WRONG_CHECK} (expected {bad.expected}, found {bad.found})"
        else:
            self._detail = f"{bad.frame}: {bad.message or _described(bad)}"

    def add_unfit(self, frame: str, difference: str) -> None:
        """Note a good frame that does not repeat the request; `difference`: `station is 8, not 7`."""
        self.count += 1
        self.is_reply = False
        self._detail = f"{frame}: {difference}"

    def __str__(self) -> str:
        if self._checks == self.count:
            every = "all with" if self.count > 1 else "with"
            return f"{self._arrived()}, {every} a {self._detail}"
        return f"{self._arrived()} and could not be used{', the last one' if self.count > 1 else ''} – {self._detail}"

    def _arrived(self) -> str:
        return f"{self.count} replies arrived" if self.count > 1 else "a reply arrived"


def _described(bad: BadFrame) -> str:
    """Return the fault of a frame without a message: `parity, found a damaged character`."""
    expected = f"expected {bad.expected}" if bad.expected else ""
    found = f"found {bad.found}" if bad.found else ""
    return ", ".join(filter(None, (bad.cause.replace("_", " "), expected, found)))


def without_count(text: str) -> str:
    """Return a text in which the sentence of `UnusableReplies`, if it has it, is the same for any number of replies."""
    return _COUNT.sub(r"replies arrived\g<rest>", text)

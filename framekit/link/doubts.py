"""The doubt about the replies to an exchange while earlier requests have no reply; `LateReplies` decides by it."""

from __future__ import annotations

from typing import Any

from framekit.link.events import Exchange
from framekit.link.overdue import LONGEST, OpenRequest
from framekit.link.values import FrameValue

MOST_HURRIED = 2
"""Further equal replies, at most, that are waited for with short silences."""


class Doubt:
    """The replies to one exchange while requests before it are open: it runs again until a reply is believed."""

    __slots__ = (
        "asks", "began", "changes", "equal", "extra", "first", "gathers_from", "hurried", "is_draining", "is_held",
        "quickest", "reply", "restarts", "result", "since", "station", "was_drained",
    )  # fmt: skip

    def __init__(self, station: Any, now: int) -> None:
        self.station = station
        """Station of the exchange; None: the exchange has no station."""
        self.began = self.gathers_from = now
        """Begin of the exchange in doubt, and of the present gathering of replies (ns)."""
        self.restarts = 0
        """Number of gatherings before the present gathering."""
        self.is_held = False
        """Whether the line is held after the last reply, so that the next one does not come quickly."""
        self.asks: list[tuple[OpenRequest, int]] = []
        """Each request of the exchange that seemed to be answered, and the time of the reply."""
        self.hurried = 0
        """Number of replies in this gathering that a short silence followed."""
        self.result: object = None
        """Content of the last reply."""
        self.reply: FrameValue | None = None
        """The last reply."""
        self.first: bytes | None = None
        """Bytes of the first reply."""
        self.equal = 0
        """Number of equal replies in sequence, the last reply included."""
        self.since = now
        """Time of the first of these equal replies."""
        self.changes = 0
        """Number of replies in this gathering whose content was not that of the reply before."""
        self.quickest = LONGEST
        """Shortest time between a request of the exchange and its reply (ns)."""
        self.extra = 0
        """Time of the last reply that came without a request."""
        self.is_draining = self.was_drained = False
        """Whether no request is sent until open replies have come or are too old; whether that silence has ended."""

    def go_on(self, now: int) -> None:
        """Go on in an exchange that begins, perhaps after exchanges with other stations."""
        self.began = now
        if not self.asks:
            self.gathers_from = self.since = now
            self.is_held = False

    def restart(self, begin: int) -> None:
        """Gather replies again from `begin` on (ns), after a hold or a lost request."""
        self.gathers_from, self.quickest = begin, LONGEST
        self.changes = self.equal = self.hurried = 0
        self.result = None
        self.restarts += 1

    def note(self, content: object, reply: FrameValue, took: int, now: int) -> None:
        """Note a reply and its content, `took` after its request (ns)."""
        if self.equal and content == self.result:
            self.equal += 1
        else:
            self.changes += self.result is not None
            self.equal, self.since, self.result = 1, now, content
        self.reply, self.first = reply, self.first or reply.raw
        self.quickest = min(self.quickest, took)

    @property
    def is_hurried(self) -> bool:
        """Return whether equal replies came after short silences, so that only their number proves anything."""
        return self.hurried > 0 and not self.changes

    def can_hurry(self, others: int, took: int, within: int) -> bool:
        """Return whether short silences prove the reply sooner: it soon comes more often than `others` can bring it.

        More than `MOST_HURRIED` further replies take longer on a line that loses replies.
        """
        more, each = 1 + others - self.equal, self.quickest + short_silence(took, within)
        return not self.changes and more <= MOST_HURRIED and more * each <= self.quickest + silence(took, within)


def silence(took: int, within: int) -> int:
    """Return how long the line has to be silent after a reply in doubt: as long as the reply took, or `within` / 8."""
    return max(took, within // 8)


def short_silence(took: int, within: int) -> int:
    """Return how long the line has to be silent where the number of equal replies counts: as long as the reply took.

    It is 1/64 of `within` at least, so that further replies in the same piece of bytes are noticed.
    """
    return max(min(took, within // 8), within // 64)


def content_of(results: dict[str, Any], reply: FrameValue) -> object:
    """Return the content of a reply and the results, for comparison."""
    return reply.raw, [one.raw if type(one) is FrameValue else one for one in results.values()]


def is_begun_again(x: Exchange, request: OpenRequest) -> bool:
    """Return whether an exchange asks for the same as an earlier request."""
    given, asked = x.request, request.asked
    if type(given) is not FrameValue or asked is None or given.frame != asked.frame:
        return False
    return all(asked.fields.get(name) == value for name, value in given.fields.items())

"""What a job table judges by its profile alone: words of failed transfers, and how many commands a scan takes.

Neither knows what a job is.
"""

from __future__ import annotations

from framekit.blocks.block_status import Failure
from framekit.blocks.jobs.profile import OTHERWISE, JobProfile
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression


class FailureWords:
    """The words of failed transfers, by the profile's outcomes."""

    def __init__(self, profile: JobProfile) -> None:
        self._outcomes = profile.outcomes
        self._unknown = profile.words["closed"]
        self._words = {name: compile_expression(one.word) for name, one in profile.outcomes.items()}

    def word_of(self, failure: Failure) -> tuple[int, bool]:
        """The word, and whether the failure counts as a completed transfer. A device's code makes it a refusal."""
        name = failure.outcome if failure.outcome in self._words else OTHERWISE
        if failure.device_code is not None and "refused" in self._words:
            name = "refused"
        try:
            word = int(self._words[name](Names({"code": failure.device_code or 0}))) & 0xFFFF
        except EVALUATION_ERRORS:
            word = 0
        return word or self._unknown, self._outcomes[name].completed


class CommandLimit:
    """At most `most` commands a scan; scans of `scan` ns count from `origin`."""

    def __init__(self, most: int, scan: int, origin: int) -> None:
        self._most, self._scan, self._origin = most, scan, origin
        self._current, self._taken = -1, 0

    def room_at(self, now: int) -> int:
        """When one more can be taken: now, or with the next scan."""
        current = (now - self._origin) // self._scan
        full = current == self._current and self._taken >= self._most
        return self._origin + (current + 1) * self._scan if full else now

    def takes(self, now: int) -> bool:
        """Counts one more; whether it is not one too many."""
        current = (now - self._origin) // self._scan
        if current != self._current:
            self._current, self._taken = current, 0
        self._taken += 1
        return self._taken <= self._most

"""Alarms of clocks: one call that is moved again and again, as whoever waits for a reply needs it.

They know their clock only as something that can be asked for calls.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from framekit.definition.times import NEVER

if TYPE_CHECKING:
    from framekit.transport.clock import Callback, Clock, Handle


class ExactAlarm:
    """Asks for nothing that is not wanted any more, so that a virtual clock has no calls in which nothing happens."""

    def __init__(self, clock: Clock, callback: Callback) -> None:
        self._clock = clock
        self._callback = callback
        self._call: Handle | None = None
        self._when = NEVER

    def set(self, when: int) -> None:
        if when == self._when:
            return
        self._when = when
        if self._call is not None:
            self._call.cancel()
        self._call = self._clock.call_at(when, self._ring) if when < NEVER else None

    def cancel(self) -> None:
        self.set(NEVER)

    def _ring(self) -> None:
        self._call, self._when = None, NEVER
        self._callback()


class LateAlarm:
    """Lets an earlier call come, and only then asks for the one that is wanted: most are moved before they come."""

    def __init__(self, clock: Clock, callback: Callback) -> None:
        self._clock = clock
        self._callback = callback
        self._call: Handle | None = None
        self._asked_for = NEVER
        self._when = NEVER

    def set(self, when: int) -> None:
        self._when = when
        if when < self._asked_for:
            if self._call is not None:
                self._call.cancel()
            self._asked_for = when
            self._call = self._clock.call_at(when, self._ring)

    def cancel(self) -> None:
        if self._call is not None:
            self._call.cancel()
        self._call, self._asked_for, self._when = None, NEVER, NEVER

    def _ring(self) -> None:
        """However late it is: a time after the one that has come gets a call of its own, others may come before it."""
        came = self._asked_for
        self._call, self._asked_for = None, NEVER
        when = self._when
        if when > came:
            self.set(when)
        else:
            self._when = NEVER
            self._callback()

"""The end of the dealings on a line: what runs is waited for, then an open session is closed, then it is told.

It begins nothing while an exchange runs or waits. How long that may take is for others to say.
"""

from __future__ import annotations

from collections.abc import Callable

from framekit.link.lanes import Lanes
from framekit.link.machine import Machine
from framekit.link.output import Output


class Farewell:
    """Closes the session when asked to, once the lane is free."""

    def __init__(self, machine: Machine, lanes: Lanes, output: Output) -> None:
        self.machine = machine
        self.lanes = lanes
        self.output = output
        self._on_done: Callable[[], None] | None = None

    def ask(self, on_done: Callable[[], None]) -> None:
        """Asks for the end; `on_done` is called once, when no session is open and the last byte has left."""
        self._on_done = on_done

    def go_on(self) -> bool:
        """Does the next thing there is to do now. False when there is nothing, or something has to end first."""
        if self._on_done is None:
            return False
        session = self.machine.session
        if session.session is None or not (session.is_open or session.busy):
            if self.output.outgoing is not None or self.output.pending or self.machine.late.items:
                return False
            self.machine.callbacks.append(self._on_done)
            self._on_done = None
            return True
        if session.busy or not self.lanes.is_free:
            return False
        if not session.session.close:
            session.end()
            return True
        return self.lanes.begin_sequences("close", session.session.close, session.station) is not None

"""Sessions of the live display; each verb with a display has its own class."""

from __future__ import annotations

from typing import TYPE_CHECKING

from framekit.table_of_extras import OPTIONS, load

if TYPE_CHECKING:
    from framekit.api.monitor import LiveView


class LiveSession:
    """A session to be watched, for `duration` ns or until it is ended."""

    lost = False
    """Whether data that should have been kept is lost."""
    failure: Exception | None = None
    """Reason why the session could not continue."""
    controls = False
    """Whether it accepts control lines."""

    def __init__(self, title: str, duration: int | None) -> None:
        self.title = title
        self.duration = duration
        self.problems: list[str] = []
        self.view: LiveView | None = None

    def control(self, line: str) -> str:
        """Execute a control line; return the reason if it is refused, else ''."""
        raise NotImplementedError

    def begin(self) -> LiveView:
        """Begin the session and return its view; called inside the loop."""
        raise NotImplementedError

    def step(self, duration: int) -> None:
        """Advance the session by real time (ns)."""

    @property
    def is_over(self) -> bool:
        """Return whether its time is over, or it has failed."""
        late = self.duration is not None and self.view is not None and self.view.elapsed >= self.duration
        return late or self.failure is not None

    async def end(self) -> None:
        raise NotImplementedError


def show(session: LiveSession) -> int:
    """Show a session on the live display of the extra; return the exit status. Raises VerbError, DefinitionError."""
    return int(load(OPTIONS["--screen"])(session))

"""The live display: `show` opens it for a session, or says what is missing for it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from framekit.cli.common import VerbError, WordsError

if TYPE_CHECKING:
    from framekit.api.monitor import LiveView


class LiveSession:
    """Something that can be watched, for `duration` ns or until it is ended.

    `problems` is told when it is over; `lost`: something is lost that should have been kept; `failure`: why it could
    not go on; `controls`: it takes control lines.
    """

    lost = False
    failure: Exception | None = None
    controls = False

    def __init__(self, title: str, duration: int | None) -> None:
        self.title = title
        self.duration = duration
        self.problems: list[str] = []
        self.view: LiveView | None = None

    def control(self, line: str) -> str:
        """Carries a control line out; why not, when it cannot be."""
        raise NotImplementedError

    def begin(self) -> LiveView:
        """Called inside the loop; what is to be shown, which is `view` from then on."""
        raise NotImplementedError

    def step(self, duration: int) -> None:
        """So much real time (ns) has passed."""

    @property
    def is_over(self) -> bool:
        """Whether its time is up, or it could not go on."""
        late = self.duration is not None and self.view is not None and self.view.elapsed >= self.duration
        return late or self.failure is not None

    async def end(self) -> None:
        raise NotImplementedError


MISSING = (
    "the live display needs textual – install framekit with the extra 'screen': pip install '.[screen]' in its folder"
)


NO_TERMINAL = "the live display wants a terminal, and this is none – leave --screen out"


def has_terminal() -> bool:
    """Whether what the display is drawn on, the standard error, is a terminal."""
    return sys.__stderr__ is not None and sys.__stderr__.isatty()


def show(session: LiveSession) -> int:
    """Until its time is over or the user quits. Raises VerbError, DefinitionError."""
    try:
        from framekit.cli.screen.app import MonitorApp
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("textual", "rich"):
            raise
        raise VerbError(MISSING) from None
    if not has_terminal():
        raise WordsError(NO_TERMINAL)
    app = MonitorApp(session)
    app.run()
    failure = app.failure or session.failure
    if failure is not None:
        from framekit.definition.problems import DefinitionError

        if isinstance(failure, DefinitionError):
            raise failure
        raise failure if isinstance(failure, VerbError) else VerbError(str(failure))
    for problem in session.problems:
        print(problem, file=sys.stderr)
    return 1 if session.lost else 0

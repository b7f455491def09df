"""The live display: `show` opens it for a session, or reports a missing library."""

from __future__ import annotations

import sys

from framekit.cli.common import VerbError, WordsError
from framekit.cli.live_session import LiveSession

MISSING = (
    "the live display needs textual – install framekit with the extra 'screen': pip install '.[screen]' in its folder"
)


NO_TERMINAL = "the live display wants a terminal, and this is none – leave --screen out"


def has_terminal() -> bool:
    """Return whether the standard error, which the display uses, is a terminal."""
    return sys.__stderr__ is not None and sys.__stderr__.isatty()


def show(session: LiveSession) -> int:
    """Show a session until its time is over or the user quits; return the exit status.

    Raises VerbError, DefinitionError.
    """
    try:
        from framekit.extras.screen.app import MonitorApp
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

"""Opens the live display, or says what is missing for it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from framekit.cli.main import Failure

if TYPE_CHECKING:
    from framekit.cli.screen.session import MonitorSession, RunSession

MISSING = "the live display needs textual – install framekit with the extra 'screen'"


def show(session: RunSession | MonitorSession) -> int:
    """Until its time is over or somebody quits. Raises Failure, DefinitionError."""
    try:
        from framekit.cli.screen.app import MonitorApp
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("textual", "rich"):
            raise
        raise Failure(MISSING) from None
    app = MonitorApp(session)
    app.run()
    if app.failure is not None:
        from framekit.definition.problems import DefinitionError

        if isinstance(app.failure, DefinitionError):
            raise app.failure
        raise Failure(str(app.failure))
    for problem in session.problems:
        print(problem, file=sys.stderr)
    return 0

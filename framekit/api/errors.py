"""Errors of the API. Each is also a subclass of the matching standard error, so callers need not know these names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from framekit.codec.shown import code_text
from framekit.link.events import NO_REPLY

if TYPE_CHECKING:
    from framekit.link.services.client import TransferResult
    from framekit.run.block_state import ErrorCode

BAD_REPLIES = ("damaged_reply", "unfit_reply", "exhausted")
CLOSED = ("closed",)
REFUSED = "refused"


class FramekitError(Exception):
    """Base class of all errors of the API. A wrong file raises `DefinitionError`, which is a ValueError."""


class RequestError(FramekitError, ValueError):
    """An impossible request: an address, a value, a parameter or a station that does not fit. No request was sent."""


class ExchangeError(FramekitError):
    """An exchange that failed.

    `outcome` is its name (`no_reply`, `refused` …, or an outcome of the protocol), `error_code` framekit's code of it,
    `cause` a description. `written` counts the elements known to be written in spite of the failure.
    """

    def __init__(self, message: str, outcome: str = "", cause: str = "", written: int = 0) -> None:
        super().__init__(message)
        self.outcome = outcome
        self.cause = cause
        self.written = written

    @property
    def error_code(self) -> ErrorCode:
        """Return framekit's code of the outcome (docs/error-codes.md)."""
        from framekit.run.block_state import error_code

        return error_code(self.outcome)


class NoReplyError(ExchangeError, TimeoutError):
    """No reply came in time, after all repeats, or a station on the way reported that no answer came."""


class ReplyError(ExchangeError):
    """The reply was damaged or does not fit the request; no part of it is used."""


class RefusedError(ExchangeError):
    """The device answered with an error: its `code`, and the `meaning` the protocol gives that ('' if none)."""

    def __init__(self, message: str, code: int, meaning: str, outcome: str = "refused", written: int = 0) -> None:
        super().__init__(message, outcome, meaning, written)
        self.code = code
        self.meaning = meaning


class LineClosedError(ExchangeError, ConnectionError):
    """The port could not be opened, or was closed or lost."""


def error_of(result: TransferResult, trouble: str = "") -> ExchangeError:
    """Return the error of a failed transfer. `trouble`: failure of a simulated device meanwhile."""
    from framekit.run.block_state import error_table

    more = f" – {trouble}" if trouble else ""
    if result.code is not None and result.outcome not in NO_REPLY:
        meaning = f": {result.meaning}" if result.meaning else ""
        return RefusedError(
            f"the device refused with code {code_text(result.code)}{meaning}{more}",
            result.code, result.meaning, result.outcome, result.written,
        )  # fmt: skip
    kind: type[ExchangeError] = ExchangeError
    row = error_table().get(result.outcome)
    text = result.outcome.replace("_", " ") if row is None else row.meaning
    if result.outcome in NO_REPLY:
        kind, text = NoReplyError, "the device did not answer"
    elif result.outcome in CLOSED:
        kind, text = LineClosedError, "the line was closed"
    elif result.outcome in BAD_REPLIES:
        kind = ReplyError
    elif result.outcome == REFUSED:
        text = "the device refused"
    cause = result.cause or result.meaning
    return kind(text + (f": {cause}" if cause else "") + more, result.outcome, cause, result.written)

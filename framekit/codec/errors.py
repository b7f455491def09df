"""Define the errors of codecs: a faulty frame, and values that cannot be sent.

Standalone generated modules contain a copy of these classes, so this module imports no other module of framekit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any


class FrameError(ValueError):
    """Report bytes that are not a valid frame of the expected kind.

    `cause` is one of: check, parity, framing, overrun, constant, where, digits, value, range, require, short, too_long,
    length, surplus, cut.
    """

    def __init__(
        self,
        cause: str,
        segment: str,
        offset: int,
        expected: str = "",
        found: str = "",
        refuse: int | None = None,
        fields: Mapping[str, Any] | None = None,
    ) -> None:
        wanted = f", expected {expected}" if expected else ""
        super().__init__(f"{segment} at byte {offset}: {cause}{wanted}" + (f", found {found}" if found else ""))
        self.cause = cause
        self.segment = segment
        """The name or kind of the faulty segment."""
        self.offset = offset
        """The offset of its first byte in the frame."""
        self.expected = expected
        self.found = found
        self.refuse = refuse
        """The code with which a server refuses the frame; None for a frame that is only bad."""
        self.fields: dict[str, Any] = dict(fields or {})
        """The values that were read before the fault."""
        self.also: FrameError | None = None
        """The first other fault, in addition to a wrong check code."""


class Misread(FrameError):  # noqa: N818 - its base class has the suffix
    """A FrameError that determines its fault on demand, since most callers only test whether a frame fits.

    It is raised only for frames that are never refused, as `refuse` must be known in advance.
    """

    def __init__(self, frame: str, diagnose: Callable[..., Any], data: bytes, ctx: Mapping[str, Any]) -> None:
        ValueError.__init__(self)
        self.refuse = None
        self._read = frame, diagnose, bytes(data), ctx

    def __getattr__(self, name: str) -> Any:
        if name not in ("cause", "segment", "offset", "expected", "found", "fields", "also"):
            raise AttributeError(name)
        frame, diagnose, data, ctx = self._read
        error: FrameError = diagnose(data, ctx).error(frame)
        self.args = error.args
        vars(self).update(vars(error))
        return vars(self)[name]

    def __str__(self) -> str:
        return str(self.args[0]) if self.cause else ""


class EncodeError(ValueError):
    """Report values that a frame cannot carry."""

    def __init__(self, field: str, message: str, more: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.field = field
        """The path of the faulty value; '' for the frame as a whole."""
        self.more = more
        """The paths of further missing values."""

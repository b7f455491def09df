"""Define the errors of codecs: a faulty frame, and values that cannot be sent.

Standalone generated modules contain a copy of these classes, so this module imports no other module of framekit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any


class FrameError(ValueError):
    """Bytes that are not the frame they were read as.

    `cause` is one of: check, parity, framing, overrun, constant, where, digits, value, range, require, short, too_long,
    length, surplus, cut. `segment` is the name or kind of what is wrong, `offset` its first byte in the frame,
    `refuse` the code the frame is to be refused with (None: it is just bad), `fields` what was read before the fault.
    `also`: the first other fault beside a wrong check code.
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
        self.offset = offset
        self.expected = expected
        self.found = found
        self.refuse = refuse
        self.fields: dict[str, Any] = dict(fields or {})
        self.also: FrameError | None = None


class Misread(FrameError):  # noqa: N818 - what it is a case of says so
    """A FrameError that finds out what is wrong when asked: most are only asked whether a frame fits.

    Only for frames that are never refused; that alone is known without reading.
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
    """Values that a frame cannot carry; `field` is the path of the value at fault, '' for the frame as a whole.

    `more`: the paths of others that are missing like it.
    """

    def __init__(self, field: str, message: str, more: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.field = field
        self.more = more

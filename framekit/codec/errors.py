"""What codecs raise: a frame that is not as it should be, and values that cannot be sent.

Generated modules that stand alone hold a copy of these classes, so nothing here may import anything of framekit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class FrameError(ValueError):
    """Bytes that are not the frame they were read as.

    `cause` is one of: check, parity, framing, overrun, constant, where, digits, value, range, require, short, too_long,
    length, surplus, cut. `segment` is the name or kind of what is wrong, `offset` its first byte in the frame,
    `refuse` the code the frame is to be refused with (None: it is just bad), `fields` what was read before the fault.
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


class EncodeError(ValueError):
    """Values that a frame cannot carry; `field` is the path of the value at fault, '' for the frame as a whole."""

    def __init__(self, field: str, message: str) -> None:
        super().__init__(message)
        self.field = field

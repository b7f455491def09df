"""What a device remembers whoever talks to it: its variables of scope `device`, and its clock.

Several engines play one device when it serves several connections at once; all of them look into the same one of these.
"""

from __future__ import annotations

from framekit.link.clock import DeviceClock
from framekit.link.evaluate import Names


class DeviceState(Names):
    """Variables of scope `device` by name, put in by the first engine that has this one.

    `changes` grows whenever one of them changes; `clock` is None until an engine has begun.
    """

    __slots__ = ("changes", "clock")

    def __init__(self) -> None:
        super().__init__()
        self.changes = 0
        self.clock: DeviceClock | None = None

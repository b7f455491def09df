"""What can go wrong with device memory, as exceptions a caller can tell apart.

Servers turn them into their protocol's codes, blocks into status words; nothing here knows either.
"""

from __future__ import annotations


class DeviceMemoryError(Exception):
    """Any refusal of the device memory."""


class UnknownAreaError(DeviceMemoryError, LookupError):
    """There is no area of that name."""


class MemoryRangeError(DeviceMemoryError, IndexError):
    """A place beyond the area."""


class AccessError(DeviceMemoryError):
    """A write to an area that is read-only for others."""


class MemoryValueError(DeviceMemoryError, ValueError):
    """A value that does not fit its place."""


class SnapshotError(DeviceMemoryError, ValueError):
    """A snapshot of another shape, or a damaged one."""

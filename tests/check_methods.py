"""Create check methods from parameters, for tests."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from framekit.definition.model.checks import CheckMethod, ready_methods


def from_ready(ready: str, /, **overrides: Any) -> CheckMethod:
    """Return the method named `ready` with other parameters. Raises KeyError, or ValueError for contradictions."""
    return _sound(replace(ready_methods()[ready], **overrides))


def from_crc(name: str, *, init: int, **parameters: Any) -> CheckMethod:
    """Return a CRC with these catalogue parameters. Raises ValueError for contradictions."""
    return _sound(CheckMethod(name=name, kind="crc", initial=init, **parameters))


def _sound(method: CheckMethod) -> CheckMethod:
    fault = method.fault()
    if fault is not None:
        raise ValueError(fault)
    return method

"""Values of frames as people and JSON write them, where nothing is known of their fields."""

from __future__ import annotations

from typing import Any


def shown(value: Any) -> Any:
    """JSON-ready values: bytes as upper-case hex pairs, the rest as it is."""
    if isinstance(value, (bytes, bytearray)):
        return value.hex(" ").upper()
    if isinstance(value, dict):
        return {name: shown(item) for name, item in value.items()}
    if isinstance(value, list):
        return [shown(item) for item in value]
    return value

"""Loaders: from nodes with positions to the model. They resolve every reference and collect every problem."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from framekit.definition.load.protocol import load_protocol, load_protocol_text

__all__ = ["load_protocol", "load_protocol_text"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(name)
    from framekit.definition.load import protocol  # what reads single keys needs no loader of files

    return getattr(protocol, name)

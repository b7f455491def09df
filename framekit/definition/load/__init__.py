"""Loaders: from nodes with positions to the model. They resolve every reference and collect every problem."""

from framekit.definition.load.library import load_protocol, load_protocol_text

__all__ = ["load_protocol", "load_protocol_text"]

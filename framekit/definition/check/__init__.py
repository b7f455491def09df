"""The checker: what can be known to be wrong before anything runs, from the model alone (reference, section 14)."""

from framekit.definition.check.protocol import check_protocol

__all__ = ["check_protocol"]

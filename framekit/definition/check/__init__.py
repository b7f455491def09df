"""The checker: what can be known to be wrong before anything runs, from the model alone (guide: checker)."""

from framekit.definition.check.protocol import check_protocol

__all__ = ["check_protocol"]

"""Names that are not fields: the caller's context, start values of parameters and state, tables.

Expressions look a name up in `Names` if the frame has no such field. This module knows no frames and no bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.codec.evaluate import MissingName

CONTEXT_KEY = "_context"
"""The context entry in which `ConstructCodec` passes a whole mapping to construct."""


class Names:
    """Lookup of names that are not fields: given values, then start values, then tables."""

    def __init__(self, given: Mapping[str, Any], known: Mapping[str, Any] | Names) -> None:
        self.given = given
        self.known = known

    def __getitem__(self, name: str) -> Any:
        """Return the value of `name`. Raises MissingName."""
        try:
            return self.given[name]
        except KeyError:
            pass
        try:
            return self.known[name]
        except KeyError:
            raise MissingName(name) from None

    def is_unset(self, name: str) -> bool:
        """Return whether the context has the name without a value yet."""
        try:
            return self[name] is None
        except MissingName:
            return False

    @classmethod
    def of_params(cls, params: Mapping[str, Any], known: Mapping[str, Any]) -> Names:
        """Return the names from the keyword arguments of `parse` and `build`, or from the mapping of a codec."""
        return cls(params.get(CONTEXT_KEY, params), known)

"""Who keeps loaded definitions, and the code made of them, from one process to the next; usually nobody does.

Imported by commands that have to be quick. How something is kept is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, ModuleType
from typing import TYPE_CHECKING
from typing import Protocol as Interface

if TYPE_CHECKING:
    from framekit.definition.model.protocol import Protocol
    from framekit.definition.sources import Sources


class Keeper(Interface):
    """Keeps definitions by the file they are loaded from, and their code."""

    def loaded(self, path: Path) -> tuple[Protocol, Sources] | None:
        """What loading the file would give now, and what it was read from; None: it has to be loaded."""

    def was_loaded(self, path: Path, protocol: Protocol, sources: Sources) -> None:
        """Told of everything that had to be loaded."""

    def module(self, protocol: Protocol) -> ModuleType:
        """The module of a definition's frames. Raises DefinitionError."""

    def code(self, protocol: Protocol, what: str, make: Callable[[], CodeType]) -> CodeType:
        """Other code made of a definition, called `what`: kept from before, or made now."""


current: Keeper | None = None
"""Whom those who load and compile ask first."""


@contextmanager
def kept_by(keeper: Keeper | None) -> Iterator[None]:
    """What is loaded and compiled inside is kept by this one."""
    global current
    before, current = current, keeper
    try:
        yield
    finally:
        current = before

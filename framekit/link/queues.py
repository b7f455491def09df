"""Queues between lanes."""

from __future__ import annotations

from collections import deque
from typing import Any

from framekit.definition.model.protocol import Protocol


class QueueFull(OverflowError, ValueError):  # noqa: N818 - says what is the case
    """An item was put into a queue that has no room."""


class Queues:
    """The queues of an engine, by name."""

    def __init__(self, protocol: Protocol) -> None:
        self._items: dict[str, deque[Any]] = {name: deque() for name in protocol.queues}
        self._sizes = {name: queue.size for name, queue in protocol.queues.items()}

    def put(self, name: str, item: Any) -> None:
        """Raises QueueFull, KeyError."""
        if self.full(name):
            raise QueueFull(f"the queue '{name}' is full")
        self._items[name].append(item)

    def take(self, name: str) -> Any:
        """The oldest item. Raises IndexError when there is none."""
        return self._items[name].popleft()

    def first(self, name: str) -> Any:
        """The oldest item, left where it is."""
        return self._items[name][0]

    def empty(self, name: str) -> bool:
        return not self._items[name]

    def full(self, name: str) -> bool:
        return len(self._items[name]) >= self._sizes[name]

    def clear(self) -> None:
        for items in self._items.values():
            items.clear()

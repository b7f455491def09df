"""Reads where a run keeps its state: `state: FILE`, or the file, the areas that are kept, how often it is written.

What is in the file is not known here.
"""

from __future__ import annotations

from framekit.blocks.model import KeptState
from framekit.definition.load.reader import Reader
from framekit.definition.nodes import Mapping, Node
from framekit.definition.problems import did_you_mean
from framekit.memory.profile import MemoryProfile

EVERY, SHORTEST = 1_000_000_000, 100_000_000


def read_state(reader: Reader, node: Node, profile: MemoryProfile | None) -> KeptState:
    """Raises Broken when it names no file, or a time that is none; other problems are noted. No profile, no areas."""
    keys = node if isinstance(node, Mapping) else None
    file = reader.text(node if keys is None else keys.get("file"))
    areas = () if profile is None else _areas(reader, None if keys is None else keys.get("keep"), profile)
    every = None if keys is None else reader.maybe(lambda time: _time(reader, time), keys.get("every"))
    return KeptState(file=file, areas=areas, every=every or EVERY, at=node.at)


def _areas(reader: Reader, node: Node | None, profile: MemoryProfile) -> tuple[str, ...]:
    """The areas that are kept."""
    if node is None:
        return retained(profile)
    areas = []
    for item in reader.items(node):
        with reader.going_on():
            areas.append(_area(reader, item, profile))
    return tuple(areas)


def retained(profile: MemoryProfile) -> tuple[str, ...]:
    """The areas that a profile calls retained; if it calls none so, all that others may write."""
    named = tuple(area.name for area in profile.areas.values() if area.retained)
    return named or tuple(area.name for area in profile.areas.values() if area.access == "rw")


def _area(reader: Reader, node: Node, profile: MemoryProfile) -> str:
    name = reader.text(node)
    for area in profile.areas.values():
        if name == area.name or name in area.aliases:
            return area.name
    todo = did_you_mean(name, profile.areas) or f"known: {', '.join(sorted(profile.areas))}"
    raise reader.broken(node.at, f"the memory has no area '{name}'", todo)


def _time(reader: Reader, node: Node) -> int:
    every = reader.time(node)
    if every < SHORTEST:
        raise reader.broken(node.at, "a file is not written more often than every 100 ms", "write it like 1 s")
    return every

"""Entry points of installed packages, without `importlib.metadata` where no package names any.

Importing that module, and letting it parse the metadata of every installed package, takes longer than the rest of
`framekit decode`. Most installations have no package with entry points for framekit; a look at the metadata files is
enough to know.
"""

from __future__ import annotations

import os
import sys
from functools import lru_cache
from importlib.machinery import PathFinder
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

METADATA = (".dist-info", ".egg-info")
"""Suffixes of the folders with the metadata of packages."""


def entry_points_of(group: str) -> list[EntryPoint]:
    """Return the entry points of a group, in the order of their packages on `sys.path`."""
    if not may_name(group):
        return []
    from importlib.metadata import entry_points

    return list(entry_points(group=group))


def may_name(group: str) -> bool:
    """Return False if certainly no installed package names an entry point of the group."""
    if any(finder is not PathFinder and hasattr(finder, "find_distributions") for finder in sys.meta_path):
        return True  # packages may be elsewhere than in the folders of sys.path
    places = []
    for entry in sys.path:
        try:
            places.append((entry or ".", os.stat(entry or ".").st_mtime_ns))
        except OSError:
            continue
    metadata = _metadata(tuple(places))
    return metadata is None or f"[{group}]" in metadata


@lru_cache(1)
def _metadata(places: tuple[tuple[str, int], ...]) -> str | None:
    """Return the text of all `entry_points.txt` in these folders; None if one of the places is an archive.

    The times at which the places were changed are part of the key, as in `importlib.metadata`.
    """
    found = []
    for place, _ in places:
        if not os.path.isdir(place):
            return None
        for name in os.listdir(place):
            if name.lower().endswith(METADATA) or name.lower() == "egg-info":
                try:
                    with open(os.path.join(place, name, "entry_points.txt"), encoding="utf-8") as file:
                        found.append(file.read())
                except OSError:
                    continue
    return "\n".join(found)

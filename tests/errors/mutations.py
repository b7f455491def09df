"""Mutated definition files: nodes deleted, duplicated, exchanged or replaced by typical mistakes."""

from __future__ import annotations

import copy
import random
from typing import Any

import yaml

REPLACEMENTS: list[Any] = [
    "", "0", "-1", "300", "0x", "99999999999", "1.5", "yes", "never", "3 s", "1..0", "5..9", "rest", "x", "it", "a.b",
    "max(", "h'0'", "'text'", "a if b", "[1, 2]", "{area}{start:dec}", "ENQ", "0G", "..", "../x", "first..last", "*",
    "next", "resend", "again", "end", "expected", "u8", "ascii", "sum8", "request", "station", "name", "\u20ac",
    [], {}, ["x"], {"x": "y"}, [{}], {"frame": "x"}, [["x"]], {"const": "00"}, {"then": "next"},
    {"field": "n", "type": "u8"},
]  # fmt: skip


def places(tree: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all nodes below the root."""
    found: list[tuple[Any, ...]] = []
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        found.append((*path, key))
        found += places(value, (*path, key))
    return found


def mutated(tree: Any, choose: random.Random) -> Any:
    """Return a copy of a tree with one to three changes."""
    tree = copy.deepcopy(tree)
    for _ in range(choose.choice([1, 1, 1, 2, 3])):
        paths = places(tree)
        if paths:
            _change(tree, choose.choice(paths), paths, choose)
    return tree


def _change(tree: Any, path: tuple[Any, ...], paths: list[tuple[Any, ...]], choose: random.Random) -> None:
    holder = at(tree, path[:-1])
    key = path[-1]
    kind = choose.choice(["delete", "replace", "replace", "exchange", "rename", "double"])
    if kind == "delete":
        del holder[key]
    elif kind == "replace":
        holder[key] = copy.deepcopy(choose.choice(REPLACEMENTS))
    elif kind == "exchange":
        holder[key] = copy.deepcopy(at(tree, choose.choice(paths)))
    elif kind == "rename" and isinstance(holder, dict):
        other = choose.choice(paths)[-1]
        holder[str(choose.choice([other, "x", "", "name", f"{key}x"]))] = holder.pop(key)
    elif isinstance(holder, list):
        holder.insert(key, copy.deepcopy(holder[key]))
    else:
        holder[f"{key}_2"] = copy.deepcopy(holder[key])


def at(tree: Any, path: tuple[Any, ...]) -> Any:
    """Return the node at a path."""
    for key in path:
        tree = tree[key]
    return tree


def dumped(tree: Any) -> str:
    """Return YAML of a tree. Thousands of trees are dumped, so the C writer is used if it is available."""
    writer = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    return str(yaml.dump(tree, Dumper=writer, sort_keys=False, allow_unicode=True))

"""Reads `sinks:`, the destinations of a run's values, each of a kind of `framekit.sinks`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from framekit.definition.keys import read_keys
from framekit.definition.load.documents import without_effect
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Mapping, Node, unread
from framekit.definition.problems import Position, did_you_mean
from framekit.definition.times import NEVER
from framekit.run.model import Point
from framekit.runfile.channels import Attempts
from framekit.sinks import SINKS, SinkKind
from framekit.sinks.base import fits
from framekit.sinks.store import NetworkSink

SHORTEST = 100_000_000
"""Shortest period of a sink (ns); without a period each change is sent."""


def _of_period(kind: SinkKind) -> Iterator[tuple[str, str, str]]:
    if kind.every is not None and kind.every < SHORTEST:
        yield "every", "values are taken every 100 ms at most", "leave every out, or write 1 s"
    elif kind.every is not None and kind.every >= NEVER:
        yield "every", "no value would ever be taken", "leave every out, or write 1 s"


class SinksLoader:
    """Reads the sinks of the run in the file `path`.

    `points`: its points, or None if some are wrong; `names`: the names of all points. `state`: the file in which the
    run stores its state, if any.
    """

    def __init__(
        self, reader: Reader, path: Path, points: Sequence[Point] | None, names: Sequence[str], state: str = ""
    ) -> None:
        self.reader, self.folder, self.points = reader, path.parent, points
        folder, self.name = path.parent, path.name.removesuffix(path.suffix).removesuffix(".run")
        self.names = names
        self.taken: dict[str, str] = {os.path.abspath(folder / state): "where the state is kept"} if state else {}

    def load(self, node: Node | None) -> tuple[SinkKind, ...]:
        """Return the sinks. Problems are noted, and broken sinks are left out."""
        found = []
        for item in self.reader.items(node):
            with self.reader.going_on():
                found.append(self._sink(self.reader.mapping(item)))
        if node is not None and not self.names and self.points is not None:
            self.reader.note(node.at, "the run has no points whose values could go there", "add points:")
        return tuple(found)

    def _sink(self, keys: Mapping) -> SinkKind:
        words = [word for word in SINKS if word in keys]
        if len(words) != 1:
            raise Broken("the schema has told that this is no sink")
        part, attempts = SINKS[words[0]], Attempts()
        kind = part(**read_keys(part, self, keys, attempts.spoil, at=keys.at))
        self.reader.problems.extend(without_effect(entry, f"in a sink of {words[0]}") for _, entry in unread(keys))
        wrong = [*_of_period(kind)]
        if not attempts.spoilt:  # else a mistake could follow from a broken key
            wrong += kind.mistakes()
        if self.points is not None and not attempts.spoilt:
            wrong += kind.mistakes_with(self.points)
        if isinstance(kind, NetworkSink):
            wrong += kind.mistakes_of_store()
            if not kind.store:
                kind = replace(kind, store=self._own_file(f"{self.name}.{words[0]}.db", keys.at, "give store: a file"))
        for name, what, todo in wrong:
            self.reader.note((keys.value(name) or keys).at, what, todo)
        if attempts.spoilt:
            raise Broken(words[0])
        return kind

    def file(self, node: Node) -> str:
        """Return the path of a file; a relative name counts from the run's folder. Raise Broken for no file name.

        Note if another part of the run uses it.
        """
        name = self.reader.text(node).strip()
        if not name:
            raise self.reader.broken(node.at, "this is no file", "write a name")
        if Path(name).suffix in (".yaml", ".yml"):
            raise self.reader.broken(node.at, f"'{name}' is a name of definitions and runs", "name another file")
        return self._own_file(name, node.at, "name another file")

    def _own_file(self, name: str, at: Position, todo: str) -> str:
        """Return the path of a file; note if another part of the run uses it."""
        path = self.folder / name
        whole = os.path.abspath(path)
        if whole in self.taken:
            self.reader.note(at, f"'{name}' is {self.taken[whole]} already", todo)
        self.taken.setdefault(whole, f"the file of a sink in line {at.line}")
        return str(path)

    def patterns(self, node: Node) -> tuple[str, ...]:
        """Return names of points, with `*` for any text. Note patterns that match no point."""
        found = self.reader.texts(node)
        for item, pattern in zip(self.reader.items(node), found, strict=True):
            if self.names and not any(fits(pattern, name) for name in self.names):
                hint = did_you_mean(pattern, self.names)
                self.reader.note(item.at, f"no point is called '{pattern}'", hint)
        return found

"""Read definition files and join them by `extends`, `application` and `uses`.

A `SourceText` is a definition with its bases merged in, section by section, still as nodes. A file is searched next to
the definition, then in the searched folders. This module does not interpret the sections.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from collections.abc import Mapping as MappingOf
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import TypeVar

from framekit.definition.expression import place_of
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Entry, Mapping, Node, Scalar, is_cut, read_nodes, unread
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean
from framekit.definition.schema import Kind, validate, wrong_kind
from framekit.definition.sources import INSIDE, find_definition, leaves_folder, searched_folders

T = TypeVar("T")


def load_file(path: Path, kind: Kind, read: Callable[[Reader, Mapping], T]) -> T:
    """Return the result of `read` for the nodes of one file. Raise DefinitionError with all problems."""
    reader = Reader()
    documents = Documents(reader)
    found = None
    with suppress(Broken):
        found = read(reader, documents.root(path, kind))
    problems = documents.first_words(reader.problems, path)
    if found is None or any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return found


@dataclass(slots=True)
class SourceText:
    """A merged definition."""

    root: Mapping
    path: Path
    names: tuple[str, ...]
    """The names of its file and of its bases, by which other files refer to it."""
    files: tuple[str, ...]
    """The paths of its file and of its bases."""
    uses: MappingOf[str, SourceText] = field(default_factory=dict)
    application: SourceText | None = None

    @property
    def at(self) -> Position:
        return self.root.at

    def section(self, key: str) -> tuple[Entry, ...]:
        """Return the named entries of a section; empty if it is missing or not a mapping."""
        node = self.root.get(key)
        return node.read_all() if isinstance(node, Mapping) else ()


class Documents:
    """Reads the files of one load, each once; problems are noted in `reader`."""

    def __init__(self, reader: Reader) -> None:
        self.reader = reader
        self.roots: dict[Path, Mapping] = {}
        self.under_way: list[Path] = []
        """The files being read, outermost first."""
        self.schema_problems: set[Problem] = set()
        """The problems found by the schema and by the YAML reader."""
        self.refused: set[Position] = set()
        """The positions of problems of the schema."""
        self.cut: set[tuple[str, int]] = set()
        """The lines in which YAML has cut an expression."""
        self.found: set[tuple[str, Path, Path]] = set()
        """The names in references between files, each with the folder of the search and the resulting file."""

    def root(self, path: Path, kind: Kind = "protocol") -> Mapping:
        """Return the validated nodes of a file. Raise Broken if it cannot be read at all."""
        path = path.resolve()
        if path not in self.roots:
            doubles: list[Problem] = []
            begin = f"{kind}: NAME"
            try:
                node = read_nodes(path, doubles, begin=begin)
            except DefinitionError as error:
                self.reader.problems.extend(error.problems)
                raise Broken(str(path)) from None
            self.reader.problems.extend(doubles)
            self.schema_problems.update(doubles)
            wrong = wrong_kind(node, kind)
            if wrong is not None:
                self.reader.problems.append(wrong)
                raise Broken(str(path))
            problems = validate(node, kind)
            self.reader.problems.extend(problems)
            self.schema_problems.update(problems)
            self.refused.update(at for problem in problems for at in problem.places)
            self.cut.update((problem.at.file, problem.at.line) for problem in problems if is_cut(problem))
            if not isinstance(node, Mapping):
                raise Broken(str(path))
            self.roots[path] = self._with_areas(node)
        return self.roots[path]

    def _with_areas(self, root: Mapping) -> Mapping:
        """Return the file with a separate entry for each area of a list such as `PV, SL: {…}`."""
        areas = root.value("areas")
        if not isinstance(areas, Mapping) or not any("," in entry.key.text for entry in areas.entries):
            return root
        found: dict[str, Entry] = {}
        for entry in areas.entries:
            for part in re.finditer(r"[^,\s]+", entry.key.text):
                at = place_of(entry.key.at, part.start() + entry.key.quoted)
                if part[0] in found:
                    self.reader.note(at, f"there are two areas '{part[0]}'", "leave one of them out")
                found[part[0]] = Entry(replace(entry.key, text=part[0], at=at), entry.value)
        whole = Mapping(tuple(found.values()), areas.at, areas.flow)
        entries = [entry.holding(whole) if entry.value is areas else entry for entry in root.entries]
        return Mapping(tuple(entries), root.at, root.flow)

    def first_words(self, problems: list[Problem], file: Path | None = None) -> list[Problem]:
        """Return the problems, sorted and without duplicates or consequences.

        A problem of a loader is dropped if the schema reports its position, or if YAML has cut an expression in its
        line. In a `file` without errors, keys that no loader has read are problems too.
        """
        root = None if file is None else self.roots.get(file.resolve())
        if root is not None and all(problem.warning for problem in problems):
            problems = [*problems, *(without_effect(entry) for _, entry in unread(root))]
        return [
            problem
            for problem in sorted(set(problems))
            if problem in self.schema_problems
            or (problem.at not in self.refused and (problem.at.file, problem.at.line) not in self.cut)
        ]

    def find(self, name: Node, beside: Path) -> Path:
        """Return the file that a definition names: next to it, else in a searched folder. Raise Broken."""
        text = self.reader.text(name)
        if not text or leaves_folder(text, beside.parent):
            raise self.reader.broken(name.at, f"'{text}' leaves the definition's folder", INSIDE)
        found = find_definition(text, beside.parent)
        if found is None:
            raise self.reader.broken(name.at, f"there is no definition '{text}'", self._near(text, beside))
        self.found.add((text, beside.parent, found))
        return found

    def _near(self, text: str, beside: Path) -> str:
        folders = (beside.parent, *searched_folders())
        known = {file.stem for folder in folders for file in folder.glob("*.yaml") if "." not in file.stem}
        name = text.removesuffix(".yml").removesuffix(".yaml")
        return did_you_mean(name, known) or f"put {name}.yaml beside {beside.name}"

    def source(self, path: Path, named: Position | None = None) -> SourceText:
        """Return the definition in `path` with everything it extends and uses; `named`: the position of the reference.

        Raise Broken for cycles and missing files.
        """
        path = path.resolve()
        if path in self.under_way:
            chain = " → ".join(step.stem for step in [*self.under_way[self.under_way.index(path) :], path])
            at = self.roots[path].at if named is None else named
            what = f"definitions refer to each other in a circle: {chain}"
            raise self.reader.broken(at, what, "put what both need into a file of its own")
        root = self.root(path)
        self.under_way.append(path)
        try:
            return self._joined(root, path)
        finally:
            self.under_way.pop()

    def _joined(self, root: Mapping, path: Path) -> SourceText:
        names: tuple[str, ...] = (path.stem,)
        files: tuple[str, ...] = (str(path),)
        uses: dict[str, SourceText] = {}
        application: SourceText | None = None
        base = self._named(root.get("extends"), path)
        if base is not None:
            root = merged(base.root, root)
            names, files, uses = names + base.names, files + base.files, dict(base.uses)
            application = base.application
        used = [(name, self._named(name, path)) for name in self.reader.items(root.get("uses"))]
        own_uses: dict[str, SourceText] = {}
        for node, one in used:
            name = PurePosixPath(self.reader.text(node)).name.removesuffix(".yaml").removesuffix(".yml")
            if one is not None and own_uses.get(name, one).path != one.path:
                self.reader.note(node.at, f"there are two files '{name}' in uses", "give one of them another name")
            if one is not None:
                own_uses[name] = one
        uses |= own_uses
        own = self.roots[path]
        carried = own.get("application") if own.get("protocol") is not None else None
        application = self._named(carried, path) or application
        missing = (own.get("extends") is not None and base is None) or (carried is not None and application is None)
        if missing or any(one is None for _, one in used):
            raise Broken(str(path))  # nearly every name would be unknown without them
        return SourceText(root, path, names, files, uses, application)

    def _named(self, name: Node | None, path: Path) -> SourceText | None:
        """Return the definition that a node of `path` names; None without a node, or if the file cannot be read."""
        if name is None:
            return None
        with self.reader.going_on():
            return self.source(self.find(name, path), name.at)
        return None


def without_effect(entry: Entry, where: str = "here") -> Problem:
    """Return the problem of a key that no loader reads."""
    return Problem(entry.key.at, f"'{entry.key.text}' has no effect {where}", "remove it")


def merged(base: Mapping, own: Mapping) -> Mapping:
    """Return `own` on top of `base`: sections are joined by name, other keys are replaced."""
    sections = {entry.key.text: entry for entry in base.entries if entry.key.text != "extends"}
    for entry in own.entries:
        key = entry.key.text
        old = sections.get(key)
        if old is not None and isinstance(old.value, Mapping) and isinstance(entry.value, Mapping):
            depth = 2 if key in ("params", "state", "areas") else 1
            entry = entry.holding(joined(old.value, entry.value, depth))
        sections[key] = entry
    return Mapping(tuple(sections.values()), own.at)


def joined(base: Mapping, own: Mapping, depth: int) -> Mapping:
    """Return the entries of both.

    A key of `own` replaces the key of `base`, or is joined with it while `depth` exceeds 1.
    """
    entries = {entry.key.text: entry for entry in base.entries}
    for entry in own.entries:
        old = entries.get(entry.key.text)
        if depth > 1 and old is not None and isinstance(old.value, Mapping) and isinstance(entry.value, Mapping):
            entry = entry.holding(joined(old.value, entry.value, depth - 1))
        entries[entry.key.text] = entry
    return Mapping(tuple(entries.values()), own.at)


def scalar_of(node: Node | None) -> str | None:
    return node.text if isinstance(node, Scalar) else None

"""YAML as nodes with positions: every scalar is text, nothing has been given a meaning yet.

Files are refused here for what makes them no plain tree of names, lists and texts: bad syntax, double keys, tags, merge
keys, several documents, excessive size. What keys mean is not known here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from framekit.definition.problems import DefinitionError, Position, Problem
from framekit.definition.tree import Entry, Mapping, Node, Scalar, Sequence
from framekit.definition.yaml_syntax import QUOTE_EXPRESSION, syntax_problem

__all__ = ["Entry", "Mapping", "Node", "Scalar", "Sequence", "read_nodes", "read_text"]

LARGEST_FILE = 4 << 20
"""Bytes (or characters) of a file."""

DEEPEST = 64
"""Mappings and lists inside each other."""

MOST_EXPANDED = 100_000
"""Nodes of a tree in which aliases are replaced by what they stand for."""

_NOT_YAML = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_COLON = re.compile(r"\s*:")
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_nodes(source: Path, noted: list[Problem] | None = None) -> Node:
    """The nodes of a file. Raises DefinitionError with everything that can be told at once.

    What leaves a tree that can be read on, such as a double key, is put into `noted` instead, if that is given.
    """
    file = str(source)
    try:
        with source.open("rb") as stream:
            data = stream.read(LARGEST_FILE + 1)
    except OSError as error:
        line = 0 if isinstance(error, (FileNotFoundError, IsADirectoryError)) else 1
        raise DefinitionError([Problem(Position(file, line, line), *_unreadable(error))]) from None
    if len(data) > LARGEST_FILE:
        raise _too_large(file)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = len(data[data.rfind(b"\n", 0, error.start) + 1 : error.start].decode("utf-8")) + 1
        what = f"the byte {data[error.start]:02X} is not UTF-8"
        raise DefinitionError([Problem(Position(file, line, column), what, "save the file as UTF-8")]) from None
    return read_text(text, file, noted)


def read_text(text: str, file: str, noted: list[Problem] | None = None) -> Node:
    """The nodes of a text; `file` is its name in positions. Raises DefinitionError and notes like `read_nodes`."""
    text = text.removeprefix("\ufeff")
    if len(text) > LARGEST_FILE:
        raise _too_large(file)
    problems = list(_strange_characters(text, file))
    if problems:
        raise DefinitionError(problems)
    builder = _Builder(text, file)
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            builder.take(event)
    except yaml.YAMLError as error:
        builder.problems.append(syntax_problem(error, text, file))
    except _GivenUp:
        pass
    return builder.result(noted)


def _unreadable(error: OSError) -> tuple[str, str]:
    if isinstance(error, FileNotFoundError):
        return "there is no such file", "check its name and folder"
    if isinstance(error, IsADirectoryError):
        return "this is a folder, not a file", "name a file in it"
    if isinstance(error, PermissionError):
        return "the file may not be read", "change its permissions"
    return "the file cannot be read", (error.strerror or "").lower()


def _too_large(file: str) -> DefinitionError:
    what = f"the file is larger than {LARGEST_FILE >> 20} MB"
    return DefinitionError([Problem(Position(file, 1, 1), what, "split it with uses: or extends:")])


def _strange_characters(text: str, file: str) -> Iterator[Problem]:
    for match in _NOT_YAML.finditer(text):
        start = text.rfind("\n", 0, match.start()) + 1
        at = Position(file, text.count("\n", 0, start) + 1, match.start() - start + 1)
        what = f"the character U+{ord(match[0]):04X} cannot stand in YAML"
        yield Problem(at, what, "remove it; bytes are written as hex")


class _GivenUp(Exception):  # noqa: N818 - it only ends the reading; the problem has been noted
    """Reading on makes no sense."""


@dataclass(slots=True)
class _Open:
    """A mapping or list that has begun. `size` and `height` are those of the tree below it, aliases expanded."""

    at: Position
    is_mapping: bool
    flow: bool
    anchor: str | None
    items: list[Node] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)
    known: dict[str, Position] = field(default_factory=dict)
    key: Node | None = None
    key_end: int = 0
    size: int = 1
    height: int = 1


@dataclass(frozen=True, slots=True)
class _Anchored:
    node: Node
    size: int
    height: int


class _Builder:
    """Builds nodes from the parser's events, without recursion."""

    def __init__(self, text: str, file: str) -> None:
        self.text = text
        self.file = file
        self.problems: list[Problem] = []
        self.doubles: list[Problem] = []
        self.root: Node | None = None
        self.stack: list[_Open] = []
        self.anchors: dict[str, _Anchored] = {}
        self.documents = 0

    def result(self, noted: list[Problem] | None) -> Node:
        """The tree. Raises DefinitionError when anything was wrong; double keys are put into `noted` if that is all."""
        root = self.root
        if not self.problems and (root is None or (isinstance(root, Scalar) and not root.quoted and not root.text)):
            self.problems.append(Problem(Position(self.file, 1, 1), "the file is empty", "begin with protocol: NAME"))
        if self.problems or root is None or (self.doubles and noted is None):
            raise DefinitionError([*self.problems, *self.doubles])
        if noted is not None:
            noted.extend(self.doubles)
        return root

    def take(self, event: yaml.Event) -> None:
        """Goes on with one event. Raises _GivenUp."""
        match event:
            case yaml.ScalarEvent():
                self._scalar(event)
            case yaml.MappingStartEvent() | yaml.SequenceStartEvent():
                self._begin(event)
            case yaml.MappingEndEvent() | yaml.SequenceEndEvent():
                self._end(event)
            case yaml.AliasEvent():
                self._alias(event)
            case yaml.DocumentStartEvent():
                self._document(event)

    # ---- events -------------------------------------------------------------------------------------------

    def _document(self, event: yaml.Event) -> None:
        self.documents += 1
        if self.documents > 1:
            self._note(self._at(event), "a second document begins here", "keep one document a file")
            raise _GivenUp

    def _scalar(self, event: yaml.ScalarEvent) -> None:
        self._refuse_tag(event)
        quoted = event.style in ("'", '"')
        node = Scalar(event.value, self._at(event), quoted, not event.style and not event.value and self._no_colon())
        if event.anchor:
            self.anchors[event.anchor] = _Anchored(node, 1, 0)
        self._add(node, event, 1, 0)

    def _begin(self, event: yaml.CollectionStartEvent) -> None:
        self._refuse_tag(event)
        if len(self.stack) >= DEEPEST:
            self._note(self._at(event), f"this is nested deeper than {DEEPEST}", "give parts of it names of their own")
            raise _GivenUp
        is_mapping = isinstance(event, yaml.MappingStartEvent)
        self.stack.append(_Open(self._at(event), is_mapping, bool(event.flow_style), event.anchor))

    def _end(self, event: yaml.Event) -> None:
        done = self.stack.pop()
        node: Node
        if done.is_mapping:
            node = Mapping(tuple(done.entries), done.at, done.flow)
        else:
            node = Sequence(tuple(done.items), done.at, done.flow)
        if done.anchor:
            self.anchors[done.anchor] = _Anchored(node, done.size, done.height)
        self._add(node, event, done.size, done.height)

    def _alias(self, event: yaml.AliasEvent) -> None:
        at, name = self._at(event), event.anchor or ""
        if any(name == outer.anchor for outer in self.stack):
            self._note(at, f"'*{name}' stands inside what it repeats", "write out what is meant")
            raise _GivenUp
        target = self.anchors.get(name)
        if target is None:
            self._note(at, f"there is no '&{name}' that '*{name}' could repeat", "quote the value if '*' belongs to it")
            target = _Anchored(Scalar("", at), 1, 0)
        if sum(outer.size for outer in self.stack) + target.size > MOST_EXPANDED:
            self._note(at, f"with this alias the file has more than {MOST_EXPANDED} parts", "use no aliases")
            raise _GivenUp
        if len(self.stack) + target.height > DEEPEST:
            self._note(at, f"with this alias the file is nested deeper than {DEEPEST}", "write out what is meant")
            raise _GivenUp
        self._add(target.node, event, target.size, target.height)

    # ---- putting together ---------------------------------------------------------------------------------

    def _add(self, node: Node, event: yaml.Event, size: int, height: int) -> None:
        if not self.stack:
            self.root = node
            return
        outer = self.stack[-1]
        outer.size += size
        outer.height = max(outer.height, height + 1)
        if not outer.is_mapping:
            outer.items.append(node)
        elif outer.key is None:
            assert event.end_mark is not None
            outer.key, outer.key_end = node, event.end_mark.index
        else:
            key, outer.key = outer.key, None
            self._entry(outer, key, node)

    def _entry(self, outer: _Open, key: Node, value: Node) -> None:
        if not isinstance(key, Scalar):
            kind = "mapping" if isinstance(key, Mapping) else "list"
            self._note(key.at, f"a {kind} cannot be a key", "put the whole expression in quotes" if outer.flow else "")
            return
        if key.text == "<<" and not key.quoted:
            self._note(key.at, "merge keys (<<) are not known here", "write the keys out, or use extends:")
            return
        if key.text in outer.known:
            self._double(outer, key, value)
            return
        outer.known[key.text] = key.at
        outer.entries.append(Entry(key, value))

    def _double(self, outer: _Open, key: Scalar, value: Node) -> None:
        """Notes a key that stands twice. The first counts; two sections of a file are put together."""
        what = f"the key '{key.text}' stands here twice, first in line {outer.known[key.text].line}"
        if isinstance(value, Scalar) and value.absent:
            self._note(key.at, what, QUOTE_EXPRESSION)
            return
        self.doubles.append(Problem(key.at, what, "remove one of them"))
        place, first = next((at, one.value) for at, one in enumerate(outer.entries) if one.key.text == key.text)
        if outer is self.stack[0] and isinstance(first, Mapping) and isinstance(value, Mapping):
            both = _Open(first.at, True, first.flow, None)
            for entry in (*first.entries, *value.entries):
                self._entry(both, entry.key, entry.value)
            outer.entries[place] = Entry(outer.entries[place].key, Mapping(tuple(both.entries), first.at, first.flow))

    def _no_colon(self) -> bool:
        """Whether the key that waits for a value has no colon behind it."""
        outer = self.stack[-1] if self.stack else None
        return outer is not None and outer.key is not None and _COLON.match(self.text, outer.key_end) is None

    def _refuse_tag(self, event: yaml.ScalarEvent | yaml.CollectionStartEvent) -> None:
        if event.tag:
            tag = event.tag.replace("tag:yaml.org,2002:", "!!")
            what = f"the tag '{tag}' has no meaning here"
            self._note(self._at(event), what, "remove it, or quote the value if '!' belongs to it")

    def _at(self, event: yaml.Event) -> Position:
        mark = event.start_mark
        assert mark is not None  # every event of a parser has its marks
        return Position(self.file, mark.line + 1, mark.column + 1)

    def _note(self, at: Position, what: str, todo: str) -> None:
        self.problems.append(Problem(at, what, todo))


def without(node: Mapping, key: str) -> Mapping:
    """A mapping less one of its keys."""
    return Mapping(tuple(entry for entry in node.entries if entry.key.text != key), node.at)

"""Parse YAML into nodes with positions. Every scalar stays text; its meaning depends on the key and is decided later.

YAML syntax errors become problems with a description and a remedy.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import yaml

from framekit.definition.problems import DefinitionError, Position, Problem
from framekit.definition.sources import edited_text
from framekit.definition.tree import Entry, Mapping, Node, Scalar, Sequence, unread

QUOTE_EXPRESSION = "quote the whole expression"
"""The remedy if YAML interprets a character of an expression as its own punctuation."""

_CLOSING = {"[": "]", "{": "}"}
_KEY_BEFORE = re.compile(r"[^\s#].*:\s+\S")


@dataclass(frozen=True, slots=True)
class _Place:
    """A mark of the scanner: its position, the text before it on its line, and the character at it."""

    line: int
    column: int
    before: str
    sign: str

    @property
    def last_sign(self) -> str:
        """Return the last non-blank character before the place on its line."""
        return self.before.rstrip()[-1:]


@dataclass(frozen=True, slots=True)
class _Error:
    """An error of the scanner or parser: its message, its place, and the start of the construct it was reading."""

    context: str
    words: str
    start: _Place
    found: _Place
    comment: _Place | None = None


_Finding = tuple[_Place, str, str]


def syntax_problem(error: yaml.YAMLError, text: str, file: str) -> Problem:
    """Return a YAML error of `text` as a problem."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return Problem(Position(file, 1, 1), "this is not YAML", "save the file as plain text in UTF-8")
    lines = text.splitlines()
    found = error.problem_mark or error.context_mark
    facts = _Error(
        context=error.context or "",
        words=error.problem or "",
        start=_place(error.context_mark or found, lines),
        found=_place(found, lines),
        comment=_swallowing(lines, error.context_mark or found, found),
    )
    place, what, todo = _explained(facts)
    return Problem(Position(file, place.line, place.column), what, todo)


def _place(mark: Any, lines: list[str]) -> _Place:
    """Return the place of a mark of either scanner."""
    if mark is None:
        return _Place(1, 1, "", "")
    number, column = int(mark.line), int(mark.column)
    line = lines[number] if number < len(lines) else ""
    return _Place(number + 1, column + 1, line[:column], line[column : column + 1])


def _swallowing(lines: list[str], start: Any, end: Any) -> _Place | None:
    """Return the start of a comment after an open bracket, within the lines of the construct being read."""
    if start is None or end is None:
        return None
    last = min(int(end.line) + 1, len(lines))
    for number in range(max(0, min(int(start.line), last - 3)), last):
        column = _comment_in_brackets(lines[number])
        if column is not None:
            return _Place(number + 1, column + 1, lines[number][:column], "#")
    return None


def _comment_in_brackets(line: str) -> int | None:
    """Return the column of a comment that begins inside brackets of this line."""
    depth, quote = 0, ""
    for column, sign in enumerate(line):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        elif sign == "#" and line[column - 1 : column].isspace():
            return column if depth > 0 else None
        else:
            depth += (sign in "[{") - (sign in "]}")
    return None


def _explained(error: _Error) -> _Finding:
    """Return place, problem and remedy of an error, by the first rule that matches."""
    rules = (_in_line, _of_signs, _of_quotes, _of_brackets, _of_indentation)
    first = next(filter(None, (rule(error) for rule in rules)), None)
    return first or (error.found, "this is no valid YAML", "check quotes, brackets and indentation here")


def _in_line(error: _Error) -> _Finding | None:
    """Explain an error of tabs, of the depth, or of the `:` of a line."""
    found, words, sign = error.found, error.words, error.found.sign
    if sign == "\t" or "tab character" in words:
        return found, "a tab stands here", "indent with spaces"
    if "nesting depth" in words:  # the limit of the library is reached first if it looks far ahead
        return found, *TOO_DEEP
    if "mapping values are not allowed" in words:
        if _KEY_BEFORE.search(found.before):
            return found, "a second ': ' stands in this value", "quote the whole value"
        line_start = _Place(found.line, len(found.before) - len(found.before.lstrip()) + 1, "", "")
        todo = "check its indentation, and the ':' of the line above"
        return line_start, "this line does not fit the one above", todo
    if "unexpected ':'" in words:
        return found, "a space is missing behind ':'", "write key: value"
    return None


def _of_signs(error: _Error) -> _Finding | None:
    """Explain a value or line that begins with a sign of YAML."""
    found, start, words, context = error.found, error.start, error.words, error.context
    sign = found.sign
    if "cannot start any token" in words:
        return found, f"a value cannot begin with '{sign}'", "put it in quotes"
    if re.search(r"an anchor|an alias|a tag|block scalar|tag handle", f"{context} {words}"):  # one of & * ! > |
        return start, f"a value cannot begin with '{start.sign or sign}'", "put it in quotes"
    if "directive" in context:
        return start, "a line cannot begin with '%'", "put the text in quotes"
    return None


def _of_quotes(error: _Error) -> _Finding | None:
    """Explain an error inside or after a text in quotes."""
    found, start, context = error.found, error.start, error.context
    if "quoted scalar" in context or "double-quoted" in context:
        if "escape" in error.words:
            return found, "a '\\' in double quotes changes what follows", "use single quotes, or write \\\\"
        return start, "the quote that opens here is not closed", "add the closing quote"
    if found.last_sign in ("'", '"') and found.sign not in ("", ":"):
        return found, "the value goes on behind its closing quote", QUOTE_EXPRESSION
    return None


def _of_brackets(error: _Error) -> _Finding | None:
    """Explain an error inside brackets, or of brackets that do not match."""
    found, words, context = error.found, error.words, error.context
    sign, last = found.sign, found.last_sign
    if error.comment is not None and ("flow" in context or "node content" in words):
        # a # in brackets starts a comment that includes the closing brackets
        return error.comment, "everything behind '#' is a comment", "put the value in quotes"
    if "flow mapping" in context or "flow sequence" in context:
        return _in_brackets(error)
    if "node content" in words:
        return _nothing_there(error)
    if _is_of_block(words) and last in _CLOSING.values():
        if sign in _CLOSING.values():
            return found, f"there is a '{sign}' too many", "remove it"
        return found, f"the value goes on behind '{last}'", QUOTE_EXPRESSION
    return None


def _is_of_block(words: str) -> bool:
    """Return whether YAML misses the key or the item of an indented block."""
    return any(sign in words for sign in ("expected key", "block end", "'-' indicator"))


def _of_indentation(error: _Error) -> _Finding | None:
    """Explain a line that does not fit those above."""
    found, start, words, context = error.found, error.start, error.words, error.context
    is_block = _is_of_block(words)
    if "simple key" in context:
        return start, "this line has no ':'", "write it as key: value"
    if is_block and ("block collection" in context or "'-' indicator" in words):
        todo = "begin it with '- ' or indent it otherwise"
        return found, "this line stands where an item of a list is wanted", todo
    if is_block:
        return found, "this line is indented like none above it", "indent it like the keys it belongs to"
    if "document start" in words:
        return found, "something stands behind the end of the document", "remove the '...' above"
    return None


def _in_brackets(error: _Error) -> _Finding:
    """Explain an error inside a mapping or list in brackets."""
    opening, sign = ("{" if "mapping" in error.context else "["), error.found.sign
    closing = _CLOSING[opening]
    if not sign or (error.found.line != error.start.line and sign not in _CLOSING):
        return error.start, f"the '{opening}' here is not closed", f"add '{closing}', or {QUOTE_EXPRESSION}"
    if sign in _CLOSING.values():
        return error.found, f"'{sign}' stands where '{closing}' is missing", f"close '{opening}' with '{closing}'"
    if error.found.last_sign in _CLOSING.values():
        return error.found, f"the value goes on behind '{error.found.last_sign}'", QUOTE_EXPRESSION
    return error.found, f"the value is cut at '{sign}'", QUOTE_EXPRESSION


def _nothing_there(error: _Error) -> _Finding:
    """Explain a missing value."""
    sign = error.found.sign
    if sign in _CLOSING.values():
        return error.found, f"there is a '{sign}' too many", "remove it, or put the value in quotes"
    if sign == "-":
        return error.found, "a list written with '- ' cannot stand between brackets", "write [a, b], or use no brackets"
    before = f"before '{sign}'" if sign else "at the end of the file"
    return error.found, f"a value is missing {before}", "write one, or put the whole value in quotes"


__all__ = ["Entry", "Mapping", "Node", "Scalar", "Sequence", "read_nodes", "read_text", "unread"]

LARGEST_FILE = 4 << 20
"""Maximum size of a file in bytes (or characters)."""

DEEPEST = 64
"""Maximum nesting depth of mappings and lists."""
TOO_DEEP = f"this is nested deeper than {DEEPEST}", "give parts of it names of their own"

MOST_EXPANDED = 100_000
"""Maximum number of nodes in a tree after the expansion of aliases."""

_NOT_YAML = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_COLON = re.compile(r"\s*:")
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_nodes(source: Path, noted: list[Problem] | None = None, *, begin: str = "protocol: NAME") -> Node:
    """Return the nodes of a file, or of the text of `edited_texts` for it.

    Raise DefinitionError with all problems that can be found at once.

    Problems that still leave a usable tree, such as a duplicate key, are appended to `noted` instead, if it is given.
    `begin`: the text with which a file should begin, for the message about an empty file.
    """
    file = str(source)
    edited = edited_text(source)
    if edited is not None:
        return read_text(edited, file, noted, begin=begin)
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
    return read_text(text, file, noted, begin=begin)


def read_text(text: str, file: str, noted: list[Problem] | None = None, *, begin: str = "protocol: NAME") -> Node:
    """Return the nodes of a text; `file` is its name in positions.

    Raise DefinitionError and note as `read_nodes` does.
    """
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
    return _without_version(builder.result(noted, begin), noted)


LANGUAGE = 1
"""The supported version of the language; a file may declare its version by `framekit: 1`."""


def _without_version(node: Node, noted: list[Problem] | None) -> Node:
    """Return the tree without the key for the language version.

    Raise DefinitionError or note an unsupported version.
    """
    entries = node.entries if isinstance(node, Mapping) else ()
    declared = next((entry for entry in entries if entry.key.text == "framekit"), None)
    if declared is None or not isinstance(node, Mapping):
        return node
    value = declared.value.text if isinstance(declared.value, Scalar) else "a list or mapping"
    if value != str(LANGUAGE):
        newer = re.fullmatch(r"[0-9]{1,9}", value) is not None and int(value) > LANGUAGE
        shown = value if len(value) <= 20 else f"{value[:20]}…"
        what = f"this is version {shown} of the language" if newer else f"'{shown}' is no version of the language"
        todo = "install a newer framekit, which reads it" if newer else f"write framekit: {LANGUAGE}"
        problem = Problem(declared.value.at, what, todo)
        if noted is None:
            raise DefinitionError([problem])
        noted.append(problem)
    return without(node, "framekit")


def head_of(source: Path) -> dict[str, str]:
    """Return the leading text values of a file by key, up to the first value that is not a text."""
    texts: list[str] = []
    with source.open(encoding="utf-8") as stream:
        events = yaml.parse(stream.read(), Loader=_LOADER)
        for event in islice(events, 3, None):  # after the start events of stream, document and mapping
            if not isinstance(event, yaml.ScalarEvent):
                break
            texts.append(event.value)
    heads = dict(zip(texts[::2], texts[1::2], strict=False))
    heads.pop("framekit", None)
    return heads


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
    """Raised to stop reading after a problem that makes the rest meaningless."""


@dataclass(slots=True)
class _Open:
    """A mapping or list that is not closed yet."""

    at: Position
    is_mapping: bool
    flow: bool
    anchor: str | None
    items: list[Node] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)
    known: dict[str, Position] = field(default_factory=dict)
    """The keys so far, with their positions."""
    key: Node | None = None
    """The key that waits for its value."""
    key_end: int = 0
    size: int = 1
    """Number of nodes in the tree below it, with aliases expanded."""
    height: int = 1
    """Height of the tree below it, with aliases expanded."""


@dataclass(frozen=True, slots=True)
class _Anchored:
    node: Node
    size: int
    height: int


class _Builder:
    """Builds nodes from the events of the parser, without recursion."""

    def __init__(self, text: str, file: str) -> None:
        self.text = text
        self.file = file
        self.problems: list[Problem] = []
        self.doubles: list[Problem] = []
        self.root: Node | None = None
        self.stack: list[_Open] = []
        self.anchors: dict[str, _Anchored] = {}
        self.documents = 0

    def result(self, noted: list[Problem] | None, begin: str) -> Node:
        """Return the tree. Raise DefinitionError with all problems.

        If only keys are duplicated, add these to `noted` if given.
        """
        root = self.root
        if not self.problems and (root is None or (isinstance(root, Scalar) and not root.quoted and not root.text)):
            self.problems.append(Problem(Position(self.file, 1, 1), "the file is empty", f"begin with {begin}"))
        if self.problems or root is None or (self.doubles and noted is None):
            raise DefinitionError([*self.problems, *self.doubles])
        if noted is not None:
            noted.extend(self.doubles)
        return root

    def take(self, event: yaml.Event) -> None:
        """Process one event. Raise _GivenUp if reading cannot continue."""
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
            self._note(self._at(event), *TOO_DEEP)
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

    # ---- assembly -------------------------------------------------------------------------------------------

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
        """Note a duplicate key. The first value counts; duplicate sections of a file are merged."""
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
        """Return whether the key that waits for a value is not followed by a colon."""
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
    """Return a mapping without one of its keys."""
    return Mapping(tuple(entry for entry in node.entries if entry.key.text != key), node.at)


CUT = "the expression was cut at a comma"

_QUOTED = re.compile(r"'[^']*'")
_NAME = re.compile(r"[A-Za-z_]\w*")
_NO_SPACE = re.compile(r"[a-z_]+:[^:\s'\"()]+")
_PROSE = re.compile(r"doc|about|source|second_source|\d+|0[xX][0-9A-Fa-f]+")
_EXPRESSION = re.compile(r"[()\[\]{}'\"+*/%&|^~<>=]|\s(?:if|else|and|or|not|in|-)\s")


@dataclass(slots=True)
class Cuts:
    """The tree without the cut-off pieces, the problems, and the positions of the affected mappings and lists."""

    tree: Node
    problems: list[Problem] = field(default_factory=list)
    places: set[Position] = field(default_factory=set)


def without_cuts(node: Node) -> Cuts:
    """Return the tree without the pieces of cut expressions; report one problem for each affected mapping or list."""
    cuts = Cuts(node)
    cuts.tree = _mended(node, cuts)
    return cuts


def is_cut(problem: Problem) -> bool:
    """Return whether a problem is a cut expression or a key without a value."""
    return problem.what.endswith((" was cut at a comma", " has no value"))


def looks_cut(text: str) -> bool:
    """Return whether a key is a piece of an expression rather than a word."""
    return _EXPRESSION.search(text) is not None


def _mended(node: Node, cuts: Cuts) -> Node:
    if isinstance(node, Mapping):
        return _mapping(node, cuts)
    return _sequence(node, cuts) if isinstance(node, Sequence) else node


def _mapping(node: Mapping, cuts: Cuts) -> Mapping:
    kept: list[Entry] = []
    depth = 0
    for entry in node.entries:
        absent = isinstance(entry.value, Scalar) and entry.value.absent
        if node.flow and (absent or depth):
            _note(node, entry.key, kept[-1] if kept else None, depth, cuts)
        elif absent:
            cuts.problems.append(_no_value(entry.key))
        else:
            value = _mended(entry.value, cuts)
            kept.append(entry if value is entry.value else Entry(entry.key, value))
        depth = max(0, depth + _opened(entry.key) + _opened(entry.value)) if node.flow else 0
    if len(kept) == len(node.entries) and all(new is old for new, old in zip(kept, node.entries, strict=True)):
        return node
    return Mapping(tuple(kept), node.at, node.flow)


def _sequence(node: Sequence, cuts: Cuts) -> Sequence:
    kept: list[Node] = []
    depth = 0
    for item in node.items:
        if node.flow and depth and isinstance(item, Scalar):
            _note(node, item, None, depth, cuts)
        else:
            kept.append(_mended(item, cuts))
        depth = max(0, depth + _opened(item)) if node.flow else 0
    if len(kept) == len(node.items) and all(new is old for new, old in zip(kept, node.items, strict=True)):
        return node
    return Sequence(tuple(kept), node.at, node.flow)


def _opened(node: Node) -> int:
    """Return the number of parentheses left open by an unquoted text, without those inside its own quotes."""
    if not isinstance(node, Scalar) or node.quoted:
        return 0
    text = _QUOTED.sub("", node.text)
    return text.count("(") - text.count(")")


def _note(node: Mapping | Sequence, piece: Scalar, before: Entry | None, depth: int, cuts: Cuts) -> None:
    """Note the first cut of a mapping or list."""
    if node.at in cuts.places:
        return
    cuts.places.add(node.at)
    if isinstance(node, Mapping) and (before is None or _NO_SPACE.fullmatch(piece.text)):
        cuts.problems.append(_no_value(piece))
    elif before is not None and _PROSE.fullmatch(before.key.text):
        cuts.problems.append(Problem(piece.at, "the text was cut at a comma", "quote the whole text"))
    elif before is not None and piece.text.isdigit() and isinstance(before.value, Scalar) and _is_number(before.value):
        cuts.problems.append(Problem(piece.at, "the number was cut at a comma", _joined(before.value.text, piece.text)))
    elif depth == 0 and _NAME.fullmatch(piece.text):
        cuts.problems.append(Problem(piece.at, CUT, f"{QUOTE_EXPRESSION}, or give '{piece.text}' a value"))
    else:
        cuts.problems.append(Problem(piece.at, CUT, QUOTE_EXPRESSION))


def _is_number(scalar: Scalar) -> bool:
    return scalar.text.removeprefix("-").isdigit()


def _joined(before: str, after: str) -> str:
    """Return the remedy for a number with a comma: thousands are written without it, fractions with a point."""
    is_grouped = len(after) == 3 and not before.removeprefix("-").startswith("0")
    return f"write {before}{after}, or {before}.{after} for a fraction" if is_grouped else f"write {before}.{after}"


def _no_value(key: Scalar) -> Problem:
    name, colon, value = key.text.partition(":")
    todo = f"write {name}: {value.strip()} with a space" if colon and value else f"write {key.text}: value"
    return Problem(key.at, f"the key '{key.text}' has no value", todo)

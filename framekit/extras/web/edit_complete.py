"""Completions for the editor: keys and words from the JSON schemas, names from the file and the files that it names.

The text is parsed with a mark in place of the word at the cursor. The path of the mark leads through the schema. Text
after the cursor that is no YAML is left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from framekit.definition.model.checks import ready_methods
from framekit.definition.nodes import read_nodes, read_text
from framekit.definition.problems import DefinitionError
from framekit.definition.schema import FIRST_KEYS, Kind, kind_schema, referred_schema
from framekit.definition.sources import edited_text, find_definition, known_definitions
from framekit.definition.tree import Mapping as MappingNode
from framekit.definition.tree import Node, Scalar, Sequence

Schema = dict[str, Any]
Steps = tuple[str | int, ...]
Answer = dict[str, Any]

MARK = "cursor_of_the_editor"
MOST_WORDS = 200
"""Largest number of completions."""
MOST_FILES = 12
"""Largest number of files whose names are offered."""
DEEPEST = 40
"""Largest number of references that are followed from one schema."""
_WORD = re.compile(r"[\w.%-]*\Z")
_CLOSING = {"[": "]", "{": "}"}


class Word(NamedTuple):
    """A completion."""

    text: str
    about: str
    inserted: str


class _Cursor(NamedTuple):
    """The place of the mark in a parsed text."""

    root: Node
    path: Steps
    """The path of the mapping, list or value that holds the mark."""
    is_key: bool
    holders: tuple[Node, ...]
    """The nodes from the root to the holder of the mark."""


def complete(path: Path, offset: int) -> Answer:
    """Return the completions at an offset (UTF-16 code units, as a browser counts): where their word begins, and words:
    text, meaning, inserted text.
    """
    text = edited_text(path) or ""
    before = text.encode("utf-16-le", "surrogatepass")[: 2 * offset].decode("utf-16-le", "replace")
    line = before[before.rfind("\n") + 1 :]
    typed = _WORD.search(line)
    word = "" if typed is None else typed[0]
    begin = offset - len(word.encode("utf-16-le", "surrogatepass")) // 2
    if _in_note_or_quotes(line):
        return {"from": begin, "words": []}
    found = dict.fromkeys(_words(path, text, len(before) - len(word), len(before)))
    near = [one for one in found if one.text.casefold().startswith(word.casefold())]
    other = [one for one in found if word and word.casefold() in one.text.casefold() and one not in near]
    return {"from": begin, "words": [list(one) for one in [*near, *other][:MOST_WORDS]]}


def _in_note_or_quotes(line: str) -> bool:
    """Return whether the end of a line is in a comment or in quotes."""
    quote = ""
    for place, sign in enumerate(line):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"" and (place == 0 or line[place - 1] in " \t[{,:"):
            quote = sign
        elif sign == "#" and (place == 0 or line[place - 1].isspace()):
            return True
    return bool(quote)


def _words(path: Path, text: str, begin: int, end: int) -> Iterator[Word]:
    """Yield the completions for the word between two offsets."""
    rest = re.match(r"[\w.%-]*(?P<colon>\s*:(\s|$))?", text[end:])
    has_colon = rest is not None and rest["colon"] is not None
    after = text[end + (0 if rest is None else rest.end() if has_colon else len(rest[0])) :]
    for mark in (f"{MARK}: ", MARK) if not has_colon else (f"{MARK}: ",):
        cursor = _cursor(path, text[:begin], mark, after)
        if cursor is None or cursor.is_key != (mark != MARK):
            continue
        yield from _Names(path, cursor).keys(has_colon) if cursor.is_key else _Names(path, cursor).values()


# ---- the place of the cursor ---------------------------------------------------------------------------------


def _cursor(path: Path, before: str, mark: str, after: str) -> _Cursor | None:
    """Return the place of the mark in the text, or in the text up to its line; None if neither can be parsed."""
    rest_of_line = after[: after.find("\n")] if "\n" in after else after
    for tail in (after, rest_of_line, "".join(_CLOSING[sign] for sign in reversed(_open_brackets(before)))):
        try:
            root = read_text(before + mark + tail, path.name, [])
        except DefinitionError:
            continue
        found = _marked(root)
        if found is not None:
            return found
    return None


def _open_brackets(text: str) -> list[str]:
    """Return the brackets that are open at the end of a text, outer first."""
    brackets: list[str] = []
    quote, last = "", " "
    for line in text.splitlines():
        if not brackets and not re.search(r"[\[{]", line):
            continue
        for sign in line:
            if quote:
                quote = "" if sign == quote else quote
            elif sign in "'\"" and last in " \t[{,:":
                quote = sign
            elif sign == "#" and last.isspace():
                break
            elif sign in _CLOSING and (brackets or last.isspace()):
                brackets.append(sign)
            elif brackets and sign == _CLOSING[brackets[-1]]:
                brackets.pop()
            last = sign
        quote, last = "", " "
    return brackets


def _marked(root: Node) -> _Cursor | None:
    """Return the place of the mark in a tree."""
    waiting: list[tuple[Node, Steps, tuple[Node, ...]]] = [(root, (), ())]
    while waiting:
        node, path, above = waiting.pop()
        holders = (*above, node)
        if isinstance(node, Scalar) and node.text == MARK:
            return _Cursor(root, path, False, above)
        if isinstance(node, Sequence):
            waiting += [(item, (*path, number), holders) for number, item in enumerate(node.items)]
        elif isinstance(node, MappingNode):
            for entry in node.entries:
                if entry.key.text == MARK:
                    return _Cursor(root, path, True, holders)
                waiting.append((entry.value, (*path, entry.key.text), holders))
    return None


# ---- schemas -------------------------------------------------------------------------------------------------


def _parts(schema: Schema, node: Node | None) -> Iterator[Schema]:
    """Yield a schema and all schemas that apply together with it to a node."""
    waiting, seen = [schema], 0
    while waiting and seen < DEEPEST:
        seen += 1
        one = waiting.pop(0)
        yield one
        if "$ref" in one:
            waiting.append(referred_schema(one["$ref"]))
        keys = node.keys() if isinstance(node, MappingNode) else ()
        waiting += [part for key, part in one.get("dependentSchemas", {}).items() if key in keys]
        for word in ("allOf", "anyOf", "oneOf"):
            waiting += [part for part in one.get(word, ()) if part.keys() != {"required"}]
        waiting += [one[word] for word in ("then", "else") if isinstance(one.get(word), dict)]


def _below(schemas: Iterable[Schema], step: str | int, node: Node) -> list[Schema]:
    """Return the schemas of a value or an item of a node."""
    found: list[Schema] = []
    for schema in schemas:
        for part in _parts(schema, node):
            if isinstance(step, int):
                inner = part.get("items")
            else:
                inner = part.get("properties", {}).get(step, part.get("additionalProperties"))
            if isinstance(inner, dict):
                found.append(inner)
    return found


def _about(schema: Schema) -> str:
    """Return the description of a schema, or of the definition that it refers to."""
    for part in _parts(schema, None):
        if text := part.get("description") or part.get("x-expected"):
            return str(text)
    return ""


# ---- words ---------------------------------------------------------------------------------------------------

_SUFFIXES: Mapping[str, Kind] = {
    "run": "run", "device": "device", "points": "points", "vectors": "vectors", "memory": "memory",
    "faults": "faults", "jobs": "jobs",
}  # fmt: skip
"""The kind of a file without a first key, by the part of its name before `.yaml`."""


class _Names:
    """The completions at one place of a file."""

    def __init__(self, path: Path, cursor: _Cursor) -> None:
        self.path = path
        self.cursor = cursor
        self.kind = self._kind()
        schemas: list[Schema] = [kind_schema(self.kind)]
        for step, node in zip(cursor.path, cursor.holders, strict=False):
            schemas = _below(schemas, step, node)
        self.schemas = schemas

    def _kind(self) -> Kind:
        root = self.cursor.root
        keys = root.keys() if isinstance(root, MappingNode) else ()
        middle = self.path.name.split(".")[-2] if self.path.name.count(".") > 1 else ""
        return next((FIRST_KEYS[key] for key in keys if key in FIRST_KEYS), _SUFFIXES.get(middle, "protocol"))

    # ---- keys -------------------------------------------------------------------------------------------------

    def keys(self, has_colon: bool) -> Iterator[Word]:
        """Yield the keys that the mapping at the cursor may have."""
        holder = self.cursor.holders[-1]
        given = set(holder.keys()) if isinstance(holder, MappingNode) else set()
        offered: dict[str, Schema] = {}
        if not self.cursor.path and not given & FIRST_KEYS.keys():
            known = kind_schema(self.kind)["properties"]
            offered = {key: known.get(key, {}) for key, kind in FIRST_KEYS.items() if kind == self.kind}
        else:
            for part in (part for schema in self.schemas for part in _parts(schema, holder)):
                offered |= {key: one for key, one in part.get("properties", {}).items() if key not in offered}
                offered |= _kinds(part, given)
        end = "" if has_colon else ": "
        for key, schema in offered.items():
            if key not in given:
                yield Word(key, _about(schema), key + end)
        for name in self._free_keys():
            if name not in given:
                yield Word(name, "", name + end)

    def _free_keys(self) -> Iterator[str]:
        """Yield names of the file that may be keys here."""
        last = next((step for step in reversed(self.cursor.path) if isinstance(step, str)), "")
        if any(
            "constructor" in str(schema.get("$ref", "")) or "/sent" in str(schema.get("$ref", ""))
            for schema in self.schemas
        ):
            yield from self._of("frames")
        elif last == "params" and self.kind in ("run", "device"):
            yield from self._of("params")

    # ---- values -----------------------------------------------------------------------------------------------

    def values(self) -> Iterator[Word]:
        """Yield the words that the value at the cursor may have."""
        for schema in self.schemas:
            for part in _parts(schema, None):
                words = [one for one in part.get("enum", ()) if isinstance(one, str)]
                words = ["yes", "no"] if {"yes", "no"} <= {*words} else words
                for word in words:
                    yield Word(word, "", word)
        if self.schemas and not self._takes_scalars():
            return
        key = next((step for step in reversed(self.cursor.path) if isinstance(step, str)), "")
        for source in _REFERS.get((self.kind, key), _REFERS.get(("", key), ())):
            names = _SOURCES[source](self) if source in _SOURCES else self.section(source)
            yield from islice((Word(name, about, name) for name, about in names), MOST_WORDS)

    def _takes_scalars(self) -> bool:
        """Return whether a scalar is allowed at the cursor."""
        types = [part["type"] for schema in self.schemas for part in _parts(schema, None) if "type" in part]
        return not types or any(
            one not in ("object", "array") for found in types for one in ([found] if isinstance(found, str) else found)
        )

    def section(self, name: str) -> Iterator[tuple[str, str]]:
        """Yield the names of a section with a description: of the file, its bases, and its protocols."""
        return ((one, "") for one in self._of(name))

    def _of(self, section: str) -> list[str]:
        found: dict[str, None] = {}
        for root in self._roots():
            node = root.value(section) if isinstance(root, MappingNode) else None
            if isinstance(node, MappingNode):
                found |= dict.fromkeys(entry.key.text for entry in node.entries if entry.key.text != MARK)
        return list(found)

    def _roots(self) -> Iterator[Node]:
        """Yield the parsed files whose names this file can use: itself, its bases, and the protocols that it names."""
        waiting: list[tuple[Node, Path]] = [(self.cursor.root, self.path.parent)]
        seen: set[Path] = set()
        while waiting:
            root, folder = waiting.pop(0)
            yield root
            for name in _named_files(root):
                file = find_definition(name, folder)
                if file is None or file in seen or len(seen) >= MOST_FILES:
                    continue
                seen.add(file)
                try:
                    waiting.append((read_nodes(file, []), file.parent))
                except DefinitionError:
                    continue

    def steps(self) -> Iterator[tuple[str, str]]:
        """Yield the words that say where a sequence goes on."""
        for word in ("next", "end", "again", "restart", "resend"):
            yield word, "where the sequence goes on"
        node = self.cursor.holders[3] if len(self.cursor.holders) > 3 else None
        for item in node.items if isinstance(node, Sequence) else ():
            name = item.value("step") if isinstance(item, MappingNode) else None
            if isinstance(name, Scalar):
                yield name.text, "step"

    def checks(self) -> Iterator[tuple[str, str]]:
        """Yield check methods: of the file, and ready ones."""
        yield from self.section("checks")
        yield from ((name, f"{method.width} bits") for name, method in ready_methods().items())

    def definitions(self) -> Iterator[tuple[str, str]]:
        """Yield the definitions in the folder of the file, and known ones."""
        for file in sorted(islice(self.path.parent.glob("*.yaml"), MOST_WORDS)):
            if "." not in file.stem and file != self.path:
                yield file.name, "in this folder"
        yield from ((file.stem, "known") for file in known_definitions() if "." not in file.stem)


def _kinds(part: Schema, given: Collection[str]) -> dict[str, Schema]:
    """Return the keys that name a kind in a schema, if no kind is given yet."""
    kinds = [branch["required"][0] for branch in part.get("oneOf", ()) if branch.keys() == {"required"}]
    if not kinds or any(key in given for key in kinds):
        return {}
    found = {}
    for key in kinds:
        schema = part.get("dependentSchemas", {}).get(key, {})
        own = [one["properties"][key] for one in _parts(schema, None) if key in one.get("properties", {})]
        found[key] = own[0] if own else part.get("properties", {}).get(key, schema)
    return found


def _named_files(root: Node) -> Iterator[str]:
    """Yield the names of other definitions in a file: bases, used files, and protocols of channels."""
    if not isinstance(root, MappingNode):
        return
    nodes: list[Node | None] = [root.value(key) for key in ("extends", "uses", "application")]
    if FIRST_KEYS.get(next(iter(root.keys()), "")) != "protocol":
        nodes.append(root.value("protocol"))
    channels = root.value("channels")
    if isinstance(channels, MappingNode):
        nodes += [one.value.value("protocol") for one in channels.entries if isinstance(one.value, MappingNode)]
    for node in nodes:
        for item in node.items if isinstance(node, Sequence) else (node,):
            if isinstance(item, Scalar) and item.text and item.text != MARK:
                yield item.text


_SOURCES: Mapping[str, Callable[[_Names], Iterator[tuple[str, str]]]] = {
    "steps": _Names.steps,
    "checks": _Names.checks,
    "definitions": _Names.definitions,
}
"""Names with descriptions that are no names of a section."""
_WHERE_TO = "then else on_timeout on_bad on_other on_noise on_break on_closed on_held on_exhausted on_fail"
_ROWS: tuple[tuple[str, str, str], ...] = (
    ("protocol", "frame of", "frames groups"),
    ("protocol", "group", "groups"),
    ("protocol", "call exchange listen open close run", "sequences"),
    ("protocol", "session", "sessions"),
    ("protocol", "queue take room", "queues"),
    ("protocol", "values", "tables"),
    ("protocol", "check method", "checks"),
    ("protocol", "areas", "areas"),
    ("protocol", _WHERE_TO, "steps"),
    ("run", "call", "services"),
    ("points", "call", "services"),
    ("run", "channel", "channels"),
    ("run", "protocol", "definitions"),
    ("device", "protocol also", "definitions"),
    ("vectors", "vectors", "definitions"),
    ("vectors", "frame", "frames"),
    ("", "send receive deliver inside ask", "frames"),
    ("", "include", "layouts"),
    ("", "role other_side", "roles"),
    ("", "extends uses application", "definitions"),
)
_REFERS: Mapping[tuple[str, str], tuple[str, ...]] = {
    (kind, key): tuple(sources.split()) for kind, keys, sources in _ROWS for key in keys.split()
}
"""The sources of the names that the value of a key can be, by the kind of the file ('' for any) and the key."""

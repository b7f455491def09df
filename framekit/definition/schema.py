"""Validation of files against the JSON schemas, with every problem at its exact place.

The schemas define the keys and the form of their values; names, expressions and conditions on several keys are checked
by the loaders and the checker.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from typing import Any, Literal

from framekit.definition.brought import bring_word, import_installed
from framekit.definition.nodes import CUT, QUOTE_EXPRESSION, Mapping, Node, Scalar, Sequence, looks_cut, without_cuts
from framekit.definition.problems import (
    MOST_EQUAL,
    DefinitionError,
    Position,
    Problem,
    did_you_mean,
    plural,
    printable,
)
from framekit.definition.sources import shipped_folder
from framekit.definition.tree import Entry

Path = tuple[str | int, ...]

_NOUNS = {
    "areas": "area",
    "channels": "channel",
    "checks": "check method",
    "frames": "frame",
    "groups": "group",
    "layouts": "layout",
    "params": "parameter",
    "queues": "queue",
    "roles": "role",
    "sequences": "sequence",
    "services": "service",
    "sessions": "session",
    "state": "state variable",
    "tables": "table",
    "points": "point",
    "values": "point",
    "blocks": "block",
    "sets": "set",
    "lanes": "lane",
    "flags": "flags entry",
}
_NUMBERED = ("channels", "blocks", "sets")
_DEEPER = {("memory", 2), ("sets", 3), ("roles", 3)}
"""Sections below the top level: the first key of the path, and the index in the path of the entry's name."""

_LISTED = {
    "addresses": ("address form", "", 1),
    "frames": ("frame case", "name", 1),
    "conversations": ("conversation", "name", 1),
    "services": ("row", "name", 2),
    "sequences": ("step", "step", 3),
}
"""Lists whose items have names: section → noun, key of the name, place of the item's number in the path."""


class Places:
    """Find nodes by path and name them."""

    def __init__(self, root: Node) -> None:
        self.root = root
        self._entries: dict[int, dict[str, Entry]] = {}
        """Entries of each mapping that was asked for, by the identity of the node."""

    def node(self, path: Iterable[str | int]) -> Node:
        """Return the node at a path of the plain tree."""
        node: Node | None = self.root
        for step in path:
            if isinstance(node, Sequence) and isinstance(step, int):
                node = node.items[step]
            elif isinstance(node, Mapping):
                node = self._by_key(node)[str(step)].value
        assert node is not None  # paths come from the tree
        return node

    def key(self, path: Path, key: str) -> Position:
        """Return the place of a key of the mapping at `path`."""
        node = self.node(path)
        if not isinstance(node, Mapping):
            return node.at
        entry = self._by_key(node).get(key)
        return node.at if entry is None else entry.key.at

    def _by_key(self, node: Mapping) -> dict[str, Entry]:
        found = self._entries.get(id(node))
        if found is None:
            found = self._entries[id(node)] = {entry.key.text: entry for entry in node.entries}
        return found

    def place(self, path: Path) -> str:
        """Return the nearest thing around with a name: `frame 'X'`, `step 'ask' of sequence 'exchange'`; '' for
        none.
        """
        return self._named(path)[0]

    def is_named(self, path: Path) -> bool:
        """Return whether the path leads to a part with a name, not into one."""
        return bool(path) and self._named(path)[1] == len(path)

    def _named(self, path: Path) -> tuple[str, int]:
        parts: list[str] = []
        end = 0
        for index in range(1, len(path)):
            part = self._entry(path, index) if isinstance(path[index], str) else self._item(path, index)
            if part:
                parts.insert(0, part)
                end = index + 1
        return " of ".join(parts), end

    def _entry(self, path: Path, index: int) -> str:
        section, name = path[index - 1], path[index]
        if section not in _NOUNS or (index != 1 and (path[0], index) not in _DEEPER):
            return ""
        noun = _NOUNS[str(section)]
        return f"{noun} {name}" if section in _NUMBERED else f"{noun} '{name}'"

    def _item(self, path: Path, index: int) -> str:
        noun, key, depth = _LISTED.get(str(path[0]), ("", "", 0))
        if not noun or index != depth or (path[0] == "sequences" and path[2] != "steps"):
            return ""
        item = self.node(path[: index + 1])
        name = item.get(key) if isinstance(item, Mapping) else None
        return f"{noun} '{name.text}'" if isinstance(name, Scalar) and name.text else f"{noun} {int(path[index]) + 1}"


MOST_WORDED = 99
"""Errors of a file, and unknown keys of a mapping, that get a message each; the others are counted."""

LONGEST_TEXT = 40
"""Characters of a wrong value that are shown."""

MOST_KINDS = 8
"""Kinds that are listed where one is missing."""

LONGEST_LIST = 12
"""Largest number of known words listed if none is similar."""

OWN_KEYS = "x-own-keys"
"""Keyword of mappings with free keys: a key that is nearly one of the known ones is a slip."""

REFERS = "x-refers"
"""Keyword of values that are a key of a section of the same file."""


@dataclass(frozen=True, slots=True)
class _Complaint:
    """A problem, the path of its node, and its sort: `unknown`, `missing`, `kinds` or `value`."""

    path: Path
    sort: str
    problem: Problem


class Messages:
    """Word the errors of a file. `cut`: mappings and lists that have lost pieces; their missing keys are no errors."""

    def __init__(self, root: Node, cut: set[Position], known_keys: Callable[[str], Iterable[str]]) -> None:
        self.places = Places(root)
        self.cut = cut
        self.known_keys = known_keys

    def problems(self, errors: Iterable[Any]) -> list[Problem]:
        """Return the errors of a validator as problems, `MOST_WORDED` at most; the last one counts the others. Equal
        errors of the parts of a section are the problem of several places.
        """
        equal: dict[Any, dict[Position, Any]] = {}
        for number, error in enumerate(errors):
            equal.setdefault(self._likeness(error) or number, {}).setdefault(self._place(error), error)
        groups = [sorted(same.items(), key=lambda one: one[0]) for same in equal.values()]
        waiting = iter(sorted(groups, key=lambda same: same[0][0]))  # the validator yields them in any order
        complaints = [complaint for same in islice(waiting, MOST_WORDED) for complaint in self._worded_together(same)]
        kinds = {complaint.path for complaint in complaints if complaint.sort == "kinds"}
        problems = [
            complaint.problem
            for complaint in complaints
            if complaint.sort not in ("unknown", "missing") or complaint.path not in kinds
        ]
        if others := sum(map(len, waiting)):
            problems.append(
                Problem(max(one.at for one in problems), _more(others, "error"), "correct the others first")
            )
        return problems

    def _likeness(self, error: Any) -> tuple[Any, ...] | None:
        """Return what errors with one message have in common apart from the name of the part; None for other errors."""
        path = [str(step) if isinstance(step, str) else 0 for step in error.absolute_path]
        if len(path) < 2 or "propertyNames" in error.absolute_schema_path:
            return None
        what: Any = None
        if error.validator == "additionalProperties":
            unknown = [key for key in error.instance if key not in error.schema.get("properties", {})]
            what = unknown[0] if len(unknown) == 1 and not looks_cut(unknown[0]) else None
        elif error.validator == "required":
            what = self._missing(error) or None
        elif error.validator in ("enum", "pattern") and isinstance(error.instance, str):
            what = error.instance
        return None if what is None else (error.validator, id(error.validator_value), path[0], *path[2:], what)

    def _place(self, error: Any) -> Position:
        """Return the place of an error: that of its value, or of the first unknown key."""
        path: Path = tuple(error.absolute_path)
        if error.validator == "additionalProperties":
            unknown = (key for key in error.instance if key not in error.schema.get("properties", {}))
            return self.places.key(path, next(unknown, ""))
        return self.places.node(path).at

    def _worded_together(self, same: list[tuple[Position, Any]]) -> Iterator[_Complaint]:
        """Yield the complaints of equal errors: of each, or of the first one if there are many."""
        (_, first), *others = same
        if len(others) < MOST_EQUAL:
            for _, error in same:
                yield from self._worded(error)
            return
        for complaint in self._worded(first):
            yield replace(complaint, problem=complaint.problem._replace(also=tuple(at for at, _ in others)))

    def _worded(self, error: Any) -> Iterator[_Complaint]:
        path: Path = tuple(error.absolute_path)
        word = _WORDS.get(error.validator)
        if "propertyNames" in error.absolute_schema_path:
            yield _Complaint(path, "value", self._name(error, path))
        elif word is None or (error.validator in ("oneOf", "anyOf") and not _are_keys(error.validator_value)):
            yield self._value(path, f"{self._subject(path)} is not right", "look at its description")
        else:
            yield from word(self, error, path)

    # ---- nouns for parts ----------------------------------------------------------------------------------

    def _thing(self, path: Path, schema: dict[str, Any]) -> str:
        """Return a noun phrase: `frame 'X'`, `a field segment of frame 'X'`, `the line section`."""
        place = self.places.place(path)
        if self.places.is_named(path):
            return place
        title = str(schema.get("title", "")) or (f"'{path[-1]}'" if path else "the file")
        if not title.startswith(("the ", "'")):
            title = f"{'an' if title[0] in 'aeiou' else 'a'} {title}"
        return f"{title} of {place}" if place else title

    def _subject(self, path: Path) -> str:
        """Return a noun phrase: `'body' of frame 'X'`, `an item of 'body' of frame 'X'`."""
        place = self.places.place(path)
        if self.places.is_named(path):
            return place
        if not path:
            return "the file"
        name = f"'{path[-1]}'"
        if isinstance(path[-1], int):
            names = [step for step in path if isinstance(step, str)]
            name = f"an item of '{names[-1]}'" if names else "an item"
        return f"{name} of {place}" if place else name

    def _inside(self, path: Path) -> str:
        place = self.places.place(path)
        return f", in {place}" if place else ""

    # ---- keys ---------------------------------------------------------------------------------------------

    def _unknown_keys(self, error: Any, path: Path) -> Iterator[_Complaint]:
        schema, node = error.schema, self.places.node(path)
        known = schema.get("properties", {})
        unknown = [key for key in error.instance if key not in known]
        outer = _outer_keys(node, {*unknown[:MOST_WORDED]})
        for number, key in enumerate(unknown):
            at = self.places.key(path, key)
            if isinstance(node, Mapping) and node.flow and looks_cut(key):
                yield _Complaint(path, "unknown", Problem(at, CUT, QUOTE_EXPRESSION))
                return
            if number == MOST_WORDED:
                what = _more(len(unknown) - number, "unknown key") + f" in {self._thing(path, schema)}"
                yield _Complaint(path, "unknown", Problem(at, what, "remove them or correct their names"))
                return
            hint = schema.get("x-hints", {}).get(key) or outer.get(key) or did_you_mean(key, known)
            if not hint:
                named = f"known: {', '.join(sorted(known))}"
                hint = named if len(known) <= LONGEST_LIST else "remove it or correct its name"
            yield self._unknown(path, key, schema, hint)

    def _unknown(self, path: Path, key: str, schema: dict[str, Any], hint: str) -> _Complaint:
        what = f"unknown key '{key}' in {self._thing(path, schema)}"
        return _Complaint(path, "unknown", Problem(self.places.key(path, key), what, hint))

    def _near_key(self, error: Any, path: Path) -> Iterator[_Complaint]:
        known = list(error.schema["properties"])
        hint = f"{did_you_mean(error.message, known)} If not, give it another name"
        yield self._unknown(path, error.message, error.schema, hint)

    def _missing(self, error: Any) -> tuple[str, ...]:
        """Return all keys that are missing in one mapping, without those that are misspelt or meant by another key."""
        schema = error.schema
        properties, hints = schema.get("properties", {}), schema.get("x-hints", {})
        strange = [key for key in islice(error.instance, MOST_WORDED) if key not in properties]
        meant = {word for key in strange for word in _WORDS_OF_HINT.findall(hints.get(key, ""))}
        cutoff = _NEARLY if OWN_KEYS in schema else 0.6
        return tuple(
            key
            for key in error.validator_value
            if key not in error.instance
            and key not in meant
            and not difflib.get_close_matches(key, strange, n=1, cutoff=cutoff)
        )

    def _missing_keys(self, error: Any, path: Path) -> Iterator[_Complaint]:
        missing, node = self._missing(error), self.places.node(path)
        if missing and node.at not in self.cut:
            keys = ("key " if len(missing) == 1 else "keys ") + ", ".join(f"'{key}'" for key in missing)
            what = f"missing {keys} in {self._thing(path, error.schema)}"
            yield _Complaint(path, "missing", Problem(node.at, what, _ADD[len(missing) > 1]))

    def _kinds(self, error: Any, path: Path) -> Iterator[_Complaint]:
        """Report a mapping that does not have exactly one of the keys that name its kind."""
        if not isinstance(error.instance, dict):
            return
        schema, node = error.schema, self.places.node(path)
        kinds = [branch["required"][0] for branch in error.validator_value]
        given = [key for key in error.instance if key in kinds]
        thing, one = self._thing(path, schema), schema.get("x-one", "kind")
        if given:
            names = " and ".join(f"'{key}'" for key in given)
            problem = Problem(self.places.key(path, given[1]), f"{thing} has more than one {one}: {names}", "keep one")
            yield _Complaint(path, "kinds", problem)
        elif (near := self._nearest(error.instance, kinds, schema)) is not None:
            complaint = self._unknown(path, near, schema, did_you_mean(near, kinds))
            yield _Complaint(path, "kinds", complaint.problem)
        elif node.at not in self.cut:
            todo = "add one of " + ", ".join(kinds[:MOST_KINDS]) + (", …" if len(kinds) > MOST_KINDS else "")
            yield _Complaint(path, "kinds", Problem(node.at, f"{thing} has no {one}", todo))

    def _nearest(self, keys: Iterable[str], kinds: list[str], schema: dict[str, Any]) -> str | None:
        """Return the key that is similar to one of the kinds and belongs to none of them."""
        options = {*schema.get("properties", ())}
        for branch in schema.get("dependentSchemas", {}).values():
            options.update(self.known_keys(branch["$ref"]))
        strange = [key for key in islice(keys, MOST_WORDED) if key not in options]
        near = [key for key in strange if difflib.get_close_matches(key, kinds, n=1, cutoff=0.6)]
        return near[0] if near else None

    def _at_least_one(self, error: Any, path: Path) -> Iterator[_Complaint]:
        keys = " or ".join(f"'{branch['required'][0]}'" for branch in error.validator_value)
        what = f"missing key {keys} in {self._thing(path, error.schema)}"
        yield _Complaint(path, "missing", Problem(self.places.node(path).at, what, "add it"))

    def _together(self, error: Any, path: Path) -> Iterator[_Complaint]:
        for key, needed in error.validator_value.items():
            for other in needed:
                strange = [one for one in error.instance if one not in error.schema.get("properties", {})]
                is_misspelt = difflib.get_close_matches(other, strange[:MOST_WORDED], n=1)
                if key in error.instance and other not in error.instance and not is_misspelt:
                    what = f"'{key}' needs '{other}' beside it{self._inside(path)}"
                    problem = Problem(self.places.key(path, key), what, f"add {other} or remove {key}")
                    yield _Complaint(path, "value", problem)

    def _excluded(self, error: Any, path: Path) -> Iterator[_Complaint]:
        keys = error.validator_value.get("required", ())
        at = max((self.places.key(path, key) for key in keys), default=self.places.node(path).at)
        what = error.schema.get("x-message", "these keys exclude each other") + self._inside(path)
        yield _Complaint(path, "value", Problem(at, what, error.schema.get("x-todo", "remove one of them")))

    # ---- values -------------------------------------------------------------------------------------------

    def _value(self, path: Path, what: str, todo: str) -> _Complaint:
        return _Complaint(path, "value", Problem(self.places.node(path).at, what, todo))

    def _type(self, error: Any, path: Path) -> Iterator[_Complaint]:
        wanted = error.validator_value
        yield self._shape(path, [wanted] if isinstance(wanted, str) else wanted, error.schema)

    def _shape(self, path: Path, wanted: list[str], schema: dict[str, Any]) -> _Complaint:
        node = self.places.node(path)
        names: list[str] = [word for word in ("object", "array") if word in wanted]
        if len(names) < len(wanted):
            names.append("scalar")
        kinds = " or ".join(_SHAPES[name][0] for name in names)
        what = f"{self._subject(path)} must be {kinds}, not {_shape_of(node)}"
        if "scalar" not in names:
            return self._value(path, what, _without_space(node) or schema.get("x-write", _SHAPES[names[0]][1]))
        expected = schema.get("x-expected", "one value")
        if names == ["scalar"] and not isinstance(node, Scalar) and node.flow:
            todo = QUOTE_EXPRESSION if "expression" in expected else "put it in quotes if the brackets belong to it"
            return self._value(path, what, schema.get("x-write", todo))
        return self._value(path, what, f"write {expected}")

    def _one_of(self, error: Any, path: Path) -> Iterator[_Complaint]:
        node, schema = self.places.node(path), error.schema
        if not isinstance(node, Scalar):
            yield self._shape(path, ["string"], {})
            return
        words = [word for word in error.validator_value if isinstance(word, str)]
        if node.text in (hints := schema.get("x-hints", {})):
            what = f"'{node.text}' is not {schema.get('x-name', 'known here')}{self._inside(path)}"
            yield self._value(path, what, hints[node.text])
            return
        known = schema.get("x-known") or "known: " + ", ".join(words[:LONGEST_LIST])
        if not node.text.strip():
            yield self._value(path, f"{self._subject(path)} is empty", known)
            return
        near = did_you_mean(node.text, words)
        what = f"'{_short(node.text)}' is not {schema.get('x-name', 'known here')}{self._inside(path)}"
        yield self._value(path, what, near if near.startswith("did you mean") else known)

    def _pattern(self, error: Any, path: Path) -> Iterator[_Complaint]:
        expected, text = error.schema.get("x-expected", "what is wanted here"), error.instance
        if text.strip() in self._keys_of(error.schema.get(REFERS, "")):
            return
        if not text.strip():
            yield self._value(path, f"{self._subject(path)} is empty", f"write {expected}")
            return
        slip, meant = error.schema.get("x-slip", ("(?!)", ""))  # a nearly correct form, and its correction
        match = re.fullmatch(slip, text)
        todo = "" if match is None else f"write {match.expand(meant)}"
        yield self._value(path, f"'{_short(text)}' is not {expected}{self._inside(path)}", todo)

    def _keys_of(self, section: str) -> Collection[str]:
        """Return the keys of a section of the file; a wrong key is reported at the key, and not where it is used."""
        node = self.places.root.get(section) if section and isinstance(self.places.root, Mapping) else None
        return {entry.key.text.strip() for entry in node.entries} if isinstance(node, Mapping) else ()

    def _name(self, error: Any, path: Path) -> Problem:
        """Report a key that is not a valid name."""
        expected = error.schema.get("x-expected", "a name")
        at, node = self.places.key(path, error.instance), self.places.node(path)
        if isinstance(node, Mapping) and node.flow and looks_cut(error.instance):
            return Problem(at, CUT, QUOTE_EXPRESSION)
        within = self._subject(path)
        todo = error.schema.get("x-write", "")
        return Problem(at, f"'{_short(error.instance)}' is not {expected}, in {within}", todo)

    def _blank(self, error: Any, path: Path) -> Iterator[_Complaint]:
        yield self._value(path, f"{self._subject(path)} is empty", "write some characters, or leave it out")

    def _few(self, error: Any, path: Path) -> Iterator[_Complaint]:
        todo = error.schema.get("x-write", "write at least one entry")
        yield self._value(path, f"{self._subject(path)} is empty", todo)

    def _many(self, error: Any, path: Path) -> Iterator[_Complaint]:
        keys = list(error.instance)
        at = self.places.key(path, keys[error.validator_value])
        what = f"{self._subject(path)} has more than one entry: {', '.join(keys)}"
        yield _Complaint(path, "value", Problem(at, what, error.schema.get("x-write", "keep one")))


_WORDS: dict[str, Callable[[Messages, Any, Path], Iterator[_Complaint]]] = {
    "additionalProperties": Messages._unknown_keys,
    OWN_KEYS: Messages._near_key,
    "required": Messages._missing_keys,
    "oneOf": Messages._kinds,
    "anyOf": Messages._at_least_one,
    "dependentRequired": Messages._together,
    "not": Messages._excluded,
    "type": Messages._type,
    "enum": Messages._one_of,
    "pattern": Messages._pattern,
    "minLength": Messages._blank,
    "minItems": Messages._few,
    "minProperties": Messages._few,
    "maxProperties": Messages._many,
}

_SHAPES = {
    "object": ("a mapping", "write key: value"),
    "array": ("a list", "write [a, b], or lines that begin with '- '"),
    "scalar": ("a single value", ""),
}
_NO_SPACE = re.compile(r"([a-z_]+):(\S.*)")
_ADD = ("add it", "add them")


def _without_space(node: Node) -> str:
    """Return advice if the space between a key and its value, or a dash and its item, is missing; else ''."""
    if isinstance(node, Mapping) and node.entries and node.entries[0].key.text.startswith("-"):
        return "write a space behind the '-'"
    match = _NO_SPACE.fullmatch(node.text) if isinstance(node, Scalar) and not node.quoted else None
    return f"write {match[1]}: {match[2]} with a space" if match else ""


def _outer_keys(node: Node, unknown: Collection[str]) -> dict[str, str]:
    """Return remedies for unknown keys that follow an empty key and may lack its indentation, by key."""
    remedies, empty = {}, None
    for entry in node.entries if isinstance(node, Mapping) and not node.flow else ():
        if empty is not None and entry.key.text in unknown:
            remedies[entry.key.text] = f"indent it if it belongs to '{empty}'"
        if _is_empty(entry.value):
            empty = entry.key.text
    return remedies


def _more(number: int, noun: str) -> str:
    return plural(number, f"more {noun}")


def _is_empty(node: Node) -> bool:
    return isinstance(node, Scalar) and not node.text and not node.quoted


def _shape_of(node: Node) -> str:
    if isinstance(node, Scalar):
        return "a text" if node.text else "empty"
    return "a mapping" if isinstance(node, Mapping) else "a list"


def _short(text: str) -> str:
    text = " ".join(text.split()) if text == text.strip() else printable(text)
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 1] + "…"


Kind = Literal["protocol", "device", "run", "vectors", "memory", "faults", "jobs", "points"]

FIRST_KEYS: dict[str, Kind] = {
    "protocol": "protocol",
    "application": "protocol",
    "device": "device",
    "run": "run",
    "vectors": "vectors",
    "memory": "memory",
    "faults": "faults",
    "jobs": "jobs",
    "points": "points",
}
"""The kind of a file by its first key."""

ANY_FIRST_KEY = ", ".join(f"{key}:" for key in FIRST_KEYS)

_NAMES: dict[Kind, str] = {
    "protocol": "a protocol",
    "device": "a device file",
    "run": "a run file",
    "vectors": "a vectors file",
    "memory": "a memory profile",
    "faults": "a fault plan",
    "jobs": "a job profile",
    "points": "a points file",
}
_SUFFIX = ".schema.json"
_DEFINITION = "#/$defs/"
_WORDS_OF_HINT = re.compile(r"\w+")
_NEARLY = 0.8


def kind_of(node: Node) -> Kind:
    """Return the kind of a file, by its first key. Raises DefinitionError for an unknown key."""
    wanted = f"begin with {ANY_FIRST_KEY}"
    if not isinstance(node, Mapping) or not node.entries:
        raise DefinitionError([Problem(node.at, "the file does not begin with a key", wanted)])
    key = node.entries[0].key
    if key.text not in FIRST_KEYS:
        near = did_you_mean(key.text, FIRST_KEYS)
        what = f"the first key '{key.text}' does not say what the file is"
        raise DefinitionError([Problem(key.at, what, near if near.startswith("did you mean") else wanted)])
    return FIRST_KEYS[key.text]


def wrong_kind(node: Node, kind: Kind) -> Problem | None:
    """Return the problem of a file that is plainly of another kind than `kind`, instead of one for each key."""
    if not isinstance(node, Mapping) or not node.entries:
        return None
    first, other = node.entries[0].key, FIRST_KEYS.get(node.entries[0].key.text, kind)
    if other == kind:
        return None
    has_own_key = any(FIRST_KEYS.get(entry.key.text) == kind for entry in node.entries)
    if has_own_key and first.text in _schemas()[kind + _SUFFIX]["properties"]:
        return None
    begins = " or ".join(f"{key}:" for key, named in FIRST_KEYS.items() if named == kind)
    return Problem(first.at, f"this is {_NAMES[other]}, not {_NAMES[kind]}", f"name a file that begins with {begins}")


def validate(node: Node, kind: Kind) -> list[Problem]:
    """Return everything in a file that its schema does not allow, sorted by position."""
    broken = {Problem(node.at, what, "mend it, or remove that package") for what in import_installed()}
    cuts = without_cuts(node)
    errors = _validator(kind).iter_errors(_plain(cuts.tree))
    messages = Messages(cuts.tree, cuts.places, _known_keys)
    return sorted({*broken, *cuts.problems, *messages.problems(errors)})


def _plain(node: Node) -> Any:
    """Return the tree as dicts, lists and texts."""
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Mapping):
        return {entry.key.text: _plain(entry.value) for entry in node.entries}
    return [_plain(item) for item in node.items]


@cache
def _schemas() -> dict[str, Any]:
    """Return the shipped schemas by file name."""
    files = sorted(shipped_folder("schemas").glob(f"*{_SUFFIX}"))
    schemas = {file.name: _with_files(file.read_text(encoding="utf-8"), file.name) for file in files}
    for schema in schemas.values():
        del schema["$schema"]  # it would choose the plain validator, which does not know our keyword
    return schemas


def kind_schema(kind: Kind) -> dict[str, Any]:
    """Return the schema of a kind of file, with the keys that modules have added; it must not be changed."""
    found: dict[str, Any] = _schemas()[kind + _SUFFIX]
    return found


def referred_schema(reference: str) -> dict[str, Any]:
    """Return the definition to which a `$ref` of `kind_schema` leads."""
    file, _, name = reference.partition(_DEFINITION)
    found: dict[str, Any] = _schemas()[file]["$defs"][name]
    return found


def _with_files(text: str, file: str) -> Any:
    """Return a schema in which every `$ref` names the file that it leads to."""
    return json.loads(text.replace(f'"$ref": "{_DEFINITION}', f'"$ref": "{file}{_DEFINITION}'))


def add_keys(kind: Kind, definition: str, keys: dict[str, Any], module: str) -> None:
    """Add keys with the schemas of their values to a definition of a schema, which a module brings by itself.

    Raises ValueError for a key of another module, and for a wrong schema.
    """
    known, added = _definitions(kind)[definition]["properties"], {}
    for key, schema in keys.items():
        whole = _sound(kind, key, schema)
        bring_word(f"key of a {definition}", key, module, key in known)
        added[key] = whole
    known.update(added)


def add_kind_of(kind: Kind, thing: str, key: str, schema: dict[str, Any], module: str) -> None:
    """Add a kind of a thing (segment, sink) that a module brings by itself: the key that names it, and its schema.

    Raises ValueError for a key that already has a meaning in the thing, and for a wrong schema.
    """
    known, end = _definitions(kind), f"_{thing}"
    name, schema = f"{key}{end}", _sound(kind, key, schema)
    both = next((one for one in schema["properties"] if one != key and f"{one}{end}" in known), None)
    if both is not None:
        raise ValueError(f"the key '{both}' of '{key}' is a kind of {thing} itself – take another word")
    others = [one for title, one in known.items() if title.endswith(end) and title != name]
    exists = name in known or any(key in one.get("properties", ()) for one in others)
    bring_word(f"key of a {thing}", key, module, exists)
    if name not in known:
        known[thing]["oneOf"].append({"required": [key]})
        known[thing]["dependentSchemas"][key] = {"$ref": f"{kind}{_SUFFIX}{_DEFINITION}{name}"}
    known[name] = schema


def add_word(kind: str, definition: str, word: str) -> None:
    """Add a word to those that a key may have."""
    known = _definitions(kind)[definition]["enum"]
    if word not in known:
        known.append(word)


def _sound(kind: str, key: str, schema: Any) -> Any:
    """Return the schema of a key in the form of `_with_files`. Raises ValueError for a wrong schema or reference."""
    from jsonschema import Draft202012Validator, SchemaError

    try:
        Draft202012Validator.check_schema(schema)
    except SchemaError as error:
        raise ValueError(f"the schema of '{key}' is wrong: {error.message} – mend it") from None
    for reference in _references(schema):
        file, _, name = reference.partition(_DEFINITION)
        if name not in _schemas().get(file or kind + _SUFFIX, {}).get("$defs", ()):
            raise ValueError(f"the schema of '{key}' refers to '{reference}', which is not there – mend it")
    return _with_files(json.dumps(schema), kind + _SUFFIX)


def _references(schema: Any) -> Iterator[str]:
    """Yield every `$ref` of a schema."""
    parts = schema if isinstance(schema, list) else []
    if isinstance(schema, dict):
        parts = list(schema.values())
        if isinstance(schema.get("$ref"), str):
            yield schema["$ref"]
    for part in parts:
        yield from _references(part)


def _definitions(kind: str) -> dict[str, Any]:
    """Return the definitions of a schema for a change, and clear the caches made from them."""
    _validator.cache_clear()
    _known_keys.cache_clear()
    found: dict[str, Any] = _schemas()[kind + _SUFFIX]["$defs"]
    return found


@cache
def _validator(kind: Kind) -> Any:
    """Return the validator of a kind of file, made once a process; the library is loaded only now."""
    from jsonschema import Draft202012Validator, validators

    extend: Any = validators.extend  # it has no types
    keywords = {OWN_KEYS: _own_keys, "oneOf": _exactly_one, "pattern": _pattern, "$ref": _referred}
    return extend(Draft202012Validator, keywords)(_schemas()[kind + _SUFFIX])


def _referred(validator: Any, wanted: str, instance: Any, schema: Any) -> Iterator[Any]:
    """Validate keyword `$ref`: all references of framekit name a file and a definition, so that no resolver is
    needed.
    """
    yield from validator.descend(instance, referred_schema(wanted))


def _are_keys(branches: list[dict[str, Any]]) -> bool:
    """Return whether each branch of `oneOf` or `anyOf` only requires one key, as in all shipped schemas."""
    return all(branch.keys() == {"required"} and len(branch["required"]) == 1 for branch in branches)


def _exactly_one(validator: Any, wanted: Any, instance: Any, schema: Any) -> Iterator[Any]:
    """Validate keyword `oneOf`: of branches that require keys, exactly one key is present."""
    from jsonschema import Draft202012Validator, ValidationError

    if not _are_keys(wanted):
        yield from Draft202012Validator.VALIDATORS["oneOf"](validator, wanted, instance, schema)
    elif sum(branch["required"][0] in instance for branch in wanted) != 1:
        yield ValidationError("not exactly one")


def _pattern(validator: Any, wanted: str, instance: Any, schema: Any) -> Iterator[Any]:
    """Validate keyword `pattern` as in JSON Schema, where `$` is the very end; in Python a line end may follow."""
    from jsonschema import ValidationError

    if isinstance(instance, str) and re.search(re.sub(r"\$\Z", r"\\Z", wanted), instance) is None:
        yield ValidationError(f"{instance!r} does not match {wanted!r}")


def _own_keys(validator: Any, wanted: Any, instance: Any, schema: Any) -> Iterator[Any]:
    """Validate keyword `x-own-keys`: any key is allowed except near misspellings of the keys that have a meaning."""
    from jsonschema import ValidationError

    known = schema.get("properties", {})
    for key in instance if wanted and isinstance(instance, dict) else ():
        if key not in known and difflib.get_close_matches(key, known, n=1, cutoff=_NEARLY):
            yield ValidationError(key)


@cache
def _known_keys(reference: str) -> Iterable[str]:
    """Return the keys of a definition `FILE#/$defs/NAME`."""
    file, _, name = reference.partition(_DEFINITION)
    found = _schemas()[file]["$defs"].get(name, {})
    return tuple(found.get("properties", ()))

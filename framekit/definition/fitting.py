"""Whether what a file holds fits its schema, told quickly.

Most files fit, and need nothing else; what is wrong with the others is found by the library for JSON Schema, and worded
in `schema`. A schema becomes functions once. Values are dicts, lists and texts, as they are in files before anything is
read of them. With a keyword that is not known here nothing fits, so that the library decides.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

OWN_KEYS = "x-own-keys"
"""Keyword of mappings with free keys: a key that is nearly one of the known ones is a slip."""

NEARLY = 0.8
"""How alike two words are when one is taken for a slip of the other."""

_SHAPES: dict[str, type] = {"object": dict, "array": list, "string": str}
_SAY_NOTHING = {"title", "description", "$comment", "$defs", "then", "else"}
"""Keywords that let everything fit; `then` and `else` belong to `if`."""

Fits = Callable[[Any], bool]


def is_near(key: str, known: Iterable[str]) -> bool:
    """Whether a key is a slip of one of the known ones."""
    return bool(difflib.get_close_matches(key, list(known), n=1, cutoff=NEARLY))


def pattern_of(wanted: str) -> re.Pattern[str]:
    """A pattern as the schemas mean it: its `$` is the very end; to Python a line end may follow."""
    return re.compile(re.sub(r"\$\Z", r"\\Z", wanted))


class Fitting:
    """Makes functions of schemas, which are there by the names of their files."""

    def __init__(self, schemas: Mapping[str, Any]) -> None:
        self._schemas = schemas
        self._made: dict[str, Fits] = {}

    def of(self, reference: str) -> Fits:
        """Whether a value fits the schema that is referred to as `FILE#/$defs/NAME`, or as `FILE`."""
        if reference not in self._made:
            self._made[reference] = lambda value: self._made[reference](value)  # for schemas that hold themselves
            file, _, path = reference.partition("#")
            schema = self._schemas[file]
            for step in filter(None, path.split("/")):
                schema = schema[step]
            self._made[reference] = self._schema(schema, file)
        return self._made[reference]

    def _schema(self, schema: Any, file: str) -> Fits:
        if isinstance(schema, bool):
            return lambda value: schema
        keywords = [word for word in schema if word not in _SAY_NOTHING and (word == OWN_KEYS or word[:2] != "x-")]
        if "properties" in keywords and "additionalProperties" in keywords:
            keywords.remove("additionalProperties")
        return _all([self._keyword(word, schema, file) for word in keywords])

    def _keyword(self, word: str, schema: Mapping[str, Any], file: str) -> Fits:
        wanted = schema[word]
        if word in _PLAIN:
            return _PLAIN[word](wanted)
        match word:
            case "$ref":
                return self.of(file + wanted if wanted.startswith("#") else wanted)
            case "properties" | "additionalProperties":
                known = {key: self._schema(one, file) for key, one in schema.get("properties", {}).items()}
                return _entries(known, self._schema(schema.get("additionalProperties", True), file))
            case "propertyNames":
                key_fits = self._schema(wanted, file)
                return lambda value: not isinstance(value, dict) or all(map(key_fits, value))
            case "items":
                item_fits = self._schema(wanted, file)
                return lambda value: not isinstance(value, list) or all(map(item_fits, value))
            case "if":
                condition = self._schema(wanted, file)
                then, other = (self._schema(schema.get(branch, True), file) for branch in ("then", "else"))
                return lambda value: then(value) if condition(value) else other(value)
            case "not":
                refused = self._schema(wanted, file)
                return lambda value: not refused(value)
            case "allOf" | "anyOf" | "oneOf":
                branches = [self._schema(one, file) for one in wanted]
                if word == "allOf":
                    return _all(branches)
                if word == "anyOf":
                    return lambda value: any(fits(value) for fits in branches)
                return lambda value: [fits(value) for fits in branches].count(True) == 1
            case _ if word == OWN_KEYS:
                names = schema.get("properties", {})
                return lambda value: (
                    not wanted
                    or not isinstance(value, dict)
                    or not any(key not in names and is_near(key, names) for key in value)
                )
        return lambda value: False


def _all(checks: list[Fits]) -> Fits:
    if len(checks) == 1:
        return checks[0]

    def fits(value: Any) -> bool:
        for check in checks:  # noqa: SIM110 - a generator takes twice as long
            if not check(value):
                return False
        return True

    return fits


def _entries(known: dict[str, Fits], others: Fits) -> Fits:
    def fits(value: Any) -> bool:
        if isinstance(value, dict):
            for key, one in value.items():
                if not known.get(key, others)(one):
                    return False
        return True

    return fits


def _shape(wanted: str | list[str]) -> Fits:
    shapes = tuple(_SHAPES[one] for one in ([wanted] if isinstance(wanted, str) else wanted) if one in _SHAPES)
    return lambda value: isinstance(value, shapes)


def _matches(wanted: str) -> Fits:
    search = pattern_of(wanted).search
    return lambda value: not isinstance(value, str) or search(value) is not None


_PLAIN: dict[str, Callable[[Any], Fits]] = {
    "type": _shape,
    "pattern": _matches,
    "enum": lambda wanted: lambda value: value in wanted,
    "required": lambda wanted: lambda value: not isinstance(value, dict) or all(key in value for key in wanted),
    "dependentRequired": lambda wanted: (
        lambda value: (
            not isinstance(value, dict)
            or all(other in value for key, needed in wanted.items() if key in value for other in needed)
        )
    ),
    "minProperties": lambda wanted: lambda value: not isinstance(value, dict) or len(value) >= wanted,
    "maxProperties": lambda wanted: lambda value: not isinstance(value, dict) or len(value) <= wanted,
    "minItems": lambda wanted: lambda value: not isinstance(value, list) or len(value) >= wanted,
    "minLength": lambda wanted: lambda value: not isinstance(value, str) or len(value) >= wanted,
}
"""Keywords that need no other schema."""

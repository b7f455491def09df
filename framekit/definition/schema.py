"""Validation of files against the JSON schemas, with every problem at its exact place.

The schemas say which keys there are and what their values look like; names, expressions and everything that concerns
more than one key is the loaders' and the checker's.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any, Literal

from framekit.definition.cut_expressions import without_cuts
from framekit.definition.problems import DefinitionError, Problem, did_you_mean
from framekit.definition.schema_messages import OWN_KEYS, Messages
from framekit.definition.shipped import shipped_folder
from framekit.definition.tree import Mapping, Node, Scalar

Kind = Literal["protocol", "device", "run", "vectors", "memory", "faults", "jobs"]

FIRST_KEYS: dict[str, Kind] = {
    "protocol": "protocol",
    "application": "protocol",
    "device": "device",
    "run": "run",
    "vectors": "vectors",
    "memory": "memory",
    "faults": "faults",
    "jobs": "jobs",
}
"""What a file is, by its first key."""

_NAMES: dict[Kind, str] = {
    "protocol": "a protocol",
    "device": "a device file",
    "run": "a run file",
    "vectors": "a vectors file",
    "memory": "a memory profile",
    "faults": "a fault plan",
    "jobs": "a job profile",
}
_SUFFIX = ".schema.json"
_NEARLY = 0.8


def kind_of(node: Node) -> Kind:
    """What kind of file this is, by its first key. Raises DefinitionError when that is none of the known."""
    wanted = "begin with " + ", ".join(f"{key}:" for key in FIRST_KEYS)
    if not isinstance(node, Mapping) or not node.entries:
        raise DefinitionError([Problem(node.at, "the file does not begin with a key", wanted)])
    key = node.entries[0].key
    if key.text not in FIRST_KEYS:
        near = did_you_mean(key.text, FIRST_KEYS)
        what = f"the first key '{key.text}' does not say what the file is"
        raise DefinitionError([Problem(key.at, what, near if near.startswith("did you mean") else wanted)])
    return FIRST_KEYS[key.text]


def wrong_kind(node: Node, kind: Kind) -> Problem | None:
    """What is wrong with a file that is plainly of another kind than `kind`: one problem, not one for each key."""
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
    """Everything in a file that its schema does not allow, sorted by position; nothing when it is all right."""
    cuts = without_cuts(node)
    errors = _validator(kind).iter_errors(_plain(cuts.tree))
    messages = Messages(cuts.tree, cuts.places, _known_keys)
    return sorted({*cuts.problems, *messages.problems(errors)})


def _plain(node: Node) -> Any:
    """The tree as dicts, lists and texts."""
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Mapping):
        return {entry.key.text: _plain(entry.value) for entry in node.entries}
    return [_plain(item) for item in node.items]


@cache
def _schemas() -> dict[str, Any]:
    """The shipped schemas by file name."""
    files = sorted(shipped_folder("schemas").glob(f"*{_SUFFIX}"))
    schemas = {file.name: json.loads(file.read_text(encoding="utf-8")) for file in files}
    for schema in schemas.values():
        del schema["$schema"]  # it would choose the plain validator, which does not know our keyword
    return schemas


def add_keys(kind: Kind, definition: str, keys: dict[str, Any]) -> None:
    """Adds keys with the schemas of their values to a definition of a schema, for what programs bring by themselves."""
    _schemas()[kind + _SUFFIX]["$defs"][definition]["properties"].update(keys)
    _validator.cache_clear()
    _known_keys.cache_clear()


@cache
def _validator(kind: Kind) -> Any:
    """The validator of a kind of file, made once a process; the libraries are loaded only now."""
    from jsonschema import Draft202012Validator, validators
    from referencing import Registry
    from referencing.jsonschema import DRAFT202012

    resources = [(name, DRAFT202012.create_resource(schema)) for name, schema in _schemas().items()]
    registry: Registry[Any] = Registry().with_resources(resources)
    extend: Any = validators.extend  # it has no types
    validator = extend(Draft202012Validator, {OWN_KEYS: _own_keys, "pattern": _pattern})
    return validator({"$ref": kind + _SUFFIX}, registry=registry)


def _pattern(validator: Any, wanted: str, instance: Any, schema: Any) -> Iterator[Any]:
    """Keyword `pattern`: as in the schemas' own language, its `$` is the very end; to Python a line end may follow."""
    from jsonschema import ValidationError

    if isinstance(instance, str) and re.search(re.sub(r"\$\Z", r"\\Z", wanted), instance) is None:
        yield ValidationError(f"{instance!r} does not match {wanted!r}")


def _own_keys(validator: Any, wanted: Any, instance: Any, schema: Any) -> Iterator[Any]:
    """Keyword `x-own-keys`: any key is allowed, except what is nearly one of the keys that have a meaning."""
    from jsonschema import ValidationError

    known = schema.get("properties", {})
    for key in instance if wanted and isinstance(instance, dict) else ():
        if key not in known and difflib.get_close_matches(key, known, n=1, cutoff=_NEARLY):
            yield ValidationError(key)


@cache
def _known_keys(reference: str) -> Iterable[str]:
    """The keys of a definition `#/$defs/NAME` of the protocol schema."""
    name = reference.rpartition("/")[2]
    found = _schemas()["protocol" + _SUFFIX]["$defs"].get(name, {})
    return tuple(found.get("properties", ()))

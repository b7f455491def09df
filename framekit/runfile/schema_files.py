"""The parts of `schemas/` generated from tables of keys: `python -m framekit.runfile.schema_files` writes them.

The files are stored in the repository for editors, and read at run time; a test compares them with the tables.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from framekit.definition.keys import here, properties_of, ref, required_of
from framekit.definition.kinds.base import KINDS
from framekit.definition.model import segments
from framekit.definition.model.procedure import Action, Row, Step
from framekit.definition.model.services import UNIT_BITS
from framekit.definition.nodes import LANGUAGE
from framekit.definition.schema import FIRST_KEYS
from framekit.definition.sources import shipped_folder
from framekit.definition.wire_types import TYPES
from framekit.memory.views import ORDERS, VIEWS
from framekit.run.behaviours import BEHAVIOURS
from framekit.run.behaviours import schema_of as schema_of_behaviour
from framekit.run.triggers import TRIGGERS
from framekit.runfile import behave as behave  # registers a kind of behaviour
from framekit.sinks import SINKS
from framekit.sinks.base import schema_of
from framekit.table_of_extras import SCHEMAS, load

WIDTH = 140
"""Line width (characters) for values that contain other mappings."""

PARTS = (
    ("step", Step, "What it does, in a sentence."),
    ("row", Row, "Why, in a sentence."),
    ("action", Action, "Why, in a sentence."),
)
"""Definitions of the schema with the classes that their keys are read into, and the description of their `doc`."""

VERSION = {
    "enum": [LANGUAGE, str(LANGUAGE)],
    "x-name": "a version of the language",
    "description": "Version of the language that the file is written in.",
}

Schemas = dict[str, dict[str, Any]]


def with_tables(schemas: Schemas) -> Schemas:
    """Return the schemas, by file name, completed from the tables of keys."""
    assert segments.Segment in KINDS["field"].__mro__  # the kinds are registered
    protocol, common = schemas["protocol.schema.json"]["$defs"], schemas["common.schema.json"]["$defs"]
    names = {f"{key}_segment": kind.schema() for key, kind in KINDS.items()}
    protocol["segment"]["oneOf"] = [{"required": [key]} for key in KINDS]
    protocol["segment"]["dependentSchemas"] = {key: here(f"{key}_segment") for key in KINDS}
    common["type_name"]["enum"] = list(TYPES)
    protocol.update(names)
    for name, part, doc in PARTS:
        protocol[name]["properties"] = {**properties_of(part), "doc": {**ref("text"), "description": doc}}
        assert set(required_of(part)) <= {*protocol[name].get("required", ())}, f"{name} has other required keys"
    block = schemas["run.schema.json"]["$defs"]["block"]["properties"]
    block.update((key, schema) for kind in TRIGGERS.values() for key, schema in kind.schemas.items())
    with_kinds(schemas["run.schema.json"]["$defs"], "sink", {word: schema_of(kind) for word, kind in SINKS.items()})
    schemas["run.schema.json"]["$defs"].update((name, load(target)()) for name, target in SCHEMAS.items())
    behaviours = {word: schema_of_behaviour(kind) for word, kind in BEHAVIOURS.items()}
    with_kinds(schemas["device.schema.json"]["$defs"], "behaviour", behaviours)
    point = schemas["points.schema.json"]["$defs"]["point"]["properties"]
    for name in sorted({f"{kind}.schema.json" for kind in FIRST_KEYS.values()}):
        schemas[name]["properties"]["framekit"] = VERSION
    point["type"]["enum"], point["order"]["enum"] = [*UNIT_BITS, *VIEWS], list(ORDERS)
    return schemas


def with_kinds(definitions: dict[str, Any], thing: str, kinds: dict[str, Any]) -> None:
    """Insert kinds, by the keys that name them, into the definitions of a schema."""
    names = {word: f"{word.replace(' ', '_')}_{thing}" for word in kinds}
    definitions[thing]["oneOf"] = [{"required": [word]} for word in kinds]
    definitions[thing]["dependentSchemas"] = {word: here(name) for word, name in names.items()}
    definitions.update((names[word], schema) for word, schema in kinds.items())


def read_files(folder: Path) -> Schemas:
    return {file.name: json.loads(file.read_text("utf-8")) for file in sorted(folder.glob("*.schema.json"))}


def text_of(schema: Any, indent: int = 0) -> str:
    """Return a schema as JSON text: a value without inner mappings, or a short one, on one line."""
    flat = json.dumps(schema, ensure_ascii=False)
    parts = schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ()
    deep = any(isinstance(part, dict) for part in parts)
    if not parts or not deep or (len(flat) + indent <= WIDTH and isinstance(schema, list)):
        return flat
    short = isinstance(schema, dict) and len(flat) + indent <= WIDTH and not schema.keys() & {"properties", "$defs"}
    if short:
        return flat
    space, end = " " * (indent + 2), " " * indent
    if isinstance(schema, dict):
        lines = [f"{space}{json.dumps(key)}: {text_of(part, indent + 2)}" for key, part in schema.items()]
        return "{\n" + ",\n".join(lines) + f"\n{end}}}"
    return "[\n" + ",\n".join(f"{space}{text_of(part, indent + 2)}" for part in schema) + f"\n{end}]"


def main() -> None:
    folder = shipped_folder("schemas")
    for name, schema in with_tables(read_files(folder)).items():
        (folder / name).write_text(text_of(schema) + "\n", "utf-8")


if __name__ == "__main__":
    main()

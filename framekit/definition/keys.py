"""A table of keys for each part of a definition: name of the key, form of its value, reader.

The table of a part is its class in the model: each attribute that a key gives is declared with `key`. The schema of the
part is generated from it (`properties_of`), and a mapping is read by it (`read_keys`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from collections.abc import Mapping as MappingOf
from dataclasses import MISSING, field, fields
from functools import cache
from typing import Any, Literal, NamedTuple, TypeVar
from typing import Protocol as Interface

from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.values import Table
from framekit.definition.problems import Position
from framekit.definition.tree import Mapping, Node, Sequence

T = TypeVar("T")
Schema = MappingOf[str, Any]
ValueKind = Literal["number", "time", "text", "bytes", "list", "record", "frame", "table", "any"]
"""Kinds of values in expressions."""


class Meanings(Interface):
    """Meanings of names in the scope of a reader."""

    reader: Reader
    circles: set[frozenset[str]]
    too_much: bool
    too_large: set[Position]

    def order(self, file: str) -> str: ...
    def turns_conversions(self, file: str) -> bool: ...
    def layout(self, node: Node) -> tuple[Sequence, Meanings]: ...
    def table(self, name: str) -> Table | None: ...
    def section(self, key: str) -> MappingOf[str, Any]: ...
    def check(self, node: Node) -> CheckMethod: ...


class KeyReading:
    """A mapping being read into a class: its keys, the attributes read so far, and the loader."""

    def __init__(self, loader: Any, keys: Mapping) -> None:
        self.loader = loader
        self.space: Meanings = getattr(loader, "space", None)  # type: ignore[assignment]  # None without a scope
        self.reader: Reader = loader.reader
        self.keys = keys
        self.found: dict[str, Any] = Attributes()


class Attributes(dict[str, Any]):
    """The attributes read so far by name; an attribute that follows from a broken key is broken, too."""

    def __missing__(self, attribute: str) -> Any:
        raise Broken(attribute)


class Form(NamedTuple):
    """Form of the value of a key: its schema and its reader; for an expression, the required kind."""

    schema: Schema
    read: Callable[[KeyReading, Node], Any]
    kind: ValueKind | None = None


class Key(NamedTuple):
    """The keys that give an attribute: their schemas by name, and the function that derives the attribute."""

    schemas: MappingOf[str, Schema]
    read: Callable[[KeyReading], Any]
    required: bool
    kind: ValueKind | None = None


def key(
    name: str, form: Form, doc: str = "", *, default: Any = MISSING, factory: Callable[[], Any] | None = None
) -> Any:
    """Declare an attribute that one key gives; without `default` or `factory` the key is required."""
    if factory is None:
        return field(default=default, metadata={"key": key_of(name, form, doc, default)})
    read = key_of(name, form, doc, None).read
    return keys({name: form.schema}, lambda r: factory() if name not in r.keys else read(r), factory=factory)


def key_of(name: str, form: Form, doc: str = "", default: Any = MISSING) -> Key:
    """Return a row of a table: a key and the form of its value."""

    def read(reading: KeyReading) -> Any:
        node = reading.keys.get(name)
        return default if node is None and default is not MISSING else form.read(reading, node)  # type: ignore[arg-type]

    schema = {**form.schema, "description": doc} if doc else form.schema
    return Key({name: schema}, read, default is MISSING, form.kind)


def keys(
    schemas: MappingOf[str, Schema],
    read: Callable[[KeyReading], Any],
    *,
    default: Any = MISSING,
    factory: Callable[[], Any] | None = None,
) -> Any:
    """Declare an attribute that several keys give together. `factory` makes its value if they are missing."""
    metadata = {"key": Key(schemas, read, default is MISSING and factory is None)}
    return (
        field(default=default, metadata=metadata)
        if factory is None
        else field(default_factory=factory, metadata=metadata)
    )


@cache
def table_of(part: type) -> MappingOf[str, Key]:
    """Return the keys of a class by attribute."""
    return {one.name: one.metadata["key"] for one in fields(part) if "key" in one.metadata}


def properties_of(part: type) -> dict[str, Schema]:
    """Return the schemas of all keys of a class, by name."""
    return {name: schema for one in table_of(part).values() for name, schema in one.schemas.items()}


def required_of(part: type) -> Iterator[str]:
    """Return the names of the required keys of a class."""
    return (next(iter(one.schemas)) for one in table_of(part).values() if one.required)


def read_keys(
    part: type, loader: Any, mapping: Mapping, broken: Callable[[], None] | None = None, **known: Any
) -> dict[str, Any]:
    """Return the attributes that the keys of a mapping give, in the order of the table, after the `known` ones.

    Read all keys, so that the problems of each are noted; then raise Broken if a key is broken. With `broken`, call it
    instead and leave the attribute of the key out; raise Broken only for a required key.
    """
    reading = KeyReading(loader, mapping)
    reading.found.update(known)
    missing: Broken | None = None
    for attribute, one in table_of(part).items():
        try:
            reading.found[attribute] = one.read(reading)
        except Broken as error:
            if broken is not None:
                broken()
            missing = missing or (error if one.required or broken is None else None)
    if missing is not None:
        raise missing
    return reading.found


def read_part(part: type[T], loader: Any, node: Node | None, **known: Any) -> T:
    """Read a mapping into a class by its table; `known`: attributes given in advance. Raises Broken."""
    mapping = loader.reader.mapping(node)
    if "at" in part.__dataclass_fields__:  # type: ignore[attr-defined]
        known.setdefault("at", mapping.at)
    return part(**read_keys(part, loader, mapping, **known))


def mapping_of(part: type, schema: Schema) -> Form:
    """Return the form of a mapping that is read into a class."""
    return Form(schema, lambda r, node: read_part(part, r.loader, node))


def list_of(part: type, schema: Schema) -> Form:
    """Return the form of mappings that are read into a class; a single mapping counts as a list."""

    def read(reading: KeyReading, node: Node) -> tuple[Any, ...]:
        return reading.reader.each(reading.reader.items(node), lambda item: read_part(part, reading.loader, item))

    return Form(schema, read)


def expressions_with_kinds(part: Any) -> Iterator[tuple[Any, ValueKind]]:
    """Yield the expressions of a part that require a kind, each with the kind."""
    for attribute, one in table_of(part.__class__).items():
        if one.kind is not None:
            yield getattr(part, attribute), one.kind


def mapping_schema(
    part: type, title: str, *, required: Iterable[str] | None = None, doc: str | None = None, **more: Any
) -> dict[str, Any]:
    """Return the schema of a mapping that is read into a class.

    `doc`: description of the key `doc`, which is not read.
    """
    wanted = list(required_of(part) if required is None else required)
    head: dict[str, Any] = {"title": title, "type": "object", **({"required": wanted} if wanted else {}), **more}
    properties = {**properties_of(part), **({} if doc is None else {"doc": {**ref("text"), "description": doc}})}
    return {**head, "properties": properties, "additionalProperties": False}


def kind_schema(kind: type, title: str) -> dict[str, Any]:
    """Return the schema of a registered kind; the first line of its docstring describes it."""
    return mapping_schema(kind, title, description=(kind.__doc__ or "").strip().partition("\n")[0])


# ---- forms of values ----------------------------------------------------------------------------------------


def ref(name: str) -> Schema:
    """Return a reference to a schema in the file of common schemas."""
    return {"$ref": f"common.schema.json#/$defs/{name}"}


def here(name: str) -> Schema:
    """Return a reference to a schema in the same file."""
    return {"$ref": f"#/$defs/{name}"}


def words(name: str, *known: str | int | bool) -> Schema:
    """Return the schema of a word of a list; `name`: its noun in messages."""
    return {"enum": list(known), "x-name": name}


TEXT = Form(ref("text"), lambda r, node: r.reader.text(node))
IDENTIFIER = Form(ref("identifier"), lambda r, node: r.reader.text(node))
LABEL = Form(ref("label"), lambda r, node: r.reader.text(node))
LABELS = Form(ref("labels"), lambda r, node: r.reader.texts(node))
ADDRESS = Form(ref("address"), lambda r, node: r.reader.text(node))
NUMBER = Form(ref("number"), lambda r, node: r.reader.number(node))
BYTES_AT_MOST = Form(ref("number"), lambda r, node: r.reader.bytes_at_most(node))
FLAG = Form(ref("flag"), lambda r, node: r.reader.flag(node))
BYTES = Form(ref("bytes"), lambda r, node: r.reader.bytes(node))
BYTE = Form(ref("byte"), lambda r, node: r.reader.byte(node))
RANGE = Form(ref("range"), lambda r, node: r.reader.range(node))
EXPRESSION = Form(ref("expression"), lambda r, node: r.reader.expression(node))
CONDITION = EXPRESSION._replace(kind="any")
TIME = EXPRESSION._replace(kind="time")
COUNT = EXPRESSION._replace(kind="number")
OCTETS = EXPRESSION._replace(kind="bytes")

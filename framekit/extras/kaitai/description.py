"""Read a Kaitai Struct file: its types with their attributes, instances and enumerations, with positions.

Names are not resolved here. A part with a wrong form is reported, and the correct parts around it are kept. Source: the
user guide of Kaitai Struct and the reference of the KSY format.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol as Interface

from framekit.definition.nodes import Mapping, Node, Scalar, Sequence
from framekit.definition.problems import CannotSayError, Position

DEEPEST_TYPES = 40
"""Limit of the nesting depth of types."""
NAME = re.compile(r"[a-z][a-z0-9_]*")
_WHOLE = re.compile(r"[-+]?(?:0[xX][0-9a-fA-F_]+|0[bB][01_]+|0[oO][0-7_]+|[0-9][0-9_]*)")
_TWO_NUMBERS = re.compile(r"[-+]?(?:0[0-7_]*[1-7][0-7_]+|[1-9][0-9_]*(?::[0-5]?[0-9])+)")
"""Plain scalars that YAML 1.1 (Kaitai's compilers) reads as other numbers than YAML 1.2: octal and base 60."""
_META_SAYS_NOTHING = (
    "application", "file-extension", "xref", "license", "ks-version", "ks-debug", "ks-opaque-types", "tags",
)  # fmt: skip
_NOT_OF_BYTES = "a definition has no place for it"


@dataclass(frozen=True, slots=True)
class KsyEnum:
    """An enumeration: its numbers with their names."""

    place: tuple[str, ...]
    """The types around it, outermost first, and its name."""
    members: dict[str, int]
    docs: dict[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class KsyAttribute:
    """An attribute, an instance or a parameter, with the keys of the file."""

    at: Position
    name: str
    keys: dict[str, Node]

    @property
    def doc(self) -> str:
        parts = (self.keys.get(key) for key in ("doc", "doc-ref"))
        return " ".join(one for part in parts if part is not None for one in texts(part))

    def text(self, key: str) -> str | None:
        """Return the text of a key. Raises CannotSayError for a list or a mapping."""
        node = self.keys.get(key)
        return None if node is None else scalar(node, key).text

    def flag(self, key: str, default: bool) -> bool:
        """Return the truth value of a key. Raises CannotSayError for any other value."""
        node = self.keys.get(key)
        if node is None:
            return default
        text = scalar(node, key).text.lower()
        if text not in ("true", "false", "yes", "no"):
            raise CannotSayError(node.at, f"{key}: {text!r}", "write true or false")
        return text in ("true", "yes")

    def byte(self, key: str) -> int | None:
        """Return the byte of a key, 0 to 255, or None. Raises CannotSayError for any other value."""
        node = self.keys.get(key)
        if node is None:
            return None
        number = whole(scalar(node, key).text)
        if number is None or not 0 <= number <= 255:
            raise CannotSayError(node.at, f"{key}: is no byte", "only ends and fillings of one byte are taken over")
        return number


@dataclass(slots=True, eq=False)
class KsyType:
    """A type; `around` is the enclosing type, None for the type of the file."""

    name: str
    at: Position
    around: KsyType | None
    depth: int = 0
    endian: str | None = None
    bit_endian: str = "be"
    encoding: str | None = None
    doc: str = ""
    seq: list[KsyAttribute] = field(default_factory=list)
    instances: dict[str, KsyAttribute] = field(default_factory=dict)
    params: dict[str, KsyAttribute] = field(default_factory=dict)
    types: dict[str, KsyType] = field(default_factory=dict)
    enums: dict[str, KsyEnum] = field(default_factory=dict)

    @property
    def names(self) -> frozenset[str]:
        """Return the names of all its values."""
        return frozenset((*(one.name for one in self.seq), *self.instances, *self.params))

    @property
    def path(self) -> tuple[str, ...]:
        """Return the enclosing types, outermost first, and the own name; the type of the file is omitted."""
        return () if self.around is None else (*self.around.path, self.name)

    def outwards(self) -> Iterator[KsyType]:
        """Yield the type and its enclosing types, innermost first."""
        here: KsyType | None = self
        while here is not None:
            yield here
            here = here.around

    def find_type(self, name: str) -> KsyType | None:
        """Return the type that a name, or `outer::inner`, means in this type; None if it is unknown."""
        first, *others = name.removeprefix("::").split("::")
        for here in self.outwards():
            found: KsyType | None = here.types.get(first)
            if found is not None:
                for other in others:
                    found = found.types.get(other) if found is not None else None
                return found
            if here.around is None and here.name == first:
                return here
        return None

    def find_enum(self, path: tuple[str, ...]) -> KsyEnum | None:
        """Return the enumeration that a name means in this type; None if it is unknown."""
        *outer, name = path
        for here in self.outwards():
            there: KsyType | None = here
            for one in outer:
                there = there.types.get(one) if there is not None else None
            if there is not None and name in there.enums:
                return there.enums[name]
        return None


@dataclass(slots=True)
class Description:
    """A file: `top` is its type, `title` and `source` come from its meta section."""

    top: KsyType
    title: str
    source: str


class Tell(Interface):
    """Report an omitted part, or as a warning a part that differs or does not concern bytes."""

    def __call__(self, at: Position, what: str, todo: str, *, warning: bool = False) -> None: ...


def scalar(node: Node, key: str) -> Scalar:
    """Return a node as a scalar. Raises CannotSayError for a list or a mapping."""
    if not isinstance(node, Scalar):
        raise CannotSayError(node.at, f"{key}: holds a list or a mapping", "write a single value")
    return one_number(node)


def one_number(node: Scalar) -> Scalar:
    """Return a scalar unchanged. Raises CannotSayError for a number that YAML 1.1 and 1.2 read differently."""
    if not node.quoted and _TWO_NUMBERS.fullmatch(node.text.strip()):
        what = f"the number {node.text[:20]} is another one in YAML 1.1 than in 1.2"
        raise CannotSayError(node.at, what, "write it in base 10 or 16, without zeros before it")
    return node


def texts(node: Node) -> Iterator[str]:
    """Yield the texts of a scalar or of a list of scalars, each on one line."""
    for one in node.items if isinstance(node, Sequence) else (node,):
        if isinstance(one, Scalar):
            yield " ".join(one.text.split())


def whole(text: str) -> int | None:
    """Return a whole number in Kaitai's notation; None for any other text."""
    text = text.strip()
    if len(text) > 80 or not _WHOLE.fullmatch(text):
        return None
    digits = text.replace("_", "")
    try:
        return int(digits, 0 if digits.lstrip("-+")[1:2].isalpha() else 10)
    except ValueError:  # for example a bare 0x
        return None


def read_description(root: Node, tell: Tell) -> Description | None:
    """Return the file of a tree; None, after a report, if the tree is not a mapping."""
    if not isinstance(root, Mapping):
        tell(root.at, "this is no description of Kaitai Struct", "begin with meta:")
        return None
    reader = _KsyReader(tell)
    meta = root.value("meta")
    name = "frame"
    titles: list[str] = []
    sources: list[str] = []
    if isinstance(meta, Mapping):
        name = next((one for one in reader.texts_of(meta, "id") if NAME.fullmatch(one)), name)
        titles = [*reader.texts_of(meta, "title")]
    sources = [*reader.texts_of(root, "doc-ref")]
    top = reader.type_of(name, root, None)
    return Description(top, " ".join(titles), ", ".join(sources))


class _KsyReader:
    """Read the nodes of a file into types, and report wrong forms."""

    def __init__(self, tell: Tell) -> None:
        self.tell = tell

    @staticmethod
    def texts_of(node: Mapping, key: str) -> Iterator[str]:
        value = node.value(key)
        return texts(value) if value is not None else iter(())

    def type_of(self, name: str, node: Mapping, around: KsyType | None) -> KsyType:
        found = KsyType(name, node.at, around, 0 if around is None else around.depth + 1)
        if around is not None:
            found.endian, found.bit_endian, found.encoding = around.endian, around.bit_endian, around.encoding
        meta = node.value("meta")
        if meta is not None:
            self._meta(found, meta)
        for entry in node.entries:
            key, value = entry.key.text, entry.value
            match key:
                case "meta":
                    pass
                case "doc":
                    found.doc = " ".join(texts(value))
                case "doc-ref":
                    if around is not None:
                        found.doc = " ".join((*found.doc.split(), *texts(value)))
                case "seq":
                    found.seq = [*self._attributes(value)]
                case "params":
                    found.params = {one.name: one for one in self._attributes(value)}
                case "instances":
                    found.instances = dict(self._instances(value))
                case "enums":
                    found.enums = dict(self._enums(value, found.path))
                case "types":
                    self._types(found, value)
                case _:
                    self.tell(entry.key.at, f"the key {key!r} of the type {name!r} is left out", _NOT_OF_BYTES)
        return found

    def _meta(self, into: KsyType, node: Node) -> None:
        if not isinstance(node, Mapping):
            self.tell(node.at, "meta: holds no keys", "write meta: {id: …}")
            return
        for entry in node.entries:
            key, value = entry.key.text, entry.value
            text = value.text if isinstance(value, Scalar) else ""
            if key == "imports":
                self.tell(value.at, "what imports: names is left out", "put its types into this file")
            elif key == "endian":
                into.endian = text
                if text not in ("le", "be"):
                    into.endian = None
                    self.tell(value.at, "a byte order that depends on values", "write le or be, or import it twice")
            elif key == "bit-endian" and text in ("le", "be"):
                into.bit_endian = text
            elif key == "encoding" and text:
                into.encoding = text
            elif key in _META_SAYS_NOTHING:
                self.tell(entry.key.at, f"meta/{key} is left out", _NOT_OF_BYTES, warning=True)
            elif key not in ("id", "title"):
                self.tell(entry.key.at, f"the key meta/{key} is left out", "correct it, or leave it out")

    def _attributes(self, node: Node) -> Iterator[KsyAttribute]:
        if not isinstance(node, Sequence):
            self.tell(node.at, "this is no list of attributes", "write - id: NAME")
            return
        known: set[str] = set()
        for number, item in enumerate(node.items):
            if not isinstance(item, Mapping):
                self.tell(item.at, "this is no attribute", "write id: NAME and what it is")
                yield KsyAttribute(item.at, f"unnamed_{number}", {"": item})
                continue
            keys = {entry.key.text: entry.value for entry in item.entries}
            written = keys.get("id")
            name = written.text if isinstance(written, Scalar) else ""
            if written is not None and (not NAME.fullmatch(name) or name in known):
                self.tell(written.at, f"{name[:40]!r} cannot be a name here", "small letters, digits and _, each once")
                keys[""] = written
            if written is None or name in known or not NAME.fullmatch(name):
                name = f"unnamed_{number}"
            known.add(name)
            yield KsyAttribute(item.at, name, keys)

    def _instances(self, node: Node) -> Iterator[tuple[str, KsyAttribute]]:
        for name, value in self._named(node, "instances"):
            if isinstance(value, Mapping):
                yield name, KsyAttribute(value.at, name, {entry.key.text: entry.value for entry in value.entries})
            else:
                self.tell(value.at, f"the instance {name!r} has no keys", "write value: EXPRESSION")

    def _named(self, node: Node, what: str) -> Iterator[tuple[str, Node]]:
        if not isinstance(node, Mapping):
            self.tell(node.at, f"{what}: holds no names", "write NAME: …")
            return
        for entry in node.entries:
            if NAME.fullmatch(entry.key.text):
                yield entry.key.text, entry.value
            else:
                self.tell(entry.key.at, f"{entry.key.text[:40]!r} cannot be a name here", "small letters, digits and _")

    def _types(self, into: KsyType, node: Node) -> None:
        for name, value in self._named(node, "types"):
            if not isinstance(value, Mapping):
                self.tell(value.at, f"the type {name!r} has no keys", "write seq: …")
            elif into.depth >= DEEPEST_TYPES:
                self.tell(value.at, f"types stand deeper inside each other than {DEEPEST_TYPES}", "take them out")
            else:
                into.types[name] = self.type_of(name, value, into)

    def _enums(self, node: Node, around: tuple[str, ...]) -> Iterator[tuple[str, KsyEnum]]:
        for name, value in self._named(node, "enums"):
            members: dict[str, int] = {}
            docs: dict[str, str] = {}
            for entry in value.entries if isinstance(value, Mapping) else ():
                try:
                    one_number(entry.key)
                except CannotSayError as error:
                    self.tell(error.problem.at, error.problem.what, error.problem.todo)
                    continue
                number, said = whole(entry.key.text), entry.value
                member = said.value("id") if isinstance(said, Mapping) else said
                text = member.text if isinstance(member, Scalar) else ""
                if number is None or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", text) or text in members:
                    self.tell(entry.key.at, f"a member of {name!r} that is no number with a name", "write 1: NAME")
                elif number in members.values():
                    self.tell(entry.key.at, f"the number {number} of {name!r} has two names", "leave one out")
                else:
                    members[text] = number
                    if isinstance(said, Mapping) and (about := " ".join(self.texts_of(said, "doc"))):
                        docs[text] = about
            yield name, KsyEnum((*around, name), members, docs)

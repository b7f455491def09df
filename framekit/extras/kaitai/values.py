"""Convert single values of a Kaitai Struct file to segments: numbers, texts, bytes, constants, and `valid`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Protocol as Interface

from framekit.definition.expression import (
    ATOM,
    Compare,
    Logic,
    Name,
    Node,
)
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.nodes import Node as YamlNode
from framekit.definition.nodes import Scalar, Sequence
from framekit.definition.problems import CannotSayError, Position
from framekit.definition.wire_types import ANY, Sizes, bounds_of_bits, exactly
from framekit.extras.kaitai.attributes import (
    OF_ALL,
    OF_BYTES,
    OF_TEXTS,
    FileParts,
    Keys,
    KsyPart,
    Region,
    contents_of,
    plain_encoding,
)
from framekit.extras.kaitai.description import KsyAttribute, KsyEnum, scalar
from framekit.extras.kaitai.translation import (
    IT,
    UNKNOWN,
    Kind,
    KsyMeaning,
    KsyScope,
    Translated,
    bytes_text,
    constant,
)

_COMPARISONS = {"eq": "==", "min": ">=", "max": "<="}
"""The operators of the rules of `valid` that compare with a single value."""
_PROCESS = re.compile(r"(?:xor|rol|ror)\((?:0x[0-9a-fA-F]+|[0-9]+)\)")
_LATIN_1 = ("iso88591", "latin1")
_ASCII = ("ascii", "usascii")
_LIKE_ASCII = re.compile(r"utf8|iso8859\d+|windows125\d|cp(?:125\d|437|85\d|866)|ibm(?:437|85\d|866)|koi8[ru]|macroman")


class Within(Interface):
    """The use of a type that contains the values."""

    file: FileParts
    scope: KsyScope
    region: Region

    def parsed(self, text: Scalar) -> Node:
        """Return the tree of an expression. Raises CannotSayError."""

    def say(
        self, node: Node, at: Position, kind: Kind | None = None, *,
        it: Translated | None = None, item: KsyScope | None = None, lazily: bool = False,
    ) -> Translated:  # fmt: skip
        """Return an expression in framekit's language. Raises CannotSayError."""

    def size(self, attribute: KsyAttribute, behind: int | None, item: KsyScope | None) -> int | str:
        """Return a number of bytes, an expression, or `rest`. Raises CannotSayError."""

    def take_all(self, at: Position, behind: int | None, what: str) -> None:
        """Record that a part takes all remaining bytes of the region. Raises CannotSayError."""


class KsyValueWriter:
    """Write the values of one use of a type. Every method raises CannotSayError for a value without a form."""

    def __init__(self, within: Within) -> None:
        self.within = within

    def only(self, attribute: KsyAttribute, more: frozenset[str]) -> None:
        """Raise CannotSayError for keys that have no meaning with this type."""
        for key in attribute.keys:
            if key not in OF_ALL | more and not key.startswith("-"):
                raise CannotSayError(
                    attribute.keys[key].at, f"{key}: of '{attribute.name}' beside its type", "leave it out"
                )

    def enum(self, attribute: KsyAttribute) -> KsyEnum | None:
        """Return the enumeration of an attribute, if it has members. Raises CannotSayError."""
        node = attribute.keys.get("enum")
        if node is None:
            return None
        name = scalar(node, "enum").text
        found = self.within.scope.type.find_enum(tuple(name.removeprefix("::").split("::")))
        if found is None:
            raise CannotSayError(
                node.at, f"there is no enumeration '{name[:60]}' here", "correct it, or write it into this file"
            )
        return found if found.members else None

    def reads_any_bytes(self, attribute: KsyAttribute) -> bool:
        """Return whether Kaitai reads an attribute with a size whatever its bytes are."""
        process, said = attribute.keys.get("process"), attribute.keys.get("type")
        if process is not None and not (isinstance(process, Scalar) and _PROCESS.fullmatch(process.text.strip())):
            return False
        if said is None:
            return True
        written = attribute.text("encoding") or self.within.scope.type.encoding or ""
        is_text = isinstance(said, Scalar) and said.text.strip() in ("str", "strz")
        return is_text and plain_encoding(written) in _LATIN_1

    def order(self, attribute: KsyAttribute, said: str | None) -> Keys:
        order = said or self.within.scope.type.endian
        if order is None:
            raise CannotSayError(
                attribute.at, f"the byte order of '{attribute.name}'", "write le or be behind its type"
            )
        word = "little" if order == "le" else "big"
        return {} if word == self.within.file.order else {"order": word}

    def number(
        self,
        attribute: KsyAttribute,
        name: str,
        into: KsyScope,
        size: int,
        order: str | None,
        signed: bool,
        item: KsyScope | None,
    ) -> KsyPart:
        self.only(attribute, frozenset({"enum"}))
        segment: Keys = {"field": name, "type": f"{'i' if signed else 'u'}{8 * size}"}
        if size > 1:
            segment |= self.order(attribute, order)
        span = bounds_of_bits(8 * size, signed)
        enum = self.enum(attribute)
        if enum is not None:
            if all(span[0] <= one <= span[1] for one in enum.members.values()):
                segment["values"] = self.within.file.table(enum)
            else:
                at = attribute.keys["enum"].at
                self.within.file.tell(
                    at, f"the names of '{attribute.name}' are left out", "some of its numbers do not fit", warning=True
                )
        into.entries[attribute.name] = KsyMeaning(name, "int", span)
        more = self.valid(attribute, segment, into.entries[attribute.name], into, item)
        return KsyPart([segment, *more], exactly(size))

    def constant(self, attribute: KsyAttribute, name: str, into: KsyScope) -> KsyPart:
        data = contents_of(attribute.keys["contents"])
        into.entries[attribute.name] = constant_meaning(constant(data))
        if "valid" in attribute.keys:
            raise CannotSayError(attribute.keys["valid"].at, "valid: of contents:", "leave it out")
        if not data:
            return KsyPart([])
        if self.within.region.counts_back:  # a constant would end the part before it wherever it occurs
            segment: Keys = {"field": name, "type": "bytes", "size": len(data), "is": bytes_text(data)}
        else:
            segment = {"const": data.hex(" ").upper()}
        return KsyPart([segment], exactly(len(data)))

    def text(
        self, attribute: KsyAttribute, name: str, into: KsyScope, behind: int | None, item: KsyScope | None
    ) -> KsyPart:
        self.only(attribute, OF_TEXTS)
        keys = attribute.keys
        terminated = scalar(keys["type"], "type").text.strip() == "strz"
        end = attribute.byte("terminator")
        end = 0 if end is None and terminated else end
        pad = attribute.byte("pad-right")
        if attribute.flag("include", False):
            raise CannotSayError(
                keys["include"].at, f"the text '{attribute.name}' with its terminator", "leave include out"
            )
        more = self._letters(attribute, name)
        segment: Keys = {"field": name, "type": "ascii"}
        sizes = ANY
        if "size" in keys:
            size = self.within.size(attribute, behind, item)
            if size == "rest":
                raise CannotSayError(
                    keys["size"].at, f"the text '{attribute.name}', which takes what is left,", "give it a size"
                )
            if size == 0:
                into.entries[attribute.name] = constant_meaning(constant(""))
                return KsyPart(
                    [
                        {"value": name, "read": "''"},
                        *self.valid(attribute, None, into.entries[attribute.name], into, item),
                    ]
                )
            segment["size"] = size
            if pad is not None and end is not None and pad != end:
                raise CannotSayError(
                    keys["pad-right"].at, f"'{attribute.name}' has a filling and a terminator", "leave one out"
                )
            if end is not None:
                segment["end"] = f"{end:02X}"
            elif pad is not None:
                segment["pad"] = f"{pad:02X}"
            sizes = exactly(size) if isinstance(size, int) else ANY
        elif attribute.flag("size-eos", False) or end is None:
            raise CannotSayError(
                attribute.at, f"where the text '{attribute.name}' ends", "give it a size or a terminator"
            )
        else:
            if pad is not None:
                raise CannotSayError(
                    keys["pad-right"].at, f"the filling of '{attribute.name}', which has no size,", "leave it out"
                )
            if not attribute.flag("eos-error", True):
                raise CannotSayError(
                    keys["eos-error"].at, f"'{attribute.name}' may lack its terminator", "leave eos-error out"
                )
            consumed = attribute.flag("consume", True)
            segment["end"] = f"{end:02X}" if consumed else [f"{end:02X}"]
            sizes = Sizes(int(consumed), None)
        into.entries[attribute.name] = KsyMeaning(name, "str")
        more += self.valid(attribute, segment, into.entries[attribute.name], into, item)
        return KsyPart([segment, *more], sizes)

    def _letters(self, attribute: KsyAttribute, name: str) -> list[Keys]:
        """Return the restriction of a text to its encoding; framekit has a character for each byte.

        Raises CannotSayError.
        """
        written = attribute.text("encoding") or self.within.scope.type.encoding
        if written is None:
            raise CannotSayError(attribute.at, f"the encoding of '{attribute.name}'", "write encoding: ASCII")
        encoding = plain_encoding(written)
        if encoding in _LATIN_1:
            return []
        if encoding not in _ASCII:
            if not _LIKE_ASCII.fullmatch(encoding):
                raise CannotSayError(attribute.at, f"a text in {written[:30]}", "take its bytes")
            what = f"characters of '{attribute.name}' that are not in ASCII are refused"
            self.within.file.tell(
                attribute.at, what, "framekit has a character for each byte; take data: for such texts", warning=True
            )
        return [{"require": f"only({name}, {self.within.file.letters()})"}]

    def data(
        self, attribute: KsyAttribute, name: str, into: KsyScope, behind: int | None, item: KsyScope | None
    ) -> KsyPart:
        self.only(attribute, OF_BYTES)
        keys = attribute.keys
        if "process" in keys:
            raise CannotSayError(keys["process"].at, f"how '{attribute.name}' is coded", "a wrap: may say it")
        end, pad = attribute.byte("terminator"), attribute.byte("pad-right")
        if attribute.flag("include", False) and end is not None:
            raise CannotSayError(keys["include"].at, f"'{attribute.name}' with its terminator", "leave include out")
        into.entries[attribute.name] = KsyMeaning(name, "bytes")
        if "size" in keys or attribute.flag("size-eos", False):
            if end is not None or pad is not None:
                at = keys["terminator" if end is not None else "pad-right"].at
                raise CannotSayError(at, f"the filling or terminator of '{attribute.name}'", "take all of its bytes")
            if "size" in keys:
                size = self.within.size(attribute, behind, item)
            else:
                self.within.take_all(attribute.at, behind, f"'{attribute.name}'")
                size = "rest"
            if size == 0:
                into.entries[attribute.name] = constant_meaning(constant(b""))
                return KsyPart(self.valid(attribute, None, into.entries[attribute.name], into, item))
            more = self.valid(attribute, None, into.entries[attribute.name], into, item)
            return KsyPart([{"data": name, "size": size}, *more], exactly(size) if isinstance(size, int) else ANY)
        if end is None or pad is not None:
            raise CannotSayError(attribute.at, f"where '{attribute.name}' ends", "give it a size or a terminator")
        if (
            not attribute.flag("eos-error", True)
            or not attribute.flag("consume", True)
            or self.within.region.counts_back
            or item
        ):
            raise CannotSayError(attribute.at, f"how '{attribute.name}' ends", "let its terminator belong to it")
        byte = f"{end:02X}"
        more = self.valid(attribute, None, into.entries[attribute.name], into, item)
        return KsyPart([{"data": name, "size": "rest", "never": [byte]}, {"const": byte}, *more], Sizes(1, None))

    # ---- what must hold -----------------------------------------------------------------------------------

    def valid(
        self, attribute: KsyAttribute, field_: Keys | None, entry: KsyMeaning, into: KsyScope, item: KsyScope | None
    ) -> list[Keys]:
        """Apply `valid` to the keys of the field, and return the remaining conditions as segments.

        Raises CannotSayError.
        """
        node = attribute.keys.get("valid")
        if node is None:
            return []
        it = Translated(entry.text, ATOM, entry.kind, entry.span, IT, item=entry.item)
        at = node.at
        conditions: list[Node] = []
        limits: dict[str, int] = {}
        for key, one in _rules_of(node).items():
            if key in _COMPARISONS:
                value = self.within.parsed(scalar(one, key))
                said = self.within.say(value, one.at, it=it, item=item, lazily=True)
                if not _takes_constant(field_, limits, key, said, entry.kind):
                    conditions.append(Compare(at, Name(at, "_"), ((_COMPARISONS[key], value),)))
            elif key == "in-enum" and scalar(one, key).text == "true" and field_ is not None and "values" in field_:
                field_["only"] = "values"
            else:
                conditions.append(self._condition(key, one, at))
        if limits and field_ is not None and entry.span is not None:
            field_["range"] = _range_within(entry.span, limits, at)
        required: list[str] = []
        for condition in conditions:
            said = self.within.say(condition, at, "bool", it=it, item=item, lazily=True)
            if UNKNOWN in said.needs:
                raise CannotSayError(at, "a condition asks for what may not be there", "ask first whether it is")
            required += [*said.needs, said.text]
        return [{"require": one} for one in dict.fromkeys(required)]

    def _condition(self, key: str, rule: YamlNode, at: Position) -> Node:
        """Return the condition of `expr` or `any-of`. Raises CannotSayError for other rules."""
        if key == "expr":
            return self.within.parsed(scalar(rule, key))
        if key == "any-of" and isinstance(rule, Sequence) and rule.items:
            options = (self.within.parsed(scalar(option, key)) for option in rule.items)
            compared = tuple(Compare(at, Name(at, "_"), (("==", option),)) for option in options)
            return compared[0] if len(compared) == 1 else Logic(at, "or", compared)
        raise CannotSayError(rule.at, f"valid: with {key!r}", "write valid: {expr: …}")


def _rules_of(node: YamlNode) -> Mapping[str, YamlNode]:
    """Return the rules of a `valid`; a value alone is the rule `eq`. Raises CannotSayError for a list."""
    if isinstance(node, Scalar):
        return {"eq": node}
    if isinstance(node, MappingNode):
        return {one.key.text: one.value for one in node.entries}
    raise CannotSayError(node.at, "valid: with a list", "write valid: {any-of: […]}")


def _takes_constant(field_: Keys | None, limits: dict[str, int], key: str, said: Translated, kind: Kind) -> bool:
    """Move a comparison with a constant to the keys of the field or to `limits`; return whether that is possible."""
    if field_ is None or said.names or said.kind != kind:
        return False
    if key == "eq" and kind in ("int", "str"):
        field_["is"] = said.text
    elif kind == "int" and said.span is not None:
        limits[key] = said.span[0]
    else:
        return False
    return True


def _range_within(span: tuple[int, int], limits: Mapping[str, int], at: Position) -> str:
    """Return the range of values that keep the limits `min` and `max`. Raises CannotSayError if it is empty."""
    low, high = max(limits.get("min", span[0]), span[0]), min(limits.get("max", span[1]), span[1])
    if low > high:
        raise CannotSayError(at, "limits that no value keeps", "correct them")
    return f"{low}..{high}"


def constant_meaning(value: Translated) -> KsyMeaning:
    return KsyMeaning(value.text, value.kind, value.span, words=frozenset())

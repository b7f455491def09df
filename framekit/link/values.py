"""Values that sequences and services work with: frames as values, attributes of values in expressions, names, and
compiled expressions.

Codecs give and take plain dictionaries; an inner frame is `{frame: fields}` in a dictionary, here it is a `FrameValue`.
Sequences, services and the line are not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from framekit.codec.evaluate import EVALUATION_ERRORS as EVALUATION_ERRORS
from framekit.codec.evaluate import compiled
from framekit.definition.expression import Expression, Name, Node, Undone, inverse_steps

NO_FIELDS: frozenset[str] = frozenset()

Unset = Callable[[Mapping[str, Any], str], Any]
"""Returns the value of a field that was not given, from the other fields and its name. Raise EVALUATION_ERRORS."""


Sent = tuple[Any, bytes, Any, str | None, Mapping[str, Any]]
"""The bytes of a frame that was built: what decodes them (`read_back`), the bytes, the names to decode them with, the
field of the outer frame it stands in (None: none), and computed fields that need no decoding."""


class FrameValue:
    """A frame as a value: received (`raw`, perhaps `refusal`), or made by a constructor and not yet sent.

    `'name' in value` asks for a field.
    """

    __slots__ = ("built", "declared", "fields", "frame", "raw", "refusal", "rest", "unset")

    fields: dict[str, Any]
    """The values a codec has decoded or is to encode."""
    declared: frozenset[str]
    """The fields that may be absent: all of a received frame, of a made frame those that need not be given."""
    unset: Unset | None
    """Returns the value that an absent field of a made frame has in expressions; an absent received field is None."""
    built: bytes | None
    """The bytes, encoded before the frame is sent; None if they depend on values that change by themselves."""
    rest: Sent | Mapping[str, Any] | None
    """The fields that building computed: None before the frame is built; the bytes they are decoded from at the first
    use; then the fields."""

    def __init__(
        self,
        frame: str,
        fields: dict[str, Any],
        raw: bytes | None = None,
        refusal: int | None = None,
        declared: frozenset[str] = NO_FIELDS,
        unset: Unset | None = None,
    ) -> None:
        self.frame = frame
        self.fields = fields
        self.raw = raw
        self.refusal = refusal
        self.declared = declared
        self.unset = unset
        self.built = self.rest = None

    @property
    def computed(self) -> Mapping[str, Any]:
        """Return the fields that building computed, decoded from the bytes on first use; empty before building."""
        rest = self.rest
        if isinstance(rest, tuple):
            info, data, names, inside, _ = rest
            self.rest = rest = info.read_back(data, names, inside)
        return rest or {}

    def complete(self) -> dict[str, Any]:
        """Return all fields, the computed fields of a sent frame included."""
        return {**computed, **self.fields} if (computed := self.computed) else self.fields

    @property
    def was_built(self) -> bool:
        """Return whether the frame has become bytes, on its own or inside another frame."""
        return self.raw is not None or self.rest is not None

    def field(self, name: str) -> Any:
        """Return a field. Raise KeyError."""
        if name in self.fields:
            return self.fields[name]
        rest = self.rest
        if isinstance(rest, tuple) and name in rest[4]:
            return rest[4][name]
        return self.computed[name]

    def set_field(self, name: str, value: Any) -> None:
        """Change a field; the bytes and the computed fields of the old values are dropped."""
        self.fields[name] = value
        self.raw = self.rest = self.built = None

    def language_attribute(self, name: str) -> Any:
        """Return `value.name`, for callers that know only the protocol of attributes, such as generated codecs."""
        return attribute(self, name)

    def copy(self) -> FrameValue:
        """Return the same frame with fields of its own, to be changed and sent."""
        value = FrameValue(self.frame, self.fields.copy(), self.raw, self.refusal, self.declared, self.unset)
        value.built = self.built
        return value

    def __contains__(self, name: object) -> bool:
        return name in self.fields or (self.rest is not None and name in self.computed)

    def __repr__(self) -> str:
        return f"<{self.frame} {self.fields}>"


def attribute(value: Any, name: str) -> Any:
    """Return `value.name` of the language. A list has its items' attributes. Raise KeyError for an unknown attribute.

    An absent optional field of a received frame is None, of a made frame its default. None has no attributes: None.
    """
    if type(value) is FrameValue:
        if name in value.fields:
            return value.fields[name]
        if name == "frame":
            return value.frame
        if name == "refusal" and name not in value:
            return value.refusal or 0
        if name in value.declared and name not in value:
            return None if value.unset is None else value.unset(value.fields, name)
        return value.field(name)
    if type(value) is dict or isinstance(value, Mapping):
        return value[name]
    if isinstance(value, (list, tuple)):
        return [attribute(item, name) for item in value]
    return None if value is None else value.language_attribute(name)


def present(value: Any, name: str) -> Any:
    """Return `value.name` for the comparison of a frame with a pattern. Raise KeyError also for an absent field."""
    if type(value) is FrameValue and name in value.declared:
        return value.field(name)
    return attribute(value, name)


def plain(value: Any) -> Any:
    """Return the value for codecs: frame values inside become `{frame: fields}`, as sent if they have been sent."""
    if type(value) is FrameValue:
        fields = value.fields if value.raw is None else value.complete()
        return {value.frame: {name: plain(item) if type(item) in HOLDERS else item for name, item in fields.items()}}
    if type(value) is dict:
        return {name: plain(item) if type(item) in HOLDERS else item for name, item in value.items()}
    if type(value) is list:
        return [plain(item) for item in value]
    return value


HOLDERS = frozenset((FrameValue, dict, list))
"""The types that may hold frame values."""


def frames_in(value: Any) -> Iterator[str]:
    """Yield the names of a frame and of those in it."""
    if type(value) is FrameValue:
        yield value.frame
        value = value.fields
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from frames_in(part)


Evaluate = Callable[["Names"], Any]
Formula = Callable[["Names"], Any]


class Names(dict[str, Any]):
    """Values by name; a missing name is looked up in `formulas` (worked out at every use), then in `parent`."""

    __slots__ = ("formulas", "parent")

    def __init__(
        self,
        values: Mapping[str, Any] | None = None,
        parent: Names | None = None,
        formulas: Mapping[str, Formula] | None = None,
    ) -> None:
        super().__init__(values or {})
        self.parent = parent
        self.formulas = formulas

    def __missing__(self, name: str) -> Any:
        formulas, parent = self.formulas, self.parent
        if formulas is not None and name in formulas:
            return formulas[name](self)
        if parent is None:
            raise KeyError(name)
        return parent[name]

    @property
    def remembered(self) -> dict[Any, Any] | None:
        """Return the results of measuring a frame that is still coming; None outside of a receiver."""
        return None if self.parent is None else self.parent.remembered

    def get(self, name: str, default: Any = None) -> Any:
        try:
            return self[name]
        except KeyError:
            return default


def compile_expression(expression: Expression) -> Evaluate:
    """Return a function of a `Names` that evaluates an expression.

    It raises KeyError (unknown name), TypeError, IndexError, ValueError or ArithmeticError; `EVALUATION_ERRORS` names
    them for callers that must go on.
    """
    return compiled(expression.root, attribute)


def compile_optional(expression: Expression | None) -> Evaluate | None:
    """Compile an expression that may be missing."""
    return None if expression is None else compile_expression(expression)


CODEC_ERRORS = Exception
"""The errors of a codec that mean that a frame does not fit; no error ends the line."""


Undo = Callable[[int, int], int]


class NotReadableError(ValueError):
    """A result that no value of the name gives."""


@dataclass(frozen=True, slots=True)
class Inverse:
    """`name` stands alone in the expression; `steps` lead from the result back to it, outermost first.

    `undone` says the same as operators.
    """

    name: str
    steps: tuple[tuple[Undo, Evaluate], ...]
    undone: tuple[Undone, ...] = ()

    def solve(self, result: int, names: Names) -> int:
        """Return the value of the name. Raise NotReadableError, and EVALUATION_ERRORS for a missing column."""
        for undo, other in self.steps:
            result = undo(result, other(names))
        return result

    def source(self, result: str, written: Callable[[Expression], str]) -> str:
        """Return the source of `solve`; it requires the name `quotient`."""
        for operator, unknown_left, other in self.undone:
            known = written(other)
            if operator == "*":
                result = f"quotient({result}, {known})"
            elif operator == "-" and not unknown_left:
                result = f"(({known}) - {result})"
            else:
                result = f"({result} {'-' if operator == '+' else '+'} ({known}))"
        return result


def inverse_of(expression: Expression) -> Inverse | None:
    """Return how to read an expression backwards; None if it cannot be, or has no name to read."""
    found = inverse_steps(expression)
    if found is None:
        return None
    name, undone = found
    steps = tuple((_undo(operator, left), compile_expression(other)) for operator, left, other in undone)
    return Inverse(name, steps, undone)


def bare_name(expression: Expression) -> str | None:
    """Return the word, if that is all there is."""
    node: Node = expression.root
    return node.name if isinstance(node, Name) else None


def _undo(operator: str, unknown_left: bool) -> Undo:
    if operator == "*":
        return quotient
    if operator == "+":
        return lambda result, other: result - other
    return (lambda result, other: result + other) if unknown_left else (lambda result, other: other - result)


def quotient(result: int, other: int) -> int:
    """Return the factor by which `other` gives `result`. Raises NotReadableError if it is not a whole number."""
    if other == 0 or result % other:
        raise NotReadableError(f"{result} is no multiple of {other}")
    return result // other


# ---- values of a definition ------------------------------------------------------------------------------------------

LayoutFunctions = tuple[Callable[..., bytes], Callable[..., dict[str, Any]]]
"""Functions that encode and decode a layout."""

EACH = "(each)"
"""The name (no word of the language) under which names hold one mapping of names a variable, for `{each: {…}}`."""


def read_as(codec: LayoutFunctions, found: Any, names: Names) -> Any:
    """Return bytes as the record of a layout, a record as its bytes."""
    encode, decode = codec
    return encode(plain(dict(found)), names) if isinstance(found, Mapping) else read_layout(decode, found, names)


def read_layout(decode: Callable[..., dict[str, Any]], data: bytes, names: Names) -> dict[str, Any]:
    """Decode bytes as a layout; surplus bytes at the end are padding without meaning. Raise ValueError."""
    try:
        return decode(data, names)
    except ValueError as error:
        end = getattr(error, "offset", None)
        if getattr(error, "cause", None) != "surplus" or not isinstance(end, int) or not 0 <= end < len(data):
            raise
        return decode(data[:end], names)

"""Translate expressions of Kaitai Struct to framekit's language: names are resolved in the types, values have kinds.

The form of a name depends on the place of the expression: `_parent.count` is `count` inside a record, unless a scope
between them has the same name. An expression without a form, or with an ambiguous form, raises CannotSayError.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from framekit.definition.expression import (
    AND,
    ATOM,
    BIT_AND,
    BIT_OR,
    BIT_XOR,
    COMPARE,
    CONDITIONAL,
    NOT,
    OR,
    PRODUCT,
    SHIFT,
    SIGN,
    SUM,
    Attribute,
    Binary,
    Compare,
    Conditional,
    Index,
    List,
    Logic,
    Name,
    Node,
    Number,
    Text,
    Unary,
)
from framekit.definition.problems import CannotSayError, Position
from framekit.definition.wire_types import bounds_of_bits
from framekit.extras.kaitai.description import KsyType
from framekit.extras.kaitai.language import BY_HAND, Cast, EnumMember, MethodCall

Kind = Literal["int", "bool", "float", "str", "bytes", "record", "list", "choice", "lost"]
_LEVELS = {
    "|": BIT_OR, "^": BIT_XOR, "&": BIT_AND, "<<": SHIFT, ">>": SHIFT, "+": SUM, "-": SUM, "*": PRODUCT, "/": PRODUCT,
    "%": PRODUCT,
}  # fmt: skip
MOST_SHIFT = 255
"""Limit of a shift to the left, in bits."""
_INTEGER = re.compile(r"([us])([1248])(?:le|be)?")
_RESERVED = frozenset({"if", "else", "or", "and", "not", "in", "true", "false", "never"})
INDEX = frozenset({"index"})
IT = frozenset({"_"})
"""The word for the value or item that an expression is about."""
UNKNOWN = "?"
"""A condition without a form at the place of its use."""
LONGEST_TEXT = 20_000
"""Limit of the length of a translated expression."""


def own_name(name: str) -> str:
    """Return a name of a Kaitai file in a form that framekit's expressions accept."""
    return f"{name}_" if name in _RESERVED else name


@dataclass(frozen=True, slots=True)
class KsyMeaning:
    """The meaning of a name in a type."""

    text: str
    """Its form at its place, usually a word."""
    kind: Kind
    span: tuple[int, int] | None = None
    """The least and greatest number, or None."""
    scope: KsyScope | None = None
    """The names in a record, or in the items of a list."""
    item: Kind = "int"
    """The kind of the items of a list."""
    cases: Mapping[str, KsyScope] = field(default_factory=dict)
    """The records that a choice may be, by the names of their types."""
    when: str = ""
    """The condition under which it is present; UNKNOWN if that condition cannot be written."""
    asked: frozenset[str] = frozenset()
    """The names that this condition reads."""
    words: frozenset[str] | None = None
    """The names that `text` reads; None if it reads only itself."""
    suffix: str = ""
    """Leads from an item of a list to its value."""
    why: str = ""
    """Explains why a lost meaning is lost."""


class KsyScope:
    """The names of one use of a type."""

    def __init__(
        self, type_: KsyType, parent: KsyScope | None, names: Iterable[str] = (), around: KsyScope | None = None
    ) -> None:
        """Create the scope of a type; `parent` and its root are the meanings of `_parent` and `_root`.

        `around`: the scope of the enclosing record, if it differs from the parent. `names`: further names that the type
        will have, so that an outer name is never read by the word of an inner name.
        """
        self.type, self.parent, self.around = type_, parent, around or parent
        self.root: KsyScope = self if parent is None else parent.root
        self.names = {own_name(one) for one in (*type_.names, *names)}
        self.entries: dict[str, KsyMeaning] = {}
        self.find: Callable[[str, Position], KsyMeaning | None] = lambda name, at: None
        """Creates the entry of an instance on demand; returns None for an unknown name."""


@dataclass(frozen=True, slots=True)
class Translated:
    """A translated part of an expression."""

    text: str
    level: int
    """Its binding strength."""
    kind: Kind
    span: tuple[int, int] | None = None
    names: frozenset[str] = frozenset()
    """The words that it begins with, which are resolved at its place."""
    needs: tuple[str, ...] = ()
    """The conditions under which it has a value."""
    scope: KsyScope | None = None
    item: Kind = "int"
    cases: Mapping[str, KsyScope] = field(default_factory=dict)
    suffix: str = ""
    above: bool = False
    """Whether it is an enclosing scope, whose names are written without a path."""
    parts: tuple[str, ...] = ()
    """The conditions that are all true if this condition is."""

    def at_level(self, level: int) -> str:
        """Return the text, in parentheses if it binds weaker than `level`."""
        return f"({self.text})" if self.level < level else self.text

    @property
    def is_constant(self) -> bool:
        return not self.names


def quoted(text: str) -> str:
    """Return a text literal."""
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


def bytes_text(data: bytes) -> str:
    return f"h'{data.hex(' ').upper()}'"


def constant(value: int | str | bytes) -> Translated:
    match value:
        case int():
            return Translated(str(value), SIGN if value < 0 else ATOM, "int", (value, value))
        case str():
            return Translated(quoted(value), ATOM, "str")
    return Translated(bytes_text(value), ATOM, "bytes")


@dataclass(slots=True)
class Translation:
    """The translation of expressions at one place."""

    scope: KsyScope
    at: Position
    it: Translated | None = None
    """The meaning of `_`."""
    index: bool = False
    """Whether `_index` is the index of an item."""
    told: list[tuple[str, str]] = field(default_factory=list)
    """Notes for readers of the result, reported at each use."""

    def of(self, node: Node) -> Translated:
        """Return the translation of a node. Raises CannotSayError."""
        made = self._of(node)
        if len(made.text) > LONGEST_TEXT:
            raise self._not("an expression that becomes too long")
        return made

    def number(self, node: Node) -> Translated:
        return self._as(node, "int", "a number")

    def condition(self, node: Node) -> Translated:
        return self._as(node, "bool", "a condition")

    def _as(self, node: Node, kind: Kind, what: str) -> Translated:
        made = self.of(node)
        if made.kind != kind:
            raise self._not(f"what is no {what.split()[-1]}, where {what} is asked for")
        return made

    def _not(self, what: str, todo: str = BY_HAND) -> CannotSayError:
        return CannotSayError(self.at, f"{what} is left out", todo)

    def _of(self, node: Node) -> Translated:
        match node:
            case Number(value=value):
                return constant(value)
            case Text(value=value):
                return constant(value)
            case List(items=items):
                return self._list(items)
            case Name(name=name):
                return self._name(name)
            case Attribute(value=value, name=name):
                return self._attribute(value, name)
            case Index(value=value, index=index):
                return self._index(self.of(value), self.number(index))
            case MethodCall(value=value, name=name, arguments=arguments):
                return self._method(self.of(value), name, arguments)
            case Cast(value=value, type=type_):
                return self._cast(self.of(value), type_)
            case EnumMember(path=path):
                return self._member(path)
            case Unary(operator="not", operand=operand):
                return self._negated(self.condition(operand))
            case Unary(operator=operator, operand=operand):
                return self._sign(operator, self.of(operand))
            case Binary(operator=operator, left=left, right=right):
                return self._binary(operator, self.of(left), self.of(right))
            case Compare(first=first, rest=((operator, second),)):
                return self._compare(self.of(first), operator, self.of(second))
            case Logic(operator=operator, operands=operands):
                return self._logic(operator, [self.condition(one) for one in operands])
            case Conditional(condition=condition, then=then, otherwise=otherwise):
                return self._chosen(self.condition(condition), self.of(then), self.of(otherwise))
        raise self._not("a number with a fraction")

    # ---- names --------------------------------------------------------------------------------------------

    def _name(self, name: str) -> Translated:
        match name:
            case "true" | "false":
                return Translated(name, ATOM, "bool", (int(name == "true"),) * 2)
            case "_" if self.it is not None:
                return self.it
            case "_index" if self.index and not self._has_index():
                return Translated("index", ATOM, "int", (0, 1 << 20), INDEX)
            case "_root":
                return self._above(self.scope.root)
            case "_parent":
                if self.scope.parent is None:
                    raise self._not("'_parent' of the type at the top")
                return self._above(self.scope.parent)
        if name.startswith("_"):
            raise self._not(f"'{name}'", "a definition knows no places in a stream, and no such value")
        return self._entry(self.scope, name, "")

    def _has_index(self) -> bool:
        """Return whether a value has the name `index`."""
        here: KsyScope | None = self.scope
        while here is not None and "index" not in here.type.names:
            here = here.around
        return here is not None

    @staticmethod
    def _above(scope: KsyScope) -> Translated:
        return Translated("", ATOM, "record", scope=scope, above=True)

    def _entry(self, scope: KsyScope, name: str, path: str, names: frozenset[str] = frozenset()) -> Translated:
        """Return the value of a name in a scope.

        `path` leads to the scope, with a trailing dot, unless it is enclosing.
        """
        entry = scope.entries.get(name) or scope.find(name, self.at)
        if entry is None or entry.kind == "lost":
            if entry is not None and entry.why:
                raise self._not(f"'{name}', {entry.why},")
            if name in scope.type.names or entry is not None:
                raise self._not(f"'{name}', which is left out or read later,")
            raise self._not(f"'{name}', a name that the type '{scope.type.name}' does not have,", "correct it")
        made = Translated(
            entry.text, ATOM, entry.kind, entry.span, scope=entry.scope, item=entry.item, cases=entry.cases,
            suffix=entry.suffix,
        )  # fmt: skip
        words = frozenset({entry.text}) if entry.words is None else entry.words
        if not words:
            return replace(made, level=SIGN if entry.text.startswith("-") else ATOM)
        needs = (entry.when,) if entry.when else ()
        if path:  # the condition belongs to the record, whose names differ here
            return replace(made, text=f"{path}{entry.text}", names=names, needs=(UNKNOWN,) if needs else ())
        if not self._is_around(scope):
            return replace(made, names=IT, needs=needs)
        self._not_hidden(words | entry.asked, scope)
        return replace(made, names=words, needs=needs)

    def _is_around(self, scope: KsyScope) -> bool:
        here: KsyScope | None = self.scope
        while here is not None and here is not scope:
            here = here.around
        return here is not None

    def _not_hidden(self, words: frozenset[str], scope: KsyScope) -> None:
        """Raise CannotSayError if an inner scope redefines one of the words of an enclosing scope."""
        here: KsyScope | None = self.scope
        while here is not None and here is not scope:
            for word in words & here.names:
                what = f"'{word}' of '{scope.type.name}', which '{here.type.name}' has a value of its own for,"
                raise self._not(what, "give one of them another name")
            here = here.around

    def _attribute(self, value: Node, name: str) -> Translated:
        outer = self.of(value)
        if outer.kind == "record" and outer.scope is not None:
            if outer.above and name in ("_parent", "_root"):
                scope = outer.scope.root if name == "_root" else outer.scope.parent
                if scope is None:
                    raise self._not("'_parent' of the type at the top")
                return self._above(scope)
            if name.startswith("_"):
                raise self._not(f"'{name}'", "a definition knows no places in a stream, and no such value")
            made = self._entry(outer.scope, name, "" if outer.above else f"{outer.text}.", outer.names)
            return made if outer.above else replace(made, needs=(*outer.needs, *made.needs))
        return self._method(outer, name, ())

    def _member(self, path: tuple[str, ...]) -> Translated:
        """Return the number of a member of an enumeration."""
        found = self.scope.type.find_enum(path[:-1])
        if found is None or path[-1] not in found.members:
            raise self._not(f"'{'::'.join(path)}', which is no member of an enumeration here,", "correct it")
        return constant(found.members[path[-1]])

    def _list(self, items: tuple[Node, ...]) -> Translated:
        parts = [self.number(one) for one in items]
        numbers = [one.span[0] for one in parts if one.is_constant and one.span is not None]
        if len(numbers) < len(parts) or any(not 0 <= one <= 255 for one in numbers):
            raise self._not("a list of numbers that are no bytes")
        return constant(bytes(numbers))

    def _index(self, value: Translated, index: Translated) -> Translated:
        names, needs = value.names | index.names, (*value.needs, *index.needs)
        text = f"{value.at_level(ATOM)}[{index.text}]{value.suffix}"
        if index.span is None or index.span[0] < 0:
            raise self._not("an index that may be less than 0")
        if value.kind == "bytes":
            return Translated(text, ATOM, "int", (0, 255), names, needs)
        if value.kind == "list":
            return Translated(text, ATOM, value.item, None, names, needs, value.scope)
        raise self._not("an index of what is no list")

    def _cast(self, value: Translated, type_: str) -> Translated:
        if value.kind == "choice" and type_ in value.cases:
            return replace(value, kind="record", scope=value.cases[type_], cases={})
        if value.kind == "int" and (match := _INTEGER.fullmatch(type_)) is not None:
            bits = 8 * int(match[2])
            low, high = bounds_of_bits(bits, match[1] == "s")
            if bits == 64 or (value.span is not None and low <= value.span[0] and value.span[1] <= high):
                return value
        if (value.kind == "bytes" and type_ == "bytes") or (value.kind == "str" and type_ == "str"):
            return value
        if value.kind == "record" and value.scope is not None and value.scope.type.name == type_.split("::")[-1]:
            return value
        raise self._not(f"'.as<{type_}>' of this")

    # ---- methods ------------------------------------------------------------------------------------------

    def _method(self, value: Translated, name: str, arguments: tuple[Node, ...]) -> Translated:
        numbers = [self.number(one) for one in arguments] if name in ("to_i", "substring") else []
        names = value.names.union(*(one.names for one in numbers))
        made = Translated("", ATOM, "int", None, names, (*value.needs, *(one for n in numbers for one in n.needs)))
        match value.kind, name, len(arguments):
            case ("str", "length", 0) | ("bytes", "length" | "size", 0) | ("list", "size" | "length", 0):
                return replace(made, text=f"len({value.text})", span=(0, 1 << 20))
            case ("list", "first", 0):
                return self._index(value, constant(0))
            case ("bytes" | "list", "last", 0):
                last = Translated(f"len({value.text}) - 1", SUM, "int", (0, 1 << 20), value.names)
                return self._index(value, last)
            case ("bytes", "first", 0):
                return self._index(value, constant(0))
            case ("list", "min" | "max", 0) if value.item == "int" and not value.suffix:
                return replace(made, text=f"{name}({value.text})")
            case ("int", "to_i", 0):
                return value
            case ("bool", "to_i", 0):
                text = f"1 if {value.at_level(OR)} else 0"
                return replace(value, text=text, level=CONDITIONAL, kind="int", parts=())
            case ("int", "to_s", 0):
                return replace(made, text=f"text({value.text})", kind="str")
            case ("str", "to_i", 0 | 1):
                return self._number_of_text(value, numbers[0].text if numbers else "10", made)
            case ("str", "substring", 2):
                if any(one.span is None or one.span[0] < 0 for one in numbers):
                    raise self._not("a part of a text that may begin before it")
                text = f"{value.at_level(ATOM)}[{numbers[0].text}:{numbers[1].text}]"
                return replace(made, text=text, kind="str")
        raise self._not(f"'.{name}' of this")

    def _number_of_text(self, value: Translated, base: str, made: Translated) -> Translated:
        """Complete `made` as the number that the digits of a text represent in a base."""
        if base not in ("2", "8", "10", "16"):
            raise self._not("a number in digits of an odd base")
        what = "'.to_i' is a number where the text has digits alone, no sign, blank or _"
        self.told.append((what, "what asks for another one is not there, or refused"))
        digits = "0123456789ABCDEFabcdef" if base == "16" else "0123456789"[: int(base)]
        need = f"len({value.text}) > 0 and only({value.text}, '{digits}')"
        text = f"number({value.text}{'' if base == '10' else f', {base}'})"
        return replace(made, text=text, span=(0, 1 << 512), needs=(*made.needs, need))

    # ---- operators ----------------------------------------------------------------------------------------

    def _sign(self, operator: str, one: Translated) -> Translated:
        if one.kind != "int" and not (one.kind == "float" and operator == "-"):
            raise self._not(f"'{operator}' of what is no number")
        span = one.span
        if span is not None:
            span = (-span[1], -span[0]) if operator == "-" else (~span[1], ~span[0])
        return replace(one, text=f"{operator}{one.at_level(SIGN)}", level=SIGN, span=span)

    @staticmethod
    def _negated(condition: Translated) -> Translated:
        return replace(condition, text=f"not {condition.at_level(NOT)}", level=NOT, parts=())

    @staticmethod
    def _logic(operator: str, parts: list[Translated]) -> Translated:
        level = OR if operator == "or" else AND
        texts = [one.at_level(level + 1) for one in parts]
        names = frozenset().union(*(one.names for one in parts))
        needs = list(parts[0].needs)
        for place, one in enumerate(parts[1:], 1):
            needs += _needed(one.needs, texts[:place], operator == "and")
        made = Translated(f" {operator} ".join(texts), level, "bool", (0, 1), names, tuple(needs))
        return replace(made, parts=tuple(one.text for one in parts)) if operator == "and" else made

    def _binary(self, operator: str, left: Translated, right: Translated) -> Translated:
        level = _LEVELS[operator]
        names, needs = left.names | right.names, (*left.needs, *right.needs)
        text = f"{left.at_level(level)} {'//' if operator == '/' else operator} {right.at_level(level + 1)}"
        made = Translated(text, level, "int", None, names, needs)
        if left.kind == right.kind == "str" and operator == "+":
            return replace(made, kind="str")
        if {left.kind, right.kind} == {"int", "float"} or left.kind == right.kind == "float":
            if operator in ("+", "-", "*"):
                return replace(made, kind="float")
            raise self._not(f"'{operator}' of numbers with a fraction")
        if not left.kind == right.kind == "int":
            raise self._not(f"'{operator}' of what are no numbers")
        if operator == "<<" and (right.span is None or right.span[0] < 0 or right.span[1] > MOST_SHIFT):
            raise self._not(f"a shift by what may be less than 0, or more than {MOST_SHIFT}", "limit it by & or %")
        return replace(made, span=_span(operator, left.span, right.span))

    def _compare(self, left: Translated, operator: str, right: Translated) -> Translated:
        numbers = {"int", "float"}
        if not (left.kind == right.kind or {left.kind, right.kind} <= numbers):
            raise self._not("a comparison of two kinds of values")
        if left.kind not in ("int", "bool", "float", "str", "bytes"):
            raise self._not("a comparison of what is no single value")
        text = f"{left.at_level(BIT_OR)} {operator} {right.at_level(BIT_OR)}"
        return Translated(text, COMPARE, "bool", (0, 1), left.names | right.names, (*left.needs, *right.needs))

    def _chosen(self, condition: Translated, then: Translated, otherwise: Translated) -> Translated:
        if then.kind != otherwise.kind and not {then.kind, otherwise.kind} <= {"int", "float"}:
            raise self._not("a choice between two kinds of values")
        if then.kind not in ("int", "bool", "float", "str", "bytes"):
            raise self._not("a choice between what is no single value")
        text = f"{then.at_level(OR)} if {condition.at_level(OR)} else {otherwise.at_level(CONDITIONAL)}"
        span = None
        if then.span is not None and otherwise.span is not None:
            span = (min(then.span[0], otherwise.span[0]), max(then.span[1], otherwise.span[1]))
        kind: Kind = then.kind if then.kind == otherwise.kind else "float"
        names = condition.names | then.names | otherwise.names
        guard = [condition.text]
        needs = (*condition.needs, *_needed(then.needs, guard, True), *_needed(otherwise.needs, guard, False))
        return Translated(text, CONDITIONAL, kind, span, names, needs)


def _needed(needs: tuple[str, ...], guard: list[str], is_true: bool) -> Iterator[str]:
    """Yield the conditions that are needed if all of a guard is true, or none of it; facts of the guard are omitted."""
    for one in needs:
        if is_true and (one in guard or f"({one})" in guard):
            continue
        if one == UNKNOWN:
            yield one
        elif is_true:
            yield f"not ({' and '.join(guard)}) or ({one})"
        else:
            yield f"{' or '.join(guard)} or ({one})"


def _span(operator: str, left: tuple[int, int] | None, right: tuple[int, int] | None) -> tuple[int, int] | None:
    """Return the range of a result; None if it is unknown or may be very large."""
    if right is not None and right[0] >= 0 and operator == "&":
        return (0, right[1])
    if right is not None and right[0] > 0 and operator == "%":
        return (0, right[1] - 1)
    if left is None or right is None:
        return None
    found = _span_of_known(operator, left, right)
    return found if found is not None and max(map(abs, found)).bit_length() <= 2048 else None


def _span_of_known(operator: str, left: tuple[int, int], right: tuple[int, int]) -> tuple[int, int] | None:
    """Return the range of a result of two operands with known ranges; None if it is unknown."""
    match operator:
        case "+":
            return (left[0] + right[0], left[1] + right[1])
        case "-":
            return (left[0] - right[1], left[1] - right[0])
        case "*":
            ends = [one * other for one in left for other in right]
            return (min(ends), max(ends))
        case "&" if left[0] >= 0:
            return (0, left[1])
        case "|" | "^" if left[0] >= 0 and right[0] >= 0:
            return (0, (1 << max(left[1], right[1]).bit_length()) - 1)
        case ">>" | "/" if left[0] >= 0 and right[0] >= 0:
            return (0, left[1])
        case "<<" if left[0] >= 0:
            return (0, left[1] << right[1])
    return None

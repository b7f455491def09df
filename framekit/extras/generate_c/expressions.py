"""Translate expressions of a definition to C, with the kind and the range of each part.

Numbers are unbounded in Python and bounded in C. So the range of every part is computed from the types of the fields,
and an expression that might exceed 64 bits is refused instead of truncated. A part without a value at run time (a
division by zero, an absent value) sets the flag `bad` and results in 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

from framekit.definition.expression import (
    Attribute,
    Binary,
    Bytes,
    Call,
    Compare,
    Conditional,
    Expression,
    Index,
    List,
    Logic,
    Name,
    Node,
    Number,
    Slice,
    Text,
    Unary,
)
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.source import number, string

LEAST, MOST = -(1 << 63), (1 << 63) - 1
"""The range of an int64_t."""
Kind = Literal["number", "bytes", "none", "record", "list", "other"]


@dataclass(frozen=True, slots=True)
class Val:
    """A value in C."""

    kind: Kind
    text: str = ""
    """An expression of the type int64_t or struct framekit_bytes."""
    low: int = LEAST
    high: int = MOST
    there: str = ""
    """The condition under which the value is present; '' if it always is."""
    known: str = ""
    """The condition under which the value has been read; '' if it always has."""
    item: CScope | None = None
    """The names in an item of a list; `@` in their texts is a placeholder for the index."""
    at_item: str = ""
    """The text of a value of an item."""
    constant: int | bytes | None = None
    """The value if it is constant."""
    fold: str = ""
    """The letter case of the comparison, 'lower' or 'upper'; '' for exact comparison."""
    inside: CScope | None = None
    """The names in a record."""
    wire: str = ""
    """The text of its encoded size, of its number of items, or of its presence."""
    least_size: int = 0
    most_size: int | None = None
    is_flag: bool = False
    is_text: bool = True


@dataclass(slots=True)
class CScope:
    """Values by the names in expressions, searched from the innermost scope outwards."""

    parent: CScope | None = None
    entries: dict[str, Val] = field(default_factory=dict)

    def find(self, name: str) -> Val | None:
        scope: CScope | None = self
        while scope is not None:
            if name in scope.entries:
                return scope.entries[name]
            scope = scope.parent
        return None


class CFacts(Protocol):
    """The file around expressions, as far as they need it."""

    def helper(self, name: str) -> str: ...
    def given(self, node: Name) -> Val: ...
    def lookup(self, node: Node, key: Val, default: Val | None) -> Val | None: ...


def constant(value: int | bytes) -> Val:
    if isinstance(value, int):
        return Val("number", number(value), value, value, constant=value)
    return Val("bytes", "", constant=value, least_size=len(value), most_size=len(value))


class CExpressionWriter:
    """Translate expressions in a scope."""

    def __init__(self, outside: CFacts, scope: CScope) -> None:
        self.outside = outside
        self.scope = scope

    # ---- what the writers of functions ask ----------------------------------------------------------------

    def value(self, expression: Expression) -> Val:
        return self.node(expression.root)

    def number(self, expression: Expression) -> Val:
        """Return a number that is present; any other value sets `bad` at run time."""
        return self._number(self.node(expression.root), expression.root)

    def condition(self, expression: Expression) -> str:
        """Return the text of the condition that the expression is true."""
        return self.truth(expression.root)

    def bytes(self, value: Val) -> str:
        """Return the text of a struct framekit_bytes."""
        if value.constant is not None and isinstance(value.constant, bytes):
            view = self.outside.helper("view")
            return f"{view}((const uint8_t *){string(value.constant)}, {len(value.constant)})"
        return value.text

    # ---- nodes --------------------------------------------------------------------------------------------

    def node(self, node: Node) -> Val:
        match node:
            case Number(value=value):
                if not LEAST <= value <= MOST:
                    raise CannotSayError(node.at, "a number of more than 64 bits")
                return constant(value)
            case Text(value=text):
                return constant(text.encode("latin-1", "replace"))
            case Bytes(value=data):
                return replace(constant(data), is_text=False)
            case Name(name=name):
                found = self.scope.find(name)
                return self._read(self.outside.given(node) if found is None else found)
            case Attribute(value=outer, name=name):
                return self._attribute(node, outer, name)
            case Index(value=outer, index=index):
                return self._index(node, outer, index)
            case Slice():
                return self._slice(node)
            case Unary():
                return self._unary(node)
            case Binary():
                return self._binary(node)
            case Compare():
                text = self._compare(node)
                return Val("number", f"(int64_t)({text})", 0, 1, is_flag=True)
            case Logic():
                return self._logic(node)
            case Conditional():
                return self._conditional(node)
            case Call():
                return self._call(node)
        raise CannotSayError(node.at, f"{type(node).__name__.lower()} in an expression")

    def _read(self, value: Val) -> Val:
        """Return a value as it is read: a value that is not available yet sets `bad` at run time."""
        if not value.known or value.kind not in ("number", "bytes"):
            return value
        if value.kind == "number":
            text = f"({value.known} ? {value.text} : {self.bad()})"
        else:
            text = f"({value.known} ? {value.text} : {self.bad_bytes()})"
        there = f"({value.known} ? {value.there} : {self.bad()} != 0)" if value.there else ""
        low, high = min(value.low, 0), max(value.high, 0)
        return replace(value, text=text, there=there, known="", low=low, high=high, least_size=0)

    def bad(self) -> str:
        return f"{self.outside.helper('bad')}(&bad)"

    def bad_bytes(self) -> str:
        return f"{self.outside.helper('bad_bytes')}(&bad)"

    def _number(self, value: Val, node: Node) -> Val:
        if value.kind == "none":
            return Val("number", self.bad(), 0, 0)
        if value.kind != "number":
            raise CannotSayError(node.at, "arithmetic with what is no whole number")
        if not value.there:
            return value
        low, high = min(value.low, 0), max(value.high, 0)
        return replace(value, text=f"({value.there} ? {value.text} : {self.bad()})", there="", low=low, high=high)

    def numbers(self, *nodes: Node) -> list[Val]:
        return [self._number(self.node(node), node) for node in nodes]

    def _bytes(self, node: Node) -> Val:
        value = self.node(node)
        if value.kind != "bytes":
            raise CannotSayError(node.at, "text of what is neither text nor bytes")
        if value.there:
            return replace(value, text=f"({value.there} ? {value.text} : {self.bad_bytes()})", there="", least_size=0)
        return value

    def ranged(self, node: Node, text: str, low: int, high: int) -> Val:
        if low < LEAST or high > MOST:
            raise CannotSayError(node.at, "a result that may need more than 64 bits", "give its fields a range")
        return Val("number", text, low, high)

    # ---- truth --------------------------------------------------------------------------------------------

    def truth(self, node: Node) -> str:
        match node:
            case Compare():
                return self._compare(node)
            case Unary(operator="not", operand=operand):
                return f"!({self.truth(operand)})"
            case Logic(operator=operator, operands=operands):
                word = " && " if operator == "and" else " || "
                return word.join(f"({self.truth(one)})" for one in operands)
        value = self.node(node)
        if value.kind == "none":
            return "false"
        if value.constant is not None:
            return "true" if value.constant else "false"
        if value.kind == "bytes":
            text = f"{value.text}.size != 0"
        elif value.kind == "number":
            text = f"{value.text} != 0"
        elif value.kind in ("record", "list") and value.wire:
            text = value.wire
        else:
            raise CannotSayError(node.at, "a condition that is no number, text or bytes")
        return f"({value.there} && {text})" if value.there else text

    def _logic(self, node: Logic) -> Val:
        values = [self.node(one) for one in node.operands]
        if all(one.is_flag for one in values):
            return Val("number", f"(int64_t)({self.truth(node)})", 0, 1, is_flag=True)
        raise CannotSayError(node.at, "'and' and 'or' that give something else than yes or no")

    def _conditional(self, node: Conditional) -> Val:
        test = self.truth(node.condition)
        first, second = self.node(node.then), self.node(node.otherwise)
        if test in ("true", "false"):
            return first if test == "true" else second
        kinds = {first.kind, second.kind} - {"none"}
        if len(kinds) > 1 or not kinds <= {"number", "bytes"}:
            raise CannotSayError(node.at, "a choice between values of different kinds")
        if not kinds:
            return Val("none")
        there = ""
        if any(one.there or one.kind == "none" for one in (first, second)):
            texts = ["false" if one.kind == "none" else one.there or "true" for one in (first, second)]
            there = f"({test} ? {texts[0]} : {texts[1]})"
        choose = self._choose_bytes if kinds == {"bytes"} else self._choose_number
        return choose(test, (first, second), there)

    def _choose_bytes(self, test: str, values: tuple[Val, Val], there: str) -> Val:
        """Return the bytes that a condition selects; an absent value is empty."""
        view = f"{self.outside.helper('view')}(NULL, 0)"
        texts = [view if one.kind == "none" else self.bytes(one) for one in values]
        sizes = [one.most_size for one in values if one.kind != "none"]
        most = None if None in sizes else max(one for one in sizes if one is not None)
        return Val("bytes", f"({test} ? {texts[0]} : {texts[1]})", there=there, most_size=most)

    def _choose_number(self, test: str, values: tuple[Val, Val], there: str) -> Val:
        """Return the number that a condition selects; an absent value is 0."""
        texts = ["0" if one.kind == "none" else one.text for one in values]
        known = [one for one in values if one.kind != "none"]
        low, high = min(one.low for one in known), max(one.high for one in known)
        return Val("number", f"(({test}) ? {texts[0]} : {texts[1]})", low, high, there)

    def _compare(self, node: Compare) -> str:
        parts, left = [], node.first
        for operator, right in node.rest:
            parts.append(self._pair(node, operator, left, right))
            left = right
        return parts[0] if len(parts) == 1 else " && ".join(f"({one})" for one in parts)

    def _pair(self, node: Node, operator: str, left: Node, right: Node) -> str:
        if operator in ("in", "not in"):
            text = self._within(node, left, right)
            return text if operator == "in" else f"!({text})"
        first, second = self.node(left), self.node(right)
        if operator in ("==", "!="):
            text = self.same(node, first, second)
            return text if operator == "==" else f"!({text})"
        if first.kind == second.kind == "bytes":
            raise CannotSayError(node.at, "texts compared by < or >")
        first, second = self._number(first, left), self._number(second, right)
        return f"{first.text} {operator} {second.text}"

    def same(self, node: Node, first: Val, second: Val) -> str:
        if "none" in (first.kind, second.kind):
            other = second if first.kind == "none" else first
            if other.kind == "none":
                return "true"
            return f"!({other.there})" if other.there else "false"
        theres = [one.there for one in (first, second) if one.there]
        if len(theres) > 1:
            raise CannotSayError(node.at, "two values compared that may both be nothing")
        there = f"{theres[0]} && " if theres else ""
        if first.kind != second.kind and {first.kind, second.kind} <= {"number", "bytes"}:
            return "false"
        if first.kind == "number" and second.kind == "number":
            if first.constant is not None and second.constant is not None:
                return "true" if first.constant == second.constant else "false"
            return f"({there}{first.text} == {second.text})" if there else f"{first.text} == {second.text}"
        if first.kind == "bytes" and second.kind == "bytes":
            text = self._same_bytes(node, first, second)
            return f"({there}{text})" if text != "false" else text
        raise CannotSayError(node.at, "a comparison of what is neither numbers nor text")

    def _same_bytes(self, node: Node, first: Val, second: Val) -> str:
        """Return the comparison of two texts, of which `lower` or `upper` may be applied to one or both."""
        fold = first.fold or second.fold
        if not fold:
            return f"{self.outside.helper('same_bytes')}({self.bytes(first)}, {self.bytes(second)})"
        plain, folded = (first, second) if second.fold else (second, first)
        if plain.constant is None and not plain.fold and plain.text in folded.text:
            return f"{self.outside.helper('is_lower' if fold == 'lower' else 'is_upper')}({plain.text})"
        if {first.fold, second.fold} == {"lower", "upper"}:
            raise CannotSayError(node.at, "small letters compared with capitals")
        for one in (first, second):  # a side that is not folded must be folded already
            if one.fold:
                continue
            if not isinstance(one.constant, bytes):
                raise CannotSayError(node.at, "lower() or upper() on one side, and no constant on the other")
            shown = one.constant.decode("latin-1")
            if not shown.isascii():
                raise CannotSayError(node.at, "letters beyond ASCII compared without their case")
            if shown != (shown.lower() if fold == "lower" else shown.upper()):
                return "false"
        return f"{self.outside.helper('same_letters')}({self.bytes(first)}, {self.bytes(second)})"

    def _within(self, node: Node, left: Node, right: Node) -> str:
        if isinstance(right, List):
            first = self.node(left)
            tests = [self.same(node, first, self.node(one)) for one in right.items]
            tests = [one for one in tests if one != "false"]
            return " || ".join(f"({one})" for one in tests) or "false"
        second = self.node(right)
        if second.kind == "bytes":
            first = self._bytes(left)
            if first.fold or second.fold:
                raise CannotSayError(node.at, "lower() or upper() in a search")
            return f"{self.outside.helper('holds')}({self.bytes(second)}, {self.bytes(first)})"
        if second.kind == "other":
            key = self.node(left)
            found = self.outside.lookup(right, key, None)
            if found is not None:
                return found.wire
        raise CannotSayError(node.at, "'in' something else than a list, a text or a table")

    # ---- parts of values ----------------------------------------------------------------------------------

    def _attribute(self, node: Node, outer: Node, name: str) -> Val:
        value = self.node(outer)
        if value.kind == "list" and value.item is not None and name in value.item.entries:
            return replace(value, item=None, at_item=value.item.entries[name].text)
        if value.kind == "record" and value.inside is not None:
            found = value.inside.entries.get(name)
            if found is None:
                raise CannotSayError(node.at, f"'{name}' of a record that may be of several forms")
            found = self._read(found)
            if value.there:
                there = f"({value.there}{f' && {found.there}' if found.there else ''})"
                return replace(found, there=there)
            return found
        raise CannotSayError(node.at, f"'.{name}' of something else than a record")

    def _index(self, node: Node, outer: Node, index: Node) -> Val:
        value = self.node(outer)
        if value.kind == "other":
            found = self.outside.lookup(outer, self.node(index), None)
            if found is None:
                raise CannotSayError(node.at, "a table in this form")
            return found
        if value.kind == "list" and value.item is not None:
            return self._item(value, value.item, index)
        if value.kind != "bytes":
            raise CannotSayError(node.at, "an item of a list in an expression")
        (place,) = self.numbers(index)
        if not value.is_text:
            value = self._bytes(outer)
            byte = self.outside.helper("byte_at")
            return Val("number", f"{byte}({self.bytes(value)}, {place.text}, &bad)", 0, 255)
        at = self.outside.helper("letter_at")
        value = self._bytes(outer)
        return Val("bytes", f"{at}({self.bytes(value)}, {place.text}, &bad)", fold=value.fold, most_size=1)

    def _item(self, value: Val, item: CScope, index: Node) -> Val:
        """Return an item of a list by its index; an index beyond the end sets `bad` at run time."""
        (place,) = self.numbers(index)
        if place.low < 0:
            raise CannotSayError(index.at, "an item counted from the end of a list")
        inside = CScope()
        is_there = f"{f'{value.there} && ' if value.there else ''}(size_t){place.text} < {value.wire}"
        for name, one in item.entries.items():
            text = one.text.replace("@", f"{place.text}")
            inside.entries[name] = replace(one, text=text, there=one.there.replace("@", place.text), known=is_there)
        return Val("record", "", inside=inside)

    def _slice(self, node: Slice) -> Val:
        value = self._bytes(node.value)
        ends = []
        for end, otherwise in ((node.start, 0), (node.stop, MOST)):
            ends.append(constant(otherwise) if end is None else self.numbers(end)[0])
        most = value.most_size
        if all(one.low >= 0 for one in ends):
            most = min(ends[1].high if most is None else most, max(ends[1].high - ends[0].low, 0))
        part = self.outside.helper("part")
        text = f"{part}({self.bytes(value)}, {ends[0].text}, {ends[1].text})"
        return Val("bytes", text, fold=value.fold, most_size=most, is_text=value.is_text)

    # ---- operators ----------------------------------------------------------------------------------------

    def _unary(self, node: Unary) -> Val:
        if node.operator == "not":
            return Val("number", f"(int64_t)({self.truth(node)})", 0, 1, is_flag=True)
        (value,) = self.numbers(node.operand)
        if value.constant is not None and isinstance(value.constant, int):
            return constant(-value.constant if node.operator == "-" else ~value.constant)
        if node.operator == "-":
            return self.ranged(node, f"(-{value.text})", -value.high, -value.low)
        return self.ranged(node, f"(~{value.text})", ~value.high, ~value.low)

    def _binary(self, node: Binary) -> Val:
        first_value, second_value = self.node(node.left), self.node(node.right)
        if "bytes" in (first_value.kind, second_value.kind):
            raise CannotSayError(node.at, f"'{node.operator}' of texts or bytes")
        first, second = self._number(first_value, node.left), self._number(second_value, node.right)
        operator = node.operator
        if (folded := _folded(operator, first, second)) is not None:
            return folded
        text = f"({first.text} {operator} {second.text})"
        match operator:
            case "+":
                return self.ranged(node, text, first.low + second.low, first.high + second.high)
            case "-":
                return self.ranged(node, text, first.low - second.high, first.high - second.low)
            case "*":
                products = [one * other for one in (first.low, first.high) for other in (second.low, second.high)]
                return self.ranged(node, text, min(products), max(products))
            case "//" | "%":
                return self._division(node, first, second)
            case "<<" | ">>":
                return self._shift(node, first, second)
            case "&":
                tops = [one.high for one in (first, second) if one.low >= 0]
                return self.ranged(node, text, 0, min(tops)) if tops else self.ranged(node, text, LEAST, MOST)
        if first.low < 0 or second.low < 0:
            raise CannotSayError(node.at, f"'{operator}' of numbers that may be negative")
        bits = max(first.high.bit_length(), second.high.bit_length())
        return self.ranged(node, text, 0, (1 << bits) - 1)

    def _division(self, node: Binary, first: Val, second: Val) -> Val:
        whole = node.operator == "//"
        if second.low <= 0 or first.low < 0:
            helper = self.outside.helper("divided" if whole else "remainder")
            text = f"{helper}({first.text}, {second.text}, &bad)"
            if second.low < 0:
                raise CannotSayError(node.at, "a division by what may be negative")
            low = first.low if whole else 0
            return self.ranged(node, text, min(low, 0), max(first.high if whole else second.high - 1, 0))
        text = f"({first.text} {'/' if whole else '%'} {second.text})"
        if whole:
            return self.ranged(node, text, first.low // second.high, first.high // second.low)
        return self.ranged(node, text, 0, min(first.high, second.high - 1))

    def _shift(self, node: Binary, first: Val, second: Val) -> Val:
        if second.low < 0 or second.high > 63:
            raise CannotSayError(node.at, "a shift by what is not between 0 and 63")
        if node.operator == ">>":
            if first.low < 0:
                raise CannotSayError(node.at, "a shift of what may be negative")
            return self.ranged(
                node, f"({first.text} >> {second.text})", first.low >> second.high, first.high >> second.low
            )
        if first.low < 0:
            raise CannotSayError(node.at, "a shift of what may be negative")
        text = f"((int64_t){first.text} << {second.text})"
        return self.ranged(node, text, first.low << second.low, first.high << second.high)

    # ---- functions ----------------------------------------------------------------------------------------

    def _call(self, node: Call) -> Val:
        write = _FUNCTIONS.get(node.function)
        found = None if write is None else write(self, node)
        if found is None:
            raise CannotSayError(node.at, f"the function {node.function}()")
        return found

    def _call_either(self, node: Call) -> Val:
        first, second = (self.node(one) for one in node.arguments)
        if first.kind == "none":
            return second
        return self._either(node, first, second) if first.there else first

    def _extreme(self, node: Call) -> Val | None:
        """Return `min` or `max` of several numbers; None for one list."""
        if len(node.arguments) < 2:
            return None
        values = self.numbers(*node.arguments)
        is_min = node.function == "min"
        helper = self.outside.helper("least" if is_min else "greatest")
        text = values[0].text
        for one in values[1:]:
            text = f"{helper}({text}, {one.text})"
        pick = min if is_min else max
        return Val("number", text, pick(one.low for one in values), pick(one.high for one in values))

    def _absolute(self, node: Call) -> Val:
        (value,) = self.numbers(*node.arguments)
        high = max(abs(value.low), abs(value.high))
        return self.ranged(node, f"{self.outside.helper('absolute')}({value.text})", 0, high)

    def _bit(self, node: Call) -> Val:
        value, place = self.numbers(*node.arguments)
        if value.low < 0 or place.low < 0 or place.high > 63:
            raise CannotSayError(node.at, "a bit that may not be among the 63 of a number")
        return Val("number", f"({value.text} >> {place.text} & 1)", 0, 1)

    def _rotated(self, node: Call) -> Val:
        value, count = self.numbers(*node.arguments)
        return Val("number", f"{self.outside.helper('rotated')}({value.text}, {count.text})", 0, 255)

    def _letters(self, node: Call) -> Val:
        value = self._bytes(node.arguments[0])
        return replace(value, fold=node.function, constant=None, text=self.bytes(value))

    def _only(self, node: Call) -> Val:
        shown, letters = (self._bytes(one) for one in node.arguments)
        if shown.fold or letters.fold:
            raise CannotSayError(node.at, "lower() or upper() in only()")
        text = f"(int64_t){self.outside.helper('only')}({self.bytes(shown)}, {self.bytes(letters)})"
        return Val("number", text, 0, 1, is_flag=True)

    def _same_items(self, node: Call) -> Val | None:
        """Return `same` of a list; None for other values."""
        value = self.node(node.arguments[0])
        if value.kind != "list" or not value.at_item:
            return None
        start = value.at_item.replace("@", "0")
        step = f"sizeof({value.text}.items[0])"
        call = f"{self.outside.helper('same_items')}(&{start}, {value.wire}, {step})"
        text = f"({value.there} ? (int64_t){call} : {self.bad()})" if value.there else f"(int64_t){call}"
        return Val("number", text, 0, 1, is_flag=True)

    def _entry(self, node: Call) -> Val | None:
        """Return an entry of a table; None where C cannot look it up."""
        key, default = self.node(node.arguments[1]), self.node(node.arguments[2])
        return self.outside.lookup(node.arguments[0], key, default)

    def _either(self, node: Node, first: Val, second: Val) -> Val:
        if first.kind == second.kind == "number":
            low, high = min(first.low, second.low), max(first.high, second.high)
            return Val("number", f"({first.there} ? {first.text} : {second.text})", low, high, second.there)
        if first.kind == second.kind == "bytes":
            return Val("bytes", f"({first.there} ? {first.text} : {self.bytes(second)})", there=second.there)
        if second.kind == "none":
            return first
        raise CannotSayError(node.at, "either() of different kinds")

    def _length(self, node: Call) -> Val:
        argument = node.arguments[0]
        found = self.scope.find(argument.name) if isinstance(argument, Name) else None
        if found is not None and found.wire and found.kind != "bytes":
            text = f"(int64_t){found.wire}"
            return Val("number", text if not found.known else f"({found.known} ? {text} : {self.bad()})", 0, 1 << 31)
        value = self.node(argument)
        if value.kind == "bytes":
            value = self._bytes(argument)
            if isinstance(value.constant, bytes):
                return constant(len(value.constant))
            most = 1 << 31 if value.most_size is None else value.most_size
            return Val("number", f"(int64_t){value.text}.size", value.least_size, most)
        raise CannotSayError(node.at, "len() of what is neither text nor bytes nor a list")

    def _as_number(self, node: Call) -> Val:
        value = self._bytes(node.arguments[0])
        base = 10 if len(node.arguments) < 2 else self.node(node.arguments[1]).constant
        if not isinstance(base, int):
            raise CannotSayError(node.at, "a base that is worked out")
        high = base**value.most_size - 1 if value.most_size is not None and value.most_size < 64 else MOST + 1
        if high > MOST:
            raise CannotSayError(node.at, "a number of more than 64 bits in a text")
        return Val(
            "number",
            f"{self.outside.helper('text_number')}({self.bytes(value)}, {base}, {number(high)}, &bad)",
            0,
            high,
        )


_FOLD: dict[str, Callable[[int, int], int]] = {
    "+": lambda one, other: one + other,
    "-": lambda one, other: one - other,
    "*": lambda one, other: one * other,
    "//": lambda one, other: one // other,
    "%": lambda one, other: one % other,
    "&": lambda one, other: one & other,
    "|": lambda one, other: one | other,
    "^": lambda one, other: one ^ other,
    "<<": lambda one, other: one << other if 0 <= other < 64 else MOST + 1,
    ">>": lambda one, other: one >> other if 0 <= other < 64 else MOST + 1,
}


def _folded(operator: str, first: Val, second: Val) -> Val | None:
    """Return the result of an operator on two constants; None if one is no constant, or the result has no form in C."""
    fold, one, other = _FOLD.get(operator), first.constant, second.constant
    if fold is None or one is None or other is None:
        return None
    assert isinstance(one, int) and isinstance(other, int)
    if operator in ("//", "%") and not other:
        return None
    result = fold(one, other)
    return constant(result) if LEAST <= result <= MOST else None


_FUNCTIONS: dict[str, Callable[[CExpressionWriter, Call], Val | None]] = {
    "none": lambda w, node: Val("none"),
    "len": CExpressionWriter._length,
    "either": CExpressionWriter._call_either,
    "min": CExpressionWriter._extreme,
    "max": CExpressionWriter._extreme,
    "abs": CExpressionWriter._absolute,
    "bit": CExpressionWriter._bit,
    "rotl8": CExpressionWriter._rotated,
    "lower": CExpressionWriter._letters,
    "upper": CExpressionWriter._letters,
    "number": CExpressionWriter._as_number,
    "only": CExpressionWriter._only,
    "same": CExpressionWriter._same_items,
    "get": CExpressionWriter._entry,
}
"""The functions of the language that C has; None as result: not for these arguments."""

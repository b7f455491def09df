"""Single segments: numbers that fit their types, keys that go together, texts and bytes that have their size.

What several segments say together (ends, orders, lengths) is checked elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator

from framekit.definition.expression.syntax import Bytes, Expression, Number, Text, Unary
from framekit.definition.model.frames import fixed_size, least_size
from framekit.definition.model.segments import (
    Bits,
    BitsPart,
    Check,
    Choose,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Optional,
    Repeat,
    Require,
    Segment,
    Value,
    Wrap,
)
from framekit.definition.model.walk import bounds_of
from framekit.definition.problems import Position, Problem, plural

NUMBERS = ("int", "digits", "bcd")


def check_segment(segment: Segment) -> Iterator[Problem]:
    """Problems of one segment by itself."""
    match segment:
        case Field():
            yield from _field(segment)
        case Bits():
            yield from _bits(segment)
        case Length() | Count():
            yield from _counting(segment)
        case Data():
            yield from _data(segment)
        case Repeat():
            yield from _repeat(segment)
        case Inner():
            if not segment.frames:
                yield Problem(segment.at, f"'{segment.name}' can hold no frame", "name a group that has frames")
        case Wrap():
            yield from _wrap(segment)
        case Check():
            yield from _check(segment)
        case Choose():
            yield from _choose(segment)


# ---- numbers ------------------------------------------------------------------------------------------------


def _field(field: Field) -> Iterator[Problem]:
    yield from _contradictions(field)
    if field.type.kind not in NUMBERS:
        yield from _no_number(field)
        return
    if field.type.kind == "digits" and isinstance(field.type.size, int) and field.type.size > 32:
        yield Problem(field.at, f"a number of {field.type.size} digits is too long", "use data: for it")
    if field.long is not None and isinstance(field.type.size, Expression):
        what = f"'{field.name}' has a computed size, so its mark for long: has none"
        yield Problem(field.at, what, "give a size that is a number, or leave long out")
    if field.only and field.long is not None:
        yield Problem(field.at, "only: values cannot go with long:", "leave one of them out")
    bounds = bounds_of(field.type)
    if bounds is not None and field.long is not None and not bounds[0] <= field.long.mark <= bounds[1]:
        what = f"the mark {field.long.mark} does not fit: '{field.name}' holds {bounds[0]} to {bounds[1]}"
        yield Problem(field.at, what, "give a mark that it can hold, or use a wider type")
    if bounds is not None and field.long is None:
        yield from _numbers(field, bounds)
    yield from _zero(field)


def _zero(segment: Field | Length | Count) -> Iterator[Problem]:
    if segment.zero_means is not None and segment.type.signed:
        what = f"'{segment.name}' has a sign: its 0 stands between other numbers and cannot mean {segment.zero_means}"
        yield Problem(segment.at, what, "take a type without sign, or leave zero_means out")


def _contradictions(field: Field) -> Iterator[Problem]:
    given = [key for key, value in (("build", field.build), ("default", field.default)) if value is not None]
    if field.is_ is not None and given:
        yield Problem(
            field.at, f"is: computes '{field.name}' always, {given[0]}: has no effect", "leave one of them out"
        )
    if field.is_ is not None and field.constants is not None:
        yield Problem(field.at, f"'{field.name}' is computed by is: and fixed by where:", "leave one of them out")
    names: dict[str, int] = {}
    for number, name in (field.values or {}).items():
        if name in names:
            what = f"the name '{name}' stands for {names[name]} and for {number}"
            yield Problem(field.at, what, "give each number its own name", warning=True)
        names[name] = number


def _no_number(field: Field) -> Iterator[Problem]:
    """Keys that only numbers have; a computed constant as long as the field."""
    kind = {"ascii": "text", "bytes": "bytes", "float": "a number with a fraction"}[field.type.kind]
    keys = {
        "range": field.limits is not None and field.type.kind != "float",
        "plus": field.plus != 0,
        "unit": field.unit is not None,
        "long": field.long is not None,
        "zero_means": field.zero_means is not None,
        "values": field.values is not None,
    }
    for key, there in keys.items():
        if there:
            yield Problem(field.at, f"{key}: belongs to whole numbers, '{field.name}' is {kind}", f"leave {key} out")
    size = field.type.fixed_size
    root = None if field.is_ is None else field.is_.root
    if isinstance(root, (Text, Bytes)):
        yield from _size_of_constant(field, root.value, size)


def _size_of_constant(field: Field, constant: int | str | bytes, size: int | None) -> Iterator[Problem]:
    if size is None or isinstance(constant, int):
        return
    fits = len(constant) <= size if field.type.pad is not None else len(constant) == size
    if not fits:
        shown = f"'{constant}'" if isinstance(constant, str) else constant.hex(" ").upper()
        what = f"{shown} has {len(constant)} bytes, '{field.name}' has {size}"
        yield Problem(
            field.at, what, "correct one of them" if field.type.pad is not None else "correct it, or add pad:"
        )


def _numbers(field: Field, bounds: tuple[int, int]) -> Iterator[Problem]:
    """Numbers that the field would have to carry: names, limits, and constant expressions."""
    if field.unit is None:
        yield from _limits(field, field.plus)
    for number in field.values or ():
        if not bounds[0] <= number + field.plus <= bounds[1]:
            yield _too_large(field, number, bounds, field.at)
    for expression in (field.is_, field.build, field.default):
        given = constant_number(expression)
        if expression is None or given is None or field.unit is not None:
            continue
        if not bounds[0] <= given + field.plus <= bounds[1]:
            yield _too_large(field, given, bounds, expression.at)
        else:
            yield from _allowed(field, given, expression.at)


def _allowed(field: Field, number: int, at: Position) -> Iterator[Problem]:
    """Whether a constant respects what the field says about its values."""
    if field.limits is not None and field.unit is None and not field.limits[0] <= number <= field.limits[1]:
        low, high = field.limits
        yield Problem(at, f"{number} is not in {low}..{high}, the range of '{field.name}'", "correct one of them")
    if field.only and field.values is not None and number not in field.values:
        yield Problem(at, f"{number} has no name in the values of '{field.name}'", "add it there, or correct it")


def constant_number(expression: Expression | None) -> int | None:
    """The number, if the expression is just one."""
    match expression.root if expression is not None else None:
        case Number(value=value, is_time=False):
            return value
        case Unary(operator="-", operand=Number(value=value, is_time=False)):
            return -value
    return None


def _limits(segment: Field | Length | Count, plus: int = 0) -> Iterator[Problem]:
    bounds = bounds_of(segment.type)
    if bounds is not None and segment.limits is not None:
        for number in segment.limits:
            if not bounds[0] <= number + plus <= bounds[1]:
                yield _too_large(segment, number, bounds, segment.at)
                return


def _too_large(segment: Field | Length | Count, number: int, bounds: tuple[int, int], at: Position) -> Problem:
    what = f"{number} does not fit: '{segment.name}' holds {bounds[0] - segment.plus} to {bounds[1] - segment.plus}"
    return Problem(at, what, "use a wider type")


def _counting(segment: Length | Count) -> Iterator[Problem]:
    kind = "a length" if isinstance(segment, Length) else "a count"
    if segment.type.kind not in NUMBERS:
        what = f"{kind} is a whole number, '{segment.name}' is of another type"
        yield Problem(segment.at, what, "use u8, u16, hex, dec or bcd")
        return
    yield from _limits(segment)
    yield from _zero(segment)
    if isinstance(segment, Length) and segment.unit < 1:
        yield Problem(segment.at, f"a unit of {segment.unit} bytes counts nothing", "give 1 or more")


def _bits(bits: Bits) -> Iterator[Problem]:
    if bits.type.kind not in NUMBERS:
        yield Problem(bits.at, "bits are taken from a whole number", "use of: u8, u16, hex, …")
        return
    size = bits.type.fixed_size
    width = 0 if size is None else size * (4 if bits.type.kind == "digits" else 8)
    taken: dict[int, str] = {}
    for part in bits.parts:
        if size is not None and part.high >= width:
            yield Problem(part.at, f"bit {part.high} is beyond the {width} bits there are", "use a wider type")
        for place in range(part.low, min(part.high, 1024) + 1):
            if place in taken:
                yield Problem(part.at, f"bit {place} belongs to '{taken[place]}' already", "give each bit one name")
                break
            taken[place] = part.name
        yield from _bits_part(part)


def _bits_part(part: BitsPart) -> Iterator[Problem]:
    """Constants of bits fit into them."""
    most = (1 << part.high - part.low + 1) - 1 if part.high < 1024 else None
    constants = [(number, part.at) for number in part.values or ()]
    constants += [
        (number, expression.at)
        for expression in (part.is_, part.build)
        if expression is not None and (number := constant_number(expression)) is not None
    ]
    for number, at in constants:
        if most is not None and not 0 <= number <= most:
            yield Problem(at, f"{number} does not fit: '{part.name}' holds 0 to {most}", "give it more bits")


# ---- data and regions ---------------------------------------------------------------------------------------


def _data(data: Data) -> Iterator[Problem]:
    number = constant_number(data.size) if isinstance(data.size, Expression) else None
    if number is not None and number < 0:
        yield Problem(data.at, f"a size of {number} bytes cannot be", "give 0 or more, rest, or an expression")
    if isinstance(data.size, int):
        if data.least > data.size:
            what = f"'{data.name}' has {data.size} bytes and wants at least {data.least}"
            yield Problem(data.at, what, "leave min out")
        if data.convert == "ascii_to_hex" and data.size % 2:
            what = f"'{data.name}' has {data.size} digits in memory, two of them make one byte"
            yield Problem(data.at, what, "give an even size")
    elif data.size == "rest" and data.pad is not None:
        yield Problem(data.at, f"'{data.name}' takes the rest: nothing is filled up", "leave pad out, or give a size")


def _repeat(repeat: Repeat) -> Iterator[Problem]:
    if isinstance(repeat.of, FieldType):
        return
    if not repeat.of:
        yield Problem(repeat.at, f"an item of '{repeat.name}' is empty", "add segments to of")
    elif all(fixed_size(segment) == 0 for segment in repeat.of):
        yield Problem(repeat.at, f"an item of '{repeat.name}' takes no bytes", "add a segment that takes some")
    elif repeat.times == "rest" and all(_may_be_nothing(segment) for segment in repeat.of):
        what = f"an item of '{repeat.name}' may take no bytes, so nothing shows how many there are"
        yield Problem(repeat.at, what, "add a segment that always takes some, or a count")


def _may_be_nothing(segment: Segment) -> bool:
    """Whether a segment is there only under a condition, or in one of several cases."""
    return segment.when is not None or isinstance(segment, (Choose, Optional, Require, Value))


def _wrap(wrap: Wrap) -> Iterator[Problem]:
    least = least_size(wrap.of)
    if isinstance(wrap.most, int):
        if wrap.least > wrap.most:
            yield Problem(wrap.at, f"min {wrap.least} is more than max {wrap.most}", "exchange them")
        elif least > wrap.most:
            yield Problem(wrap.at, f"the content takes at least {least} bytes, max says {wrap.most}", "correct max")
    if not wrap.of:
        yield Problem(wrap.at, "there is nothing in this wrap", "add segments to of")


def _check(check: Check) -> Iterator[Problem]:
    """A code has the places its digits need."""
    bits = {"raw": 8, "hex": 4, "HEX": 4, "nibbles": 4}.get(check.form)
    if bits is not None and check.size * bits < check.method.width:
        what = f"a code of {check.method.width} bits does not fit into {plural(check.size, 'byte')}"
        todo = "leave size out" if check.form == "raw" else "each digit holds 4 bits: leave size out"
        yield Problem(check.at, what, todo)
    if check.form == "dec" and 10**check.size <= (1 << check.method.width) - 1:
        what = f"a code of {check.method.width} bits does not fit into {check.size} decimal digits"
        yield Problem(check.at, what, "leave size out")
    if check.over is not None and check.name in check.over:
        yield Problem(check.at, "a check code cannot cover itself", "leave its name out of over")


def _choose(choose: Choose) -> Iterator[Problem]:
    seen: set[int | str] = set()
    for keys, _ in choose.cases:
        for key in keys:
            if key in seen:
                yield Problem(choose.at, f"there are two cases {key}", "join them")
            seen.add(key)

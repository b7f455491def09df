"""Write the segments of a frame as Lua tables for `reader.lua`: one function for each kind of segment.

Questions about related segments (counted segments, covered bytes, later segments) are answered by the writer of careful
functions of the Python codec, so that both interpret a definition identically.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from framekit.codec.kinds.check import in_one_buffer
from framekit.codec.kinds.counted import absent_behind, counted_room
from framekit.codec.python.choices import in_order
from framekit.codec.python.diagnosis import DiagnosisWriter, checks_option, inside_of
from framekit.codec.python.expressions import FieldScope, constant_of
from framekit.codec.python.facts import parts_around
from framekit.codec.python.function import (
    covered_parts,
    covered_paths,
    covers_later,
    paths_of,
    paths_read,
    standing_any_way,
)
from framekit.codec.python.module import Module
from framekit.codec.python.runtime_diagnosis import shown
from framekit.definition.codings import Blocks, Ciphered, Cobs, Doubled, Escaped, Hex, Inserted, Plain, Short
from framekit.definition.expression import Expression, Node, Number, Text
from framekit.definition.kinds.check import Added
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.frames import Frame, bytes_of, everything, flat, nearest_path, without_when
from framekit.definition.model.segments import (
    PLAIN,
    Bits,
    Check,
    Choose,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Fill,
    Inner,
    ItemEnd,
    Length,
    Nested,
    Optional,
    Record,
    Repeat,
    Require,
    Segment,
    Segments,
    Skip,
    Value,
    Wrap,
    exactly,
)
from framekit.definition.problems import CannotSayError, Problem
from framekit.extras.wireshark.expressions import LuaExpressions, constant
from framekit.extras.wireshark.fields import FieldUse, FilterFields
from framekit.extras.wireshark.source import flag, listed, not_said, number, string, table

Entries = dict[str, str | None]
WIDEST_CHECK = 32
"""Largest width in bits of a check code that Lua computes."""


class Checks:
    """The check methods of a file, each as an entry of the list `methods`."""

    def __init__(self, expressions: LuaExpressions) -> None:
        self._expressions = expressions
        self.lines: dict[CheckMethod, str] = {}

    def method(self, method: CheckMethod, at: Any) -> str:
        """Return the source of a check method. Raises CannotSayError for a method that Lua cannot compute."""
        if method.is_keyed:
            raise not_said(at, f"the check code {method.name} is made with a key")
        if method.kind not in ("sum", "word_sum", "xor", "sum7", "xor7", "or", "multiply", "crc", "fold"):
            raise not_said(at, f"the check method {method.name} is brought by a program")
        if method.width > WIDEST_CHECK:
            raise not_said(at, f"the check code {method.name} has more than {WIDEST_CHECK} bits")
        if method not in self.lines:
            entries: Entries = {
                "kind": string(method.kind), "width": str(method.width), "order": string(method.order),
                "initial": str(method.initial), "poly": str(method.poly), "xorout": str(method.xorout),
                "refin": flag(method.refin), "refout": flag(method.refout),
                "complement": None if method.complement is None else string(method.complement),
                "mask": None if method.mask is None else str(method.mask),
            }  # fmt: skip
            if method.expression is not None:
                problems = len(self._expressions.problems)
                code = self._expressions.text(method.expression.root, FieldScope(), ("acc", "byte"))
                if len(self._expressions.problems) > problems:
                    raise not_said(at, f"the check code {method.name}")
                entries["fold"] = f"function(acc, byte) return {code} end"
            self.lines[method] = table(entries)
        return f"methods[{[*self.lines].index(method) + 1}]"


class SegmentWriter:
    """Write the segments of a frame."""

    def __init__(
        self, module: Module, frame: Frame, expressions: LuaExpressions, checks: Checks, fields: FilterFields
    ) -> None:
        self.frame = frame
        self.segments = module.static.segments(frame)
        self.static = module.static
        self.diagnosis = DiagnosisWriter(module, self.segments)
        self.expressions = expressions
        self.checks = checks
        self.fields = fields
        self.scope = FieldScope()
        self.diagnosis.declare(self.segments, self.scope)
        self.unverified: list[Problem] = []

    # ---- parts of a frame ---------------------------------------------------------------------------------

    def whole(self) -> Entries:
        """Return the table entries that define how the bytes of the frame are read."""
        frame = self.frame
        if frame.delimited and frame.tail and isinstance(frame.tail[0], Const):
            return {
                "head": self.listed(frame.head, self.scope), "body": self.listed(frame.body, self.scope),
                "tail": self.listed(frame.tail, self.scope), "tail_first": string(frame.tail[0].data[:1]),
                "middle_checks": flag(checks_option(frame.body)),
            }  # fmt: skip
        return self.region(self.segments, self.scope)

    def region(self, segments: Segments, scope: FieldScope) -> Entries:
        """Return the entries of a region: its segments, and the Lua indexes of its variable part and of its tail."""
        front, middle, _ = parts_around(self.diagnosis.static, segments)
        if not middle:
            return {"of": self.listed(segments, scope), "front": None}
        sizes = (len(front), len(front) + len(middle))
        return {
            "of": self.listed(segments, scope), "from_middle": str(sizes[0] + 1), "from_tail": str(sizes[1] + 1),
            "middle_checks": flag(checks_option(middle)),
        }  # fmt: skip

    def listed(self, segments: Segments, scope: FieldScope) -> str:
        return listed(self.segment(one, scope) for one in segments)

    def segment(self, segment: Segment, scope: FieldScope) -> str:
        """Return the table of a segment; a segment without a Lua form fails when it is reached."""
        key = self._key(segment)
        static = self.static.present(segment)
        paths = sorted({path for one in everything((segment,)) for path in paths_of(one)})
        entries: Entries = {
            "kind": None, "key": string(key), "shown": string(self._shown(segment)),
            "path": self._path(segment, key),
            "size_known": None if static.fixed is None else str(static.fixed),
            "when": None if segment.when is None else self.expressions.function(segment.when, scope),
            "told": None if segment.when is None else self._needs(segment, segment.when),
            "refuse": None if segment.refuse is None or isinstance(segment, _NOT_REFUSED) else str(segment.refuse),
            "paths": self._texts(paths) if segment.name else None,
        }  # fmt: skip
        try:
            kind = _KINDS.get(type(segment))
            if kind is None:
                raise not_said(segment.at, f"a segment of the kind '{segment.KEY}'")
            entries |= kind(self, without_when(segment), scope)
        except CannotSayError as error:
            self.expressions.problems.append(error.problem)
            entries |= {"kind": '"cannot"', "why": string(error.problem.what)}
        if segment.when is not None:
            self._absent(segment, scope, entries)
        return table(entries)

    def _absent(self, segment: Segment, scope: FieldScope, entries: Entries) -> None:
        """Add the entries for the case that the condition of a segment is false."""
        if isinstance(segment, Field) and segment.default is not None:
            entries["default"] = self._value(self._default(segment), scope)
            return
        wanted = self._left_out((segment,))
        nowhere = self._nowhere(segment)
        entries["without"] = self._texts(wanted) if wanted else entries.get("without")
        entries["nowhere"] = self._texts(nowhere) if nowhere else entries.get("nowhere")

    @staticmethod
    def _default(field: Field) -> Expression:
        """Return the default of a field, with a name from `values` replaced by its number."""
        assert field.default is not None
        root = field.default.root
        for value, name in (field.values or {}).items():
            if isinstance(root, Text) and root.value == name:
                return Expression(name, _number(root, value))
        return field.default

    def _left_out(self, segments: Iterable[Segment]) -> list[str]:
        names = {name for one in flat(segments) for name in one.value_names}
        return sorted(names & self.diagnosis.asked_by_name)

    def _nowhere(self, segment: Segment) -> list[str]:
        asked = self.diagnosis.asked_for
        return sorted({one.path for one in standing_any_way((segment,)) if one.path in asked})

    # ---- texts --------------------------------------------------------------------------------------------

    def _key(self, segment: Segment) -> str:
        """Return the key of a segment in the careful functions: its name, or its kind if no name is needed."""
        name = segment.name or ""
        if name and (not name.startswith("_") or segment.path in self.diagnosis.asked_for):
            return name
        return type(segment).__name__.lower()

    @staticmethod
    def _path(segment: Segment, key: str) -> str | None:
        """Return the path that distinguishes a segment from those of other records; None if the key is enough."""
        return string(segment.sibling_path(key)) if segment.holder else None

    def _shown(self, segment: Segment) -> str:
        return shown(self._key(segment))

    @staticmethod
    def _texts(names: Iterable[str]) -> str:
        return listed(string(name) for name in names)

    def _needs(self, segment: Segment, *needed: str | Expression) -> str:
        """Return the paths of the segments that must be read before names and expressions of a segment are valid."""
        return self._texts(sorted(paths_read(segment, self.diagnosis.all_paths, *needed)))

    def _value(self, expression: Expression, scope: FieldScope) -> str:
        return self.expressions.function(expression, scope)

    def _size(self, size: int | Expression | None, scope: FieldScope, times: int = 1, parts: int = 1) -> str:
        if isinstance(size, int):
            return str(size * times // parts)
        assert size is not None
        text = self.expressions.text(size.root, scope)
        text = f"X.mul({text}, {times})" if times != 1 else f"X.div({text}, {parts})" if parts != 1 else text
        return f"function(n) return {text} end"

    def _shows(self, segment: Segment, name: str, use: FieldUse) -> str:
        return str(self.fields.use(self.frame, name, use, segment.doc))

    def _may_hold(self, segment: Segment) -> str | None:
        """Return whether the first byte of a following constant may be part of the segment's content."""
        return flag(bytes_of([segment], self.static.frames))

    # ---- types --------------------------------------------------------------------------------------------

    def type(self, type_: FieldType, at: Any) -> str:
        form = None
        if type_.form is not None:
            one = type_.form
            form = table(
                {
                    "decimals": None if one.decimals is None else str(one.decimals), "sign": string(one.sign),
                    "digits": str(one.digits), "fill": string(one.fill), "exponent": str(one.exponent),
                    "empty": flag(one.empty), "point": flag(one.point),
                }
            )  # fmt: skip
        scale: Entries = {}
        if type_.scale is not None:
            one_ = type_.scale
            scale = {"factor": number(one_.factor, at), "offset": number(one_.offset, at), "places": str(one_.places)}
        return table(
            {
                "kind": string(type_.kind), "size": str(type_.size) if isinstance(type_.size, int) else None,
                "order": string(type_.order), "signed": flag(type_.signed),
                "base": str(type_.base) if type_.kind == "digits" else None, "upper": flag(type_.upper),
                "pad": None if type_.pad is None else string(type_.pad),
                "stop": None if type_.end is None or type_.kind != "ascii" else string(type_.end), "form": form,
                "fixed": flag(type_.size is not None),
                "inside": None if type_.inside is None else self.type(type_.inside, at), **scale,
            }
        )  # fmt: skip

    def _numbered(self, segment: Field | Length | Count) -> Entries:
        """Return the conversion from the encoded number to the value, and its limits."""
        plus = segment.plus if isinstance(segment, Field) else 0
        unit = segment.unit if isinstance(segment, Field) else None
        at, limits = segment.at, segment.limits
        return {
            "plus": number(plus, at) if plus else None,
            "unit": number(unit, at) if unit is not None and unit != 1 else None,
            "zero_means": None if segment.zero_means is None else number(segment.zero_means, at),
            "limits": None if limits is None else listed(_limit(one) for one in limits),
        }


def _number(at: Node, value: int) -> Node:
    return Number(at.at, value)


def _limit(value: int) -> str:
    """Return a limit as a Lua number; a limit that is not exact is too large to matter."""
    return str(value) if abs(value) < 1 << 53 else f"{float(value)!r}"


# ---- the kinds ----------------------------------------------------------------------------------------------


def _const(w: SegmentWriter, s: Const, scope: FieldScope) -> Entries:
    return {"kind": '"const"', "data": string(s.data), "f": w._shows(s, w._shown(s), FieldUse("bytes"))}


def _skip(w: SegmentWriter, s: Skip, scope: FieldScope) -> Entries:
    return {"kind": '"skip"', "size": str(s.size), "f": w._shows(s, w._shown(s), FieldUse("bytes"))}


def _fill(w: SegmentWriter, s: Fill, scope: FieldScope) -> Entries:
    tail = w.static.all(w.frame.tail).least
    return {
        "kind": '"fill"', "total": str(s.total), "fixed_after": str(tail),
        "f": w._shows(s, w._shown(s), FieldUse("bytes")),
    }  # fmt: skip


def _field(w: SegmentWriter, s: Field, scope: FieldScope) -> Entries:
    type_ = s.type.before_end if s.type.is_delimited else s.type
    entries: Entries = {
        "kind": '"field"', "type": w.type(type_, s.at), **w._numbered(s),
        "f": w._shows(s, s.name, FieldUse.of_field(s)),
    }  # fmt: skip
    if s.long is not None:
        longer = w.type(s.long.type, s.at)
        entries["long"] = table({"mark": number(s.long.mark, s.at), "type": longer})
    elif s.type.is_delimited:
        stops = s.type.stops if s.type.end is None else (s.type.end,)
        entries["stops"] = listed(map(string, stops))
        entries["keeps_stop"] = flag(s.type.end is None)
    elif s.type.size is None:
        entries |= {"takes_rest": "true", "may_hold": w._may_hold(s)}
    else:
        entries["size"] = w._size(s.type.size, scope)
    if s.constants is not None:
        entries |= {"among": listed(constant(one, s.at) for one in s.constants), "among_cause": '"where"'}
    elif s.is_ is not None and (fixed := constant_of(s.is_)) is not None:
        entries["among"] = listed([number(fixed, s.at)])
    elif s.only and s.values is not None:
        entries["among"] = listed(number(one, s.at) for one in s.values)
    if s.is_ is not None and (s.constants is not None or constant_of(s.is_) is None):
        entries |= {"is": w._value(s.is_, scope), "needs": w._needs(s, s.is_)}
    return entries


def _counting(w: SegmentWriter, s: Length | Count, wanted: str | None, counted: Iterable[str]) -> Entries:
    entries: Entries = {
        "kind": '"number"', "type": w.type(s.type, s.at), **w._numbered(s), "size": w._size(s.type.size or 0, w.scope),
        "f": w._shows(s, s.name, FieldUse.of_number(s.type)),
    }  # fmt: skip
    if wanted is not None:
        entries |= {"is": f"function(n) return {wanted} end", "needs": w._needs(s, *counted)}
    return entries


def _length(w: SegmentWriter, s: Length, scope: FieldScope) -> Entries:
    found = counted_room(w.diagnosis, s)
    if found is None:
        return {**_counting(w, s, None, ()), "size": w._size(s.type.size or 0, scope)}
    rooms, converted = found
    parts = [f"X.room(n, {', '.join(map(string, rooms))})"] if rooms else []
    parts += [f"X.len(X.either(X.of(n, {string(name)}), X.list({{}})))" for name in converted]
    total = " + ".join(parts) or "0"
    if s.unit != 1:
        total = f"X.div({total}, {s.unit})"
    entries = _counting(w, s, f"{total} + {number(s.plus, s.at)}", s.of)
    return {**entries, "size": w._size(s.type.size or 0, scope)}


def _count(w: SegmentWriter, s: Count, scope: FieldScope) -> Entries:
    wanted = None
    if absent_behind(s, w.diagnosis) is not None:
        items = f"X.len(X.either(X.of(n, {string(s.of)}), X.list({{}})))"
        wanted = f"{items} + {number(s.plus, s.at)}"
    return {**_counting(w, s, wanted, (s.of,)), "size": w._size(s.type.size or 0, scope)}


def _bits(w: SegmentWriter, s: Bits, scope: FieldScope) -> Entries:
    parts = []
    for part in s.parts:
        width = part.high - part.low + 1
        entries: Entries = {
            "key": string(part.name), "path": w._path(s, part.name), "shown": string(part.name),
            "low": str(part.low), "bits": str(width),
            "f": w._shows(s, part.name, FieldUse.of_bits(part)),
        }  # fmt: skip
        if part.constants is not None:
            entries |= {"among": listed(number(one, part.at) for one in part.constants), "among_cause": '"where"'}
        elif part.is_ is not None and (fixed := constant_of(part.is_)) is not None:
            entries |= {"among": listed([number(fixed, part.at)]), "among_cause": '"value"'}
        elif part.is_ is not None:
            entries |= {"is": w._value(part.is_, scope), "needs": w._needs(s, part.is_)}
        parts.append(table(entries))
    return {
        "kind": '"bits"', "type": w.type(s.type, s.at), "size": w._size(s.type.size or 0, scope),
        "parts": listed(parts),
    }  # fmt: skip


def _data(w: SegmentWriter, s: Data, scope: FieldScope) -> Entries:
    entries: Entries = {
        "kind": '"data"', "f": w._shows(s, s.name, FieldUse("bytes")), "swap": str(s.swap) if s.swap else None,
        "convert": None if s.convert is None else string(s.convert), "least": str(s.least) if s.least else None,
        "never": string(s.never) if s.never else None,
    }  # fmt: skip
    if s.size == "rest":
        return {**entries, "takes_rest": "true", "may_hold": w._may_hold(s)}
    times, parts = {"hex_to_ascii": (2, 1), "ascii_to_hex": (1, 2), None: (1, 1)}[s.convert]
    return {**entries, "size": w._size(s.size, scope, times, parts)}


def _value(w: SegmentWriter, s: Value, scope: FieldScope) -> Entries:
    use = FieldUse.of_expression(s.read.root, w.diagnosis.by_name)
    return {"kind": '"value"', "read": w._value(s.read, scope), "f": w._shows(s, s.name, use)}


def _require(w: SegmentWriter, s: Require, scope: FieldScope) -> Entries:
    return {
        "kind": '"require"', "key": '"require"', "shown": '"require"', "text": string(s.condition.text),
        "condition": w._value(s.condition, scope),
    }  # fmt: skip


def _check(w: SegmentWriter, s: Check, scope: FieldScope) -> Entries:
    entries: Entries = {
        "kind": '"check"', "size": str(s.size), "form": string(s.form), "order": string(s.order),
        "verify": string(s.verify), "digits": flag(s.form in ("hex", "HEX")),
        "late": flag(covers_later(s, w.diagnosis.segments)), "f": w._shows(s, w._shown(s), FieldUse("bytes")),
    }  # fmt: skip
    if s.verify == "off":
        return entries
    try:
        problems = len(w.expressions.problems)
        entries |= {
            "method": w.checks.method(s.method, s.at),
            "covered": f"function(n) return {_covered(w, s, scope)} end",
        }
        if len(w.expressions.problems) > problems:
            problem = w.expressions.problems.pop()
            raise not_said(problem.at, problem.what)
    except CannotSayError as error:
        w.unverified.append(error.problem._replace(todo="it is shown, and not verified"))
        entries |= {"unverified": string(error.problem.what), "covered": None, "method": None}
    return entries


def _covered(w: SegmentWriter, check: Check, scope: FieldScope) -> str:
    """Return the source of the bytes that a check covers."""
    segments = w.diagnosis.segments
    if check.covers is None:
        return "X.before(n)"
    parts = covered_parts(check, segments)
    if check.span is not None and check.span[1] == "here" and parts[0] and in_one_buffer(check, segments):
        return f"X.from(n, {string(covered_paths(check, segments)[0])})"
    texts: list[str] = []
    for part in parts:
        if isinstance(part, Added):
            type_ = "nil" if part.type is None else w.type(part.type, part.at)
            texts.append(f"F.added({type_}, {w.expressions.text(part.value.root, scope)})")
        elif part:
            texts.append(f"X.bytes_of(n, {', '.join(map(string, part))})")
    return " .. ".join(texts) or '""'


def _record(w: SegmentWriter, s: Record, scope: FieldScope) -> Entries:
    return {"kind": '"record"', "of": w.listed(s.of, inside_of(scope, s.name))}


def _list(w: SegmentWriter, s: Repeat, scope: FieldScope) -> Entries:
    times = s.times
    entries: Entries = {
        "kind": '"list"', "align": str(s.align), "between": flag(s.between), "is_until": flag(s.until is not None),
        "times": w._size(times, scope) if isinstance(times, (int, Expression)) else None,
        "is_fixed": flag(isinstance(times, int)), "may_hold": w._may_hold(s),
    }  # fmt: skip
    if isinstance(s.of, FieldType):
        use = FieldUse.of_number(s.of)
        return {
            **entries, "kind": '"values"', "type": w.type(s.of, s.at), "item_size": str(s.of.fixed_size),
            "f": w._shows(s, s.name, use),
        }  # fmt: skip
    single = string(PLAIN) if s.single else None
    return {**entries, "of": w.listed(s.of, inside_of(scope, s.name)), "single": single}


def _item_end(w: SegmentWriter, s: ItemEnd, scope: FieldScope) -> Entries:
    return {"kind": '"item_end"', "until_": None if s.until is None else w._value(s.until, scope)}


def _choose(w: SegmentWriter, s: Choose, scope: FieldScope) -> Entries:
    known = w.diagnosis.by_path
    field = known.get(nearest_path(str(s.on).strip(), s, known))
    names = field.values if isinstance(field, Field) and field.values is not None else {}
    numbers: dict[object, Any] = {name: value for value, name in names.items()}
    on = w._value(s.on, scope)
    cases = []
    for keys, segments in s.cases:
        w.diagnosis.declare(segments, scope)  # another case may have a record or list of the same name
        values = (numbers.get(key, key) if isinstance(key, str) else key for key in keys)
        cases.append(table({"keys": listed(constant(one, s.at) for one in values), "of": w.listed(segments, scope)}))
    w.diagnosis.declare(s.otherwise or (), scope)
    without, nowhere = w._left_out((s,)), w._nowhere(s)
    return {
        "kind": '"choose"', "on": on, "cases": listed(cases),
        "otherwise": None if s.otherwise is None else w.listed(s.otherwise, scope),
        "without": w._texts(without) if without else None, "nowhere": w._texts(nowhere) if nowhere else None,
    }  # fmt: skip


def _optional(w: SegmentWriter, s: Optional, scope: FieldScope) -> Entries:
    without, nowhere = w._left_out(s.of), w._nowhere(s)
    return {
        "kind": '"optional"', "of": w.listed(s.of, scope), "may_hold": w._may_hold(s),
        "without": w._texts(without) if without else None, "nowhere": w._texts(nowhere) if nowhere else None,
    }  # fmt: skip


def _wrap(w: SegmentWriter, s: Wrap, scope: FieldScope) -> Entries:
    fixed = w.static.all(s.of).fixed
    size = s.size
    if size is None and fixed is not None and s.escape is None:
        size = s.coding.sizes(exactly(fixed)).fixed
    return {
        "kind": '"wrap"', "coding": _coding(w, s, fixed), "checks": flag(checks_option(s.of)),
        "may_hold": w._may_hold(s),
        "size": None if size is None else w._size(size, scope), "least": str(s.least) if s.least else None,
        "most": None if s.most is None else w._size(s.most, scope) if isinstance(s.most, Expression) else str(s.most),
        "plain_size": None if fixed is None or s.escape is None else str(fixed), **w.region(s.of, scope),
    }  # fmt: skip


def _coding(w: SegmentWriter, s: Wrap, fixed: int | None) -> str:
    coding = s.coding
    match coding:
        case Hex():
            return table({"kind": '"hex"'})
        case Plain():
            return table({"kind": '"none"'})
        case Cobs():
            return table({"kind": '"cobs"'})
        case Doubled(escape=escape):
            embedded = listed(map(string, w.diagnosis.module.embedded_frames(s)))
            return table({"kind": '"doubled"', "escape": str(escape), "embedded": embedded})
        case Escaped(escape=escape, codes=codes, flip=flip):
            plain = "{ " + ", ".join(f"[{code}] = {byte}" for byte, code in codes) + " }"
            never = string(bytes(sorted(coding.never)))
            turned = None if flip is None else str(flip)
            return table({"kind": '"escaped"', "escape": str(escape), "plain": plain, "flip": turned, "never": never})
        case Inserted(after=after, insert=insert):
            return table({"kind": '"inserted"', "after": string(after), "insert": string(insert)})
        case Blocks(size=size, check_code=check):
            try:
                entries: Entries = {
                    "method": w.checks.method(check.method, check.at), "size": str(check.size),
                    "form": string(check.form), "order": string(check.order),
                    "digits": flag(check.form in ("hex", "HEX")),
                }  # fmt: skip
                return table({"kind": '"blocks"', "size": str(size), "check": table(entries)})
            except CannotSayError as error:
                return _no_coding(w, error)
        case Short(fill=fill, least=least):
            size_ = {"size": str(fixed), "least": str(least)}
            return table({"kind": '"short"', "fill": string(bytes((fill,))), **size_})
        case Ciphered():
            return _no_coding(w, not_said(s.at, "the content is enciphered"))
    return _no_coding(w, not_said(s.at, f"the coding {coding.shown}"))


def _no_coding(w: SegmentWriter, error: CannotSayError) -> str:
    w.expressions.problems.append(error.problem)
    return table({"kind": '"cannot"', "why": string(error.problem.what)})


def _inner(w: SegmentWriter, s: Inner, scope: FieldScope) -> Entries:
    fixed = w.static.present(s).fixed
    size: int | Expression | None = s.size if s.size != "rest" else None
    size = fixed if size is None and fixed is not None else size
    return {
        "kind": '"inner"', "frames": w._texts(in_order(w.static, s.frames)), "takes_rest": flag(s.size == "rest"),
        "size": None if size is None else w._size(size, scope), "may_hold": w._may_hold(s),
        "f": w._shows(s, s.name, FieldUse("string")),
    }  # fmt: skip


def _nested(w: SegmentWriter, s: Nested, scope: FieldScope) -> Entries:
    return {"kind": '"nested"', "frame": string(s.frame)}


_KINDS: Mapping[type[Segment], Callable[[SegmentWriter, Any, FieldScope], Entries]] = {
    Const: _const, Skip: _skip, Fill: _fill, Field: _field, Length: _length, Count: _count, Bits: _bits, Data: _data,
    Value: _value, Require: _require, Check: _check, Record: _record, Repeat: _list, ItemEnd: _item_end,
    Choose: _choose, Optional: _optional, Wrap: _wrap, Inner: _inner, Nested: _nested,
}  # fmt: skip
_NOT_REFUSED = (Skip, Wrap, Inner, Nested, Record)
"""Kinds whose own faults are never answered with a refusal code."""

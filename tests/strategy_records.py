"""Draw values of records, segment by segment: the internals of `strategies`."""

from __future__ import annotations

from typing import Any

from construct_oracle import ConstructCodec, FrameConstruct
from construct_oracle.filling import Circular, Filling, Plan
from construct_oracle.names import Names
from hypothesis import strategies as st
from strategy_hints import Hints, hints_of, same_attributes
from strategy_values import Draw, Values, built, flat, floats, fractions, span_of

from framekit.codec import support
from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName, start_values
from framekit.codec.samples import item_of
from framekit.definition.expression import Expression, Name, Node, names_in
from framekit.definition.model import segments as model
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import FieldType, Segment

TRIES = 12
UNKNOWN: Any = object()


class Maker(Values):
    """One attempt to draw values: record by record, each from its segments in order."""

    def __init__(
        self, draw: Draw, protocol: Protocol, codec: ConstructCodec, context: dict[str, Any], small: bool
    ) -> None:
        super().__init__(draw, small)
        self.protocol = protocol
        self.codec = codec
        self.names = Names(context, start_values(protocol))

    def frame(self, name: str) -> dict[str, Any] | None:
        """Draw values of a frame; None if this attempt has failed."""
        frame = self.protocol.frames[name]
        construct = self.codec.frames[name]
        assert isinstance(construct, FrameConstruct)
        before, self.forbidden = self.forbidden, construct.end_mark if frame.delimited else b""
        try:
            return _Record(self, construct.plan, frame.segments, None).made()
        finally:
            self.forbidden = before


class _Record:
    """Values of a record that is being drawn; `plan` allows evaluating expressions on the values so far."""

    def __init__(self, maker: Maker, plan: Plan, segments: tuple[Segment, ...], outer: Filling | None) -> None:
        self.maker = maker
        self.draw = maker.draw
        self.plan = plan
        self.outer = outer
        self.given: dict[str, Any] = {}
        self.words: dict[str, Any] = {}
        self.all = flat(segments)
        self.segments = segments
        self.inputs = {name for segment in self.all for part in built(segment) for name in names_in(part.root)}

        self.failed = False

    def made(self) -> dict[str, Any] | None:
        """Return the values, or None if no consistent values were found."""
        self._make_all(self._in_order(self.segments))
        return None if self.failed or not self._holds() else self.given

    def _in_order(self, segments: tuple[Segment, ...]) -> list[Segment]:
        """Return the segments, sometimes with an optional field moved to the front.

        The value given first decides which other optional fields are present.
        """
        fields = [item for item in segments if isinstance(item, model.Field) and item.when and item.default]
        if fields and self.draw(st.booleans()):
            first = self.draw(st.sampled_from(fields))
            return [first, *(item for item in segments if item is not first)]
        return list(segments)

    def _make_all(self, segments: list[Segment]) -> None:
        for segment in segments:
            if self.failed:
                return
            if segment.when is not None and self.evaluate(segment.when.root) in (False, 0):
                continue
            match segment:
                case model.Choose():
                    self._make_case(segment)
                case model.Optional():
                    if self.draw(st.booleans()):
                        self._make_all(list(segment.of))
                case model.Wrap():
                    self._make_all(list(segment.of))
                case model.Bits():
                    for part in segment.parts:
                        self._offer(part.name, self._bits(part))
                case _:
                    if segment.name in self.plan.values:
                        self._offer(segment.name, self._value(segment))

    def _make_case(self, choose: model.Choose) -> None:
        value = self.evaluate(choose.on.root)
        chosen = next((of for keys, of in choose.cases if value in keys), choose.otherwise)
        if value is UNKNOWN or chosen is None:
            self.failed = True
        else:
            self._make_all(list(chosen))

    def _offer(self, name: str, value: Any) -> None:
        """Store a value, unless its field is absent or it would make another given field absent."""
        if value is UNKNOWN:
            return
        if value is None:
            self.failed = True
            return
        self.given[name] = value
        filling = self.filling()
        try:
            if not all(filling.is_there(other) for other in self.given):
                del self.given[name]
        except (MissingName, Circular, *EVALUATION_ERRORS):
            pass  # it depends on values that are not drawn yet

    # ---- expressions --------------------------------------------------------------------------------------

    def filling(self) -> Filling:
        found = Filling(self.plan, self.given, self.maker.names, self.outer)
        found.words = self.words
        return found

    def evaluate(self, node: Node) -> Any:
        """Return the value of an expression for the values given so far, or UNKNOWN if it cannot be evaluated yet."""
        try:
            return self.filling().evaluate(Expression("", node))
        except (MissingName, Circular, *EVALUATION_ERRORS):
            return UNKNOWN

    def _strictly(self, node: Node) -> Any:
        return self.filling().evaluate(Expression("", node))

    def hints(self, name: str) -> Hints:
        found = hints_of(self.all, self._hint_value).get(name, Hints())
        for segment in self.all:
            if isinstance(segment, model.Choose) and isinstance(segment.on.root, Name) and segment.on.root.name == name:
                keys = [key for keys, _ in segment.cases for key in keys]
                if segment.otherwise is None:
                    found.add("in", keys)
                elif self.draw(st.booleans()):
                    found.add("in", self.draw(st.sampled_from([list(keys) for keys, _ in segment.cases])))
        return found

    def _hint_value(self, node: Node) -> Any:
        try:
            return self._strictly(node)
        except Circular:
            raise KeyError("not known yet") from None

    def _holds(self) -> bool:
        for segment in self.all:
            if not isinstance(segment, model.Require) or (segment.when and not self.evaluate(segment.when.root)):
                continue
            if self.evaluate(segment.condition.root) in (False, 0, UNKNOWN):
                return False
        return True

    # ---- values -------------------------------------------------------------------------------------------

    def _value(self, segment: Segment) -> Any:
        """Draw a value for a segment; UNKNOWN if it needs no value, None if no value is possible."""
        match segment:
            case model.Field():
                return self._field(segment)
            case model.Data():
                return self._data(segment)
            case model.Repeat():
                return self._repeat(segment)
            case model.Record():
                fields = self.plan.values[segment.name][0].construct.fields  # type: ignore[attr-defined]
                return _Record(self.maker, fields.plan, segment.of, self.filling()).made()
            case model.Nested():
                return self.maker.frame(segment.frame)
            case model.Inner():
                frame = self.draw(st.sampled_from(segment.frames))
                values = self.maker.frame(frame)
                return None if values is None else {frame: values}
            case model.Value() if segment.name in self.inputs and segment.build is None:
                return self.maker.number(0, 31)
        return UNKNOWN

    def _bits(self, part: model.BitsPart) -> Any:
        if part.is_ is not None or part.build is not None:
            return UNKNOWN
        if part.constants is not None:
            return self.draw(st.sampled_from(part.constants)) if self.draw(st.booleans()) else UNKNOWN
        return self.draw(st.integers(0, (1 << part.high - part.low + 1) - 1))

    def _field(self, field: model.Field) -> Any:
        if field.is_ is not None:
            return UNKNOWN
        if field.constants is not None:
            return self.draw(st.sampled_from(field.constants)) if self.draw(st.booleans()) else UNKNOWN
        if field.build is not None and self.evaluate(field.build.root) is not UNKNOWN:
            return UNKNOWN
        if field.build is not None and set(names_in(field.build.root)) & set(self.plan.values) - {field.name}:
            return UNKNOWN
        if field.default is not None and self.draw(st.booleans()):
            return UNKNOWN
        hints = self.hints(field.name)
        match field.type.kind:
            case "ascii":
                least, most = self._text_sizes(field)
                return self.maker.text(least, most, hints, field.type)
            case "bytes":
                size = self._size(field.type.size, field.name)
                return None if size is None else self.maker.bytes(size)
            case "float" | "hex_float":
                return self.draw(floats(field.type))
            case "scaled":
                least, most = span_of(field.type.inside, self._size(field.type.size, field.name) or None)
                return support.scaled(self.maker.number(least, most), *field.type.scale.arguments)
            case "fraction":
                return self.draw(fractions(field.type))
        return self._number(field, hints)

    def _number(self, field: model.Field, hints: Hints) -> Any:
        if field.values and (field.only or self.draw(st.booleans())):
            choice = [number for number in field.values if number not in hints.denied]
            if hints.allowed is not None:
                choice = [number for number in choice if number in hints.allowed]
            number = self.draw(st.sampled_from(choice)) if choice else None
            return number if number is None or self.draw(st.booleans()) else field.values[number]
        if hints.allowed is not None:
            return self.draw(st.sampled_from(hints.allowed)) if hints.allowed else None
        size = self._size(field.type.size, field.name)
        if size is None:
            return None
        least, most = span_of(field.type, size) if field.long is None else span_of(field.long.type, None)
        unit = field.unit or 1
        least, most = least - field.plus, most - field.plus
        if field.zero_means is not None:
            least, most = max(least, 1), field.zero_means
        if field.limits is not None:
            least, most = max(least, -(-field.limits[0] // unit)), min(most, field.limits[1] // unit)
        least = max(least, least if hints.least is None else hints.least)
        most = min(most, most if hints.most is None else hints.most)
        if least > most:
            return None
        number = self.maker.number(least, most)
        return None if number in hints.denied else number * unit

    def _text_sizes(self, field: model.Field) -> tuple[int, int]:
        if field.type.size is None:
            return 0, 8
        size = self.evaluate(field.type.size.root) if isinstance(field.type.size, Expression) else field.type.size
        if isinstance(size, int):
            return (0 if field.type.pad is not None else size), size
        return self._free_sizes(field.name, 0)

    def _free_sizes(self, name: str, least: int) -> tuple[int, int]:
        """Return the shortest and longest size of a segment whose length is computed from it."""
        most = least + 12
        for segment in self.all:
            if not isinstance(segment, model.Length) or name not in segment.of:
                continue
            if segment.zero_means is not None:
                least = max(least, segment.unit - segment.plus)
            if segment.limits is not None:
                least = max(least, segment.limits[0] * segment.unit - segment.plus - 8 * (len(segment.of) - 1))
                most = min(max(most, least), segment.limits[1] * segment.unit - segment.plus)
        return max(least, 0), max(most, 0)

    def _size(self, size: int | Expression | None, name: str) -> int | None:
        if isinstance(size, Expression):
            found = self.evaluate(size.root)
            return found if isinstance(found, int) and 0 <= found <= 4096 else None
        return size or 0

    def _data(self, data: model.Data) -> Any:
        size: Any = data.size
        if isinstance(size, Expression):
            size = self._wanted_length(size) if isinstance(size.root, Name) else self.evaluate(size.root)
        if isinstance(size, int):
            if data.pad is not None and self.draw(st.booleans()):
                size = self.draw(st.integers(0, size))
            return self._content(data, size) if 0 <= size <= 4096 else None
        lengths = [part for part in self.all if isinstance(part, model.Length) and data.name in part.of]
        unit = max((part.unit for part in lengths), default=1)
        if data.convert == "ascii_to_hex":
            unit = max(unit, 2)
        least, most = self._free_sizes(data.name, data.least)
        found = self._content(data, self.draw(st.integers(-(-least // unit), most // unit)) * unit)
        return self._suiting(data, found)

    def _content(self, data: model.Data, size: int) -> bytes:
        if data.convert == "ascii_to_hex":
            return bytes(self.draw(st.text("0123456789ABCDEF", min_size=size, max_size=size)).encode())
        if data.never:
            allowed = [byte for byte in range(256) if byte not in data.never]
            return bytes(self.draw(st.lists(st.sampled_from(allowed), min_size=size, max_size=size)))
        return self.maker.bytes(size)

    def _suiting(self, data: model.Data, found: bytes) -> Any:
        """Return bytes of the computed size, if their size depends on the bytes themselves."""
        for _ in range(TRIES if isinstance(data.size, Expression) else 0):
            self.given[data.name] = found
            wanted = self.evaluate(data.size.root) if isinstance(data.size, Expression) else UNKNOWN
            del self.given[data.name]
            if not isinstance(wanted, int) or wanted == len(found):
                return found
            found = self._content(data, max(wanted, 0))
        return found

    def _wanted_length(self, size: Expression) -> Any:
        """Return the size that a computed length must have because a condition compares it with a known value."""
        assert isinstance(size.root, Name)
        computed = {segment.name for segment in self.all if isinstance(segment, model.Length)}
        if size.root.name not in computed:
            return self.evaluate(size.root)
        allowed = self.hints(size.root.name).allowed
        return allowed[0] if allowed else UNKNOWN

    def _repeat(self, repeat: model.Repeat) -> Any:
        times = self._times(repeat)
        if times is None:
            return None
        if isinstance(repeat.of, FieldType):
            if repeat.of.kind == "fraction":
                return [self.draw(fractions(repeat.of)) for _ in range(times)]
            if repeat.of.kind in ("float", "hex_float"):
                return [self.draw(floats(repeat.of)) for _ in range(times)]
            least, most = span_of(repeat.of.inside or repeat.of, None)
            numbers = [self.maker.number(least, most) for _ in range(times)]
            scale = repeat.of.scale
            return numbers if scale is None else [support.scaled(number, *scale.arguments) for number in numbers]
        fields = self.plan.values[repeat.name][0].construct.fields  # type: ignore[attr-defined]
        items: list[dict[str, Any]] = []
        alike = same_attributes(self.all).get(repeat.name, [])
        previous: Filling | None = None
        for place in range(times):
            words = {model.INDEX: place, model.LAST: place == times - 1, model.PREVIOUS: previous}
            of = item_of(repeat, words[model.LAST])
            item = self._item(of, fields.plan, items[0] if items else None, alike, words)
            if item is None:
                return None
            items.append(item)
            previous = Filling(fields.plan, item, self.maker.names, self.filling())
            previous.words = words
        return [item[model.PLAIN] for item in items] if repeat.single else items

    def _times(self, repeat: model.Repeat) -> int | None:
        if isinstance(repeat.times, int):
            return repeat.times
        found = self.evaluate(repeat.times.root) if isinstance(repeat.times, Expression) else UNKNOWN
        if isinstance(found, int) and not self._counts(repeat):
            return found if 0 <= found <= 64 else None
        least, most = 0 if repeat.until is None else 1, 4
        for segment in self.all:
            if isinstance(segment, model.Count) and segment.of == repeat.name and segment.limits is not None:
                least, most = max(least, segment.limits[0]), min(max(most, segment.limits[0]), segment.limits[1])
        return int(self.draw(st.integers(least, most)))

    def _counts(self, repeat: model.Repeat) -> bool:
        return any(isinstance(segment, model.Count) and segment.of == repeat.name for segment in self.all)

    def _item(
        self,
        of: tuple[Segment, ...],
        plan: Plan,
        first: dict[str, Any] | None,
        alike: list[str],
        words: dict[str, Any],
    ) -> Any:
        """Return an item; if possible, an item that agrees with the first in the names `alike`."""
        for _ in range(TRIES):
            record = _Record(self.maker, plan, of, self.filling())
            record.words = words
            item = record.made()
            if item is not None and (first is None or self._agree(plan, first, item, alike)):
                return item
        return None if first is None else dict(first)

    def _agree(self, plan: Plan, first: dict[str, Any], item: dict[str, Any], alike: list[str]) -> bool:
        one, other = (Filling(plan, given, self.maker.names, self.filling()) for given in (first, item))
        return all(one[name] == other[name] for name in alike)

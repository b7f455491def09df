"""Facts about every frame that are known before any byte comes: codec, beginning, inner frames, echo, announcements.

Made once for a codec, which is known only by the contract below.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from typing import Any, Protocol, TypeVar, TypeVarTuple, Unpack

from framekit.codec.errors import FrameError, Misread
from framekit.codec.python.choices import fixed_bytes
from framekit.codec.python.source import quoted
from framekit.codec.shown import shown
from framekit.definition.expression import Name, names_in, ordered_by_need
from framekit.definition.kinds.base import all_fixed
from framekit.definition.model import procedure
from framekit.definition.model import protocol as model
from framekit.definition.model.frames import WIRE, Frame, StaticSizes, by_value_name, certain, everything, parts_of
from framekit.definition.model.segments import (
    Bits,
    BitsPart,
    Check,
    Const,
    Count,
    Data,
    Field,
    Inner,
    Length,
    Segment,
    Wrap,
)
from framekit.link.quick_look import (
    NO_SIZES,
    NOT_QUICK,
    Counted,
    counted_of,
    intact_of,
    quick_of,
    restricted_bytes,
    sizes_by_byte,
)
from framekit.link.scope import Scope
from framekit.link.values import (
    EVALUATION_ERRORS,
    Evaluate,
    FrameValue,
    Names,
    compile_expression,
    compile_optional,
    plain,
)


class FrameCodec(Protocol):
    """One frame's compiled functions, as the codec contract has them."""

    @property
    def encode(self) -> Callable[..., bytes]: ...
    @property
    def decode(self) -> Callable[..., dict[str, Any]]: ...
    @property
    def measure(self) -> Callable[..., int]: ...
    @property
    def extent(self) -> Callable[..., int] | None: ...
    @property
    def diagnose(self) -> Callable[..., Any]: ...


Make = Callable[[dict[str, Any], bytes | None, int | None], FrameValue]
"""Makes a value of decoded fields, bytes and refusal, with values of the frames inside."""

Shape = tuple[tuple[str, str, Any], ...]
"""The places of frames inside a frame's fields: (`inner`, name, None), (`record` or `list`, name, its shape)."""


Announcements = tuple[tuple[str, Evaluate | None, Evaluate], ...]
"""The values of later frames that a frame announces: a variable, the key of a table, the value."""


def announce(announces: Announcements, value: FrameValue, scope: Scope) -> None:
    """Set the variables that a frame announces, in order. Raise EVALUATION_ERRORS."""
    names = Names({**value.complete(), WIRE: value.raw}, scope)
    for variable, key, evaluate in announces:
        if key is None:
            scope.set(variable, evaluate(names))
        else:
            scope.set_entry(variable, key(names), evaluate(names))


NO_VALUES: Mapping[str, Any] = {}
EchoTest = Callable[..., bool]
"""Compares the fields that a reply repeats, and calls the tests of the frames inside."""


def _never(*_: Any) -> bool:
    raise KeyError


SINGLE = (Field, Data, Length, Count, Check, Const, Bits, Inner)
"""Segments that hold no lists."""


@lru_cache(1024)
def _test_of(condition: str) -> Callable[..., bool]:
    """Return a function that tests a condition on a reply's `fields`, the pending request and the sent frame.

    Its last argument has the tests of the frames inside, by their names.
    """
    test: Callable[..., bool] = eval(f"lambda fields, asked, sent, known: {condition}", {"__builtins__": {}})
    return test


def _mark_inner(
    inner: FrameValue, name: str, own: FrameInfo | None, outer: FrameInfo, data: bytes, names: Context
) -> None:
    """Note for a frame in a field of an outer frame that it has become bytes; no reference leads to the outer value."""
    inner.rest = outer, data, names, name, own.usual_in(inner, names) if own and own.usual else NO_VALUES


class FrameInfo:
    """Facts about a frame. `first`: the byte it begins with, if that is certain. `known`: fields that are constants.

    `extent`: as `measure` if the frame is good; if `guesses`, only for known frames inside. `has_lists`: it may hold
    lists or records. `inner`: the field with the only frame inside. `intact`: a quick test of its check code, if it has
    one; a frame that fails is bad, never refused. The table of all frames sets `make`.
    `carries`: frames that may be put into this frame when `insert` holds. `value_names`: its fields. `sizes`: the
    extents by a byte. `quick`: how a good frame is decoded quickly. `usual`: fields that replies repeat, and
    the names that give them where the frame does not. `optional`: fields that need not be given, and their defaults;
    `may_lack`: their names. `fixed_bytes`: bytes that it always has, with their offsets; `restricted`: those of them
    that measuring does not read, up to where its tail may move; `is_fixed`: it has always the same size;
    `is_checked`: it always has a check code.
    """

    __slots__ = (
        "_diagnose", "announces", "carries", "computed", "count", "counted", "decode", "echo", "echo_fields",
        "echoes", "encode", "extent", "first", "fixed_bytes", "flat", "frame", "guesses", "has_lists", "inner",
        "inners", "insert", "intact", "is_checked", "is_fixed", "known", "make", "may_lack", "measure", "most", "name",
        "numbers", "on_line", "optional", "quick", "refuse", "restricted", "rests", "shape", "sizes", "usual",
        "value_names",
    )  # fmt: skip

    def __init__(self, frame: Frame, codec: FrameCodec) -> None:
        self.frame = frame
        self.name = frame.name
        self.make: Make
        self.sizes = NO_SIZES
        self.quick = NOT_QUICK
        self.counted: Counted | None = None
        self.encode, self.decode, self.measure = codec.encode, codec.decode, codec.measure
        self.first = first_byte(frame.segments)
        self.fixed_bytes = tuple(fixed_bytes(frame.segments))
        self.restricted = tuple(restricted_bytes(frame, self.fixed_bytes))
        self.is_fixed = frame.size is None and all_fixed(frame.segments) is not None
        self.is_checked = any(
            isinstance(one, Check) and there and one.when is None and one.verify == "error"
            for one, there in certain(frame.segments)
        )
        self.shape = shape_of(frame.segments)
        self.flat = not self.shape
        self.has_lists = any(not isinstance(segment, SINGLE) for segment in frame.segments)
        self.inners = tuple(name for kind, name, _ in self.shape if kind == "inner")
        self.inner = self.shape[0][1] if len(self.shape) == 1 and self.shape[0][0] == "inner" else None
        self.guesses = codec.extent is not None and self.inner is not None
        self.extent = codec.extent if self.guesses and codec.extent is not None else codec.measure
        self.refuse = frame.refuse
        self.intact = intact_of(frame)
        self._diagnose = codec.diagnose
        self.most = frame.most
        self.known: dict[str, Any] = {}
        self.computed: list[tuple[str, Evaluate, frozenset[str]]] = []
        """The expressions of `is:`, and the fields of the frame that they read: their names have no other meaning."""
        self.numbers: dict[str, dict[str, int]] = {}
        self.on_line = True
        self.carries: tuple[str, ...] = ()
        self.insert: Evaluate | None = None
        self.value_names = frozenset(by_value_name(frame.segments))
        self.count = len(self.value_names)
        self._collect(frame.segments)
        self.echo = tuple((name, _plain_name(item), compile_expression(item)) for name, item in frame.echo.items())
        self.echo_fields = frozenset(name for name, *_ in self.echo)
        self.echoes = bool(self.echo or self.inners)
        """Building it, or a frame inside, may repeat fields of a request."""
        self.announces = tuple(
            (one.name, compile_optional(one.key), compile_expression(one.value)) for one in frame.announces
        )
        self.optional = optional_of(frame)
        self.may_lack = frozenset(self.optional)
        self.rests = _rests(frame, self.optional)
        self.usual: dict[str, str] = {}

    def usual_in(self, value: FrameValue, names: Context) -> Mapping[str, Any]:
        """Return the fields of `usual` that are not given in a value, with their values."""
        return {name: names[given] for name, given in self.usual.items() if name not in value.fields}

    def unset(self, names: Names, fields: Mapping[str, Any], name: str) -> Any:
        """Return the value of an optional field that was not given. Raise EVALUATION_ERRORS."""
        evaluate = self.optional[name]
        for other in self.rests.get(name, ()):
            if other not in fields:
                fields = {**fields, other: self.unset(names, fields, other)}
        value = None if evaluate is None else evaluate(Names(fields, names))
        return self.numbers.get(name, {}).get(value, value) if type(value) is str else value

    def fits(self, buffer: bytes | bytearray, start: int, size: int) -> int:
        """Return how many of `size` bytes from `start` on come before a byte that the frame never has at its place."""
        for place, allowed in self.fixed_bytes:
            if place < size and buffer[start + place] not in allowed:
                return place
        return size

    def read_back(self, data: bytes, names: Context, inside: str | None) -> dict[str, Any]:
        """Decode the fields of a sent frame, or of the frame in the field `inside`."""
        try:
            fields = self.make(self.decode(data, names), data, None).fields
        except EVALUATION_ERRORS:
            return {}
        if inside is None:
            return fields
        inner = fields.get(inside)
        return inner.fields if type(inner) is FrameValue else {}

    def misread(self, raw: bytes, names: Mapping[str, Any]) -> FrameError:
        """Return what `decode` raises for a frame that is not `intact`."""
        return Misread(self.name, self._diagnose, raw, names)

    def _collect(self, segments: tuple[Segment, ...], certain: bool = True) -> None:
        for segment in segments:
            there = certain and segment.when is None
            if isinstance(segment, Field):
                self._field(segment, segment.values, there)
            elif isinstance(segment, Bits):
                for part in segment.parts:
                    self._field(part, part.values, there)
            elif isinstance(segment, Wrap):
                self._collect(segment.of, there)
                if segment.inside and segment.insert is not None:
                    self.carries, self.insert = segment.inside, compile_expression(segment.insert)
            elif segment.has_cases and segment.chooses_by is None:
                self._collect(segment.usual_block, False)

    def _field(self, field: Field | BitsPart, values: Mapping[int, str] | None, there: bool) -> None:
        """Record the names of numbers, the constant and `is` of a field.

        They are unknown for a field that may be absent, because the builder decides its presence. One of several
        constants is unknown for a field that repeats the request, because the request decides it.
        """
        name, constants, is_ = field.name, field.constants, field.is_
        if values:
            self.numbers[name] = {text: number for number, text in values.items()}
        if not there:
            return
        if constants and (len(constants) == 1 or name not in self.frame.echo):
            self.known[name] = constants[0]
        elif is_ is not None:
            own = self.value_names.intersection(names_in(is_.root))
            self.computed.append((name, compile_expression(is_), own))


def _plain_name(expression: Any) -> str | None:
    return expression.root.name if isinstance(expression.root, Name) else None


def first_byte(segments: tuple[Segment, ...]) -> int | None:
    """Return the byte every frame of these segments begins with, when that is a constant."""
    first = segments[0] if segments else None
    if isinstance(first, Const) and first.when is None and first.data:
        return first.data[0]
    return None


def shape_of(segments: tuple[Segment, ...]) -> Shape:
    """Return where inner frames stand in the fields of these segments."""
    found: list[tuple[str, str, Any]] = []
    for segment in segments:
        if isinstance(segment, Inner):
            found.append(("inner", segment.name, None))
        for block in segment.blocks:
            found.extend(shape_of(block))
        below = shape_of(segment.inner_record or ())
        if below:
            found.append(("record" if segment.is_record else "list", segment.name or "", below))
    return tuple(found)


Context = Mapping[str, Any]
Made = TypeVar("Made")
Of = TypeVarTuple("Of")

MOST_KEPT = 4096
"""So much of what receivers ask for is kept; which frames are expected together depends on what happens."""


class ProtocolCodec(Protocol):
    """A compiled protocol. `QUIET` and `LOST` are the special results of `measure`; both below every other result."""

    @property
    def frames(self) -> Mapping[str, FrameCodec]: ...
    @property
    def fused(self) -> Mapping[str, tuple[int, Sequence[Callable[..., dict[str, Any]] | None]]]: ...
    @property
    def layouts(self) -> Mapping[str, tuple[Callable[..., bytes], Callable[..., dict[str, Any]]]]: ...
    @property
    def QUIET(self) -> int: ...  # noqa: N802 - a constant of the generated module
    @property
    def LOST(self) -> int: ...  # noqa: N802


def made_once(protocol: model.Protocol, codec: ProtocolCodec, kind: type[Made], make: Callable[[], Made]) -> Made:
    """Return what `make` makes of a protocol, made once for all who use this codec of it."""
    kept: dict[Any, tuple[model.Protocol, Made]] = getattr(codec, "kept", {})
    found = kept.get(kind)
    if found is None or found[0] is not protocol:
        found = kept[kind] = protocol, make()
    return found[1]


def table_of(protocol: model.Protocol, codec: ProtocolCodec) -> FrameTable:
    """Return the table of all frames of a protocol, made once for a codec."""
    return made_once(protocol, codec, FrameTable, lambda: FrameTable(protocol, codec))


class FrameTable:
    """All frames of a protocol; `on_line` are those looked for on the line, frames that exist to be refused last.

    A frame that stands in others (`inner`), or that steps decode and no row takes, never is.
    """

    def __init__(self, protocol: model.Protocol, codec: ProtocolCodec) -> None:
        self.codec = codec
        self._kept: dict[tuple[Any, ...], Any] = {}
        self._echoes: dict[tuple[str | None, str | None], dict[str, EchoTest]] = {}
        self.infos = {name: FrameInfo(frame, codec.frames[name]) for name, frame in protocol.frames.items()}
        sequences = tuple(protocol.sequences.values())
        taken = {name for row in parts_of(sequences, procedure.Row) for name in row.frames}
        decoded = {name for part in parts_of(sequences, procedure.Decode) for name in part.frames}
        inner = protocol.carried | (decoded - taken)
        shapes = StaticSizes(protocol.frames)
        repeated = {plain_name for info in self.infos.values() for _, plain_name, _ in info.echo}
        for info in self.infos.values():
            info.usual = usual_of(info.frame, repeated)
            info.make = self._maker(info)
            info.counted = counted_of(info.frame, shapes)
            if info.guesses and not info.frame.inside:
                info.sizes = sizes_by_byte(info.frame, shapes)
            if not info.frame.inside:  # else a frame inside may be at any offset
                info.quick = quick_of(
                    info.frame, info.decode if info.flat else None, info.sizes, shapes, codec.fused.get(info.name)
                )
            info.on_line = not info.frame.inner and info.name not in inner
        outer = [info for info in self.infos.values() if info.on_line and info.frame.side != "none"]
        self.on_line = tuple(info.name for info in sorted(outer, key=lambda info: info.refuse is not None))

    def once(self, make: Callable[[Unpack[Of]], Made], *of: *Of) -> Made:
        """Return `make(*of)`, made once for all receivers."""
        found: Made | None = self._kept.get((make, *of))
        if found is None:
            if len(self._kept) >= MOST_KEPT:
                self._kept.clear()
            found = self._kept[make, *of] = make(*of)
        return found

    def received(self, name: str, fields: dict[str, Any], raw: bytes | None, refusal: int | None) -> FrameValue:
        """Return the frame value of decoded fields; a refusal holds for the frame and for the frames inside."""
        info = self.infos.get(name)
        return FrameValue(name, fields, raw, refusal) if info is None else info.make(fields, raw, refusal)

    def _maker(self, info: FrameInfo) -> Make:
        """Return the function that creates values of a frame and of frames inside it.

        If a frame inside must be refused, so must the outer frame.
        """
        frame_name, refuse, shape, infos, convert = info.name, info.refuse, info.shape, self.infos, self._convert
        declared, one = info.value_names, info.inner or ""  # the field with the only inner frame

        def make_one(fields: dict[str, Any], raw: bytes | None, refusal: int | None) -> FrameValue:
            if refusal is not None:
                return make(fields, raw, refusal)
            value = FrameValue(frame_name, fields, raw, refuse, declared)
            found = fields.get(one)
            if type(found) is dict and len(found) == 1:
                ((frame, content),) = found.items()
                inner = infos.get(frame)
                if inner is None:
                    fields[one] = FrameValue(frame, content, None, refuse)
                elif inner.flat and refuse is None:
                    value.refusal = own = inner.refuse
                    fields[one] = FrameValue(frame, content, None, own, inner.value_names)
                elif inner.flat:
                    fields[one] = FrameValue(frame, content, None, refuse)
                else:
                    fields[one] = made = inner.make(content, None, refuse)
                    value.refusal = made.refusal
            return value

        def make_flat(fields: dict[str, Any], raw: bytes | None, refusal: int | None) -> FrameValue:
            if refusal is not None:
                return FrameValue(frame_name, fields, raw, refusal)
            return FrameValue(frame_name, fields, raw, refuse, declared)

        def make(fields: dict[str, Any], raw: bytes | None, refusal: int | None) -> FrameValue:
            value = FrameValue(frame_name, fields, raw, refuse if refusal is None else refusal)
            if refusal is None:  # a frame to be refused may be decoded in part only
                value.declared = declared
            for kind, name, below in shape:
                found = fields.get(name)
                if kind != "inner":
                    convert(below, value, found)
                elif type(found) is dict and len(found) == 1:
                    ((frame, content),) = found.items()
                    inner = infos.get(frame)
                    if inner is None:
                        fields[name] = FrameValue(frame, content, None, value.refusal)
                    else:
                        fields[name] = made = inner.make(content, None, value.refusal)
                        value.refusal = made.refusal
            return value

        return make_flat if not shape else make_one if one else make

    def _convert(self, shape: Shape, outer: FrameValue, found: Any) -> None:
        """Replace frames in a record, or in a list of records, by frame values."""
        for record in found if type(found) is list else (found,):
            for kind, name, below in shape if type(record) is dict else ():
                part = record.get(name)
                if kind != "inner":
                    self._convert(below, outer, part)
                elif type(part) is dict and len(part) == 1:
                    ((frame, content),) = part.items()
                    record[name] = made = self.received(frame, content, None, outer.refusal)
                    outer.refusal = made.refusal

    def made(self, name: str, fields: dict[str, Any], names: Names) -> FrameValue:
        """Return a frame value from a constructor's fields: constants and `is` are known at once."""
        info = self.infos[name]
        found = self.completed(info, fields, names)
        if info.optional.keys() <= found.keys():
            return FrameValue(name, found)
        return FrameValue(name, found, None, None, info.may_lack, partial(info.unset, names))

    @staticmethod
    def completed(info: FrameInfo, fields: dict[str, Any], names: Names) -> dict[str, Any]:
        """Return the fields of a constructor with constants and `is`."""
        for field, numbers in info.numbers.items():
            given = fields.get(field)
            if type(given) is str:
                fields[field] = numbers.get(given, given)
        for field, constant in info.known.items():
            fields.setdefault(field, constant)
        for field, evaluate, own in info.computed:
            if field not in fields and own <= fields.keys():
                try:
                    fields[field] = evaluate(Names(fields, names))
                except EVALUATION_ERRORS:
                    continue
        return fields

    def encode(self, value: FrameValue, names: Context) -> bytes:
        """Encode a frame value; afterwards the value holds the bytes and every field as sent. Raise ValueError."""
        return self.build(self.infos[value.frame], value, names)

    def build(self, info: FrameInfo, value: FrameValue, names: Context) -> bytes:
        """Do as `encode` for a frame that is known."""
        fields, name, data = value.fields, info.inner, value.built
        if data is not None:
            pass
        elif info.flat:
            data = info.encode(fields, names)
        elif name is None or type(inner := fields.get(name)) is not FrameValue:
            data = info.encode(plain(fields), names)
            self._mark_inners(info, value, data, names)
        elif inner.built is not None:
            data = info.encode({**fields, name: {"unknown": {"data": inner.built}}}, names)
        elif inner.raw is not None:
            data = info.encode({**fields, name: plain(inner)}, names)
        else:
            below = self.infos.get(inner.frame)
            given = {inner.frame: inner.fields} if below is not None and below.flat else plain(inner)
            data = info.encode({**fields, name: given}, names)
            _mark_inner(inner, name, below, info, data, names)
        value.raw, value.rest = data, (info, data, names, None, NO_VALUES)
        if info.announces:
            value.complete()
        return data

    def mark_sent(self, value: FrameValue, data: bytes, names: Context) -> None:
        """Note that a value has become these bytes: from now on it holds them, and every field as sent."""
        info = self.infos[value.frame]
        value.raw, value.rest = data, (info, data, names, None, NO_VALUES)
        self._mark_inners(info, value, data, names)
        if info.announces:
            value.complete()

    def _mark_inners(self, info: FrameInfo, value: FrameValue, data: bytes, names: Context) -> None:
        """Note for the frames inside a value that they have become bytes with it."""
        for name in info.inners:
            inner = value.fields.get(name)
            if type(inner) is FrameValue and inner.raw is None:
                _mark_inner(inner, name, self.infos.get(inner.frame), info, data, names)

    def fill_echo(self, reply: FrameValue, *requests: FrameValue | None) -> None:
        """Fill the fields of a reply, and of frames inside, that repeat the first request that has them."""
        info = self.infos.get(reply.frame)
        if info is None or not info.echoes:
            return
        fields = reply.fields
        if not info.echo_fields <= fields.keys():
            for field, plain_name, evaluate in info.echo:
                for request in () if field in fields else requests:
                    if request is not None:
                        try:
                            fields[field] = echoed(plain_name, evaluate, request)
                            break
                        except EVALUATION_ERRORS:
                            continue
        for name in info.inners:
            inner = fields.get(name)
            if type(inner) is FrameValue and inner.raw is None:
                self.fill_echo(inner, *requests)

    def repeats(self, reply: FrameValue, asked: FrameValue | None, sent: FrameValue | None, names: Names) -> bool:
        """Return whether a reply, with the frames inside, repeats the pending request, else the frame that was sent.

        `names`: those that the reply's `echo` may read.
        """
        kinds = None if asked is None else asked.frame, None if sent is None else sent.frame
        known = self._echoes.get(kinds)
        if known is None:
            known = self._echoes[kinds] = {}
        try:
            return known[reply.frame](reply.fields, asked, sent, known)
        except (KeyError, AttributeError):  # a field is absent, an expression has to be evaluated, or a frame is new
            self._learn(reply, known, kinds)
            return self._repeats(reply, tuple(one for one in (asked, sent) if one is not None), names)

    def difference(self, reply: FrameValue, requests: Sequence[FrameValue]) -> str:
        """Return the first field that a reply repeats with another value than the request: `station is 8, not 7`."""
        info = self.infos.get(reply.frame)
        for field, plain_name, _ in () if info is None else info.echo:
            for request in requests:
                if plain_name is None or plain_name not in self.infos[request.frame].value_names:
                    continue
                with suppress(*EVALUATION_ERRORS):
                    found, wanted = reply.fields[field], request.field(plain_name)
                    if found != wanted:
                        return f"{field} is {shown(found)}, not {shown(wanted)}"
                break
        for name in () if info is None else info.inners:
            inner = reply.fields.get(name)
            if type(inner) is FrameValue and (found := self.difference(inner, requests)):
                return found
        return ""

    def _learn(self, reply: FrameValue, known: dict[str, EchoTest], kinds: tuple[str | None, str | None]) -> None:
        """Make the tests that a reply and the frames inside lack; if they lack none, the tests with computed fields."""
        frames = list(self._with_inners(reply))
        missing = [name for name in frames if name not in known]
        for name in missing or frames:
            known[name] = self._echo_test(name, *kinds, has_computed=not missing)

    def _with_inners(self, reply: FrameValue) -> Iterator[str]:
        """Yield the names of the kinds of a frame and of the frames inside it."""
        yield reply.frame
        info = self.infos.get(reply.frame)
        for name in () if info is None else info.inners:
            inner = reply.fields.get(name)
            if type(inner) is FrameValue:
                yield from self._with_inners(inner)

    def _echo_test(self, reply: str, asked: str | None, sent: str | None, *, has_computed: bool = False) -> EchoTest:
        """Return the test of a reply to such frames; it raises KeyError where `_repeats` has to decide.

        `has_computed`: some of the fields are not given but computed when the frames are built.
        """
        info = self.infos.get(reply)
        if info is None:
            return _never
        tests: list[str] = []
        found = "{}.field({})" if has_computed else "{}.fields[{}]"
        for field, plain_name, _ in info.echo:
            if plain_name is None:
                return _never
            for word, request in (("asked", asked), ("sent", sent)):
                if request is not None and plain_name in self.infos[request].value_names:
                    tests.append(f"fields[{quoted(field)}] == {found.format(word, quoted(plain_name))}")
                    break
        for name in info.inners:
            inner = f"fields[{quoted(name)}]"
            tests.append(f"known[{inner}.frame]({inner}.fields, asked, sent, known)")
        return _test_of(" and ".join(tests) or "True")

    def _repeats(self, reply: FrameValue, requests: tuple[FrameValue, ...], names: Names) -> bool:
        """Return whether a reply, with the frames inside, repeats the fields of the first request that has them."""
        infos, fields = self.infos, reply.fields
        info = infos.get(reply.frame)
        if info is None:
            return True
        for field, plain_name, evaluate in info.echo:
            if field not in fields:
                continue
            for request in requests:
                if plain_name is not None and plain_name not in infos[request.frame].value_names:
                    continue
                try:
                    wanted = echoed(plain_name, evaluate, request, None if plain_name is not None else names)
                except EVALUATION_ERRORS:
                    continue
                if fields[field] != wanted:
                    return False
                break
        inside = (fields.get(name) for name in info.inners)
        return all(self._repeats(inner, requests, names) for inner in inside if type(inner) is FrameValue)


def echoed(plain_name: str | None, evaluate: Evaluate, request: FrameValue, names: Names | None = None) -> Any:
    """Return the value that a reply repeats of a request. Raise KeyError if the request has no such field."""
    if plain_name is not None:
        return request.field(plain_name)
    return evaluate(Names({**request.complete(), "request": request}, names))


def _rests(frame: Frame, optional: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Return the optional fields whose defaults depend on other optional fields, with these; cycles are left out."""
    fields = (one for one in everything(frame.segments) if isinstance(one, Field) and one.name in optional)
    defaults = {one.name: one.default for one in fields if one.default is not None}
    named = {name: names_in(defaults[name].root) & set(optional) - {name} for name in ordered_by_need(defaults)}
    return {name: tuple(sorted(others)) for name, others in named.items() if others}


def optional_of(frame: Frame) -> dict[str, Evaluate | None]:
    """Return the fields that need not be given and that are not computed, with their defaults; None: no default.

    A field that repeats a field of the request is known when it has been repeated.
    """
    found: dict[str, Evaluate | None] = {}
    for segment, there in certain(frame.segments):
        if isinstance(segment, Field):
            others = (segment.is_, segment.build, segment.constants)
            if all(one is None for one in others) and segment.name not in frame.echo:
                default = segment.default
                if default is not None or segment.when is not None or not there:
                    found[segment.name] = None if default is None else compile_expression(default)
        elif isinstance(segment, Bits):
            left = [part for part in segment.parts if part.is_ is None and part.build is None and not part.constants]
            zero = (lambda _: 0) if segment.when is None and there else None
            found.update((part.name, zero) for part in left if part.name not in frame.echo)
        elif segment.when is not None or not there:
            found.update((name, None) for name in segment.wanted_names if name not in frame.echo)
    return found


def usual_of(frame: Frame, wanted: Collection[str | None]) -> dict[str, str]:
    """Return the fields among `wanted` that are always present and take a whole number from a name; field → name."""
    found: dict[str, str] = {}
    for field in frame.segments:
        if isinstance(field, Field) and field.name in wanted and field.type.is_whole_number:
            given = field.build or field.default
            others = field.when, field.is_, field.values, field.constants, field.unit, field.zero_means
            if given is not None and isinstance(given.root, Name) and all(one is None for one in others):
                found[field.name] = given.root.name
    inside = by_value_name(frame.segments)
    return {name: given for name, given in found.items() if given == name or given not in inside}

"""Frames: sizes and lengths that agree, numbers that fit their types, variable parts whose end can be found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

from framekit.definition.codings import Hex
from framekit.definition.expression import Expression, Logic, Name, names_in, walk
from framekit.definition.kinds.data import REQUEST
from framekit.definition.model.frames import (
    WIRE,
    Frame,
    PartlyRead,
    StaticSizes,
    all_fixed,
    by_value_name,
    bytes_of,
    certain,
    everything,
    expressions_of,
    field_names,
    fixed_size,
    flat,
    in_place_of_records,
    least_size,
    leaves,
    nearest_path,
    parts_of,
)
from framekit.definition.model.procedure import Decode
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import (
    LAST,
    MOST_BYTES,
    Check,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Nested,
    Repeat,
    Segment,
    Segments,
    Sizes,
    Skip,
    Wrap,
    either,
)
from framekit.definition.problems import Position, Problem, did_you_mean, plural
from framekit.definition.wire_types import shown_stops


def check_frame(protocol: Protocol, frame: Frame, ends: FrameEnds) -> list[Problem]:
    """Return all problems of one frame by itself; `ends`: the open ends of the protocol's frames."""
    found = list(_level(protocol, frame.segments))
    found += _order_of_sizes(frame.segments, set())
    for repeat in parts_of(frame.segments, Repeat):
        found += () if repeat.is_counted else _last_too_soon(repeat.members)
    found += _LeftForOthers(protocol).check(frame)
    found += _lengths_of_numbers(frame)
    found += _lengths_that_never_fit(protocol, frame)
    found += ends.check(frame)
    found += _spans(frame)
    found += _early_ends(frame, ends)
    if frame.delimited:
        found += _delimited(protocol, frame)
    found += _whole_size(frame, ends)
    found += _items_without_end(frame)
    found += _hidden_options(frame)
    found += _sizes_of_absent_numbers(frame)
    found += _counted_and_open(protocol, frame, ends)
    found += _keys(protocol, frame, ends)
    found += _shown_as(frame)
    found += _inner(protocol, frame, ends)
    if frame.inside:
        found += check_interrupting(
            protocol, frame, not frame.delimited and frame.size is None and ends.is_open(frame.segments)
        )
    return found


def check_partly_read(frame: PartlyRead) -> Iterator[Problem]:
    """Yield the problems of the good segments of a frame with errors, each by itself."""
    twice: dict[str, Problem] = {}
    _values(frame.segments, twice)
    yield from twice.values()
    yield from _order_of_sizes(frame.segments, set())
    for segment in everything(frame.segments):
        if segment.at not in frame.holders:
            yield from segment.check()


def _keys(protocol: Protocol, frame: Frame, ends: FrameEnds) -> Iterator[Problem]:
    """Report keys of a frame that require another key, or a definition elsewhere."""
    if not frame.segments and not frame.inner:
        yield Problem(frame.at, f"'{frame.name}' has no bytes", "add segments to body, or a group with a head")
    if frame.delimited and frame.size is not None:
        what = f"'{frame.name}' has a size, and ends where its tail begins"
        yield Problem(frame.at, what, "leave size or delimited out")
    if frame.surplus is not None and not frame.delimited:
        yield Problem(frame.at, f"surplus of '{frame.name}' has no meaning", "add delimited: yes, or leave it out")
    for one in frame.announces:
        name, expression = one.name, one.value
        variable = protocol.state.get(name)
        if variable is not None and (one.key is None) != (variable.keys is None):
            fault = f"'{name}' is a table" if one.key is None else f"'{name}' is no table"
            yield Problem(expression.at, fault, f"write {name}[key]" if one.key is None else f"write {name}")
        if variable is None:
            hint = did_you_mean(name, protocol.state) or f"add {name}: to state"
            yield Problem(expression.at, f"there is no variable '{name}' to announce", hint)
        elif frame.name not in ends.decoded and (frame.inner or frame.side == "none" or frame.name in ends.carried):
            what = f"'{frame.name}' stands inside other frames, so it announces nothing"
            yield Problem(expression.at, what, "let the frame around it announce, from its inner field")
        for part in (expression,) if one.key is None else (expression, one.key):
            yield from _two_of_wire(protocol, frame, part)


def _shown_as(frame: Frame) -> Iterator[Problem]:
    """Report unknown values that `shows:` of bytes reads, and layouts with the name of a value of the frame."""
    known = by_value_name(frame.segments)
    for data in flat(frame.segments):
        if not isinstance(data, Data) or data.shows is None:
            continue
        for node in walk(data.shows.by):
            if isinstance(node, Name) and node.name not in known and node.name != REQUEST:
                what = f"'{frame.name}' has no value '{node.name}'"
                todo = did_you_mean(node.name, known) or "name a value with the number, or request"
                yield Problem(data.at, what, todo)
        for shown in data.shows.layouts.values():
            if shown.layout in known:
                what = f"'{shown.layout}' is a value of '{frame.name}' already"
                yield Problem(shown.at, what, "give the layout another name")


def _two_of_wire(protocol: Protocol, frame: Frame, said: Expression) -> Iterator[Problem]:
    """Report a second meaning of `wire` in the announcements of a frame, in which `wire` is the bytes of the whole
    frame.
    """
    if WIRE in names_in(said.root):
        holder = f"'{frame.name}' has a value" if WIRE in field_names(frame.segments) else ""
        for section in ("params", "state", "tables"):
            holder = holder or (f"{section} has a name" if WIRE in getattr(protocol, section) else "")
        if holder:
            what = f"'{WIRE}' is the bytes of the whole frame here, and {holder} '{WIRE}' too"
            yield Problem(said.at, what, "give that another name")


def _inner(protocol: Protocol, frame: Frame, ends: FrameEnds) -> Iterator[Problem]:
    """Report problems of inner frames: a frame must not contain itself, and must fit into its place."""
    for inner in parts_of(frame.segments, Inner):
        if frame.name in _within(protocol, (inner,)):
            what = f"'{frame.name}' may stand inside itself"
            yield Problem(inner.at, what, "leave it out of the group, or take data: for what is inside")
        frames = [protocol.frames[name] for name in inner.frames if name in protocol.frames]
        for one in frames if inner.size is None else ():
            if ends.sizes.frame(one.name).least == 0 and not ends.is_surely_open(one.segments):
                what = f"'{one.name}' may take no bytes, so nothing shows that it is there"
                yield Problem(inner.at, what, f"give '{inner.name}' a size, or the frame something that always is")
        sizes = [least_size(one.segments) for one in frames]
        if isinstance(inner.size, int) and sizes and min(sizes) > inner.size:
            what = f"every frame for '{inner.name}' has at least {plural(min(sizes), 'byte')}, its size is {inner.size}"
            yield Problem(inner.at, what, "correct size")
    for nested in _always_nested(frame.segments):
        what = f"'{nested.layout}' always stands in itself, so it never ends"
        yield Problem(nested.at, what, "put the include into a repeat, a choose or an optional")
    for nested in parts_of(frame.segments, Nested):
        if nested.frame in protocol.frames and ends.is_open(protocol.frames[nested.frame].segments):
            what = f"nothing shows where '{nested.layout}' ends that stands in itself"
            yield Problem(nested.at, what, "give all in it a size, or an end of its own")
    for repeat in parts_of(frame.segments, Repeat):
        for inner in parts_of(repeat.of, Inner):
            known = {_always(protocol.frames[name]) for name in inner.frames if name in protocol.frames}
            inside_itself = frame.name in _within(protocol, (inner,))  # reported already
            if inner.size is None and not inside_itself and known and (None in known or len(known) > 1):
                what = f"nothing shows where '{inner.name}' ends in an item of '{repeat.name}'"
                yield Problem(inner.at, what, "give it a size, such as that of a length before it")


def _always_nested(segments: Segments) -> Iterator[Nested]:
    """Yield the nested layouts that are present for every value, so that the layout would never end."""
    for segment, is_present in certain(segments):
        if not is_present or segment.when is not None:
            continue
        if isinstance(segment, Nested):
            yield segment
        elif not isinstance(segment, Repeat) or segment.until is not None or segment.times not in (0, "rest"):
            counted = isinstance(segment, Repeat) and isinstance(segment.times, Expression)
            yield from () if counted else _always_nested(segment.members)


def _always(frame: Frame) -> int | None:
    """Return the constant size of a frame (bytes); None if it depends on content."""
    return frame.size if frame.size is not None else all_fixed(frame.segments)


def _within(protocol: Protocol, segments: Segments) -> dict[str, None]:
    """Return the names of all frames that segments may contain, at any depth."""
    found: dict[str, None] = {}
    ahead = [segments]
    while ahead:
        names = {name for part in parts_of(ahead.pop(), Segment) for name in part.frames_inside}
        fresh = sorted((names & protocol.frames.keys()) - found.keys())
        found |= dict.fromkeys(fresh)
        ahead += [protocol.frames[name].segments for name in fresh]
    return found


def _spans(frame: Frame) -> Iterator[Problem]:
    """Report ranges `from..to` of checks that are not in the order of the frame, or of their record or item."""
    for check in parts_of(frame.segments, Check):
        yield from _covered_in_part(frame, check)
    for holder in (None, *parts_of(frame.segments, Segment)):
        segments = frame.segments if holder is None else holder.inner_record
        if segments:
            yield from _spans_in(segments)


def _spans_in(segments: Segments) -> Iterator[Problem]:
    order = [segment.name for segment in flat(segments)]
    for check in (one for one in flat(segments) if isinstance(one, Check)):
        if check.wire:
            yield from _in_wraps(segments, check)
        for first, last in (part for part in check.covers or () if isinstance(part, tuple)):
            if not {first, last} <= {*order, "here"}:
                continue
            end = check.name if last == "here" else last
            if end in order and order.index(first) > order.index(end):
                yield Problem(check.at, f"'{first}' stands behind '{last}'", f"write over: {last}..{first}")
            elif last != "here" and check.name in order[order.index(first) : order.index(last) + 1]:
                todo = "let its range end before it, or begin behind it"
                yield Problem(check.at, "a check code cannot cover itself", todo)


def _in_wraps(segments: Segments, check: Check) -> Iterator[Problem]:
    """Report checks with `wire` across the border of a wrap: content of a wrap is not on the wire by itself."""
    named = {*check.names, *check.edges}
    for wrap in (one for one in flat(segments) if one.is_there_inside):
        inside = [one for block in wrap.blocks for one in flat(block)]
        apart = sorted(named & {one.name for one in inside if one.name}) if check not in inside else []
        if apart:
            what = f"'{apart[0]}' stands in a wrap, so it is not on the wire as it is"
            yield Problem(check.at, what, "name the wrap, or leave wire out")
        elif check in inside and not named <= {one.name for one in inside}:
            what = "a check in a wrap covers what stands outside of it, and with wire its own code would be coded anew"
            yield Problem(check.at, what, "leave wire out, or put the check behind the wrap")
        elif check in inside:
            what = "a check in a wrap counts the content before it is coded, so wire has no effect"
            yield Problem(check.at, what, "leave wire out, or put the check behind the wrap")


def _early_ends(frame: Frame, ends: FrameEnds) -> Iterator[Problem]:
    """Report checks with `ends` that are not a direct part of the frame at a known place, after all bytes that they
    cover.
    """
    todo = "leave ends out"
    for check in (one for one in parts_of(frame.segments, Check) if one.ends):
        inside = list(in_place_of_records(frame.segments))
        place = next((place for place, one in enumerate(inside) if one is check), None)
        if place is None or check.when is not None:
            what = "a check code ends a frame only if it always stands in it, and in no wrap, list or case"
            yield Problem(check.at, what, f"put it there, or {todo}")
            continue
        if not any(one.takes_bytes for one in inside[place + 1 :]) and frame.size is None:
            yield Problem(check.at, "nothing stands behind this check code that it could spare", todo)
        open_part = next((one for one in inside[:place] if ends.reaches_on(one)), None)
        if open_part is not None:
            what = f"only what follows shows where {open_part.title} ends, and so where this check code stands"
            yield Problem(check.at, what, f"give {open_part.title} a size, or {todo}")
        elif frame.delimited and place >= sum(1 for _ in in_place_of_records(frame.head)):
            what = "only what follows shows where the body ends, and so where this check code stands"
            yield Problem(check.at, what, todo)
        if _covers_other_parts(frame, check, inside[:place]):
            what = "a check code that ends a frame covers what stands before it, and nothing in wraps or cases"
            yield Problem(check.at, what, f"name other segments in over, or {todo}")


def _covers_other_parts(frame: Frame, check: Check, before: Sequence[Segment]) -> bool:
    """Return whether a check covers parts that are not among the segments `before` it, or are in wraps or cases."""
    covered = _covered_leaves(frame, check)
    held = (one for one in before if one.blocks and not (check.wire and one.is_there_inside))
    apart = {id(leaf) for one in held for leaf in leaves((one,))}
    return bool(covered - {id(leaf) for leaf in leaves(before)} or covered & apart)


def _covered_in_part(frame: Frame, check: Check) -> Iterator[Problem]:
    """Report checks that cover only a part of a case or of a conditional part although they are outside of it."""
    named, edges = ({check.sibling_path(name) for name in names} for names in (check.names, check.edges))
    whole = _covered_leaves(frame, check)
    for holder in parts_of(frame.segments, Segment):
        part = all(id(leaf) in whole for leaf in leaves(holder.usual_block)) and bool(edges)
        in_part = holder.when is not None and not part
        parts = holder.blocks if holder.has_cases or in_part else ()
        blocks = [{one.path for one in flat(block) if one.name} for block in parts]
        here = next((paths for paths in blocks if check.path in paths), set())
        paths = {path for block in blocks for path in block & (named | edges)} - here
        if paths:
            what = "the range of a check ends in" if paths & edges else "a check covers what stands in"
            called = {"choose": "a case", "optional": "an optional part"}.get(holder.KEY, "a part under a condition")
            todo = f"name the {holder.KEY} part, or what stands beside it"
            shown = sorted(path.rpartition(".")[2] for path in paths)
            yield Problem(check.at, f"{what} {called}: '{', '.join(shown)}'", todo)


def _records(segments: Segments) -> Iterator[Segments]:
    """Yield the segments of the frame, then those of every record and list in it."""
    yield segments
    yield from (one.members for one in everything(segments) if one.inner_record is not None)


def _covered_leaves(frame: Frame, check: Check) -> set[int]:
    """Return the identities of the segments with bytes that a check covers, by name and by its ranges."""
    record = next((of for of in _records(frame.segments) if any(one is check for one in flat(of))), ())
    inside = list(flat(record))
    found = {id(leaf) for leaf in leaves(one for one in inside if one.name in check.names)}
    places = {one.name: place for place, one in enumerate(inside)}
    for part in (part for part in check.covers or () if isinstance(part, tuple)):
        first, last = (places.get(check.name if name == "here" else name, -1) for name in part)
        between = (one for one in inside[first:last] if not one.blocks)
        found |= {id(leaf) for leaf in leaves((*between, *inside[last : last + 1]))}
    return found


def _level(protocol: Protocol, segments: Segments) -> Iterator[Problem]:
    """Report problems of segments on one level, and of the levels inside."""
    twice: dict[str, Problem] = {}
    _values(segments, twice)
    yield from twice.values()
    for segment in flat(segments):
        yield from segment.check()
        if isinstance(segment, Data) and isinstance(segment.size, Expression):
            yield from _computed(segment, segments)
        if segment.is_record:
            yield from _read_in_itself(protocol, segment)
        yield from _level(protocol, segment.inner_record or ())


def _read_in_itself(protocol: Protocol, record: Segment) -> Iterator[Problem]:
    """Report expressions in a record that read the record itself: it is not complete yet."""
    if record.name in {name for one in everything(record.members) for name in one.value_names}:
        return
    for expression in expressions_of(record.members):
        if record.name in names_in(expression.root):
            what = f"'{record.name}' is read inside '{record.name}' itself"
            todo = f"write the name of a field alone, without '{record.name}'"
            if record.name in {*protocol.params, *protocol.state, *protocol.tables}:
                todo += ", or give the record another name if the one outside is meant"
            yield Problem(expression.at, what, todo)


def _values(segments: tuple[Segment, ...], problems: dict[str, Problem]) -> dict[str, Position]:
    """Return the places of the values of a list, by name; note duplicate names, which only the cases of one choice may
    have.
    """
    found: dict[str, Position] = {}
    for segment in segments:
        here = dict.fromkeys(segment.value_names, segment.at)
        for block in segment.blocks:
            here |= _values(block, problems)
        for name in here.keys() & found.keys():
            problems[name] = Problem(here[name], f"there are two fields '{name}'", "give one of them another name")
        found |= here
    return found


def _computed(data: Data, level: tuple[Segment, ...]) -> Iterator[Problem]:
    """Report sizes that are plain fields and not computed by a length, `build` or `is`."""
    assert isinstance(data.size, Expression)
    for segment in flat(level):
        if segment is data:
            return
        plain = (
            isinstance(segment, Field) and segment.is_ is None and segment.build is None and segment.constants is None
        )
        if plain and segment.name == data.size.text.strip():
            yield Problem(
                segment.at,
                f"'{segment.name}' is the size of '{data.name}', but nothing computes it",
                f"write {{length: {segment.name}, type: …, of: [{data.name}]}}",
                warning=True,
            )


def _order_of_sizes(
    segments: tuple[Segment, ...], before: set[str], outer: frozenset[str] = frozenset()
) -> Iterator[Problem]:
    """Report sizes, repetitions, conditions and values that read a segment after them; `outer`: names of the outer
    records.
    """
    known, names = set(before), field_names(segments) | outer
    values = {segment.name for segment in flat(segments) if segment.follows is not None}
    for segment in flat(segments):
        for what, expression in segment.needed():
            late = sorted((names_in(expression.root) & names) - known)
            for name in late:
                moved = f"what '{name}' reads" if name in values else f"'{name}'"
                fault, todo = f"the {what} uses '{name}', which is read only later", f"move {moved} before it"
                if name == segment.name:
                    fault, todo = f"the {what} of '{name}' cannot come from '{name}' itself", "give a size"
                yield Problem(expression.at, fault, todo)
        if segment.inner_record is not None:
            outside = known - field_names(segment.inner_record)
            yield from _order_of_sizes(segment.inner_record, outside, frozenset(names - {segment.name or ""}))
        known.update(segment.value_names)
        if segment.name:
            known.add(segment.name)


def _last_too_soon(segments: Segments) -> Iterator[Problem]:
    """Report uses of `last` before the end of an item in lists without a number of items."""
    for segment in flat(segments):
        late = {id(one) for _, one in segment.computed()}
        if isinstance(segment, Field) and segment.when is not None:
            late.discard(id(segment.default))
        for expression in expressions_of(segment.with_lists(lambda _: ())):
            if LAST in names_in(expression.root) and id(expression) not in late:
                what = f"only the end of an item shows whether it is the last one, and '{expression}' is read before"
                yield Problem(expression.at, what, "take last in is: or build: only, or give times a number")
        if segment.is_record:
            yield from _last_too_soon(segment.members)


class _LeftForOthers:
    """Checks that a part with several end bytes (`end: [2C, 2A]`) is followed by a part that begins with one of them.

    A part that is always present only needs to be able to begin so: its value is given. A part that comes first because
    another is absent must be a constant, because given values do not show that it counts.
    """

    def __init__(self, protocol: Protocol) -> None:
        self.sizes = StaticSizes(protocol.frames)

    def check(self, frame: Frame) -> Iterator[Problem]:
        yield from self._behind(self.sizes.segments(frame), ((),))

    def _behind(self, segments: Segments, after: tuple[Segments, ...]) -> Iterator[Problem]:
        """Report problems of these segments; `after`: the possible segments after them."""
        for place, segment in enumerate(segments):
            stops = () if segment.number_type is None else segment.number_type.stops
            if not (stops or segment.blocks or segment.inner_record):
                continue
            rest = tuple((*segments[place + 1 :], *one) for one in after)
            for block in segment.blocks:
                yield from self._behind(block, ((),) if segment.is_there_inside else rest)
            if segment.inner_record is not None:
                again = ((*segment.next_item, *rest[0]),) if isinstance(segment, Repeat) else ()
                yield from self._behind(segment.members, (*again, *rest))
            problem = next((found for one in rest if (found := self._first(one, stops))), None) if stops else None
            if problem is not None:
                what = f"{segment.title} ends before {shown_stops(stops)}, and {problem}"
                yield Problem(segment.at, what, "put {field: NAME, type: u8} or a constant behind it")

    def _first(
        self, segments: Segments, stops: tuple[bytes, ...], surely: bool = False, is_all: bool = True
    ) -> str | None:
        """Return the fault of the first byte of these segments, which must be one of `stops`; None if it is right.

        `surely`: it must be so for all values. `is_all`: no other segments follow.
        """
        absent = ""
        for segment in segments:
            if not segment.takes_bytes or self.sizes.present(segment).most == 0:
                continue
            problem = self._begins(segment, stops, surely)
            if problem is not None:
                return absent + problem
            if self.sizes.of(segment).least > 0:
                return None
            absent, surely = absent or f"{segment.title} may be absent or empty: ", True
        return f"{absent}nothing follows it" if is_all else None

    def _begins(self, segment: Segment, stops: tuple[bytes, ...], surely: bool) -> str | None:
        """Return the fault of the first byte of one segment, if it is present and has bytes; None if it is right."""
        blocks = (segment.members,) if segment.is_record else () if segment.is_there_inside else segment.blocks
        if blocks:
            found = (self._first(block, stops, surely, False) for block in blocks)
            return next((one for one in found if one), None)
        if isinstance(segment, Const | Skip):
            data = segment.data if isinstance(segment, Const) else segment.fill[:1]
            fits = any(data[: len(stop)] == stop[: len(data)] for stop in stops)
            return None if fits else f"what follows begins with {data[: max(map(len, stops))].hex(' ').upper()}"
        own = () if segment.number_type is None else segment.number_type.stops
        first = bytes_of((segment,), self.sizes.frames) - {stop[0] for stop in own if len(stop) == 1}
        if surely or not first & {stop[0] for stop in stops}:
            return f"{segment.title} {'need not begin' if surely else 'never begins'} with that"
        return None


def _lengths_of_numbers(frame: Frame) -> Iterator[Problem]:
    """Report lengths that are counted from a number whose size they define: neither is known first."""
    typed = {one.path: one.number_type for one in parts_of(frame.segments, Segment) if one.number_type is not None}
    for length in parts_of(frame.segments, Length):
        for name in length.of:
            type_ = typed.get(length.sibling_path(name))
            size = type_.size if type_ is not None and type_.is_whole_number else None
            if isinstance(size, Expression) and length.name in names_in(size.root):
                what = f"'{length.name}' counts the bytes of '{name}' and is their number: nothing says how many"
                todo = f"write {{field: {length.name}, …}}, which is given, or {{data: {name}, size: {length.name}}}"
                yield Problem(length.at, what, todo)


def _lengths_that_never_fit(protocol: Protocol, frame: Frame) -> Iterator[Problem]:
    """Report lengths whose number can represent none of the possible sizes of the counted parts."""
    static = StaticSizes(protocol.frames)
    lengths = [one for one in parts_of(frame.segments, Length) if not one.plain and one.zero_means is None]
    found: dict[str, list[Sizes]] = {}
    for one in everything(frame.segments) if lengths else ():
        found.setdefault(one.path, []).append(static.of(one))
    for length in lengths:
        bounds = length.type.bounds if length.type.is_whole_number else None
        if bounds is None or length.unit < 1 or not found.keys() >= set(length.counted):
            continue
        low, high = length.limits or bounds
        sizes = Sizes(0, 0)
        for path in length.counted:
            sizes += either(found[path])
        least = sizes.least // length.unit + length.plus
        most = None if sizes.most is None else sizes.most // length.unit + length.plus
        if least > high or (most is not None and most < low):
            is_ = f"always {least}" if least == most else f"at least {least}" if least > high else f"at most {most}"
            what = f"'{length.name}' of '{frame.name}' would be {is_}, and holds {low} to {high}"
            yield Problem(length.at, what, "use a wider type, or correct plus, range or the sizes")


class FrameEnds:
    """Open parts: parts whose end is shown only by the following bytes, or by silence."""

    def __init__(self, protocol: Protocol) -> None:
        self.frames = protocol.frames
        self.sizes = StaticSizes(protocol.frames)
        self._open: dict[str, bool] = {}
        sequences = tuple(protocol.sequences.values())
        self.decoded = frozenset(name for part in parts_of(sequences, Decode) for name in part.frames)
        """Frames that steps decode from bytes."""

    @cached_property
    def carried(self) -> frozenset[str]:
        """Return the names of the frames that are inner frames of others."""
        parts = (part for frame in self.frames.values() for part in parts_of(frame.segments, Segment))
        return frozenset(name for part in parts for name in part.frames_inside)

    def check(self, frame: Frame) -> Iterator[Problem]:
        """Report open parts without an end: the end of a region, a constant after them, or the end of the frame."""
        segments = frame.body if frame.delimited else frame.segments
        yield from self._escapes(segments, ())
        yield from self._region(segments)
        for wrap in parts_of(frame.segments, Wrap):
            yield from self._region(wrap.of)
            yield from self._size_of(wrap)
        for repeat in parts_of(frame.segments, Repeat):
            inner = next((one for one in repeat.members if isinstance(one, Inner) and one.size == "rest"), None)
            if inner is not None and self.is_open(repeat.members):
                what = f"nothing shows where {inner.title} ends in an item of '{repeat.name}'"
                yield Problem(inner.at, what, "give it a size, or put a constant behind it")

    def _size_of(self, wrap: Wrap) -> Iterator[Problem]:
        """Report sizes that no content can have on the wire; hex digits are two for each byte."""
        size, found = wrap.size, wrap.coding.sizes(self.sizes.all(wrap.of))
        if not isinstance(size, int):
            return
        if size < found.least or (found.most is not None and size > found.most):
            most = "" if found.most in (None, found.least) else f" to {found.most}"
            what = f"the content takes {found.least}{most} bytes on the wire, size says {size}"
            yield Problem(wrap.at, what, "correct size")
        elif isinstance(wrap.coding, Hex) and size % 2:
            yield Problem(wrap.at, f"{size} hex digits are no whole bytes", "give an even size")

    def _escapes(self, segments: Segments, behind: Segments) -> Iterator[Problem]:
        """Report wraps without an end, at any depth; a wrap in an item must end within the item."""
        segments = tuple(_in_records(segments))
        for place, segment in enumerate(segments):
            after = (*segments[place + 1 :], *behind)
            if isinstance(segment, Wrap):
                if segment.escape is not None and self.sizes.all(segment.of).fixed is None:
                    yield from _end_of_escape(segment, after)
                after = ()
            for block in segment.blocks:
                yield from self._escapes(block, after)
            if segment.is_list:
                yield from self._escapes(segment.members, (segment,))

    def _region(self, segments: Segments) -> Iterator[Problem]:
        """Report problems of the parts of one region."""
        open_part: Segment | None = None
        unread: set[str] = set()
        for segment in _in_records(segments):
            unread = set() if open_part is None else unread | {*open_part.value_names, *segment.value_names}
            hidden = segment.when is not None and bool(names_in(segment.when.root) & unread)
            if open_part is not None and isinstance(segment, Const) and _is_end_of(segment, open_part):
                open_part = None
            elif self.reaches_on(segment):
                if open_part is not None:
                    yield Problem(
                        segment.at,
                        f"two parts take the rest: nothing shows where {open_part.title} ends",
                        "give one a size, or put a constant between them",
                    )
                open_part = segment
            elif open_part is not None and (hidden or not self._can_be_counted(segment, open_part)):
                what = f"nothing shows where {open_part.title} ends and {segment.title} begins"
                todo = "give one of them a size, or put a constant between them"
                yield Problem(segment.at, what, "give it a size" if _ends_itself(open_part) else todo)

    def _can_be_counted(self, segment: Segment, part: Segment) -> bool:
        """Return whether the bytes of a segment after an open part can be counted from the end."""
        if isinstance(part, Wrap) or _ends_itself(part):
            return self.sizes.present(segment).fixed is not None
        return not segment.takes_bytes or _fixed(segment)

    def reaches_on(self, segment: Segment) -> bool:
        """Return whether only the following bytes, or silence, show the end of a segment."""
        match segment:
            case Wrap(coding=Hex(), size=None, of=of):
                return self.is_open(of)
            case Segment(chooses_by=Expression()):
                return any(map(self.is_open, segment.blocks))
            case Inner(size=None, frames=names):
                return any(self._is_open_inside(name) for name in names)
            case Inner(size=size):
                return size == "rest"
        return segment.takes_rest

    def _is_open_inside(self, name: str) -> bool:
        """Return whether an inner frame does not determine its own end.

        Each frame is examined once; recursion counts as closed.
        """
        frame = self.frames.get(name)
        if frame is None or frame.size is not None or frame.delimited:
            return False
        if name not in self._open:
            self._open[name] = False
            self._open[name] = self.is_open(frame.segments)
        return self._open[name]

    def is_open(self, segments: Segments) -> bool:
        """Return whether only the following bytes, or silence, show the end of these segments."""
        segments = tuple(_in_records(segments))
        for place, segment in enumerate(segments):
            if self.reaches_on(segment):
                following = segments[place + 1 :]
                ends = any(
                    isinstance(one, Const) and one.when is None and _is_end_of(one, segment) for one in following
                )
                return not ends or any(self.sizes.present(one).fixed is None for one in following)
        return False

    def is_surely_open(self, segments: Segments) -> bool:
        """Return whether the segments are open for all conditions and choices."""
        return self.is_open(segments) and any(
            segment.when is None and (not segment.blocks or segment.is_there_inside) and self.reaches_on(segment)
            for segment in _in_records(segments)
        )


def _ends_itself(part: Segment) -> bool:
    """Return whether a part is an inner frame whose end follows from its own segments."""
    return isinstance(part, Inner) and part.size is None


def _is_end_of(constant: Const, part: Segment) -> bool:
    """Return whether a constant marks the end of a part.

    It does not end an inner frame, nor digits if it may begin like a digit.
    """
    if isinstance(part, Wrap):
        return constant.when is None and constant.data[:1] in {bytes((byte,)) for byte in part.coding.never}
    return not _ends_itself(part)


def _end_of_escape(wrap: Wrap, behind: Segments) -> Iterator[Problem]:
    """Report a wrap with doubled escape byte that no constant with this byte ends."""
    follows = next((one for one in behind if one.takes_bytes), None)
    if follows is not None and not _begins_with(wrap.escape or 0, follows):
        what = f"nothing shows where {wrap.title} ends: no {wrap.escape or 0:02X} need follow it"
        yield Problem(wrap.at, what, "put a constant that begins with the escape byte behind it, without when")


def _begins_with(byte: int, segment: Segment) -> bool:
    """Return whether a segment is always present and begins with that byte."""
    if segment.chooses_by is not None and segment.when is None and segment.usual_block:
        return all(bool(block) and _begins_with(byte, block[0]) for block in segment.blocks)
    return isinstance(segment, Const) and segment.when is None and segment.data[:1] == bytes((byte,))


def _in_records(segments: Segments) -> Iterator[Segment]:
    """Yield the segments, with records replaced by their segments."""
    for segment in segments:
        yield from _in_records(segment.members) if segment.is_record else (segment,)


def _counted_and_open(protocol: Protocol, frame: Frame, ends: FrameEnds) -> Iterator[Problem]:
    """Report parts that an earlier length counts but only silence ends: the length is then only compared."""
    if frame.size is not None or protocol.kind == "application" or not ends.is_open(frame.segments):
        return
    if frame.name in ends.carried:
        return
    counted = {path: one for one in parts_of(frame.segments, Length) for path in one.counted}
    for segment in _in_records(frame.segments):
        length = counted.get(segment.path)
        if length is None or not segment.takes_rest or isinstance(segment, Wrap):
            continue
        what = f"the length '{length.name}' counts {segment.title}, but only silence ends it"
        is_exact = length.of == (segment.name,) and not length.plus and length.unit == 1
        size = length.name if is_exact else f"(what {length.name} leaves for it)"
        todo = f"write size: {size}"
        if isinstance(segment, Repeat):
            todo = f"put it into {{wrap: none, size: {size}, of: […]}}"
        yield Problem(segment.at, what, f"{todo}, so that the length ends it", warning=True)


def _items_without_end(frame: Frame) -> Iterator[Problem]:
    """Report parts of list items that reach as far as the bytes do."""
    for repeat in parts_of(frame.segments, Repeat):
        rest = next((one for one in repeat.inner_record or () if one.takes_rest), None)
        if rest is not None:
            what = f"nothing shows where {rest.title} ends in an item of '{repeat.name}'"
            yield Problem(rest.at, what, "give it a size, or a length or count in the item")


def _hidden_options(frame: Frame) -> Iterator[Problem]:
    """Report optional parts whose presence neither bytes nor given values show."""
    for optional in parts_of(frame.segments, Segment):
        if not optional.has_cases or optional.chooses_by is not None:
            continue
        if _may_be_nothing(optional.usual_block):
            what = "the optional part may be there and take no bytes: nothing shows that it is there"
            yield Problem(optional.at, what, "put something into it that always takes bytes")
        if not any(one.may_be_given for one in flat(optional.usual_block)):
            what = "the optional part is never there: no value of it is given"
            yield Problem(optional.at, what, "put a field into it, or take when: instead")


def _sizes_of_absent_numbers(frame: Frame) -> Iterator[Problem]:
    """Report sizes that use a length or count which may be absent."""
    absent = {
        one.path: one for kind in (Length, Count) for one in parts_of(frame.segments, kind) if one.when is not None
    }
    known = {path for one in everything(frame.segments) for path in map(one.sibling_path, one.value_names)}
    for user in parts_of(frame.segments, Segment):
        size = user.times if isinstance(user, Repeat) else user.size if isinstance(user, Data | Wrap) else None
        for name in sorted(names_in(size.root)) if isinstance(size, Expression) else ():
            number = absent.get(nearest_path(name, user, known))
            if number is not None and not _implies(user.when, number.when):
                what = f"the size of {user.title} is '{size}', and '{name}' may be absent"
                yield Problem(user.at, what, f"give both the same when: {number.when}")


def _may_be_nothing(segments: Segments) -> bool:
    """Return whether segments may have values but no bytes; sizes that depend on values are not considered."""
    if all_fixed(segments) == 0:
        return any(one.value_names for one in flat(segments))
    return all(
        segment.chooses_by is not None and any(_may_be_nothing(block) for block in segment.blocks)
        for segment in segments
    )


def _implies(when: Expression | None, wanted: Expression | None) -> bool:
    """Return whether condition `when` includes condition `wanted`."""
    if when is None or wanted is None:
        return wanted is None
    joined = isinstance(when.root, Logic) and when.root.operator == "and"
    return str(wanted) in [part.strip(" ()") for part in (str(when).split(" and ") if joined else [])] + [str(when)]


def _without_own_end(segments: tuple[Segment, ...]) -> Iterator[Segment]:
    """Yield the segments of a list, including those in records, cases and digits; a wrap with escape ends by itself."""
    for segment in segments:
        yield segment
        if segment.is_record:
            yield from _without_own_end(segment.members)
        if segment.chooses_by is not None or (isinstance(segment, Wrap) and not segment.ends_itself):
            for block in segment.blocks:
                yield from _without_own_end(block)


def _fixed(segment: Segment) -> bool:
    if fixed_size(segment) is not None:
        return True
    return segment.number_type is not None and segment.number_type.size is not None


def _delimited(protocol: Protocol, frame: Frame) -> Iterator[Problem]:
    """Report a delimited frame whose tail does not begin with an end constant, or whose body may contain its first
    byte.
    """
    first = frame.tail[0] if frame.tail else None
    if not isinstance(first, Const) or first.when is not None:
        at = first.at if first is not None else frame.at
        what = f"the tail of '{frame.name}' must begin with a constant that is always there"
        yield Problem(at, what, "delimited bodies end there")
        return
    end = first.data[0]
    inside = _within(protocol, frame.body)
    for segment in everything((*frame.body, *(one for name in inside for one in protocol.frames[name].segments))):
        if _may_hold(segment, end):
            verb = "holds" if isinstance(segment, Const) else "may hold"
            yield Problem(
                segment.at,
                f"{segment.title} {verb} {end:02X}, the byte that ends the body of '{frame.name}'",
                "leave delimited out, or send it as ASCII digits",
            )


def _may_hold(segment: Segment, byte: int) -> bool:
    """Return whether a segment itself may contain a byte. Text is checked when it is sent; fill bytes are allowed."""
    if isinstance(segment, Skip):
        return byte in (segment.fill * segment.size)[: segment.size]
    if isinstance(segment, Repeat) and isinstance(segment.of, FieldType):
        return segment.of.kind != "ascii" and byte in bytes_of((segment,))
    if isinstance(segment, Repeat):
        return segment.align > 1 and byte == segment.fill
    if segment.blocks or segment.inner_record is not None or segment.frames_inside or segment.whole_frame is not None:
        return isinstance(segment, Wrap) and byte in segment.coding.contents
    is_text = segment.number_type is not None and segment.number_type.kind == "ascii"
    return segment.takes_bytes and not is_text and byte in bytes_of((segment,))


def _items(segments: tuple[Segment, ...]) -> int:
    """Return the number of items of all lists of a frame, nested lists included; a list of computed length counts
    once.
    """
    found = 0
    for segment in flat(segments):
        inside = _items(segment.members)
        if isinstance(segment, Repeat):
            inside = (segment.times if isinstance(segment.times, int) else 1) * (1 + inside)
        found += inside
    return found


def _whole_size(frame: Frame, ends: FrameEnds) -> Iterator[Problem]:
    before = (*frame.head, *frame.body)
    if frame.size is not None and not any(one.takes_rest for one in _without_own_end(before)) and ends.is_open(before):
        what = f"nothing shows where the content of '{frame.name}' ends and what fills it up begins"
        yield Problem(frame.at, what, "give the frame inside a size, or leave the frame's size out")
    for segment in _without_own_end(before) if frame.size is not None else ():
        if segment.takes_rest:
            what = f"{segment.title} reaches to the end of the body, and would read what fills '{frame.name}' up"
            yield Problem(segment.at, what, "give it a size, such as that of a length, or leave the frame's size out")
    least = least_size(frame.segments)
    items = _items(frame.segments)
    if least > MOST_BYTES:
        what = f"'{frame.name}' takes at least {least} bytes, {MOST_BYTES} are possible"
        yield Problem(frame.at, what, "make its parts smaller")
    elif items > MOST_BYTES:
        what = f"the lists in '{frame.name}' have {items} items together, {MOST_BYTES} are possible"
        yield Problem(frame.at, what, "make them shorter")
    for limit, key in ((frame.size, "size"), (frame.most, "max")):
        if limit is not None and least > limit:
            yield Problem(
                frame.at, f"'{frame.name}' takes at least {plural(least, 'byte')}, {key} says {limit}", f"correct {key}"
            )


# ---- frames that interrupt others --------------------------------------------------------------------------


def check_interrupting(protocol: Protocol, frame: Frame, is_open: bool) -> Iterator[Problem]:
    """Report reasons why a receiver cannot separate the frames in `inside` from the bytes of the frame.

    `is_open`: only silence ends the frame.
    """
    todo = "leave inside out"
    inner = protocol.carried
    if frame.inner or frame.name in inner:
        what = f"'{frame.name}' stands only in other frames"
        yield Problem(frame.at, what, "write inside: at the frames around it")
        return
    if is_open:
        what = f"only silence ends '{frame.name}': what comes next may follow it as well as interrupt it"
        yield Problem(frame.at, what, f"give its open part a size or an end, or {todo}")
    if any(wrap.inside for wrap in parts_of(frame.segments, Wrap)):
        yield Problem(frame.at, f"a wrap of '{frame.name}' has inside: too", "write it at one place only")
        return
    firsts: dict[int, str] = {}
    for name in frame.inside:
        other = protocol.frames.get(name)
        if other is None:
            continue
        is_constant = other.size is None and all(_is_constant(one) for one in other.segments)
        if other.inner or name in inner or not is_constant:
            what = f"'{name}' cannot interrupt '{frame.name}': it is more than constant bytes"
            yield Problem(frame.at, what, f"make it of const: only, or {todo}")
        elif other.segments:
            first = other.segments[0]
            assert isinstance(first, Const)
            firsts.setdefault(first.data[0], name)
    for segment in _parts(protocol, StaticSizes(protocol.frames).segments(frame), frozenset()):
        held = _bytes_held(segment) & firsts.keys()
        if held:
            byte = min(held)
            verb = "holds" if isinstance(segment, Const) else "may hold"
            what = f"{segment.title} {verb} {byte:02X}, which tells where '{firsts[byte]}' interrupts '{frame.name}'"
            yield Problem(segment.at, what, _remedy(segment, sorted(held)))


def _is_constant(segment: Segment) -> bool:
    return isinstance(segment, Const) and segment.when is None


def _parts(protocol: Protocol, segments: Segments, around: frozenset[str]) -> Iterator[Segment]:
    """Yield the segments for bytes on the wire, those of inner frames included; a wrap is one segment."""
    for segment in segments:
        inside = segment.blocks if segment.inner_record is None else (segment.inner_record,)
        names = [name for name in segment.frames_inside if name in protocol.frames and name not in around]
        if isinstance(segment, Wrap) or not (inside or segment.frames_inside):
            yield segment
            continue
        if isinstance(segment, Repeat):
            yield segment
        for block in inside:
            yield from _parts(protocol, block, around)
        for name in names:
            known = around | {*segment.frames_inside}
            yield from _parts(protocol, StaticSizes(protocol.frames).segments(protocol.frames[name]), known)


def _bytes_held(segment: Segment) -> frozenset[int]:
    """Return the bytes that a segment itself may contain; for a list of records, its fill bytes only."""
    is_list = isinstance(segment, Repeat) and segment.align <= 1 and bool(segment.members)
    return frozenset() if is_list else bytes_of((segment,))


def _remedy(segment: Segment, held: list[int]) -> str:
    shown = ", ".join(f"{byte:02X}" for byte in held)
    if isinstance(segment, Data) and segment.convert is None:
        return f"add never: [{shown}] to '{segment.name}'"
    if isinstance(segment, Field) and segment.type.kind in ("ascii", "bytes"):
        return f"take {{data: {segment.name}, never: [{shown}]}}"
    if isinstance(segment, (Field, Length, Count)) and segment.type.kind == "int" and segment.type.size == 1:
        return f"give '{segment.name}' a range without {shown}"
    if isinstance(segment, Const):
        return "take another byte, or leave inside out"
    return "send it as ASCII digits, or leave inside out"

"""Read a frame carefully, with a call per segment: record values and spans, and find the first fault.

Generated modules contain copies of this source, so it imports only the errors of framekit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from hmac import compare_digest
from typing import Any

from framekit.codec.errors import FrameError

Ask = Callable[[Any], Any]
"""Compute a value from the state of the reading."""
Span = tuple[str, int, int, Any]
"""Path of a value, offset of its first byte, offset after its last byte, and the value."""
Opened = tuple[bytes, Sequence[int], *tuple[str, ...]]
"""The decoded content of a wrap.

Its parts are the content, the offset of each byte and of the end in the region, the cause of a fault ('' for none; with
a fault the last offset is that of the fault), and for some causes the expected and received bytes.
"""
EVALUATION_ERRORS = (ValueError, LookupError, TypeError, ArithmeticError, AttributeError)
"""The exceptions that an expression can raise for damaged values."""


class Stop(Exception):  # noqa: N818 - control flow, not an error
    """Raised if the rest of this part of the frame cannot be read."""


class Nothing(dict[str, Any]):
    """Stand for an absent record, all of whose values are absent; its entries are its inner records."""

    def __eq__(self, other: object) -> bool:
        return other is None or other is self

    __hash__ = None


class ItemPlace:
    """The state of the list item that is being read."""

    def __init__(self, reading: Diagnosis, index: int, previous: Any, count: int | None, filled: int = 0) -> None:
        self.reading = reading
        self.index = index
        """Its index, from 0."""
        self.previous = previous
        """The previous item, or None."""
        self.count = count
        """The number of items, or None if it is not known in advance."""
        self.filled = filled
        """Maximum number of fill bytes after the last item."""
        self.ended: bool | None = None
        """Whether the item ends the list; None until this is known."""

    @property
    def last(self) -> bool:
        """Return whether it is the last item; without a count this is known only at its end."""
        if self.ended is not None:
            return self.ended
        if self.count is not None:
            return self.index == self.count - 1
        return self.reading.at + self.filled >= self.reading.end


class Notes:
    """The faults of a frame."""

    def __init__(self) -> None:
        self.first: FrameError | None = None
        """The first fault other than a wrong check code."""
        self.turn = 0
        """The turn of the first fault."""
        self.check: FrameError | None = None
        """The first wrong check code."""
        self.unchecked = False
        """Whether a check code was not reached."""
        self.warnings: list[str] = []
        """The wrong check codes that only warn."""
        self.unknown: list[tuple[str, FrameError]] = []
        """The inner frames that fit no candidate, each with the fault of the candidate that was read furthest."""


class Diagnosis:
    """The state of a careful reading, with a method for each kind of call; `refuse`: the refusal code of a fault.

    `n["name"]` is a field by name, searched from the innermost record outwards; an absent field is None, and a list
    around the current item holds the previous items. Offsets are relative to the current buffer; `wire` converts them
    to offsets in the frame.
    """

    def __init__(self, data: bytes, ctx: Mapping[str, Any]) -> None:
        self.data = data
        self.ctx = ctx
        self.at = 0
        self.end = len(data)
        self.places: Sequence[int] | None = None
        """The offsets in the frame of the bytes of the current buffer; None if they are equal."""
        self.fields: dict[str, Any] = {}
        self.scopes = [self.fields]
        self.path = ""
        """The prefix of segments in messages: the enclosing records, with the indexes of items."""
        self.holder = ""
        """The prefix of segments in `bounds`, `turns` and `starts`: the enclosing records."""
        self.left_out: dict[tuple[int, str], Any] = {}
        self.bounds: dict[str, tuple[bytes, int, int]] = {}
        self.turn = 0
        """The number of segments so far, including those without bytes."""
        self.turns: dict[str, int] = {}
        self.starts: dict[str, int] = {}
        self.shown: list[tuple[str, str, int, int, Any, Sequence[int] | None]] = []
        """The parts of `spans`: prefix, segment, start, end, value, and `places`."""
        self.notes = Notes()
        self.is_quiet = False
        """Whether the current part has already reported its fault."""

    def __getitem__(self, name: str) -> Any:
        item: Any = None
        for scope in reversed(self.scopes):
            if name in scope:
                value = scope[name]
                own = isinstance(value, list) and value and value[-1] is item
                return value[:-1] if own else value
            if (id(scope), name) in self.left_out:
                return self.left_out[id(scope), name]
            item = scope
        raise KeyError(name)

    def without(self, names: Iterable[str], records: Iterable[str] = ()) -> None:
        """Mark fields and records as absent; `outer.inner`, listed after `outer`, is a record in another record."""
        scope = id(self.scopes[-1])
        self.left_out |= {(scope, name): None for name in names}
        for path in records:
            name, *inside = path.split(".")
            if not inside:
                self.left_out[scope, name] = Nothing()
            found = self.left_out[scope, name]
            for one in inside:
                found = found.setdefault(one, Nothing())

    # ---- the result ---------------------------------------------------------------------------------------

    @property
    def fault(self) -> FrameError | None:
        """Return the fault: a wrong check code takes precedence.

        Only a frame with reached and correct check codes is refused.
        """
        if self.notes.first is not None and self.notes.unchecked:
            self.notes.first.refuse = None
        return self.notes.check or self.notes.first

    def error(self, frame: str) -> FrameError:
        """Return the fault with the fields that were read before it."""
        fault = self.fault or FrameError("value", frame, 0, "values that fit together")
        fault.also = self.notes.first if fault is self.notes.check else None
        last = self.turn + 1 if fault is self.notes.check else self.notes.turn
        fault.fields = {name: value for name, value in self.fields.items() if self.turns.get(name, 0) < last}
        return fault

    @property
    def spans(self) -> list[Span]:
        """Return path, offset of the first byte, offset after the last byte and value of everything that was read.

        The content of an inner frame follows the frame itself.
        """
        found: list[Span] = []
        for path, segment, first, last, value, places in self.shown:
            if not isinstance(value, Diagnosis):
                found.append((path + shown(segment), wire_offset(places, first), wire_offset(places, last), value))
                continue
            for inner, start, end, one in value.spans:
                place = wire_offset(places, first + start), wire_offset(places, first + end)
                found.append((f"{path}{segment}.{inner}", *place, one))
        return found

    def note(self, cause: str, segment: str, place: int, expected: str, found: str, refuse: int | None = None) -> None:
        """Record a fault; only the first fault in the frame counts."""
        self.note_at(self.wire(place), cause, segment, expected, found, refuse)

    def note_at(self, place: int, cause: str, segment: str, expected: str, found: str, refuse: int | None) -> None:
        """Record a fault at an offset in the frame."""
        if self.is_quiet:
            return
        turn = self.turns.get(self.holder + segment, self.turn)
        first = self.notes.first
        if first is None or (place, turn) < (first.offset, self.notes.turn):
            self.notes.turn = turn
            self.notes.first = FrameError(cause, self.path + shown(segment), place, expected, found, refuse)

    def stop(self, cause: str, segment: str, expected: str, found: str, refuse: int | None = None) -> Stop:
        """Record a fault that ends the reading of this part; return the exception to raise."""
        self.note(cause, segment, self.at, expected, found, refuse)
        return Stop()

    def wire(self, place: int) -> int:
        """Return the offset in the frame of an offset in the current buffer."""
        return place if self.places is None else wire_offset(self.places, place)

    def show(self, segment: str, start: int, value: Any) -> None:
        self.shown.append((self.path, segment, start, self.at, value, self.places))

    # ---- going on -----------------------------------------------------------------------------------------

    def begin(self, name: str) -> int:
        """Start the turn of the next segment; return its offset."""
        self.turn += 1
        path = self.holder + name
        self.turns[path] = self.turn
        at = self.at
        self.starts[path] = at if self.places is None else wire_offset(self.places, at)
        return at

    def take(self, name: str, size: int, refuse: int | None = None) -> bytes:
        """Return the next `size` bytes. Raises Stop if they are missing."""
        start = self.at
        if size < 0:
            raise self.stop("length", name, "a size of at least 0", f"{-size} less", refuse)
        if start + size > self.end:
            raise self.stop("short", name, f"{size} bytes", str(max(self.end - start, 0)), refuse)
        self.at = start + size
        self.bounds[self.holder + name] = (self.data, start, self.at)
        return self.data[start : self.at]

    def ask(self, what: int | Ask, cause: str, segment: str, refuse: int | None = None) -> Any:
        """Return the value of an expression, a whole number unless `cause` is `value`.

        Raises Stop if it has no value.
        """
        if isinstance(what, int):
            return what
        try:
            found = what(self)
        except EVALUATION_ERRORS:
            found = None
        else:
            if cause == "value" or isinstance(found, int):
                return found
        raise self.stop(cause, segment, "values it can be worked out from", "none", refuse)

    def rest(self, behind: int | Ask, segment: str) -> int:
        """Return the number of bytes before those of the following segments. Raises Stop if these do not fit."""
        following = int(self.ask(behind, "length", segment))
        available = max(self.end - self.at, 0)
        if available < following:
            unit = "byte" if following == 1 else "bytes"
            raise self.stop("short", segment, f"at least {following} {unit}", str(available))
        return available - following

    def until_tail(self, mark: int) -> int:
        """Return the number of bytes from the next byte `mark` to the end.

        The byte ends a body whatever its content.
        """
        stop = self.data.find(mark, self.at, self.end)
        if stop < 0:
            raise self.stop("short", "tail", f"{mark:02X}", "none")
        return self.end - stop

    # ---- parts of a frame ---------------------------------------------------------------------------------

    @contextmanager
    def part(self, behind: int | Ask = 0, surplus: int | None = None, checks: bool = False) -> Iterator[None]:
        """Read a part before the bytes of the following segments; reading continues after the part in every case.

        `surplus`: the refusal code for remaining bytes. `checks`: the part contains check codes.
        """
        whole = self.end
        self.end = whole - self.ask(behind, "short", "frame")
        scopes, path, holder = len(self.scopes), self.path, self.holder
        try:
            yield
            if self.at < self.end:
                self.turn += 1
                self.note("surplus", "frame", self.at, "its end", f"{self.end - self.at} bytes more", surplus)
        except Stop:
            del self.scopes[scopes:]
            self.path, self.holder = path, holder
            self.notes.unchecked = self.notes.unchecked or checks
        self.at, self.end = self.end, whole

    @contextmanager
    def attempt(self, behind: int | Ask, checks: bool = False) -> Iterator[None]:
        """Read a part before the bytes of the following segments, which are read even if the part fails."""
        start, whole = self.at, self.end
        tail = whole - self.ask(behind, "short", "frame")
        scopes, path, holder = len(self.scopes), self.path, self.holder
        try:
            yield
        except Stop:
            if tail < start:
                raise
            del self.scopes[scopes:]
            self.at, self.end, self.path, self.holder = tail, whole, path, holder
            self.notes.unchecked = self.notes.unchecked or checks

    @contextmanager
    def record(self, name: str) -> Iterator[None]:
        """Read the fields of a record."""
        start = self.begin(name)
        fields: dict[str, Any] = {}
        self.scopes[-1][name] = fields
        outer = self.path, self.holder
        self.path, self.holder = f"{self.path}{name}.", f"{self.holder}{name}."
        self.scopes.append(fields)
        yield
        self.scopes.pop()
        self.path, self.holder = outer
        self.bounds[self.holder + name] = (self.data, start, self.at)

    def within(self, name: str, compare: Callable[[], None]) -> None:
        """Compare values of a record, if it is present, after later segments have been read."""
        fields = self.scopes[-1].get(name)
        if fields is None:
            return
        outer = self.path, self.holder
        self.path, self.holder = f"{self.path}{name}.", f"{self.holder}{name}."
        self.scopes.append(fields)
        compare()
        self.scopes.pop()
        self.path, self.holder = outer

    def items(
        self,
        name: str,
        times: int | Ask | None,
        behind: int | Ask = 0,
        until: bool = False,
        align: int = 1,
        between: bool = False,
        single: str = "",
    ) -> Iterator[ItemPlace]:
        """Yield every item of a list of records; `times` None: as many as fit before the following segments.

        `until`: the items determine which is the last (`ends`). `align`: each item begins at a multiple of `align`
        bytes from the start of the list; `between`: the last item has no fill bytes. `single`: the items are the values
        of this field; the list is omitted if one of them is faulty.
        """
        start = self.begin(name)
        items: list[dict[str, Any]] = []
        if not single:
            self.scopes[-1][name] = items
        outer, holder = self.path, self.holder
        count = None if times is None else self.ask(times, "length", name)
        if count is not None and count < 0:
            raise self.stop("length", name, "at least 0 items", f"{-count} less")
        whole, ended = self.end, False
        if count is None and not until:
            self.end = start + self.rest(behind, name)
        while not ended if until else self.at < self.end if count is None else len(items) < count:
            if between:
                self.at += -(self.at - start) % align
            before = self.at
            filled = 0 if between else align - 1
            item = ItemPlace(self, len(items), items[-1] if items else None, count, filled)
            items.append({})
            self.path, self.holder = f"{outer}{name}[{item.index}].", f"{holder}{name}."
            self.scopes.append(items[-1])
            yield item
            self.scopes.pop()
            self.path, self.holder = outer, holder
            ended = bool(item.ended)
            if self.at == before and not isinstance(times, int):
                raise self.stop("length", name, "items with bytes", "an empty one")
            if not between:
                self.take(name, -(self.at - start) % align)
        self.end = whole
        self.bounds[self.holder + name] = (self.data, start, self.at)
        if single and all(single in one for one in items):
            self.scopes[-1][name] = [one[single] for one in items]

    def ends(self, item: ItemPlace, until: Ask) -> None:
        """Record whether the item that was read is the last of its list."""
        item.ended = bool(self.ask(until, "value", "until"))

    @contextmanager
    def inside(
        self,
        name: str,
        size: int | Ask | None,
        open_up: Callable[[bytes], Opened],
        behind: int | Ask = 0,
        checks: bool = False,
    ) -> Iterator[None]:
        """Read the content of a wrap of `size` encoded bytes; None: all bytes before the following segments."""
        start = self.begin(name)
        raw = self.take(name, self.rest(behind, name) if size is None else self.ask(size, "short", name))
        plain, places, *told = open_up(raw)
        cause = told[0]
        if cause:
            bad = start + places[-1]
            if cause == "check":
                self.wrong_check(name, bad, told[1], told[2])
            else:
                self.note(cause, name, bad, told[1] if told[1:] else "wrapped content", hex_text(raw[places[-1] :][:2]))
        whole = self.data, self.at, self.end, self.places
        self.places = [self.wire(start + place) for place in places]
        self.data, self.at, self.end = plain, 0, len(plain)
        has_content = cause in ("", "check")
        values, bounds = self.scopes[-1], dict(self.bounds)
        before = tuple(values)
        quiet, self.is_quiet = self.is_quiet, self.is_quiet or not has_content
        try:
            with self.part(checks=checks):
                yield
        finally:
            if not has_content:  # values and spans computed without content are invalid
                self.bounds = bounds
                for one in values.keys() - set(before):
                    del values[one]
            self.data, self.at, self.end, self.places = whole
            self.is_quiet = quiet

    def const(self, name: str, data: bytes, refuse: int | None = None) -> None:
        start = self.begin(name)
        found = self.take(name, len(data), refuse)
        if found != data:
            self.note("constant", name, start, hex_text(data), hex_text(found), refuse)
        self.show(name, start, found)

    def skip(self, name: str, size: int) -> None:
        start = self.begin(name)
        self.show(name, start, self.take(name, size))

    def field(
        self,
        name: str,
        size: int | Ask,
        parse: Callable[[bytes], Any],
        refuse: int | None = None,
        **rules: Any,
    ) -> None:
        """Read a value; `rules` are the arguments of `validate`."""
        start = self.begin(name)
        raw = self.take(name, self.ask(size, "length", name, refuse), refuse)
        self.store(name, start, raw, parse, refuse, **rules)

    def store(
        self, name: str, start: int, raw: bytes, parse: Callable[[bytes], Any], refuse: int | None, **rules: Any
    ) -> None:
        """Store the value of some bytes, or record a fault for invalid digits."""
        try:
            value = parse(raw)
        except ValueError:
            self.note("digits", name, start, "digits", repr(raw)[1:], refuse)
            self.show(name, start, raw)
            return
        self.scopes[-1][name] = value
        self.show(name, start, value)
        if rules:
            self.validate(name, start, value, refuse, **rules)

    def validate(
        self,
        name: str,
        place: int,
        value: Any,
        refuse: int | None,
        limits: tuple[int, int] | None = None,
        among: Any = None,
        cause: str = "value",
    ) -> None:
        """Record a fault unless a value is within `limits` and one of `among`."""
        if among is not None and value not in among:
            self.note(cause, name, place, " or ".join(str(one) for one in among), repr(value), refuse)
        if limits is not None and not limits[0] <= value <= limits[1]:
            self.note("range", name, place, f"{limits[0]}..{limits[1]}", str(value), refuse)

    def long(
        self,
        name: str,
        size: int,
        parse: Callable[[bytes], int],
        is_mark: Callable[[bytes], bool],
        longer: int,
        parse_longer: Callable[[bytes], int],
        refuse: int | None = None,
        **rules: Any,
    ) -> None:
        """Read a number that is a mark followed by a longer number if it is large."""
        start = self.begin(name)
        raw = self.take(name, size, refuse)
        try:
            is_long = is_mark(raw)
        except ValueError:
            is_long = False
        if is_long:
            raw, parse = self.take(name, longer, refuse), parse_longer
        self.bounds[self.holder + name] = (self.data, start, self.at)
        self.store(name, start, raw, parse, refuse, **rules)

    def until(
        self,
        name: str,
        end: Any,
        parse: Callable[[bytes], Any],
        refuse: int | None = None,
        find: Callable[..., int] | None = None,
        **rules: Any,
    ) -> None:
        """Read a text up to its end bytes. With `find` the end is the first of several byte strings and not consumed.

        Such an end may follow the list if the text ends the last item of a list.
        """
        start = self.begin(name)
        ends = (end,) if find is None else tuple(bytes((one,)) if isinstance(one, int) else one for one in end)
        limit = self.end if find is None else self.end + max(map(len, ends))
        stop = self.data.find(end, start, limit) if find is None else find(self.data, end, start, limit)
        if stop < 0 or stop > self.end:
            shown = " or ".join(map(hex_text, ends))
            raise self.stop("short", name, f"the end {shown}", "none", refuse)
        raw = self.take(name, stop - start)
        self.at = stop if find is not None else stop + len(end)
        self.bounds[self.holder + name] = (self.data, start, self.at)
        self.store(name, start, raw, parse, refuse, **rules)

    def bits(
        self,
        name: str,
        size: int | Ask,
        parse: Callable[[bytes], int],
        parts: Mapping[str, tuple[int, int]],
        refuse: int | None = None,
        among: Mapping[str, tuple[Any, str]] | None = None,
    ) -> None:
        """Read named bits of a number: name → lowest bit and mask; `among`: name → allowed values and the cause."""
        start = self.begin(name)
        raw = self.take(name, self.ask(size, "length", name, refuse), refuse)
        try:
            number = parse(raw)
        except ValueError:
            self.note("digits", name, start, "digits", repr(raw)[1:], refuse)
            return
        for part, (low, mask) in parts.items():
            value = number >> low & mask
            path = self.holder + part
            self.turns[path], self.starts[path] = self.turn, self.starts[self.holder + name]
            self.bounds[path] = self.bounds[self.holder + name]
            self.scopes[-1][part] = value
            self.show(part, start, value)
            if among is not None and part in among:
                self.validate(part, start, value, refuse, among=among[part][0], cause=among[part][1])

    def data_field(
        self,
        name: str,
        size: int | Ask | None,
        parse: Callable[[bytes], Any],
        refuse: int | None = None,
        behind: int | Ask = 0,
        least: int = 0,
        never: bytes = b"",
    ) -> None:
        """Read `size` encoded bytes; None: all before the following segments; `never`: forbidden bytes."""
        start = self.begin(name)
        room = self.rest(behind, name) if size is None else self.ask(size, "length", name, refuse)
        raw = self.take(name, room, refuse)
        self.store(name, start, raw, parse, refuse)
        bad = next((place for place, byte in enumerate(raw) if byte in never), -1) if never else -1
        if bad >= 0:
            self.note("value", name, start + bad, f"no {hex_text(never)}", hex_text(raw[bad : bad + 1]), refuse)
        value = self.scopes[-1].get(name)
        if value is not None and len(value) < least:
            self.note("short", name, start, f"at least {least} bytes", str(len(value)), refuse)

    def values(
        self,
        name: str,
        times: int | Ask | None,
        size: int,
        parse: Callable[[bytes], Any],
        refuse: int | None = None,
        behind: int | Ask = 0,
    ) -> None:
        """Read a list of plain values of `size` bytes each."""
        start = self.begin(name)
        room = self.rest(behind, name) if times is None else size * self.ask(times, "length", name, refuse)
        raw = self.take(name, room, refuse)
        if room % size:
            self.note("short", name, start, f"{size} bytes", str(room % size), refuse)
            return

        def parse_all(raw: bytes) -> list[Any]:
            return [parse(raw[place : place + size]) for place in range(0, len(raw), size)]

        self.store(name, start, raw, parse_all, refuse)

    def value(self, name: str, read: Ask, refuse: int | None = None) -> None:
        """Compute a value that takes no bytes."""
        start = self.begin(name)
        try:
            value = read(self)
        except EVALUATION_ERRORS:
            self.note("value", name, start, "values it can be worked out from", "none", refuse)
            return
        self.bounds[self.holder + name] = (self.data, start, start)
        self.scopes[-1][name] = value
        self.show(name, start, value)

    def absent(self, name: str, default: Ask) -> None:
        """Compute the default of an absent field."""
        start = self.begin(name)
        try:
            self.bounds[self.holder + name] = (self.data, start, start)
            self.scopes[-1][name] = default(self)
        except EVALUATION_ERRORS:
            self.note("value", name, start, "values it can be worked out from", "none")

    def nothing(self, *paths: str) -> None:
        """Give absent segments an empty span."""
        for path in paths:
            self.bounds[path] = (self.data, self.at, self.at)

    def require(self, text: str, condition: Ask, refuse: int | None = None) -> None:
        """Record a fault unless a condition is true here."""
        start = self.begin("require")
        self.expect("require", "require", start, text, condition, refuse)

    def expect(
        self, cause: str, segment: str, place: int, expected: str, condition: Ask, refuse: int | None = None
    ) -> None:
        """Record a fault of a segment unless a condition is true; a condition without a value is false."""
        try:
            holds = condition(self)
        except EVALUATION_ERRORS:
            holds = False
        if not holds:
            self.note(cause, segment, place, expected, "", refuse)

    def same(self, cause: str, name: str, wanted: Ask, refuse: int | None = None) -> None:
        """Compare a value with its expected value, if both are available."""
        path = self.holder + name
        if path not in self.bounds or name not in self.scopes[-1]:
            return
        found = self[name]
        try:
            right = wanted(self)
        except EVALUATION_ERRORS:
            if self.fault is None:
                self.note_at(self.starts[path], cause, name, "values it can be worked out from", "none", refuse)
            return
        if found != right:
            self.note_at(self.starts[path], cause, name, str(right), str(found), refuse)

    def check(
        self, name: str, size: int, code: Ask, digits: bool = False, verify: bool = True, keyed: bool = False
    ) -> None:
        """Read a check code over the bytes before it; `digits` may be in upper or lower case."""
        start = self.begin(name)
        self.show(name, start, self.take(name, size))
        end, self.at = self.at, start
        self.verify(self.holder + name, code, digits, verify, keyed)
        self.at = end

    def verify(self, path: str, code: Ask, digits: bool = False, verify: bool = True, keyed: bool = False) -> None:
        """Compare a check code, if it was read, with the expected bytes; a code made with a key is not shown."""
        if path not in self.bounds:
            return
        data, start, end = self.bounds[path]
        name = path.removeprefix(self.holder)
        found = data[start:end]
        try:
            wanted = code(self)
        except EVALUATION_ERRORS:
            if verify:
                self.note("value", name, start, "values it can be worked out from", "none")
                self.notes.unchecked = True
            return
        if compare_digest(*((found.upper(), wanted.upper()) if digits else (found, wanted))):
            return
        expected = "the code made with the key" if keyed else hex_text(wanted)
        self.wrong_check(name, start, expected, hex_text(found), verify)

    def wrong_check(self, name: str, place: int, expected: str, found: str, verify: bool = True) -> None:
        """Record a wrong check code, or only a warning without `verify`; the first in the frame counts."""
        fault = FrameError("check", self.path + shown(name), self.wire(place), expected, found)
        if not verify:
            self.notes.warnings.append(str(fault))
        elif self.notes.check is None or fault.offset < self.notes.check.offset:
            self.notes.check = fault

    def inner(self, name: str, size: int | Ask | None, choice: Any, behind: int | Ask = 0, found: bool = False) -> None:
        """Read an inner frame: the first candidate that fits, or that is to be refused.

        `found`: the size was measured on the candidates; it is not positive if none fits.
        """
        start = self.begin(name)
        room = self.rest(behind, name) if size is None else self.ask(size, "length", name)
        if found and room <= 0:
            raise self.no_frame(name, start, choice)
        raw, nearest = self.take(name, room), None
        for frame in choice.frames(raw):
            one: Diagnosis = frame.diagnose(raw, self.ctx)
            fault = one.fault
            if fault is None or fault.refuse is not None:
                fields = one.fields if fault is None else one.error(frame.name).fields
                self.scopes[-1][name] = {frame.name: fields}
                self.show(name, start, frame.name)
                self.adopt(f"{name}.{frame.name}", start, one)
                return
            if nearest is None or reach_of(one) > reach_of(nearest[1]):
                nearest = frame.name, one, one.notes.first or fault
        if nearest is not None:
            self.notes.unknown.append((self.path + name, self.moved(f"{name}.{nearest[0]}", start, nearest[2])))
        self.scopes[-1][name] = {"unknown": {"data": raw}}
        self.show(name, start, raw)

    def no_frame(self, name: str, start: int, choice: Any) -> Stop:
        """Record that no candidate for an inner frame fits, with the fault of the candidate that was read furthest."""
        best: tuple[str, Diagnosis] | None = None
        for frame in choice.everything:
            size = frame.measure(self.data, start, self.end, self.ctx)
            one: Diagnosis = frame.diagnose(self.data[start : start + size if size > 0 else self.end], self.ctx)
            fault = one.fault
            if fault is not None and (best is None or reach_of(one) > reach_of(best[1])):
                best = frame.name, one
        if best is None:
            return self.stop("value", name, "one of its frames", hex_text(self.data[start : self.end]))
        self.adopt(f"{name}.{best[0]}", start, best[1], best[1].notes.first)
        return Stop()

    def nested(self, name: str, level: Any) -> None:
        """Read the next level of a layout inside itself, which determines its own end."""
        start = self.begin(name)
        size = level.measure(self.data, start, self.end, self.ctx)
        raw = self.take(name, size) if size > 0 else self.data[start : self.end]
        one: Diagnosis = level.diagnose(raw, self.ctx)
        self.scopes[-1][name] = one.fields
        self.adopt(name, start, one)
        if size <= 0:
            raise Stop

    def adopt(self, name: str, start: int, inner: Diagnosis, first: FrameError | None = None) -> None:
        """Add the results for an inner frame; its fault has a later turn than the inner frame itself."""
        self.shown.append((self.path, name, start, start, inner, self.places))
        self.notes.warnings.extend(inner.notes.warnings)
        unknown = ((f"{self.path}{name}.{path}", self.moved(name, start, fault)) for path, fault in inner.notes.unknown)
        self.notes.unknown.extend(unknown)
        fault = first or inner.fault
        if fault is not None:
            self.turn += 1
            path, place = f"{name}.{fault.segment}", start + fault.offset
            self.note(fault.cause, path, place, fault.expected, fault.found, fault.refuse)

    def moved(self, name: str, start: int, fault: FrameError) -> FrameError:
        """Return a fault of an inner frame as a fault of this frame."""
        segment, place = f"{self.path}{name}.{fault.segment}", self.wire(start + fault.offset)
        return FrameError(fault.cause, segment, place, fault.expected, fault.found)

    # ---- what was read ------------------------------------------------------------------------------------

    def bytes_of(self, *paths: str) -> bytes:
        """Return the bytes of these segments in this order, decoded if they are in a wrap."""
        return b"".join(data[start:end] for data, start, end in (self.bounds[path] for path in paths))

    def bytes_from(self, path: str) -> bytes:
        """Return all bytes from a segment up to the current offset."""
        return self.data[self.bounds[path][1] : self.at]

    def room(self, *paths: str) -> int:
        """Return the total size of these segments in bytes."""
        return sum(end - start for _, start, end in (self.bounds[path] for path in paths if path in self.bounds))


def reach_of(reading: Diagnosis) -> int:
    """Return the number of valid bytes before the first fault other than a wrong check code.

    Without such a fault the result is the size plus 1.
    """
    first = reading.notes.first
    return len(reading.data) + 1 if first is None else first.offset


def wire_offset(places: Sequence[int] | None, place: int) -> int:
    """Return the offset in the frame of an offset in a buffer, given the offsets of the buffer's bytes."""
    return place if places is None else places[min(place, len(places) - 1)]


def shown(segment: str) -> str:
    """Return the path of a segment with its own name, or with its kind if it has none."""
    holder, dot, name = segment.rpartition(".")
    return f"{holder}{dot}{name.split('_')[1]}" if name.startswith("_") else segment


def hex_text(data: bytes) -> str:
    """Return bytes in the format of messages: `10 03`."""
    return data.hex(" ").upper()


def hex_content(raw: bytes) -> Opened:
    """Decode carefully a content in hex digits."""
    for place in range(0, len(raw), 2):
        if len(raw) < place + 2 or raw[place : place + 2].strip(b"0123456789ABCDEFabcdef"):
            return b"", [place], "digits"
    return bytes.fromhex(raw.decode("ascii")), range(0, len(raw) + 1, 2), ""

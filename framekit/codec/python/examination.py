"""The careful way to read a frame: segment by segment, noting where everything stands and the first thing that is wrong.

Pasted into generated modules, whose `examine_…` functions call it; so it imports nothing of framekit but the errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from framekit.codec.errors import FrameError

Ask = Callable[["Examination"], Any]
Span = tuple[str, int, int, Any]

Opened = tuple[bytes, Sequence[int], str]
"""What is inside a wrap: the content, the place of each byte and of the end in the region, '' or the cause of a fault
(then the last place is where it is)."""


class Stop(Exception):  # noqa: N818 - no error, a way out of a part that cannot be read on
    """What is left of this part of a frame cannot be read."""


class Notes:
    """The first fault of a frame, a wrong check code, and checks that only warn."""

    def __init__(self) -> None:
        self.first: FrameError | None = None
        self.check: FrameError | None = None
        self.warnings: list[str] = []


class Examination:
    """A frame being read carefully. `fields`, `spans` (path, first byte, byte behind the last, value) grow as it goes.

    `n["name"]` is a field by name, innermost record first. Places count in the present buffer; `wire` turns them into
    those on the wire, also inside wraps.
    """

    def __init__(self, data: bytes, ctx: Mapping[str, Any]) -> None:
        self.data = data
        self.ctx = ctx
        self.at = 0
        self.end = len(data)
        self.places: Sequence[int] | None = None
        self.fields: dict[str, Any] = {}
        self.scopes = [self.fields]
        self.path = ""
        self.bounds: dict[str, tuple[bytes, int, int]] = {}
        self.spans: list[Span] = []
        self.notes = Notes()

    def __getitem__(self, name: str) -> Any:
        for scope in reversed(self.scopes):
            if name in scope:
                return scope[name]
        raise KeyError(name)

    # ---- the result ---------------------------------------------------------------------------------------

    @property
    def fault(self) -> FrameError | None:
        """What is wrong: a wrong check code before everything else."""
        return self.notes.check or self.notes.first

    def error(self, frame: str) -> FrameError:
        """The fault with the fields that were read before it."""
        fault = self.fault or FrameError("value", frame, 0, "values that fit together")
        fault.fields = self.fields
        return fault

    def note(self, cause: str, segment: str, place: int, expected: str, found: str, refuse: int | None = None) -> None:
        """A fault; the first one in the frame counts."""
        place = self.wire(place)
        if self.notes.first is None or place < self.notes.first.offset:
            self.notes.first = FrameError(cause, self.path + shown(segment), place, expected, found, refuse)

    def stop(self, cause: str, segment: str, expected: str, found: str, refuse: int | None = None) -> Stop:
        """A fault behind which this part cannot be read on."""
        self.note(cause, segment, self.at, expected, found, refuse)
        return Stop()

    def wire(self, place: int) -> int:
        """Where a place in the present buffer is on the wire."""
        return place if self.places is None else self.places[min(place, len(self.places) - 1)]

    def show(self, segment: str, start: int, value: Any) -> None:
        self.spans.append((self.path + shown(segment), self.wire(start), self.wire(self.at), value))

    # ---- parts of a frame ---------------------------------------------------------------------------------

    @contextmanager
    def part(self, behind: int | Ask = 0, surplus: int | None = None) -> Iterator[None]:
        """A part with `behind` bytes behind it; however it goes, reading goes on behind it."""
        whole = self.end
        behind = behind if isinstance(behind, int) else self.ask(behind, "length", "size")
        if whole - behind < self.at:
            raise self.stop("short", "frame", f"{self.at + behind} bytes", f"{whole}")
        self.end = whole - behind
        scopes, path = len(self.scopes), self.path
        try:
            yield
            if self.at < self.end:
                self.note("surplus", "frame", self.at, "its end", f"{self.end - self.at} bytes more", surplus)
        except Stop:
            del self.scopes[scopes:]
            self.path = path
        self.at, self.end = self.end, whole

    @contextmanager
    def record(self, name: str) -> Iterator[None]:
        """Fields that make one value."""
        fields: dict[str, Any] = {}
        self.scopes[-1][name] = fields
        outer, start = self.path, self.at
        self.path = f"{outer}{name}."
        self.scopes.append(fields)
        yield
        self.scopes.pop()
        self.path = outer
        self.bounds[name] = (self.data, start, self.at)

    def items(self, name: str, times: int | Ask | None, behind: int | Ask = 0) -> Iterator[int]:
        """Every item of a list of records; `times` None: as many as fit before the last `behind` bytes."""
        items: list[dict[str, Any]] = []
        self.scopes[-1][name] = items
        outer, start, index = self.path, self.at, 0
        count = None if times is None else self.ask(times, "length", name)
        end = self.at + self.rest(behind, name)
        while self.at < end if count is None else index < count:
            before = self.at
            items.append({})
            self.path = f"{outer}{name}[{index}]."
            self.scopes.append(items[-1])
            yield index
            self.scopes.pop()
            self.path = outer
            index += 1
            if self.at == before and (count is None or index > len(self.data)):
                raise self.stop("length", name, "items with bytes", "an empty one")
        self.bounds[name] = (self.data, start, self.at)

    @contextmanager
    def inside(
        self, name: str, size: int | Ask | None, open_up: Callable[[bytes], Opened], behind: int | Ask = 0
    ) -> Iterator[None]:
        """The content of a wrap; `size` on the wire, None: up to the last `behind` bytes."""
        start = self.at
        raw = self.take(name, self.rest(behind, name) if size is None else self.ask(size, "short", name))
        plain, places, cause = open_up(raw)
        if cause:
            bad = start + places[-1]
            self.note(cause, name, bad, "wrapped content", raw[places[-1] :][:2].hex(" "))
            raise Stop
        whole = self.data, self.at, self.end, self.places
        self.places = [self.wire(start + place) for place in places]
        self.data, self.at, self.end = plain, 0, len(plain)
        try:
            with self.part():
                yield
        finally:
            self.data, self.at, self.end, self.places = whole

    # ---- segments -----------------------------------------------------------------------------------------

    def take(self, name: str, size: int, refuse: int | None = None) -> bytes:
        """The next bytes. Raises Stop if they are not there."""
        start = self.at
        if size < 0:
            raise self.stop("length", name, "a size of at least 0", str(size), refuse)
        if start + size > self.end:
            raise self.stop("short", name, f"{size} bytes", str(max(self.end - start, 0)), refuse)
        self.at = start + size
        self.bounds[name] = (self.data, start, self.at)
        return self.data[start : self.at]

    def const(self, name: str, data: bytes, refuse: int | None = None) -> None:
        start = self.at
        found = self.take(name, len(data), refuse)
        if found != data:
            self.note("constant", name, start, data.hex(" "), found.hex(" "), refuse)
        self.show(name, start, found)

    def skip(self, name: str, size: int) -> None:
        start = self.at
        self.show(name, start, self.take(name, size))

    def field(
        self,
        name: str,
        size: int | Ask,
        parse: Callable[[bytes], Any],
        refuse: int | None = None,
        **rules: Any,
    ) -> None:
        """A value; `rules` are those of `judge`."""
        start = self.at
        raw = self.take(name, size if isinstance(size, int) else self.ask(size, "length", name, refuse), refuse)
        self.store(name, start, raw, parse, refuse, rules)

    def store(
        self, name: str, start: int, raw: bytes, parse: Callable[[bytes], Any], refuse: int | None, rules: Any
    ) -> None:
        try:
            value = parse(raw)
        except ValueError:
            self.note("digits", name, start, "digits", repr(raw)[1:], refuse)
            self.show(name, start, raw)
            return
        self.scopes[-1][name] = value
        self.show(name, start, value)
        self.judge(name, start, value, refuse, **rules)

    def judge(
        self,
        name: str,
        place: int,
        value: Any,
        refuse: int | None,
        limits: tuple[int, int] | None = None,
        among: Any = None,
        cause: str = "value",
    ) -> None:
        """What must hold for a value: it lies in `limits`; it is one of `among`."""
        if among is not None and value not in among:
            self.note(cause, name, place, " or ".join(str(one) for one in among), repr(value), refuse)
        if limits is not None and not limits[0] <= value <= limits[1]:
            self.note("range", name, place, f"{limits[0]}..{limits[1]}", str(value), refuse)

    def long(
        self,
        name: str,
        size: int,
        parse: Callable[[bytes], int],
        mark: int,
        longer: int,
        parse_longer: Callable[[bytes], int],
        refuse: int | None = None,
        **rules: Any,
    ) -> None:
        """A number that is a mark with a longer number behind when it is large."""
        start = self.at
        raw = self.take(name, size, refuse)
        if parse(raw) == mark:
            raw, parse = self.take(name, longer, refuse), parse_longer
        self.bounds[name] = (self.data, start, self.at)
        self.store(name, start, raw, parse, refuse, rules)

    def until(
        self, name: str, end: bytes, parse: Callable[[bytes], Any], refuse: int | None = None, **rules: Any
    ) -> None:
        """A text up to the bytes that end it."""
        start = self.at
        stop = self.data.find(end, start, self.end)
        if stop < 0:
            raise self.stop("short", name, f"the end {end.hex(' ')}", "none", refuse)
        raw = self.take(name, stop - start)
        self.at = stop + len(end)
        self.bounds[name] = (self.data, start, self.at)
        self.store(name, start, raw, parse, refuse, rules)

    def bits(
        self,
        name: str,
        size: int,
        parse: Callable[[bytes], int],
        parts: Mapping[str, tuple[int, int]],
        refuse: int | None = None,
        among: Mapping[str, tuple[Any, str]] | None = None,
    ) -> None:
        """Named bits of one number: name → lowest bit and mask; `among`: name → allowed values and the cause."""
        start = self.at
        raw = self.take(name, size, refuse)
        try:
            number = parse(raw)
        except ValueError:
            self.note("digits", name, start, "digits", repr(raw)[1:], refuse)
            return
        for part, (low, mask) in parts.items():
            value = number >> low & mask
            self.scopes[-1][part] = value
            self.show(part, start, value)
            if among is not None and part in among:
                self.judge(part, start, value, refuse, among=among[part][0], cause=among[part][1])

    def data_field(
        self,
        name: str,
        size: int | Ask | None,
        parse: Callable[[bytes], Any],
        refuse: int | None = None,
        behind: int | Ask = 0,
        least: int = 0,
    ) -> None:
        """Bytes; `size` on the wire, None: up to the last `behind` bytes."""
        start = self.at
        room = self.rest(behind, name) if size is None else self.ask(size, "length", name, refuse)
        raw = self.take(name, room, refuse)
        self.store(name, start, raw, parse, refuse, {})
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
        """A list of plain values of `size` bytes each."""
        start = self.at
        count = self.rest(behind, name) // size if times is None else self.ask(times, "length", name, refuse)
        raw = self.take(name, count * size, refuse)

        def parse_all(raw: bytes) -> list[Any]:
            return [parse(raw[place : place + size]) for place in range(0, len(raw), size)]

        self.store(name, start, raw, parse_all, refuse, {})

    def value(self, name: str, read: Ask, refuse: int | None = None) -> None:
        """A value that takes no bytes."""
        value = self.ask(read, "value", name, refuse)
        self.scopes[-1][name] = value
        self.show(name, self.at, value)

    def absent(self, name: str, default: Ask) -> None:
        """The value of a field that is not there."""
        self.scopes[-1][name] = self.ask(default, "value", name)

    def require(self, text: str, condition: Ask, refuse: int | None = None) -> None:
        """A condition that must hold here."""
        self.expect("require", "require", self.at, text, condition, refuse)

    def expect(
        self, cause: str, segment: str, place: int, expected: str, condition: Ask, refuse: int | None = None
    ) -> None:
        try:
            holds = condition(self)
        except EVALUATION_ERRORS:
            holds = False
        if not holds:
            self.note(cause, segment, place, expected, "", refuse)

    def same(self, cause: str, name: str, wanted: Ask, refuse: int | None = None) -> None:
        """A value that was read is compared with what it should be."""
        if name not in self.bounds or not any(name in scope for scope in self.scopes):
            return
        found = self[name]
        try:
            right = wanted(self)
        except EVALUATION_ERRORS:
            return
        if found != right:
            self.note(cause, name, self.bounds[name][1], str(right), str(found), refuse)

    def check(self, name: str, size: int, code: Ask, digits: bool = False, verify: bool = True) -> None:
        """A check code, compared with the bytes it should be; whether `digits` are in upper or lower case is the same."""
        start = self.at
        found = self.take(name, size)
        self.show(name, start, found)
        try:
            self.at = start
            wanted = code(self)
        except EVALUATION_ERRORS:
            return
        finally:
            self.at = start + size
        if found == wanted or (digits and found.upper() == wanted.upper()):
            return
        fault = FrameError("check", self.path + shown(name), self.wire(start), wanted.hex(" "), found.hex(" "))
        if not verify:
            self.notes.warnings.append(str(fault))
        elif self.notes.check is None:
            self.notes.check = fault

    def inner(self, name: str, size: int | Ask | None, choice: Any, behind: int | Ask = 0) -> None:
        """A frame inside this one: the first candidate that fits, or that is to be refused."""
        start = self.at
        raw = self.take(name, self.rest(behind, name) if size is None else self.ask(size, "length", name))
        for frame in choice.frames(raw):
            found: Examination = frame.examine(raw, self.ctx)
            fault = found.fault
            if fault is None or fault.refuse is not None:
                self.scopes[-1][name] = {frame.name: found.fields}
                self.show(name, start, frame.name)
                self._adopt(name, start, found)
                return
        self.scopes[-1][name] = {"unknown": {"data": raw}}
        self.show(name, start, raw)

    def _adopt(self, name: str, start: int, inner: Examination) -> None:
        for path, first, last, value in inner.spans:
            span = f"{self.path}{name}.{path}", self.wire(start + first), self.wire(start + last), value
            self.spans.append(span)
        self.notes.warnings.extend(inner.notes.warnings)
        fault = inner.fault
        if fault is not None:
            self.note(
                fault.cause, f"{name}.{fault.segment}", start + fault.offset, fault.expected, fault.found, fault.refuse
            )

    def finish(self, surplus: int | None = None) -> None:
        """Nothing may be left."""
        if self.at < self.end:
            self.note("surplus", "frame", self.at, "its end", f"{self.end - self.at} bytes more", surplus)

    # ---- asking -------------------------------------------------------------------------------------------

    def ask(self, what: int | Ask, cause: str, segment: str, refuse: int | None = None) -> Any:
        """The value of an expression. Raises Stop if it cannot be worked out."""
        if isinstance(what, int):
            return what
        try:
            return what(self)
        except EVALUATION_ERRORS:
            raise self.stop(cause, segment, "values it can be worked out from", "none", refuse) from None

    def rest(self, behind: int | Ask, segment: str) -> int:
        """How many bytes there are up to the last `behind` ones."""
        return int(self.end - self.ask(behind, "length", segment) - self.at)

    def bytes_of(self, *names: str) -> bytes:
        """These segments in this order, each as it is inside its wrap."""
        return b"".join(data[start:end] for data, start, end in (self.bounds[name] for name in names))

    def bytes_from(self, name: str) -> bytes:
        """Everything from a segment up to here."""
        return self.data[self.bounds[name][1] : self.at]

    def room(self, *names: str) -> int:
        """Bytes these segments take."""
        return sum(end - start for _, start, end in (self.bounds[name] for name in names if name in self.bounds))


def shown(segment: str) -> str:
    """A segment's name, or its kind when it has none of its own."""
    return segment.split("_")[1] if segment.startswith("_") else segment


def hex_content(raw: bytes) -> Opened:
    """What hex digits stand for."""
    for place in range(0, len(raw), 2):
        if len(raw) < place + 2 or raw[place : place + 2].strip(b"0123456789ABCDEFabcdef"):
            return b"", [place], "digits"
    return bytes.fromhex(raw.decode("ascii")), range(0, len(raw) + 1, 2), ""


def doubled_content(raw: bytes, escape: int) -> Opened:
    """Content without the second ones of doubled escape bytes."""
    plain, places, place = bytearray(), [], 0
    while place < len(raw):
        places.append(place)
        plain.append(raw[place])
        if raw[place] == escape:
            place += 1
            if raw[place : place + 1] != raw[place - 1 : place]:
                return b"", [place - 1], "constant"
        place += 1
    return bytes(plain), [*places, len(raw)], ""


EVALUATION_ERRORS = (ValueError, LookupError, TypeError, ArithmeticError, AttributeError)
"""What working out an expression on damaged values can raise."""
NEEDS = {
    "Examination": ("Notes", "Stop", "shown"),
    "hex_content": (),
    "doubled_content": (),
}
IMPORTS = {
    "Examination": (
        "from collections.abc import Callable, Iterator, Sequence",
        "from contextlib import contextmanager",
    ),
}

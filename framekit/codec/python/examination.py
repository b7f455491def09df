"""The careful way to read a frame: segment by segment, noting where everything stands and the first thing wrong.

Pasted into generated modules, whose `examine_…` functions call it; so it imports nothing of framekit but the errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from framekit.codec.errors import FrameError
from framekit.codec.python.examination_state import EVALUATION_ERRORS, Ask, ExaminationState, shown


class Examination(ExaminationState):
    """The segments of a frame, one call each; `refuse` is the code of a fault there that is to be answered."""

    def const(self, name: str, data: bytes, refuse: int | None = None) -> None:
        start = self.begin(name)
        found = self.take(name, len(data), refuse)
        if found != data:
            self.note("constant", name, start, data.hex(" "), found.hex(" "), refuse)
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
        """A value; `rules` are those of `judge`."""
        start = self.begin(name)
        raw = self.take(name, self.ask(size, "length", name, refuse), refuse)
        self.store(name, start, raw, parse, refuse, **rules)

    def store(
        self, name: str, start: int, raw: bytes, parse: Callable[[bytes], Any], refuse: int | None, **rules: Any
    ) -> None:
        """Keeps what bytes mean; digits that are none are a fault."""
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
        is_mark: Callable[[bytes], bool],
        longer: int,
        parse_longer: Callable[[bytes], int],
        refuse: int | None = None,
        **rules: Any,
    ) -> None:
        """A number that is a mark with a longer number behind when it is large."""
        start = self.begin(name)
        raw = self.take(name, size, refuse)
        try:
            is_long = is_mark(raw)
        except ValueError:
            is_long = False
        if is_long:
            raw, parse = self.take(name, longer, refuse), parse_longer
        self.bounds[name] = (self.data, start, self.at)
        self.store(name, start, raw, parse, refuse, **rules)

    def until(
        self, name: str, end: bytes, parse: Callable[[bytes], Any], refuse: int | None = None, **rules: Any
    ) -> None:
        """A text up to the bytes that end it."""
        start = self.begin(name)
        stop = self.data.find(end, start, self.end)
        if stop < 0:
            raise self.stop("short", name, f"the end {end.hex(' ')}", "none", refuse)
        raw = self.take(name, stop - start)
        self.at = stop + len(end)
        self.bounds[name] = (self.data, start, self.at)
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
        """Named bits of one number: name → lowest bit and mask; `among`: name → allowed values and the cause."""
        start = self.begin(name)
        raw = self.take(name, self.ask(size, "length", name, refuse), refuse)
        try:
            number = parse(raw)
        except ValueError:
            self.note("digits", name, start, "digits", repr(raw)[1:], refuse)
            return
        for part, (low, mask) in parts.items():
            value = number >> low & mask
            self.turns[part] = self.turn
            self.bounds[part] = self.bounds[name]
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
        start = self.begin(name)
        room = self.rest(behind, name) if size is None else self.ask(size, "length", name, refuse)
        self.store(name, start, self.take(name, room, refuse), parse, refuse)
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
        """A value that takes no bytes."""
        start = self.begin(name)
        try:
            value = read(self)
        except EVALUATION_ERRORS:
            self.note("value", name, start, "values it can be worked out from", "none", refuse)
            return
        self.bounds[name] = (self.data, start, start)
        self.scopes[-1][name] = value
        self.show(name, start, value)

    def absent(self, name: str, default: Ask) -> None:
        """The value of a field that is not there."""
        start = self.begin(name)
        try:
            self.bounds[name] = (self.data, start, start)
            self.scopes[-1][name] = default(self)
        except EVALUATION_ERRORS:
            self.note("value", name, start, "values it can be worked out from", "none")

    def nothing(self, *names: str) -> None:
        """Segments that are not there take no bytes."""
        for name in names:
            self.bounds[name] = (self.data, self.at, self.at)

    def require(self, text: str, condition: Ask, refuse: int | None = None) -> None:
        """A condition that must hold here."""
        start = self.begin("require")
        self.expect("require", "require", start, text, condition, refuse)

    def expect(
        self, cause: str, segment: str, place: int, expected: str, condition: Ask, refuse: int | None = None
    ) -> None:
        """A condition about a segment; one that cannot be worked out does not hold."""
        try:
            holds = condition(self)
        except EVALUATION_ERRORS:
            holds = False
        if not holds:
            self.note(cause, segment, place, expected, "", refuse)

    def same(self, cause: str, name: str, wanted: Ask, refuse: int | None = None) -> None:
        """A value that was read is compared with what it should be, as far as that can be told."""
        if name not in self.bounds or not any(name in scope for scope in self.scopes):
            return
        found = self[name]
        try:
            right = wanted(self)
        except EVALUATION_ERRORS:
            if self.fault is None:
                self.note(cause, name, self.bounds[name][1], "values it can be worked out from", "none", refuse)
            return
        if found != right:
            self.note(cause, name, self.bounds[name][1], str(right), str(found), refuse)

    def check(self, name: str, size: int, code: Ask, digits: bool = False, verify: bool = True) -> None:
        """A check code over what was read before it; `digits` may be in upper or lower case."""
        start = self.begin(name)
        self.show(name, start, self.take(name, size))
        end, self.at = self.at, start
        self.verify(name, code, digits, verify)
        self.at = end

    def verify(self, name: str, code: Ask, digits: bool = False, verify: bool = True) -> None:
        """Compares a check code that was read with the bytes it should be."""
        data, start, end = self.bounds[name]
        found = data[start:end]
        try:
            wanted = code(self)
        except EVALUATION_ERRORS:
            self.notes.unchecked = self.notes.unchecked or verify
            return
        if found == wanted or (digits and found.upper() == wanted.upper()):
            return
        fault = FrameError("check", self.path + shown(name), self.wire(start), wanted.hex(" "), found.hex(" "))
        if not verify:
            self.notes.warnings.append(str(fault))
        elif self.notes.check is None:
            self.notes.check = fault

    def inner(self, name: str, size: int | Ask | None, choice: Any, behind: int | Ask = 0) -> None:
        """A frame inside this one: the first candidate that fits, or that is to be refused."""
        start = self.begin(name)
        raw = self.take(name, self.rest(behind, name) if size is None else self.ask(size, "length", name))
        for frame in choice.frames(raw):
            found: Examination = frame.examine(raw, self.ctx)
            fault = found.fault
            if fault is None or fault.refuse is not None:
                fields = found.fields if fault is None else found.error(frame.name).fields
                self.scopes[-1][name] = {frame.name: fields}
                self.show(name, start, frame.name)
                self.adopt(name, start, found)
                return
        self.scopes[-1][name] = {"unknown": {"data": raw}}
        self.show(name, start, raw)

    def adopt(self, name: str, start: int, inner: Examination) -> None:
        """Takes over what was found out about a frame inside; its fault comes behind the frame itself."""
        for path, first, last, value in inner.spans:
            span = f"{self.path}{name}.{path}", self.wire(start + first), self.wire(start + last), value
            self.spans.append(span)
        self.notes.warnings.extend(inner.notes.warnings)
        fault = inner.fault
        if fault is not None:
            self.turn += 1
            path, place = f"{name}.{fault.segment}", start + fault.offset
            self.note(fault.cause, path, place, fault.expected, fault.found, fault.refuse)

    # ---- what was read ------------------------------------------------------------------------------------

    def bytes_of(self, *names: str) -> bytes:
        """These segments in this order, each as it is inside its wrap; those that are not there count nothing."""
        return b"".join(data[start:end] for data, start, end in (self.bounds[name] for name in names))

    def bytes_from(self, name: str) -> bytes:
        """Everything from a segment up to here."""
        return self.data[self.bounds[name][1] : self.at]

    def room(self, *names: str) -> int:
        """Bytes these segments take."""
        return sum(end - start for _, start, end in (self.bounds[name] for name in names if name in self.bounds))


NEEDS = {"Examination": ("ExaminationState", "shown")}
IMPORTS = {"Examination": ("from collections.abc import Callable",)}

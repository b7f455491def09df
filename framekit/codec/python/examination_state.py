"""The state of a frame being read carefully: where reading stands, what was found, the first fault, parts of a frame.

Pasted into generated modules as the base of `examination`; so it imports nothing of framekit but the errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from framekit.codec.errors import FrameError

Ask = Callable[[Any], Any]
"""A function of the examination that works something out from what was read."""
Span = tuple[str, int, int, Any]
Opened = tuple[bytes, Sequence[int], str]
"""What is inside a wrap: the content, the place of each byte and of the end in the region, '' or the cause of a fault
(then the last place is where it is)."""

EVALUATION_ERRORS = (ValueError, LookupError, TypeError, ArithmeticError, AttributeError)
"""What working out an expression on damaged values can raise."""


class Stop(Exception):  # noqa: N818 - no error, a way out of a part that cannot be read on
    """What is left of this part of a frame cannot be read."""


class Nothing(dict[str, Any]):
    """What stands for a record that is not there: all in it is nothing, too."""

    def get(self, name: str, default: Any = None) -> Any:
        return self

    def __eq__(self, other: object) -> bool:
        return other is None or other is self

    __hash__ = None


class Notes:
    """The first fault and its turn, a wrong check code, whether one was not reached, and checks that only warn."""

    def __init__(self) -> None:
        self.first: FrameError | None = None
        self.turn = 0
        self.check: FrameError | None = None
        self.unchecked = False
        self.warnings: list[str] = []


class ExaminationState:
    """A frame being read carefully. `fields`, `spans` (path, first byte, byte behind the last, value) grow as it goes.

    `n["name"]` is a field by name, innermost record first; one that is left out is nothing, and the list
    around an item holds those before it. Places count in the present
    buffer; `wire` turns them into those on the wire, also inside wraps. `turn` counts segments, also those that take no
    bytes. `is_quiet`: the part that is read now has had its fault.
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
        self.left_out: dict[tuple[int, str], Any] = {}
        self.bounds: dict[str, tuple[bytes, int, int]] = {}
        self.turn = 0
        self.turns: dict[str, int] = {}
        self.spans: list[Span] = []
        self.notes = Notes()
        self.is_quiet = False

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
        """Fields and records that are not there are nothing."""
        scope = id(self.scopes[-1])
        self.left_out |= {(scope, name): None for name in names} | {(scope, name): Nothing() for name in records}

    # ---- the result ---------------------------------------------------------------------------------------

    @property
    def fault(self) -> FrameError | None:
        """What is wrong: a wrong check code before everything else. It is refused only if the check code is right."""
        if self.notes.first is not None and self.notes.unchecked:
            self.notes.first.refuse = None
        return self.notes.check or self.notes.first

    def error(self, frame: str) -> FrameError:
        """The fault with the fields that were read before it."""
        fault = self.fault or FrameError("value", frame, 0, "values that fit together")
        last = self.turn + 1 if fault is self.notes.check else self.notes.turn
        fault.fields = {name: value for name, value in self.fields.items() if self.turns.get(name, 0) < last}
        return fault

    def note(self, cause: str, segment: str, place: int, expected: str, found: str, refuse: int | None = None) -> None:
        """A fault; the first one in the frame counts."""
        if self.is_quiet:
            return
        place, turn = self.wire(place), self.turns.get(segment, self.turn)
        first = self.notes.first
        if first is None or (place, turn) < (first.offset, self.notes.turn):
            self.notes.turn = turn
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

    # ---- going on -----------------------------------------------------------------------------------------

    def begin(self, name: str) -> int:
        """The turn of the next segment; gives the place where it begins."""
        self.turn += 1
        self.turns[name] = self.turn
        return self.at

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

    def ask(self, what: int | Ask, cause: str, segment: str, refuse: int | None = None) -> Any:
        """The value of an expression; only a `value` may be no whole number. Raises Stop if it cannot be worked out."""
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
        """How many bytes there are up to the last `behind` ones. Raises Stop if they overlap what was read."""
        size = int(self.end - self.ask(behind, "length", segment) - self.at)
        if size < 0:
            raise self.stop("short", segment, "room for what follows", f"{size} bytes")
        return size

    def until_tail(self, mark: int) -> int:
        """How many bytes there are from the next byte `mark` on, which ends a body whatever is in it."""
        stop = self.data.find(mark, self.at, self.end)
        if stop < 0:
            raise self.stop("short", "tail", f"{mark:02X}", "none")
        return self.end - stop

    # ---- parts of a frame ---------------------------------------------------------------------------------

    @contextmanager
    def part(self, behind: int | Ask = 0, surplus: int | None = None, checks: bool = False) -> Iterator[None]:
        """A part with `behind` bytes behind it; however it goes, reading goes on there.

        `surplus`: the code for bytes left over. `checks`: there are check codes in it.
        """
        whole = self.end
        self.end = whole - self.ask(behind, "short", "frame")
        scopes, path = len(self.scopes), self.path
        try:
            yield
            if self.at < self.end:
                self.turn += 1
                self.note("surplus", "frame", self.at, "its end", f"{self.end - self.at} bytes more", surplus)
        except Stop:
            del self.scopes[scopes:]
            self.path = path
            self.notes.unchecked = self.notes.unchecked or checks
        self.at, self.end = self.end, whole

    @contextmanager
    def attempt(self, behind: int | Ask, checks: bool = False) -> Iterator[None]:
        """A part with `behind` bytes behind it, which are read all the same if the part cannot be."""
        start, whole = self.at, self.end
        tail = whole - self.ask(behind, "short", "frame")
        scopes, path = len(self.scopes), self.path
        try:
            yield
        except Stop:
            if tail < start:
                raise
            del self.scopes[scopes:]
            self.at, self.end, self.path = tail, whole, path
            self.notes.unchecked = self.notes.unchecked or checks

    @contextmanager
    def record(self, name: str) -> Iterator[None]:
        """Fields that make one value."""
        start = self.begin(name)
        fields: dict[str, Any] = {}
        self.scopes[-1][name] = fields
        outer, self.path = self.path, f"{self.path}{name}."
        self.scopes.append(fields)
        yield
        self.scopes.pop()
        self.path = outer
        self.bounds[name] = (self.data, start, self.at)

    def items(self, name: str, times: int | Ask | None, behind: int | Ask = 0) -> Iterator[int]:
        """Every item of a list of records; `times` None: as many as fit before the last `behind` bytes."""
        start = self.begin(name)
        items: list[dict[str, Any]] = []
        self.scopes[-1][name] = items
        outer, index = self.path, 0
        count = None if times is None else self.ask(times, "length", name)
        whole = self.end
        if count is None:
            self.end = start + self.rest(behind, name)
        while self.at < self.end if count is None else index < count:
            before = self.at
            items.append({})
            self.path = f"{outer}{name}[{index}]."
            self.scopes.append(items[-1])
            yield index
            self.scopes.pop()
            self.path = outer
            index += 1
            if self.at == before and not isinstance(times, int):
                raise self.stop("length", name, "items with bytes", "an empty one")
        self.end = whole
        self.bounds[name] = (self.data, start, self.at)

    @contextmanager
    def inside(
        self,
        name: str,
        size: int | Ask | None,
        open_up: Callable[[bytes], Opened],
        behind: int | Ask = 0,
        checks: bool = False,
    ) -> Iterator[None]:
        """The content of a wrap; `size` on the wire, None: up to the last `behind` bytes."""
        start = self.begin(name)
        raw = self.take(name, self.rest(behind, name) if size is None else self.ask(size, "short", name))
        plain, places, cause = open_up(raw)
        if cause:
            bad = start + places[-1]
            self.note(cause, name, bad, "wrapped content", raw[places[-1] :][:2].hex(" "))
        whole = self.data, self.at, self.end, self.places
        self.places = [self.wire(start + place) for place in places]
        self.data, self.at, self.end = plain, 0, len(plain)
        quiet, self.is_quiet = self.is_quiet, self.is_quiet or bool(cause)
        try:
            with self.part(checks=checks):
                yield
        finally:
            self.data, self.at, self.end, self.places = whole
            self.is_quiet = quiet


def shown(segment: str) -> str:
    """A segment's name, or its kind when it has none of its own."""
    return segment.split("_")[1] if segment.startswith("_") else segment


def hex_content(raw: bytes) -> Opened:
    """What hex digits stand for."""
    for place in range(0, len(raw), 2):
        if len(raw) < place + 2 or raw[place : place + 2].strip(b"0123456789ABCDEFabcdef"):
            return b"", [place], "digits"
    return bytes.fromhex(raw.decode("ascii")), range(0, len(raw) + 1, 2), ""


def doubled_content(raw: bytes, escape: int, embedded: tuple[bytes, ...] = ()) -> Opened:
    """Content without the second ones of doubled escape bytes, and without what is embedded in it."""
    plain, places, place = bytearray(), [], 0
    while place < len(raw):
        frame = next((frame for frame in embedded if raw.startswith(frame, place)), None)
        if frame is not None:
            place += len(frame)
            continue
        places.append(place)
        plain.append(raw[place])
        if raw[place] == escape:
            place += 1
            if raw[place : place + 1] != raw[place - 1 : place]:
                return b"", [place - 1], "constant"
        place += 1
    return bytes(plain), [*places, len(raw)], ""


NEEDS = {"ExaminationState": ("Notes", "Nothing", "Stop", "shown")}
IMPORTS = {
    "ExaminationState": (
        "from collections.abc import Iterable, Iterator, Sequence",
        "from contextlib import contextmanager",
    ),
}

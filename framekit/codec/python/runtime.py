"""Helpers that generated modules carry with them: pasted as they stand here, so each is on its own like those of `support`.

They may use each other (`NEEDS`), standard imports (`IMPORTS`) and the names every generated module has: `Any`,
`Context`, `FrameError`, `EncodeError`, `QUIET`, `LOST`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from framekit.codec.errors import EncodeError, FrameError

Context = Mapping[str, Any]

QUIET = -(1 << 40)
LOST = QUIET - 1


class Misfit(ValueError):
    """Something does not fit; what it is, is found out afterwards."""


class Defaults(dict[str, Any]):
    """What frames need beside their fields, with the definition's start values."""

    def __missing__(self, name: str) -> Any:
        raise KeyError(f"'{name}' has no default: give it in ctx, such as DEFAULTS | {{'{name}': ...}}")


class Frame(NamedTuple):
    """One frame's functions. `refuse`: the code it is always refused with."""

    name: str
    encode: Callable[..., bytes]
    decode: Callable[..., dict[str, Any]]
    measure: Callable[..., int]
    examine: Callable[..., Any]
    refuse: int | None = None


def attribute(value: Any, name: str) -> Any:
    """`value.name`: an entry of a mapping, something of an object that has fields, or the list of a list's attributes."""
    if isinstance(value, Mapping):
        return value[name]
    if isinstance(value, (list, tuple)):
        return [attribute(item, name) for item in value]
    return value.language_attribute(name)


class RangeTable(dict[Any, Any]):
    """A table some of whose keys are ranges: (first, last, value)."""

    def __init__(self, entries: Mapping[Any, Any], ranges: tuple[tuple[int, int, Any], ...]) -> None:
        super().__init__(entries)
        self.ranges = ranges

    def __missing__(self, key: Any) -> Any:
        for first, last, value in self.ranges:
            if isinstance(key, int) and first <= key <= last:
                return value
        raise KeyError(key)

    def __contains__(self, key: object) -> bool:
        in_range = isinstance(key, int) and any(first <= key <= last for first, last, _ in self.ranges)
        return in_range or super().__contains__(key)

    def get(self, key: Any, default: Any = None) -> Any:
        return self[key] if key in self else default


# ---- frames inside frames ----------------------------------------------------------------------------------


class Choice:
    """Frames that may stand at one place, in the order they are tried, told apart by one byte."""

    __slots__ = ("at", "cases", "everything", "others")

    def __init__(self, everything: tuple[Frame, ...], at: int = 0, cases: Any = None, others: Any = None) -> None:
        self.everything = everything
        self.at = at
        self.cases: dict[int, Any] = cases or {}
        self.others: Any = everything if others is None else others

    def frames(self, data: bytes | bytearray, start: int = 0, end: int | None = None) -> tuple[Frame, ...]:
        """The frames that the deciding byte allows; all, if it is not there."""
        place = start + self.at
        if place >= (len(data) if end is None else end):
            return self.everything
        found = self.cases.get(data[place], self.others)
        return found if type(found) is tuple else found.frames(data, start, end)


def decode_first(choice: Choice, data: bytes, ctx: Context) -> dict[str, Any]:
    """The first frame that fits, as `{name: fields}`. Raises FrameError if that frame is to be refused."""
    for frame in choice.frames(data):
        try:
            return {frame.name: frame.decode(data, ctx)}
        except FrameError as error:
            if error.refuse is not None:
                raise
    return {"unknown": {"data": data}}


def measure_first(choice: Choice, data: bytes | bytearray, start: int, end: int, ctx: Context, seen: int = 0) -> int:
    """How long the frame is that stands here: the first that is complete and fits, else what is wanted at least."""
    want, quiet, lost = 0, False, False
    candidates = choice.frames(data, start, end)
    for frame in candidates:
        size = frame.measure(data, start, end, ctx, seen)
        if size > 0:
            if fits(frame, bytes(data[start : start + size]), ctx):
                return size
        elif size == 0:
            continue
        elif size > QUIET:
            want = max(want, size) if want else size
        else:
            quiet, lost = quiet or size == QUIET, lost or size == LOST
    return want or (QUIET if quiet else LOST if lost else 0)


def fits(frame: Frame, data: bytes, ctx: Context) -> bool:
    """Whether the bytes are this frame, good or to be refused."""
    try:
        frame.decode(data, ctx)
    except FrameError as error:
        return error.refuse is not None
    return True


def encode_one(choice: Choice, value: Any, name: str, ctx: Context) -> bytes:
    """The bytes of `{frame: fields}`. Raises EncodeError."""
    if not isinstance(value, Mapping) or len(value) != 1:
        raise EncodeError(name, f"'{name}' must be one frame as {{name: fields}}")
    ((wanted, fields),) = value.items()
    if wanted == "unknown":
        return bytes(fields["data"])
    for frame in choice.everything:
        if frame.name == wanted:
            try:
                return frame.encode(fields, ctx)
            except EncodeError as error:
                raise EncodeError(f"{name}.{error.field}" if error.field else name, str(error)) from None
    raise EncodeError(name, f"'{name}' cannot be a '{wanted}'")


# ---- doubled escape bytes ----------------------------------------------------------------------------------


def end_of_region(data: bytes | bytearray, at: int, escape: int) -> int:
    """The place of the first escape byte that is not doubled. Raises ValueError if there is none."""
    place = find_region_end(data, at, len(data), escape)
    if place < 0:
        raise ValueError("the region does not end")
    return place


def find_region_end(data: bytes | bytearray, at: int, end: int, escape: int, seen: int = 0) -> int:
    """The place of the first escape byte before `end` that is not doubled; -1 if it is not there yet.

    `seen`: up to there nothing was found before.
    """
    place = max(at, seen)
    while place > at and data[place - 1] == escape:
        place -= 1  # escape bytes are paired from the first one of their row
    while True:
        place = data.find(escape, place, end)
        if place < 0 or place + 1 >= end:
            return -1
        if data[place + 1] != escape:
            return place
        place += 2


def end_of_doubled(data: bytes | bytearray, at: int, escape: int, size: int, end: int | None = None) -> int:
    """The place behind `size` plain bytes. Raises ValueError if an escape byte is not doubled, IndexError if too few."""
    end = len(data) if end is None else end
    for _ in range(size):
        if at >= end:
            raise IndexError("more bytes are wanted")
        if data[at] == escape:
            at += 1
            if at >= end:
                raise IndexError("more bytes are wanted")
            if data[at] != escape:
                raise ValueError("an escape byte is not doubled")
        at += 1
    return at


# ---- values that cannot be sent ----------------------------------------------------------------------------


class Rule(NamedTuple):
    """What a value must be. `least` and `most` limit numbers, and the length of texts, bytes and lists.

    `names` (name → number) may be given instead of the number, `only` those. A number is a multiple of `unit`. `inside`:
    the rules of a mapping or of the items of a list ('' for items that are plain values).
    """

    type: str
    least: int | None = None
    most: int | None = None
    needed: bool = False
    names: Any = ()
    only: bool = False
    unit: int = 1
    inside: Mapping[str, Any] | None = None


Rules = Mapping[str, Rule]


def check_given(values: Context, rules: Rules, computed: Context, path: str = "") -> None:
    """Every value must be known, and what is computed must be as computed. Raises EncodeError."""
    for name in values:
        if name not in rules:
            raise EncodeError(path + name, f"there is no '{path}{name}' in this frame")
    for name, right in computed.items():
        if name in values:
            given = values[name]
            if rules[name].names and isinstance(given, str):
                given = rules[name].names.get(given, given)
            if given != right:
                raise EncodeError(path + name, f"'{path}{name}' is computed as {right!r}, not {given!r}")


def encode_error(values: Any, rules: Rules, error: Exception) -> EncodeError:
    """What is wrong with the values, in one sentence."""
    if isinstance(error, EncodeError):
        return error
    found = find_misfit(values, rules, "") if isinstance(values, Mapping) else None
    if found is not None:
        return found
    if isinstance(error, KeyError):
        return EncodeError("", f"{error.args[0]!r} is needed to build this frame: give it in ctx")
    return EncodeError("", f"the values do not fit into this frame{f': {error}' if str(error) else ''}")


def find_misfit(values: Context, rules: Rules, path: str) -> EncodeError | None:
    """The first value that breaks its rule."""
    for name in values:
        if name not in rules:
            return EncodeError(path + name, f"there is no '{path}{name}' in this frame")
    for name, rule in rules.items():
        if name in values:
            found = misfit_of(values[name], rule, path + name)
        else:
            found = EncodeError(path + name, f"'{path}{name}' is missing") if rule.needed else None
        if found is not None:
            return found
    return None


def misfit_of(value: Any, rule: Rule, name: str) -> EncodeError | None:
    """What is wrong with one value."""
    if rule.names and (isinstance(value, str) or rule.only):
        if value in rule.names or value in rule.names.values():
            return None
        return EncodeError(name, f"'{name}' is one of {', '.join(rule.names)}, not {value!r}")
    kinds: dict[str, Any] = {"number": int, "float": (int, float), "text": str, "bytes": (bytes, bytearray)}
    kinds |= {"list": (list, tuple), "mapping": Mapping, "any": object}
    if not isinstance(value, kinds[rule.type]):
        return EncodeError(name, f"'{name}' must be a {rule.type}, not {type(value).__name__}")
    if rule.type in ("number", "float"):
        size, what = value, f"'{name}' is {value}"
    else:
        size = len(value) if rule.type in ("text", "bytes", "list") else 0
        what = f"'{name}' has a length of {size}"
    if rule.least is not None and size < rule.least:
        return EncodeError(name, f"{what}, less than {rule.least}")
    if rule.most is not None and size > rule.most:
        return EncodeError(name, f"{what}, more than {rule.most}")
    if rule.unit != 1 and value % rule.unit:
        return EncodeError(name, f"{what}, no multiple of {rule.unit}")
    if rule.type == "text" and any(ord(sign) > 255 for sign in value):
        return EncodeError(name, f"'{name}' has characters that are no bytes")
    return None if rule.inside is None else misfit_inside(value, rule.inside, name)


def misfit_inside(value: Any, rules: Rules, name: str) -> EncodeError | None:
    """What is wrong in a mapping or in the items of a list."""
    if isinstance(value, Mapping):
        return find_misfit(value, rules, f"{name}.")
    for place, item in enumerate(value):
        path = f"{name}[{place}]"
        if "" in rules:
            found = misfit_of(item, rules[""], path)
        elif isinstance(item, Mapping):
            found = find_misfit(item, rules, f"{path}.")
        else:
            found = EncodeError(path, f"'{path}' must be a mapping of fields")
        if found is not None:
            return found
    return None


def check_size(name: str, found: int, wanted: int) -> None:
    """A value must be as long as another one says. Raises EncodeError."""
    if found != wanted:
        raise EncodeError(name, f"'{name}' has a length of {found}, it must be {wanted}")


def ends_here(decode: Callable[..., Any], data: bytes, ctx: Context, place: int) -> bool:
    """Whether everything from `place` on fits, so that the frame ends here."""
    try:
        decode(data, ctx)
    except FrameError as error:
        return error.cause != "check" and error.offset < place
    return True


def measure_hex(measure: Callable[..., int], data: bytes | bytearray, at: int, end: int, ctx: Context) -> int:
    """How many hex digits content takes whose length `measure` finds in the bytes they stand for."""
    digits = bytes(data[at:end])
    good = len(digits) - len(digits.lstrip(b"0123456789ABCDEFabcdef"))
    plain = bytes.fromhex(digits[: good - good % 2].decode("ascii"))
    size = measure(plain, 0, len(plain), ctx)
    if size > 0:
        return 2 * size
    if size <= QUIET:
        return size
    return LOST if good < len(digits) else 2 * size + good % 2


NEEDS: dict[str, tuple[str, ...]] = {
    "decode_first": ("Choice", "Frame"),
    "measure_first": ("Choice", "Frame", "fits"),
    "fits": ("Frame",),
    "encode_one": ("Choice", "Frame"),
    "Choice": ("Frame",),
    "end_of_region": ("find_region_end",),
    "check_given": ("Rule",),
    "encode_error": ("find_misfit",),
    "find_misfit": ("Rule", "misfit_of"),
    "misfit_of": ("Rule", "misfit_inside"),
    "misfit_inside": ("find_misfit", "misfit_of"),
}
"""The names of this module that a helper uses itself."""

IMPORTS: dict[str, tuple[str, ...]] = {
    "Frame": ("from collections.abc import Callable", "from typing import NamedTuple"),
    "Rule": ("from typing import NamedTuple",),
}
"""The import lines that a helper's source stands on."""

"""Helpers that generated modules carry with them: inlined as they stand here, each on its own like those of `support`.

They may use each other, standard imports and the names every generated module has: `Any`,
`Context`, `FrameError`, `EncodeError`, `QUIET`, `LOST`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from decimal import Decimal
from struct import Struct
from typing import Any, NamedTuple

from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.support import Unfit

Context = Mapping[str, Any]
Reads = Callable[..., dict[str, Any]]

QUIET = -(1 << 40)
LOST = QUIET - 1


class Mismatch(ValueError):  # noqa: N818 - says no more than that
    """Something does not fit; what it is, is found out afterwards."""


class Wrong(Mismatch):
    """Nothing but a check code, a constant or the limit of a wrap does not fit: the frame is not refused, but bad."""


class Defaults(dict[str, Any]):
    """What frames need beside their fields, with the definition's start values."""

    def __missing__(self, name: str) -> Any:
        raise KeyError(f"'{name}' has no default: give it in ctx, such as DEFAULTS | {{'{name}': ...}}")


def attribute(value: Any, name: str) -> Any:
    """`value.name`: an entry of a mapping, something an object offers, or the list of a list's attributes.

    What is nothing has nothing.
    """
    if isinstance(value, Mapping):
        return value[name]
    if isinstance(value, (list, tuple)):
        return [attribute(item, name) for item in value]
    return None if value is None else value.language_attribute(name)


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
        try:
            return self[key]
        except KeyError:
            return default


class Structs(dict[int, Struct]):
    """Structs for lists, by the number of values in them; those of long lists are made each time."""

    def __init__(self, before: str, code: str) -> None:
        self.before = before
        self.code = code

    def __missing__(self, count: int) -> Struct:
        found = Struct(f"{self.before}{count}{self.code}")
        if count <= 256:
            self[count] = found
        return found


class Packs(dict[int, Callable[..., bytes]]):
    """What packs lists, by the number of values in them: to call these takes a sixth less than `pack` of a struct."""

    def __init__(self, before: str, code: str) -> None:
        self.before = before
        self.code = code

    def __missing__(self, count: int) -> Callable[..., bytes]:
        found = Struct(f"{self.before}{count}{self.code}").pack
        if count <= 256:
            self[count] = found
        return found


def without_none(values: Context) -> dict[str, Any]:
    """The values that are not None: those that were given."""
    return {name: value for name, value in values.items() if value is not None}


# ---- ends ---------------------------------------------------------------------------------------------------


def ends_here(decode: Callable[..., Any], data: bytes, ctx: Context, place: int) -> bool:
    """Whether everything from `place` on fits, so that the frame ends here."""
    try:
        decode(data, ctx)
    except FrameError as error:
        return error.cause != "check" and error.offset < place
    return True


def content_of(diagnose: Callable[..., Any], data: bytes, ctx: Context) -> Any:
    """The fields of a frame of which so much has come; a line remembers them while more of it comes."""
    remembered = getattr(ctx, "remembered", None)
    if remembered is None:
        return diagnose(data, ctx).fields
    found = remembered.get(diagnose)
    if found is None or found[0] is not ctx or found[1] != data:
        found = remembered[diagnose] = ctx, data, diagnose(data, ctx).fields
    return found[2]


def measure_hex(measure: Callable[..., int], data: bytes | bytearray, at: int, end: int, ctx: Context) -> int:
    """How many hex digits content takes whose length `measure` finds in the bytes they stand for, and one more.

    So that no digits differ from no such content; `measure` finds a byte before the content for the same reason.
    """
    digits = bytes(data[at:end])
    good = len(digits) - len(digits.lstrip(b"0123456789ABCDEFabcdef"))
    plain = b"\0" + bytes.fromhex(digits[: good - good % 2].decode("ascii"))
    size = measure(plain, 0, len(plain), ctx)
    if size > 0:
        return 2 * size - 1
    if size <= QUIET:
        return size
    return LOST if good < len(digits) else 2 * size + good % 2


# ---- regions in which every escape byte is doubled -----------------------------------------------------------


def end_of_region(data: bytes | bytearray, at: int, escape: int, embedded: tuple[bytes, ...] = ()) -> int:
    """The place of the first escape byte that is not doubled. Raises ValueError if there is none."""
    place = find_region_end(data, at, len(data), escape, 0, embedded)
    if place < 0:
        raise ValueError("the region does not end")
    return place


def find_region_end(
    data: bytes | bytearray, at: int, end: int, escape: int, seen: int = 0, embedded: tuple[bytes, ...] = ()
) -> int:
    """The place of the first escape byte before `end` that is not doubled; -1 if it is not there yet.

    `seen`: up to there nothing was found before. `embedded`: what may stand in the region all the same.
    """
    place = at if seen < at else seen
    if place > at and data[place - 1] == escape:
        if data.count(escape, place, end) == end - place:
            return -1  # nothing but escape bytes yet: no need to count them anew for each that comes
        while place > at and data[place - 1] == escape:
            place -= 1  # they are paired from the first one of their row
    while True:
        place = data.find(escape, place, end)
        if place < 0 or place + 1 >= end:
            return -1
        behind = data[place + 1]
        if behind == escape:
            place += 2
            continue
        for frame in embedded:
            if frame[1] == behind:
                place += len(frame)
                break
        else:
            return place


def without_embedded(data: bytes, escape: int, embedded: tuple[bytes, ...]) -> bytes:
    """Content of a region without the frames that stand in it."""
    for frame in embedded:
        if frame in data:
            break
    else:
        return data
    parts, start, place = [], 0, data.find(escape)
    while place >= 0:
        found = next((frame for frame in embedded if data.startswith(frame, place)), None)
        if found is not None:
            parts.append(data[start:place])
            start = place + len(found)
            place = data.find(escape, start)
        else:
            place = data.find(escape, place + (2 if data[place + 1 : place + 2] == bytes((escape,)) else 1))
    return b"".join(parts) + data[start:]


def end_of_stuffed(data: bytes | bytearray, at: int, escape: int, size: int, end: int | None = None) -> int:
    """The place behind `size` plain bytes. Raises ValueError for an escape byte not doubled, IndexError if too few."""
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


# ---- frames of which one stands somewhere; which, and by which byte they are told apart, the generator writes


class Frame(NamedTuple):
    """One frame's functions. `refuse`: the code it is always refused with; `extent`: None where it is `measure`."""

    name: str
    encode: Callable[..., bytes]
    decode: Callable[..., dict[str, Any]]
    measure: Callable[..., int]
    diagnose: Callable[..., Any]
    refuse: int | None = None
    extent: Callable[..., int] | None = None


class Choice:
    """Frames that may stand at one place, in the order they are tried, told apart by one byte.

    `named` holds them by name, `encoders` what builds them. `readers`: by the deciding byte, names with decoders in the
    order they are tried, or another choice; `absent`: those for when that byte is not there. `likely`: by the deciding
    byte, the first name and decoder where it leaves one or two; `sole`: how long the only frame is that it allows,
    None where there are several.
    """

    __slots__ = (
        "absent", "at", "cases", "encoders", "everything", "likely", "named", "others", "readers", "sole",
    )  # fmt: skip

    def __init__(self, everything: tuple[Frame, ...], at: int = 0, cases: Any = None, others: Any = None) -> None:
        self.everything = everything
        self.at = at
        self.cases: dict[int, Any] = cases or {}
        self.others: Any = everything if others is None else others
        self.named = {frame.name: frame for frame in everything}
        self.encoders = {"unknown": encode_unknown, **{frame.name: frame.encode for frame in everything}}
        self.absent = readers_of(self.others)
        self.readers = [self.absent] * 256
        self.sole = [measure_of(self.others)] * 256
        for byte, found in self.cases.items():
            self.readers[byte] = readers_of(found)
            self.sole[byte] = measure_of(found)
        self.likely = [found[0] if type(found) is tuple and 1 <= len(found) <= 2 else None for found in self.readers]

    def frames(self, data: bytes | bytearray, start: int = 0, end: int | None = None) -> tuple[Frame, ...]:
        """The frames that the deciding byte allows; all, if it may still come, which it cannot without an `end`."""
        place = start + self.at
        if end is not None and place >= end:
            return self.everything
        found = self.others if place >= len(data) else self.cases.get(data[place], self.others)
        return found if type(found) is tuple else found.frames(data, start, end)


def readers_of(found: Any) -> Any:
    """Names and decoders of a row of frames; a choice stays what it is."""
    return tuple((frame.name, frame.decode) for frame in found) if type(found) is tuple else found


def measure_of(found: Any) -> Any:
    """What measures a row of frames if it is one or none."""
    if found == ():
        return no_frame
    return found[0].measure if type(found) is tuple and len(found) == 1 else None


def no_frame(data: bytes | bytearray, start: int, end: int, ctx: Context, seen: int = 0) -> int:
    """What measures where no frame may stand."""
    return 0


def fused_readers(choice: Choice, readers: dict[str, Any]) -> list[Any]:
    """By the deciding byte: what reads the frame that is likely together with the one around it; None: nothing does."""
    return [None if one is None else readers.get(one[0]) for one in choice.likely]


def decode_first(choice: Choice, data: bytes, ctx: Context, mismatch: Exception | None = None) -> dict[str, Any]:
    """The first frame that fits, as `{name: fields}`. Raises FrameError if that frame is to be refused.

    `mismatch`: what the likely frame has said, if that was read already.
    """
    found: Any = choice
    while type(found) is Choice:
        found = found.readers[data[found.at]] if found.at < len(data) else found.absent
    if isinstance(mismatch, FrameError):
        if mismatch.refuse is not None:
            raise mismatch
        found = found[1:]
    for name, decode in found:
        try:
            return {name: decode(data, ctx)}
        except FrameError as error:
            if error.refuse is not None:
                raise
    return {"unknown": {"data": data}}


def measure_first(
    choice: Choice,
    data: bytes | bytearray,
    start: int,
    end: int,
    ctx: Context,
    seen: int = 0,
    whole: bool = False,
    behind: int = 0,
    reads: bool = True,
) -> int:
    """How long the frame is that stands here: the first that fits, else what is wanted at least, with what is `behind`.

    While one wants more, none behind it is taken: how the bytes come makes no difference; but no more is wanted than
    that one takes, as the next byte may tell that it is not the first. `whole`: no more come. Without `reads` a frame
    that is complete is believed to fit.
    """
    want, quiet, lost, other = 0, False, False, 0
    for frame in choice.frames(data, start, end):
        size = frame.measure(data, start, end, ctx, seen)
        if size > 0:
            if (whole or not want) and (not reads or fits(frame, bytes(data[start : start + size]), ctx)):
                return size
            other = size if not other else min(other, size)
        elif size > QUIET:
            if size:
                want = max(want, size) if want else size
        else:
            quiet, lost = quiet or size == QUIET, lost or size == LOST
    if want:
        return max(want - behind, min(end - start - other - behind, -1)) if other else want - behind
    return QUIET if quiet else LOST if lost else 0


def extent_first(
    choice: Choice, data: bytes | bytearray, start: int, end: int, ctx: Context, seen: int = 0, behind: int = 0
) -> int:
    """What `measure_first` says if a frame fits that is complete: none is read for that."""
    place = start + choice.at
    measure = choice.sole[data[place]] if place < end else None
    if measure is not None:
        size: int = measure(data, start, end, ctx, seen)
        return size - behind if QUIET < size < 0 else size
    return measure_first(choice, data, start, end, ctx, seen, behind=behind, reads=False)


def fits(frame: Frame, data: bytes, ctx: Context) -> bool:
    """Whether the bytes are this frame, good or to be refused."""
    try:
        frame.decode(data, ctx)
    except FrameError as error:
        return error.refuse is not None
    return True


def encode_one(choice: Choice, value: Any, name: str, ctx: Context) -> bytes:
    """The bytes of `{frame: fields}`. Raises EncodeError."""
    # a dict is by far the most frequent, and asking whether something is a Mapping costs as much as the rest
    one = (type(value) is dict or isinstance(value, Mapping)) and len(value) == 1
    ((wanted, fields),) = value.items() if one else (("", None),)
    if type(fields) is not dict and not isinstance(fields, Mapping):
        raise EncodeError(name, f"'{name}' must be one frame as {{name: fields}}")
    frame = choice.named.get(wanted)
    if frame is not None:
        try:
            return frame.encode(fields, ctx)
        except EncodeError as error:
            path = f"{name}.{wanted}."
            more = tuple(path + one for one in error.more)
            raise EncodeError(path + error.field if error.field else name, str(error), more) from None
    if wanted == "unknown":
        return encode_unknown(fields, ctx)
    raise EncodeError(name, f"'{name}' cannot be a '{wanted}'")


def encode_unknown(fields: Any, ctx: Context) -> bytes:
    """Return the bytes of a frame inside that no definition fits, or that is encoded already: its `data`."""
    return bytes(b"" + fields["data"])


def encode_nested(level: Frame, value: Any, name: str, ctx: Context) -> bytes:
    """The bytes of a layout that stands in itself, one level deeper. Raises EncodeError."""
    if not isinstance(value, Mapping):
        raise EncodeError(name, f"'{name}' must be a mapping of fields")
    try:
        return level.encode(value, ctx)
    except EncodeError as error:
        more = tuple(f"{name}.{one}" for one in error.more)
        raise EncodeError(f"{name}.{error.field}" if error.field else name, str(error), more) from None


# ---- why values cannot be sent: asked by encoders when something went wrong ---------------------------------


class Rule(NamedTuple):
    """What a value must be. `least` and `most` limit numbers, and the length of texts, bytes and lists.

    `names` (name → number) may be given instead of the number, `only` those. A number is a multiple of `unit`.
    `inside`: the rules of a mapping or of the items of a list ('' for items that are plain values). `fits`: raises
    ValueError for a value that cannot be written, with the reason.
    """

    type: str
    least: int | None = None
    most: int | None = None
    needed: bool = False
    names: Any = ()
    only: bool = False
    unit: int = 1
    inside: Any = None
    fits: Any = None


Rules = Mapping[str, Rule]


def check_given(
    values: Context,
    rules: Rules,
    computed: Context,
    path: str = "",
    elsewhere: tuple[str, ...] = (),
    absent: tuple[str, ...] = (),
) -> None:
    """Every value must be known, and what is computed must be as computed.

    `elsewhere`: names of cases not taken. `absent`: names of what is not there; None may be given for them. Raises
    EncodeError.
    """
    if elsewhere or not values.keys() <= rules.keys():
        for name in values:
            if name not in rules or (name in elsewhere and values[name] is not None):
                raise EncodeError(f"{path}{name}", f"there is no '{path}{name}' in this frame")
    for name in absent:
        if values.get(name) is not None:
            raise EncodeError(path + name, f"'{path}{name}' is not part of this frame, but {values[name]!r} is given")
    for name, right in computed.items():
        if name in values and name not in absent:
            given = values[name]
            if rules[name].names and isinstance(given, str):
                given = rules[name].names.get(given, given)
            if given != right:
                raise EncodeError(path + name, f"'{path}{name}' is computed as {right!r}, not {given!r}")


def encode_error(values: Any, rules: Rules, error: Exception) -> EncodeError:
    """What is wrong with the values, in one sentence."""
    if isinstance(error, EncodeError):
        return error
    found = find_mismatch(values, rules, "") if isinstance(values, Mapping) else None
    if found is not None:
        return found
    missing = path_of(error.args[0], rules) if isinstance(error, KeyError) else None
    if missing is not None:
        return EncodeError(missing, f"'{missing}' is missing")
    if isinstance(error, KeyError) and isinstance(error.args[0], str):
        name = error.args[0]
        return EncodeError("", name if " " in name else f"'{name}' is needed to build this frame: give it in ctx")
    why = str(error) if isinstance(error, Unfit) else "what is computed from them cannot be worked out or sent"
    return EncodeError("", f"the values do not fit into this frame: {why}")


def read_back(data: bytes, values: Any, decode: Callable[..., Any], ctx: Any, texts: Any) -> bytes:
    """The bytes of a frame in which texts end before one of several bytes, and others stand around these texts.

    `texts`: the path of each, and the bytes in words. Raises EncodeError where one would be read with another end.
    """
    try:
        found = decode(data, ctx)
    except FrameError:
        found = {}
    for path, stops in texts:
        if not is_read_back(values, found, path):
            field = ".".join(path)
            raise EncodeError(field, f"{field!r} ends before {stops}, and something else follows it")
    return data


def is_read_back(given: Any, found: Any, path: Any) -> bool:
    """Whether what is given at a path is what has been found there; also where nothing is given."""
    if isinstance(given, (list, tuple)) and isinstance(found, list):
        return len(given) == len(found) and all(map(is_read_back, given, found, [path] * len(given)))
    if not path:
        if isinstance(given, str) or isinstance(found, (str, list)):
            return bool(given == found)
        return bool(Decimal(str(given)) == Decimal(str(found)))
    name, rest = path[0], path[1:]
    return name not in given or (name in found and is_read_back(given[name], found[name], rest))


def path_of(name: Any, rules: Rules) -> str | None:
    """The path of the value of that name, None if there is none."""
    if name in rules:
        return str(name)
    for outer, rule in rules.items():
        inner = path_of(name, rule.inside) if rule.inside else None
        if inner is not None:
            return f"{outer}.{inner}"
    return None


def find_mismatch(values: Context, rules: Rules, path: str) -> EncodeError | None:
    """The first value that breaks its rule, or, if that is one that is missing, all that are."""
    for name in values:
        if name not in rules:
            return EncodeError(f"{path}{name}", f"there is no '{path}{name}' in this frame")
    for name, rule in rules.items():
        if name in values:
            found = mismatch_of(values[name], rule, path + name)
        elif rule.needed:
            found = missing_error([one for one in rules if rules[one].needed and one not in values], path)
        else:
            found = None
        if found is not None:
            return found
    return None


def missing_error(names: list[str], path: str) -> EncodeError | None:
    """Values that are not there."""
    if not names:
        return None
    *some, last = [f"'{path}{name}'" for name in names]
    verb = f"{', '.join(some)} and {last} are" if some else f"{last} is"
    return EncodeError(path + names[0], f"{verb} missing", tuple(path + name for name in names[1:]))


def mismatch_of(value: Any, rule: Rule, name: str) -> EncodeError | None:
    """What is wrong with one value."""
    if rule.names and (isinstance(value, str) or (rule.only and isinstance(value, (int, float)))):
        if value in rule.names or value in rule.names.values():
            return None
        return EncodeError(name, f"'{name}' is one of {', '.join(rule.names)}, not {value!r}")
    kinds: dict[str, Any] = {"number": int, "float": (int, float), "text": str, "bytes": (bytes, bytearray)}
    kinds |= {"digits": (bytes, bytearray), "list": (list, tuple), "mapping": Mapping, "any": object}
    kinds["decimal"] = object  # what is none does not fit
    if not isinstance(value, kinds[rule.type]):
        return EncodeError(name, f"'{name}' {other_kind(value, rule)}")
    if rule.fits is not None:
        try:
            rule.fits(value)
        except ValueError as error:
            return EncodeError(name, f"'{name}': {error}")
    if rule.type in ("number", "float", "decimal"):
        size, what = value, f"'{name}' is {value}"
    else:
        size = len(value) if rule.type in ("text", "bytes", "digits", "list") else 0
        what = f"'{name}' has a length of {size}"
    if size is None:
        return None
    if rule.least is not None and size < rule.least:
        return EncodeError(name, f"{what}, less than {rule.least}")
    if rule.most is not None and size > rule.most:
        return EncodeError(name, f"{what}, more than {rule.most}")
    if rule.unit != 1 and value % rule.unit:
        return EncodeError(name, f"{what}, no multiple of {rule.unit}")
    if rule.type == "digits" and (size % 2 or value.strip(b"0123456789ABCDEFabcdef")):
        return EncodeError(name, f"'{name}' is not made of pairs of hex digits")
    if rule.type == "text" and any(ord(sign) > 255 for sign in value):
        return EncodeError(name, f"'{name}' has characters that are no bytes")
    return None if rule.inside is None else mismatch_inside(value, rule.inside, name)


def other_kind(value: Any, rule: Rule) -> str:
    """What is said of a value that is of no kind which its rule takes."""
    words = {"number": "a whole number", "float": "a number", "text": "text", "list": "a list", "mapping": "a mapping"}
    wanted, found = f"must be {words.get(rule.type, 'bytes')}", type(value).__name__
    if rule.type == "number" and found in ("float", "Decimal"):
        fractions = "a field has fractions by scale:, decimals: or a float as its type"
        return f"{wanted}, and {value} is a {found} – round it; {fractions}"
    return f"{wanted}, not {found}"


def mismatch_inside(value: Any, rules: Rules, name: str) -> EncodeError | None:
    """What is wrong in a mapping or in the items of a list."""
    if isinstance(value, Mapping):
        return find_mismatch(value, rules, f"{name}.")
    for place, item in enumerate(value):
        path = f"{name}[{place}]"
        if "" in rules:
            found = mismatch_of(item, rules[""], path)
        elif isinstance(item, Mapping):
            found = find_mismatch(item, rules, f"{path}.")
        else:
            found = EncodeError(path, f"'{path}' must be a mapping of fields")
        if found is not None:
            return found
    return None


def needed(values: Context, name: str, path: str) -> Any:
    """A value of a record that has to be there. Raises EncodeError."""
    if name not in values:
        raise EncodeError(path + name, f"'{path}{name}' is missing")
    return values[name]


def check_size(name: str, found: int, wanted: int | None) -> None:
    """A value must be as long as another one says. Raises EncodeError."""
    if wanted is None:
        raise EncodeError(name, f"the size of '{name}' cannot be told: a value it is worked out from is not there")
    if found != wanted:
        raise EncodeError(name, f"'{name}' has a length of {found}, it must be {wanted}")

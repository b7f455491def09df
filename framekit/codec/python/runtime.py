"""Implement the helpers of generated modules, which contain copies of their source, as of `support`.

They may use each other, standard imports, and the names that every generated module defines: `Any`, `Context`,
`FrameError`, `EncodeError`, `QUIET`, `LOST`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from decimal import Decimal
from struct import Struct
from typing import Any, NamedTuple

from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.support import Unfit

Context = Mapping[str, Any]
"""Values of the names that frames read from outside."""
Reads = Callable[..., dict[str, Any]]
"""A function that decodes a frame."""

QUIET = -(1 << 40)
"""The result of measuring for a frame that only silence ends."""
LOST = QUIET - 1
"""The result of measuring for a frame whose end cannot be found."""


class Mismatch(ValueError):  # noqa: N818 - carries no information
    """Raised if a value or bytes do not fit; a later second look determines the fault."""


class Wrong(Mismatch):
    """Raised if only a check code, a constant or the limit of a wrap is wrong: the frame is bad, but not refused."""


class Defaults(dict[str, Any]):
    """The values that frames need in addition to their fields, with the definition's start values."""

    def __missing__(self, name: str) -> Any:
        raise KeyError(f"'{name}' has no default: give it in ctx, such as DEFAULTS | {{'{name}': ...}}")


def attribute(value: Any, name: str) -> Any:
    """Return `value.name`: an entry of a mapping, an attribute of an object, or the list of the items' attributes.

    The attributes of None are None.
    """
    if isinstance(value, Mapping):
        return value[name]
    if isinstance(value, (list, tuple)):
        return [attribute(item, name) for item in value]
    return None if value is None else value.language_attribute(name)


class RangeTable(dict[Any, Any]):
    """A table in which some keys are ranges: (first, last, value)."""

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
    """Structs for lists, by the number of values; those for long lists are not cached."""

    def __init__(self, before: str, code: str) -> None:
        self.before = before
        self.code = code

    def __missing__(self, count: int) -> Struct:
        found = Struct(f"{self.before}{count}{self.code}")
        if count <= 256:
            self[count] = found
        return found


class Packs(dict[int, Callable[..., bytes]]):
    """Pack methods for lists, by the number of values; calling them takes a sixth less time than `Struct.pack`."""

    def __init__(self, before: str, code: str) -> None:
        self.before = before
        self.code = code

    def __missing__(self, count: int) -> Callable[..., bytes]:
        found = Struct(f"{self.before}{count}{self.code}").pack
        if count <= 256:
            self[count] = found
        return found


def without_none(values: Context) -> dict[str, Any]:
    """Return the values that are not None, which are the given values."""
    return {name: value for name, value in values.items() if value is not None}


# ---- ends ---------------------------------------------------------------------------------------------------


def ends_here(decode: Callable[..., Any], data: bytes, ctx: Context, place: int) -> bool:
    """Return whether the bytes from `place` on fit, so that the frame ends here."""
    try:
        decode(data, ctx)
    except FrameError as error:
        return error.cause != "check" and error.offset < place
    return True


def content_of(diagnose: Callable[..., Any], data: bytes, ctx: Context) -> Any:
    """Return the fields of an incomplete frame; a receiver's context caches them until more bytes arrive."""
    remembered = getattr(ctx, "remembered", None)
    if remembered is None:
        return diagnose(data, ctx).fields
    found = remembered.get(diagnose)
    if found is None or found[0] is not ctx or found[1] != data:
        found = remembered[diagnose] = ctx, data, diagnose(data, ctx).fields
    return found[2]


def measure_hex(measure: Callable[..., int], data: bytes | bytearray, at: int, end: int, ctx: Context) -> int:
    """Return the number of hex digits of a content plus one; `measure` finds its length in the decoded bytes.

    The added one distinguishes empty content from missing content; for the same reason `measure` sees a byte before the
    content.
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
    """Return the offset of the first escape byte that is not doubled. Raises ValueError if none occurs."""
    place = find_region_end(data, at, len(data), escape, 0, embedded)
    if place < 0:
        raise ValueError("the region does not end")
    return place


def find_region_end(
    data: bytes | bytearray, at: int, end: int, escape: int, seen: int = 0, embedded: tuple[bytes, ...] = ()
) -> int:
    """Return the offset of the first escape byte before `end` that is not doubled; -1 if it has not arrived yet.

    `seen`: the bytes before it were searched earlier. `embedded`: frames that may occur in the region.
    """
    place = at if seen < at else seen
    if place > at and data[place - 1] == escape:
        if data.count(escape, place, end) == end - place:
            return -1  # only escape bytes so far: avoid recounting them for each new byte
        while place > at and data[place - 1] == escape:
            place -= 1  # pairs are counted from the first escape byte of a run
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
    """Return the content of a region without its embedded frames."""
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
    """Return the offset after `size` plain bytes.

    Raises ValueError for an escape byte that is not doubled, IndexError for missing bytes.
    """
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


# ---- candidates for an inner frame; the generator writes their order and the deciding byte


class Frame(NamedTuple):
    """The functions of a frame."""

    name: str
    encode: Callable[..., bytes]
    decode: Callable[..., dict[str, Any]]
    measure: Callable[..., int]
    diagnose: Callable[..., Any]
    refuse: int | None = None
    """The code with which it is always refused."""
    extent: Callable[..., int] | None = None
    """None if it equals `measure`."""


class Choice:
    """Candidate frames in the order of trial, distinguished by one byte.

    `named`: the candidates by name; `encoders`: their encoders. Indexed by the deciding byte: `readers` holds names
    with decoders in the order of trial, or another choice; `likely` the first name and decoder of one or two
    candidates; `sole` the measuring function of the only candidate, None for several. `absent`: the readers for a
    missing deciding byte.
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
        """Return the candidates for the deciding byte; all of them if the byte may still arrive (before `end`)."""
        place = start + self.at
        if end is not None and place >= end:
            return self.everything
        found = self.others if place >= len(data) else self.cases.get(data[place], self.others)
        return found if type(found) is tuple else found.frames(data, start, end)


def readers_of(found: Any) -> Any:
    """Return names and decoders of a list of frames; a choice is returned unchanged."""
    return tuple((frame.name, frame.decode) for frame in found) if type(found) is tuple else found


def measure_of(found: Any) -> Any:
    """Return the measuring function of a list of at most one frame; None for several."""
    if found == ():
        return no_frame
    return found[0].measure if type(found) is tuple and len(found) == 1 else None


def no_frame(data: bytes | bytearray, start: int, end: int, ctx: Context, seen: int = 0) -> int:
    """Return 0, the size where no frame is possible."""
    return 0


def fused_readers(choice: Choice, readers: dict[str, Any]) -> list[Any]:
    """Return by the deciding byte the reader of the likely candidate together with the outer frame, or None."""
    return [None if one is None else readers.get(one[0]) for one in choice.likely]


def decode_first(choice: Choice, data: bytes, ctx: Context, mismatch: Exception | None = None) -> dict[str, Any]:
    """Return the first frame that fits, as `{name: fields}`. Raises FrameError if that frame is to be refused.

    `mismatch`: the error of the likely candidate, if it was already tried.
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


def read_inside(choice: Choice, data: bytes, given: Any, ctx: Context) -> Any:
    """Return the values of an inner frame that was built; those that were given if a reader would refuse it."""
    try:
        return decode_first(choice, data, ctx)
    except FrameError:
        return given


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
    """Return the size of the first frame that fits here, or else the number of missing bytes, including `behind`.

    While a candidate needs more bytes, no later candidate is accepted, so that the result is independent of the arrival
    of the bytes. At most as many bytes are requested as a complete later candidate needs, since the next byte may
    exclude the first. `whole`: no more bytes will arrive. Without `reads` every complete frame is assumed to fit.
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
    """Return the result of `measure_first` under the assumption that a complete frame fits, without reading it."""
    place = start + choice.at
    measure = choice.sole[data[place]] if place < end else None
    if measure is not None:
        size: int = measure(data, start, end, ctx, seen)
        return size - behind if QUIET < size < 0 else size
    return measure_first(choice, data, start, end, ctx, seen, behind=behind, reads=False)


def fits(frame: Frame, data: bytes, ctx: Context) -> bool:
    """Return whether the bytes are this frame, valid or to be refused."""
    try:
        frame.decode(data, ctx)
    except FrameError as error:
        return error.refuse is not None
    return True


def encode_one(choice: Choice, value: Any, name: str, ctx: Context) -> bytes:
    """Return the bytes of `{frame: fields}`. Raises EncodeError."""
    # a dict is by far the most frequent, and the test for a Mapping takes as long as the rest
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
    """Return the bytes of an inner frame without a definition, or already encoded: its `data`."""
    return bytes(b"" + fields["data"])


def encode_nested(level: Frame, value: Any, name: str, ctx: Context) -> bytes:
    """Return the bytes of the next level of a layout inside itself. Raises EncodeError."""
    if not isinstance(value, Mapping):
        raise EncodeError(name, f"'{name}' must be a mapping of fields")
    try:
        return level.encode(value, ctx)
    except EncodeError as error:
        more = tuple(f"{name}.{one}" for one in error.more)
        raise EncodeError(f"{name}.{error.field}" if error.field else name, str(error), more) from None


# ---- errors of encoders, determined after a mismatch -------------------------------------------------------


class Rule(NamedTuple):
    """The allowed values of a name."""

    type: str
    """The kind of value."""
    least: int | None = None
    """The least number, or the minimum length of a text, bytes or list."""
    most: int | None = None
    """The greatest number, or the maximum length of a text, bytes or list."""
    needed: bool = False
    names: Any = ()
    """Numbers by name; a name may be given instead of its number."""
    only: bool = False
    """Whether only these names and their numbers are allowed."""
    unit: int = 1
    """The unit of which a number is a multiple."""
    inside: Any = None
    """The rules of a mapping or of the items of a list ('' for plain items)."""
    fits: Any = None
    """Raises ValueError with the reason for a value that cannot be written."""


Rules = Mapping[str, Rule]


def check_given(
    values: Context,
    rules: Rules,
    computed: Context,
    path: str = "",
    elsewhere: tuple[str, ...] = (),
    absent: tuple[str, ...] = (),
) -> None:
    """Raise EncodeError unless every value is known and computed values equal the given ones.

    `elsewhere`: names of cases that were not chosen. `absent`: names of absent values, for which None may be given.
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
    """Return the error for the first faulty value."""
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
    """Return the bytes of a frame unchanged, if its texts that end before certain bytes are read back correctly.

    `texts`: the path of each text, and its end bytes in words. Raises EncodeError for a text that would have another
    end.
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
    """Return whether the given value at a path equals the value read there, or no value is given."""
    if isinstance(given, (list, tuple)) and isinstance(found, list):
        return len(given) == len(found) and all(map(is_read_back, given, found, [path] * len(given)))
    if not path:
        if isinstance(given, str) or isinstance(found, (str, list)):
            return bool(given == found)
        return bool(Decimal(str(given)) == Decimal(str(found)))
    name, rest = path[0], path[1:]
    return name not in given or (name in found and is_read_back(given[name], found[name], rest))


def path_of(name: Any, rules: Rules) -> str | None:
    """Return the path of the value with a name, or None if it is unknown."""
    if name in rules:
        return str(name)
    for outer, rule in rules.items():
        inner = path_of(name, rule.inside) if rule.inside else None
        if inner is not None:
            return f"{outer}.{inner}"
    return None


def find_mismatch(values: Context, rules: Rules, path: str) -> EncodeError | None:
    """Return the error for the first value that violates its rule.

    A missing value is reported together with all others.
    """
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
    """Return the error for missing values, or None if the list is empty."""
    if not names:
        return None
    *some, last = [f"'{path}{name}'" for name in names]
    verb = f"{', '.join(some)} and {last} are" if some else f"{last} is"
    return EncodeError(path + names[0], f"{verb} missing", tuple(path + name for name in names[1:]))


def mismatch_of(value: Any, rule: Rule, name: str) -> EncodeError | None:
    """Return the error for a value that violates its rule, or None."""
    if rule.names and (isinstance(value, str) or (rule.only and isinstance(value, (int, float)))):
        if value in rule.names or value in rule.names.values():
            return None
        return EncodeError(name, f"'{name}' is one of {', '.join(rule.names)}, not {value!r}")
    kinds: dict[str, Any] = {"number": int, "float": (int, float), "text": str, "bytes": (bytes, bytearray)}
    kinds |= {"digits": (bytes, bytearray), "list": (list, tuple), "mapping": Mapping, "any": object}
    kinds["decimal"] = object  # `fits` refuses other kinds
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
    """Return the description of a value of the wrong kind."""
    words = {"number": "a whole number", "float": "a number", "text": "text", "list": "a list", "mapping": "a mapping"}
    wanted, found = f"must be {words.get(rule.type, 'bytes')}", type(value).__name__
    if rule.type == "number" and found in ("float", "Decimal"):
        fractions = "a field has fractions by scale:, decimals: or a float as its type"
        return f"{wanted}, and {value} is a {found} – round it; {fractions}"
    return f"{wanted}, not {found}"


def mismatch_inside(value: Any, rules: Rules, name: str) -> EncodeError | None:
    """Return the first error in a mapping or in the items of a list, or None."""
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
    """Return a value of a record. Raises EncodeError if it is missing."""
    if name not in values:
        raise EncodeError(path + name, f"'{path}{name}' is missing")
    return values[name]


def check_size(name: str, found: int, wanted: int | None) -> None:
    """Raise EncodeError unless a value has the length that another value states."""
    if wanted is None:
        raise EncodeError(name, f"the size of '{name}' cannot be told: a value it is worked out from is not there")
    if found != wanted:
        raise EncodeError(name, f"'{name}' has a length of {found}, it must be {wanted}")

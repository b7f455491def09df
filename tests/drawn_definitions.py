"""Random definitions of segments of every kind with every key, and values that may fit them.

`DRAWN` has one function for every kind. A test compares it, and the keys that the functions write, with the schema, so
that no new kind or key is forgotten. A drawn definition may be senseless; `check` must refuse it then.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from random import Random
from typing import Any

Segments = list[dict[str, Any]]
NOT_DRAWN: Segments = []
WHOLE = "whole"
ELSE = "else"

TYPES: tuple[dict[str, Any], ...] = (
    {"type": "u8"}, {"type": "u8"}, {"type": "u8"}, {"type": "i8"}, {"type": "u16"}, {"type": "u16", "order": "little"},
    {"type": "i16"}, {"type": "u24"}, {"type": "u32", "order": "CDAB"}, {"type": "u32", "order": "BADC"},
    {"type": "u40"}, {"type": "u64"}, {"type": "dec", "size": 2}, {"type": "dec", "size": 3, "order": "little"},
    {"type": "hex", "size": 2}, {"type": "hex", "size": 4, "order": "little", "case": "lower"},
    {"type": "hex", "size": 3}, {"type": "oct", "size": 3}, {"type": "bcd", "size": 1}, {"type": "bcd", "size": 2},
    {"type": "uint", "size": 3}, {"type": "uint", "size": "§"}, {"type": "int", "size": 2},
    {"type": "hex", "size": "§"},
)  # fmt: skip
"""Types of whole numbers; a size `§` becomes an expression of the names in scope."""
OTHER_TYPES: tuple[tuple[dict[str, Any], tuple[Any, ...]], ...] = (
    ({"type": "f32"}, (0.0, 1.5, -2.0)),
    ({"type": "f64", "order": "little"}, (0.0, 1e300)),
    ({"type": "ascii", "size": 2}, ("ab", "\x10\x03")),
    ({"type": "ascii", "size": 3, "pad": "20"}, ("", "a", "abc")),
    ({"type": "ascii", "end": "00"}, ("", "abc")),
    ({"type": "ascii", "size": "§"}, ("", "a", "ab", "abc")),
    ({"type": "bytes", "size": 2}, (b"\x10\x02", b"ab")),
    ({"type": "bytes", "size": "§"}, (b"", b"a", b"\x10b")),
)
TEXT_TYPES: tuple[tuple[dict[str, Any], tuple[Any, ...]], ...] = (
    ({"type": "decimal", "size": 3}, (0, 7, -4)),
    ({"type": "decimal", "size": 3, "pad": "20", "sign": "never"}, (0, 7, 123)),
    ({"type": "decimal", "end": "2C"}, (0, 7, -4)),
    ({"type": "decimal", "size": "§"}, (0, 7, 12)),
    ({"type": "decimal", "size": 6, "decimals": "1", "sign": "always"}, (1.5, -2, 12.5)),
    (
        {
            "type": "decimal",
            "size": 6,
            "decimals": "any",
            "pad": "20",
            "digits": "2",
            "sign": "space",
            "point": "always",
        },
        (1.5, -2, 0),
    ),
    ({"type": "decimal", "end": ["2C", "2A"], "decimals": "any"}, (1.5, -2, 0.25)),
    ({"type": "decimal", "end": "2C", "decimals": "any", "point": "always"}, (1.5, -2, 0)),
    ({"type": "decimal", "end": "0D 0A", "decimals": "2", "digits": "0", "empty": "yes"}, (1.5, 0.25, 0)),
    ({"type": "decimal", "end": "2C", "decimals": "3", "exponent": "2"}, (1.5, 250, 0, -0.001)),
    ({"type": "u8", "scale": "0.5", "offset": "-40"}, (-40, 0.5, 87)),
    ({"type": "i16", "order": "little", "scale": "0.1"}, (1.5, -2, 0)),
    ({"type": "bcd", "size": 2, "scale": "10"}, (0, 120)),
    ({"type": "decimal", "end": "2C", "scale": "-0.25"}, (0, 0.5, -1)),
    ({"type": "f32", "as": "hex"}, (0.0, 1.5)),
    ({"type": "f64", "as": "hex", "order": "little", "case": "lower"}, (0.0, -2.0)),
    ({"type": "i16", "as": "hex"}, (0, -2)),
    ({"type": "ascii", "end": ["2C", "2A"]}, ("", "abc", "a,")),
)
"""Types of numbers as text, and possible delimiters."""
LIST_TYPES = (
    *((kind, choice) for kind, choice in TEXT_TYPES if "end" not in kind and kind.get("size") != "§"),
    ({"type": "decimal", "size": 9, "decimals": "1", "exponent": "1"}, (1.5, 250, 0)),
)
"""Types of list items: each must determine its own size."""
CONDITIONS = ("§ > 3", "§ == 2", "§ != §", "§ % 2 == 0", "§ in names", "not § > 1", "§ > 1 and § < 7", "bit(§, 1)")
NUMBERS = (
    "§", "§ + 1", "§ * 2", "§ - 1", "§ & 3", "len(¤)", "4 if § > 2 else 1", "min(§, 3)", "§ // §", "max(§, §)",
    "get(names, §, 3)", "7 - §", "abs(§ - 4)", "(§ << 1) & 7", "find(names, 5)",
)  # fmt: skip
MORE_CONDITIONS = ("§ == none()", "either(§, 2) > 1", "limit > 1", "§ + level > 4", "only(text(§), '0123')", "same(¤)")
MORE_NUMBERS = (
    "either(§, 2)", "limit", "§ + level", "number(digits(§ & 15, 2), 16)", "rotl8(§ & 255, 1)", "span(§ & 7, 3)",
    "sum([§, §])", "[§, 2][0]", "find_last(names, 5)", "[§, 3, 1][1]", "1 if ¤ == none() else 2",
)  # fmt: skip
"""Names that are only used with `more`: parameters, state, functions, lists, absent values."""
SIZES = ("§", "§", "§ & 3", "§ - 1", "min(§, 4)", "2", "§ // 2", "2 * §")
BYTES = (0x10, 0x41, 0x03, 0x05, 0x00, 0xFF, 0x30, 0x7E)
PARAMS = {"limit": {"type": "number", "default": "2", "range": "0..9"}}
STATE = {"level": {"scope": "line", "type": "u8", "initial": "1"}}
CHECKS = ("sum8", "xor8", "crc16-modbus", "lrc8", "sum16", "crc8", "folded")

AES_KEYS = ("h'00 01 02 03 04 05 06 07 08 09 0A 0B 0C 0D 0E 0F'", "h'2B 7E 15 16 28 AE D2 A6 AB F7 15 88 09 CF 4F 3C'")
IV = "h'00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 FF'"
CIPHERS: tuple[dict[str, Any], ...] = (
    {"cipher": "aes-cbc", "pad": "pkcs7"}, {"cipher": "aes-cbc", "pad": "iso7816"}, {"cipher": "aes-cbc"},
    {"cipher": "aes-cbc", "pad": "iso7816", "clear": 1}, {"cipher": "aes-gcm", "tag": 6, "clear": 2},
    {"cipher": "aes-ctr"}, {"cipher": "aes-gcm"}, {"cipher": "aes-gcm", "tag": 4, "also": "h'01'"},
)  # fmt: skip

SEALED = {"code": f"aes({AES_KEYS[0]}, (data + xor({IV}, {AES_KEYS[1]}))[-16:])", "width": 128}
"""A check code computed by an expression."""


class Scope:
    """Names that an expression may use: numbers, and values that have a length. `outer` is the enclosing scope."""

    def __init__(self, outer: Scope | None = None) -> None:
        self.outer = outer
        self.numbers: list[str] = []
        self.sized: list[str] = []
        self.places: list[str] = []

    def all(self, attribute: str) -> list[str]:
        here: list[str] = getattr(self, attribute)
        return here + (self.outer.all(attribute) if self.outer is not None else [])


class DrawnDefinition:
    """Draw a protocol whose frame `f` has random segments: `text`; `values` are values to build the frame from.

    `used` are the kinds and keys in the text; `kinds` are the kinds that must occur. Expressions may use names that are
    declared later. `more` also draws parameters, state and further functions and keys, so the same seed gives another
    definition. `alike` gives every record, item, inner frame and case the same names.
    """

    def __init__(
        self, seed: int | str, kinds: tuple[str, ...] = (), *, more: bool = False, alike: bool = False
    ) -> None:
        self.random, self.apart = Random(seed), Random(f"{seed} apart")
        self.keyed = Random(f"{seed} keyed")
        self.more, self.alike = more, alike
        self.counts = Counter[str]()
        """Number of names by prefix; with `alike`, in the present scope."""
        self.layouts: dict[str, Segments] = {}
        self.frames: dict[str, dict[str, Any]] = {}
        self.groups: dict[str, dict[str, Any]] = {}
        self.used: set[tuple[str, str]] = set()
        self.free: list[tuple[dict[str, Any], Any, str, Scope]] = []
        self.values: dict[str, Any] = {}
        scope = Scope()
        body = self.body(scope, self.values, 0, kinds)
        self._resolve()
        frame: dict[str, Any] = {"body": body}
        self._about_frame(frame)
        definition = {
            "protocol": "drawn",
            "order": self.random.choice(["big", "little"]),
            "tables": {"names": {"1": 2, "2-4": 5, "7": 1}},
            **({"params": PARAMS, "state": STATE} if more else {}),
            "checks": {"folded": {"fold": "(acc * 3 + byte) & 0xFF", "initial": 1}, "sealed": SEALED},
            **({"layouts": self.layouts} if self.layouts else {}),
            **({"groups": self.groups} if self.groups else {}),
            "frames": {"f": frame, **self.frames},
        }
        self.text = json.dumps(definition)

    # ---- what is drawn ------------------------------------------------------------------------------------

    def some(self, *choice: Any) -> Any:
        return self.random.choice(choice)

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def name(self, letter: str) -> str:
        """Return an unused name of the present scope."""
        key = letter if self.alike else ""
        self.counts[key] += 1
        return f"{letter}{self.counts[key]}"

    def name_of_whole(self, letter: str) -> str:
        """Return an unused name for a layout or frame."""
        key = WHOLE if self.alike else ""
        self.counts[key] += 1
        return f"{letter}{self.counts[key]}"

    @contextmanager
    def scope_of_its_own(self) -> Iterator[None]:
        """Enter a record, an item or an inner frame: with `alike`, its names start again."""
        outside = self.counts
        if self.alike:
            self.counts = Counter({WHOLE: outside[WHOLE]})
        yield
        if self.alike:
            self.counts = outside | Counter({WHOLE: self.counts[WHOLE]})

    def cases(self, keys: tuple[str, ...], draw: Callable[[str], Segments]) -> dict[str, Segments]:
        """Return the cases of a choice: with `alike`, all start with the same names."""
        first, found = Counter(self.counts), dict[str, Segments]()
        all_counts = first
        for key in keys:
            if self.alike:
                self.counts = first | Counter({WHOLE: all_counts[WHOLE]})
            found[key] = draw(key)
            all_counts |= self.counts
        self.counts = all_counts
        return found

    def bytes(self, size: int) -> bytes:
        return bytes(self.random.choice(BYTES) for _ in range(size))

    def expression(self, holder: dict[str, Any], key: Any, text: str, scope: Scope) -> None:
        """Set a key to an expression; its names are chosen when all names are known."""
        later = key not in ("when", "size", "choose", "times", "until") or self.chance(0.03)
        holder[key] = text if later else self._with_names(text, scope)
        if "§" in holder[key] or "¤" in holder[key]:
            self.free.append((holder, key, text, scope))

    def _with_names(self, text: str, scope: Scope) -> str:
        while "§" in text:
            text = text.replace("§", self.random.choice(scope.all("numbers") or ["3"]), 1)
        while "¤" in text:
            text = text.replace("¤", self.random.choice(scope.all("sized") or ["'ab'"]), 1)
        return text

    def _resolve(self) -> None:
        for holder, key, text, scope in self.free:
            holder[key] = self._with_names(text, scope)

    def _about_frame(self, frame: dict[str, Any]) -> None:
        """Add keys of the frame itself."""
        if self.chance(0.1):
            frame["max"] = self.random.randrange(4, 40)
        if self.chance(0.07):
            frame |= {"size": self.random.randrange(4, 40), "fill": "2A"}
        if self.chance(0.1):
            frame["refuse"] = 7
        first = next((segment for segment in frame["body"] if segment.get("type") == "u8" and "field" in segment), None)
        if self.chance(0.3):
            self.groups["g"] = {"head": frame["body"][:1], "tail": frame["body"][-1:]}
            frame |= {"group": "g", "body": frame["body"][1:-1]}
            if self.chance(0.3):
                self.groups["g"]["delimited"] = "yes"
            if first in self.groups["g"]["head"]:
                frame["where"] = {first["field"]: self.some(1, [1, 2])}
                if self.more and self.chance(0.3):
                    frame["where"] = {first["field"]: {"build": self.some("limit", "level + 1")}}

    def body(self, scope: Scope, values: dict[str, Any], depth: int, kinds: tuple[str, ...] = ()) -> Segments:
        """Return some segments, and store their values in `values`."""
        wanted = list(kinds)
        least = 1 if depth else 2
        while len(wanted) < least or (len(wanted) < 6 and self.chance(0.55 - 0.15 * depth)):
            leaf = depth > 1 or self.chance(0.75)
            wanted.append(self.random.choice(LEAVES if leaf else HOLDERS))
        self.random.shuffle(wanted)
        found: Segments = []
        for kind in wanted:
            before = Scope()
            before.numbers = scope.all("numbers")
            for segment in DRAWN[kind](self, scope, values, depth):
                self._common(segment, scope, before)
                found.append(segment)
        if depth == 0 and self.chance(0.5):
            found.append({"const": self.some("7E", "10 03", "03")})
        if depth == 0 and self.chance(0.4):
            found += check(self, scope, values, depth)
        for segment in found:
            kind = next(key for key in segment if key in DRAWN)
            self.used |= {(kind, key) for key in segment}
        return found

    def _common(self, segment: dict[str, Any], scope: Scope, before: Scope) -> None:
        kind = next(key for key in segment if key in DRAWN)
        if self.chance(0.15):
            self.expression(segment, "when", self.condition(), before)
        if self.chance(0.07):
            segment["refuse"] = self.random.randrange(1, 9)
        if self.chance(0.03):
            segment["doc"] = "a note"
        named = {"const", "text", "bits", "choose", "optional", "wrap", "check", "skip", "require", "include"}
        if kind in named and "as" not in segment and self.chance(0.3):
            name = segment.setdefault("name", self.name("s"))
            if kind in ("bits", "include", "wrap", "choose", "optional"):
                scope.sized.append(name)
            scope.places.append(name)

    def condition(self) -> str:
        return self.random.choice(MORE_CONDITIONS if self.more and self.chance(0.4) else CONDITIONS)

    def number(self) -> str:
        """Return an expression that gives a number."""
        return self.random.choice(MORE_NUMBERS if self.more and self.chance(0.4) else NUMBERS)

    def type(self, scope: Scope) -> dict[str, Any]:
        """Return the keys of a whole number."""
        found = dict(self.random.choice(TYPES))
        if found.get("size") == "§":
            self.expression(found, "size", self.random.choice(SIZES), scope)
        return found

    def numbered(self, holder: dict[str, Any], scope: Scope) -> None:
        """Add the type of a number to its segment, which an expression in it refers to."""
        kind = dict(self.random.choice(TYPES))
        holder |= kind
        if kind.get("size") == "§":
            self.expression(holder, "size", self.random.choice(SIZES), scope)


def const(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    return [{"const": drawn.some("05", "02 41", "7E", "10 02")}]


def text(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    return [{"text": drawn.some("XY", "0", "a'\"b")}]


def skip(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    return [{"skip": drawn.some(0, 1, 3), **drawn.some({}, {"fill": "2A"})}]


def field(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    name = drawn.name("f")
    segment: dict[str, Any] = {"field": name}
    if drawn.apart.random() < 0.15:
        return text_number(drawn, scope, values, segment)
    if drawn.chance(0.25):
        kind, choice = drawn.random.choice(OTHER_TYPES)
        segment |= kind
        if kind.get("size") == "§":
            drawn.expression(segment, "size", drawn.random.choice(SIZES), scope)
        values[name] = drawn.random.choice(choice)
        if isinstance(values[name], (str, bytes)):
            scope.sized.append(name)
        if drawn.chance(0.15):
            segment["default"] = {float: "0", str: "'ab'", bytes: "h'10 02'"}[type(values[name])]
            if drawn.chance(0.5):
                del values[name]
        scope.places.append(name)
        return [segment]
    drawn.numbered(segment, scope)
    values[name] = drawn.random.randrange(9)
    option = drawn.random.randrange(22)
    if option == 0:
        drawn.expression(segment, "is", drawn.number(), scope)
        del values[name]
    elif option == 1:
        drawn.expression(segment, "build", drawn.number(), scope)
        if drawn.chance(0.7):
            del values[name]
    elif option in (2, 3):
        drawn.expression(segment, "default", drawn.some("3", drawn.number()), scope)
        if drawn.chance(0.6):
            del values[name]
    elif option == 4:
        segment["values"] = {"1": "A", "2": "B", "3": "§C".replace("§", ""), "8": "E"}
        if drawn.chance(0.5):
            segment["only"] = "values"
            values[name] = drawn.some(1, 2, "B")
    elif option == 5:
        segment["range"] = drawn.some("0..9", "1..4", "2..200")
    elif option == 6:
        segment["plus"] = drawn.some(3, 1, -1)
    elif option == 7:
        segment["unit"] = drawn.some("ms", "10 ms")
        values[name] *= 10_000_000
    elif option == 8:
        segment |= {"long": {"mark": 200, **drawn.some({"type": "u16"}, {"type": "hex", "size": 4})}}
        values[name] = drawn.some(7, 199, 200, 300)
    elif option == 9:
        segment["zero_means"] = drawn.some(256, 9)
        values[name] = drawn.some(1, segment["zero_means"])
    elif option == 10:
        segment["memory"] = "D1"
    if "unit" not in segment:
        scope.numbers.append(name)
    if drawn.chance(0.2):
        scope.sized.append(name)
    scope.places.append(name)
    return [segment]


def text_number(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], segment: dict[str, Any]) -> Segments:
    """Return a numeric text field; after a field that ends before a delimiter, also return the delimiter."""
    name, random = segment["field"], drawn.apart
    kind, choice = random.choice(TEXT_TYPES)
    segment |= kind
    if kind.get("size") == "§":
        drawn.expression(segment, "size", random.choice(SIZES), scope)
    values[name] = random.choice(choice)
    if (
        isinstance(values[name], int)
        and kind["type"] != "f32"
        and "scale" not in kind
        and "decimals" not in kind
        and "exponent" not in kind
    ):
        scope.numbers.append(name)
        option = random.randrange(8)
        if option == 0:
            segment["range"] = random.choice(["0..9", "-5..200"])
        elif option == 1:
            segment["plus"] = random.choice([3, -1])
    elif random.random() < 0.1:
        segment["default"] = "'ab'" if isinstance(values[name], str) else "0"
        values.pop(name)
    scope.places.append(name)
    if not isinstance(kind.get("end"), list):
        return [segment]
    mark = drawn.name("f")
    values[mark] = random.choice([0x2C, 0x2A])
    return [segment, {"field": mark, "type": "u8"}]


def bits(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    low, high = drawn.name("b"), drawn.name("b")
    segment: dict[str, Any] = {"bits": {low: "0-2", high: drawn.some("3", "7", "3-5")}}
    drawn.numbered(segment, scope)
    segment["of"] = segment.pop("type")
    values |= {low: drawn.random.randrange(8), high: drawn.random.randrange(2)}
    scope.numbers += [low, high]
    option = drawn.random.randrange(8)
    if option == 0:
        segment["is"] = {}
        drawn.expression(segment["is"], low, drawn.some("1", drawn.number()), scope)
        del values[low]
    elif option == 1:
        segment["build"] = {}
        drawn.expression(segment["build"], low, drawn.number(), scope)
        del values[low]
    elif option == 2:
        segment["values"] = {low: {"1": "A", "4": "B"}}
    elif option == 3:
        del values[high]
    return [segment]


def data(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    name = drawn.name("d")
    segment: dict[str, Any] = {"data": name, "size": drawn.some(0, 1, 2, 4)}
    size = segment["size"]
    if drawn.chance(0.3):
        drawn.expression(segment, "size", drawn.random.choice(SIZES), scope)
        size = drawn.random.randrange(4)
    elif drawn.chance(0.2):
        segment["size"] = "rest"
        size = drawn.random.randrange(4)
    values[name] = drawn.bytes(size)
    if drawn.chance(0.3):
        segment["convert"] = drawn.some("hex_to_ascii", "ascii_to_hex")
        if segment["convert"] == "ascii_to_hex":
            values[name] = b"0aB7cD"[: size + size % 2]
    if drawn.chance(0.1):
        segment["swap"] = drawn.some(2, 4)
    if drawn.chance(0.15):
        segment["pad"] = drawn.some("00", "2E")
        values[name] = values[name][: drawn.random.randrange(size + 1)]
    if drawn.chance(0.1):
        segment["min"] = drawn.some(1, 2)
    if drawn.chance(0.05):
        segment["memory"] = "D2"
    if drawn.apart.random() < 0.15:
        segment["never"] = drawn.apart.choice([["7E"], ["03", "10"], "7E 10 03"])
    scope.sized.append(name)
    scope.places.append(name)
    return [segment]


def length(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    name, counted = drawn.name("l"), drawn.name("d")
    segment: dict[str, Any] = {"length": name}
    drawn.numbered(segment, scope)
    others = [place for place in scope.places if drawn.chance(0.3)]
    segment["of"] = [counted, *others]
    target: dict[str, Any] = {"data": counted, "size": name}
    size = drawn.random.randrange(5)
    option = drawn.random.randrange(9)
    if option == 0:
        segment |= {"unit": drawn.some("words", "dwords")}
        target["size"] = f"{name} * {2 if segment['unit'] == 'words' else 4}"
        size = drawn.some(0, 4, 8)
    elif option == 1:
        segment["plus"] = drawn.some(1, 3, -1)
        target["size"] = f"{name} - {segment['plus']}"
    elif option == 2:
        segment["range"] = drawn.some("0..9", "1..3")
    elif option == 3:
        segment["zero_means"] = 256
        size = drawn.some(1, 4, 256)
    elif option == 4:
        target["convert"] = "hex_to_ascii"
        if drawn.chance(0.7):
            segment["plain"] = "yes"
    elif option == 5:
        target["size"] = "rest"
    elif option == 6:
        target = {"repeat": counted, "times": drawn.some(name, "rest"), "of": "u8"}
    if others and drawn.chance(0.7):
        target["size"] = "rest"
    values[counted] = list(drawn.bytes(size)) if "repeat" in target else drawn.bytes(size)
    scope.numbers.append(name)
    scope.sized.append(counted)
    scope.places += [name, counted]
    between = DRAWN[drawn.random.choice(LEAVES)](drawn, scope, values, depth) if drawn.chance(0.3) else []
    return [segment, *between, target]


def count(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    name, items = drawn.name("n"), drawn.name("r")
    segment: dict[str, Any] = {"count": name}
    drawn.numbered(segment, scope)
    segment["of"] = items
    if drawn.chance(0.15):
        segment |= drawn.some({"plus": 1}, {"range": "0..4"}, {"zero_means": 10})
    times = f"{name} - 1" if segment.get("plus") else drawn.some(name, name, name, "rest")
    scope.numbers.append(name)
    return [segment, _items(drawn, scope, values, depth, items, times, drawn.random.randrange(4))]


def repeat(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    times = drawn.some(2, 1, "rest", "rest")
    many = times if isinstance(times, int) else drawn.random.randrange(4)
    return [_items(drawn, scope, values, depth, drawn.name("r"), times, many)]


def _items(
    drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int, name: str, times: Any, many: int
) -> dict[str, Any]:
    segment: dict[str, Any] = {"repeat": name, "times": times}
    scope.places.append(name)
    if drawn.apart.random() < 0.3:
        kind, choice = drawn.apart.choice(LIST_TYPES)
        segment |= {"of": kind["type"], **{key: one for key, one in kind.items() if key != "type"}}
        values[name] = [drawn.apart.choice(choice) for _ in range(many)]
        scope.sized.append(name)
        return segment
    if drawn.chance(0.4):
        kind = dict(drawn.random.choice([form for form in TYPES if form.get("size") != "§"]))
        segment["of"] = kind.pop("type")
        segment |= kind
        if times != 1 and drawn.apart.random() < 0.3:
            segment |= drawn.apart.choice([{"separator": "2C"}, {"align": 8, "between": "yes"}])
            if "separator" in segment and drawn.apart.random() < 0.6:
                segment = {"repeat": name, "times": times, "separator": "2C", "of": "decimal", "end": "3B"}
        values[name] = [drawn.random.randrange(9) for _ in range(many)]
        scope.sized.append(name)
        return segment
    inside, inner = Scope(scope), {}
    if drawn.more and drawn.chance(0.3):
        inside.sized.append(name)  # the earlier items
    if drawn.apart.random() < 0.3:
        inside.numbers += ["index", drawn.apart.choice(["last", "index"])]
    with drawn.scope_of_its_own():
        segment["of"] = drawn.body(inside, inner, depth + 1)
    own = [number for number in inside.numbers if number.isidentifier() and number not in ("index", "last")]
    if own and drawn.apart.random() < 0.2:
        segment["of"].append({"require": f"either(previous.{own[-1]}, 1) * 0 == {own[-1]} * 0"})
    if drawn.apart.random() < 0.2:
        segment |= {"align": drawn.apart.choice([2, 4, 4, 8])}
        segment |= drawn.apart.choice([{}, {"between": "yes"}, {"between": "yes", "fill": "2A"}])
    if times != 1 and drawn.apart.random() < 0.15:
        segment["separator"] = drawn.apart.choice(["2C", "0D 0A"])
    if times == "rest" and many and drawn.apart.random() < 0.4:
        del segment["times"]
        drawn.expression(segment, "until", drawn.apart.choice([f"index == {many - 1}", "§ == 8", "§ > 3"]), inside)
    values[name] = [dict(inner) for _ in range(many)]
    if drawn.chance(0.5):
        scope.sized.append(name)
    if inside.numbers and drawn.chance(0.3):
        scope.numbers.append(f"sum({name}.{inside.numbers[0]})")
    return segment


def choose(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    segment: dict[str, Any] = {}
    drawn.expression(segment, "choose", drawn.some("§", "§", "§ & 1", "min(§, 2)"), scope)
    if drawn.more and drawn.chance(0.3):
        segment["choose"] = drawn.some("limit", "level", "1 if limit == 2 else 0")
    keys = drawn.some(("1", "2"), ("0", "1, 2"), ("0", "1", "2,3,4"))

    def case(key: str) -> Segments:
        if key == ELSE and not drawn.chance(0.8):
            return NOT_DRAWN
        return drawn.body(scope, values, depth + 1) if drawn.chance(0.3 if key == ELSE else 0.85) else []

    found = drawn.cases((*keys, ELSE), case)
    otherwise = found.pop(ELSE)
    segment["cases"] = found
    if otherwise is not NOT_DRAWN:
        segment["else"] = otherwise
    return [segment]


def optional(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    inside: dict[str, Any] = {}
    segment: dict[str, Any] = {"optional": drawn.body(scope, inside, depth + 1)}
    if drawn.chance(0.5):
        values |= inside
    return [segment]


def include(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    layout = drawn.name_of_whole("y")
    if drawn.chance(0.3):
        drawn.layouts[layout] = drawn.body(scope, values, depth + 1)
        return [{"include": layout}]
    name = drawn.name("rec")
    inside = Scope(scope)
    values[name] = {}
    with drawn.scope_of_its_own():
        drawn.layouts[layout] = drawn.body(inside, values[name], depth + 1)
    if inside.numbers and drawn.chance(0.6):
        scope.numbers.append(f"{name}.{drawn.random.choice(inside.numbers)}")
    scope.places.append(name)
    if drawn.apart.random() < 0.2:
        _nest(drawn, layout, values[name])
    return [{"include": layout, "as": name}]


def _nest(drawn: DrawnDefinition, layout: str, values: dict[str, Any]) -> None:
    """Make a layout contain itself: in a list, or if a field is set."""
    again = {"include": layout, "as": "again", "depth": drawn.apart.choice([2, 3])}
    drawn.used.add(("include", "depth"))
    flat = {**values}
    if drawn.apart.random() < 0.5:
        drawn.layouts[layout] += [{"field": "more", "type": "u8"}, {**again, "when": "more"}]
        values |= {"more": 1, "again": {**flat, "more": 0}}
    else:
        count = {"count": "more", "type": "u8", "of": "below"}
        drawn.layouts[layout] += [count, {"repeat": "below", "times": "more", "of": [again]}]
        values["below"] = [{"again": {**flat, "below": []}}] * drawn.apart.randrange(3)


def inner(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    name, frames = drawn.name("i"), [drawn.name_of_whole("frame") for _ in range(drawn.some(1, 2))]
    choice: list[dict[str, Any]] = []
    for place, frame in enumerate(frames):
        inside: dict[str, Any] = {}
        with drawn.scope_of_its_own():
            body = drawn.body(Scope(), inside, depth + 1)
        lead = [{"const": f"0{place + 1}"}] if drawn.chance(0.8) else []
        drawn.frames[frame] = {"body": [*lead, *body]}
        choice.append({frame: inside})
    values[name] = drawn.random.choice(choice)
    segment: dict[str, Any] = {"inner": name, "of": frames}
    if drawn.chance(0.4):
        drawn.expression(segment, "size", drawn.some("rest", "rest", "§", "4"), scope)
    scope.places.append(name)
    return [segment]


def wrap(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    segment: dict[str, Any] = {"wrap": drawn.some("hex", {"escape": "DLE"}, {"escape": "DLE"})}
    segment["of"] = drawn.body(scope, values, depth + 1)
    if drawn.chance(0.2):
        rest = drawn.name("d")
        segment["of"].append({"data": rest, "size": "rest"})
        values[rest] = drawn.bytes(drawn.random.randrange(4))
        scope.sized.append(rest)
    if drawn.chance(0.3):
        segment["of"] += check(drawn, scope, values, depth)
    if drawn.chance(0.1):
        segment["min"] = drawn.some(1, 3)
    if drawn.chance(0.1):
        segment["max"] = drawn.some(4, 20)
    if isinstance(segment["wrap"], dict) and drawn.chance(0.1):
        frame = drawn.name_of_whole("frame")
        drawn.frames[frame] = {"body": [{"const": "10 05"}]}
        segment |= {"inside": [frame], "insert": "1 == 1"}
    if "inside" in segment or drawn.apart.random() < 0.4:
        return [segment, {"const": "10 03"}] if isinstance(segment["wrap"], dict) else [segment]
    return coded(drawn, segment, scope)


def coded(drawn: DrawnDefinition, segment: dict[str, Any], scope: Scope) -> Segments:
    """Return the wrap with another coding, and a segment for its end: a constant that it cannot hold, or a length."""
    if drawn.keyed.random() < 0.2:
        return ciphered(drawn, segment, scope)
    if drawn.apart.random() < 0.2:
        segment["wrap"] = {"short": drawn.apart.choice(["00", "02"])}
        if drawn.apart.random() < 0.5:
            segment["wrap"]["min"] = drawn.apart.choice([1, 2])
        return [segment, {"const": "7F"}] if drawn.apart.random() < 0.5 else [segment]
    if drawn.apart.random() < 0.25:
        segment["wrap"] = {"block": drawn.apart.choice([1, 2, 5]), "check": drawn.apart.choice(CHECKS)}
        segment["wrap"] |= drawn.apart.choice([{}, {"as": "hex"}, {"order": "little"}])
        if drawn.apart.random() < 0.4:
            segment["plain"] = drawn.apart.choice([2, 3, "§"])
            if segment["plain"] == "§":
                drawn.expression(segment, "plain", "§", scope)
            return [segment]
    segment["wrap"], end = (
        (segment["wrap"], "")
        if "block" in segment["wrap"]
        else drawn.apart.choice(
            [
                ({"escape": "7D", "xor": "20", "bytes": ["7E", "7D", "10"]}, "7E"),
                ({"escape": "DB", "codes": {"C0": "DC", "DB": "DD"}}, "C0"),
                ("cobs", "00"),
                ("none", ""),
                ({"after": "10 03", "insert": drawn.apart.choice(["03", "10", "FF FF"])}, ""),
            ]
        )
    )
    if end and drawn.apart.random() < 0.7:
        return [segment, {"const": end}]
    name, counted = segment.setdefault("name", drawn.name("w")), drawn.name("n")
    segment["size"] = counted
    return [{"length": counted, "type": "u16", "of": [name]}, segment]


def ciphered(drawn: DrawnDefinition, segment: dict[str, Any], scope: Scope) -> Segments:
    """Wrap the segment with a cipher; its size comes from a length field or is the rest of the region."""
    segment["wrap"] = drawn.keyed.choice(CIPHERS) | {"key": drawn.keyed.choice(AES_KEYS), "iv": IV}
    if drawn.keyed.random() < 0.3:
        return [segment]
    name, counted = segment.setdefault("name", drawn.name("w")), drawn.name("n")
    segment["size"] = counted
    return [{"length": counted, "type": "u16", "of": [name]}, segment]


def check(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    segment: dict[str, Any] = {"check": drawn.random.choice(CHECKS)}
    places = scope.places
    option = drawn.random.randrange(6)
    if option == 0 and places:
        segment["over"] = drawn.random.sample(places, min(len(places), drawn.some(1, 2, 3)))
    elif option == 1 and places:
        segment["over"] = f"{drawn.random.choice(places)}..here"
    elif option == 2 and len(places) > 1:
        low, high = sorted(drawn.random.sample(range(len(places)), 2))
        segment["over"] = f"{places[low]}..{places[high]}"
    elif option == 3 and drawn.chance(0.3):
        segment["over"] = drawn.some("0..1", "1..here")
    if drawn.chance(0.3):
        segment["as"] = drawn.some("hex", "HEX", "nibbles", "raw", "dec")
        if segment["as"] == "hex" and drawn.chance(0.5):
            segment["case"] = "lower"
    if drawn.chance(0.3):
        segment["order"] = drawn.some("little", "big")
    if drawn.chance(0.1):
        segment["verify"] = drawn.some("warn", "off")
    if drawn.chance(0.1):
        segment["size"] = drawn.some(2, 4)
    if drawn.apart.random() < 0.2:
        segment["ends"] = "yes"
    if drawn.keyed.random() < 0.15:
        segment["check"] = drawn.keyed.choice(["hmac-md5", "hmac-sha256", "cmac-aes", "sealed"])
        if segment["check"] != "sealed":
            segment["key"] = drawn.keyed.choice(AES_KEYS)
        if segment.get("as") == "dec":
            segment["as"] = "raw"
        if drawn.keyed.random() < 0.5:
            segment["size"] = 4
    if "over" in segment:
        beside_what_stands(drawn, segment, scope)
    return [segment]


def beside_what_stands(drawn: DrawnDefinition, check: dict[str, Any], scope: Scope) -> None:
    """Add optional keys to a check code.

    These are `wire`, whether wraps are covered as encoded, and bytes that are covered but not transmitted.
    """
    if drawn.apart.random() < 0.3:
        check["wire"] = drawn.apart.choice(["yes", "yes", "no"])
    if drawn.apart.random() < 0.3:
        parts = check["over"] if isinstance(check["over"], list) else [check["over"]]
        added: dict[str, Any] = {"bytes": "h'10 02'"}
        if drawn.apart.random() < 0.6:
            drawn.expression(added, "bytes", drawn.apart.choice(["§ & 0xFF", "§", "get(names, §, 3)"]), scope)
            added |= drawn.apart.choice(
                [{"type": "u8"}, {"type": "u16", "order": "little"}, {"type": "dec", "size": 3}]
            )
        parts.insert(drawn.apart.randrange(len(parts) + 1), added)
        check["over"] = parts


def value(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    name = drawn.name("v")
    segment: dict[str, Any] = {"value": name}
    drawn.expression(segment, "read", drawn.random.choice((*NUMBERS, *CONDITIONS)), scope)
    if drawn.more and drawn.chance(0.5):
        drawn.expression(segment, "read", drawn.some(drawn.number(), drawn.condition()), scope)
    if drawn.chance(0.2):
        drawn.expression(segment, "build", drawn.number(), scope)
    scope.numbers.append(name)
    if drawn.chance(0.1):
        scope.places.append(name)
    return [segment]


def require(drawn: DrawnDefinition, scope: Scope, values: dict[str, Any], depth: int) -> Segments:
    segment: dict[str, Any] = {}
    drawn.expression(segment, "require", drawn.some("§ < 400", "§ >= 0", "§ != 77", "len(¤) < 300"), scope)
    return [segment]


Draw = Callable[[DrawnDefinition, Scope, dict[str, Any], int], Segments]
DRAWN: Mapping[str, Draw] = {
    "const": const, "text": text, "field": field, "bits": bits, "data": data, "length": length, "count": count,
    "repeat": repeat, "choose": choose, "optional": optional, "include": include, "inner": inner, "wrap": wrap,
    "check": check, "skip": skip, "value": value, "require": require,
}  # fmt: skip
"""For every kind of segment, a function that draws it with the segments it needs."""
HOLDERS = ("repeat", "count", "choose", "optional", "include", "inner", "wrap")
LEAVES = ("field", "field", "field", *(kind for kind in DRAWN if kind not in HOLDERS))

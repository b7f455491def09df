"""Roles of the bytes of frames: constants, counters, addresses, lengths, copies of the request, values.

Frames are grouped into kinds by their direction and by the byte that determines their form. In each kind a byte is
named by the property it has in nearly all frames; a byte without such a property stays `unknown`.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from math import log, log2
from typing import NamedTuple

from framekit.definition.problems import plural
from framekit.extras.guess.model import (
    CheckGuess,
    Evidence,
    FieldKind,
    FrameKind,
    Framing,
    GuessedField,
    HeardFrame,
    LengthField,
    Order,
)
from framekit.extras.guess.pieces import LARGEST_SIGNAL
from framekit.extras.guess.texts import is_text, with_texts

HEAD = 12
"""Number of bytes at the head of a frame that are examined singly."""
MOST_KINDS = 12
NEARLY = 0.97
LEAST_STEPS = 6
MOST_COPIED = 6
"""Largest number of bytes at the head of a request that a reply may repeat."""
LEAST_OF_KIND = 3
ENOUGH_OF_FORM = 6
"""Number of frames from which a constant byte is no coincidence."""
FEW = 0.1
"""Largest share of frames that may be damaged or be error replies."""
SURE = 20.0
"""Evidence (bits) from which a counter, a count or a copy is certain."""


class FrameShape(NamedTuple):
    """Sizes of the parts of a plain frame that belong to its framing (bytes)."""

    head: int
    """Size of the start mark."""
    tail: int
    """Size of check and end mark."""
    outside: int = 0
    """Size of the check after the end mark."""


class KindHints(NamedTuple):
    """Hints about kinds that pairs of request and reply give."""

    copies: set[int]
    """Offsets whose byte a reply repeats."""
    turned: frozenset[int]
    """Offsets in a reply with a byte of the request, unchanged or with the same bits inverted."""
    is_asked_for: bool
    """Whether the request determines the size of the reply."""


class AskedTold(NamedTuple):
    """A request and its reply, as plain frames."""

    request: bytes
    reply: bytes


def shape_of(framing: Framing, check: CheckGuess | None, texts: Sequence[bytes]) -> FrameShape:
    """Return the sizes of the parts before and after the content."""
    has_marks = framing.kind in ("marks", "length")
    after, end = framing.behind, framing.plain_end
    has_marks = has_marks and all(
        one.startswith(framing.start) and one[: len(one) - after].endswith(end) for one in texts
    )
    tail = len(end) + after if has_marks else 0
    if check is not None and check.place.at is None:
        tail = max(tail, check.place.behind)
    return FrameShape(len(framing.start) if has_marks else 0, tail, after if has_marks else 0)


def directed(frames: Sequence[HeardFrame], plain: Sequence[bytes]) -> tuple[list[str], float]:
    """Return the sender of each frame (`client`, `server`, or '' if unknown), and the evidence for it in bits.

    If the capture has two directions, the direction of the first frame is the client's. On one wire, and on a port that
    receives both directions, frames alternate.
    """
    ways = [frame.direction for frame in frames]
    if "in" in ways and "out" in ways:
        first = ways[0]
        return ["client" if way == first else "server" for way in ways], 0.0
    bits = 0.0 if len(frames) < 6 else _evidence_of_turns(plain)
    if not bits:
        return [""] * len(frames), 0.0
    return ["client" if number % 2 == 0 else "server" for number in range(len(frames))], bits


def _evidence_of_turns(plain: Sequence[bytes]) -> float:
    """Return the evidence (bits) that requests and replies alternate; 0 if nothing indicates it."""
    forms = [(len(one), one[:2]) for one in plain]
    even, odd = Counter(forms[::2]), Counter(forms[1::2])
    together = [sum(one[:2] == two[:2] for one, two in list(pairwise(plain))[first::2]) for first in (0, 1)]
    counts = len(plain) // 2, (len(plain) - 1) // 2
    if together[0] >= NEARLY * counts[0] and together[1] <= 0.85 * counts[1]:
        return 8.0
    apart = sum(count for form, count in even.items() if form not in odd and count > 1)
    apart += sum(count for form, count in odd.items() if form not in even and count > 1)
    return float(apart) if apart >= 0.9 * len(plain) else 0.0


CLIENT_SERVER = ("client", "server")


def function_place(texts: Sequence[bytes], shape: FrameShape, known: set[int], hints: KindHints) -> int | None:
    """Return the offset in the head whose byte best predicts the size of frames, or None; offsets that replies repeat
    are preferred.

    A byte that is not in `hints.turned` needs as many forms as values, and the request must not determine the size
    already: otherwise the byte may be a measured value.
    """
    shortest = min(len(text) for text in texts)
    before = _surprise(Counter(map(len, texts)))
    best: tuple[float, int] | None = None
    for place in range(shape.head, min(shortest - shape.tail, shape.head + 6)):
        values = Counter(text[place] for text in texts)
        often = sum(count for count in values.values() if count >= LEAST_OF_KIND)
        if place in known or not 2 <= len(values) <= MOST_KINDS or often < 0.8 * len(texts):
            continue
        after = sum(
            count * _surprise(Counter(len(text) for text in texts if text[place] == value))
            for value, count in values.items()
        ) / len(texts)  # fmt: skip
        sizes = len({len(text) for text in texts})
        by_luck = 0.0 if place in hints.copies else (len(values) - 1) * (sizes - 1) / (2 * len(texts) * log(2))
        gain = before - after + (1.0 if place in hints.copies else 0.0)
        if (
            before - after > 0.2 + 2 * by_luck
            and not _is_count(place, texts)
            and (best is None or gain > best[0] + 0.2)
            and (place in hints.turned or (not hints.is_asked_for and _has_forms(place, texts, shape)))
        ):
            best = gain, place
    return None if best is None else best[1]


def _has_forms(place: int, texts: Sequence[bytes], shape: FrameShape) -> bool:
    """Return whether the frames of each value of this byte differ in more than the byte: in size or in constant
    bytes.
    """
    groups: dict[int, list[bytes]] = defaultdict(list)
    for text in texts:
        groups[text[place]].append(text)
    forms = {value: _Form.of(own, place, shape) for value, own in groups.items() if len(own) >= LEAST_OF_KIND}
    return len(forms) > 1 and not any(
        forms[one].is_like(forms[two])
        or (forms[one].sizes & forms[two].sizes and _drifts([text[place] for text in texts], one, two))
        for one, two in combinations(forms, 2)
    )


def _drifts(values: Sequence[int], one: int, two: int) -> bool:
    """Return whether the value changes rarely from one of the two to the other, as a slowly changing quantity does."""
    own = [value for value in values if value in (one, two)]
    changes = sum(before != after for before, after in pairwise(own))
    return changes < 0.5 * min(own.count(one), own.count(two))


class _Form(NamedTuple):
    """Form of the frames that share one value of a byte."""

    sizes: frozenset[int]
    """Sizes of most of the frames."""
    frames: int
    """Number of frames."""
    constants: dict[int, int]
    """Constant bytes by offset, without the byte that selects the frames."""

    @classmethod
    def of(cls, texts: Sequence[bytes], place: int, shape: FrameShape) -> _Form:
        sizes = Counter(map(len, texts))
        often = frozenset(size for size, count in sizes.items() if count >= FEW * len(texts))
        inner = min(len(text) for text in texts) - shape.tail
        places = {at: {text[at] for text in texts} for at in range(shape.head, min(inner, shape.head + HEAD))}
        return cls(often, len(texts), {at: min(own) for at, own in places.items() if at != place and len(own) == 1})

    def is_like(self, other: _Form) -> bool:
        """Return whether the two forms show no difference: a common size, and equal constants if both have enough
        frames.
        """
        if not self.sizes & other.sizes:
            return False
        if min(self.frames, other.frames) < ENOUGH_OF_FORM:
            return True
        return all(other.constants.get(at, value) == value for at, value in self.constants.items())


def _turned(pairs: Sequence[AskedTold], shape: FrameShape, known: set[int]) -> frozenset[int]:
    """Return the offsets at which most replies have a byte of the request's head, unchanged or with the same bits
    inverted, if it has few values that recur.
    """
    if len(pairs) < LEAST_STEPS:
        return frozenset()
    found = set()
    shortest = min(min(len(pair.request), len(pair.reply)) for pair in pairs)
    places = range(shape.head, min(shape.head + MOST_COPIED, shortest - shape.tail))
    for asked in places:
        values = {pair.request[asked] for pair in pairs}
        if asked in known or not 2 <= len(values) <= min(MOST_KINDS, len(pairs) // 2):
            continue
        for replied in places:
            bits = Counter(pair.request[asked] ^ pair.reply[replied] for pair in pairs)
            if replied not in known and bits.most_common(1)[0][1] >= 0.8 * len(pairs):
                found.add(replied)
                found |= {asked} if asked == replied else set()
    return frozenset(found)


def _is_asked_for(pairs: Sequence[AskedTold], shape: FrameShape, copies: set[int]) -> bool:
    """Return whether the request determines the size of most replies, apart from the bytes that replies repeat."""
    sizes: dict[bytes, Counter[int]] = defaultdict(Counter)
    for pair in pairs:
        inner = pair.request[: len(pair.request) - shape.tail]
        key = bytes(byte for at, byte in enumerate(inner) if at not in copies)
        sizes[key][len(pair.reply)] += 1
    again = [own for own in sizes.values() if own.total() > 1]
    count = sum(own.total() for own in again)
    alike = sum(own.most_common(1)[0][1] for own in again)
    return count >= 0.5 * len(pairs) > 0 and alike >= 0.9 * count


def _is_count(place: int, texts: Sequence[bytes]) -> bool:
    """Return whether a byte determines the size in most frames."""
    for unit in (1, 2):
        rest, often = Counter(len(text) - unit * text[place] for text in texts).most_common(1)[0]
        sizes = {len(text) for text in texts if len(text) - unit * text[place] == rest}
        if len(sizes) >= 3 and often >= 0.5 * len(texts):
            return True
    return False


def _surprise(counts: Counter[int]) -> float:
    """Return the entropy of a value with these counts (bits)."""
    whole = sum(counts.values())
    return -sum(count / whole * log2(count / whole) for count in counts.values())


def kinds_of(
    frames: Sequence[HeardFrame], plain: Sequence[bytes], sides: Sequence[str], framing: Framing,
    checks: Sequence[CheckGuess | None], rules: Sequence[int],
) -> list[FrameKind]:  # fmt: skip
    """Return the kinds of frames with their fields.

    `plain`: the frames without their stuffing; `rules`: the checks, each with its frames.
    """
    found = []
    pairs = [(one, two) for one, two in pairwise(range(len(frames))) if (sides[one], sides[two]) == CLIENT_SERVER]
    for rule, check in enumerate(checks):
        own = [number for number, one in enumerate(rules) if one == rule]
        if not own:
            continue
        shape = shape_of(framing, check, [plain[number] for number in own])
        known = _known_places(framing, check)
        some = [AskedTold(plain[one], plain[two]) for one, two in pairs if rule == rules[one] == rules[two]]
        copies = _copies(some, shape, known)
        turned = _turned(some, shape, known)
        hints = KindHints({*copies}, turned, _is_asked_for(some, shape, set(copies) - turned))
        groups = _by_function([(number, sides[number]) for number in own], plain, shape, known, hints)
        heads = {plain[number][shape.head : shape.head + 1] for number in own}
        rule_form = {shape.head} if len(checks) > 1 and len(heads) == 1 else set[int]()
        asked, replies = ([plain[number] for number in own if sides[number] == side] for side in CLIENT_SERVER)
        forms = frozenset(_telling(asked, replies, shape) - known - set(copies) | rule_form)
        for (side, value, place), numbers in groups.items():
            name = {"client": "asked", "server": "told"}.get(side, "frame")
            name = name if value is None else f"{name}_{value:02x}"
            texts = [plain[number] for number in numbers]
            own_copies = _copies_of({*numbers}, pairs, plain, set(copies))
            fields = fields_of(
                texts, shape, framing.length, check, own_copies, is_reply=side == "server", function=place, forms=forms
            )
            own_frames = tuple(frames[number] for number in numbers)
            found.append((numbers[0], FrameKind(name, own_frames[0].direction, fields, own_frames, side, check)))
    order = {"client": 0, "server": 1}
    return [kind for _, kind in sorted(found, key=lambda one: (order.get(one[1].side, 2), one[0]))]


def _by_function(
    numbers: Sequence[tuple[int, str]], plain: Sequence[bytes], shape: FrameShape, known: set[int],
    hints: KindHints,
) -> dict[tuple[str, int | None, int | None], list[int]]:  # fmt: skip
    """Return the numbers of the frames by (side, value of the byte that selects the form, its offset).

    If replies repeat this byte of their request, it separates the frames of the other side too.
    """
    sides: dict[str, list[int]] = defaultdict(list)
    for number, side in numbers:
        sides[side].append(number)
    places = {
        side: function_place(
            [plain[number] for number in own],
            shape,
            known,
            hints._replace(is_asked_for=hints.is_asked_for and side == CLIENT_SERVER[1]),
        )
        for side, own in sides.items()
    }
    repeated = [place for place in places.values() if place in hints.copies]
    groups: dict[tuple[str, int | None, int | None], list[int]] = defaultdict(list)
    for side, own in sides.items():
        place = places[side]
        if repeated and place is None:
            values = Counter(plain[number][repeated[0]] for number in own)
            place = repeated[0] if 2 <= len(values) <= MOST_KINDS else None
        for number in own:
            groups[side, None if place is None else plain[number][place], place].append(number)
    return groups


def _telling(asked: Sequence[bytes], told: Sequence[bytes], shape: FrameShape) -> set[int]:
    """Return the offsets in the head whose byte is constant on either side, with different values on the two sides."""
    if min(len(asked), len(told)) < LEAST_OF_KIND:
        return set()
    shortest = min(map(len, (*asked, *told)))
    found = set()
    for place in range(shape.head, min(shortest - shape.tail, shape.head + MOST_COPIED)):
        values = [{text[place] for text in side} for side in (asked, told)]
        if len(values[0]) == len(values[1]) == 1 and values[0] != values[1]:
            found.add(place)
    return found


def _known_places(framing: Framing, check: CheckGuess | None) -> set[int]:
    places = set(range(len(framing.start)))
    if framing.length is not None:
        places |= set(range(framing.length.offset, framing.length.end))
    if check is not None and check.place.at is not None:
        places |= set(range(check.place.at, check.place.at + check.place.size))
    return places


def _copies(pairs: Sequence[AskedTold], shape: FrameShape, known: set[int]) -> dict[int, Evidence]:
    """Return the offsets at which replies repeat the byte of their request, with the evidence."""
    found: dict[int, Evidence] = {}
    if len(pairs) < LEAST_STEPS:
        return found
    shortest = min(min(len(pair.request), len(pair.reply)) for pair in pairs)
    for place in range(shape.head, min(shape.head + MOST_COPIED, shortest - shape.tail)):
        same = sum(pair.request[place] == pair.reply[place] for pair in pairs)
        values = len({pair.request[place] for pair in pairs})
        if place not in known and same >= NEARLY * len(pairs):
            found[place] = Evidence(same, len(pairs), 8.0 * (values - 1))
    return found


def _copies_of(
    numbers: set[int], pairs: Sequence[tuple[int, int]], plain: Sequence[bytes], places: set[int]
) -> dict[int, Evidence]:
    """Return the evidence of copies from frames of one kind alone."""
    own = [(plain[one], plain[two]) for one, two in pairs if one in numbers or two in numbers]
    found = {}
    for place in places:
        both = [(one[place], two[place]) for one, two in own if place < min(len(one), len(two))]
        same = sum(one == two for one, two in both)
        values = len({one for one, two in both if one == two})
        found[place] = Evidence(same, len(both), 8.0 * max(0, values - 1))
    return found


def fields_of(
    texts: Sequence[bytes], shape: FrameShape, length: LengthField | None, check: CheckGuess | None,
    copies: dict[int, Evidence], *, is_reply: bool, function: int | None, forms: frozenset[int],
) -> tuple[GuessedField, ...]:  # fmt: skip
    """Return the fields of frames of one kind, from the first byte to the last.

    `function`: offset of the byte that selects the kind; `forms`: offsets of constants with other values in other
    kinds.
    """
    shortest, longest = min(map(len, texts)), max(map(len, texts))
    if check is None and longest <= LARGEST_SIGNAL and len(set(texts)) == 1:
        whole = Evidence(len(texts), len(texts))
        return (GuessedField("form", 0, longest, "constant", texts[0].hex(" ").upper(), whole, is_mark=True),)
    head = HEAD if length is None else max(HEAD, length.end)
    inner = min(shortest - shape.tail, head if longest > shortest else max(head, shortest - shape.tail))
    found: list[GuessedField] = []
    at = 0
    if shape.head:
        found.append(GuessedField("start", 0, shape.head, "constant", texts[0][: shape.head].hex(" ").upper()))
        at = shape.head
    while at < inner:
        if at == function or at in forms:
            value, name = f"{texts[0][at]:02X}", "function" if at == function else "form"
            field = GuessedField(name, at, 1, "constant", value, Evidence(len(texts), len(texts)), is_mark=True)
        elif at in copies:
            field = _copied_byte(at, texts, copies[at], is_reply)
        else:
            field = _field_at(at, inner, texts, length, check)
        found.append(field)
        at += field.size
    found = _merged(found, texts)
    if longest > shortest:
        while found and found[-1].kind == "unknown":
            at = found.pop().offset
        about = f"{shortest - shape.tail - at} to {longest - shape.tail - at} bytes"
        kind: FieldKind = "text" if is_text([text[at : len(text) - shape.tail] for text in texts]) else "value"
        found.append(GuessedField("data", at, 0, kind, about))
    found = with_texts(found, texts)
    found += _tail_fields(texts[0], shape, check)
    names = Counter[str]()
    return tuple(_named(field, names) for field in found)


def _copied_byte(at: int, texts: Sequence[bytes], copy: Evidence, is_reply: bool) -> GuessedField:
    """Return the field of a byte that replies repeat; requests may count it up."""
    about, evidence = "as in the request" if is_reply else "the reply repeats it", copy
    steps = None if is_reply else _steps(at, 1, "big", texts)
    if steps is not None:
        about, evidence = f"{ONE_UP}; {about}", steps
    return GuessedField(f"copy_{at}", at, 1, "copy", about, evidence)


def _tail_fields(text: bytes, shape: FrameShape, check: CheckGuess | None) -> Iterator[GuessedField]:
    """Yield the fields after the content of a frame: marks and the check, at offsets from the end."""

    def mark(name: str, before: int, size: int, is_mark: bool = False) -> GuessedField:
        value = text[len(text) - before :][:size].hex(" ").upper()
        return GuessedField(name, -before, size, "constant", value, is_mark=is_mark)

    end_size = shape.tail
    if check is not None and check.place.at is None:
        place = check.place
        if shape.outside:
            yield mark("end", shape.tail, shape.tail - shape.outside)
        elif place.stop:
            yield mark("mark", place.behind, place.stop, is_mark=True)
        yield GuessedField("check", -(place.tail + place.size), place.size, "check", check.name)
        end_size = place.tail
    if end_size:
        yield mark("end", end_size, end_size)


def _field_at(
    at: int, inner: int, texts: Sequence[bytes], length: LengthField | None, check: CheckGuess | None
) -> GuessedField:
    if length is not None and at == length.offset and length.end <= inner:
        return GuessedField("length", at, length.size, "length", _more(length.plus, length.unit))
    if check is not None and check.place.at == at:
        return GuessedField("check", at, check.place.size, "check", check.name)
    value, often = Counter(text[at] for text in texts).most_common(1)[0]
    same = Evidence(often, len(texts), 8.0 * (often - 1))
    if often == len(texts):
        return GuessedField("constant", at, 1, "constant", f"{value:02X}", same)
    counter = _counter(at, inner, texts)
    if counter is not None:
        return counter
    count = _count(at, texts)
    if count is not None:
        return count
    values = len({text[at] for text in texts})
    about = f"{values} values, {min(text[at] for text in texts):02X} to {max(text[at] for text in texts):02X}"
    return GuessedField("unknown", at, 1, "unknown", about)


def _counter(at: int, inner: int, texts: Sequence[bytes]) -> GuessedField | None:
    """Return the widest number that increases by one from frame to frame."""
    choices: tuple[tuple[int, Order], ...] = ((2, "big"), (2, "little"), (1, "big"))
    for width, order in choices:
        if at + width > inner:
            continue
        steps = _steps(at, width, order, texts)
        if steps is not None:
            about = ONE_UP + ("" if width == 1 else f", {order}")
            return GuessedField("counter", at, width, "counter", about, steps)
    return None


ONE_UP = "goes up by one from frame to frame"


def _steps(at: int, width: int, order: Order, texts: Sequence[bytes]) -> Evidence | None:
    """Return the evidence for a number that nearly always increases by one from frame to frame; None if it does not."""
    if len(texts) <= LEAST_STEPS:
        return None
    numbers = [int.from_bytes(text[at : at + width], order) for text in texts]
    steps = sum((two - one) % (1 << 8 * width) == 1 for one, two in pairwise(numbers))
    low = {number & 0xFF for number in numbers}
    if width > 1 and not any(two == one + 1 and two & 0xFF == 0 for one, two in pairwise(numbers)):
        return None  # no carry was seen: the low byte counts, the high byte is a separate field
    if steps < 0.9 * (len(numbers) - 1) or len(low) <= LEAST_STEPS:
        return None
    return Evidence(steps, len(numbers) - 1, 8.0 * steps)


def _more(plus: int, unit: int) -> str:
    """Describe the relation of a number to the size of its frame, in words."""
    if unit == 1:
        return f"the frame has {plural(plus, 'byte')} more"
    return f"it counts words: the frame has twice that, and {plural(plus, 'byte')} more"


def _count(at: int, texts: Sequence[bytes]) -> GuessedField | None:
    """Return the byte that determines the size of the frame."""
    for unit in (1, 2):
        rests = Counter(len(text) - unit * text[at] for text in texts)
        rest, often = rests.most_common(1)[0]
        sizes = len({len(text) for text in texts})
        if often >= NEARLY * len(texts) and sizes > 1 and at < rest <= at + 40:
            about = _more(rest, unit)
            evidence = Evidence(often, len(texts), 8.0 * (sizes - 1))
            return GuessedField("count", at, 1, "count", about, evidence, plus=rest, unit=unit)
    return None


def _merged(fields: Sequence[GuessedField], texts: Sequence[bytes]) -> list[GuessedField]:
    """Merge adjacent constants into one field."""
    found: list[GuessedField] = []
    for field in fields:
        last = found[-1] if found else None
        together: set[FieldKind] = {"constant"}
        if last is not None and last.kind == field.kind and field.kind in together and last.name == field.name:
            size = last.size + field.size
            about = texts[0][last.offset : last.offset + size].hex(" ").upper()
            found[-1] = replace(last, size=size, about=about)
        else:
            found.append(field)
    return found


def _named(field: GuessedField, names: Counter[str]) -> GuessedField:
    """Return the field with a number appended to its name if the name is not unique."""
    names[field.name] += 1
    many = names[field.name] > 1 or field.name in ("unknown", "constant", "text")
    name = f"{field.name}_{names[field.name]}" if many else field.name
    return replace(field, name=name)

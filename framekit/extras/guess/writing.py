"""Output of a guess as a definition in YAML: frames, checks, request and reply.

The definition contains only numbers and hex digits of the capture, and names made by this program.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from framekit.definition.model.checks import CheckMethod
from framekit.extras.guess.checks import FLETCHER
from framekit.extras.guess.model import CheckGuess, FrameKind, Framing, Guess, GuessedField, HeardFrame, Stuffing
from framekit.extras.guess.times import GuessedTimes

TOLD_KINDS = ("unknown", "counter", "copy", "text", "named")
"""Kinds of fields whose description is written as a comment."""


def definition_text(guess: Guess, name: str, source: str) -> str:
    """Return the definition as YAML. `name`: of the protocol; `source`: description of the bytes for its first line."""
    has_sides = {kind.side for kind in guess.kinds} >= {"client", "server"}
    lines = [
        f"# Guessed from {source}: {len(guess.frames)} frames. What stands here was seen; what it means is not known.",
        f"protocol: {name}",
    ]
    if has_sides:
        lines.append("extends: standard")
    lines += ["order: big", *_check_section(guess), *_receiver(guess, has_sides)]
    if has_sides:
        lines += _params(guess.times)
        lines += ["groups:", "  request: {from: client}"]
    lines.append("frames:")
    for kind in guess.kinds:
        lines += _frame(kind, guess, has_sides)
    return "\n".join(lines) + "\n"


STANDARD_TIMEOUT = 1_000_000_000
SHORTEST_TIMEOUT, LONGEST_TIMEOUT = 10_000_000, 60_000_000_000
MOST_RETRIES = 10
"""Retries and time-outs (ns) that may differ from those of `standard`."""


def _params(times: GuessedTimes) -> Iterator[str]:
    """Yield the lines of `params` for the observed time-out and number of repeats of the client."""
    rows = []
    if times.longest_timeout is not None:
        timeout, why = times.longest_timeout, "after that the client went on"
    else:
        timeout, why = 2 * times.slowest, "twice the slowest reply"
    if SHORTEST_TIMEOUT <= timeout <= LONGEST_TIMEOUT and (times.longest_timeout or timeout > STANDARD_TIMEOUT):
        rows.append(f"  reply_timeout: {{default: {timeout // 1_000_000} ms}}  # {why}")
    repeats = None if times.unanswered is None else times.unanswered.repeats
    if repeats is not None and repeats <= MOST_RETRIES:
        rows.append(f"  retries: {{default: {repeats}}}  # as the client did that was heard")
    if rows:
        yield from ("params:", *rows)


def _own_checks(guess: Guess) -> dict[CheckMethod, str]:
    """Return the methods that are not in the catalogue, with their names."""
    own = [kind.check.method for kind in guess.kinds if kind.check is not None and not kind.check.name]
    return {method: f"own_{at}" if at else "own" for at, method in enumerate(dict.fromkeys(own))}


def _check_section(guess: Guess) -> Iterator[str]:
    rows = [f"{name}: {{{_method(method)}}}" for method, name in _own_checks(guess).items()]
    if rows:
        yield f"checks: {{{', '.join(rows)}}}"


def _method(method: CheckMethod) -> str:
    if method.kind == "crc":
        yes = "yes" if method.refin else "no"
        keys = (
            f"width: {method.width}, poly: 0x{method.poly:X}, init: 0x{method.initial:X}, refin: {yes}, "
            f"xorout: 0x{method.xorout:X}"
        )
    elif method.kind == "fold":
        keys = f'fold: "{FLETCHER}", initial: 0, width: 16'
    else:
        base = {"sum": f"sum{method.width}", "word_sum": f"wsum{method.width}", "xor": f"xor{method.width}"}[
            method.kind
        ]
        base += "-little" if method.kind != "sum" and method.order == "little" and method.width > 8 else ""
        keys = f"method: {base}"
        keys += f", complement: {method.complement}" if method.complement else ""
        keys += f", initial: 0x{method.initial:X}" if method.initial else ""
    return keys


def _receiver(guess: Guess, has_sides: bool) -> Iterator[str]:
    """Yield a gap of half a typical short pause between frames, if no other rule ends a frame."""
    framing = guess.framing
    if framing is None or framing.kind not in ("pauses", "fixed"):
        if not has_sides:
            yield "receiver: {gap: 1 s}"
        return
    times = [frame.time for frame in guess.frames if frame.time is not None]
    steps = [after - before for before, after in pairwise(times) if after > before]
    gap = max(5, sorted(steps)[len(steps) // 10] // 2_000_000) if steps else 50
    yield f"receiver: {{gap: {gap} ms, quiet: {gap} ms}}"


def _frame(kind: FrameKind, guess: Guess, has_sides: bool) -> Iterator[str]:
    framing = guess.framing
    assert framing is not None
    keys = []
    if kind.side == "client" and has_sides:
        keys.append("group: request")
    elif kind.side == "server" and has_sides:
        keys.append("from: server")
        asked = [{field.name for field in one.fields} for one in guess.kinds if one.side == "client"]
        echoed = [
            field.name for field in kind.fields if field.kind == "copy" and all(field.name in names for names in asked)
        ]
        if echoed:
            keys.append(f"echo: [{', '.join(echoed)}]")
    yield f"  {kind.name}:"
    for key in keys:
        yield f"    {key}"
    yield "    body:"
    yield from (f"      {line}" for line in _body(kind, framing, guess))


def _body(kind: FrameKind, framing: Framing, guess: Guess) -> Iterator[str]:
    own = "" if kind.check is None else kind.check.name or _own_checks(guess)[kind.check.method]
    segments = list(_segments(kind, framing, own))
    has_marks = any(field.name == "end" for field in kind.fields)
    if framing.stuffing is None or not has_marks:
        yield from (f"- {text}" for text in segments)
        return
    inner = [
        text
        for text, field in zip(segments, kind.fields, strict=True)
        if field.wire or field.name not in ("start", "end", "check")[: 3 if framing.behind else 2]
    ]
    apart = 0 if kind.check is None or kind.check.place.at is not None else kind.check.place.start
    for part in (framing.start[:apart], framing.start[apart:]):  # a check may begin to count within the mark
        if part:
            yield f"- {{const: {_hex(part)}}}"
    coding = _wrap(framing, [frame for one in guess.kinds for frame in one.frames])
    yield from ("- name: content", f"  wrap: {coding}") if framing.behind else (f"- wrap: {coding}",)
    yield "  of:"
    yield from (f"    - {text}" for text in inner)
    yield f"- {{const: {_hex(framing.end)}}}"
    if kind.check is not None and framing.behind:
        yield f"- {_check_behind(kind.check, framing, own)}"


def _check_behind(check: CheckGuess, framing: Framing, name: str) -> str:
    """Return the segment of a check outside of the marks: over the content, and over the end mark without its escape
    byte, if covered.
    """
    order = ", order: little" if check.place.order == "little" and check.place.size > 1 else ""
    digits = ", as: hex" if check.place.form == "hex" else ""
    mark = "" if check.place.stop else f", {{bytes: \"h'{framing.plain_end.hex().upper()}'\"}}"
    start = f"{check.place.start}.." if check.place.start < len(framing.start) else ""
    return f"{{check: {name}{order}{digits}, over: [{start}content{mark}]}}"


def _wrap(framing: Framing, frames: Sequence[HeardFrame]) -> str:
    stuffing = framing.stuffing
    assert stuffing is not None
    if stuffing.kind in ("cobs", "hex"):
        return stuffing.kind
    if stuffing.kind == "doubled":
        return f"{{escape: {stuffing.escape:02X}}}"
    if stuffing.kind == "escape_xor":
        marks = dict.fromkeys((*framing.start, *framing.end, stuffing.escape, *_escaped(stuffing, frames)))
        inside = ", ".join(f"{byte:02X}" for byte in marks)
        return f"{{escape: {stuffing.escape:02X}, xor: {stuffing.xor:02X}, bytes: [{inside}]}}"
    codes = ", ".join(f"{byte:02X}: {code:02X}" for code, byte in stuffing.codes)
    return f"{{escape: {stuffing.escape:02X}, codes: {{{codes}}}}}"


def _escaped(stuffing: Stuffing, frames: Sequence[HeardFrame]) -> list[int]:
    """Return the bytes observed after the escape byte, unescaped."""
    escape = bytes([stuffing.escape])
    seen = {part[0] ^ stuffing.xor for frame in frames for part in frame.data.split(escape)[1:] if part}
    return sorted(seen)


def _segments(kind: FrameKind, framing: Framing, check: str) -> Iterator[str]:
    """Yield a segment for each field. `check`: the name of the check."""
    sized = next((field for field in kind.fields if field.kind in ("length", "count")), None)
    for field in kind.fields:
        about = f"  # {field.about}" if field.about and field.kind in TOLD_KINDS else ""
        match field.kind:
            case "constant" if field.name in ("start", "end", "function") or field.is_mark:
                yield f"{{const: {field.about}}}"
            case _ if field.size == 0:
                yield f"{_data(field, kind, framing, sized)}{about}"
            case "length" | "count" if field is sized:
                yield _length(field, kind, framing)
            case "check":
                yield "" if framing.behind else _check(kind, field, framing, check)
            case "constant":
                yield f"{_plain(field)}  # always {field.about}"
            case _:
                yield f"{_plain(field)}{about}"


def _plain(field: GuessedField) -> str:
    order = f", order: {field.order}" if field.order != "big" else ""
    if field.wire == "bits":
        names = ", ".join(f"{name}: {bit}" for bit, name in enumerate(bit_names(field.name, field.size)))
        return f"{{bits: {{{names}}}, of: u{8 * field.size}{order}}}"
    if field.wire in ("bcd", "decimal"):
        return f"{{field: {field.name}, type: {field.wire}, size: {field.size}{order}{field.keys}}}"
    if field.wire not in ("", "text", "bytes"):
        return f"{{field: {field.name}, type: {field.wire}{order}}}"
    if field.wire == "text" or (field.kind == "text" and not field.wire):
        return f"{{field: {field.name}, type: ascii, size: {field.size}}}"
    if field.size in (1, 2, 4) and not field.wire:
        order = ", order: little" if "little" in field.about else ""
        return f"{{field: {field.name}, type: u{8 * field.size}{order}}}"
    return f"{{data: {field.name}, size: {field.size}}}"


def _data(field: GuessedField, kind: FrameKind, framing: Framing, sized: GuessedField | None) -> str:
    """Return the segment for bytes of varying size; a text ends at the constant bytes after it if they never occur
    within it.
    """
    size = "rest" if sized is None else _size_of_data(sized, kind, framing)
    if "text" in (field.wire, field.kind) and field.wire != "bytes":
        end = _end_of_text(field, kind, framing) if sized is None else b""
        if sized is not None or end:
            until = f"end: [{_hex(end)}]" if end else f"size: {size}"
            return f"{{field: {field.name}, type: ascii, {until}}}"
    return f"{{data: {field.name}, size: {size}}}"


def _end_of_text(field: GuessedField, kind: FrameKind, framing: Framing) -> bytes:
    """Return the constant bytes after a text that never occur within it; empty if none exist or bytes are stuffed."""
    following = kind.fields[kind.fields.index(field) + 1 :]
    is_mark = (
        bool(following) and following[0].kind == "constant" and (following[0].name == "end" or following[0].is_mark)
    )
    if not is_mark or framing.stuffing is not None:
        return b""
    end, after = bytes.fromhex(following[0].about), sum(one.size for one in following)
    texts = (frame.data[field.offset : len(frame.data) - after] for frame in kind.frames)
    return b"" if any(end[:1] in text for text in texts) else end


def _length(field: GuessedField, kind: FrameKind, framing: Framing) -> str:
    """Return the segment of a length field, with the bytes that it counts in addition to the data."""
    length = framing.length
    if field.kind == "length" and length is not None:
        digits = {"hex": "hex", "decimal": "dec"}.get(length.form)
        wire = f"{digits}, size: {length.size}" if digits else f"u{8 * length.width}"
        order = ", order: little" if length.order == "little" else ""
        unit, plus = length.unit, length.plus
    else:
        wire, order, unit, plus = "u8", "", field.unit, field.plus
    data = next((one.name for one in kind.fields if not one.size), None)
    if data is None:
        at = field.offset
        wires = {frame.data[at : at + field.size] for frame in kind.frames}
        if framing.stuffing is None and len(wires) == 1:
            return f"{{const: {_hex(wires.pop())}}}  # {field.name}: {field.about}"
        return f"{{field: {field.name}, type: {wire}{order}}}"
    more = _around(kind) - plus
    plus = -(-more // unit)
    keys = f"of: [{data}]" + (", unit: words" if unit == 2 else "") + (f", plus: {plus}" if plus else "")
    return f"{{length: {field.name}, type: {wire}{order}, {keys}}}"


def _size_of_data(field: GuessedField, kind: FrameKind, framing: Framing) -> str:
    length = framing.length
    is_length = field.kind == "length" and length is not None
    unit = length.unit if is_length and length is not None else field.unit
    plus = length.plus if is_length and length is not None else field.plus
    less = _around(kind) - plus
    text = field.name if unit == 1 else f"{field.name} * {unit}"
    return f'"{text} - {less}"' if less > 0 else f'"{text} + {-less}"' if less < 0 else text


def _around(kind: FrameKind) -> int:
    """Return the number of bytes of a frame other than its data."""
    return sum(field.size for field in kind.fields)


def _check(kind: FrameKind, field: GuessedField, framing: Framing, check: str) -> str:
    """Return the check segment, or a field with a comment if the range cannot be expressed within `wrap`."""
    assert kind.check is not None
    place = kind.check.place
    keys = [f"check: {check}"]
    if place.form == "hex":
        keys.append("as: hex")
    if place.order == "little" and place.size > 1:
        keys.append("order: little")
    first = len(framing.start) if framing.stuffing is not None else 0  # in a wrap its own content counts
    if place.at is not None:
        start, last = place.at + place.size + place.start, _last_counted(kind)
    else:
        start, last = place.start, _before_mark(kind) if place.stop else "here"
    if place.at is not None or start != first or place.stop:
        named = [one.name for one in kind.fields if one.offset == start and not _is_unnamed(one, kind)]
        if framing.stuffing is not None and (
            last.isdigit() or (not named and start > first)
        ):  # offsets within a wrap have no meaning
            return f"{_plain(field)}  # {check}, counted from byte {start} on: no name stands where that begins or ends"
        keys.append(f"over: {named[0] if named and start >= first else start}..{last}")
    return "{" + ", ".join(keys) + "}"


def _is_unnamed(field: GuessedField, kind: FrameKind) -> bool:
    """Return whether a field is a constant in the definition, or bits, each of which has a name of its own."""
    if field.wire:
        return field.wire == "bits"
    is_fixed = field.kind in ("length", "count") and all(one.size for one in kind.fields)
    return field.is_mark or field.name in ("start", "end", "function") or is_fixed


def _before_mark(kind: FrameKind) -> str:
    """Return the last covered field before the uncovered bytes of a code, or the offset of its last byte."""
    before = next(number for number, field in enumerate(kind.fields) if field.name == "mark") - 1
    last = kind.fields[before]
    return str(last.offset + last.size - 1) if _is_unnamed(last, kind) else last.name


def _last_counted(kind: FrameKind) -> str:
    """Return the last field that a check in the head covers."""
    names = [field.name for field in kind.fields if field.name != "end"]
    return names[-1]


def bit_names(name: str, size: int) -> list[str]:
    """Return the names of the bits of `size` bytes, lowest bit first."""
    return [f"{name}_{bit}" for bit in range(8 * size)]


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()


def named_apart(kinds: Sequence[FrameKind]) -> list[FrameKind]:
    """Return the kinds with unique names."""
    seen: dict[str, int] = {}
    found = []
    for kind in kinds:
        seen[kind.name] = seen.get(kind.name, 0) + 1
        name = kind.name if seen[kind.name] == 1 else f"{kind.name}_{seen[kind.name]}"
        found.append(replace(kind, name=name))
    return found

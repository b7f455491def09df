"""Statements about an unknown line from its captured bytes, each with its evidence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from framekit.definition.problems import plural
from framekit.extras.guess.checks import alike, find_checks, holds
from framekit.extras.guess.fields import ONE_UP, SURE, directed, kinds_of
from framekit.extras.guess.framing import BY_CUTTING, CutLine, as_heard, framings_of, readings_of
from framekit.extras.guess.framing import SURE as SURE_FRAMING
from framekit.extras.guess.model import (
    CheckGuess,
    Evidence,
    FrameKind,
    Framing,
    Guess,
    HeardBytes,
    HeardFrame,
    LengthField,
    Statement,
    Stuffing,
)
from framekit.extras.guess.pieces import LARGEST_SIGNAL, Cutting, are_portions, other_cuttings, say_little
from framekit.extras.guess.rules import FrameRule, rules_of
from framekit.extras.guess.stuffing import StuffingError, plain_frame
from framekit.extras.guess.times import GuessedTimes, TimedFrame, shown, times_of
from framekit.extras.guess.writing import named_apart

MOST_FRAMINGS = 4
"""Number of framings tried in search of a check that decides between them."""
MOST_PIECES = 4
"""Largest number of pieces, plus one, in which the system may hand over one frame."""
ENOUGH_CHECKED = 0.9
"""Least share of frames in which a check must hold to confirm the framing."""
MOST_NAMED = 3
"""Largest number of kinds of replies named in a statement."""
WELL = 0.95
"""Share of bytes and ends from which a framing is accepted without further trials."""
LEAST_PIECES = 3
"""Least number of pieces that cutting by pauses must give."""
MOST_TOGETHER = 0.5
"""Least share of pieces that must hold several frames before a piece is split."""
WIDE = 16
"""Width of a check (bits) that hardly ever holds by chance, wherever a piece is cut."""
LONGEST_PART = 512
"""Longest part (bytes) searched for the end of a frame in a piece with several frames."""
MOST_SHOWN = 16
"""Number of bytes of a request shown in a statement."""
MOST_CHECKED = 400
"""Number of frames searched for a check."""


def guess(chunks: Sequence[HeardBytes]) -> Guess:
    """Return the statements about these bytes, which are in order of arrival; a guess without statements if no bytes
    exist.
    """
    found = Guess(chunks)
    if not any(chunk.data for chunk in chunks):
        return found
    best = _best_cut(chunks)
    cut, plain, check = best.cut, best.plain, best.check
    if check is not None:
        cut, plain = _mended(cut, plain, check)
    rules = rules_of(cut.frames, plain, cut.framing, check)
    check = rules[0].check
    found.framing, found.frames, found.noise, found.check = cut.framing, list(cut.frames), cut.noise, check
    _add_kinds(found, best, cut, plain, rules)
    return found


def _add_kinds(
    found: Guess, best: TriedCut, cut: CutLine, plain: Sequence[bytes | None], rules: Sequence[FrameRule]
) -> None:  # fmt: skip
    """Add the kinds of frames, their times, and the statements; nothing if no rule has frames."""
    rule_of = {number: at for at, rule in enumerate(rules) for number in rule.numbers}
    whole = sorted(rule_of)
    frames = [cut.frames[number] for number in whole]
    texts = [text for number in whole if (text := plain[number]) is not None]
    if not texts:
        return
    sides, luck = directed(frames, texts)
    checks = [rule.check for rule in rules]
    kinds = kinds_of(frames, texts, sides, cut.framing, checks, [rule_of[number] for number in whole])
    is_sure = any(check is not None and check.is_sure for check in checks)
    is_shown = is_sure or (best.cutting.kind == "heard" and best.is_seen)
    found.kinds = named_apart(kinds if is_shown else [_unsure(kind) for kind in kinds])
    if not is_sure and not best.is_seen:
        found.statements = [_of_pieces(best.cutting.pieces)]
        return
    found.times = times_of(_timed(cut.frames, found.kinds, len({one.direction for one in frames}) > 1))
    found.statements = [
        *_of_framing(cut),
        *(statement for rule in rules for statement in _of_check(rule.check, rule.which)),
        *_of_sides(sides, luck),
        *_of_times(found.times),
        *_of_fields(found.kinds),
    ]


@dataclass(frozen=True, slots=True)
class TriedCut:
    """The likeliest framing for one cutting of the bytes."""

    cutting: Cutting
    """The pieces that the framing was found in."""
    cut: CutLine
    """The frames as on the wire."""
    plain: list[bytes | None]
    """The frames without stuffing; None for a frame whose stuffing is invalid."""
    check: CheckGuess | None
    """The check of the frames, if one was found."""

    @property
    def is_checked(self) -> bool:
        return self.check is not None and self.check.is_sure and _share(self.check) >= ENOUGH_CHECKED

    @property
    def is_marked(self) -> bool:
        """Return whether marks or a length determine the end of frames."""
        return self.cut.framing.kind in ("marks", "length")

    @property
    def is_told(self) -> bool:
        """Return whether marks and frames explain nearly all of the bytes."""
        few = LEAST_PIECES * len(self.cutting.pieces) if self.cutting.kind == "whole" else 0
        return self.is_marked and self.cut.fit >= WELL and len(self.cut.frames) > few

    @property
    def is_seen(self) -> bool:
        """Return whether there is evidence for the framing other than the cutting."""
        framing = self.cut.framing
        if self.is_checked or framing.kind in ("marks", "length") or framing.start or framing.end:
            return True
        return not say_little(self.cutting.pieces)

    @property
    def good(self) -> list[HeardFrame]:
        """Return the frames in which the check holds."""
        check, pairs = self.check, zip(self.cut.frames, self.plain, strict=True)
        return [] if check is None else [one for one, text in pairs if text is not None and holds(check, text)]

    @property
    def rank(self) -> tuple[float, int]:
        """Return the share of bytes in which the check holds, up to `ENOUGH_CHECKED`, and the number of those frames.

        The number decides between good framings: two adjacent frames often have a check together, while each has its
        own.
        """
        good = self.good
        share = sum(len(one.data) for one in good) / sum(len(piece.data) for piece in self.cutting.pieces)
        return min(share, ENOUGH_CHECKED), len(good)


def _best_cut(chunks: Sequence[HeardBytes]) -> TriedCut:
    """Return the best cutting: the captured pieces if they explain the bytes, else the cutting whose check holds in the
    most bytes.

    If the pieces are weak evidence and no check holds, return the first cutting with marks or a length, or else the
    cutting at the clearest pauses.
    """
    first = _tried(chunks, as_heard(chunks))
    framing = first.cut.framing
    is_sure = first.is_told and framing.evidence.chance >= SURE_FRAMING
    if first.is_checked or (is_sure and not say_little(chunks)):
        return _in_parts(first) or first
    best, most = first, first.rank
    little = not (framing.start or framing.end) and (
        say_little(first.cutting.pieces) or are_portions(first.cutting.pieces)
    )
    apart: TriedCut | None = None
    for cutting in other_cuttings(chunks):
        tried = _tried(chunks, cutting)
        tried = _in_parts(tried) or tried
        if tried.is_checked and (tried.rank > most or not best.is_checked):
            best, most = tried, tried.rank
        elif little and not best.is_checked and tried.is_told and not best.is_told:
            best = tried
        if apart is None and cutting.kind == "pauses" and not say_little(cutting.pieces):
            apart = tried if len(cutting.pieces) >= LEAST_PIECES else None
    if little and not best.is_checked and not best.is_told and apart is not None:
        best = apart
    return _doubted(best)


def _in_parts(tried: TriedCut) -> TriedCut | None:
    """Split pieces that consist of several adjacent frames, such as request and reply on one wire; return None if they
    do not.

    The CRC over both frames together fits with another initial register, and the CRC of each frame fits with its usual
    register.
    """
    check, framing = tried.check, tried.cut.framing
    if not tried.is_checked or check is None or check.name or check.method.kind != "crc":
        return None
    if framing.kind == "marks" or check.place.at is not None:
        return None
    for usual in alike(check):
        frames, together = list[HeardFrame](), 0
        for frame in tried.cut.frames:
            parts = _parts(usual, frame.data)
            together += len(parts) > 1
            frames += [frame._replace(data=part) for part in parts or [frame.data]]
        if together >= MOST_TOGETHER * len(tried.cut.frames):
            held = sum(holds(usual, one.data) for one in frames)
            usual = replace(usual, evidence=Evidence(held, len(frames), check.evidence.chance))
            plain = Framing("pauses", evidence=Evidence(held, len(frames)))
            cut = replace(tried.cut, frames=tuple(frames), framing=plain)
            return replace(tried, cut=cut, plain=[one.data for one in frames], check=usual)
    return None


def _parts(check: CheckGuess, data: bytes) -> list[bytes]:
    """Return the adjacent frames in these bytes, two or more; an empty list if the rest is no frame."""
    least = check.place.start + check.place.size + check.place.tail + 1
    for end in range(least, min(len(data) - least, LONGEST_PART) + 1):
        if holds(check, data[:end]):
            rest = data[end:]
            return [data[:end], *([rest] if holds(check, rest) else _parts(check, rest) or [rest])]
    return []


def _doubted(tried: TriedCut) -> TriedCut:
    """Mark size and uncatalogued check as uncertain if only pauses separate frames on one wire: a piece may be a
    request with its reply.
    """
    check, cut = tried.check, tried.cut
    two_ways = len({piece.direction for piece in tried.cutting.pieces}) > 1
    if tried.cutting.kind != "pauses" or two_ways or (check is not None and check.name):
        return tried
    framing = cut.framing
    if framing.kind == "length":
        evidence = replace(framing.evidence, chance=min(framing.evidence.chance, BY_CUTTING))
        cut = replace(cut, framing=replace(framing, evidence=evidence))
    return replace(tried, cut=cut, check=None if check is None else replace(check, is_sure=False))


def _tried(chunks: Sequence[HeardBytes], cutting: Cutting) -> TriedCut:
    """Return the likeliest framing with a check in nearly all of its frames; else the framing whose check holds in the
    largest share; without any check, the likeliest framing.
    """
    first: TriedCut | None = None
    best: tuple[float, TriedCut] | None = None
    cuts = framings_of(chunks, cutting)
    for cut in [*cuts[:-1][:MOST_FRAMINGS], cuts[-1]]:
        plain = [_plain(cut.framing, frame.data) for frame in cut.frames]
        texts = [text for text in plain if text is not None][:MOST_CHECKED]
        first = first or TriedCut(cutting, cut, plain, None)
        checks = find_checks(texts, *_around(cut.framing)) if texts else []
        if not checks:
            continue
        found = _of_digits(cut, checks[0]) or (cut, plain, checks[0])
        tried = TriedCut(cutting, *found)
        if tried.is_checked:
            return tried
        if best is None or _share(found[2]) > best[0]:
            best = _share(found[2]), tried
    assert first is not None
    return first if best is None else best[1]


def _around(framing: Framing) -> tuple[int, int]:
    """Return the sizes of the start mark and of the end mark."""
    return len(framing.start), 0 if framing.behind else len(framing.end)


def _share(check: CheckGuess) -> float:
    return check.evidence.holds / check.evidence.of


def _of_digits(cut: CutLine, check: CheckGuess) -> tuple[CutLine, list[bytes | None], CheckGuess] | None:
    """Return frames, plain bytes and check with hex digits decoded if everything between the marks is hex digits and
    the check covers the decoded bytes; else None.
    """
    framing = cut.framing
    if check.place.counted != "hex" or framing.kind != "marks":
        return None
    good = [one.data for one in cut.frames if holds(check, one.data)]
    framing = replace(framing, stuffing=Stuffing("hex"), evidence=Evidence(len(good), len(cut.frames), SURE))
    plain = [_plain(framing, one.data) for one in cut.frames]
    texts = [text for text in plain if text is not None]
    if not good or len(texts) < 0.9 * len(cut.frames):
        return None
    checks = find_checks(texts[:MOST_CHECKED], len(framing.start), len(framing.end))
    return (replace(cut, framing=framing), plain, checks[0]) if checks else None


def _mended(cut: CutLine, plain: list[bytes | None], check: CheckGuess) -> tuple[CutLine, list[bytes | None]]:
    """Join frames that came in two pieces, and split pieces that hold several frames, as the check shows."""
    if cut.framing.kind not in ("pauses", "fixed") or cut.framing.stuffing is not None:
        return cut, plain
    frames: list[HeardFrame] = []
    at = 0
    while at < len(cut.frames):
        frame = cut.frames[at]
        at += 1
        whole = frame.data
        if not holds(check, whole):
            parts = _parts(check, whole) if check.method.width >= WIDE else []
            if parts and holds(check, parts[-1]):
                frames += [frame._replace(data=part) for part in parts]
                continue
            for more in range(1, MOST_PIECES):
                after = cut.frames[at : at + more]
                if len(after) < more or any(one.direction != frame.direction for one in after):
                    break
                together = whole + b"".join(one.data for one in after)
                if holds(check, together):
                    frame, at = frame._replace(data=together), at + more
                    break
        frames.append(frame)
    framing = cut.framing
    evidence = Evidence(sum(holds(check, one.data) for one in frames), len(frames), framing.evidence.chance)
    framing = replace(framing, kind="pauses", fixed=0, evidence=evidence)
    return replace(cut, frames=tuple(frames), framing=framing), [one.data for one in frames]


def _plain(framing: Framing, data: bytes) -> bytes | None:
    try:
        return plain_frame(framing, data)
    except StuffingError:
        return None


def _unsure(kind: FrameKind) -> FrameKind:
    """Return the kind with the evidence of its fields removed: the frames were cut by this analysis only."""
    fields = (replace(one, evidence=replace(one.evidence, chance=0.0)) for one in kind.fields)
    return replace(kind, fields=tuple(fields))


# ---- statements -------------------------------------------------------------------------------------------------


def _of_pieces(pieces: Sequence[HeardBytes]) -> Statement:
    """Return the only statement possible if the pieces are portions of a transfer and frames are not recognizable."""
    size, often = Counter(len(piece.data) for piece in pieces).most_common(1)[0]
    text = f"pieces of {plural(size, 'byte')} are how the bytes were handed over; where frames end was not found"
    return Statement(text, Evidence(often, len(pieces)), False, "frames of that size")


def _of_framing(cut: CutLine) -> Iterator[Statement]:
    framing, frames = cut.framing, cut.frames
    marks = [f"begins with {_hex(framing.start)}"] * bool(framing.start)
    after = f", and {plural(framing.behind, 'byte')} behind it" if framing.behind else ""
    marks += [f"ends with {_hex(framing.end)}{after}"] * bool(framing.end)
    alike = Evidence(
        sum(
            one.data.startswith(framing.start) and one.data.endswith(framing.end, 0, len(one.data) - framing.behind)
            for one in frames
        ),
        len(frames),
    )
    if marks:
        yield Statement(f"a frame {' and '.join(marks)}", alike, False, "a frame without that")
    sure = framing.evidence.chance >= SURE_FRAMING
    if framing.kind == "length" and framing.length is not None:
        length = framing.length
        what = _place_of(length)
        others = [_place_of(one) for one in readings_of(length, frames)]
        what += f" (or {', or '.join(others)})" if others else ""
        text = f"the length stands in {what}: a frame has {_of_length(length)}"
        yield Statement(text, framing.evidence, sure, "a frame of another size")
    elif framing.kind == "fixed":
        yield Statement(f"every frame has {plural(framing.fixed, 'byte')}", alike, False, "a frame of another size")
    elif framing.kind == "pauses":
        yield Statement("frames are told apart by pauses", alike, False, "a pause inside of a frame")
    else:
        yield Statement("its end is told by that mark", framing.evidence, sure, "the mark inside of a frame")
    if framing.stuffing is not None:
        against = "another sign" if framing.stuffing.kind == "hex" else "an escape byte before anything else"
        yield Statement(f"inside, {_stuffed(framing)}", framing.evidence, sure, against)


def _of_length(length: LengthField) -> str:
    """Describe the size of a frame."""
    if length.unit != 1:
        return f"{length.unit} × its value and {plural(length.plus, 'byte')}"
    if not length.plus:
        return "as many bytes"
    return f"{plural(abs(length.plus), 'byte')} {'more' if length.plus > 0 else 'fewer'} than it says"


def _place_of(length: LengthField) -> str:
    if length.form == "decimal":
        return f"{length.width} decimal digits at {length.offset}"
    digits = " as hex digits" if length.form == "hex" else ""
    order = "" if length.width == 1 else f", {length.order} end first"
    return f"{length.width} byte{'s' * (length.width > 1)} at {length.offset}{digits}{order}"


def _stuffed(framing: Framing) -> str:
    stuffing = framing.stuffing
    assert stuffing is not None
    match stuffing.kind:
        case "cobs":
            return "bytes are written by COBS"
        case "hex":
            return "each byte is written as two hex digits"
        case "doubled":
            return f"{stuffing.escape:02X} is written twice"
        case "escape_xor":
            return f"a mark is written as {stuffing.escape:02X} and the byte xor {stuffing.xor:02X}"
    codes = ", ".join(f"{code:02X} for {byte:02X}" for code, byte in stuffing.codes)
    return f"a mark is written as {stuffing.escape:02X} and a code: {codes}"


def _of_check(check: CheckGuess | None, which: str) -> Iterator[Statement]:
    if check is None:
        return
    place = check.place
    where = f"at {place.at}" if place.at is not None else "at the end"
    if place.at is None and place.tail:
        where = f"before the last {place.tail} byte{'s' * (place.tail > 1)}"
    name = check.name or own_name(check)
    where += f" of frames {which}" if which else ""
    text = f"the check {where} is {name}, from byte {place.start} on"
    text += f" without the {place.stop} before it" if place.stop and place.at is None else ""
    text += f", {place.order} end first" if place.size > 1 and place.form == "binary" else ""
    text += ", as hex digits" if place.form == "hex" else ""
    if check.others:
        text += f" (or {', or '.join(check.others[:3])})"
    yield Statement(
        f"{text}; equal frames count once",
        check.evidence,
        check.is_sure,
        "a frame in which it does not hold, and that was not damaged",
    )


def own_name(check: CheckGuess) -> str:
    """Describe a check that is not in the catalogue."""
    method = check.method
    if method.kind == "crc":
        reflected = ", reflected" if method.refin else ""
        return (
            f"a CRC of {method.width} bits, polynomial {method.poly:X}, init {method.initial:X}{reflected}, "
            f"xorout {method.xorout:X}"
        )
    complement = f", {method.complement}' complement" if method.complement else ""
    return f"{method.kind} of {method.width} bits{complement}, and {method.initial:X}"


def _of_sides(sides: Sequence[str], luck: float) -> Iterator[Statement]:
    counts = Counter(sides)
    if counts["client"] and counts["server"]:
        turns = sum(one != two for one, two in pairwise(sides))
        evidence = Evidence(turns, len(sides) - 1, luck)
        yield Statement("requests and replies take turns", evidence, False, "two of one side in a row")


def _timed(frames: Sequence[HeardFrame], kinds: Sequence[FrameKind], two_ways: bool) -> list[TimedFrame]:
    """Return the frames in order with their kinds; the direction determines the sender of a damaged frame.

    A signal of the client, such as ACK, is omitted.
    """
    kind_of = {id(frame): kind for kind in kinds for frame in kind.frames}
    sides = {kind.direction: kind.side for kind in kinds if two_ways}
    found = []
    for one in frames:
        kind = kind_of.get(id(one))
        side, name = (sides.get(one.direction, ""), "") if kind is None else (kind.side, kind.name)
        if side != "client" or len(one.data) > LARGEST_SIGNAL:
            found.append(TimedFrame(one.time, side, name, one.data))
    return found


def _of_times(times: GuessedTimes) -> Iterator[Statement]:
    for answers in times.answers:
        if not answers.told:
            continue
        names = [f"{name} ({count})" if len(answers.told) > 1 else name for name, count in answers.told[:MOST_NAMED]]
        if others := answers.told[MOST_NAMED:]:
            names.append(f"{len(others)} more ({sum(count for _, count in others)})")
        delay = f", after {answers.delay}" if answers.delay is not None else ""
        text = f"{answers.asked} is answered by {' or '.join(names)}{delay}"
        yield Statement(text, Evidence(answers.answered, answers.of), False, "another frame after it")
    silence = times.unanswered
    if silence is not None and silence.wait is not None:
        text = f"without a reply the next request follows after {silence.wait}"
        if times.longest_timeout is not None:
            text += f": a time-out of {shown(times.longest_timeout)} at most"
            if silence.pause is not None and 0.05 * silence.wait.least < silence.pause < silence.wait.least:
                rest = shown(silence.wait.least - silence.pause)
                text += f", of {rest} if it pauses then as after a reply ({shown(silence.pause)})"
        yield Statement(text, Evidence(silence.count, silence.of), False, "a reply that came later and was taken")
    if silence is not None and silence.repeats is not None:
        often = f"repeated {plural(silence.repeats, 'time')}" if silence.repeats else "not repeated"
        evidence = Evidence(silence.alike, silence.given_up)
        yield Statement(f"a request without a reply is {often}", evidence, False, "another number of repeats")
    for one in times.periods:
        which = f" {_hex(one.data)}" if one.data and len(one.data) <= MOST_SHOWN else ""
        yield Statement(f"{one.kind}{which} comes every {one.every}", Evidence(one.near, one.of), False)


def _of_fields(kinds: Sequence[FrameKind]) -> Iterator[Statement]:
    for kind in kinds:
        for field in kind.fields:
            if field.kind in ("counter", "count") or (
                field.kind == "copy" and (kind.side == "server" or field.about.startswith(ONE_UP))
            ):
                where = (
                    f"byte {field.offset}"
                    if field.size == 1
                    else f"bytes {field.offset} to {field.offset + field.size - 1}"
                )
                is_sure = field.evidence.chance >= SURE
                yield Statement(f"{kind.name}: {where} {field.name}: {field.about}", field.evidence, is_sure)


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()

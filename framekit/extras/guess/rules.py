"""Frames of one line that follow different rules: a short request and a long reply, an ACK, a mark before commands.

If the check of most frames holds in none of the frames with a common beginning, these get a check of their own, or
none. If no check holds in all frames, checks are searched in the frames of each direction and of each common beginning.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

from framekit.extras.guess.checks import LARGEST_START, find_checks, holds
from framekit.extras.guess.model import CheckGuess, Evidence, Framing, HeardFrame

LEAST_FRAMES = 3
FEW = 0.1
"""Share of the frames of another rule in which a check of 8 bits may hold by chance."""
MOST_HEADS = 4
"""Largest number of different first bytes that may belong to separate rules."""
MOST_CHECKED = 400


@dataclass(frozen=True, slots=True)
class FrameRule:
    """Frames that have the same check, or none. `which`: description of these frames; '' for most frames."""

    check: CheckGuess | None
    numbers: frozenset[int]
    which: str = ""


def rules_of(
    frames: Sequence[HeardFrame], plain: Sequence[bytes | None], framing: Framing, check: CheckGuess | None
) -> list[FrameRule]:
    """Return the rules, the rule of most frames first. Frames without a rule are damaged."""
    texts = {number: text for number, text in enumerate(plain) if text is not None}
    if check is None or not check.is_sure:
        found = _by_groups(frames, texts, framing)
        if found:
            return found
    if check is None:
        return [FrameRule(None, frozenset(texts))]
    good = frozenset(number for number, text in texts.items() if holds(check, text))
    rest = {number: text for number, text in texts.items() if number not in good}
    others, other_numbers = [], set[int]()
    for head, numbers in _by_head(texts, len(framing.start)).items():
        bad = [number for number in numbers if number in rest]
        if len(bad) < LEAST_FRAMES or len(bad) < (1 - FEW) * len(numbers):
            continue
        which = f"that begin with {head.hex(' ').upper()}"
        others.append(_rule(bad, texts, framing, check, which))
        other_numbers.update(bad)
    distinct = {text for number, text in texts.items() if number not in other_numbers}
    held = sum(holds(check, text) for text in distinct)
    check = replace(check, evidence=Evidence(held, len(distinct), check.evidence.chance))
    return [FrameRule(check, good), *others]


def _rule(
    numbers: Sequence[int], texts: dict[int, bytes], framing: Framing, main: CheckGuess | None, which: str
) -> FrameRule:
    """Return the rule of frames in which the main check does not hold: preferably the same check from another byte
    on.
    """
    distinct = list(dict.fromkeys(texts[number] for number in numbers))
    found: CheckGuess | None = None
    if main is not None and main.place.at is None and len(distinct) >= LEAST_FRAMES:
        for start in range(LARGEST_START + 1):
            other = replace(main, place=replace(main.place, start=start), others=())
            held = sum(holds(other, text) for text in distinct)
            if held >= 0.95 * len(distinct):
                chance = main.method.width * held - 4.0
                found = replace(other, evidence=Evidence(held, len(distinct), chance), is_sure=chance >= 2 * LEAST)
                break
    if found is None and len(distinct) >= LEAST_FRAMES:
        found = next(
            iter(find_checks(distinct[:MOST_CHECKED], len(framing.start), 0 if framing.behind else len(framing.end))),
            None,
        )
    own = [number for number in numbers if found is None or holds(found, texts[number])]
    return FrameRule(found, frozenset(own), which)


LEAST = 12.0
"""Evidence (bits) from which the same check from another byte on is accepted."""


def _by_head(texts: dict[int, bytes], head: int) -> dict[bytes, list[int]]:
    groups: dict[bytes, list[int]] = defaultdict(list)
    for number, text in texts.items():
        groups[text[head : head + 1]].append(number)
    return groups


def _by_groups(frames: Sequence[HeardFrame], texts: dict[int, bytes], framing: Framing) -> list[FrameRule]:
    """Return rules with a check for the frames of each direction or of each common beginning; an empty list if no group
    has a check.
    """
    ways: dict[str, list[int]] = defaultdict(list)
    for number in texts:
        ways[{"in": "that came in", "out": "that went out"}.get(frames[number].direction, "")].append(number)
    heads = {
        f"that begin with {head.hex(' ').upper()}": numbers
        for head, numbers in _by_head(texts, len(framing.start)).items()
    }
    tried: list[set[frozenset[int]]] = []
    for groups in (ways, heads):
        parts = {frozenset(numbers) for numbers in groups.values()}
        if not 2 <= len(groups) <= MOST_HEADS or parts in tried:
            continue
        tried.append(parts)
        rules = [_rule(numbers, texts, framing, None, which) for which, numbers in groups.items()]
        sure = [one for one in rules if one.check is not None and one.check.is_sure]
        if sure:
            main = max(sure, key=lambda one: len(one.numbers))
            again = [
                one if one.check is not None else _rule(list(one.numbers), texts, framing, main.check, one.which)
                for one in rules
            ]
            return sorted(again, key=lambda one: one.which != main.which)
    return []

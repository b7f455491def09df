"""What each value of a frame must be, as a table that generated encoders explain refusals with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from framekit.codec.python import forms
from framekit.codec.python.module import Module
from framekit.codec.python.registry import kind_of
from framekit.codec.python.source import quoted
from framekit.definition.model.frames import flat
from framekit.definition.model.segments import (
    Count,
    Length,
    Segment,
)

Lengths = Mapping[str, forms.Range]
Rules = Iterable[tuple[str, str]]
"""Names of values, each with the text of its rule."""


class RuleWriter:
    """Writes the rules of the values of a list of segments."""

    def __init__(self, module: Module, title: str) -> None:
        self.module = module
        self.title = title
        module.function("Rule")

    def mapping(self, segments: tuple[Segment, ...]) -> str:
        """The mapping name → rule, as text."""
        branches = {id(one) for segment in flat(segments) for one in _in_branches(segment)}
        lengths = _lengths(segments)
        found: dict[str, str] = {}
        for segment in flat(segments):
            always = id(segment) not in branches and segment.when is None
            for name, rule in kind_of(segment).rules(self, segment, always, lengths):
                found.setdefault(name, rule)
        return "{" + ", ".join(f"{quoted(name)}: {rule}" for name, rule in found.items()) + "}"

    def rule(
        self,
        kind: str,
        limits: forms.Range,
        needed: bool,
        names: str = "",
        inside: str = "",
        only: bool = False,
        unit: int = 1,
    ) -> str:
        parts = [quoted(kind)]
        if limits.least is not None or limits.most is not None:
            parts += [str(limits.least), str(limits.most)]
        if needed:
            parts.append("needed=True")
        if names:
            parts.append(f"names={names}")
        if only:
            parts.append("only=True")
        if unit != 1:
            parts.append(f"unit={unit:_}")
        if inside:
            parts.append(f"inside={inside}")
        return f"Rule({', '.join(parts)})"


def _in_branches(segment: Segment) -> Iterable[Segment]:
    for block in () if segment.is_there_inside else segment.blocks:
        yield from flat(block)


def _lengths(segments: tuple[Segment, ...]) -> dict[str, forms.Range]:
    """How long a value may be because of the one length or count that stands for it alone."""
    found: dict[str, forms.Range] = {}
    for segment in flat(segments):
        limits = forms.value_range(segment) if isinstance(segment, (Length, Count)) else forms.Range(None, None)
        least, most = limits.least, limits.most
        if isinstance(segment, Length) and len(segment.of) == 1 and segment.unit == 1 and segment.plus == 0:
            found[segment.of[0]] = forms.Range(least or None, most)
        if isinstance(segment, Count) and segment.plus == 0:
            found[segment.of] = forms.Range(least or None, most)
    return found

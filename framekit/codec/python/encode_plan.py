"""What an encoder knows before it is written: the order of its values, the bytes its checks need kept, its rules.

Each value comes after those it depends on; fields may refer to later ones. Where values refer to each other in a
circle, one that may be given is taken from what was given. A check that covers everything before it in its buffer needs
nothing kept; for any other, the segments it covers are put together apart from their neighbours. The rules say what
each value must be; refusals are explained with them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from framekit.codec.python import forms
from framekit.codec.python.function import covered_names, covered_parts, on_the_wire, standing
from framekit.codec.python.module import Module
from framekit.codec.python.registry import kind_of
from framekit.codec.python.source import quoted
from framekit.definition.kinds.check import Added
from framekit.definition.model.frames import everything, flat
from framekit.definition.model.segments import Check, Count, Length, Segment

Lengths = Mapping[str, forms.Range]
Rules = Iterable[tuple[str, str]]
"""Names of values, each with the text of its rule."""


@dataclass(slots=True)
class Task:
    """One thing to write: the names it gives, those it waits for, and how it is written.

    `write(missing)` gets the names that are not there yet because of a circle; they are read from the given values. In
    a circle a task with `may_be_given` is taken first, one with `prefer` before all.
    """

    gives: tuple[str, ...]
    waits_for: set[str]
    write: Callable[[set[str]], None]
    may_be_given: bool = False
    prefer: bool = False
    done: bool = field(default=False, init=False)


def run_in_order(tasks: list[Task]) -> None:
    """Writes every task after those it waits for, as far as possible in the order given."""
    givers = {name: task for task in tasks for name in task.gives}
    while pending := [task for task in tasks if not task.done]:
        ready = next((task for task in pending if not _open(task, givers)), None)
        if ready is None:
            given = [task for task in pending if task.may_be_given]
            ready = next((task for task in given if task.prefer), (given or pending)[0])
        ready.done = True
        ready.write(_open(ready, givers))


def _open(task: Task, givers: dict[str, Task]) -> set[str]:
    """The names a task still waits for."""
    return {name for name in task.waits_for if name in givers and not givers[name].done and givers[name] is not task}


class Coverage:
    """`of(name)`: a mark for a segment; neighbours with the same mark may be put together."""

    def __init__(self, segments: tuple[Segment, ...]) -> None:
        self.segments = segments
        self.by_name = {segment.name: segment for segment in everything(segments) if segment.name}
        self.whole: set[str] = set()
        self._marks: dict[str, frozenset[str]] = {}
        for buffer, begins in buffers(segments):
            for check in checks_in(buffer):
                self._add(check, buffer, begins)

    def of(self, names: Iterable[str]) -> frozenset[str]:
        return frozenset(mark for name in names for mark in self._marks.get(name, ()))

    def names(self, check: Check) -> list[str] | None:
        """The leaves a check covers, in the order it covers them; None: everything before it."""
        return None if check.covers is None else covered_names(check, self.segments)

    def parts(self, check: Check) -> list[list[str] | Added]:
        """What its `over` says that a check covers: runs of segments, and what is not on the wire between them."""
        return covered_parts(check, self.segments)

    def _add(self, check: Check, buffer: tuple[Segment, ...], begins: bool) -> None:
        names = self.names(check)
        before: list[Segment] = []
        for segment in standing(check, buffer):
            if segment is check:
                break
            before.append(segment)
        here = [segment.name for segment in before]
        mixed = not check.wire and any(segment.is_there_inside for segment in on_the_wire(buffer))
        if names is None or (names == here and begins and not mixed and not check.added):
            self.whole.add(check.name or "")
            return
        in_order = names == [name for name in here if name in names]
        for part, run in enumerate(one for one in self.parts(check) if isinstance(one, list)):
            for place, name in enumerate(run):
                mark = f"{check.name} {part}" if in_order else f"{check.name} {part} {place}"
                self._marks[name] = self._marks.get(name, frozenset()) | {mark}


def buffers(segments: tuple[Segment, ...], begins: bool = True) -> Iterator[tuple[tuple[Segment, ...], bool]]:
    """Every list of segments whose bytes are put together on their own; whether nothing stands before it."""
    yield segments, begins
    for segment in segments:
        for block in segment.blocks:
            yield from buffers(block, segment.is_there_inside)
        if segment.inner_record is not None:  # what a record holds stands in the buffer around it
            yield from list(buffers(segment.inner_record))[1 if segment.is_record else 0 :]


def checks_in(segments: Iterable[Segment]) -> Iterator[Check]:
    """The checks that stand in a buffer itself."""
    for segment in segments:
        if isinstance(segment, Check):
            yield segment
        elif segment.is_record:
            yield from checks_in(segment.members)


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
        fits: str = "",
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
        if fits:
            parts.append(f"fits={fits}")
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

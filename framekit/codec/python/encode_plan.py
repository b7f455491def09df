"""Plan an encoder: the order of its values, the bytes that checks cover, its rules and its structs.

Each value comes after its dependencies; fields may refer to later fields. If values depend on each other in a circle, a
value that may be given is taken from the given values. A check that covers everything before it in its buffer needs no
kept bytes; for any other check, the covered segments are assembled separately. Rules describe the allowed values and
explain refusals. A pack plan lists the arguments of one struct.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from heapq import heappop, heappush

from framekit.codec.python import forms
from framekit.codec.python.function import covered_parts, covered_paths, on_the_wire, standing
from framekit.codec.python.module import Module
from framekit.codec.python.registry import kind_of
from framekit.codec.python.source import bytes_literal, quoted
from framekit.definition.kinds.check import Added
from framekit.definition.model.frames import flat
from framekit.definition.model.segments import Check, Count, FieldType, Length, Segment

Lengths = Mapping[str, forms.Range]
"""Limits of the sizes of values, by name."""
Rules = Iterable[tuple[str, str]]
"""Names of values, each with the source of its rule."""


@dataclass(slots=True)
class Task:
    """A piece of source to write, with the names it provides and the names it waits for."""

    gives: tuple[str, ...]
    """The names that the task provides."""
    waits_for: set[str]
    """The names that must be available first."""
    write: Callable[[set[str]], None]
    """Writes the source, given the names that a circle leaves missing.

    Missing names are read from the given values.
    """
    may_be_given: bool = False
    """Whether the value may be given, so that the task can break a circle."""
    prefer: bool = False
    """Whether the task breaks a circle before all others."""
    done: bool = field(default=False, init=False)


def run_in_order(tasks: list[Task]) -> None:
    """Run every task after its dependencies, in the given order as far as possible."""
    givers = {name: task for task in tasks for name in task.gives}
    missing = [{name for name in task.waits_for if givers.get(name, task) is not task} for task in tasks]
    waiting: dict[str, list[int]] = {}
    for place, names in enumerate(missing):
        for name in names:
            waiting.setdefault(name, []).append(place)
    ready = [place for place, names in enumerate(missing) if not names]  # in order, so it is a heap
    in_circles = iter(sorted(range(len(tasks)), key=lambda place: (*_rank(tasks[place]), place)))
    for _ in tasks:
        place = heappop(ready) if ready else next(place for place in in_circles if not tasks[place].done)
        task = tasks[place]
        task.done = True
        task.write(set(missing[place]))
        for name in (name for name in task.gives if givers[name] is task):
            for other in waiting.pop(name, ()):
                missing[other].discard(name)
                if not missing[other] and not tasks[other].done:
                    heappush(ready, other)


def _rank(task: Task) -> tuple[bool, bool]:
    """Return the rank of a task in a circle: the task with the least rank is written first."""
    return not (task.may_be_given and task.prefer), not task.may_be_given


class Coverage:
    """Determine which segments each check covers. Segments and checks are identified by path."""

    def __init__(self, segments: tuple[Segment, ...]) -> None:
        self.segments = segments
        self.whole: set[str] = set()
        """The checks that cover all bytes before them."""
        self._marks: dict[str, frozenset[str]] = {}
        for buffer, begins in buffers(segments):
            for check in checks_in(buffer):
                self._add(check, buffer, begins)

    def of(self, paths: Iterable[str]) -> frozenset[str]:
        """Return the mark of segments; neighbours with equal marks may be packed together."""
        return frozenset(mark for path in paths for mark in self._marks.get(path, ()))

    def paths(self, check: Check) -> list[str] | None:
        """Return the leaves that a check covers, in order of coverage; None for everything before it."""
        return None if check.covers is None else covered_paths(check, self.segments)

    def parts(self, check: Check) -> list[list[str] | Added]:
        """Return the operands of a check's `over`: runs of segments, and added bytes that are not transmitted."""
        return covered_parts(check, self.segments)

    def _add(self, check: Check, buffer: tuple[Segment, ...], begins: bool) -> None:
        paths = self.paths(check)
        before: list[Segment] = []
        for segment in standing(check, buffer):
            if segment is check:
                break
            before.append(segment)
        here = [segment.path for segment in before]
        mixed = not check.wire and any(segment.is_there_inside for segment in on_the_wire(buffer))
        if paths is None or (paths == here and begins and not mixed and not check.added):
            self.whole.add(check.path)
            return
        in_order = paths == [path for path in here if path in paths]
        for part, run in enumerate(one for one in self.parts(check) if isinstance(one, list)):
            for place, path in enumerate(run):
                mark = f"{check.path} {part}" if in_order else f"{check.path} {part} {place}"
                self._marks[path] = self._marks.get(path, frozenset()) | {mark}


def buffers(segments: tuple[Segment, ...], begins: bool = True) -> Iterator[tuple[tuple[Segment, ...], bool]]:
    """Yield every list of segments that is assembled separately, and whether it begins its buffer."""
    yield segments, begins
    for segment in segments:
        for block in segment.blocks:
            yield from buffers(block, segment.is_there_inside)
        if segment.inner_record is not None:  # the content of a record belongs to the buffer around it
            yield from list(buffers(segment.inner_record))[1 if segment.is_record else 0 :]


def checks_in(segments: Iterable[Segment]) -> Iterator[Check]:
    """Yield the checks that belong to a buffer itself."""
    for segment in segments:
        if isinstance(segment, Check):
            yield segment
        elif segment.is_record:
            yield from checks_in(segment.members)


class RuleWriter:
    """Write the rules of the values of a list of segments."""

    def __init__(self, module: Module, title: str) -> None:
        self.module = module
        self.title = title
        module.function("Rule")

    def mapping(self, segments: tuple[Segment, ...]) -> str:
        """Return the source of the mapping name → rule."""
        blocks = (block for segment in flat(segments) if segment.has_cases for block in segment.blocks)
        branches = {id(one) for block in blocks for one in flat(block)}
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
        """Return the source of a rule; arguments with their default are omitted."""
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


def _lengths(segments: tuple[Segment, ...]) -> dict[str, forms.Range]:
    """Return limits of the sizes of values, from the length or count that counts only that value."""
    found: dict[str, forms.Range] = {}
    for segment in flat(segments):
        limits = forms.value_range(segment) if isinstance(segment, (Length, Count)) else forms.Range(None, None)
        least, most = limits.least, limits.most
        if isinstance(segment, Length) and len(segment.of) == 1 and segment.unit == 1 and segment.plus == 0:
            found[segment.of[0]] = forms.Range(least or None, most)
        if isinstance(segment, Count) and segment.plus == 0:
            found[segment.of] = forms.Range(least or None, most)
    return found


# ---- the pack plan of a run of segments --------------------------------------------------------------------


_DIGITS = re.compile(r'b"(%0\d+[Xx])" % (\w+|\([^()]*\))')
_MOST_PLUSES = 4
"""Sums of more pieces than this use `join`."""


@dataclass(slots=True)
class PackArgument:
    """An argument of a struct: code, byte order and source."""

    code: str
    order: str
    text: str
    digits: tuple[FieldType, ...] = ()
    """The types of the numbers whose hex digits the argument contains."""


class PackPlan:
    """The arguments of a struct; `title` names its constant in the module."""

    def __init__(self, module: Module, title: str) -> None:
        self.module, self.title = module, title
        self.arguments: list[PackArgument] = []

    @property
    def order(self) -> str:
        """Return the byte order of the arguments, or an empty text if any order is right."""
        return next((argument.order for argument in self.arguments if argument.order), "")

    def add(self, new: PackArgument) -> None:
        """Add an argument; adjacent zeros, literals and hex digits are merged."""
        last = self.arguments[-1] if self.arguments else None
        if last is not None and last.digits and new.digits:
            orders = {type_.order for type_ in (*last.digits, *new.digits) if type_.fixed_size != 2}
            if len(orders) <= 1 and last.digits[0].upper == new.digits[0].upper:
                last.text, last.digits = f"{last.text}, {new.text}", (*last.digits, *new.digits)
                return
        if last is not None and last.code.endswith("s") and new.code.endswith("s"):
            both = merged([last.text, new.text])
            if len(both) == 1 and both[0].startswith('b"'):
                last.code, last.text = f"{int(last.code[:-1]) + int(new.code[:-1])}s", both[0]
                return
        if last is not None and last.code.endswith("x") and new.code.endswith("x"):
            last.code = f"{int(last.code[:-1] or 1) + int(new.code[:-1] or 1)}x"
            return
        self.arguments.append(new)

    def finished(self) -> tuple[str, list[str]]:
        """Return the joined codes of all arguments, and the sources of those that have a source."""
        self.arguments = [self._with_digits(argument) for argument in self.arguments]
        codes = "".join(argument.code for argument in self.arguments)
        return codes, [argument.text for argument in self.arguments if argument.text]

    def text(self) -> str:
        """Return the source of the bytes of all arguments."""
        codes, texts = self.finished()
        arguments = self.arguments
        if all(argument.code[-1] in "sx" for argument in arguments):
            texts = [argument.text or bytes_literal(bytes(int(argument.code[:-1] or 1))) for argument in arguments]
            return _formatted(merged(texts)) or 'b""'
        if codes == "B":
            return f"{self.module.struct('B', '')}.pack({texts[0]})"  # half the time of `bytes((…,))`
        return f"{self.module.struct(codes, self.order, self.title)}.pack({', '.join(texts)})"

    def _with_digits(self, argument: PackArgument) -> PackArgument:
        """Return the argument with its hex digits built.

        A single number is formatted; several numbers are packed and converted at once.
        """
        types = argument.digits
        if not types:
            return argument
        size = sum(type_.fixed_size or 0 for type_ in types)
        if len(types) == 1:
            if types[0].order == "little" and size > 2:
                text = forms.build(self.module, types[0], argument.text, str(size))
            else:
                form = f"%0{size}{'X' if types[0].upper else 'x'}"
                text = (
                    argument.text if argument.text.isidentifier() or argument.text.isdigit() else f"({argument.text})"
                )
                text = f"{bytes_literal(form.encode())} % {text}"
            return PackArgument(f"{size}s", "", text)
        self.module.imports.add("from binascii import hexlify")
        codes = "".join(forms.INT_CODES[(type_.fixed_size or 2) // 2] for type_ in types)
        order = next(("<" if type_.order == "little" else ">" for type_ in types if type_.fixed_size != 2), "")
        constant = self.module.struct(codes, order, self.title, "digits")
        upper = ".upper()" if types[0].upper else ""
        return PackArgument(f"{size}s", "", f"hexlify({constant}.pack({argument.text})){upper}")


def sum_of(texts: list[str]) -> str:
    """Return the source of the concatenation of these bytes."""
    parts = merged([text for text in texts if text])
    if len(parts) > _MOST_PLUSES:
        return f'b"".join(({", ".join(parts)}))'
    return " + ".join(parts) or 'b""'


def _formatted(parts: list[str]) -> str:
    """Return the source of a concatenation.

    Several numbers in digits are formatted at once, in half the time of a sum.
    """
    numbers = [_DIGITS.fullmatch(part) for part in parts]
    if sum(number is not None for number in numbers) < 2:
        return " + ".join(parts)
    form, operands = "", []
    for part, number in zip(parts, numbers, strict=True):
        if number is not None:
            form += number[1]
            operands.append(number[2].removeprefix("(").removesuffix(")") if number[2][0] == "(" else number[2])
        elif is_literal(part):
            form += part[2:-1].replace("%", "%%")
        else:
            form += "%b"
            operands.append(part)
    return 'b"' + form + '" % (' + ", ".join(operands) + ")"


def merged(texts: list[str]) -> list[str]:
    """Return the sources with adjacent literals joined and empty literals removed."""
    found: list[str] = []
    for text in texts:
        if text == 'b""':
            continue
        if is_literal(text) and found and is_literal(found[-1]):
            found[-1] = found[-1][:-1] + text[2:]
        else:
            found.append(text)
    return found


def is_literal(text: str) -> bool:
    """Return whether a source is a plain bytes literal, without a following `%`."""
    return text.startswith('b"') and text.endswith('"') and text.count('"') == 2

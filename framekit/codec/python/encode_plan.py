"""What an encoder knows before it is written: the order of its values, the bytes its checks need, its rules and packs.

Each value comes after those it depends on; fields may refer to later ones. Where values refer to each other in a
circle, one that may be given is taken from what was given. A check that covers everything before it in its buffer needs
nothing kept; for any other, the segments it covers are put together apart from their neighbours. The rules say what
each value must be; refusals are explained with them. A pack plan says what one struct packs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from framekit.codec.python import forms
from framekit.codec.python.function import covered_parts, covered_paths, on_the_wire, standing
from framekit.codec.python.module import Module
from framekit.codec.python.registry import kind_of
from framekit.codec.python.source import bytes_literal, quoted
from framekit.definition.kinds.check import Added
from framekit.definition.model.frames import flat
from framekit.definition.model.segments import Check, Count, FieldType, Length, Segment

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
    """`of(paths)`: a mark for segments; neighbours with the same mark may be put together.

    `whole`: the checks that cover all that stands before them. Segments and checks are known by their paths.
    """

    def __init__(self, segments: tuple[Segment, ...]) -> None:
        self.segments = segments
        self.whole: set[str] = set()
        self._marks: dict[str, frozenset[str]] = {}
        for buffer, begins in buffers(segments):
            for check in checks_in(buffer):
                self._add(check, buffer, begins)

    def of(self, paths: Iterable[str]) -> frozenset[str]:
        return frozenset(mark for path in paths for mark in self._marks.get(path, ()))

    def paths(self, check: Check) -> list[str] | None:
        """The leaves a check covers, in the order it covers them; None: everything before it."""
        return None if check.covers is None else covered_paths(check, self.segments)

    def parts(self, check: Check) -> list[list[str] | Added]:
        """What its `over` says that a check covers: runs of segments, and what is not on the wire between them."""
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


# ---- the pack plan of a run of segments --------------------------------------------------------------------


_DIGITS = re.compile(r'b"(%0\d+[Xx])" % (\w+|\([^()]*\))')
_MOST_PLUSES = 4
"""More pieces than so many are joined."""


@dataclass(slots=True)
class PackArgument:
    """One argument of a struct: code, byte order, text; `digits`: the numbers whose hex digits it is."""

    code: str
    order: str
    text: str
    digits: tuple[FieldType, ...] = ()


class PackPlan:
    """The arguments of one struct; `title` names its constant in the module."""

    def __init__(self, module: Module, title: str) -> None:
        self.module, self.title = module, title
        self.arguments: list[PackArgument] = []

    @property
    def order(self) -> str:
        """The byte order of those that have one; empty if none has."""
        return next((argument.order for argument in self.arguments if argument.order), "")

    def add(self, new: PackArgument) -> None:
        """Adds an argument; zeros, literals and hex digits are put together with those before."""
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
        """The codes of all arguments as one, and the texts of those that have one."""
        self.arguments = [self._with_digits(argument) for argument in self.arguments]
        codes = "".join(argument.code for argument in self.arguments)
        return codes, [argument.text for argument in self.arguments if argument.text]

    def text(self) -> str:
        """Text of the bytes of all arguments."""
        codes, texts = self.finished()
        arguments = self.arguments
        if all(argument.code[-1] in "sx" for argument in arguments):
            texts = [argument.text or bytes_literal(bytes(int(argument.code[:-1] or 1))) for argument in arguments]
            return _formatted(merged(texts)) or 'b""'
        if codes == "B":
            return f"{self.module.struct('B', '')}.pack({texts[0]})"  # half the time of bytes((…,))
        return f"{self.module.struct(codes, self.order, self.title)}.pack({', '.join(texts)})"

    def _with_digits(self, argument: PackArgument) -> PackArgument:
        """Hex digits of one number are formatted, those of several packed and converted at once."""
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
    """Text of all these bytes one behind the other."""
    parts = merged([text for text in texts if text])
    if len(parts) > _MOST_PLUSES:
        return f'b"".join(({", ".join(parts)}))'
    return " + ".join(parts) or 'b""'


def _formatted(parts: list[str]) -> str:
    """Text of all these bytes; where several are numbers in digits, formatted at once in half the time of a sum."""
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
    """Neighbouring literals put together, empty ones left out."""
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
    """Whether a text is a literal of bytes and nothing else, not one that goes on with `%`."""
    return text.startswith('b"') and text.endswith('"') and text.count('"') == 2

"""Values of a definition as Python source: what the functions of service rows are written of.

Names that are known are variables, all others are looked up when the function runs. File text gets in by `repr` and the
expression emitter only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from types import CodeType
from typing import Any

from framekit.codec import support
from framekit.codec.evaluate import LookedUp
from framekit.codec.python.source import Source
from framekit.definition.expression import Expression, Name, emit
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, ReadAs, RecordOf, Value
from framekit.link.services.rows import ServiceRows
from framekit.link.values import EACH, EVALUATION_ERRORS, FrameValue, Inverse, Names, attribute, plain, read_as

OF_REQUESTS = ("request", "buffer", "station")
"""Parameters of the function of a served row."""


class WriterLevel:
    """What is known of names while a function is written: the variable of each, and what is still to be solved.

    `parts`: the variable with the other things that an address says, where the request names it as text. `history`:
    variables in the order in which names got them. `item`: the variable with the fields of a list's item, `memory` that
    with the data in memory's form, `type` what gives the type that the address says, `shift`
    how many bits after an element it begins, as one more argument.
    `parameters`: names that are parameters of the function.
    """

    def __init__(self, parameters: tuple[str, ...] = OF_REQUESTS) -> None:
        self.parameters = parameters
        self.values: dict[str, str] = {}
        self.history: list[tuple[str, str]] = []
        self.pending: list[tuple[Inverse, str]] = []
        self.padded = False
        self.parts: str | None = None
        self.memory = "None"
        self.type = ""
        self.shift = ""
        self.item = "None"

    def put(self, name: str, variable: str) -> None:
        self.values[name] = variable
        self.history.append((name, variable))

    @property
    def held(self) -> str:
        """Every variable so far, as the items of a tuple."""
        found = [*self.values.values(), *(variable for _, variable in self.pending)]
        found += [self.item] * (self.item != "None")
        return "".join(f"{variable}, " for variable in dict.fromkeys(found))


class Written(LookedUp):
    """How names are written: as variables where they are known, else looked up in the names of the engine.

    `of_item`: the fields of a list's item are names here, before all others.
    """

    def __init__(self, level: WriterLevel, of_item: bool = False) -> None:
        super().__init__("names")
        self.level = level
        self.item = level.item if of_item else "None"

    def name(self, node: Name) -> str:
        known = self._known(node)
        return (
            known
            if self.item == "None"
            else f"({self.item}[{node.name!r}] if {node.name!r} in {self.item} else {known})"
        )

    def _known(self, node: Name) -> str:
        found = self.level.values.get(node.name)
        if found is not None:
            return found
        if node.name in self.level.parameters:
            return node.name
        if self.level.parts is not None:
            return f"said({self.level.parts}, names, {node.name!r})"
        return super().name(node)


class ValueWriter:
    """Writes values. `given` is what the function brings along, `known` the source of the names below its own."""

    def __init__(self, shared: ServiceRows, given: dict[str, Any], known: str) -> None:
        self.shared, self.given, self.known = shared, given, known
        given.update(
            {
                "FrameValue": FrameValue,
                "Names": Names,
                "attribute": attribute,
                "frame_made": shared.table.made,
                "partial": partial,
                "plain": plain,
                "read_as": read_as,
                "said": said,
                "support": support,
            }
        )

    def constant(self, value: Any) -> str:
        """Source of a value that the function brings along."""
        if value is None or type(value) in (int, bool, str, bytes):
            return repr(value)
        name = f"c{len(self.given)}"
        self.given[name] = value
        return name

    def expression(self, expression: Expression, level: WriterLevel) -> str:
        """An expression on the names that are known at this point."""
        return emit(expression.root, Written(level))

    def names(self, level: WriterLevel) -> str:
        """Names with everything that is known, a new level of them where there is something, for what looks them up."""
        return f"Names({self.items(level)}, {self.known})" if level.parts or level.values else self.known

    def items(self, level: WriterLevel) -> str:
        """All names that are known, as a dictionary."""
        parts = f"**{level.parts}, " if level.parts else ""
        return f"{{{parts}{', '.join(f'{name!r}: {value}' for name, value in level.values.items())}}}"

    # ---- values -------------------------------------------------------------------------------------------

    def value(self, value: Value, level: WriterLevel) -> str:
        """Source of a value of the definition."""
        match value:
            case Expression():
                return self.expression(value, level)
            case FrameOf():
                return self._frame(value, level)
            case RecordOf(fields=fields):
                return self._record(fields, level)
            case ListOf(items=items):
                return f"[{', '.join(self.value(item, level) for item in items)}]"
            case LayoutOf(layout=layout, fields=fields):
                encode = self.constant(self.shared.codec.layouts[layout][0])
                return f"{encode}(plain({self._record(fields, level)}), {self.names(level)})"
            case ReadAs(layout=layout, source=source):
                codec = self.constant(self.shared.codec.layouts[layout])
                return f"read_as({codec}, {self.value(source, level)}, {self.names(level)})"
            case EachOf(fields=fields, when=when) if not level.values:
                of_each = f"[Names(one, names) for one in names[{EACH!r}]]"
                holds = "" if when is None else f" if {self.expression(when, level)}"
                return f"[{self._record(fields, level)} for names in {of_each}{holds}]"
        raise TypeError(f"no value of one request: {value!r}")

    def _record(self, fields: Mapping[str, Value], level: WriterLevel) -> str:
        return f"{{{', '.join(f'{name!r}: {self.value(value, level)}' for name, value in fields.items())}}}"

    def _frame(self, frame: FrameOf, level: WriterLevel) -> str:
        info = self.shared.table.infos[frame.frame]
        settled = {name: evaluate(Names()) for name, evaluate, _ in info.computed if _is_settled(evaluate)}
        is_settled = all(name in settled or name in frame.fields for name, *_ in info.computed)
        if not is_settled or frame.fields.keys() & info.numbers.keys():
            return f"frame_made({frame.frame!r}, {self._record(frame.fields, level)}, {self.names(level)})"
        items = {name: self.value(value, level) for name, value in frame.fields.items()}
        items |= {name: self.constant(value) for name, value in {**info.known, **settled}.items() if name not in items}
        made = f"{frame.frame!r}, {{{', '.join(f'{name!r}: {text}' for name, text in items.items())}}}"
        if not info.optional.keys() <= items.keys():
            unset = f"partial({self.constant(info.unset)}, {self.names(level)})"
            made += f", None, None, {self.constant(info.may_lack)}, {unset}"
        return f"FrameValue({made})"

    def repeats(self, value: Value) -> bool:
        """Whether a frame, or one inside it, repeats something of the request that is not given."""
        if not isinstance(value, FrameOf):
            return True
        info = self.shared.table.infos[value.frame]
        there = {*value.fields, *info.known, *(name for name, evaluate, _ in info.computed if _is_settled(evaluate))}
        if any(name not in there for name, _, _ in info.echo):
            return True
        inner = [value.fields[name] for kind, name, _ in info.shape if kind == "inner" and name in value.fields]
        return any(self.repeats(one) for one in inner)


def _is_settled(evaluate: Callable[[Names], Any]) -> bool:
    """Whether an expression has its value whatever the names are."""
    try:
        evaluate(Names())
    except EVALUATION_ERRORS:
        return False
    return True


def said(parts: Mapping[str, Any], names: Names, name: str) -> Any:
    """A name that an address may have said."""
    return parts[name] if name in parts else names[name]


def function_of(header: str, body: Source, given: Mapping[str, Any]) -> Any:
    """The function with that header and these lines, which uses what is `given` by name."""
    source, space = Source(), dict(given)
    with source.block(header):
        source.lines.extend(body.lines)
    exec(code_of_source(source.text()), space)
    return space["function"]


@lru_cache(512)
def code_of_source(source: str) -> CodeType:
    """Compiled once: many devices serve by the same rows."""
    return compile(source, "<service row>", "exec")

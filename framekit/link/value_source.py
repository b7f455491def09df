"""Values of a definition as Python source: one writer for sequences, rows of services, and single values.

Text of a definition reaches the source only by `quoted`, `literal` and the expression emitter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from functools import lru_cache, partial
from types import CodeType
from typing import Any, NamedTuple

from framekit.codec.evaluate import HOMES, LookedUp
from framekit.codec.python.source import Source, literal, quoted
from framekit.definition.expression import Binary, Expression, NameWriter, Number, Text, emit
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, ReadAs, RecordOf, Value
from framekit.link.frame_table import FrameInfo, FrameTable
from framekit.link.values import (
    EACH,
    EVALUATION_ERRORS,
    Evaluate,
    FrameValue,
    Names,
    attribute,
    compile_expression,
    plain,
    read_as,
)


class ValueNames(NamedTuple):
    """The names at a place in the source: their writer, and the source of a mapping of all names for look-ups."""

    writer: NameWriter
    known: str


LOOKED_UP = ValueNames(LookedUp("names"), "names")
"""Names that are looked up in the variable `names` when the function runs."""


class SourceModule:
    """Functions of a module, and the constants that they use: each is written once."""

    def __init__(self) -> None:
        self.functions = Source()
        self.constants: dict[str, str] = {}
        """Constants with names of their own, and their source."""
        self._names: dict[str, str] = {}

    def constant(self, kind: str, source: str) -> str:
        """Return the name of a constant that is worked out when the module is loaded."""
        found = self._names.get(source)
        if found is None:
            found = self._names[source] = f"{kind}_{len(self._names)}"
        return found

    def text(self, about: str) -> str:
        """Return the source of the module."""
        out = Source()
        out.docstring(about)
        for source, name in self._names.items():
            out.add(f"{name} = {source}")
        for name, source in self.constants.items():
            out.add(f"{name} = {source}")
        return out.text() + self.functions.text()


class ValueWriter:
    """Writes values into functions of a module; `names` says how names are written at that place."""

    def __init__(self, table: FrameTable, module: SourceModule) -> None:
        self.infos = table.infos
        self.module = module

    def value(self, value: Value, names: ValueNames) -> str:
        """Return the source of a value."""
        match value:
            case Expression():
                return emit(value.root, names.writer)
            case FrameOf():
                return self.frame(value, names)
            case RecordOf(fields=fields):
                return self.record(fields, names)
            case ListOf(items=items):
                return f"[{', '.join(self.value(item, names) for item in items)}]"
            case LayoutOf(layout=layout, fields=fields):
                encode = self.module.constant("layout", f"LAYOUTS[{quoted(layout)}][0]")
                return f"{encode}(plain({self.record(fields, names)}), {names.known})"
            case ReadAs(layout=layout, source=source):
                return f"read_as({self.layout(layout)}, {self.value(source, names)}, {names.known})"
            case EachOf(fields=fields, when=when):
                variables = f"[Names(one, known) for known in ({names.known},) for one in known[EACH]]"
                holds = "" if when is None else f" if {emit(when.root, LOOKED_UP.writer)}"
                return f"[{self.record(fields, LOOKED_UP)} for names in {variables}{holds}]"
        raise TypeError(f"no value of a definition: {value!r}")

    def record(self, fields: Mapping[str, Value], names: ValueNames) -> str:
        """Return the source of a dictionary."""
        return f"{{{', '.join(f'{quoted(name)}: {self.value(value, names)}' for name, value in fields.items())}}}"

    def layout(self, layout: str) -> str:
        """Return the name of a constant: the functions that encode and decode a layout."""
        return self.module.constant("layout", f"LAYOUTS[{quoted(layout)}]")

    def frame(self, frame: FrameOf, names: ValueNames, sent: bool = False) -> str:
        """Return the source of a frame value as `FrameTable.made` makes it, constants and `is` included.

        `sent`: it is encoded at once, which gives it its `is` and its defaults.
        """
        info = self.infos[frame.frame]
        others = dict(info.known)
        for name, evaluate, _ in () if sent else info.computed:
            if name not in frame.fields:
                try:
                    others[name] = evaluate(Names())
                except EVALUATION_ERRORS:  # it depends on names
                    make = self.module.constant("make", "TABLE.made")
                    return f"{make}({quoted(frame.frame)}, {self.record(frame.fields, names)}, {names.known})"
        items = {name: self._field(info, name, value, names, sent) for name, value in frame.fields.items()}
        items |= {name: _written(value) for name, value in others.items() if name not in items}
        fields = ", ".join(f"{quoted(name)}: {text}" for name, text in items.items())
        if sent or info.optional.keys() <= items.keys():
            return f"FrameValue({quoted(frame.frame)}, {{{fields}}})"
        may_lack, unset = (
            self.module.constant("info", f"INFOS[{quoted(frame.frame)}].{one}") for one in ("may_lack", "unset")
        )
        lacking = f"None, None, {may_lack}, partial({unset}, {names.known})"
        return f"FrameValue({quoted(frame.frame)}, {{{fields}}}, {lacking})"

    def _field(self, info: FrameInfo, name: str, value: Value, names: ValueNames, sent: bool) -> str:
        """Return the source of a field: the number, if a name of it is given."""
        if isinstance(value, FrameOf):
            return self.frame(value, names, sent and self.is_plain(value.frame))
        source, numbers = self.value(value, names), info.numbers.get(name)
        if numbers is None or (isinstance(value, Expression) and isinstance(value.root, (Number, Binary))):
            return source
        if isinstance(value, Expression) and isinstance(value.root, Text):
            return literal(numbers.get(value.root.value, value.root.value))
        known = self.module.constant("numbers", f"INFOS[{quoted(info.name)}].numbers[{quoted(name)}]")
        return f"number_of({known}, {source})"

    def is_plain(self, frame: str) -> bool:
        """Return whether a frame can be encoded from its fields and constants alone."""
        info = self.infos[frame]
        return not {name for name, *_ in info.computed} & {name for name, *_ in info.echo}

    def repeats(self, value: Value) -> bool:
        """Return whether a frame, or a frame inside it, repeats a field of the request that is not given."""
        if not isinstance(value, FrameOf):
            return True
        info = self.infos[value.frame]
        given = {*value.fields, *info.known, *(name for name, evaluate, _ in info.computed if _is_settled(evaluate))}
        if any(name not in given for name, _, _ in info.echo):
            return True
        inner = [value.fields[name] for kind, name, _ in info.shape if kind == "inner" and name in value.fields]
        return any(self.repeats(one) for one in inner)


def _written(value: Any) -> str:
    return f"Decimal({quoted(str(value))})" if isinstance(value, Decimal) else literal(value)


def _is_settled(evaluate: Evaluate) -> bool:
    """Return whether an expression depends on no name."""
    try:
        evaluate(Names())
    except EVALUATION_ERRORS:
        return False
    return True


def number_of(numbers: Mapping[str, int], value: Any) -> Any:
    """Return the number for a name of a field's values; other values as they are."""
    return numbers.get(value, value) if type(value) is str else value


FUNCTIONS: dict[str, Any] = {
    "Decimal": Decimal,
    "EACH": EACH,
    "EVALUATION_ERRORS": EVALUATION_ERRORS,
    "FrameValue": FrameValue,
    "Names": Names,
    "attribute": attribute,
    "number_of": number_of,
    "partial": partial,
    "plain": plain,
    "read_as": read_as,
    **HOMES,
}
"""Names that the source of values uses."""


def globals_of(table: FrameTable) -> dict[str, Any]:
    """Return the global names of a module with values: frames and layouts of a protocol, and FUNCTIONS."""
    return {**FUNCTIONS, "TABLE": table, "INFOS": table.infos, "LAYOUTS": table.codec.layouts}


# ---- single functions ------------------------------------------------------------------------------------------------


class FunctionSource:
    """Writes one function and loads it. `given`: more global names of it."""

    def __init__(self, table: FrameTable, given: Mapping[str, Any] | None = None) -> None:
        self.module = SourceModule()
        self.values = ValueWriter(table, self.module)
        self.body = Source(1)
        self._globals = {**globals_of(table), **(given or {})}

    def object(self, value: Any) -> str:
        """Return the source of any object, which becomes a global name unless it can be written down."""
        if value is None or type(value) in (int, bool, str, bytes):
            return literal(value)
        name = f"c{len(self._globals)}"
        self._globals[name] = value
        return name

    def given(self, name: str) -> Any:
        """Return the object of a name that `object` has returned; None for other source."""
        return self._globals.get(name)

    def load(self, *parameters: str) -> Any:
        """Return the function with these parameters."""
        out = self.module.functions
        with out.block(f"def function({', '.join(parameters)}):"):
            out.lines.extend(self.body.lines)
        exec(code_of_source(self.module.text("A function of values.")), self._globals)
        return self._globals["function"]


@lru_cache(512)
def code_of_source(source: str) -> CodeType:
    """Compile a source once: many devices serve by the same rows."""
    return compile(source, "<values>", "exec")


class ValueCompiler:
    """Compiles values to functions of a `Names`, which raise `EVALUATION_ERRORS`; for refusals of a codec, ValueError.

    All methods raise KeyError for a layout that the codec does not have.
    """

    def __init__(self, table: FrameTable) -> None:
        self.table = table
        self._compiled: dict[int, tuple[Value, Evaluate]] = {}
        """The values of the definition that were compiled, by identity: all sides of a protocol share the functions."""

    def compile(self, value: Value) -> Evaluate:
        """Return a function for a `FrameValue`, bytes, a dict, a list, or the result of an expression."""
        if isinstance(value, Expression):
            return compile_expression(value)
        found = self._compiled.get(id(value))
        if found is None:
            made = self._function(lambda writer: writer.value(value, LOOKED_UP))
            found = self._compiled[id(value)] = value, made
        return found[1]

    def fields(self, fields: Mapping[str, Value]) -> Callable[[Names], dict[str, Any]]:
        """Return a function for the record of these fields."""
        return self._function(lambda writer: writer.record(fields, LOOKED_UP))

    def all(self, values: Sequence[Value | bytes | None]) -> Callable[[Names], Any]:
        """Return a function for a tuple of values; None and bytes stand for themselves."""

        def source(writer: ValueWriter) -> str:
            parts = [
                literal(one) if one is None or isinstance(one, bytes) else writer.value(one, LOOKED_UP)
                for one in values
            ]
            return f"({''.join(f'{part}, ' for part in parts)})"

        return self._function(source)

    def _function(self, source: Callable[[ValueWriter], str]) -> Evaluate:
        writer = FunctionSource(self.table)
        writer.body.add(f"return {source(writer.values)}")
        function: Evaluate = writer.load("names")
        return function

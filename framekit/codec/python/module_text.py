"""Texts of what the functions of a generated module share: imports, constants, helpers."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python.module import Module
from framekit.codec.python.source import Source, quoted

MISFITS = "MISFITS = (ValueError, LookupError, TypeError, ArithmeticError, AttributeError, struct_error)"
"""The line that says what is raised where something does not fit; of `struct`, `error` as `struct_error`."""

_MADE = "RangeTable("
MEASURE_NOTE = """\
`measure_…(data, start, end)` tells how long the frame at data[start] is: its length when it is complete; 0 when no
such frame begins there; a negative number when it wants so many bytes more at least; QUIET when only silence ends it;
LOST when its end cannot be found because the bytes are damaged."""
"""What is said of the functions that measure."""


def constants(module: Module) -> Source:
    """Tables, structs and sets, which stand on nothing."""
    out = Source()
    for name, text in module.tables.values():
        if not text.startswith(_MADE):
            out.add(f"{name}: Mapping[Any, Any] = {text}")
    for text, name in module.structs.items():
        out.add(f"{name} = Struct({quoted(text)})")
    for text, name in module.sets.items():
        out.add(f"{name} = {text}")
    return out


def late_constants(module: Module) -> Source:
    """Constants that are made with helpers."""
    out = Source()
    for name, text in module.tables.values():
        if text.startswith(_MADE):
            out.add(f"{name}: Mapping[Any, Any] = {text}")
    for text, name in module.structs_of_lists.items():
        out.add(f"{name} = {text}")
    for name, (text, about) in module.late.items():
        out.add(f"{name} = {text}", about)
    return out


def helpers(module: Module, methods: set[str]) -> list[Source]:
    """The pasted helpers; `methods`: those that are used of what examines frames."""
    found = []
    for name in module.functions:
        if name == "Defaults":
            continue
        part = Source()
        only = methods if name.startswith("Examination") else None
        part.lines.extend(module.source_of(name, only).rstrip().splitlines())
        found.append(part)
    return found


def sorted_imports(lines: Iterable[str]) -> list[str]:
    """Import lines in order, those from one module as one line, except for names that are changed."""
    plain = sorted(line for line in lines if line.startswith("import "))
    wanted: dict[str, set[str]] = {}
    for line in lines:
        if line.startswith("from "):
            source, names = line.removeprefix("from ").split(" import ")
            wanted.setdefault(source, set()).update(name.strip() for name in names.split(","))
    found = []
    for source, every in sorted(wanted.items()):
        simple = sorted((name for name in every if " as " not in name), key=_import_key)
        found += [f"from {source} import {', '.join(simple)}"] if simple else []
        found += [f"from {source} import {name}" for name in sorted(every) if " as " in name]
    return [*plain, *found]


def _import_key(name: str) -> tuple[bool, str]:
    return name[0].islower(), name

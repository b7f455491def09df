"""The shared parts of one generated module: inlined helpers, structs, tables, check codes, context names.

Each part is registered when a function first asks for it, so a module contains only the parts that it uses. No kind of
segment is known here.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.util import resolve_name
from types import FunctionType
from typing import Any, NamedTuple

from framekit.codec import ciphers, stuffing, support
from framekit.codec.checks import FUNCTIONS, source_of
from framekit.codec.python import runtime, runtime_diagnosis
from framekit.codec.python.choices import in_order
from framekit.codec.python.expressions import ExpressionWriter, FieldScope, NameEntry
from framekit.codec.python.source import OWN_WORDS, Code, Identifiers, Source, UniqueNames, literal, quoted, text_source
from framekit.definition.expression import BIT_AND
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.frames import StaticSizes, everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Const, Segments, Wrap
from framekit.definition.problems import DefinitionError, Problem

_ALWAYS = ("fault", "error", "spans")


@cache
def whole_source(value: Any) -> str:
    """Return the source of a function or class."""
    module = sys.modules.get(value.__module__)
    definition = None if module is None else _definitions(module).get(value.__name__)
    if definition is None or vars(module).get(value.__name__) is not value:
        return inspect.getsource(value)
    return definition.source


class _Definition(NamedTuple):
    """A function or class at the top level of a module, parsed, with its source."""

    node: ast.FunctionDef | ast.ClassDef
    source: str


@cache
def _definitions(module: Any) -> Mapping[str, _Definition]:
    """Return the functions and classes at the top level of a module by name; none without its source.

    The module is parsed once: `inspect.getsource` searches all of it for each class, and tokenizes each function.
    """
    try:
        lines = inspect.getsource(module).splitlines(keepends=True)
    except (OSError, TypeError):
        return {}
    return {
        node.name: _Definition(node, "".join(lines[_first_line(node) - 1 : node.end_lineno]))
        for node in _parsed(module).body
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
    }


@cache
def _parsed(module: Any) -> ast.Module:
    """Return the parsed source of a module."""
    return ast.parse(inspect.getsource(module))


def used_methods(classes: Iterable[type], text: str) -> set[str]:
    """Return the methods that the calls `n.method` in `text` use, directly or indirectly."""
    bodies = {name: source for one in classes for name, source in _methods(one)}
    wanted = set(re.findall(r"\bn\.(\w+)", text)) | set(_ALWAYS)
    wanted |= {name for name in bodies if name.startswith("__")}
    known: set[str] = set()
    while wanted - known:
        name = min(wanted - known)
        known.add(name)
        wanted |= set(re.findall(r"\bself\.(\w+)", bodies.get(name, "")))
    return known & set(bodies)


def class_source(one: type, methods: set[str]) -> str:
    """Return the source of a class with only some of its methods."""
    text = whole_source(one)
    first = next(iter(_functions(text)), None)
    if first is None:
        return text
    head = text.splitlines()[: _first_line(first) - 1]
    while head and (not head[-1].strip() or head[-1].strip().startswith("# ----")):
        head.pop()
    kept = [source for name, source in _methods(one) if name in methods]
    return "\n".join(head) + "\n\n" + "\n\n".join(kept) + "\n" if kept else "\n".join(head) + "\n"


@cache
def _methods(one: type) -> tuple[tuple[str, str], ...]:
    text = whole_source(one)
    lines = text.splitlines()
    return tuple(
        (function.name, "\n".join(lines[_first_line(function) - 1 : function.end_lineno]))
        for function in _functions(text)
    )


@cache
def _functions(text: str) -> tuple[ast.FunctionDef, ...]:
    (found,) = ast.parse(textwrap.dedent(text)).body
    assert isinstance(found, ast.ClassDef)
    return tuple(part for part in found.body if isinstance(part, ast.FunctionDef))


def _first_line(definition: ast.FunctionDef | ast.ClassDef) -> int:
    return min([definition.lineno, *(decorator.lineno for decorator in definition.decorator_list)])


_ORDER_NAMES = {"": "PLAIN", "<": "LITTLE", ">": "BIG"}
BUILT_IN = frozenset(
    {"station", "own", "role", "line", "now", "clock", "request", "buffer", "reply", "expected", "it", "part"}
)
_LONGEST_FORMAT_NAME = 30
_INLINED: list[Any] = [support, stuffing, ciphers, runtime, runtime_diagnosis]
"""The modules whose functions can be inlined; the first `OWN_HELPERS` belong to framekit."""
OWN_HELPERS = len(_INLINED)


def add_helpers(module: Any) -> None:
    """Allow inlining of the functions of a module."""
    added = [one for one in _INLINED[OWN_HELPERS:] if one is module or one.__name__ != module.__name__]
    _INLINED[OWN_HELPERS:] = added if module in added else [*added, module]
    for made in (inlined_names, _names_of_added, _defined, _imports_of, _definitions, _parsed):
        made.cache_clear()


@cache
def inlined_names() -> frozenset[str]:
    """Return every name that inlined code may add to a module."""
    names = {name for module in _INLINED[:OWN_HELPERS] for name in vars(module)} | {*_names_of_added().values()}
    return frozenset(name for name in names if not name.startswith("_"))


@cache
def _names_of_added() -> Mapping[tuple[str, str], str]:
    """Return the names that functions and imports of added modules have in generated modules, by module and name.

    Two functions of one name get different names; an import of several modules appears once.
    """
    names = UniqueNames({*dir(builtins), *OWN_WORDS, *(name for one in _INLINED[:OWN_HELPERS] for name in vars(one))})
    imported = {one: name for module in _INLINED[:OWN_HELPERS] for name, one in _imports_of(module).items()}
    found: dict[tuple[str, str], str] = {}

    for module in _INLINED[OWN_HELPERS:]:
        for name, one in _imports_of(module).items():
            if one not in imported:
                imported[one] = names.take(name) if one.may_be_renamed else name
            found[module.__name__, name] = imported[one]
    for module in _INLINED[OWN_HELPERS:]:
        found |= {(module.__name__, name): names.take(name) for name in sorted(_defined(module))}
    return found


def _home_of(name: str) -> Any:
    """Return the module of framekit that defines a helper.

    Raises ValueError for an unknown name.
    """
    found = next((module for module in _INLINED[:OWN_HELPERS] if name in _defined(module)), None)
    if found is None:
        raise ValueError(f"framekit has no helper '{name}' – give the function itself, not its name")
    return found


@cache
def _defined(module: Any) -> frozenset[str]:
    """Return the names of the functions and classes that a module defines."""
    made = ((name, value) for name, value in vars(module).items() if isinstance(value, FunctionType | type))
    return frozenset(name for name, value in made if value.__module__ == module.__name__)


class Import(NamedTuple):
    """An import: `import what`, or `from origin import what`."""

    origin: str
    what: str

    @property
    def may_be_renamed(self) -> bool:
        """Return whether `as` may rename it: `import a.b` defines `a`, and `import a.b as c` another object."""
        return bool(self.origin) or "." not in self.what

    def line(self, name: str) -> str:
        """Return the line that imports it as `name`."""
        renamed = f" as {name}" if name != self.what and self.may_be_renamed else ""
        return f"{f'from {self.origin} ' if self.origin else ''}import {self.what}{renamed}"


@cache
def _imports_of(module: Any) -> Mapping[str, Import]:
    """Return the imports at the top of a module by name, those of framekit excluded."""
    found: dict[str, Import] = {}
    for node in _parsed(module).body:
        if isinstance(node, ast.Import):
            for one in node.names:
                whole = one.asname is not None and "." in one.name
                origin, _, last = one.name.rpartition(".") if whole else ("", "", one.name)
                found[one.asname or one.name.partition(".")[0]] = Import(origin, last)
        elif isinstance(node, ast.ImportFrom):
            origin = resolve_name(f"{'.' * node.level}{node.module or ''}", module.__package__)
            if origin.partition(".")[0] not in ("framekit", "__future__"):
                found |= {one.asname or one.name: Import(origin, one.name) for one in node.names}
    return found


@cache
def outer_names(helper: Any) -> tuple[str, ...]:
    """Return the global names that the source of a function or class reads."""
    (found,) = ast.parse(textwrap.dedent(whole_source(helper))).body
    parts: list[ast.AST] = [found]
    if isinstance(found, ast.ClassDef):
        parts = [*found.body, *found.bases, *found.keywords, *found.decorator_list]
    used = ({node.id for node in ast.walk(part) if isinstance(node, ast.Name)} - _bound(part) for part in parts)
    return tuple(sorted(set[str]().union(*used)))


def _bound(found: ast.AST) -> set[str]:
    """Return the names that a function binds inside itself."""
    bound: set[str] = set()
    for node in ast.walk(found):
        if node is found:
            continue
        match node:
            case ast.arg():
                bound.add(node.arg)
            case ast.Name() if not isinstance(node.ctx, ast.Load):
                bound.add(node.id)
            case ast.FunctionDef() | ast.ClassDef():
                bound.add(node.name)
            case ast.ExceptHandler() if node.name is not None:
                bound.add(node.name)
            case ast.alias():
                bound.add(node.asname or node.name)
    return bound


def _renamed(text: str, names: Mapping[str, str]) -> str:
    """Return the source of a function or class with global names replaced."""
    (found,) = ast.parse(textwrap.dedent(text)).body
    bound = _bound(found)
    for node in ast.walk(found):
        if isinstance(node, ast.Name) and node.id not in bound:
            node.id = names.get(node.id, node.id)
    assert isinstance(found, ast.FunctionDef | ast.ClassDef)
    found.name = names.get(found.name, found.name)
    return ast.unparse(found)


class Module:
    """The common part of a generated module."""

    def __init__(self, protocol: Protocol, standalone: bool = True) -> None:
        self.protocol = protocol
        self.standalone = standalone
        self.static = StaticSizes(protocol.frames)
        self.names = Identifiers(inlined_names())
        self.functions: dict[str, None] = {}
        self._added: dict[str, Callable[..., Any]] = {}
        self._under_way: set[str] = set()
        self.imports: set[str] = set()
        self.structs: dict[str, str] = {}
        self.structs_of_lists: dict[str, str] = {}
        self.sets: dict[str, str] = {}
        self.tables: dict[str, tuple[str, str]] = {}
        self.late: dict[str, tuple[str, str]] = {}
        self.folds: dict[str, tuple[str, CheckMethod]] = {}
        self.context: set[str] = set()
        self.rule_tables: dict[str, str] = {}
        self.choices: dict[tuple[str, ...], str] = {}
        self.fused_tables: dict[str, str] = {}
        self.extra: list[Source] = []
        self._bcd = ""

    # ---- functions ----------------------------------------------------------------------------------------

    def function(self, helper: str | Callable[..., Any]) -> str:
        """Inline a helper with all its dependencies: a helper of framekit by name, or a function of an added module.

        Returns its name in the generated module. Raises ValueError for an unknown helper.
        """
        name = helper if isinstance(helper, str) else self._name_of(helper)
        if name not in self.functions and name not in self._under_way:
            self._under_way.add(name)
            if isinstance(helper, str):
                module, known = _home_of(name), name
            else:
                module, known = sys.modules[helper.__module__], helper.__name__
                self._added[name] = helper
            imports = _imports_of(module)
            for other in outer_names(getattr(module, known)):
                if other in imports:
                    own = _names_of_added().get((module.__name__, other), other)
                    self.imports.add(imports[other].line(own))
                elif isinstance(helper, str):
                    if any(other in _defined(one) for one in _INLINED[:OWN_HELPERS]):
                        self.function(other)
                elif other in _defined(module):
                    self.function(getattr(module, other))
            self.functions[name] = None
        return name

    def _name_of(self, helper: Callable[..., Any]) -> str:
        """Return the name that a function of an added module has here."""
        name = _names_of_added().get((helper.__module__, helper.__name__))
        if name is None:
            what = f"nothing has brought the function '{helper.__qualname__}' of '{helper.__module__}'"
            raise ValueError(f"{what} – let it stand beside the kind that uses it, outside of functions and classes")
        return name

    def source_of(self, name: str, methods: set[str] | None = None) -> str:
        """Return the source of an inlined helper; of a class with only the given methods."""
        if name in self._added:
            added = self._added[name]
            all_names = _names_of_added().items()
            names = {known: own for (home, known), own in all_names if home == added.__module__ and known != own}
            text = whole_source(added)
            return (
                _renamed(text, names) if any(re.search(rf"\b{re.escape(known)}\b", text) for known in names) else text
            )
        found = getattr(_home_of(name), name)
        return whole_source(found) if methods is None else class_source(found, methods)

    # ---- constants ----------------------------------------------------------------------------------------

    def struct(self, codes: str, order: str, *hint: str) -> str:
        """Return the module constant of a `struct` format."""
        self.imports.add("from struct import Struct")
        text = (order or ">") + codes if order or len(codes) > 1 else codes
        if text not in self.structs:
            name = f"{_ORDER_NAMES[order]}_{codes}"
            wanted = (name,) if len(name) <= _LONGEST_FORMAT_NAME else hint
            self.structs[text] = self.names.constant(*wanted)
        return self.structs[text]

    def list_structs(
        self, before: str, code: str, order: str, *hint: str, packs: bool = False, most: int | None = None
    ) -> str:
        """Return the module constant of structs: the codes `before`, then a number of values, which is the index.

        `packs`: of their `pack` methods. `most`: they are a list up to this number of values, faster than a mapping.
        """
        before, order = (order or ">") + before, order or ">"
        if most is None:
            key = f"{self.function('Packs' if packs else 'Structs')}({literal(before)}, {literal(code)})"
        else:
            self.imports.add("from struct import Struct")
            form = text_source(before, Code("count"), code)
            key = f"[Struct({form}).pack for count in range({most + 1})]"
        if key not in self.structs_of_lists:
            name = f"{'packs_' if packs else ''}{_ORDER_NAMES[order]}_{before[1:]}_{code}s".replace("__", "_")
            self.structs_of_lists[key] = self.names.constant(*((name,) if len(name) <= _LONGEST_FORMAT_NAME else hint))
        return self.structs_of_lists[key]

    def table(self, name: str) -> str | None:
        """Return the module constant of a table of the definition; None if no table has that name."""
        table = self.protocol.tables.get(name)
        if table is None:
            return None
        if name not in self.tables:
            text = literal(dict(table.entries))
            if table.ranges:
                text = f"{self.function('RangeTable')}({text}, {literal(tuple(table.ranges))})"
            self.tables[name] = self.names.constant(name), text
        return self.tables[name][0]

    def value_names(self, values: Mapping[int, str], hint: str) -> str:
        """Return the module constant of a mapping number → name; a table of this content is used."""
        for name, table in self.protocol.tables.items():
            if not table.ranges and dict(table.entries) == dict(values):
                found = self.table(name)
                assert found is not None
                return found
        text = literal(dict(values))
        for known, there in self.tables.values():
            if there == text:
                return known
        self.tables[f"names of {hint} {len(self.tables)}"] = self.names.constant(hint), text
        return next(reversed(self.tables.values()))[0]

    def numbers(self, values: Mapping[int, str], hint: str) -> str:
        """Return the module constant of the reverse of `value_names`: name → number."""
        names = self.value_names(values, hint)
        key = f"numbers of {names}"
        if key not in self.tables:
            text = f"{{name: number for number, name in {names}.items()}}"
            self.tables[key] = self.names.constant(names, "by_name"), text
        return self.tables[key][0]

    def bcd_numbers(self) -> str:
        """Return the module constant with the numbers of single BCD bytes.

        A look-up takes a third of the time of a call.
        """
        if not self._bcd:
            self._bcd = self.names.constant("bcd_numbers")
            digits = "for tens in range(10) for ones in range(10)"
            self.late[self._bcd] = f"{{bytes((tens << 4 | ones,)): 10 * tens + ones {digits}}}", "two decimal digits"
        return self._bcd

    def rules(self, identifier: str, text: str) -> str:
        """Return the module constant with the rules of a frame's values."""
        name = self.names.constant(identifier, "values")
        self.rule_tables[name] = text
        return name

    def choice(self, frames: tuple[str, ...], *name: str) -> str:
        """Return the module constant of the candidates for an inner frame."""
        self.function("Choice")
        frames = in_order(self.static, frames)
        if frames not in self.choices:
            self.choices[frames] = self.names.constant(*name)
        return self.choices[frames]

    def fused(self, identifier: str, frames: tuple[str, ...], readers: Mapping[str, str]) -> str:
        """Return the module constant of the readers of a frame together with an inner frame, by the deciding byte."""
        name, choice = self.names.constant(identifier, "fused"), self.choice(frames, identifier, "inside")
        entries = ", ".join(f"{literal(frame)}: {function}" for frame, function in readers.items())
        self.fused_tables[name] = f"{self.function('fused_readers')}({choice}, {{{entries}}})"
        return name

    def embedded(self, wrap: Wrap) -> str:
        """Return source of the frames inside a wrap that consist of constants; '' if there are none."""
        found = self.embedded_frames(wrap)
        return literal(tuple(found)) if found else ""

    def embedded_frames(self, wrap: Wrap) -> list[bytes]:
        """Return the bytes of these frames; their second byte distinguishes them from other uses of the escape byte."""
        found = []
        for name in wrap.inside:
            segments = self.protocol.frames[name].segments
            data = b"".join(segment.data for segment in segments if isinstance(segment, Const))
            if all(isinstance(segment, Const) for segment in segments) and len(data) > 1 and data[0] == wrap.escape:
                found.append(data)
        return found

    def among(self, names: Iterable[str], *hint: str) -> str:
        """Return the module constant that checks whether all keys of a mapping are among these names."""
        text = f"frozenset({literal(tuple(sorted(names)))}).issuperset"
        if text not in self.sets:
            self.sets[text] = self.names.constant(*hint, "free")
        return self.sets[text]

    # ---- check codes --------------------------------------------------------------------------------------

    def check(self, method: CheckMethod, data: str) -> str:
        """Return the source of the check code over the bytes `data` (source), without outer parentheses."""
        if method.kind == "fold":
            return f"{self._own_code(method)}({data})"
        added = FUNCTIONS.get(method.kind)
        own = "" if added is None else self.function(added)
        source = source_of(method, data, alone=self.standalone, own=own)
        for function in (*source.functions, *source.makers):
            self.function(function)
        self.imports.update(source.imports)
        for name, text in source.constants:
            self.late[name] = text, method.name
        return source.expression

    def mac(self, method: CheckMethod, data: str, key: str, size: int) -> str:
        """Return source of a keyed code: the number of its first `size` bytes. `key`: source of its operands."""
        if method.kind == "code":
            return f"{self.function('first_bytes')}({self._own_code(method)}({data}, {key}), {size})"
        name, _, way = method.kind.partition("-")
        digest = f", {quoted(way)}" if name == "hmac" else ""
        return f"{self.function(f'{name}_code')}({data}, {key}{digest}, {size})"

    def _own_code(self, method: CheckMethod) -> str:
        """Return the name of the function of a check that the definition gives as an expression."""
        if method.name not in self.folds:
            self.folds[method.name] = self.names.fresh(f"{method.name}_code"), method
        return self.folds[method.name][0]

    def fold(self, name: str, method: CheckMethod) -> Source:
        """Return the function of a check that the definition gives as an expression."""
        assert method.expression is not None
        if method.kind == "code":
            return self._whole_code(name, method)
        mask = (1 << method.width) - 1
        out = Source()
        with out.block(f"def {name}(data: bytes) -> int:"):
            out.docstring(
                f"Return the check code `{method.name}`: {method.expression}, starting with {method.initial:#x}."
            )
            out.add(f"code = {method.initial:#x}")
            table = _step_table(self, method, mask)
            if table is not None:
                self.late[f"{name.upper()}_STEPS"] = table, method.name
            with out.block("for byte in data:"):
                if table is not None:
                    out.add(f"code = {name.upper()}_STEPS[code ^ byte]")
                else:
                    out.add(f"code = {_step(self, method, 'code', 'byte')} & {mask:#x}")
            out.add(f"return {_finished(method, mask)}")
        return out

    def _whole_code(self, name: str, method: CheckMethod) -> Source:
        """Return the function of a check whose bytes an expression computes."""
        assert method.expression is not None
        out = Source()
        scope = FieldScope()
        scope.entries = {"data": NameEntry("data")}
        with out.block(f"def {name}(data: bytes, ctx: Context) -> Any:"):
            out.docstring(f"Return the check code `{method.name}`: {method.expression}.")
            out.add("data = bytes(data)")
            out.add(f"return {ExpressionWriter(self, scope, self.given).text(method.expression)}")
        return out

    def given(self, name: str) -> str:
        """Return the source of a context value."""
        self.context.add(name)
        return f"ctx[{quoted(name)}]"

    def known(self, name: str, segments: Segments) -> str:
        """Return the name of a context value. Raise DefinitionError for a segment's name, which has no value here."""
        protocol = self.protocol
        segment = next((one for one in everything(segments) if name in (one.name, *one.value_names)), None)
        if segment is not None and name not in protocol.params and name not in protocol.state and name not in BUILT_IN:
            what = f"'{name}' has no value where an expression reads it"
            raise DefinitionError([Problem(segment.at, what, "read a field that stands before, or a part of it")])
        return name

    def words(self) -> Iterable[str]:
        """Return the names that locals must not have."""
        return [*inlined_names(), *(name for name, _ in self.folds.values())]


def _finished(method: CheckMethod, mask: int) -> str:
    text = {"ones": f"~code & {mask:#x}", "twos": f"-code & {mask:#x}", None: "code"}[method.complement]
    return text if method.mask is None else f"({text}) & {method.mask:#x}"


def _step_table(module: Module, method: CheckMethod, mask: int) -> str | None:
    """Return the table of an 8-bit code whose next value depends only on `acc ^ byte`; None for other codes."""
    if method.width != 8 or method.expression is None:
        return None
    names: dict[str, Any] = {name: getattr(support, name) for name in ("rotl8", "bit", "span", "times")}
    text = _step(module, method, "code", "byte")
    try:
        step = eval(f"lambda code, byte: {text} & {mask:#x}", names)
        mixed = [step(0, byte) for byte in range(256)]
        if not all(step(code, byte) == mixed[code ^ byte] for code in range(256) for byte in range(256)):
            return None
    except (NameError, TypeError, ValueError, ArithmeticError):
        return None
    return f"tuple({_step(module, method, '0', 'mixed')} & {mask:#x} for mixed in range(256))"


def _step(module: Module, method: CheckMethod, acc: str, byte: str) -> str:
    assert method.expression is not None
    scope = FieldScope()
    scope.entries = {"acc": NameEntry(acc), "byte": NameEntry(byte)}
    return ExpressionWriter(module, scope, module.given).text(method.expression, BIT_AND)

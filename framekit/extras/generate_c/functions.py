"""Hold the common state of generated C functions: lines, locals, labels, spans of segments, and encoded numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from framekit.codec.python.encode_plan import Task
from framekit.codec.python.facts import is_followed, lengths_asked, names_asked_for
from framekit.codec.python.function import covered_paths, paths_of, wire_paths
from framekit.definition.expression import Expression, Text
from framekit.definition.model.frames import StaticSizes, everything
from framekit.definition.model.segments import Check, Const, Field, FieldType, Inner, Length, Segment, Segments, Wrap
from framekit.definition.problems import CannotSayError, Problem
from framekit.extras.generate_c.checks import CheckFunctions
from framekit.extras.generate_c.expressions import CExpressionWriter, CFacts, CScope, Val, constant
from framekit.extras.generate_c.layout import Layouts
from framekit.extras.generate_c.source import CSource, identifier, string


@dataclass(frozen=True, slots=True)
class CKind:
    """The C of a kind of segment (`kinds`): `read`, `put` and `measure` write statements of its functions."""

    model: type[Segment]
    read: Callable[..., None]
    values: Callable[..., list[Task]] | None = None
    """Returns the tasks that assign its values to locals before bytes are assembled; None if it has no values."""
    put: Callable[..., None] | None = None
    """Writes its bytes; None if it takes no bytes."""
    measure: Callable[..., None] | None = None
    """Measures it; None for a segment of constant size, which is skipped."""


class FileFacts(CFacts, Protocol):
    """The file around a function, as far as the function's writer needs it."""

    kinds: Mapping[type[Segment], CKind]
    prefix: str
    static: StaticSizes
    layouts: Layouts
    checks: CheckFunctions
    context: str
    """The declaration of the context as a further parameter; '' if no function needs it."""
    hand_on: str
    """The context as a further argument."""

    def to_give(self, frame: str, name: str, problem: Problem) -> None: ...
    def frame_enum(self, frame: str) -> str: ...

    never_resyncs: bool

    def first_inside(self, segment: Inner) -> str: ...
    def nearest_inside(self, segment: Inner) -> str: ...
    def inner_reader(self, segment: Inner) -> str: ...
    def function(self, name: str, code: CSource) -> None: ...
    def order_of(self, frames: tuple[str, ...]) -> tuple[str, ...]: ...


def order_of_bytes(type_: FieldType, size: int) -> list[int]:
    """Return the offsets of the bytes of a number, most significant first."""
    places = list(range(size))
    if type_.order == "little":
        return places[::-1]
    if type_.order == "BADC":
        return [place ^ 1 for place in places]
    if type_.order == "CDAB":
        back = places[::-1]
        return [back[place ^ 1] for place in places]
    return places


def stands(span: str, data: str, first: str, last: str) -> tuple[str, ...]:
    """Return the statements that store the span of a segment."""
    return f"{span}.data = {data};", f"{span}.first = {first};", f"{span}.last = {last};", f"{span}.there = true;"


class CFunctionWriter:
    """Write a function: its lines and its locals."""

    def __init__(self, file: FileFacts, segments: Segments) -> None:
        self.file = file
        self.static = file.static
        self.segments = segments
        self.out = CSource(1)
        self.locals: list[str] = []
        self.used: set[str] = set()
        self.by_name = {segment.name: segment for segment in everything(segments) if segment.name}
        self.by_path = {segment.path: segment for segment in everything(segments) if segment.name}
        self.all_paths = {path for segment in everything(segments) for path in paths_of(segment)}
        """The paths of the segments and of their values."""
        self.by_value_name: dict[str, list[Segment]] = {}
        for segment in everything(segments):
            for name in segment.value_names:
                self.by_value_name.setdefault(name, []).append(segment)
        self.asked_by_name = names_asked_for(segments)
        self.tracked = self._tracked()
        self.spans: dict[str, str] = {}

    def _tracked(self) -> set[str]:
        """Return the paths of the segments whose spans are needed."""
        found: set[str] = set()
        for segment in everything(self.segments):
            if isinstance(segment, Check):
                found.update(covered_paths(segment, self.segments))
            elif isinstance(segment, Length) and not is_followed(segment, self.segments):
                found.update(segment.counted)
                found.update(wire_paths(self.segments, segment.counted))
        asked = lengths_asked(self.segments)
        return found | {path for path in self.all_paths if path.rpartition(".")[2] in asked}

    def assembled(
        self,
        header: str,
        first: str,
        lines: list[str],
        more: Iterable[str] = (),
        given: tuple[str, str] = ("v", "v->"),
        begin: Iterable[str] = (),
        end: Iterable[str] = (),
    ) -> CSource:
        """Return the whole function.

        `first`: its first declaration; `more`: further locals; `given`: a parameter that may be unused, and its form in
        the lines; `begin`, `end`: lines before and after its own lines.
        """
        lines, locals_ = pruned(lines, ["bool bad = false;", *more, *self.locals])
        body = "\n".join(lines)
        code = CSource()
        with code.block(header):
            code.add(first, *locals_)
            if self.file.context and "context->" not in body and "context," not in body:
                code.add("(void)context;")
            if given[1] not in body:
                code.add(f"(void){given[0]};")
            code.add(*begin)
            code.lines.extend(lines)
            code.add(*end)
        return code

    # ---- names --------------------------------------------------------------------------------------------

    def fresh(self, name: str) -> str:
        """Return a name that no other local has."""
        base = identifier(name)
        found, count = base, 1
        while found in self.used:
            count += 1
            found = f"{base}{count}"
        self.used.add(found)
        return found

    def local(self, type_: str, name: str, start: str = "0") -> str:
        """Return a new local of the whole function, with its initial value."""
        found = self.fresh(name)
        self.locals.append(f"{type_} {found} = {start};")
        return found

    def span(self, path: str) -> str | None:
        """Return the local of the span of a segment, or None if the span is not needed."""
        if path not in self.tracked:
            return None
        if path not in self.spans:
            self.file.helper("spans")
            name = path.rpartition(".")[2].strip("_")
            self.spans[path] = self.local("struct fk_span", f"{name}_span", "{ NULL, 0, 0, false }")
        return self.spans[path]

    def kind_of(self, segment: Segment) -> CKind:
        """Return the C of a segment's kind. Raises CannotSayError for an unsupported kind."""
        found = self.file.kinds.get(type(segment))
        if found is None:
            raise CannotSayError(segment.at, f"a segment of the kind '{segment.KEY or type(segment).__name__.lower()}'")
        return found

    def kept(self, value: Val, name: str) -> str:
        """Return a local with a number, or the text of a constant number."""
        if value.constant is not None:
            return value.text
        local = self.local("int64_t", name)
        self.keep(local, value.text)
        return local

    def keep(self, local: str, text: str) -> None:
        """Write the assignment of a computed value to a local.

        If it fails, the function returns or records a failure.
        """
        raise NotImplementedError

    def worked_out(self, local: str, text: str, if_bad: Callable[[], tuple[str, ...]]) -> None:
        """Write the assignment of a computed value to a local; `if_bad` returns the statements for a failure."""
        if "&bad" not in text:
            self.add(f"{local} = {text};")
            return
        self.add("bad = false;", f"{local} = {text};")
        self.when("bad", *if_bad())

    embedded = "NULL, 0"
    """The table of the frames embedded in the current wrap, and their number, as arguments."""

    def embedded_in(self, wrap: Wrap) -> str:
        """Return the table of the frames that may be embedded anywhere in a wrap, and their number, as arguments."""
        rows = []
        for name in wrap.inside:
            segments = self.file.layouts.frames[name].segments
            data = b"".join(one.data for one in segments if isinstance(one, Const))
            if all(isinstance(one, Const) for one in segments) and len(data) > 1 and data[0] == wrap.escape:
                rows.append(f"{{ {string(data)}, {len(data)} }}")
        if not rows:
            return "NULL, 0"
        table = self.fresh("embedded")
        self.locals.append(f"static const struct fk_stop {table}[] = {{ {', '.join(rows)} }};")
        return f"{table}, {len(rows)}"

    def stops(self, type_: FieldType) -> str:
        """Return the table of the delimiters before which a value ends, and their number, as arguments."""
        table = self.fresh("stops")
        rows = ", ".join(f"{{ {string(one)}, {len(one)} }}" for one in type_.stops)
        self.locals.append(f"static const struct fk_stop {table}[] = {{ {rows} }};")
        return f"{table}, {len(type_.stops)}"

    @contextmanager
    def block(self, header: str, behind: str = "") -> Iterator[None]:
        with self.out.block(header, behind):
            yield

    @contextmanager
    def where(self, condition: str) -> Iterator[None]:
        """Write lines that run if a condition holds; '' for an unconditional block."""
        if condition:
            with self.block(f"if ({condition})"):
                yield
        else:
            yield

    def value_local(self, name: str, *, is_text: bool) -> str:
        """Return a new local for a number, or for a text or bytes."""
        return self.local("struct framekit_bytes", name, "{ NULL, 0 }") if is_text else self.local("int64_t", name)

    def add(self, *lines: str) -> None:
        self.out.add(*lines)

    def when(self, test: str, *lines: str) -> None:
        self.out.when(test, *lines)

    def writer(self, scope: CScope) -> CExpressionWriter:
        return CExpressionWriter(self.file, scope)

    def number(self, expression: Expression, scope: CScope) -> Val:
        return self.writer(scope).number(expression)

    def default_value(self, segment: Field, default: Expression, scope: CScope) -> Val:
        """Return a default, with a name from `values` replaced by its number."""
        if segment.values is not None and isinstance(default.root, Text):
            for number, name in segment.values.items():
                if name == default.root.value:
                    return constant(number)
        return self.writer(scope).value(default)

    # ---- numbers on the wire ------------------------------------------------------------------------------

    def read_number(self, type_: FieldType, raw: str, size: str, at: Segment) -> tuple[str, str]:
        """Return the text of an encoded number, and the call that detects invalid bytes; '' if all bytes are valid."""
        helper = self.file.helper
        match type_.kind:
            case "int" if type_.fixed_size is not None:
                if type_.fixed_size > 8:
                    raise CannotSayError(at.at, "a number of more than 64 bits")
                parts = []
                places = order_of_bytes(type_, type_.fixed_size)
                for shift, place in zip(range(8 * (len(places) - 1), -1, -8), places, strict=True):
                    byte = f"(uint64_t){raw}[{place}]"
                    parts.append(f"{byte} << {shift}" if shift else byte)
                text = f"({' | '.join(parts)})" if len(parts) > 1 else parts[0]
                if type_.signed:
                    return f"{helper('with_sign')}({text}, {8 * len(places)})", ""
                return text, ""
            case "int":
                if type_.order not in ("big", "little"):
                    raise CannotSayError(at.at, f"a number of computed size in the order {type_.order}")
                little = "true" if type_.order == "little" else "false"
                signed = "true" if type_.signed else "false"
                got = self.number_local()
                call = f"{helper('any_int')}({raw}, {size}, {little}, {signed}, &{got})"
                return got, call
            case "digits":
                little = "true" if type_.order == "little" else "false"
                got = self.number_local()
                return got, f"{helper('digits')}({raw}, {size}, {type_.base}, {little}, &{got})"
            case "bcd":
                little = "true" if type_.order == "little" else "false"
                got = self.number_local()
                return got, f"{helper('bcd')}({raw}, {size}, {little}, &{got})"
            case "hex_int":
                if type_.order not in ("big", "little"):
                    raise CannotSayError(at.at, f"digits of a number in the order {type_.order}")
                little = "true" if type_.order == "little" else "false"
                got = self.number_local()
                call = f"{helper('digits')}({raw}, {size}, 16, {little}, &{got})"
                return f"{helper('with_sign')}({got}, {4 * (type_.fixed_size or 2)})", call
            case "decimal" | "fraction":
                got = self.number_local()
                call = f"{helper('decimal_number')}({raw}, {self.decimal_form(type_, size)}, &{got})"
                return got, call
        raise CannotSayError(at.at, f"a number as '{type_.kind}'")

    def number_local(self) -> str:
        if "got" not in self.used:
            self.local("uint64_t", "got")
        return "got"

    def decimal_form(self, type_: FieldType, size: str) -> str:
        """Return the arguments that describe a number in text: its size, whether the size is fixed, and its form."""
        form = type_.form
        assert form is not None
        self.file.helper("decimal_form")
        name = self.fresh("form")
        sign = {"minus": 0, "never": 0, "always": ord("+"), "space": ord(" ")}[form.sign]
        flags = ", ".join("true" if one else "false" for one in (form.sign == "never", form.point))
        decimals = -1 if form.decimals is None else form.decimals
        row = f"{decimals}, {form.digits}, {form.exponent}, {form.fill[0]}, {sign}, {flags}"
        self.locals.append(f"static const struct fk_decimal_form {name} = {{ {row} }};")
        return f"{size}, {'true' if type_.size is not None else 'false'}, &{name}"

    def write_number(self, type_: FieldType, value: str, target: str, size: str, at: Segment) -> str:
        """Return the statement that encodes an int64_t."""
        helper = self.file.helper
        little = "true" if type_.order == "little" else "false"
        match type_.kind:
            case "int" if type_.order in ("big", "little"):
                return f"{helper('put_int')}({target}, (uint64_t){value}, {size}, {little});"
            case "int":
                places = ", ".join(map(str, order_of_bytes(type_, type_.fixed_size or 2)))
                return f"{helper('put_places')}({target}, (uint64_t){value}, {size}, (const uint8_t[]){{{places}}});"
            case "digits" | "hex_int":
                upper = "true" if type_.upper else "false"
                return f"{helper('put_digits')}({target}, (uint64_t){value}, {size}, {type_.base}, {little}, {upper});"
            case "bcd":
                return f"{helper('put_bcd')}({target}, (uint64_t){value}, {size}, {little});"
        raise CannotSayError(at.at, f"a number as '{type_.kind}'")


_ASSIGNED = re.compile(r"\s*(\w+)(\.\w+)*( = \1\.\w+)* = [^=].*;")


def pruned(lines: list[str], locals_: list[str]) -> tuple[list[str], list[str]]:
    """Return the lines and the declarations without the locals that are never read."""
    named = {found[1]: one for one in locals_ if (found := re.search(r"(\w+)(?:\[\w*\])?(?: =.*)?;", one)) is not None}
    lines = [line for line in lines if not (line.strip().startswith("(void)") and line.strip()[6:-1] in named)]
    while True:
        read: set[str] = set()
        for line in lines:
            words = re.findall(r"[A-Za-z_]\w*", line)
            assigned = _ASSIGNED.fullmatch(line)
            if assigned is not None and assigned[1] in named:
                words = re.findall(r"[A-Za-z_]\w*", line[line.rindex(" = ") :])
            read.update(words)
        unread = named.keys() - read
        if not unread:
            break
        left = [line for line in lines if (found := _ASSIGNED.fullmatch(line)) is None or found[1] not in unread]
        if len(left) == len(lines) and not unread & named.keys():
            break
        lines = left
        named = {name: one for name, one in named.items() if name not in unread}
    return lines, [one for one in locals_ if one in set(named.values())]

"""What the writers of all functions of C share: lines, locals, labels, where segments stand, numbers on the wire."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from framekit.codec.c.checks import CheckFunctions
from framekit.codec.c.expressions import CExpressionWriter, CFacts, CScope, Val, constant
from framekit.codec.c.layout import Layouts
from framekit.codec.c.source import CSource, identifier, string
from framekit.codec.python.encode_plan import Task
from framekit.codec.python.facts import is_followed, lengths_asked, names_asked_for
from framekit.codec.python.function import covered_paths, paths_of, wire_paths
from framekit.definition.expression import Expression, Text
from framekit.definition.model.frames import StaticSizes, everything
from framekit.definition.model.segments import Check, Const, Field, FieldType, Inner, Length, Segment, Segments, Wrap
from framekit.definition.problems import CannotSayError, Problem


@dataclass(frozen=True, slots=True)
class CKind:
    """What the C of a kind of segment is (`kinds`): `read`, `put` and `measure` write statements of its functions.

    `values`: gives what brings its values into locals before bytes are put together; None: it has none. `put`: None
    where it takes no bytes. `measure`: None where its bytes are passed, as many as there always are.
    """

    model: type[Segment]
    read: Callable[..., None]
    values: Callable[..., list[Task]] | None = None
    put: Callable[..., None] | None = None
    measure: Callable[..., None] | None = None


class FileFacts(CFacts, Protocol):
    """What the writer of a function asks of the file that is being written."""

    kinds: Mapping[type[Segment], CKind]
    prefix: str
    static: StaticSizes
    layouts: Layouts
    checks: CheckFunctions
    context: str
    """How functions declare the context as a parameter behind others; '' if nothing needs one."""
    hand_on: str
    """How it is handed on."""

    def to_give(self, frame: str, name: str, problem: Problem) -> None: ...
    def frame_enum(self, frame: str) -> str: ...

    never_resyncs: bool

    def first_inside(self, segment: Inner) -> str: ...
    def nearest_inside(self, segment: Inner) -> str: ...
    def inner_reader(self, segment: Inner) -> str: ...
    def function(self, name: str, code: CSource) -> None: ...
    def order_of(self, frames: tuple[str, ...]) -> tuple[str, ...]: ...


def order_of_bytes(type_: FieldType, size: int) -> list[int]:
    """Where the bytes of a number stand, the most significant first."""
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
    """The statements that keep where a segment stands."""
    return f"{span}.data = {data};", f"{span}.first = {first};", f"{span}.last = {last};", f"{span}.there = true;"


class CFunctionWriter:
    """One function: its lines, and what its locals are called."""

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
        """The paths of the segments and of all values in them."""
        self.by_value_name: dict[str, list[Segment]] = {}
        for segment in everything(segments):
            for name in segment.value_names:
                self.by_value_name.setdefault(name, []).append(segment)
        self.asked_by_name = names_asked_for(segments)
        self.tracked = self._tracked()
        self.spans: dict[str, str] = {}

    def _tracked(self) -> set[str]:
        """The paths of segments whose places are asked for."""
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
        """The whole function. `first`: its first declaration; `more`: locals beside its own; `given`: a parameter that
        may be unused, and how lines use it; `begin`, `end`: what stands before its lines and behind them.
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
        """A name that no other local has."""
        base = identifier(name)
        found, count = base, 1
        while found in self.used:
            count += 1
            found = f"{base}{count}"
        self.used.add(found)
        return found

    def local(self, type_: str, name: str, start: str = "0") -> str:
        """A local of the whole function, with what it is at first."""
        found = self.fresh(name)
        self.locals.append(f"{type_} {found} = {start};")
        return found

    def span(self, path: str) -> str | None:
        """The local with the place of a segment, if something asks for that."""
        if path not in self.tracked:
            return None
        if path not in self.spans:
            self.file.helper("spans")
            name = path.rpartition(".")[2].strip("_")
            self.spans[path] = self.local("struct fk_span", f"{name}_span", "{ NULL, 0, 0, false }")
        return self.spans[path]

    def kind_of(self, segment: Segment) -> CKind:
        """What the C of a segment is. Raises CannotSayError for a kind that C does not have."""
        found = self.file.kinds.get(type(segment))
        if found is None:
            raise CannotSayError(segment.at, f"a segment of the kind '{segment.KEY or type(segment).__name__.lower()}'")
        return found

    def kept(self, value: Val, name: str) -> str:
        """The local with a number, or its text if it is always the same."""
        if value.constant is not None:
            return value.text
        local = self.local("int64_t", name)
        self.keep(local, value.text)
        return local

    def keep(self, local: str, text: str) -> None:
        """Puts what is worked out into a local, and leaves the function, or tells, where it cannot be."""
        raise NotImplementedError

    def worked_out(self, local: str, text: str, if_bad: Callable[[], tuple[str, ...]]) -> None:
        """Puts what is worked out into a local. `if_bad`: gives what is done where it cannot be."""
        if "&bad" not in text:
            self.add(f"{local} = {text};")
            return
        self.add("bad = false;", f"{local} = {text};")
        self.when("bad", *if_bad())

    embedded = "NULL, 0"
    """What may stand in the content of the wrap that is written: the table of it and how many there are."""

    def embedded_in(self, wrap: Wrap) -> str:
        """The table of the frames that may stand anywhere in a wrap, and how many there are."""
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
        """The table of the bytes before which a value ends, and how many there are."""
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
        """What is done where a condition holds; '' for one that always does."""
        if condition:
            with self.block(f"if ({condition})"):
                yield
        else:
            yield

    def value_local(self, name: str, *, is_text: bool) -> str:
        """A local for a number, or for a text or bytes."""
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
        """A default; one that is a name of `values` is its number."""
        if segment.values is not None and isinstance(default.root, Text):
            for number, name in segment.values.items():
                if name == default.root.value:
                    return constant(number)
        return self.writer(scope).value(default)

    # ---- numbers on the wire ------------------------------------------------------------------------------

    def read_number(self, type_: FieldType, raw: str, size: str, at: Segment) -> tuple[str, str]:
        """The text of the number behind bytes; that of the condition under which they show none, if they may not."""
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
        """The arguments that say how a number is written as text: how many characters, whether always so many, how."""
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
        """The statement that writes an int64_t as it stands on the wire."""
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
    """The lines and the declarations of locals without those that nothing reads."""
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

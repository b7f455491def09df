"""Generate the C header and source of a protocol, with the list of parts that are left out."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from framekit.codec.evaluate import start_values
from framekit.codec.python.choices import Leaf, Switch, in_order, tree_of
from framekit.definition.expression import Name, Node
from framekit.definition.kinds.base import constant_number
from framekit.definition.model.frames import Frame, StaticSizes, everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import Parameter, StateVariable
from framekit.definition.model.segments import Bits, Field, Inner, Segments
from framekit.definition.model.values import Table
from framekit.definition.problems import CannotSayError, Problem
from framekit.extras.generate_c.checks import CheckFunctions
from framekit.extras.generate_c.expressions import LEAST, MOST, Val, constant
from framekit.extras.generate_c.kinds import KINDS
from framekit.extras.generate_c.layout import CMember, CStruct, Layouts, declare, inner_name
from framekit.extras.generate_c.measure import CMeasureWriter
from framekit.extras.generate_c.parser import ParserWriter, line_frames
from framekit.extras.generate_c.reader import ReadWriter
from framekit.extras.generate_c.source import CNames, CSource, comment, identifier, number, string
from framekit.extras.generate_c.writer import WriteWriter

MOST_BYTES = 1024
"""Size in bytes of a frame whose definition sets no limit."""
INT32 = -(1 << 31), (1 << 31) - 1
"""The range of numbers whose definition sets no limit."""
REASONS = (
    "check", "constant", "where", "digits", "value", "range", "require", "short", "too_long", "length", "surplus",
    "cut",
)  # fmt: skip
"""Faults of frames, by framekit's names."""


@dataclass(frozen=True, slots=True)
class Generated:
    """The two generated files."""

    name: str
    header: str
    source: str
    frames: tuple[str, ...]
    """The frames in the files."""
    left_out: tuple[tuple[str, Problem], ...]
    """The frames that are left out, each with the reason."""
    to_give: tuple[tuple[str, str, Problem], ...]
    """The values that callers must give although the definition computes them: frame, name, reason."""
    not_measured: tuple[tuple[str, Problem], ...]
    """The frames that cannot be found in streams, each with the reason."""
    not_built: tuple[tuple[str, Problem], ...]
    """The frames that cannot be built, each with the reason."""
    structs: dict[str, CStruct]
    prefix: str
    in_streams: tuple[str, ...]
    """The frames that the parser of streams searches for."""


@cache
def support_parts() -> dict[str, tuple[tuple[str, ...], str]]:
    """Return the functions of `support.c`: name → names of the functions it needs, and its text."""
    text = Path(__file__).with_name("support.c").read_text(encoding="ascii")
    found = {}
    for part in re.split(r"^/\*: ", text, flags=re.MULTILINE)[1:]:
        head, _, body = part.partition(" */\n")
        name, _, needs = head.partition(" needs ")
        found[name] = tuple(needs.split()), body.strip() + "\n"
    return found


class CFile:
    """Both files while they are written.

    It provides names, tables, helpers and check codes to expressions and functions.
    """

    def __init__(self, protocol: Protocol, most: int = MOST_BYTES) -> None:
        self.protocol = protocol
        self.kinds = KINDS
        self.prefix = prefix_of(protocol.name)
        self.static = StaticSizes(protocol.frames)
        self.helpers: list[str] = []
        self.functions: dict[str, CSource] = {}
        self.checks = CheckFunctions(self)
        self.layouts = Layouts(protocol.frames, self.static, self, most)
        self.structs: dict[str, CStruct] = {}
        self.names = CNames(f"the C of '{protocol.name}'")
        for own in ("parser", "context", "defaults"):
            self.names.take(f"{self.prefix}_{own}", "what stands in every such file")
        self.names.take(f"{self.prefix.upper()}_FRAME_UNKNOWN", "what stands in every such file")
        self.start_values = start_values(protocol)
        self.asked: dict[str, Val] = {}
        self.context = ""
        self.hand_on = ""
        self.inner_structs: dict[tuple[str, ...], str] = {}
        self.never_resyncs = protocol.receiver.resync == "never"
        self.not_measured: dict[str, Problem] = {}
        self.not_built: dict[str, Problem] = {}
        self.firsts: dict[tuple[str, ...], str] = {}
        self.nearest: dict[tuple[str, ...], str] = {}
        self.given_only: dict[tuple[str, str], Problem] = {}

    # ---- what the writers ask -----------------------------------------------------------------------------

    def helper(self, name: str) -> str:
        """Return the name of a helper function, which is included in the source."""
        if name not in self.helpers:
            for needed in support_parts()[name][0]:
                self.helper(needed)
            self.helpers.append(name)
        return f"fk_{name}"

    def function(self, name: str, code: CSource) -> None:
        self.functions.setdefault(name, code)

    def to_give(self, frame: str, name: str, problem: Problem) -> None:
        """Record a value that callers must give, because C cannot compute it."""
        self.given_only[frame, name] = problem

    def frame_enum(self, frame: str) -> str:
        return f"{self.prefix}_{identifier(frame)}"

    def number_name(self, frame: str) -> str:
        """Return the enumeration constant of a frame."""
        return f"{self.prefix.upper()}_FRAME_{identifier(frame)}"

    def order_of(self, frames: tuple[str, ...]) -> tuple[str, ...]:
        return in_order(self.static, frames)

    def given(self, node: Name) -> Val:
        """Return a parameter, a state variable or a table.

        Raises CannotSayError for names that only a running engine knows.
        """
        name = node.name
        if name in self.asked:
            return self.asked[name]
        if name in self.protocol.tables:
            return Val("other", name)
        parameter, state = self.protocol.params.get(name), self.protocol.state.get(name)
        if parameter is not None:
            value = self._parameter(parameter)
        else:
            value = None if state is None or state.keys is not None else self._variable(state)
        if value is None:
            what = "parameter" if parameter else "state variable" if state else "name"
            raise CannotSayError(node.at, f"the {what} '{name}', which C is not given")
        if value.constant is not None:
            return value
        if name not in self.start_values and not value.there:
            value = replace(value, there=f"context->has_{identifier(name)}")
        self.asked[name] = value
        return value

    def _parameter(self, parameter: Parameter) -> Val | None:
        """Return a parameter; None for those without a form in C."""
        text = f"context->{identifier(parameter.name)}"
        if parameter.is_ is not None and (fixed := constant_number(parameter.is_)) is not None:
            return constant(fixed)
        if parameter.type in ("number", "flag") and parameter.is_ is None:
            low, high = (0, 1) if parameter.type == "flag" else parameter.limits or INT32
            return Val("number", f"(int64_t){text}", low, high)
        if parameter.type in ("bytes", "choice", "text") and not parameter.secret:
            longest = max(map(len, parameter.choices), default=0) if parameter.type == "choice" else None
            return Val("bytes", text, most_size=longest, is_text=parameter.type != "bytes")
        return None

    def _variable(self, state: StateVariable) -> Val | None:
        """Return a state variable that is no table; None for those without a form in C."""
        text = f"context->{identifier(state.name)}"
        there = f"context->has_{identifier(state.name)}" if state.announced else ""
        if state.type in ("text", "bytes"):
            return Val("bytes", text, there=there, is_text=state.type != "bytes")
        if re.fullmatch(r"[ui](8|16|24|32)|flag|number", state.type) is None:
            return None
        low, high = INT32
        if state.type == "flag":
            low, high = 0, 1
        elif state.type != "number":
            bits = int(state.type[1:])
            low, high = (0, (1 << bits) - 1) if state.type[0] == "u" else (-(1 << bits - 1), (1 << bits - 1) - 1)
        return Val("number", f"(int64_t){text}", low, high, there)

    def lookup(self, node: Node, key: Val, default: Val | None) -> Val | None:
        """Return an entry of a table, a number or a text, for a number or a text as key."""
        if not isinstance(node, Name) or node.name not in self.protocol.tables or key.kind not in ("number", "bytes"):
            return None
        if key.fold:
            raise CannotSayError(node.at, f"an entry of '{node.name}' by letters of one case")
        table = self.protocol.tables[node.name]
        by_text = key.kind == "bytes"
        function, low, high, is_text = self._table(node, table, by_text)
        key_text = key.text
        if isinstance(key.constant, bytes):
            key_text = f"{self.helper('view')}((const uint8_t *){string(key.constant)}, {len(key.constant)})"
        there = f"{function}_has({key_text})"
        there = f"({key.there} && {there})" if key.there else there
        kind: Any = "bytes" if is_text else "number"
        if default is not None:
            text = f"{function}({key_text}, NULL)"
            if default.kind == "none":
                return Val(kind, text, low, high, there=there)
            if default.kind != kind or default.there or default.fold:
                return None
            low, high = min(low, default.low), max(high, default.high)
            shown = default.text
            if isinstance(default.constant, bytes):
                size = len(default.constant)
                shown = f"{self.helper('view')}((const uint8_t *){string(default.constant)}, {size})"
            return Val(kind, f"({there} ? {text} : {shown})", low, high, wire=there)
        entry = f"{function}({key_text}, &bad)"
        if key.there:
            nothing = f"{self.helper('bad_bytes' if is_text else 'bad')}(&bad)"
            entry = f"({key.there} ? {entry} : {nothing})"
        return Val(kind, entry, min(low, 0), max(high, 0), wire=there)

    def _table(self, node: Name, table: Table, by_text: bool) -> tuple[str, int, int, bool]:
        values = [*(one for key, one in table.entries.items() if isinstance(key, str) == by_text)]
        values += [] if by_text else [one for _, _, one in table.ranges]
        is_text = bool(values) and all(isinstance(one, str) for one in values)
        if not values or not (is_text or all(isinstance(one, int) for one in values)):
            raise CannotSayError(node.at, f"the table '{table.name}', which holds more than numbers or texts")
        numbers = [one for one in values if isinstance(one, int)]
        if numbers and not LEAST <= min(numbers) <= max(numbers) <= MOST:
            raise CannotSayError(node.at, f"the table '{table.name}', whose numbers need more than 64 bits")
        rows = _rows(table, by_text)
        function = f"fk_table_{identifier(table.name)}{'_by_text' if by_text else ''}"
        if function not in self.functions:
            self.functions[function] = self._table_code(function, rows, by_text, is_text)
        return function, min(numbers, default=0), max(numbers, default=0), is_text

    def _table_code(self, function: str, rows: list[tuple[str, str]], by_text: bool, is_text: bool) -> CSource:
        code = CSource()
        key = "struct framekit_bytes" if by_text else "int64_t"
        value = "struct framekit_bytes" if is_text else "int64_t"
        nothing = f"{self.helper('view')}(NULL, 0)" if is_text else "0"
        test = (
            f"{self.helper('same_bytes')}(key, rows[i].key)"
            if by_text
            else "key >= rows[i].first && key <= rows[i].last"
        )
        with code.block(f"static {value} {function}({key} key, bool *bad)"):
            with code.block("static const struct", f" rows[{len(rows)}] = {{"):
                code.add("struct framekit_bytes key;" if by_text else "int64_t first, last;", f"{value} value;")
            code.add(*(f"    {{ {one}, {two} }}," for one, two in rows), "};", "size_t i;")
            with code.block(f"for (i = 0; i < {len(rows)}; i++)"), code.block(f"if ({test})"):
                code.add("return rows[i].value;")
            code.when("bad != NULL", "*bad = true;")
            code.add(f"return {nothing};")
        with code.block(f"static inline bool {function}_has({key} key)"):
            code.add("bool bad = false;", f"(void){function}(key, &bad);", "return !bad;")
        return code

    # ---- frames inside ------------------------------------------------------------------------------------

    def inner_reader(self, segment: Inner) -> str:
        """Return the function that reads an inner frame: the first frame that fits, or that is to be refused."""
        frames = tuple(dict.fromkeys(segment.frames))
        order = self.order_of(frames)
        name = f"{self.prefix}_fk_inner_{'_'.join(identifier(one) for one in (order[0], str(len(order))))}"
        known = set(self.inner_structs.values())
        if frames in self.inner_structs:
            return self.inner_structs[frames]
        base, count = name, 1
        while name in known:
            count += 1
            name = f"{base}_{count}"
        self.inner_structs[frames] = name
        upper = self.prefix.upper()
        self.helper("view")
        code = CSource()
        header = (
            f"static void {name}(const uint8_t *data, size_t size{self.context}, void *into,"
            " struct framekit_fault *fault, struct fk_notes *outer)"
        )
        with code.block(header):
            with code.block("struct", " *v = into;"):
                code.add(f"enum {self.prefix}_frame frame;")
                with code.block("union", " of;"):
                    code.add("struct framekit_bytes unknown;")
                    for one in frames:
                        code.add(f"struct {self.frame_enum(one)} {inner_name(one)};")
            if self.context:
                code.add("(void)context;")
            code.add("fault->reason = FRAMEKIT_OK;")
            self._switch(code, tree_of(self.static, order), lambda left: self._tried(code, left, upper))
            code.add(f"v->frame = {upper}_FRAME_UNKNOWN;", "v->of.unknown = fk_view(data, size);")
        self.functions[name] = code
        return name

    def first_inside(self, segment: Inner) -> str:
        """Return the function that measures an inner frame.

        It returns the length of the first frame that fits, or the number of missing bytes. Its parameters state the
        size of the later segments, and whether no more bytes will arrive (`whole`).
        """
        frames = tuple(dict.fromkeys(segment.frames))
        if frames in self.firsts:
            return self.firsts[frames]
        for frame in frames:
            if frame in self.not_measured:
                raise CannotSayError(segment.at, f"the frame '{frame}' inside, whose end C does not find")
        order = self.order_of(frames)
        name = f"{self.prefix}_fk_first_{len(self.firsts)}"
        code = CSource()
        header = f"static int64_t {name}(const uint8_t *data, size_t size{self.context}, bool whole, int64_t behind)"
        self.helper("told")
        with code.block(header):
            code.add("const unsigned *list = NULL;", "size_t count = 0, i;")
            code.add("int64_t want = 0, other = 0, found;", "bool quiet = false, lost = false;")
            every = ", ".join(str(place) for place in range(len(order)))
            code.add(f"static const unsigned every[] = {{ {every} }};", "list = every;", f"count = {len(order)};")
            if isinstance(tree := tree_of(self.static, order), Switch):
                self._switch(code, tree, lambda left: self._listed(code, left, order), "whole")
            with code.block("for (i = 0; i < count; i++)"):
                self._measured(code, order)
            with code.block("if (want != 0)"):
                with code.block("if (other != 0)"):
                    code.add(
                        "int64_t least = (int64_t)size - other - behind < -1 ? (int64_t)size - other - behind : -1;"
                    )
                    code.add("return want - behind > least ? want - behind : least;")
                code.add("return want - behind;")
            code.add("return quiet ? FK_QUIET : lost ? FK_LOST : 0;")
        self.functions[name] = code
        self.firsts[frames] = name
        return name

    def _measured(self, code: CSource, order: tuple[str, ...]) -> None:
        """Write how the frame `list[i]` of `order` is measured, and read if it is complete."""
        code.add("struct fk_notes notes;", "struct framekit_fault fault;")
        with code.block("union", " scratch;"):
            for place, frame in enumerate(order):
                code.add(f"struct {self.frame_enum(frame)} of{place};")
        with code.block("switch (list[i])"):
            for place, frame in enumerate(order):
                call = f"{self.prefix}_fk_measure_{identifier(frame)}(data, size{self.hand_on})"
                code.add(f"case {place}: found = {call}; break;")
            code.add("default: found = 0; break;")
        with code.block("if (found > 0)"):
            with code.block("if (whole || want == 0)"):
                code.add("memset(&notes, 0, sizeof notes);")
                with code.block("switch (list[i])"):
                    for place, frame in enumerate(order):
                        call = (
                            f"{self.prefix}_fk_read_{identifier(frame)}(data, (size_t)found{self.hand_on},"
                            f" &scratch.of{place}, &notes)"
                        )
                        code.add(f"case {place}: {call}; break;")
                    code.add("default: break;")
                code.add("fk_told(&notes, &fault);")
                code.when("fault.reason == FRAMEKIT_OK || fault.refuse >= 0", "return found;")
            code.add("other = other == 0 || found < other ? found : other;")
        with code.block("else if (found > FK_QUIET)"):
            code.add("want = found != 0 && (want == 0 || found > want) ? found : want;")
        with code.block("else"):
            code.add("quiet = quiet || found == FK_QUIET;", "lost = lost || found == FK_LOST;")

    def nearest_inside(self, segment: Inner) -> str:
        """Return the function that determines the fault if no frame fits.

        This is the fault of the frame that is read furthest.
        """
        frames = tuple(dict.fromkeys(segment.frames))
        if frames in self.nearest:
            return self.nearest[frames]
        order = self.order_of(frames)
        name = self.nearest[frames] = f"{self.prefix}_fk_nearest_{len(self.nearest)}"
        self.helper("told")
        code = CSource()
        header = (
            f"static void {name}(const uint8_t *data, size_t size{self.context}, struct framekit_fault *fault,"
            " struct fk_notes *outer)"
        )
        with code.block(header):
            code.add("struct framekit_fault one;", "size_t reach = 0, reached;", "int64_t found;")
            with code.block("union", " scratch;"):
                for place, frame in enumerate(order):
                    code.add(f"struct {self.frame_enum(frame)} of{place};")
            if self.context:
                code.add("(void)context;")
            for place, frame in enumerate(order):
                suffix = identifier(frame)
                with code.block(""):
                    code.add("struct fk_notes notes;", "memset(&notes, 0, sizeof notes);")
                    code.add(f"found = {self.prefix}_fk_measure_{suffix}(data, size{self.hand_on});")
                    size = "found > 0 ? (size_t)found : size"
                    code.add(f"{self.prefix}_fk_read_{suffix}(data, {size}{self.hand_on}, &scratch.of{place}, &notes);")
                    code.when("notes.no_room", "outer->no_room = true;", "return;")
                    code.add("fk_told(&notes, &one);")
                    code.add("reached = notes.reason == FRAMEKIT_OK ? size + 1 : notes.place;")
                    first = "one.reason = notes.reason;", "one.offset = notes.place;"
                    code.when("notes.reason != FRAMEKIT_OK", *first)
                    better = "fault->reason == FRAMEKIT_OK || reached > reach"
                    code.when(f"one.reason != FRAMEKIT_OK && ({better})", "*fault = one;", "reach = reached;")
        self.functions[name] = code
        return name

    def _listed(self, code: CSource, frames: tuple[str, ...], order: tuple[str, ...]) -> None:
        """Write the list of the frames that remain for a value of the deciding byte."""
        if not frames:
            code.add("count = 0;")
            return
        some = ", ".join(str(order.index(one)) for one in frames)
        code.add(f"static const unsigned some[] = {{ {some} }};", "list = some;", f"count = {len(frames)};")

    def _switch(
        self, code: CSource, tree: Leaf | Switch, leaf: Callable[[tuple[str, ...]], None], cut: str = ""
    ) -> None:
        """Write the statements for the frames that remain for each value of the deciding byte.

        `cut`: the condition for the default branch if the bytes end before the deciding byte; empty for no condition.
        """
        if isinstance(tree, Leaf):
            leaf(tree.frames)
            return
        with code.block(f"switch (size > {tree.at} ? (int)data[{tree.at}] : -1)"):
            for value, inside in tree.cases:
                with code.block(f"case {value}:"):
                    self._switch(code, inside, leaf, cut)
                    code.add("break;")
            if cut:
                code.add("case -1:")
                with code.block(f"if ({cut})"):
                    self._switch(code, tree.others, leaf, cut)
                code.add("break;")
            with code.block("default:"):
                self._switch(code, tree.others, leaf, cut)
                code.add("break;")

    def _tried(self, code: CSource, frames: tuple[str, ...], upper: str) -> None:
        for one in frames:
            self._try(code, one, upper)

    def _try(self, code: CSource, frame: str, upper: str) -> None:
        reader = f"{self.prefix}_fk_read_{identifier(frame)}"
        with code.block(""):
            code.add("struct fk_notes notes;", "memset(&notes, 0, sizeof notes);")
            code.add(f"{reader}(data, size{self.hand_on}, &v->of.{inner_name(frame)}, &notes);")
            code.when("notes.no_room", "outer->no_room = true;", "return;")
            code.add("fk_told(&notes, fault);")
            code.when(
                "fault->reason == FRAMEKIT_OK || fault->refuse >= 0",
                f"v->frame = {upper}_FRAME_{identifier(frame)};",
                "return;",
            )
            code.add("fault->reason = FRAMEKIT_OK;")


def prefix_of(name: str) -> str:
    """Return the prefix of all names of a protocol, distinct from the prefixes of the generator."""
    found = identifier(name).lower()
    return f"x{found}" if re.match(r"(fk|framekit)(_|$)", found) else found


def generate(protocol: Protocol, most: int = MOST_BYTES) -> Generated:
    """Return the C of a protocol, with as many of its frames as C can represent."""
    left: dict[str, Problem] = {}
    while True:
        file = _Writing(protocol, most, set(left))
        found = file.write()
        if not found:
            return file.finished(left)
        left |= found


class _Writing:
    """One attempt, with all frames that are not yet left out."""

    def __init__(self, protocol: Protocol, most: int, left: set[str]) -> None:
        self.file = CFile(protocol, most)
        self.protocol = protocol
        self.frames = [one for one in protocol.frames.values() if one.name not in left]
        self.left = left
        self.parser: ParserWriter | None = None

    def write(self) -> dict[str, Problem]:
        """Write everything; return the frames that must be left out, with the reasons."""
        file, found = self.file, dict[str, Problem]()
        self._context()
        for frame in self.frames:
            try:
                self._known_inside(frame)
                file.names.take(file.frame_enum(frame.name), f"the frame '{frame.name}'", frame.at)
                file.names.take(file.number_name(frame.name), f"the number of '{frame.name}'", frame.at)
                file.structs[frame.name] = file.layouts.struct(frame)
            except CannotSayError as error:
                found[frame.name] = error.problem
        if found:
            return found
        self.order = self._in_order(found)
        if found:
            return found
        for frame in self.order:
            try:
                segments = file.static.segments(frame)
                writer = ReadWriter(file, segments, file.structs[frame.name])
                name = f"{file.prefix}_fk_read_{identifier(frame.name)}"
                file.functions[name] = writer.write(name, frame)
            except CannotSayError as error:
                found[frame.name] = error.problem
                continue
            self._build(frame, segments)
            self._measure(frame, segments)
        return found

    def _build(self, frame: Frame, segments: Segments) -> None:
        """Write the encoder of a frame; a frame without an encoder is reported and can still be decoded."""
        file = self.file
        name = f"{file.prefix}_fk_write_{identifier(frame.name)}"
        try:
            for segment in everything(frame.segments):
                for inside in segment.frames_inside:
                    if inside in file.not_built:
                        raise CannotSayError(segment.at, f"the frame '{inside}' inside is not built")
            builder = WriteWriter(file, frame, segments, file.structs[frame.name])
            file.functions[name] = builder.write(name, frame)
        except CannotSayError as error:
            file.not_built[frame.name] = error.problem

    def _measure(self, frame: Frame, segments: Segments) -> None:
        """Write the measuring function of a frame; a frame without it is reported and can still be decoded."""
        file = self.file
        name = f"{file.prefix}_fk_measure_{identifier(frame.name)}"
        try:
            if frame.inside:
                raise CannotSayError(frame.at, "frames that may interrupt it")
            if frame.mark in ("first", "last"):
                raise CannotSayError(frame.at, "a byte of nine bits that marks it")
            writer = CMeasureWriter(file, frame, segments, file.structs[frame.name])
            file.functions[name] = writer.write(name)
        except CannotSayError as error:
            file.not_measured[frame.name] = error.problem

    def _context(self) -> None:
        """Determine whether functions need the context: whether expressions read names other than fields.

        The result must be known in advance, since all functions pass the context on.
        """
        file = self.file
        probe = CFile(self.protocol, file.layouts.most)
        for frame in self.frames:
            segments = probe.static.segments(frame)
            for segment in everything(segments):
                from framekit.definition.expression import walk
                from framekit.definition.model.frames import expressions_of

                for expression in expressions_of(segment):
                    for node in walk(expression.root):
                        if isinstance(node, Name):
                            try:
                                probe.given(node)
                            except CannotSayError:
                                continue
        if probe.asked:
            file.context = f", const struct {file.prefix}_context *context"
            file.hand_on = ", context"
        self.given = probe.asked

    def _known_inside(self, frame: Frame) -> None:
        for segment in everything(frame.segments):
            for name in segment.frames_inside:
                if name in self.left:
                    raise CannotSayError(segment.at, f"the frame '{name}' inside is left out")

    def _in_order(self, found: dict[str, Problem]) -> list[Frame]:
        """Return the frames with inner frames before their outer frames."""
        order: list[Frame] = []
        names = {one.name for one in self.frames}
        waiting = list(self.frames)
        while waiting:
            done = {one.name for one in order}
            ready = [one for one in waiting if _inside(one) & names <= done]
            if not ready:
                for one in waiting:
                    found[one.name] = Problem(one.at, f"the frame '{one.name}' may stand in itself")
                return order
            order += ready
            waiting = [one for one in waiting if one not in ready]
        return order

    # ---- the files ----------------------------------------------------------------------------------------

    def finished(self, left: dict[str, Problem]) -> Generated:
        file = self.file
        file.helper("told")
        found = line_frames(self.protocol, self.frames, file.not_measured)
        most = max((file.layouts.most_of(one) for one in found), default=0)
        self.parser = (
            ParserWriter(file.prefix, file.context, file.hand_on, found, most, self.protocol.receiver)
            if found
            else None
        )
        header = self._header()
        source = self._source()
        names = tuple(one.name for one in self.frames)
        to_give = tuple((frame, name, problem) for (frame, name), problem in file.given_only.items())
        told = tuple(file.not_measured.items())
        built = tuple(file.not_built.items())
        return Generated(
            file.prefix, header, source, names, tuple(left.items()), to_give, told, built, file.structs, file.prefix,
            tuple(one.name for one in found),
        )  # fmt: skip

    def _header(self) -> str:
        file, protocol = self.file, self.protocol
        prefix, upper = file.prefix, file.prefix.upper()
        out = CSource()
        out.add(comment(f"The frames of {protocol.name} in C99, made by framekit: {protocol.about}".rstrip(": ")))
        out.add(f"#ifndef {upper}_H", f"#define {upper}_H", "", *_SHARED.splitlines(), "")
        out.add("#ifdef __cplusplus", 'extern "C" {', "#endif", "")
        with out.block(f"enum {prefix}_frame", ";"):
            out.add(f"{upper}_FRAME_UNKNOWN,")
            for frame in self.frames:
                out.add(f"{file.number_name(frame.name)},")
        out.add("")
        self._enums(out)
        if self.given:
            out.add("/* What frames depend on beside their fields. */")
            with out.block(f"struct {prefix}_context", ";"):
                for name, value in self.given.items():
                    if value.there:
                        out.add(f"bool has_{identifier(name)};")
                    type_ = "struct framekit_bytes" if value.kind == "bytes" else CMember(
                        name, "number", "", protocol.at, value.low, value.high).ctype  # fmt: skip
                    out.add(f"{type_} {identifier(name)};")
            out.add("", f"extern const struct {prefix}_context {prefix}_defaults;", "")
        enums = {one.name: file.frame_enum(one.name) for one in self.frames}
        for frame in self.order:
            if frame.doc:
                out.add(comment(frame.doc))
            with out.block(f"struct {file.frame_enum(frame.name)}", ";"):
                declare(file.structs[frame.name], out, prefix, enums)
            out.add("")
        out.add(f"#define {upper}_MAX_FRAME {self._greatest()}", "")
        for frame in self.order:
            struct = f"struct {file.frame_enum(frame.name)}"
            out.add(
                f"enum framekit_reason {prefix}_decode_{identifier(frame.name)}(const uint8_t *data, size_t size"
                f"{file.context}, {struct} *frame, struct framekit_fault *fault);"
            )
            if frame.name not in file.not_built:
                encode = f"int32_t {prefix}_encode_{identifier(frame.name)}"
                out.add(f"{encode}(const {struct} *frame{file.context}, uint8_t *to, size_t room);")
            if frame.name not in file.not_measured:
                name = f"{prefix}_measure_{identifier(frame.name)}"
                out.add(f"int32_t {name}(const uint8_t *data, size_t size{file.context});")
        out.add("")
        if self.parser is not None:
            self.parser.header(out)
        out.add("#ifdef __cplusplus", "}", "#endif", "", "#endif")
        return out.text()

    def _greatest(self) -> int:
        return max((self.file.layouts.most_of(one) for one in self.frames), default=0)

    def _enums(self, out: CSource) -> None:
        """Write enumerations for the names of numbers."""
        file = self.file
        known: dict[str, dict[int, str]] = {}
        for frame in self.frames:
            for segment in everything(frame.segments):
                parts = segment.parts if isinstance(segment, Bits) else (segment,) if isinstance(segment, Field) else ()
                for part in parts:
                    if part.values is None:
                        continue
                    values = dict(part.values)
                    if any(not -(1 << 31) <= one < 1 << 31 for one in values):
                        continue
                    name = identifier(part.name or "")
                    if known.get(name) == values:
                        continue
                    if name in known:
                        name = f"{identifier(frame.name)}_{name}"
                        if known.get(name, values) != values:
                            continue
                    if name in known:
                        continue
                    rows = self._rows(name, values)
                    if rows is None:
                        continue
                    known[name] = values
                    with out.block(f"enum {file.prefix}_{name}_values", ";"):
                        out.add(*(f"{constant} = {value}," for constant, value in rows))
                    out.add("")

    def _rows(self, name: str, values: dict[int, str]) -> list[tuple[str, int]] | None:
        upper, rows, seen = self.file.prefix.upper(), list[tuple[str, int]](), set[str]()
        for value, text in values.items():
            constant_name = f"{upper}_{name}_{_word(text)}".upper()
            if constant_name in seen or constant_name in self.file.names.taken:
                constant_name += f"_{value}" if value >= 0 else f"_MINUS_{-value}"
            if constant_name in seen or constant_name in self.file.names.taken:
                return None
            seen.add(constant_name)
            rows.append((constant_name, value))
        for one in seen:
            self.file.names.take(one, f"a value of '{name}'")
        return rows

    def _source(self) -> str:
        file = self.file
        prefix = file.prefix
        out = CSource()
        out.add(comment(f"The frames of {self.protocol.name} in C99, made by framekit."))
        out.add(f'#include "{prefix}.h"', "", "#include <string.h>", "")
        parts = support_parts()
        body = CSource()
        for code in file.functions.values():
            body.add(*code.lines, "")
        for frame in self.order:
            self._decode(body, frame)
            self._measured(body, frame)
        if self.parser is not None:
            self.parser.functions(body)
            self.parser.source(body)
        for name in _carried(body.text()):
            out.add(*parts[name][1].splitlines(), "")
        if self.given:
            self._defaults(out)
        out.add(*body.lines)
        return out.text()

    def _defaults(self, out: CSource) -> None:
        file = self.file
        with out.block(f"const struct {file.prefix}_context {file.prefix}_defaults =", ";"):
            for name, value in self.given.items():
                start = file.start_values.get(name)
                if value.there:
                    out.add(f"{'false' if start is None else 'true'},")
                if value.kind == "bytes":
                    start = b"" if start is None else start
                    data = start.encode("latin-1", "replace") if isinstance(start, str) else bytes(start)
                    out.add(f"{{ (const uint8_t *){string(data)}, {len(data)} }},")
                else:
                    out.add(f"{number(int(start or 0))},")
        out.add("")

    def _measured(self, out: CSource, frame: Frame) -> None:
        file = self.file
        name = identifier(frame.name)
        if frame.name in file.not_measured:
            return
        header = f"int32_t {file.prefix}_measure_{name}(const uint8_t *data, size_t size{file.context})"
        with out.block(header):
            out.add(f"int64_t found = {file.prefix}_fk_measure_{name}(data, size{file.hand_on});")
            out.add("return found == FK_QUIET ? FRAMEKIT_QUIET : found == FK_LOST ? FRAMEKIT_LOST : (int32_t)found;")
        out.add("")

    def _decode(self, out: CSource, frame: Frame) -> None:
        file = self.file
        prefix = file.prefix
        name = identifier(frame.name)
        header = (
            f"enum framekit_reason {prefix}_decode_{name}(const uint8_t *data, size_t size{file.context},"
            f" struct {file.frame_enum(frame.name)} *frame, struct framekit_fault *fault)"
        )
        with out.block(header):
            out.add(
                "static const uint8_t nothing[1] = { 0 };", "struct fk_notes notes;", "struct framekit_fault found;"
            )
            out.add("memset(&notes, 0, sizeof notes);")
            out.add(f"{prefix}_fk_read_{name}(data == NULL ? nothing : data, size{file.hand_on}, frame, &notes);")
            out.add("fk_told(&notes, fault == NULL ? &found : fault);")
            out.add("return fault == NULL ? found.reason : fault->reason;")
        out.add("")
        if frame.name in file.not_built:
            return
        with out.block(
            f"int32_t {prefix}_encode_{name}(const struct {file.frame_enum(frame.name)} *frame{file.context},"
            " uint8_t *to, size_t room)"
        ):
            out.add("struct fk_out out = { to, room, 0, FRAMEKIT_OK };")
            out.add(f"{prefix}_fk_write_{name}(frame{file.hand_on}, &out);")
            out.when("out.at > 0x7FFFFFFF", "out.reason = FRAMEKIT_NO_ROOM;")
            out.add("return out.reason == FRAMEKIT_OK ? (int32_t)out.at : -(int32_t)out.reason;")
        out.add("")


def _carried(body: str) -> list[str]:
    """Return the support functions that a source needs, each after its own dependencies."""
    found: list[str] = []

    def add(name: str) -> None:
        if name in found:
            return
        needs, text = support_parts()[name]
        for one in (*needs, *_called(text)):
            if one != name:
                add(one)
        found.append(name)

    for name in _called(body):
        add(name)
    return found


@cache
def _called(text: str) -> tuple[str, ...]:
    words = set(re.findall(r"\bfk_(\w+)", text))
    spans = {"spans"} if "fk_span" in text else set()
    spans |= {"ends"} if "FK_QUIET" in text or "FK_LOST" in text else set()
    return tuple(name for name in support_parts() if name in words | spans or f"{name}_at" in words)


def _rows(table: Table, by_text: bool) -> list[tuple[str, str]]:
    """Return the keys and values of the entries with texts or with numbers as keys, as initializers in C."""
    rows: list[tuple[str, str]] = []
    for key, value in table.entries.items():
        if isinstance(key, str) and by_text:
            data = key.encode("latin-1", "replace")
            rows.append((f"{{ (const uint8_t *){string(data)}, {len(data)} }}", _shown_entry(value)))
        elif isinstance(key, int) and not by_text and LEAST <= key <= MOST:
            rows.append((f"{number(key)}, {number(key)}", _shown_entry(value)))
    for first, last, value in () if by_text else table.ranges:
        rows.append((f"{number(first)}, {number(last)}", _shown_entry(value)))
    return rows


def _shown_entry(value: Any) -> str:
    if isinstance(value, int):
        return number(value)
    data = str(value).encode("latin-1", "replace")
    return f"{{ (const uint8_t *){string(data)}, {len(data)} }}"


def _word(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_") or "x"


def _inside(frame: Frame) -> set[str]:
    return {name for segment in everything(frame.segments) for name in segment.frames_inside}


_SHARED = (
    """\
#ifndef FRAMEKIT_C99
#define FRAMEKIT_C99 1
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Why bytes are not a frame, or values cannot be sent. */
enum framekit_reason {
    FRAMEKIT_OK,
"""
    + "".join(f"    FRAMEKIT_{one.upper()},\n" for one in REASONS)
    + """\
    FRAMEKIT_NO_ROOM /* more than the struct or the buffer has room for */
};

/* What measuring says beside a length (above 0), "no such frame" (0), or how many bytes it wants at least (below 0). */
#define FRAMEKIT_QUIET (-0x7FFFFFFE) /* only silence ends the frame */
#define FRAMEKIT_LOST (-0x7FFFFFFF) /* its end cannot be found */

/* Bytes that stand elsewhere. */
struct framekit_bytes {
    const uint8_t *data;
    size_t size;
};

/* A number in text with as many digits behind its point as it has: `number` times 10 to the power of minus `places`. */
struct framekit_decimal {
    int64_t number;
    int16_t places;
};

/* What a parser of streams tells: it wants more bytes, a frame, bytes that would be a frame but for a fault. */
enum framekit_event {
    FRAMEKIT_MORE,
    FRAMEKIT_FRAME,
    FRAMEKIT_BAD
};

/* Who sends what comes, for a parser of streams. */
#define FRAMEKIT_FROM_CLIENT 1u
#define FRAMEKIT_FROM_SERVER 2u

/* The first fault of a frame: why, at which byte, and the code with which a server refuses it (-1: it is just bad). */
struct framekit_fault {
    enum framekit_reason reason;
    size_t offset;
    int64_t refuse;
};
#endif"""
)

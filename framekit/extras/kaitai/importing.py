"""Import a definition from a Kaitai Struct file: types become layouts and frames; parts without a form are reported.

The type of the file becomes a frame. If it only switches on a parameter, each case becomes a frame; if it reads no
bytes, each of its types. A frame is the whole stream. No part is imported inexactly: a part that would read other bytes
or give other values is left out. If it is in a conditional part or in a case, frames that contain it are refused; else
the frame is left out.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from framekit.codec.ambiguity import check_matrices
from framekit.codec.codec import compile_protocol
from framekit.definition.expression import Name
from framekit.definition.imported import ImportedDefinition
from framekit.definition.load.protocol import load_protocol
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.nodes import Scalar, read_text
from framekit.definition.problems import CannotSayError, DefinitionError, Position, Problem, printable
from framekit.definition.sources import cached_by
from framekit.definition.written import comment, yaml_lines
from framekit.extras.kaitai.attributes import Keys, LeftOutError, Region, StaticTypes, WorkDone, is_end
from framekit.extras.kaitai.description import Description, KsyEnum, KsyType, read_description
from framekit.extras.kaitai.language import parse
from framekit.extras.kaitai.translation import Kind, KsyMeaning, KsyScope
from framekit.extras.kaitai.type_writer import TypeWriter

MOST_CHECKED = 200
"""Limit of the frames that are tested individually after the whole definition is refused."""
_PARAMS: Mapping[str, tuple[str, Kind]] = {
    "bool": ("flag", "bool"), "str": ("text", "str"), "bytes": ("bytes", "bytes"),
    **{f"{sign}{size}": ("number", "int") for sign in "us" for size in (1, 2, 4, 8)},
}  # fmt: skip
_NOT_PARAMS = frozenset(
    {
        "it", "part", "request", "reply", "buffer", "reply_buffer", "expected", "own", "role", "now", "frame",
        "refusal", "station", "line", "clock", "cause", "outcome", "if", "else", "or", "and", "not", "in", "true",
        "false", "never",
    }
)  # fmt: skip
"""Names that a parameter of a protocol cannot have."""
_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
ASCII = "".join(map(chr, range(128)))


def import_kaitai(text: str, file: str, name: str) -> ImportedDefinition:
    """Return the definition `name` from the text of a file. Raises DefinitionError if no frame can be imported."""
    problems: dict[Problem, None] = {}

    def tell(at: Position, what: str, todo: str, *, warning: bool = False) -> None:
        problems.setdefault(Problem(at, what, todo, warning))

    found = read_description(read_text(text, file), tell)
    if found is None:
        raise DefinitionError(problems)
    writer = _DefinitionWriter(found, file, name, problems)
    writer.write()
    made = writer.accepted()
    if not writer.frames:
        at = found.top.at
        raise DefinitionError(
            [*problems] or [Problem(at, "there is nothing to read in this file", "write seq: or types:")]
        )
    return ImportedDefinition(made, tuple(sorted(problems)))


class _DefinitionWriter:
    """Hold the common parts of the frames: tables, layouts, parameters and reports."""

    def __init__(self, found: Description, file: str, name: str, problems: dict[Problem, None]) -> None:
        self.found, self.file, self.name, self.problems = found, file, name, problems
        self.frames: dict[str, Keys] = {}
        self.places: dict[str, Position] = {}
        self.work = WorkDone()
        self.static = StaticTypes()
        self.order = "little" if found.top.endian == "le" else "big"
        self.params: dict[str, Keys] = {}
        self._layouts: dict[str, list[Keys]] = {}
        self._layout_names: dict[str, str] = {}
        self._tables: dict[str, dict[int, str]] = {}
        self._table_names: dict[tuple[str, ...], str] = {}
        self._docs: list[str] = []
        self._every_name = {one for type_ in _types(found.top) for one in type_.names}
        self._letters = ""

    # ---- what types ask for -------------------------------------------------------------------------------

    def tell(self, at: Position, what: str, todo: str, *, warning: bool = False) -> None:
        self.problems.setdefault(Problem(at, what, todo, warning))

    def table(self, enum: KsyEnum) -> str:
        """Return the name of the table of an enumeration that has members."""
        if enum.place not in self._table_names:
            name = _unused(enum.place[-1], self._tables, "_".join(enum.place))
            self._table_names[enum.place] = name
            self._tables[name] = {number: member for member, number in enum.members.items()}
            self._docs += [f"{name}.{member}: {doc}" for member, doc in enum.docs.items()]
        return self._table_names[enum.place]

    def layout(self, type_: KsyType, segments: list[Keys]) -> str:
        """Return the name of the layout with these segments."""
        key = json.dumps([type_.path, segments], ensure_ascii=True)
        if key not in self._layout_names:
            name = _unused(type_.name, self._layouts, "_".join(type_.path))
            self._layout_names[key] = name
            self._layouts[name] = segments
        return self._layout_names[key]

    def letters(self) -> str:
        """Return the name of a parameter that holds the ASCII characters."""
        if not self._letters:
            self._letters = _unused("ascii", {**self.params, **dict.fromkeys(self._every_name)}, "ascii_letters")
            text = ASCII.replace("\\", "\\\\").replace("'", "\\'")
            self.params[self._letters] = {"type": "text", "is": f"'{text}'"}
        return self._letters

    # ---- frames -------------------------------------------------------------------------------------------

    def write(self) -> None:
        top = self.found.top
        scope = KsyScope(top, None)
        scope.find = lambda name, at: self._param(name)
        cases = self._cases(scope)
        if cases is not None:
            for type_ in cases:
                self._frame(type_, KsyScope(type_, scope))
        elif top.seq:
            self._frame(top, scope)
        else:
            for name, instance in top.instances.items():
                self.tell(
                    instance.at, f"the instance '{name}' is left out: it stands in no frame", "put it into a type"
                )
            for type_ in top.types.values():
                if type_.params:
                    self.tell(type_.at, f"the type '{type_.name}', which is told parameters, is no frame", "")
                else:
                    self._frame(type_, KsyScope(type_, None))

    def _cases(self, scope: KsyScope) -> list[KsyType] | None:
        """Return the types of the cases if the file's type only switches on a parameter, else None."""
        top = self.found.top
        first = top.seq[0] if top.seq else None
        type_ = None if first is None else first.keys.get("type")
        if first is None or not isinstance(type_, MappingNode) or not first.keys.keys() <= {"id", "type", "doc"}:
            return None
        on, cases = type_.value("switch-on"), type_.value("cases")
        try:
            asked = parse(on.text, on.at) if isinstance(on, Scalar) else None
        except CannotSayError:
            return None
        if not isinstance(asked, Name) or asked.name not in top.params or not isinstance(cases, MappingNode):
            return None
        if not all(is_end(one) for one in top.seq[1:]) or top.instances:
            return None
        scope.entries[asked.name] = KsyMeaning("", "lost", why="which says which frame it is")
        found: dict[KsyType, None] = {}
        for entry in cases.entries:
            name = entry.value.text if isinstance(entry.value, Scalar) else ""
            one = top.find_type(name)
            if one is None:
                self.tell(entry.value.at, f"the case '{name[:40]}' is no frame", "only types of this file are frames")
            else:
                found.setdefault(one)
        return [*found]

    def _param(self, name: str) -> KsyMeaning | None:
        """Return the meaning of a parameter of the file's type, which becomes a parameter of the protocol."""
        param = self.found.top.params.get(name)
        if param is None:
            return None
        said = param.keys.get("type")
        word = said.text if isinstance(said, Scalar) else "bytes" if said is None else ""
        if word not in _PARAMS or not param.keys.keys() <= {"id", "type", "doc", "doc-ref", "enum"}:
            return KsyMeaning("", "lost", why="a parameter of such a type")
        type_, kind = _PARAMS[word]
        own = f"{name}_" if name in _NOT_PARAMS else name
        self.params.setdefault(own, {"type": type_, **({"doc": param.doc} if param.doc else {})})
        return KsyMeaning(own, kind)

    def _frame(self, type_: KsyType, scope: KsyScope) -> None:
        name = _unused(type_.name, self.frames, type_.name)
        self.work.begin()
        try:
            region = Region()
            segments, sizes = TypeWriter(self, scope, region, 0, alone=True, using=(type_,)).write()
            if region.most is not None and sizes.least > region.most:
                raise CannotSayError(type_.at, f"the type '{type_.name}' takes more bytes than it may", "correct it")
            if sizes.most == 0:
                raise CannotSayError(type_.at, f"the type '{type_.name}', which takes no bytes, is no frame", "")
        except CannotSayError as error:
            self.tell(error.problem.at, error.problem.what, error.problem.todo)
            self._is_left_out(type_, name)
            return
        except LeftOutError:
            self._is_left_out(type_, name)
            return
        self.places[name] = type_.at
        doc = {"doc": type_.doc} if type_.doc else {}
        most = {} if region.most is None or sizes.fixed is not None else {"max": region.most}
        self.frames[name] = {**doc, **most, "body": segments}

    def _is_left_out(self, type_: KsyType, name: str) -> None:
        what = f"the frame '{name}' is left out"
        self.tell(type_.at, what, "it cannot be read without what is told of it; write that by hand")

    # ---- the text -----------------------------------------------------------------------------------------

    def accepted(self) -> str:
        """Return the text without the frames that framekit's own checker refuses; these are reported.

        A frame that is always taken for another frame can only be read by name, as in Kaitai, where a parameter selects
        it.
        """
        wrong, alike = _refused(self._text(self.frames)) if self.frames else ([], [])
        if wrong:
            for name, frame in [*self.frames.items()]:
                many = len(self.frames) > MOST_CHECKED
                why = ["there are too many"] if many else _refused(self._text({name: frame}))[0]
                if why:
                    self.tell(self.places[name], f"the frame '{name}' is left out: {why[0]}", "write it by hand")
                    del self.frames[name]
            wrong, alike = _refused(self._text(self.frames)) if self.frames else ([], [])
        if wrong:
            self.tell(self.found.top.at, f"the frames are left out: {wrong[0]}", "take some of the types alone")
            self.frames.clear()
        while alike:
            for name in alike:
                frame = self.frames.pop(name)
                what = f"the frame '{name}' is read only where it is named, as no bytes tell it from another one"
                self.tell(self.places[name], what, "give it a constant, or from: with its side", warning=True)
                self.frames[name] = {"from": "none", **frame}
            alike = _refused(self._text(self.frames))[1]
        return self._text(self.frames)

    def _text(self, frames: Mapping[str, Keys]) -> str:
        layouts = self._asked_for(frames)
        shown = json.dumps([layouts, frames])
        tables = {name: one for name, one in self._tables.items() if json.dumps(name) in shown}
        words = set(_WORD.findall(shown))
        params = {name: one for name, one in self.params.items() if name in words}
        top: Keys = {"protocol": self.name}
        if self.found.title or self.found.top.doc:
            top["about"] = " – ".join(one for one in (self.found.title, self.found.top.doc) if one)
        if self.found.source:
            top["source"] = self.found.source
        top["order"] = self.order
        parts: Keys = {"params": params, "tables": tables, "layouts": layouts, "frames": dict(frames)}
        top |= {name: part for name, part in parts.items() if part}
        lines = [comment(f"Made by framekit of {Path(self.file).name}.")]
        if self.problems:
            lines.append(comment("What it does not say:"))
            lines += [comment(printable(f"  {_short(problem)}")) for problem in sorted(self.problems)]
        lines += [comment(printable(f"  {one}")) for one in self._docs]
        return "\n".join([*lines, "", *yaml_lines(top, compact=True)]) + "\n"

    def _asked_for(self, frames: Mapping[str, Keys]) -> dict[str, list[Keys]]:
        """Return the layouts that frames include, directly or indirectly, in the order of creation."""
        asked: set[str] = set()
        waiting: list[Any] = [*frames.values()]
        while waiting:
            one = waiting.pop()
            if isinstance(one, dict):
                name = one.get("include")
                if isinstance(name, str) and name in self._layouts and name not in asked:
                    asked.add(name)
                    waiting.append(self._layouts[name])
                waiting += one.values()
            elif isinstance(one, list):
                waiting += one
        return {name: one for name, one in self._layouts.items() if name in asked}


def _short(problem: Problem) -> str:
    place = f"{Path(problem.at.file).name}:{problem.at.line}:{problem.at.column}"
    return f"{place}: {problem.what}" + (f" – {problem.todo}" if problem.todo else "")


def _types(type_: KsyType) -> Iterator[KsyType]:
    yield type_
    for one in type_.types.values():
        yield from _types(one)


def _unused(name: str, taken: Mapping[str, Any], longer: str) -> str:
    """Return the name if it is free, else the longer name, with a number if necessary."""
    for one in (name, longer):
        if one not in taken:
            return one
    number = 2
    while f"{longer}_{number}" in taken:
        number += 1
    return f"{longer}_{number}"


def _refused(text: str) -> tuple[list[str], list[str]]:
    """Return the problems of a definition without positions, and the frames that are never found among the others."""
    with TemporaryDirectory() as folder, cached_by(None):
        path = Path(folder) / "made.yaml"
        path.write_text(text, "utf-8")
        try:
            protocol = load_protocol(path)
            compile_protocol(protocol)
        except DefinitionError as error:
            return [problem.what for problem in error.problems], []
        told = {problem.at for problem in check_matrices(protocol, weak_codes=False) if not problem.warning}
    frames = protocol.frames.values()
    return [], [frame.name for frame in frames if frame.at in told and frame.side != "none"]

"""Generate a Kaitai Struct file from a definition: a type per frame, and a top type with the frame as parameter.

The stream holds one whole frame, like the input of `framekit decode`. Parts that Kaitai cannot express are reported
with their position. A frame that is not readable without them becomes a type that fails, so that no wrong value is
shown.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import (
    Fill,
)
from framekit.definition.problems import CannotSayError, Problem, printable
from framekit.definition.written import comment, yaml_lines
from framekit.extras.kaitai.block import NOTHING_BEHIND, KsyBlock
from framekit.extras.kaitai.expressions import TOP_NAMES, TypeScope
from framekit.extras.kaitai.source import KsyNames, prose
from framekit.extras.kaitai.state import FRAME_KIND, UNEXPECTED, Keys, KsyFile, KsyFrame

_FAILS: Keys = {"seq": [{"id": "nothing", "size": 0, "valid": {"expr": "false"}}]}


@dataclass(frozen=True, slots=True)
class KaitaiFile:
    """A generated file."""

    name: str
    text: str
    types: Mapping[str, str]
    """The name of the type of each frame."""
    frames: tuple[str, ...]
    """The frames that can be read."""
    params: tuple[str, ...]
    """The parameters of the top type."""
    left_out: tuple[Problem, ...]
    """The parts that are left out."""


def generate_kaitai(protocol: Protocol) -> KaitaiFile:
    """Return the file of a protocol."""
    return _FileWriter(KsyFile(protocol)).write()


class _FileWriter:
    """Write the file of a protocol."""

    def __init__(self, file: KsyFile) -> None:
        self.file = file
        self.protocol, self.static = file.protocol, file.static

    def write(self) -> KaitaiFile:
        protocol = self.protocol
        self.file.tell(
            protocol.at,
            "this file has only the frames of the definition",
            "Kaitai knows no lines, time limits, repeats, sequences, services and addresses",
        )
        written: dict[str, Keys] = {}
        read: list[str] = []
        for name, frame in protocol.frames.items():
            try:
                written[self.file.types[name]] = _frame(self.file, frame)
                read.append(name)
            except CannotSayError as error:
                self.file.tell(
                    error.problem.at, f"frame '{name}' is left out: {error.problem.what}", error.problem.todo
                )
                written[self.file.types[name]] = dict(_FAILS)
        for name in read:
            self._limit(protocol.frames[name], written[self.file.types[name]])
        params = dict(self.file.expressions.params.values())
        kinds = {FRAME_KIND: dict(enumerate(self.file.types.values()))} if self.file.types else {}
        top: Keys = {
            "meta": {
                "id": self.file.name,
                "title": prose(f"{protocol.name}: {protocol.about}" if protocol.about else protocol.name),
                "ks-version": "0.11",
                "endian": "le" if protocol.order == "little" else "be",
                "bit-endian": "be",
            },
            "doc": "One whole frame; the parameter frame says which. Made by framekit from the definition.",
            "params": [
                {"id": TOP_NAMES[0], "type": "s4", **({"enum": FRAME_KIND} if self.file.types else {})},
                *({"id": name, "type": type_} for name, type_ in params.items()),
            ],
            "seq": [self._content(), {"id": TOP_NAMES[2], "size": 0, "valid": {"expr": "_io.eof"}}],
            "enums": {
                **kinds,
                **{name: _members(values) for values, name in self.file.enums.items()},
            },
            "types": {**written, UNEXPECTED: _FAILS},
        }
        lines = [comment(f"What Kaitai does not say of {protocol.name}:"), *map(_told, self.file.problems), ""]
        text = "\n".join([*lines, *yaml_lines(top)]) + "\n"
        asked = (TOP_NAMES[0], *self.file.expressions.params)
        return KaitaiFile(self.file.name, text, self.file.types, tuple(read), asked, tuple(sorted(self.file.problems)))

    def _limit(self, frame: Frame, keys: Keys) -> None:
        """Add the size limit of a frame, unless it follows from its parts, and the check that it fills its stream."""
        most = self.static.frame(frame.name).most
        texts = ["_io.eof"] if frame.name in self.file.inside else []
        if any(isinstance(one, Fill) for one in self.static.segments(frame)):
            texts.append(f"_io.size == {frame.size}")
        elif frame.most is not None and (most is None or most > frame.most):
            texts.append(f"_io.size <= {frame.most}")
        if texts and frame.name in self.file.without_end:
            self.file.tell(frame.at, f"the size of '{frame.name}' is not compared", "its end is not that of its stream")
        elif texts:
            keys.setdefault("seq", []).append({"size": 0, "valid": {"expr": " and ".join(texts)}})

    def _content(self) -> Keys:
        cases = {f"{FRAME_KIND}::{type_}": type_ for type_ in self.file.types.values()}
        return {"id": TOP_NAMES[1], "type": {"switch-on": TOP_NAMES[0], "cases": cases or {"_": UNEXPECTED}}}


def _members(values: Iterable[tuple[int, str]]) -> dict[int, Any]:
    names = KsyNames()
    found: dict[int, Any] = {}
    for number, text in values:
        name = names.new(text)
        found[number] = name if name == text else {"id": name, "doc": prose(text)}
    return found


def _told(problem: Problem) -> str:
    place = f"{Path(problem.at.file).name}:{problem.at.line}:{problem.at.column}"
    return comment(printable(f"  {place}: {problem.what} – {problem.todo}"))


def _frame(file: KsyFile, frame: Frame) -> Keys:
    """Return the type of a frame. Raises CannotSayError."""
    made = KsyFrame(file, frame)
    block = KsyBlock(made, TypeScope(), file.static.segments(frame))
    if frame.inside:
        what = f"frames that interrupt '{frame.name}' are left out"
        file.tell(frame.at, what, "Kaitai cannot pass over bytes in between")
    block.write(NOTHING_BEHIND)
    doc = {"doc": prose(frame.doc)} if frame.doc else {}
    return {**doc, **block.keys(), **({"types": made.types} if made.types else {})}

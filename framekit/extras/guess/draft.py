"""Definitions of guessed frames, with vectors: checked before they are written, and written whole.

A new name of a field makes a new definition. A name that would make it wrong is refused, and the files stay unchanged.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from framekit.api.check import check_file
from framekit.api.imports import protocol_name
from framekit.api.replaced_file import replace_whole
from framekit.api.vectors import run_vectors, vectors_path
from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.shown import explain
from framekit.definition.load.protocol import load_protocol
from framekit.definition.problems import DefinitionError
from framekit.definition.sources import cached_by
from framekit.extras.guess.model import FrameKind, Guess
from framekit.extras.guess.naming import FieldNaming, NamingError, named, overlaps
from framekit.extras.guess.writing import definition_text

MOST_VECTORS = 3
MOST_READ = 500
"""Number of frames of a kind that become vectors, and that the definition must read."""


class DraftError(ValueError):
    """The guess gives no definition, or the definition cannot be written."""


@dataclass(frozen=True, slots=True)
class Draft:
    """A definition and its vectors as texts. `problems`: its faults; `warnings`: of the check."""

    name: str
    text: str
    vectors: str
    problems: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    def put(self, path: Path) -> None:
        """Write both files, each whole or not at all; without vectors the file of vectors is removed.

        Raises OSError.
        """
        for file, text in ((path.resolve(), self.text), (vectors_path(path).resolve(), self.vectors)):
            if text:
                replace_whole(file, text.encode(), file if file.exists() else None)
            else:
                file.unlink(missing_ok=True)


def drafted(found: Guess, name: str, source: str) -> Draft:
    """Return the definition of a guess, checked as `framekit check` and `framekit test` do. Raises DraftError."""
    if not found.kinds:
        raise DraftError("no frames were found – nothing can be written")
    source = re.sub(r"[^\w .,/+-]", "_", source)
    text = definition_text(found, name, source)
    with TemporaryDirectory() as folder, cached_by(None):
        path = Path(folder) / f"{name}.yaml"
        path.write_text(text, "utf-8")
        reported = [one._replace(at=one.at._replace(file=path.name)) for one in check_file(str(path)).problems]
        problems = [str(problem) for problem in reported if not problem.warning]
        warnings = tuple(str(problem) for problem in reported if problem.warning)
        if problems:
            return Draft(name, text, "", tuple(problems), warnings)
        codec = compile_protocol(load_protocol(path))
        lines = [f"vectors: {name}", "frames:"]
        for kind in found.kinds:
            problems += _not_read(kind, codec)
            lines += _vectors_of(kind, codec, source)
        vectors = "\n".join(lines) + "\n"
        vectors_path(path).write_text(vectors, "utf-8")
        try:
            failed = [problem for case in run_vectors(path) for problem in case.problems]
            problems += [problem.removeprefix(f"{folder}/") for problem in failed]
        except DefinitionError as error:
            problems += [str(one._replace(at=one.at._replace(file=f"{name}.vectors.yaml"))) for one in error.problems]
    return Draft(name, text, vectors, tuple(problems), warnings)


def write_definition(found: Guess, path: Path, source: str) -> Draft:
    """Write `NAME.yaml` and `NAME.vectors.yaml`, also with problems. Raises OSError, DraftError, ProtocolNameError."""
    draft = drafted(found, protocol_name(path), source)
    draft.put(path)
    return draft


def _not_read(kind: FrameKind, codec: Codec) -> Iterator[str]:
    """Report the frames of a kind that the definition does not read: their number, and the first of them."""
    step = max(1, len(kind.frames) // MOST_READ)
    wrong = []
    for frame in kind.frames[::step]:
        try:
            codec.frames[kind.name].decode(frame.data, {})
        except ValueError as error:
            wrong.append(f"{frame.data[:32].hex(' ').upper()}: {explain(error)}")
    if wrong:
        of = len(kind.frames[::step])
        yield f"{kind.name} does not read {len(wrong)} of {of} frames, such as {wrong[0]}"


def _vectors_of(kind: FrameKind, codec: Codec, source: str) -> Iterator[str]:
    """Yield the first different frames of a kind whose values can be written."""
    count = 0
    for data in dict.fromkeys(one.data for one in kind.frames):
        try:
            fields = codec.frames[kind.name].decode(data, {})
        except ValueError:
            continue
        if any(isinstance(value, float) and not math.isfinite(value) for value in fields.values()):
            continue
        yield f"  - frame: {kind.name}"
        yield f"    source: {source}"
        yield f"    values: {_values(fields)}"
        yield f"    bytes: {data.hex(' ').upper()}"
        count += 1
        if count == MOST_VECTORS:
            return


def _values(fields: Mapping[str, Any]) -> str:
    """Return the values of a frame in the form of vectors."""

    def plain(value: Any) -> str:
        if isinstance(value, (bytes, bytearray)):
            return f'"{value.hex(" ").upper()}"'
        if isinstance(value, bool):
            return str(int(value))
        return json.dumps(value) if isinstance(value, str) else str(value)

    return "{" + ", ".join(f"{name}: {plain(value)}" for name, value in fields.items()) + "}"


class NamedGuess:
    """A guess with names.

    `guess` and `draft` include all names; `path` is the definition's file, None if it has none.
    """

    def __init__(self, base: Guess, name: str, source: str, path: Path | None = None) -> None:
        """Begin with a file that has been written from this guess. Raises DraftError."""
        self.path = path
        self.source = source
        self.namings: list[FieldNaming] = []
        self.guess = self._base = base
        self.draft = drafted(base, name, source)
        self._troubles = len(self.draft.problems)

    def give(self, naming: FieldNaming) -> None:
        """Name bytes of all frames of a kind; overlapping earlier names are removed. Raises NamingError."""
        self._use(
            [*(one for one in self.namings if not overlaps(one, naming) and not self._shared(one, naming)), naming]
        )

    def forget(self, kind: str, offset: int) -> None:
        """Remove the name of the bytes at an offset. Raises NamingError."""
        own = next((one for one in self.guess.kinds if one.name == kind), None)
        field = next((one for one in own.fields if one.wire and one.offset == offset), None) if own else None
        if field is None:
            raise NamingError("these bytes have no name")
        named_so = (field.offset, field.size, field.name)
        self._use(
            [
                one
                for one in self.namings
                if (one.offset, one.size, one.name) != named_so or (one.kind != kind and field.kind != "copy")
            ]
        )

    def _shared(self, one: FieldNaming, new: FieldNaming) -> bool:
        """Return whether an earlier name, given to the other side, is for the same bytes: a reply repeats its
        request.
        """
        own = next((kind for kind in self.guess.kinds if kind.name == new.kind), None)
        return own is not None and any(
            (field.name, field.offset, field.size)
            == (one.name, one.offset, one.size)
            == (one.name, new.offset, new.size)
            and field.kind == "copy"
            for field in own.fields
        )

    def _use(self, namings: list[FieldNaming]) -> None:
        guess = named(self._base, namings)
        draft = drafted(guess, self.draft.name, self.source)
        if len(draft.problems) > self._troubles:
            raise NamingError(draft.problems[0])
        if self.path is not None and not draft.problems:
            self._put(self.path, draft)
        self.namings, self.guess, self.draft = namings, guess, draft

    def _put(self, path: Path, draft: Draft) -> None:
        try:
            if path.read_text("utf-8") != self.draft.text:
                raise NamingError(f"{path.name} has been changed since it was written – keep that, and start again")
            draft.put(path)
        except FileNotFoundError:
            raise NamingError(f"{path.name} is gone – start again") from None
        except (OSError, UnicodeDecodeError) as error:
            raise NamingError(f"{path.name} cannot be written: {error}") from None

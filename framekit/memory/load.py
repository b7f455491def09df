"""Reads memory profiles from `NAME.memory.yaml`, beside the file that names them or among the shipped ones.

Problems are collected and raised together. What an address means is not known here.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from framekit.definition.check.addresses import check_forms
from framekit.definition.load.documents import Documents, merged
from framekit.definition.load.profile_files import find_profile
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Mapping, Scalar
from framekit.definition.problems import NOWHERE, DefinitionError, Position
from framekit.memory.profile import MemoryProfile
from framekit.memory.profile_loader import ProfileLoader

SUFFIX = ".memory.yaml"


def load_profile(name_or_path: str | Path, folder: Path | None = None, at: Position = NOWHERE) -> MemoryProfile:
    """The profile in a file (a Path), or of a name: `NAME.memory.yaml` in `folder`, else a shipped one.

    `at` is where the name was written. Raises DefinitionError with everything that is wrong.
    """
    path = name_or_path if isinstance(name_or_path, Path) else _find(name_or_path, folder, at)
    reader = Reader()
    documents = Documents(reader)
    with suppress(Broken):
        return _profile(documents.root(path, "memory"), documents, path)
    raise DefinitionError(reader.problems)


def load_profile_node(node: Mapping, folder: Path | None = None) -> MemoryProfile:
    """A profile written in place, `{areas: …}`, on top of the one named by its key `profile`, if it has that.

    Sections are joined by name, in areas single keys are replaced. Keys no profile has are not looked at: whoever reads
    the file around checks them. Raises DefinitionError.
    """
    base = node.get("profile")
    reader = Reader()
    documents = Documents(reader)
    with suppress(Broken):
        if base is None:
            return _profile(node, documents)
        name = base.text if isinstance(base, Scalar) else ""
        return _profile(merged(documents.root(_find(name, folder, base.at), "memory"), node), documents)
    raise DefinitionError(reader.problems)


def _profile(root: Mapping, documents: Documents, file: Path | None = None) -> MemoryProfile:
    """The profile in nodes. Raises Broken when it is not even nearly one, DefinitionError with all its problems."""
    reader = documents.reader
    profile = ProfileLoader(reader, root).profile()
    if not reader.problems:
        reader.problems.extend(check_forms(profile.addresses, profile.areas, profile.tables))
    problems = documents.first_words(reader.problems, file)
    if any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return profile


def _find(name: str, folder: Path | None, at: Position) -> Path:
    return find_profile(name, folder, at, kind="memory profile", suffix=SUFFIX)

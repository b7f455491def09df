"""Where profiles are found: beside the file that names them, else among the shipped ones.

What stands in a profile is not known here.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean
from framekit.definition.shipped import shipped_folder


def find_profile(name: str, folder: Path | None, at: Position, *, kind: str, suffix: str) -> Path:
    """The file `NAME` or `NAME` + `suffix` in `folder`, else the shipped one; `kind` is what messages call it.

    Raises DefinitionError when there is none, and for names that leave the folder.
    """
    if not name or name.startswith(("/", "~")) or "\\" in name or ".." in PurePosixPath(name).parts:
        what = f"'{name}' leaves the folder of the file that names it"
        raise DefinitionError([Problem(at, what, "name a profile beside it or a shipped one")])
    places = [place for place in (folder, shipped_folder("frames")) if place is not None]
    for place in places:
        for candidate in (place / name, place / f"{name}{suffix}"):
            if candidate.is_file() and candidate.resolve().is_relative_to(place.resolve()):
                return candidate
    known = {path.name.removesuffix(suffix) for place in places for path in place.glob(f"*{suffix}")}
    todo = did_you_mean(name, known) or f"write {name}{suffix}"
    raise DefinitionError([Problem(at, f"there is no {kind} '{name}'", todo)])

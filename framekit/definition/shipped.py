"""Where definitions stand: those that come with framekit, installed or in a working copy, and those beside others.

What is in the files is not known here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal


def shipped_folder(name: Literal["frames", "schemas"]) -> Path:
    """The folder of shipped definitions or schemas: inside the installed package, else beside the package."""
    package = Path(__file__).parent.parent
    installed = package / "_shipped" / name
    return installed if installed.is_dir() else package.parent / name


def find_definition(name: str, folder: Path) -> Path | None:
    """The file of a definition: `folder/NAME`, `folder/NAME.yaml`, or a shipped one; None if there is none."""
    for place in (folder, shipped_folder("frames")):
        for candidate in (place / name, place / f"{name}.yaml"):
            if candidate.is_file() and candidate.resolve().is_relative_to(place.resolve()):
                return candidate
    return None


def definition_file(name: str | Path, folder: Path) -> Path | None:
    """The file that a name or a path means, seen from `folder`; None if there is none."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.is_file():
        return path if path.is_file() else None
    return find_definition(str(name), folder)

"""What definitions are read from: where their files stand, whether these are as before, and the cache of them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from decimal import Decimal
from enum import Enum
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path, PurePosixPath
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Literal, NamedTuple
from typing import Protocol as Interface

from framekit.definition import PATH_VARIABLE
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean

if TYPE_CHECKING:
    from framekit.definition.model.protocol import Protocol


def shipped_folder(name: Literal["frames", "schemas"]) -> Path:
    """The folder of shipped definitions or schemas: inside the installed package, else beside the package."""
    package = Path(__file__).parent.parent
    installed = package / "_shipped" / name
    return installed if installed.is_dir() else package.parent / name


def shipped_definitions(pattern: str = "*.yaml") -> list[Path]:
    """The shipped files of this pattern, by name."""
    folders = _with_families(shipped_folder("frames"))
    return sorted((path for folder in folders for path in folder.glob(pattern)), key=lambda path: path.name)


def known_definitions() -> list[Path]:
    """The definitions of every folder that is searched, by name; of two with one name the one that is found first."""
    found: dict[str, Path] = {}
    for folder in searched_folders():
        for path in folder.glob("*.yaml"):
            found.setdefault(path.stem, path)
    return [found[name] for name in sorted(found)]


PACKAGES = "framekit.protocols"
"""The group of entry points by which installed packages bring definitions: each names a package, which holds them."""


def roots() -> Iterator[Path]:
    """The folders of FRAMEKIT_PATH, that of shipped definitions, and those of installed packages, in this order."""
    yield from _path(os.environ.get(PATH_VARIABLE, ""))
    yield shipped_folder("frames")
    yield from _packages()


@cache
def _path(text: str) -> tuple[Path, ...]:
    return tuple(Path(os.path.expanduser(folder)).absolute() for folder in text.split(os.pathsep) if folder)


@cache
def _packages() -> tuple[Path, ...]:
    """The folders of the packages, by the names of their entry points. None of them is imported."""
    from importlib.metadata import entry_points
    from importlib.util import find_spec

    found: list[Path] = []
    for point in sorted(entry_points(group=PACKAGES), key=lambda point: point.name):
        with suppress(ImportError, ValueError, AttributeError):  # the last one: the entry point names nothing
            package, *inside = point.module.split(".")
            spec = find_spec(package)
            places = () if spec is None else spec.submodule_search_locations or ()
            found += [Path(place, *inside, *(point.attr or "").split(".")) for place in places]
    return tuple(found)


def searched_folders() -> Iterator[Path]:
    """Every folder in which a name is looked for: the roots, and the folders in them, one for each family."""
    for root in roots():
        yield from _with_families(root)


def _with_families(root: Path) -> tuple[Path, ...]:
    try:
        return _families(root, root.stat().st_mtime_ns)
    except OSError:
        return ()


@lru_cache(64)
def _families(root: Path, changed: int) -> tuple[Path, ...]:
    return (*sorted(path for path in root.iterdir() if path.is_dir()), root)


def root_of(path: Path) -> Path | None:
    """The root that a file lies in, so that it may name others of it by `../`; None if it lies in none."""
    path = path.resolve()
    return next((root for root in roots() if path.is_relative_to(root.resolve())), None)


def find_definition(name: str, folder: Path) -> Path | None:
    """The file of a definition: `folder/NAME`, `folder/NAME.yaml`, or one in a folder that is searched; None if there
    is none. A name with `../` is looked for beside `folder` only, inside the root that it lies in."""
    if ".." not in PurePosixPath(name).parts:
        return _first_file(name, (folder, *searched_folders()), ".yaml")
    root = root_of(folder)
    return (
        None
        if root is None
        else _first_file(os.path.relpath(folder.resolve() / name, root.resolve()), (root,), ".yaml")
    )


def _first_file(name: str, places: Iterable[Path], suffix: str) -> Path | None:
    """The first file `NAME` or `NAME` + `suffix` inside one of the folders."""
    for place in places:
        for candidate in (place / name, place / f"{name}{suffix}"):
            if os.path.isfile(candidate) and candidate.resolve().is_relative_to(place.resolve()):
                return candidate
    return None


def definition_file(name: str | Path, folder: Path) -> Path | None:
    """The file that a name or a path means, seen from `folder`; None if there is none."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or os.path.isfile(path):
        return path if os.path.isfile(path) else None
    return find_definition(str(name), folder)


class Sources(NamedTuple):
    """Every file that was read, with a hash of what it held; every name in them, seen from its folder, with the file
    it meant. Plain texts, so that they can be kept."""

    files: tuple[tuple[str, str], ...]
    found: tuple[tuple[str, str, str], ...]

    def still_hold(self) -> bool:
        """Whether every file has the content it had, and every name still means the same file."""
        return all(_digest(Path(path)) == before for path, before in self.files) and all(
            str(find_definition(name, Path(folder))) == path for name, folder, path in self.found
        )


def sources_of(files: Iterable[Path], found: Iterable[tuple[str, Path, Path]]) -> Sources:
    """The sources as they are now."""
    return Sources(
        tuple((str(path), _digest(path)) for path in files),
        tuple((name, str(folder), str(path)) for name, folder, path in found),
    )


def _digest(path: Path) -> str:
    """The hash of a file's content; '' for one that cannot be read."""
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


class Cache(Interface):
    """Keeps definitions by the file they are loaded from, and their code."""

    def loaded(self, path: Path) -> tuple[Protocol, Sources] | None:
        """What loading the file would give now, and what it was read from; None: it has to be loaded."""

    def was_loaded(self, path: Path, protocol: Protocol, sources: Sources) -> None:
        """Told of everything that had to be loaded."""

    def module(self, protocol: Protocol) -> ModuleType:
        """The module of a definition's frames. Raises DefinitionError."""

    def code(self, protocol: Protocol, what: str, make: Callable[[], CodeType]) -> CodeType:
        """Other code made of a definition, called `what`: kept from before, or made now."""


_current: Cache | None = None


def current_cache() -> Cache | None:
    """What loading and compiling ask first."""
    return _current


@contextmanager
def cached_by(cache: Cache | None) -> Iterator[None]:
    """What is loaded and compiled inside is kept by this one."""
    global _current
    before, _current = _current, cache
    try:
        yield
    finally:
        _current = before


def fingerprint(value: object) -> str:
    """A short text for a model value (dataclasses, mappings, sequences, plain values); positions do not count.

    Raises TypeError for anything else inside.
    """
    digest = hashlib.sha256()
    for piece in _pieces(value):
        digest.update(piece.encode())
    return digest.hexdigest()[:32]


def _pieces(value: object) -> Iterator[str]:
    """The content as texts, none of which can be mistaken for another."""
    if isinstance(value, (Position, Problem)):
        return
    if is_dataclass(value) and not isinstance(value, type):
        yield f"{type(value).__name__}("
        for field in fields(value):
            yield f"{field.name}="
            yield from _pieces(getattr(value, field.name))
        yield ")"
    elif value is None or isinstance(value, (str, bytes, int, float, Decimal, Enum)):
        yield f"{value!r},"
    elif isinstance(value, Mapping):
        yield "{"
        for key, item in value.items():
            yield f"{key!r}:"
            yield from _pieces(item)
        yield "}"
    elif isinstance(value, (tuple, list, frozenset, set)):
        yield "["
        for item in sorted(value, key=repr) if isinstance(value, (frozenset, set)) else value:
            yield from _pieces(item)
        yield "]"
    else:
        raise TypeError(f"a {type(value).__name__} has no fingerprint")


def find_profile(name: str, folder: Path | None, at: Position, *, kind: str, suffix: str) -> Path:
    """The file `NAME` or `NAME` + `suffix` in `folder`, else the shipped one; `kind` is what messages call it.

    Raises DefinitionError when there is none, and for names that leave the folder.
    """
    if not name or name.startswith(("/", "~")) or "\\" in name or ".." in PurePosixPath(name).parts:
        what = f"'{name}' leaves the folder of the file that names it"
        raise DefinitionError([Problem(at, what, "name a profile beside it or a shipped one")])
    places = [place for place in (folder, *searched_folders()) if place is not None]
    found = _first_file(name, places, suffix)
    if found is not None:
        return found
    known = {path.name.removesuffix(suffix) for place in places for path in place.glob(f"*{suffix}")}
    todo = did_you_mean(name, known) or f"write {name}{suffix}"
    raise DefinitionError([Problem(at, f"there is no {kind} '{name}'", todo)])

"""Find definition files, detect changes of their content, and hold the current cache of definitions."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path, PurePosixPath
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Literal, NamedTuple
from typing import Protocol as Interface

from framekit.definition import PATH_VARIABLE, ROOT_VARIABLE
from framekit.definition.installed import entry_points_of
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean

if TYPE_CHECKING:
    from framekit.definition.model.protocol import Protocol


def shipped_folder(name: Literal["frames", "schemas", "demo"]) -> Path:
    """Return the folder of shipped definitions, schemas, or files of the demonstration.

    It is in the installed package; of a checkout next to the package.
    """
    package = Path(__file__).parent.parent
    installed = package / "_shipped" / name
    if installed.is_dir():
        return installed
    return package.parent / ("examples/demo" if name == "demo" else name)


def shipped_definitions(pattern: str = "*.yaml") -> list[Path]:
    """Return the shipped files of this pattern, by name."""
    folders = _with_families(shipped_folder("frames"))
    return sorted((path for folder in folders for path in folder.glob(pattern)), key=lambda path: path.name)


def known_definitions() -> list[Path]:
    """Return the definitions of all searched folders, by name; of two with the same name the first."""
    found: dict[str, Path] = {}
    for folder in searched_folders():
        for path in folder.glob("*.yaml"):
            found.setdefault(path.stem, path)
    return [found[name] for name in sorted(found)]


PACKAGES = "framekit.protocols"
"""The group of entry points of packages with definitions: each names a package, which contains the files."""


def roots() -> Iterator[Path]:
    """Yield the folders of FRAMEKIT_PATH, of the shipped definitions, and of installed packages, in this order."""
    yield from _path(os.environ.get(PATH_VARIABLE, ""))
    yield shipped_folder("frames")
    yield from _packages()


@cache
def _path(text: str) -> tuple[Path, ...]:
    return tuple(Path(os.path.expanduser(folder)).absolute() for folder in text.split(os.pathsep) if folder)


@cache
def _packages() -> tuple[Path, ...]:
    """Return the folders of the packages, by the names of their entry points. No package is imported."""
    from importlib.util import find_spec

    found: list[Path] = []
    for point in sorted(entry_points_of(PACKAGES), key=lambda point: point.name):
        with suppress(ImportError, ValueError, AttributeError):  # AttributeError: its value names no module
            package, *inside = point.module.split(".")
            spec = find_spec(package)
            places = () if spec is None else spec.submodule_search_locations or ()
            found += [Path(place, *inside, *(point.attr or "").split(".")) for place in places]
    return tuple(found)


def searched_folders() -> Iterator[Path]:
    """Yield every folder in which a name is looked up: the roots, and the folders in them, one for each family."""
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


PROJECT_MARKS = ("pyproject.toml", ".git", "framekit.yaml")
"""The root of a project is the nearest folder above a file that holds a file or folder of one of these names."""


def root_of(path: Path) -> Path | None:
    """Return the root that contains a file, within which the file may name others by `../`, or None.

    A root is a folder with definitions (`roots`), the folder of FRAMEKIT_ROOT, or the root of a project.
    """
    path = path.resolve()
    named = os.environ.get(ROOT_VARIABLE, "")
    known = (*roots(), *((Path(os.path.expanduser(named)),) if named else ()))
    found = next((root for root in known if path.is_relative_to(root.resolve())), None)
    return found or next((above for above in (path, *path.parents) if _is_project(above)), None)


def _is_project(folder: Path) -> bool:
    return any(os.path.exists(folder / mark) for mark in PROJECT_MARKS)


def leaves_folder(name: str, folder: Path) -> bool:
    """Return whether a file named in a file of `folder` is neither in it, nor below it, nor in the same root."""
    if name.startswith(("/", "~")) or "\\" in name:
        return True
    if ".." not in PurePosixPath(name).parts:
        return False
    root = root_of(folder)
    return root is None or not (folder / name).resolve().is_relative_to(root.resolve())


INSIDE = (
    "name a file beside it, a shipped one, or by ../ one of its project "
    "(the folder with pyproject.toml, .git or framekit.yaml, or --root)"
)
"""The remedy for a name that leaves its folder."""


def find_definition(name: str, folder: Path) -> Path | None:
    """Return the file of a definition: `folder/NAME`, `folder/NAME.yaml`, or a file in a searched folder; or None.

    A name with `../` is looked up relative to `folder` only, inside the root that contains it.
    """
    if ".." not in PurePosixPath(name).parts:
        return _first_file(name, (folder, *searched_folders()), ".yaml")
    return _found_upwards(name, folder, ".yaml")


def _found_upwards(name: str, folder: Path, suffix: str) -> Path | None:
    """Return the file of a name with `../`, inside the root of `folder`; None if there is none."""
    root = root_of(folder) if ".." in PurePosixPath(name).parts else None
    return root and _first_file(os.path.relpath(folder.resolve() / name, root.resolve()), (root,), suffix)


def _first_file(name: str, places: Iterable[Path], suffix: str) -> Path | None:
    """Return the first file `NAME` or `NAME` + `suffix` in one of the folders."""
    for place in places:
        for candidate in (place / name, place / f"{name}{suffix}"):
            if os.path.isfile(candidate) and candidate.resolve().is_relative_to(place.resolve()):
                return candidate
    return None


def definition_file(name: str | Path, folder: Path) -> Path | None:
    """Return the file of a name or a path, relative to `folder`; None if it does not exist."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or os.path.isfile(path):
        return path if os.path.isfile(path) else None
    return find_definition(str(name), folder)


class Sources(NamedTuple):
    """Every file that was read, with a hash of its content; every name in them, seen from its folder, with its file.

    Plain texts, so that the cache can keep them.
    """

    files: tuple[tuple[str, str], ...]
    found: tuple[tuple[str, str, str], ...]

    def still_hold(self) -> bool:
        """Return whether every file has the same content, and every name still means the same file."""
        return all(_digest(Path(path)) == before for path, before in self.files) and all(
            str(find_definition(name, Path(folder))) == path for name, folder, path in self.found
        )


def sources_of(files: Iterable[Path], found: Iterable[tuple[str, Path, Path]]) -> Sources:
    """Return the sources with their present content."""
    return Sources(
        tuple((str(path), _digest(path)) for path in files),
        tuple((name, str(folder), str(path)) for name, folder, path in found),
    )


_edited: ContextVar[Mapping[Path, str]] = ContextVar("_edited")
"""The texts of `edited_texts`, by their resolved paths."""


@contextmanager
def edited_texts(texts: Mapping[Path, str]) -> Iterator[None]:
    """Read these texts in place of the content of their files inside the context, in addition to outer contexts.

    The files must exist. Positions, and the search for files that a text names, are those of the real files.
    """
    token = _edited.set({**_edited.get({}), **{path.resolve(): text for path, text in texts.items()}})
    try:
        yield
    finally:
        _edited.reset(token)


def edited_text(path: Path) -> str | None:
    """Return the text that replaces the content of a file, or None."""
    texts = _edited.get({})
    return texts.get(path.resolve()) if texts else None


def _digest(path: Path) -> str:
    """Return the hash of a file's content, or of the text that replaces it; '' for a file that cannot be read."""
    text = edited_text(path)
    try:
        return sha256(path.read_bytes() if text is None else text.encode("utf-8", "surrogatepass")).hexdigest()
    except OSError:
        return ""


class Cache(Interface):
    """A cache of definitions by file, and of their code."""

    def loaded(self, path: Path) -> tuple[Protocol, Sources] | None:
        """Return the definition that the file gives now, and its sources; None if it has to be loaded."""

    def was_loaded(self, path: Path, protocol: Protocol, sources: Sources) -> None:
        """Store a definition that had to be loaded."""

    def module(self, protocol: Protocol) -> ModuleType:
        """Return the module of a definition's frames. Raises DefinitionError."""

    def code(self, protocol: Protocol, what: str, make: Callable[[], CodeType]) -> CodeType:
        """Return other code of a definition, called `what`: from the cache, or made now."""


_current: Cache | None = None


def current_cache() -> Cache | None:
    """Return the cache that loading and compiling use."""
    return _current


@contextmanager
def cached_by(cache: Cache | None) -> Iterator[None]:
    """Use a cache for everything that is loaded and compiled inside the context."""
    global _current
    before, _current = _current, cache
    try:
        yield
    finally:
        _current = before


def find_profile(name: str, folder: Path | None, at: Position, *, kind: str, suffix: str) -> Path:
    """Return the file `NAME` or `NAME` + `suffix` in `folder`, else the shipped file; `kind` is its name in messages.

    Raises DefinitionError if neither exists, and for names that leave the folder.
    """
    if not name or leaves_folder(name, Path() if folder is None else folder):
        raise DefinitionError([Problem(at, f"'{name}' leaves the folder of the file that names it", INSIDE)])
    places = [place for place in (folder, *searched_folders()) if place is not None]
    found = _found_upwards(name, folder, suffix) if folder is not None else None
    found = found or _first_file(name, places, suffix)
    if found is not None:
        return found
    known = {path.name.removesuffix(suffix) for place in places for path in place.glob(f"*{suffix}")}
    todo = did_you_mean(name, known) or f"write {name}{suffix}"
    raise DefinitionError([Problem(at, f"there is no {kind} '{name}'", todo)])

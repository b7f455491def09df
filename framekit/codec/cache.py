"""Compiled protocols kept from one command to the next, in the user's cache folder.

A kept one counts only for this version of framekit and Python and this very code of theirs, while every source file has
the content it had, and every name in them still means the same file. The model of the protocol is read only when
it is needed: a command that decodes a frame needs the functions and what `FrameNote` says.
"""

from __future__ import annotations

import hashlib
import marshal
import os
import stat
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING, Any, NamedTuple

from framekit import __version__
from framekit.codec.functions import FrameFunctions, module_of
from framekit.definition.brought import import_installed, states
from framekit.definition.sources import Sources, definition_file, shipped_folder

if TYPE_CHECKING:
    from types import ModuleType

    from framekit.definition.model.protocol import Protocol


MOST_BYTES = 268_435_456
"""So much do the files hold together, then the oldest go; the newest one stays whatever it holds."""

SUFFIX = ".framekit"
"""How files of the cache end: no others are ever removed, whatever folder is named."""

_AS_IT_IS = sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"))
"""A file is opened itself, no link to another one, without waiting, and byte by byte; where systems know of that."""


def cache_folder() -> Path | None:
    """The folder for framekit's files, made if need be; None where there is none that this user alone can write.

    `FRAMEKIT_CACHE` names another one; with an empty name nothing is kept.
    """
    given = os.environ.get("FRAMEKIT_CACHE")
    if given == "":
        return None
    try:
        folder = Path(given) if given is not None else _user_cache() / "framekit"
        if not folder.is_absolute():
            return None
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700, parents=True)
        return folder if _is_own(os.lstat(folder), stat.S_ISDIR) and _is_private(folder) else None
    except (OSError, RuntimeError):  # RuntimeError: no home folder
        return None


def _user_cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(home):
        return Path(home)
    if sys.platform not in ("darwin", "win32"):
        return Path.home() / ".cache"
    from platformdirs import user_cache_path  # which takes 5 ms to import

    return user_cache_path()


def _is_own(found: os.stat_result, kind: object) -> bool:
    """Whether it is of that kind (`stat.S_ISDIR`, …), this user's, and closed to all others.

    Windows tells no owner here: there `_is_private` is what counts.
    """
    if not (callable(kind) and kind(found.st_mode)):
        return False
    return sys.platform == "win32" or (found.st_uid == os.geteuid() and not found.st_mode & 0o077)


def _is_private(folder: Path) -> bool:
    """Whether the place of a folder keeps others out: on Windows the user's profile does, elsewhere no place has to."""
    return sys.platform != "win32" or folder.resolve().is_relative_to(Path.home().resolve())


def read_entry(folder: Path, name: str) -> bytes | None:
    """The content of a file; None if there is none that can be read, or one that another user may have written."""
    try:
        descriptor = os.open(folder / (name + SUFFIX), os.O_RDONLY | _AS_IT_IS)
        try:
            if not _is_own(os.fstat(descriptor), stat.S_ISREG):
                return None
            with open(descriptor, "rb", closefd=False) as file:
                return file.read()
        finally:
            os.close(descriptor)
    except OSError:
        return None


def keep(folder: Path, name: str, data: bytes) -> None:
    """Writes a file, whole or not at all; a cache that cannot be written is none."""
    temporary = folder / f"{name}.{os.getpid()}.new{SUFFIX}"
    with suppress(OSError):
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _AS_IT_IS, 0o600)
        try:
            with open(descriptor, "wb") as file:
                file.write(data)
            temporary.replace(folder / (name + SUFFIX))
        except OSError:
            temporary.unlink(missing_ok=True)
            raise
        _drop_oldest(folder)


def _drop_oldest(folder: Path) -> None:
    found = sorted(((file.lstat(), file) for file in folder.glob(f"*{SUFFIX}")), key=lambda each: -each[0].st_mtime_ns)
    size = 0
    for number, (state, file) in enumerate(found):
        size += state.st_size
        if number and size > MOST_BYTES:
            file.unlink(missing_ok=True)


class FrameNote(NamedTuple):
    """What of a frame's definition tells when it is tried on bytes."""

    name: str
    inner: bool
    side: str
    refuse: int | None
    names: Mapping[str, Mapping[int, str]]
    """The names of numbers, by field."""


class CacheEntry(NamedTuple):
    """What is kept of a protocol; the model pickled, since it is not always needed."""

    sources: tuple[Any, ...]
    name: str
    code: CodeType
    frames: list[tuple[Any, ...]]
    warned: bool
    pickled: bytes


class CachedCodec(FrameFunctions):
    """The functions of a protocol's frames; `catalogue`: its frames; `warned`: its definition has warnings."""

    def __init__(self, kept: CacheEntry, again: Callable[[], CacheEntry]) -> None:
        super().__init__(module_of(kept.name, kept.code))
        self.catalogue: Mapping[str, FrameNote] = {note[0]: FrameNote(*note) for note in kept.frames}
        self.warned = kept.warned
        self._kept = kept
        self._again = again

    @cached_property
    def protocol(self) -> Protocol:
        """The definition, made `again` if what was kept of it is damaged.

        `compile_protocol` of it takes the code that is there.
        """
        from framekit.codec.codec import codec_from

        protocol = _model(self._kept)
        if protocol is None:
            self._kept = self._again()
            protocol = _model(self._kept)
            assert protocol is not None  # it was made just now
        codec_from(protocol, self._kept.code)
        return protocol


def cached_codec(name: str | Path, folder: Path) -> CachedCodec:
    """The codec of a protocol by name or file, seen from `folder`: kept from before, or made now and kept.

    Raises DefinitionError.
    """
    cache, path = cache_folder(), definition_file(name, folder)

    def made() -> CacheEntry:
        kept = _made(name, folder)
        if files is not None and path is not None:
            files.write(path, kept)
        return kept

    files = None if cache is None else CacheFolder(cache)
    kept = None if files is None or path is None else files.read(path)
    if kept is not None:
        with suppress(ImportError):  # a library that it was compiled for is no longer there
            return CachedCodec(kept, made)
    return CachedCodec(made(), made)


def _made(name: str | Path, folder: Path) -> CacheEntry:
    from framekit.codec.codec import code_of
    from framekit.definition.load.protocol import load_with_files

    loaded = load_with_files(name, folder)
    return _parts(loaded.protocol, loaded.sources, code_of(loaded.protocol))


def _parts(protocol: Protocol, sources: Sources, code: CodeType) -> CacheEntry:
    import pickle

    from framekit.codec.plain import names_of

    notes = [
        (frame.name, frame.inner, frame.side, frame.refuse, names_of(protocol, frame.name))
        for frame in protocol.frames.values()
    ]
    return CacheEntry(tuple(sources), protocol.name, code, notes, bool(protocol.warnings), pickle.dumps(protocol))


def _model(kept: CacheEntry) -> Protocol | None:
    """The model; None where it is damaged."""
    import gc
    import pickle

    from framekit.definition.model.protocol import Protocol

    collects = gc.isenabled()
    gc.disable()  # tens of thousands of objects come, and none goes
    try:
        protocol = pickle.loads(kept.pickled)
    except Exception:  # what is damaged may raise anything
        return None
    finally:
        if collects:
            gc.enable()
    return protocol if isinstance(protocol, Protocol) else None


class CacheFolder:
    """Compiled protocols in a folder, by the files of their definitions."""

    def __init__(self, cache: Path) -> None:
        self.cache = cache
        self._stamp = _stamp()

    def _key(self, path: Path) -> str:
        broken = import_installed()  # before the states are asked for: what they bring has a part in every definition
        return hashlib.sha256(f"{path}\n{path.resolve()}\n{self._stamp}\n{broken}{states()}".encode()).hexdigest()

    def read(self, path: Path) -> CacheEntry | None:
        """What was kept, if it is whole and still right."""
        content = self._content(self._key(path))
        if content is None:
            return None
        try:
            kept = CacheEntry(*marshal.loads(content))
            return kept if Sources(*kept.sources).still_hold() else None
        except (EOFError, ValueError, TypeError, AttributeError, LookupError):  # nothing of ours: it is made again
            return None

    def write(self, path: Path, kept: CacheEntry) -> None:
        self._write(self._key(path), tuple(kept))

    def read_code(self, path: Path, sources: Sources, what: str) -> CodeType | None:
        """Other code that was made of a definition read from these very sources."""
        content = self._content(self._key_of_code(path, sources, what))
        if content is None:
            return None
        try:
            code = marshal.loads(content)
        except (EOFError, ValueError, TypeError):  # nothing of ours: it is made again
            return None
        return code if isinstance(code, CodeType) else None

    def write_code(self, path: Path, sources: Sources, what: str, code: CodeType) -> None:
        self._write(self._key_of_code(path, sources, what), code)

    def _content(self, key: str) -> bytes | None:
        """What was kept under a key, if it is whole."""
        data = read_entry(self.cache, key) or b""
        digest, content = data[:32], data[32:]
        if hashlib.sha256(content).digest() != digest or not content.startswith(key.encode()):
            return None
        return content[len(key) :]

    def _write(self, key: str, value: Any) -> None:
        """Keeps it with its own key: under another name it counts for nothing."""
        content = key.encode() + marshal.dumps(value)
        keep(self.cache, key, hashlib.sha256(content).digest() + content)

    def _key_of_code(self, path: Path, sources: Sources, what: str) -> str:
        return hashlib.sha256(f"{self._key(path)}\n{what}\n{tuple(sources)!r}".encode()).hexdigest()


class DefinitionCache:
    """Gives loaders and compilers what a folder has, and puts there what they have made (see `sources.Cache`)."""

    def __init__(self, files: CacheFolder) -> None:
        self.files = files
        self._codes: dict[int, CodeType] = {}
        self._known: dict[int, tuple[Path, Protocol, Sources]] = {}

    def loaded(self, path: Path) -> tuple[Protocol, Sources] | None:
        kept = self.files.read(path)
        protocol = None if kept is None else _model(kept)
        if kept is None or protocol is None:
            return None
        sources = Sources(*kept.sources)
        self._codes[id(protocol)] = kept.code
        self.was_loaded(path, protocol, sources)
        return protocol, sources

    def was_loaded(self, path: Path, protocol: Protocol, sources: Sources) -> None:
        self._known[id(protocol)] = path, protocol, sources

    def module(self, protocol: Protocol) -> ModuleType:
        from framekit.codec.codec import code_of

        if id(protocol) in self._codes:
            with suppress(ImportError):
                return module_of(protocol.name, self._codes[id(protocol)])
        code = code_of(protocol)
        if id(protocol) in self._known:
            path, _, sources = self._known[id(protocol)]
            self.files.write(path, _parts(protocol, sources, code))
        return module_of(protocol.name, code)

    def code(self, protocol: Protocol, what: str, make: Callable[[], CodeType]) -> CodeType:
        if id(protocol) not in self._known:
            return make()
        path, _, sources = self._known[id(protocol)]
        found = self.files.read_code(path, sources, what)
        if found is None:
            found = make()
            self.files.write_code(path, sources, what, found)
        return found


def definition_cache() -> DefinitionCache | None:
    """Keeps definitions and their code in the user's cache folder; None where there is none to trust."""
    cache = cache_folder()
    return None if cache is None else DefinitionCache(CacheFolder(cache))


def _stamp() -> str:
    """What compiles definitions: the versions, and size and time of every file of framekit that has a part in it."""
    package = Path(__file__).parent.parent
    found = [__version__, sys.version, str(sys.implementation.cache_tag)]
    for folder in (package / "definition", package / "codec", package / "link", shipped_folder("schemas")):
        for root, _, files in os.walk(folder):
            for name in files:
                if name.endswith((".py", ".json")):
                    state = os.stat(os.path.join(root, name))
                    found.append(f"{root}/{name} {state.st_size} {state.st_mtime_ns}")
    return "\n".join(sorted(found))

"""Cache compiled protocols in a folder of the user, for later commands.

An entry is valid only for the same version and code of framekit and Python, while every source file has the same
content and every name in it refers to the same file. The model of a protocol is unpickled on demand: decoding a frame
needs only the functions and a `FrameNote`.
"""

from __future__ import annotations

import hashlib
import marshal
import os
import stat
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cached_property, lru_cache
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
"""Limit of the total size of all files, in bytes; beyond it the oldest files are removed, but never the newest."""

SUFFIX = ".framekit"
"""The suffix of the cache's files; files with other suffixes are never removed."""

_AS_IT_IS = sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"))
"""Flags to open a file itself, not the target of a link, without waiting, in binary; as far as the system has them."""


def cache_folder() -> Path | None:
    """Return the folder for framekit's files, created if necessary; None if no folder is writable by this user alone.

    `FRAMEKIT_CACHE` names another folder; empty, it turns the cache off.
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
    """Return whether a file has the kind (`stat.S_ISDIR`, …), belongs to this user, and is closed to all others.

    Windows reports no owner: `_is_private` decides instead.
    """
    if not (callable(kind) and kind(found.st_mode)):
        return False
    return sys.platform == "win32" or (found.st_uid == os.geteuid() and not found.st_mode & 0o077)


def _is_private(folder: Path) -> bool:
    """Return whether a folder is in the user's profile on Windows; on other systems its mode is enough."""
    return sys.platform != "win32" or folder.resolve().is_relative_to(Path.home().resolve())


def read_entry(folder: Path, name: str) -> bytes | None:
    """Return the content of a file; None if it is not readable, or another user may have written it."""
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
    """Write a file, whole or not at all; errors are ignored, as for a cache that does not exist."""
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
    """The facts of a frame's definition that trying it on bytes needs."""

    name: str
    inner: bool
    side: str
    refuse: int | None
    names: Mapping[str, Mapping[int, str]]
    """The names of numbers, by field."""
    shows: bool
    """Whether displays read bytes of the frame as layouts."""


class CacheEntry(NamedTuple):
    """A cached protocol; the model is pickled, because most commands do not need it."""

    sources: tuple[Any, ...]
    name: str
    code: CodeType
    frames: list[tuple[Any, ...]]
    warned: bool
    pickled: bytes


class CachedCodec(FrameFunctions):
    """The functions of a protocol's frames, from a cache entry."""

    def __init__(self, kept: CacheEntry, again: Callable[[], CacheEntry]) -> None:
        super().__init__(module_of(kept.name, kept.code))
        self.catalogue: Mapping[str, FrameNote] = {note[0]: FrameNote(*note) for note in kept.frames}
        """The facts of the protocol's frames, by name."""
        self.warned = kept.warned
        """Whether the definition has warnings."""
        self._kept = kept
        self._again = again

    @cached_property
    def protocol(self) -> Protocol:
        """Return the definition, loaded again if the entry is damaged.

        A later `compile_protocol` of it uses the code of the entry.
        """
        from framekit.codec.codec import codec_from

        protocol = _model(self._kept)
        if protocol is None:
            self._kept = self._again()
            protocol = _model(self._kept)
            assert protocol is not None  # the entry is new, so its model is valid
        codec_from(protocol, self._kept.code)
        return protocol


def cached_codec(name: str | Path, folder: Path) -> CachedCodec:
    """Return the codec of a protocol by name or file, relative to `folder`: from the cache, or compiled and cached now.

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
        with suppress(ImportError):  # a library that the code was compiled for is no longer installed
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
    from framekit.definition.kinds.data import ShownAs
    from framekit.definition.model.frames import parts_of

    notes = [
        (
            frame.name,
            frame.inner,
            frame.side,
            frame.refuse,
            names_of(protocol, frame.name),
            any(True for _ in parts_of(frame.segments, ShownAs)),
        )
        for frame in protocol.frames.values()
    ]
    return CacheEntry(tuple(sources), protocol.name, code, notes, bool(protocol.warnings), pickle.dumps(protocol))


def _model(kept: CacheEntry) -> Protocol | None:
    """Return the model of an entry, or None if the entry is damaged."""
    import gc
    import pickle

    from framekit.definition.model.protocol import Protocol

    collects = gc.isenabled()
    gc.disable()  # the collector would visit tens of thousands of new objects in vain
    try:
        protocol = pickle.loads(kept.pickled)
    except Exception:  # a damaged pickle may raise any exception
        return None
    finally:
        if collects:
            gc.enable()
    return protocol if isinstance(protocol, Protocol) else None


class CacheFolder:
    """Read and write the entries of a folder, by the files of their definitions."""

    def __init__(self, cache: Path) -> None:
        self.cache = cache
        self._stamp = _stamp(__version__)

    def _key(self, path: Path) -> str:
        broken = import_installed()  # before `states()`: installed extensions are part of every definition
        return hashlib.sha256(f"{path}\n{path.resolve()}\n{self._stamp}\n{broken}{states()}".encode()).hexdigest()

    def read(self, path: Path) -> CacheEntry | None:
        """Return the entry of a definition file, or None if it is missing, damaged or outdated."""
        content = self._content(self._key(path))
        if content is None:
            return None
        try:
            kept = CacheEntry(*marshal.loads(content))
            return kept if Sources(*kept.sources).still_hold() else None
        # not an entry of this version: it is written again
        except (EOFError, ValueError, TypeError, AttributeError, LookupError):
            return None

    def write(self, path: Path, kept: CacheEntry) -> None:
        self._write(self._key(path), tuple(kept))

    def read_code(self, path: Path, sources: Sources, what: str) -> CodeType | None:
        """Return other code that was compiled from a definition with exactly these sources, or None.

        `what` names the code.
        """
        content = self._content(self._key_of_code(path, sources, what))
        if content is None:
            return None
        try:
            code = marshal.loads(content)
        except (EOFError, ValueError, TypeError):  # not an entry of this version: it is written again
            return None
        return code if isinstance(code, CodeType) else None

    def write_code(self, path: Path, sources: Sources, what: str, code: CodeType) -> None:
        self._write(self._key_of_code(path, sources, what), code)

    def _content(self, key: str) -> bytes | None:
        """Return the content of an entry, or None if it is missing or damaged."""
        data = read_entry(self.cache, key) or b""
        digest, content = data[:32], data[32:]
        if hashlib.sha256(content).digest() != digest or not content.startswith(key.encode()):
            return None
        return content[len(key) :]

    def _write(self, key: str, value: Any) -> None:
        """Write an entry together with its key, so that it is invalid under another name."""
        content = key.encode() + marshal.dumps(value)
        keep(self.cache, key, hashlib.sha256(content).digest() + content)

    def _key_of_code(self, path: Path, sources: Sources, what: str) -> str:
        return hashlib.sha256(f"{self._key(path)}\n{what}\n{tuple(sources)!r}".encode()).hexdigest()


class DefinitionCache:
    """Provide the cache to loaders and compilers (see `sources.Cache`)."""

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
    """Return the cache in the user's folder, or None if no folder can be trusted."""
    cache = cache_folder()
    return None if cache is None else DefinitionCache(CacheFolder(cache))


@lru_cache(1)
def _stamp(version: str) -> str:
    """Return a text with the versions, and the size and time of every file of framekit that takes part in compiling."""
    package = Path(__file__).parent.parent
    found = [version, sys.version, str(sys.implementation.cache_tag)]
    for folder in (package / "definition", package / "codec", package / "link", shipped_folder("schemas")):
        for root, _, files in os.walk(folder):
            for name in files:
                if name.endswith((".py", ".json")):
                    state = os.stat(os.path.join(root, name))
                    found.append(f"{root}/{name} {state.st_size} {state.st_mtime_ns}")
    return "\n".join(sorted(found))

"""Compiled protocols kept from one command to the next, in the user's cache folder.

A kept one counts only for this version of framekit and Python and this very code of theirs, while every source file has
the content it had, and every name in them still means the same file. The model of the protocol is read only when
somebody asks for it: a command that decodes a frame needs the functions and what `FrameNote` says.
"""

from __future__ import annotations

import hashlib
import marshal
import os
import sys
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from framekit import __version__
from framekit.codec.functions import FrameFunctions, module_of
from framekit.codec.kept_files import cache_folder, keep, read_kept
from framekit.definition.shipped import definition_file, shipped_folder
from framekit.definition.sources import Sources

if TYPE_CHECKING:
    from types import CodeType

    from framekit.definition.model.protocol import Protocol


class FrameNote(NamedTuple):
    """What of a frame's definition tells when it is tried on bytes."""

    name: str
    inner: bool
    side: str
    refuse: int | None


class StoredCodec(FrameFunctions):
    """The functions of a protocol's frames; `catalogue`: its frames; `warned`: its definition has warnings."""

    def __init__(self, name: str, code: CodeType, frames: list[tuple[Any, ...]], warned: bool, pickled: bytes) -> None:
        super().__init__(module_of(name, code))
        self.catalogue: Mapping[str, FrameNote] = {note[0]: FrameNote(*note) for note in frames}
        self.warned = warned
        self._code = code
        self._pickled = pickled

    @cached_property
    def protocol(self) -> Protocol:
        """The definition; `compile_protocol` of it takes the code that is there."""
        import pickle

        from framekit.codec.codec import codec_from

        protocol: Protocol = pickle.loads(self._pickled)
        codec_from(protocol, self._code)
        return protocol


def stored_codec(name: str | Path, folder: Path) -> StoredCodec:
    """The codec of a protocol by name or file, seen from `folder`: kept from before, or made now and kept.

    Raises DefinitionError.
    """
    cache, path = cache_folder(), definition_file(name, folder)
    if cache is None or path is None:
        return _made(name, folder, None, "")
    key = hashlib.sha256(f"{path.resolve()}\n{_stamp()}".encode()).hexdigest()
    kept = read_kept(cache, key)
    return (None if kept is None else _read(kept)) or _made(name, folder, cache, key)


def _made(name: str | Path, folder: Path, cache: Path | None, key: str) -> StoredCodec:
    import pickle

    from framekit.codec.codec import code_of
    from framekit.definition.load.library import load_with_files

    loaded = load_with_files(name, folder)
    protocol = loaded.protocol
    notes = [(frame.name, frame.inner, frame.side, frame.refuse) for frame in protocol.frames.values()]
    parts = protocol.name, code_of(protocol), notes, bool(protocol.warnings), pickle.dumps(protocol)
    if cache is not None:
        content = marshal.dumps((tuple(loaded.sources), *parts))
        keep(cache, key, hashlib.sha256(content).digest() + content)
    return StoredCodec(*parts)


def _read(kept: bytes) -> StoredCodec | None:
    """What was kept, if it is whole and still right."""
    digest, content = kept[:32], kept[32:]
    if hashlib.sha256(content).digest() != digest:
        return None
    sources, *parts = marshal.loads(content)
    try:
        return StoredCodec(*parts) if Sources(*sources).still_hold() else None
    except ImportError:  # a library it was compiled for has been changed since
        return None


def _stamp() -> str:
    """What compiles definitions: the versions, and size and time of every file of framekit that has a part in it."""
    package = Path(__file__).parent.parent
    found = [__version__, sys.version, str(sys.implementation.cache_tag)]
    for folder in (package / "definition", package / "codec", shipped_folder("schemas")):
        for root, _, files in os.walk(folder):
            for name in files:
                if name.endswith((".py", ".json")):
                    state = os.stat(os.path.join(root, name))
                    found.append(f"{root}/{name} {state.st_size} {state.st_mtime_ns}")
    return "\n".join(sorted(found))

"""The file a device memory is kept in.

First line: what it is. Second line: the shape, as JSON (name, unit and size of every area). The rest: the
bytes of all areas in that order, compressed with a checksum. Reading trusts nothing in it: a file of another
shape is refused, and no more is unpacked than the memory holds.
"""

from __future__ import annotations

import json
import os
import secrets
import zlib
from collections.abc import Mapping
from pathlib import Path

from framekit.memory.errors import SnapshotError
from framekit.memory.numbers import unit_bits

Shape = tuple[tuple[str, str, int], ...]
"""Name, unit and size of every area."""

_TITLE = b"framekit memory 1\n"


def write_snapshot(path: Path, shape: Shape, contents: Mapping[str, bytes]) -> None:
    """Writes beside `path`, then puts it in place in one step. Raises OSError."""
    whole = b"".join(contents[name] for name, _, _ in shape)
    header = json.dumps(shape, ensure_ascii=True, separators=(",", ":")).encode("ascii") + b"\n"
    beside = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with open(beside, "xb") as file:
            file.write(_TITLE + header + zlib.compress(whole))
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def read_snapshot(path: Path, shape: Shape) -> dict[str, bytes]:
    """Bytes of every area. Raises SnapshotError for another kind of file or shape, or damage; OSError."""
    with open(path, "rb") as file:
        if file.read(len(_TITLE)) != _TITLE:
            raise SnapshotError(f"{path} is no memory snapshot of this version")
        header = json.dumps(shape, ensure_ascii=True, separators=(",", ":")).encode("ascii") + b"\n"
        line = file.readline(max(len(header), 1 << 20))
        if line != header:
            raise SnapshotError(f"{path} is of another memory: {_difference(line, shape)}")
        sizes = [(size * unit_bits(unit) + 7) // 8 for _, unit, size in shape]
        # zlib may store incompressible data with a few bytes more than it has
        packed = file.read(sum(sizes) + sum(sizes) // 1000 + 1024)
    whole = _unpack(packed, sum(sizes), path)
    contents, at = {}, 0
    for (name, _, _), size in zip(shape, sizes, strict=True):
        contents[name] = whole[at : at + size]
        at += size
    return contents


def _unpack(packed: bytes, size: int, path: Path) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        whole = unpacker.decompress(packed, size + 1)
    except zlib.error as problem:
        raise SnapshotError(f"{path} is damaged") from problem
    if len(whole) != size or not unpacker.eof or unpacker.unused_data:
        raise SnapshotError(f"{path} is damaged")
    return whole


def _difference(line: bytes, shape: Shape) -> str:
    try:
        there = {str(name): f"{size} × {unit}" for name, unit, size in json.loads(line)}
    except (ValueError, TypeError, RecursionError):
        return "its list of areas is damaged"
    here = {name: f"{size} × {unit}" for name, unit, size in shape}
    for name in [*here, *there]:
        if here.get(name) != there.get(name):
            return f"area {name} is {there.get(name, 'not')} there and {here.get(name, 'not')} here"
    return "its areas stand in another order"

"""The memory of one device: its areas by name, watches over them, and snapshots of the whole.

Used by one thread. It knows nothing of addresses as users write them, of protocols or of time.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from framekit.definition.problems import did_you_mean
from framekit.memory.area import Area
from framekit.memory.errors import SnapshotError, UnknownAreaError
from framekit.memory.snapshot import Shape, read_snapshot, write_snapshot
from framekit.memory.watch import ALL_BITS, Changed, Watch


class DeviceMemory:
    """Areas, found by name or alias. Raises ValueError when two areas claim one name.

    Every method that takes the name of an area raises UnknownAreaError, and what the area raises (see
    `Area`).
    """

    def __init__(self, areas: Iterable[Area]) -> None:
        self.areas: dict[str, Area] = {}
        self._by_name: dict[str, Area] = {}
        for area in areas:
            self.areas[area.name] = area
            for name in (area.name, *area.aliases):
                if name in self._by_name:
                    raise ValueError(f"two areas of the memory are named {name}")
                self._by_name[name] = area

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __iter__(self) -> Iterator[Area]:
        return iter(self.areas.values())

    def area(self, name: str) -> Area:
        """The area of that name or alias."""
        found = self._by_name.get(name)
        if found is None:
            hint = did_you_mean(name, self._by_name)
            raise UnknownAreaError(f"the memory has no area '{name}'" + (f" – {hint}" if hint else ""))
        return found

    # --- access; see Area

    def read(self, area: str, unit: str | int, start: int, count: int = 1) -> list[int]:
        """`count` unsigned values of `unit`, from number `start` on."""
        return self.area(area).read(unit, start, count)

    def write(self, area: str, unit: str | int, start: int, values: Sequence[int], *, force: bool = False) -> None:
        """Puts unsigned values at number `start` on; all or none."""
        (self._by_name.get(area) or self.area(area)).write(unit, start, values, force=force)

    def read_bytes(self, area: str, offset: int, count: int) -> bytes:
        """`count` bytes from byte `offset` on."""
        return self.area(area).read_bytes(offset, count)

    def write_bytes(self, area: str, offset: int, data: bytes, *, force: bool = False) -> None:
        """Puts `data` at byte `offset`."""
        self.area(area).write_bytes(offset, data, force=force)

    def watch(self, area: str, first_word: int, count: int, callback: Changed, mask: int = ALL_BITS) -> Watch:
        """Calls `callback(area, first_changed_word, words)` once for every write that changes these words."""
        return self.area(area).watch(first_word, count, callback, mask)

    # --- the whole

    @property
    def shape(self) -> Shape:
        """Name, unit and size of every area; snapshots fit memories of the same shape."""
        return tuple((area.name, area.unit, area.size) for area in self)

    def snapshot(self) -> dict[str, bytes]:
        """The bytes of every area."""
        return {area.name: area.read_bytes(0, area.size_bytes) for area in self}

    def restore(self, snapshot: Mapping[str, bytes]) -> None:
        """Puts a snapshot back, read-only areas too; watches are called.

        Raises SnapshotError, having changed nothing, if it is of another shape.
        """
        here = {area.name: area.size_bytes for area in self}
        there = {name: len(data) for name, data in snapshot.items()}
        if here != there:
            differ = sorted(name for name in here.keys() | there.keys() if here.get(name) != there.get(name))
            raise SnapshotError(f"the snapshot is of another memory: it differs in {', '.join(differ)}")
        for area in self:
            area.write_bytes(0, snapshot[area.name], force=True)

    def reset(self) -> None:
        """All areas to 0, read-only ones too; watches are called."""
        for area in self:
            area.write_bytes(0, bytes(area.size_bytes), force=True)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a snapshot file, which is the old or the new one and never half of it. Raises OSError."""
        write_snapshot(Path(path), self.shape, self.snapshot())

    def load(self, path: str | os.PathLike[str]) -> None:
        """Restores a snapshot file. Raises SnapshotError when it is damaged or of another shape, OSError."""
        self.restore(read_snapshot(Path(path), self.shape))

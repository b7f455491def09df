"""Services, areas, errors: constructors name fields there are, areas and units are known, a reply always fits."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from framekit.definition.check.names import field_names
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import UNIT_BITS, ServiceRow
from framekit.definition.model.values import FrameOf, LayoutOf, ReadAs
from framekit.definition.model.visit import parts_of
from framekit.definition.problems import Problem, did_you_mean


def check_services(protocol: Protocol, broken: Collection[str] = ()) -> list[Problem]:
    """Everything wrong with services, areas and errors; and with constructors anywhere."""
    found = list(_constructors(protocol))
    for rows in protocol.services.values():
        for row in rows:
            found += _row(protocol, row)
    found += _codes(protocol)
    if protocol.errors is not None:
        for name in protocol.errors.names:
            if name not in protocol.tables:
                found.append(
                    Problem(protocol.errors.at, f"there is no table '{name}'", did_you_mean(name, protocol.tables))
                )
    return found


def _constructors(protocol: Protocol) -> Iterator[Problem]:
    """`{frame: {field: …}}` may only name fields of that frame."""
    holders = [protocol.sequences, protocol.services, protocol.errors]
    for made in parts_of(holders, FrameOf):
        frame = protocol.frames.get(made.frame)
        if frame is not None:
            yield from _fields(made, "frame", made.frame, field_names(frame.segments))
    for layout in parts_of(holders, LayoutOf):
        if layout.layout in protocol.layouts:
            yield from _fields(layout, "layout", layout.layout, field_names(protocol.layouts[layout.layout].segments))
    for read in parts_of(holders, ReadAs):
        if read.layout not in protocol.layouts:
            yield Problem(read.at, f"there is no layout '{read.layout}'", did_you_mean(read.layout, protocol.layouts))


def _fields(made: FrameOf | LayoutOf, kind: str, name: str, known: set[str]) -> Iterator[Problem]:
    for field in made.fields:
        if field not in known:
            yield Problem(made.at, f"{kind} '{name}' has no field '{field}'", did_you_mean(field, known))


def _row(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    for area in row.areas:
        if area not in protocol.areas:
            yield Problem(row.at, f"there is no area '{area}'", did_you_mean(area, protocol.areas))
    for unit in row.units:
        if unit not in UNIT_BITS and not any(unit == area.unit for area in protocol.areas.values()):
            yield Problem(row.at, f"'{unit}' is not a unit of any area", did_you_mean(unit, UNIT_BITS))
    if row.reply and row.reply[-1].when is not None and not row.client_only:
        yield Problem(row.reply[-1].at, "the last reply has a condition", "a server must have a reply for every case")
    if row.service in ("read", "write") and row.request is None and row.run is None:
        yield Problem(row.at, f"a row of {row.service} has no request", "add request: {frame: {…}}")


def _codes(protocol: Protocol) -> Iterator[Problem]:
    """Two areas with one code for a unit can't be told apart by a server."""
    seen: dict[tuple[str, object], str] = {}
    for area in protocol.areas.values():
        for unit, code in area.codes.items():
            other = seen.setdefault((unit, code), area.name)
            if other != area.name and code != 0:
                yield Problem(
                    area.at, f"areas '{other}' and '{area.name}' have the same code for {unit}", "give each its own"
                )

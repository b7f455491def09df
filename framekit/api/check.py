"""The check of a file of any kind. Modules of a kind are imported for the first file of the kind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from framekit.codec.ambiguity import check_matrices
from framekit.definition.load.protocol import definition_path, load_protocol
from framekit.definition.nodes import read_nodes
from framekit.definition.problems import DefinitionError, Problem, most_important, plural
from framekit.definition.schema import ANY_FIRST_KEY, kind_of
from framekit.table_of_extras import OPTIONS, load

if TYPE_CHECKING:
    from framekit.run.model import RunModel
    from framekit.service.feasibility import BlockLoad as BlockLoad
    from framekit.service.feasibility import ChannelLoad as ChannelLoad


@dataclass(frozen=True)
class Checked:
    """Result of a check: a description of the file, its problems, and the load of its channels."""

    what: str
    problems: list[Problem]
    loads: tuple[ChannelLoad, ...] = ()


def check_file(name: str) -> Checked:
    """Check a file of any kind."""
    try:
        path = definition_path(name)
        kind = "points" if path.suffix == ".csv" else kind_of(read_nodes(path, noted=[], begin=ANY_FIRST_KEY))
        checked = CHECKS[kind](path)
        return Checked(checked.what, list(most_important(checked.problems)), checked.loads)
    except DefinitionError as error:
        return Checked("", list(error.problems))


def _protocol(path: Path) -> Checked:
    from framekit.api.scan import check_probe
    from framekit.link.addresses import check_addresses

    protocol = load_protocol(path)
    problems = [*protocol.warnings, *check_matrices(protocol, built=lambda: _built_by_vectors(path))]
    problems += check_addresses(protocol.addresses, protocol.areas, protocol.tables)
    problems += check_probe(protocol)
    roles = f", roles {', '.join(protocol.roles)}" if protocol.roles else ""
    return Checked(f"{protocol.kind} {protocol.name}, {plural(len(protocol.frames), 'frame')}{roles}", problems)


def _built_by_vectors(definition: Path) -> set[str]:
    """Return the frames that the vectors of a definition build."""
    from framekit.api.vectors import vectors_path
    from framekit.definition.vectors import read_vectors

    path = vectors_path(definition)
    vectors = read_vectors(path)[0] if path.is_file() else None
    return set() if vectors is None else {one.frame for one in vectors.frames if one.frame and one.values is not None}


def _device(path: Path) -> Checked:
    from framekit.runfile.devices import load_devices

    devices = load_devices(path, path.parent)
    name = devices[0].name
    protocol = " and ".join(dict.fromkeys(device.protocol.name for device in devices))
    alone = [device for device in devices if not device.shares]
    if len(alone) == 1:
        return Checked(f"device {name} speaking {protocol}", [])
    stations = ", ".join(device.station for device in alone)
    name = name.removesuffix(f" {devices[0].own}")
    return Checked(f"device {name}, stations {stations}, speaking {protocol}", [])


def _run(path: Path) -> Checked:
    from framekit.run.model import POINTS_SET
    from framekit.runfile.run_file import read_run
    from framekit.service.device import devices_of

    loaded, channels, found = read_run(path)
    problems: list[Problem] = []
    for channel in channels:
        try:
            devices_of(channel, path.parent)
        except DefinitionError as error:
            problems += error.problems
    if loaded is None:
        raise DefinitionError([*found, *problems])
    for protocol in {id(channel.protocol): channel.protocol for channel in loaded.channels.values()}.values():
        problems += [problem for problem in check_matrices(protocol, weak_codes=False) if not problem.warning]
    if problems:
        raise DefinitionError(problems)
    loads, doubts = loads_of(loaded)
    numbered = sum(block.set != POINTS_SET for block in loaded.blocks)
    blocks = plural(numbered, "block") if numbered or not loaded.points else ""
    parts = [part for part in (blocks, plural(len(loaded.points), "point") if loaded.points else "") if part]
    what = f"run {loaded.name}, {' and '.join(parts)} on {plural(len(loaded.channels), 'channel')}"
    return Checked(what, [*loaded.warnings, *doubts], loads)


def loads_of(run: RunModel) -> tuple[tuple[ChannelLoad, ...], list[Problem]]:
    """Return the load of each channel of a run, computed on simulated lines, and a warning for each cycle that lacks
    time.
    """
    from framekit.service import feasibility

    loads = feasibility.loads_of(run)
    return loads, feasibility.load_problems(loads)


def _vectors(path: Path) -> Checked:
    from framekit.api.vectors import vector_problems
    from framekit.definition.vectors import read_vectors

    vectors, problems = read_vectors(path)
    if vectors is None:
        raise DefinitionError(problems)
    try:
        protocol = load_protocol(definition_path(vectors.protocol, path.parent))
        problems = [*problems, *vector_problems(vectors, protocol)]
    except DefinitionError as error:
        if error.problems[0].at.file == vectors.protocol:
            what, todo = error.problems[0].what, error.problems[0].todo
        else:
            what, todo = f"the definition of '{vectors.protocol}' is not right", f"framekit check {vectors.protocol}"
        raise DefinitionError([*problems, Problem(vectors.protocol_at, what, todo)]) from None
    if problems:
        raise DefinitionError(problems)
    frames, conversations = plural(len(vectors.frames), "frame"), plural(len(vectors.conversations), "conversation")
    what = f"vectors of {vectors.protocol}, {frames}, {conversations}"
    return Checked(what, [])


def _memory(path: Path) -> Checked:
    from framekit.link.addresses import check_addresses
    from framekit.memory.profile import load_profile
    from framekit.run.block_words import check_items
    from framekit.runfile.devices import check_profile

    profile = load_profile(path)
    problems = check_addresses(profile.addresses, profile.areas, profile.tables)
    problems += [*check_items(profile.flags.values()), *check_profile(profile)]
    return Checked(f"memory {profile.name}, {len(profile.areas)} areas", problems)


def _faults(path: Path) -> Checked:
    from framekit.runfile.fault_plans import load_fault_plan

    plan = load_fault_plan(path)
    return Checked(f"faults {plan.name}, {plural(len(plan.rules), 'rule')}", [])


def _jobs(path: Path) -> Checked:
    profile = load(OPTIONS["NAME.jobs.yaml"])(path)
    return Checked(f"jobs {profile.name}, {len(profile.slots)} slots, {profile.bits.size} status bits", [])


def _points(path: Path) -> Checked:
    from framekit.runfile.points import load_points

    return Checked(f"points {path.name.removesuffix('.points.yaml')}, {plural(len(load_points(path)), 'point')}", [])


CHECKS = {
    "protocol": _protocol, "device": _device, "run": _run, "vectors": _vectors, "memory": _memory, "faults": _faults,
    "jobs": _jobs, "points": _points,
}  # fmt: skip

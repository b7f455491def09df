"""Read `jobs:` of a run file: the profile with the changes of the run, hosts, and channels that jobs may open."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from framekit.definition.load.protocol import load_protocol
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.frames import parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import JobWork
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.nodes import Node
from framekit.definition.problems import DefinitionError
from framekit.extras.commreq.job_profiles import load_job_profile
from framekit.link.addresses import AddressGrammar
from framekit.memory.profile import read_scan
from framekit.run.model import HOST, AfterLate, JobProfile, JobsSection, Opening
from framekit.runfile.channels import ChannelLoader
from framekit.runfile.transfers import OwnPlaces

_AFTER = {one.value: one for one in AfterLate}


def read_jobs(
    reader: Reader, node: Node, folder: Path, grammar: AddressGrammar, channels: ChannelLoader
) -> JobsSection:
    """Return the jobs section; `grammar` parses addresses of the own memory. Raise Broken."""
    keys = reader.mapping(node)
    named = keys.get("profile")
    if named is None:
        raise Broken("the schema asks for a profile")
    try:
        profile = load_job_profile(reader.text(named), folder, named.at)
    except DefinitionError as error:
        reader.problems.extend(error.problems)
        raise Broken("jobs") from None
    changed: dict[str, Any] = {
        "scan": reader.tried(partial(read_scan, reader), keys.get("scan")),
        "connect": reader.tried(reader.time, keys.get("connect")),
        "after_late": reader.tried(lambda after: reader.one_of(after, _AFTER, "a moment"), keys.get("next")),
    }
    places = OwnPlaces(reader, grammar)
    status = reader.tried(lambda given: places.place(given, bits=profile.bits.size), keys.get("status"))
    hosts = {entry.key.text: reader.text(entry.value) for entry in reader.entries(keys.get("hosts"))}
    surplus = keys.get("surplus")
    waits = surplus is None or reader.text(surplus) == "wait"
    commands = reader.maybe(lambda given: read_commands(reader, given, folder), keys.get("commands"))
    return JobsSection(
        profile=replace(profile, **{name: value for name, value in changed.items() if value is not None}),
        status=status,
        hosts=hosts,
        waits=waits,
        commands=commands,
        opening=read_opening(reader, keys, profile, channels, grammar),
        at=node.at,
    )


def read_opening(
    reader: Reader, keys: MappingNode, profile: JobProfile, channels: ChannelLoader, grammar: AddressGrammar
) -> Opening | None:
    """Return the template of channels for hosts without a channel; None if the run allows none, or if it is invalid."""
    entry = next((entry for entry in keys.entries if entry.key.text == "open"), None)
    most = keys.get("connections")
    if entry is None or keys.get("open") is None:
        if most is not None:
            reader.note(
                most.at, "connections: counts channels that are opened when wanted", "add open: {port, protocol}"
            )
        return None
    connections = len(profile.slots)
    with reader.going_on():
        connections = connections if most is None else reader.number(most)
        if most is not None and connections < 1:
            reader.note(most.at, f"{connections} connections are none", "give 1 or more, or leave open out")
    with reader.going_on():
        channel = channels.channel(entry, grammar, numbered=False)
        given = reader.mapping(entry.value)
        if (host := given.get("host")) is not None:
            reader.note(
                host.at, "the host is the one that a job names", f"leave host out, and write {HOST} in the port"
            )
        return Opening(channel=channel, connections=connections)
    return None


def read_commands(reader: Reader, node: Node, folder: Path) -> Protocol:
    """Return the application that decodes the words of commands to jobs. Raise Broken."""
    name = reader.text(node)
    try:
        application = load_protocol(name, folder)
    except DefinitionError as error:
        reader.of_file(error, name, node.at)
        raise Broken(name) from None
    if application.commands is None or not any(parts_of(dict(application.services), JobWork)):
        raise reader.broken(node.at, f"'{name}' has no commands to jobs", "name an application that has them")
    return application

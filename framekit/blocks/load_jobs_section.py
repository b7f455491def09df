"""Reads the jobs section of a run: profile, what the run changes of it, hosts, what is opened for other hosts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from framekit.blocks.jobs.load import load_job_profile
from framekit.blocks.jobs.profile import AfterLate, JobProfile
from framekit.blocks.jobs.profile_loader import read_scan
from framekit.blocks.jobs.section import HOST, JobsSection, Opening
from framekit.blocks.load_channel import ChannelLoader
from framekit.blocks.memory_settings import read_mapping
from framekit.blocks.own_places import read_place
from framekit.definition.load import load_protocol
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.commands import JobWork
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.walk import parts_of
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.nodes import Node
from framekit.definition.problems import DefinitionError, Problem
from framekit.link.addresses import AddressGrammar

_AFTER = {one.value: one for one in AfterLate}


def read_jobs(
    reader: Reader, node: Node, folder: Path, grammar: AddressGrammar, channels: ChannelLoader
) -> JobsSection:
    """The jobs section; `grammar` reads addresses of the own memory. Raises Broken."""
    keys = reader.mapping(node)
    named = keys.get("profile")
    if named is None:
        raise Broken("the schema asks for a profile")
    try:
        profile = load_job_profile(reader.text(named), folder, named.at)
    except DefinitionError as error:
        reader.problems.extend(error.problems)
        raise Broken("jobs") from None
    changed: dict[str, Any] = {}
    with reader.going_on():
        if (scan := keys.get("scan")) is not None:
            changed["scan"] = read_scan(reader, scan)
    with reader.going_on():
        if (connect := keys.get("connect")) is not None:
            changed["connect"] = reader.time(connect)
    with reader.going_on():
        if (after := keys.get("next")) is not None:
            changed["after_late"] = reader.one_of(after, _AFTER, "a moment")
    status = None
    with reader.going_on():
        status = reader.maybe(lambda given: read_place(reader, grammar, given, profile.bits.size), keys.get("status"))
    hosts = {entry.key.text: reader.text(entry.value) for entry in reader.entries(keys.get("hosts"))}
    surplus = keys.get("surplus")
    waits = surplus is None or reader.text(surplus) == "wait"
    commands = reader.maybe(lambda given: read_commands(reader, given, folder), keys.get("commands"))
    return JobsSection(
        profile=replace(profile, **changed),
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
    """The channel that is opened for hosts without one; None where the run allows none, and for a broken one."""
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
        channel = channels.template(entry)
        given = reader.mapping(entry.value)
        if (host := given.get("host")) is not None:
            reader.note(
                host.at, "the host is the one that a job names", f"leave host out, and write {HOST} in the port"
            )
        if (node := given.get("map")) is not None:
            channel = replace(channel, mapping=read_mapping(reader, node, channel.protocol, grammar))
        return Opening(channel=channel, connections=connections)
    return None


def read_commands(reader: Reader, node: Node, folder: Path) -> Protocol:
    """The application that reads the words of commands to jobs. Raises Broken."""
    name = reader.text(node)
    try:
        application = load_protocol(name, folder)
    except DefinitionError as error:
        for problem in error.problems:
            there = problem.at.file != name
            reader.problems.append(problem if there else Problem(node.at, problem.what, problem.todo))
        raise Broken(name) from None
    if application.commands is None or not any(parts_of(dict(application.services), JobWork)):
        raise reader.broken(node.at, f"'{name}' has no commands to jobs", "name an application that has them")
    return application

"""`framekit fleet BROKER`: list the gateways of a fleet, and roll run files out to them."""

from __future__ import annotations

import argparse
import os
import queue
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    VerbError,
    WordsError,
    add,
    duration_of,
    in_words,
    print_json,
    table,
    time_of,
)
from framekit.cli.live_output import LiveOutput, live_output
from framekit.definition.problems import printable

if TYPE_CHECKING:
    from framekit.extras.fleet.fleet import Fleet, GatewayAnswer, Member
    from framekit.sinks.broker import BrokerAccess
    from framekit.sinks.secrets import Secret

HEAD = ("gateway", "is", "since", "run", "channels", "points", "version", "file", "health")
LONGEST_WITHIN = 86_400_000_000_000
LONGEST_ANSWER = 60.0
"""Default time limit for the answers of gateways (s)."""
LOOKS_EVERY = 5.0
"""Longest interval of the checks for gateways that have become silent (s)."""


def add_fleet_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("broker", metavar="BROKER", help="the MQTT broker: HOST or HOST:PORT")
    parser.add_argument("gateways", metavar="GATEWAY", nargs="*", help="only these; default: all that are known there")
    parser.add_argument("--group", metavar="NAME", help="the fleet; default: framekit")
    parser.add_argument("--user", metavar="NAME", default="", help="the user's name at the broker")
    parser.add_argument("--password", metavar="env:NAME|file:NAME", help="where the password stands")
    parser.add_argument(
        "--tls", nargs="?", const="", metavar="FILE",
        help="encrypted; the certificates (PEM) to check the broker's against, default: those of the system",
    )  # fmt: skip
    parser.add_argument("--watch", action="store_true", help="go on, and tell what changes")
    add(parser, "--for")
    parser.add_argument("--roll", metavar="RUN.yaml", type=Path, help="roll this run file out to the gateways named")
    parser.add_argument("--all", action="store_true", help="roll it out to all that take files")
    parser.add_argument("--token", metavar="env:NAME|file:NAME", help="where the token of these gateways stands")
    parser.add_argument("--within", metavar="TIME", help="wait so long for the answers; default: 60 s")
    add(parser, "--json")


def run_fleet(arguments: argparse.Namespace) -> int:
    from framekit.extras.fleet.fleet import GROUP, Fleet, file_of, name_of

    refuse_useless(arguments)
    duration = duration_of(arguments.duration)
    within = None if arguments.within is None else time_of("--within", arguments.within)
    if within is not None and within > LONGEST_WITHIN:
        raise WordsError("--within: write a day at most")
    try:
        group = name_of(GROUP if arguments.group is None else arguments.group)
    except ValueError as error:
        raise WordsError(f"--group: {error}") from None
    access = access_of(arguments)
    token = "" if arguments.token is None else kept_secret("--token", arguments.token, "token").read()
    changed: queue.SimpleQueue[str] = queue.SimpleQueue()
    try:
        with in_words():
            file = None if arguments.roll is None else file_of(arguments.roll)
            fleet = Fleet(access, group, changed.put)
    except WordsError as error:
        raise VerbError(str(error)) from None
    with fleet:
        missing = [name for name in arguments.gateways if name not in fleet.members]
        if file is not None:
            names = [*arguments.gateways] or [
                name for name, one in sorted(fleet.members.items()) if one.takes_files and one.online
            ]
            seconds = LONGEST_ANSWER if within is None else within / 1e9
            return show_answers(fleet.roll(names, file, token, seconds), arguments.json)
        if missing:
            raise VerbError(f"there is no gateway '{missing[0]}' in the fleet '{group}' of {access}")
        if not arguments.watch:
            show(fleet, arguments)
            return 0
        with live_output(arguments.json) as live:
            show(fleet, arguments)
            live.on_gone(lambda: changed.put(""))
            with live.until_stopped(), live.may_drop():
                watch(fleet, arguments, changed, duration, live)
            return live.report_losses(0)


def refuse_useless(arguments: argparse.Namespace) -> None:
    """Raise WordsError for options that have no effect, or need another option."""
    if arguments.roll is None:
        for name, given in (("--all", arguments.all), ("--token", arguments.token), ("--within", arguments.within)):
            if given:
                raise WordsError(f"{name} has no effect without --roll")
        if arguments.duration is not None and not arguments.watch:
            raise WordsError("--for has no effect without --watch")
        return
    if arguments.watch or arguments.duration is not None:
        raise WordsError("--roll ends with the answers – leave --watch and --for out")
    if arguments.token is None:
        raise WordsError("--roll needs --token: where the token of these gateways stands")
    if bool(arguments.gateways) == arguments.all:
        raise WordsError("--roll needs the names of gateways, or --all")


def access_of(arguments: argparse.Namespace) -> BrokerAccess:
    """Return the access to the broker from the command line. Raises WordsError."""
    from framekit.sinks.broker import BrokerAccess, place_of

    try:
        place = place_of(arguments.broker)
    except ValueError as error:
        raise WordsError(f"{error} – write HOST or HOST:PORT") from None
    if arguments.password is not None and not arguments.user:
        raise WordsError("--password has no effect without --user")
    if arguments.tls and not os.path.isfile(arguments.tls):
        raise WordsError(f"--tls: there is no file '{arguments.tls}' – name a file of certificates (PEM)")
    password = None if arguments.password is None else kept_secret("--password", arguments.password, "password")
    return BrokerAccess(place, arguments.user, password, arguments.tls)


def kept_secret(option: str, text: str, what: str) -> Secret:
    """Return the secret that an option names, after checking that it can be read. Raises WordsError."""
    from framekit.sinks.secrets import secret_named

    try:
        found = secret_named(text, what)
        found.read()
    except (ValueError, OSError) as error:
        raise WordsError(f"{option}: {error}") from None
    return found


# ---- output ---------------------------------------------------------------------------------------------------


def row_of(member: Member) -> tuple[str, ...]:
    """Return the cells of a gateway."""
    birth = member.birth
    state = "silent" if member.is_silent else "up" if member.online else "down"
    words = (
        member.name, state, member.said("began"), member.said("run"), str(birth.get("channels", "")),
        str(birth.get("points", "")), member.said("version"), member.said("file"),
        "; ".join(member.troubles) or ("good" if member.health else "-"),
    )  # fmt: skip
    return words


def data_of(member: Member) -> dict[str, Any]:
    """Return a gateway for JSON output."""
    birth = {name: value for name, value in member.birth.items() if name != "number"}
    return {
        **birth, "gateway": member.name, "online": member.online and not member.is_silent,
        "takes_files": member.takes_files, "health": member.health,
    }  # fmt: skip


def wanted(fleet: Fleet, arguments: argparse.Namespace) -> list[Member]:
    """Return the selected gateways, by name."""
    return [
        one
        for name, one in sorted(fleet.members.copy().items())
        if not arguments.gateways or name in arguments.gateways
    ]


def show(fleet: Fleet, arguments: argparse.Namespace) -> None:
    """Print the selected gateways."""
    members = wanted(fleet, arguments)
    if arguments.json:
        for one in members:
            print_json(data_of(one))
    elif members:
        print(table([row_of(one) for one in members], HEAD))
    else:
        print(f"no gateway of the fleet '{fleet.group}' has told {fleet.access} of itself")
    sys.stdout.flush()


def watch(
    fleet: Fleet, arguments: argparse.Namespace, changed: queue.SimpleQueue[str], duration: int | None,
    live: LiveOutput,
) -> None:  # fmt: skip
    """Print changes until the time (ns) is over, or the reader of the output has gone."""
    until = None if duration is None else time.monotonic() + duration / 1e9
    shown = {one.name: row_of(one) for one in wanted(fleet, arguments)}
    connected = True
    while not live.gone and (until is None or time.monotonic() < until):
        left = LOOKS_EVERY if until is None else max(0.0, min(LOOKS_EVERY, until - time.monotonic()))
        with suppress(queue.Empty):
            changed.get(timeout=left)
        if connected != fleet.connected:
            connected = fleet.connected
            change = "is there again" if connected else "has gone; nothing is known of gateways until it is there again"
            print(f"framekit fleet: the broker {fleet.access} {change}", file=sys.stderr, flush=True)
        for member in wanted(fleet, arguments):
            row = row_of(member)
            if row == shown.get(member.name):
                continue
            shown[member.name] = row
            if arguments.json:
                print_json(data_of(member))
            else:
                print(printable(f"{time.strftime('%H:%M:%S')}  " + "  ".join(word for word in row if word)), flush=True)


def show_answers(answers: list[GatewayAnswer], as_json: bool) -> int:
    """Print the answers of gateways to a file; return the exit status."""
    for one in answers:
        if as_json:
            data = {"gateway": one.gateway, "ok": one.ok, "how": one.how, "problems": list(one.problems)}
            print_json({name: value for name, value in data.items() if value not in ("", [])})
            continue
        word = one.how if one.ok else "refused" if one.answered else "not done"
        print(printable(f"{one.gateway}: {word}"))
        for problem in one.problems:
            print(f"  {printable(problem)}")
    if not answers:
        print("no gateway takes files")
    return 0 if answers and all(one.ok for one in answers) else 1

"""A run that is one of a fleet: it tells a broker how it is, and takes run files that are rolled out to it.

A rolled file is checked here as `framekit check` does it. What can be changed while the run goes on is changed so; for
everything else the run ends when no exchange is under way, and begins anew with the other file. The file is replaced
before any of that, and put back where it comes to nothing. At any moment it is the old one or the new one, whole.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import os
import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from framekit import __version__
from framekit.api.errors import RequestError
from framekit.api.fleet import (
    BIRTH,
    HEALTH,
    LARGEST_FILE,
    LARGEST_MESSAGE,
    NO,
    ONLINE,
    ROLL,
    ROLLED,
    SIGN_OF_LIFE,
    STALE_AFTER,
    YES,
    as_message,
    from_message,
    signature,
    topic,
)
from framekit.api.replaced_file import ReplacedFile, digest_of
from framekit.api.run import RunCalls, content_of, reasons
from framekit.codec.shown import explain
from framekit.definition.fingerprint import fingerprint
from framekit.definition.problems import DefinitionError, Problem, library_missing
from framekit.run.edit import Edit
from framekit.run.model import RunModel
from framekit.runfile.fleet import FleetSection
from framekit.runfile.run_file import load_run
from framekit.sinks.base import SinkKind
from framekit.sinks.broker import KEEPALIVE
from framekit.transport.schemes import writes_files

if TYPE_CHECKING:
    from paho.mqtt.client import Client

log = logging.getLogger(__name__)

HEALTH_EVERY = 2_000_000_000
"""How often a gateway looks at its health (ns); what has changed is told."""
MOST_TOLD = 50
"""So many problems of a file, and so many names of a kind of trouble, are told."""
SHORTEST_TOKEN = 12
LONGEST_HOLD = 30
"""Seconds for which a rolled file waits until no exchange is under way."""
LONGEST_WAIT = 60
"""Seconds until a lost broker is tried again, at most."""


class Gateway:
    """The place of one run file in its fleet, while runs of it come and go; `with` tells the fleet of its end.

    `content`: what the file held when `model` was loaded. To be used in a running loop. `over` is set when the run that
    is at work has to end because `next_run` is to begin. Raises RequestError without the library, and for a token that
    cannot be read.
    """

    def __init__(self, path: Path, model: RunModel, content: bytes) -> None:
        fleet: FleetSection = model.fleet
        self.path, self.fleet, self.name = path, fleet, fleet.gateway
        self.over = asyncio.Event()
        self.next_run: RunModel | None = None
        self._file = ReplacedFile(path)
        self._model, self._content = model, content
        self._before: tuple[RunModel, bytes] | None = None
        """What counts again if nothing comes of the file that is on trial; None: none is."""
        self._failed: list[str] = []
        self._own_files = {*model.files, *_files_of_before(path, self._file)}
        self._run: RunCalls | None = None
        self._loop = asyncio.get_running_loop()
        self._began = datetime.now(UTC)
        self._number = ""
        self._instance = secrets.token_hex(8)
        self._other_seen = -float(STALE_AFTER)
        self._health: dict[str, Any] = {}
        self._told = 0.0
        self._rolling: dict[str, Any] | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        try:
            self._token = "" if fleet.token is None else fleet.token.read()
            if self._token and len(self._token) < SHORTEST_TOKEN:
                what = f"the token has {len(self._token)} characters"
                raise ValueError(f"{what} – give {SHORTEST_TOKEN} or more")
            self._client = fleet.access.client(f"framekit/{fleet.group}/{self.name}/{self._instance}", reconnects=True)
            if self._token:
                self._file.hold()
        except ModuleNotFoundError:
            raise RequestError(library_missing("a fleet", "paho-mqtt")) from None
        except BlockingIOError:
            what = f"another process takes files for {path.name} already"
            raise RequestError(f"fleet: {what} – end it, or run another file") from None
        except (OSError, ValueError) as error:
            raise RequestError(f"fleet: {error}") from None

    def __enter__(self) -> Self:
        client = self._client
        client.will_set(self._topic(ONLINE), NO, 1, retain=True)
        client.reconnect_delay_set(1, LONGEST_WAIT)
        client.on_connect = self._connected
        client.on_message = self._message
        client.connect_async(*self.fleet.access.at, KEEPALIVE)
        client.loop_start()
        return self

    def __exit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        if self._rolling is not None:
            self._take_back(["the run was ended before"])
        if self._client.is_connected():
            self._client.publish(self._topic(ONLINE), NO, 1, retain=True).wait_for_publish(1)
        self._client.disconnect()
        self._client.loop_stop()
        self._file.let_go()

    def _topic(self, what: str) -> str:
        return topic(self.fleet.group, self.name, what)

    # ---- what it tells ------------------------------------------------------------------------------------

    def begins(self, run: RunCalls) -> None:
        """A run that is about to start is the one that is told of from now on."""
        self._run, self._health = run, {}
        run.each(HEALTH_EVERY, self._look)

    def has_begun(self) -> None:
        """The run of `begins` has started, and tells of itself: with that a rolled file is applied, or refused."""
        self.over.clear()
        self.next_run = None
        failed, self._failed = self._failed, []
        if failed:
            self._refuse(failed)
        elif self._rolling is not None:
            self._keep()
            self._end_rolling("begun anew")
        else:
            self._bear()

    def has_failed(self, why: list[str]) -> RunModel:
        """The next run could not begin: the file of before is put back. Gives its run, which is to begin instead."""
        self._failed = [*why, *self._put_back()]
        return self._model

    def edited(self, model: RunModel, content: bytes) -> None:
        """The run was changed at the gateway itself, and goes on."""
        self._model, self._content = model, content
        self._bear()

    def _bear(self) -> None:
        """Tells what this gateway is. The number in it signs one rolled file."""
        if self._token and not self._number:
            self._number = secrets.token_hex(16)
        if not self._client.is_connected():
            return  # it is told as soon as there is a connection
        birth = {
            "run": self._model.name,
            "about": self._model.about,
            "version": __version__,
            "began": _utc(self._began),
            "file": digest_of(self._content),
            "channels": len(self._model.channels),
            "points": len(self._model.points),
            "instance": self._instance,
            **({"number": self._number} if self._number else {}),
        }
        self._client.publish(self._topic(BIRTH), as_message(birth), 1, retain=True)
        self._client.publish(self._topic(ONLINE), YES, 1, retain=True)
        if self._health:
            self._tell_health()

    def _look(self) -> None:
        """Tells the health where it is another one, and once in a while as a sign of life."""
        if self._run is None:
            return
        health = health_of(self._run)
        if time.monotonic() - self._other_seen < STALE_AFTER:
            health["problems"] = [f"another gateway is called '{self.name}' too", *health["problems"]]
        if health != self._health or time.monotonic() - self._told >= SIGN_OF_LIFE:
            self._health = health
            self._tell_health()

    def _tell_health(self) -> None:
        if self._run is None or not self._client.is_connected():
            return
        waiting = sum(sink.waiting for sink in self._run.status().sinks)
        data = {"at": _utc(datetime.now(UTC)), "instance": self._instance, **self._health, "waiting": waiting}
        self._client.publish(self._topic(HEALTH), as_message(data), 1, retain=True)
        self._told = time.monotonic()

    # ---- rolled files -------------------------------------------------------------------------------------

    def _heard(self, payload: bytes) -> None:
        """A file comes. What is not signed rightly is answered with nothing but that."""
        data = from_message(payload)
        identity, text, signed = (data.get(key) for key in ("id", "file", "signature"))
        if not (isinstance(identity, str) and isinstance(text, str) and isinstance(signed, str)):
            log.warning("fleet: a message to %s is no rolled file", self._topic(ROLL))
            return
        if data.get("instance") != self._instance:
            return  # it is for another gateway that is called so
        said = {"id": identity[:64].encode(errors="backslashreplace").decode()}
        content = text.encode(errors="backslashreplace")
        wanted = signature(self._token, self.fleet.group, self.name, self._number, said["id"], content)
        if not self._number or not hmac.compare_digest(wanted.encode(), signed.encode(errors="backslashreplace")):
            log.warning("fleet: a file that was rolled out is not signed with the token, or was sent before")
            self._answer(said, problems=["it is not signed with the token of this gateway, or was sent before"])
            return
        self._number = ""
        if self._rolling is not None or self.next_run is not None:
            self._bear()
            self._answer(said, problems=["another file is being applied – try again"])
            return
        self._rolling = said
        task = self._loop.create_task(self._roll(content))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _roll(self, content: bytes) -> None:
        """Refused without a trace, or on trial: the file is the new one, and the run changes when it can."""
        log.info("fleet: a run file of %d bytes is rolled out", len(content))
        if content == self._content == content_of(self.path):
            self._end_rolling("it is this file already; what it names beside counts from a new start on")
            return
        try:
            model = await asyncio.to_thread(self._checked, content)
            run = self._run
            if run is None or not run.running:
                raise ValueError("the run is not at work")
            self._put(model, content)
        except ValueError as error:
            self._refuse(reasons(error))
            return
        except Exception as error:  # whatever a file brings about, this gateway is ready for the next one
            log.exception("fleet: a rolled file")
            self._refuse([f"this gateway cannot apply it: {explain(error)}"])
            return

        assert self._before is not None
        now = self._before[0]
        waits = self._loop.call_later(LONGEST_HOLD, lambda: self._give_up(run, now))

        def applied(edit: Edit) -> None:
            waits.cancel()
            self._keep()
            self._end_rolling(f"applied while it goes on: {edit}")

        def ended(edit: Edit) -> None:
            waits.cancel()
            self.next_run = model
            self.over.set()

        try:
            try:
                if now.name != model.name or fingerprint(now.initial) != fingerprint(model.initial):
                    raise ValueError("names and start values count from a start on")
                run.edit(model, applied)
            except ValueError:  # it takes a new start, when no exchange is under way
                run.edit(replace(now, blocks=()), ended)
        except Exception as error:
            waits.cancel()
            log.debug("fleet: a rolled file", exc_info=True)
            self._take_back(reasons(error) if isinstance(error, ValueError) else [explain(error)])

    def _give_up(self, run: RunCalls, now: RunModel) -> None:
        """Exchanges that do not end keep a file from being applied; all channels stand still meanwhile."""
        if self._before is None or self.next_run is not None:
            return
        run.edit(now)  # what waits is forgotten, and nothing is held any more
        self._take_back([f"an exchange has not ended within {LONGEST_HOLD} s – try again"])

    def _checked(self, content: bytes) -> RunModel:
        """The run that a rolled file says. Raises DefinitionError, ValueError."""
        if len(content) > LARGEST_FILE:
            raise ValueError(f"the file has {len(content)} bytes – {LARGEST_FILE} at most are rolled out")
        if content_of(self.path) != self._content:
            raise ValueError("the run file was edited at the gateway since the run began – start the run anew there")
        model = load_run(self.path, content.decode())
        problems = list(more_than(self._model, model, self._file, self._own_files))
        if problems:
            raise DefinitionError(problems)
        return model

    def _put(self, model: RunModel, content: bytes) -> None:
        """The file is the new one, on trial. Raises ValueError; then it is the old one."""
        try:
            self._file.put(content)
        except OSError as error:
            raise ValueError(f"the file cannot be replaced: {error.strerror or error}") from None
        self._before = self._model, self._content
        self._model, self._content = model, content

    def _keep(self) -> None:
        """The trial has ended well."""
        self._before = None
        self._own_files |= set(self._model.files)
        try:
            self._file.keep()
        except OSError as error:
            log.warning("fleet: the trial of a rolled file is not noted to be over: %s", error)

    def _put_back(self) -> list[str]:
        """The trial has ended badly; what went wrong with that too."""
        if self._before is None:
            return []
        self._model, self._content = self._before
        self._before = None
        try:
            self._file.put_back()
        except OSError as error:
            return [f"the file of before cannot be put back: {error.strerror or error}"]
        return []

    def _take_back(self, why: list[str]) -> None:
        self._refuse([*why, *self._put_back()])

    def _refuse(self, problems: list[str]) -> None:
        told = problems[:MOST_TOLD]
        for folder in {self.path.parent.resolve(), self.path.parent.absolute()}:
            told = [one.replace(f"{folder}{os.sep}", "") for one in told]
        if len(problems) > MOST_TOLD:
            told.append(f"and {len(problems) - MOST_TOLD} more")
        log.warning("fleet: a rolled file is refused: %s", told[0] if told else "")
        self._end_rolling("", told)

    def _end_rolling(self, how: str, problems: list[str] | None = None) -> None:
        """Answers what is being rolled out. What this gateway is now, with a new number, is told before that."""
        said, self._rolling = self._rolling, None
        self._bear()
        if said is not None:
            self._answer(said, how, problems)

    def _answer(self, said: dict[str, Any], how: str = "", problems: list[str] | None = None) -> None:
        data = said | {"ok": not problems, "how": how, "problems": problems or []}
        self._client.publish(self._topic(ROLLED), as_message(data), 1)

    # ---- in the library's thread --------------------------------------------------------------------------

    def _connected(self, client: Client, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            log.warning("fleet: the broker %s refuses: %s", self.fleet.access, reason)
            return
        client.subscribe([(self._topic(what), 1) for what in (ONLINE, HEALTH, *([ROLL] if self._token else []))])
        self._in_loop(self._bear)

    def _message(self, client: Client, data: Any, message: Any) -> None:
        """What comes to its own topics: rolled files, and what others say under its name."""
        if message.retain:
            return
        what = message.topic.rpartition("/")[2]
        payload = bytes(message.payload[: LARGEST_MESSAGE + 1])
        if what == ROLL:
            self._in_loop(lambda: self._heard(payload))
        elif what == HEALTH:
            if from_message(payload).get("instance") != self._instance:
                self._in_loop(self._is_not_alone)
        elif payload == NO:  # the will of a connection that was lost: this one is there
            self._in_loop(self._bear)

    def _is_not_alone(self) -> None:
        if time.monotonic() - self._other_seen >= STALE_AFTER:
            log.warning("fleet: another gateway of the fleet '%s' is called '%s' too", self.fleet.group, self.name)
        self._other_seen = time.monotonic()

    def _in_loop(self, action: Callable[[], None]) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(action)


def health_of(run: RunCalls) -> dict[str, Any]:
    """What is not as it should be: nothing but empty lists when all is well."""
    status = run.status()
    failing = [
        f"{block.label} {block.name}".strip()
        for block in status.blocks
        if block.failed and block.last_failure is not None and block.last_failure.at == block.last_end
    ]
    sinks = [f"{sink.kind}: {sink.problem}" for sink in status.sinks if sink.problem]
    sinks += [f"{sink.kind}: {sink.dropped} dropped" for sink in status.sinks if sink.dropped]
    points = run.points if run.run.points else {}
    return {
        "down": [
            channel.number
            for channel in status.channels
            if channel.state != "open" and ((one := run.run.channels.get(channel.number)) is None or one.enabled)
        ][:MOST_TOLD],
        "failing": failing[:MOST_TOLD],
        "bad": [name for name, point in points.items() if point.quality != "good"][:MOST_TOLD],
        "sinks": sinks[:MOST_TOLD],
        "problems": run.problems[:MOST_TOLD],
    }


def more_than(old: RunModel, new: RunModel, file: ReplacedFile, own: set[str]) -> Iterator[Problem]:
    """What a rolled file may not say: another fleet, secrets for another place, files and ports of others.

    `own`: files that runs of this gateway have written.
    """
    if new.fleet is None or fingerprint(new.fleet) != fingerprint(old.fleet):
        at = new.at if new.fleet is None else new.fleet.at
        yield Problem(at, "a rolled file stays in its fleet, and says the same of it", "change that on the gateway")
    known = {_in_essence(sink) for sink in old.sinks}
    for sink in new.sinks:
        if _in_essence(sink) in known:
            continue
        if sink.has_secret:
            what = "a sink with a secret, or one that the system gives, is not of the present file"
            yield Problem(sink.at, what, "change that sink on the gateway first")
        if sink.listens is not None and not _is_local(sink.listens[0]):
            what = f"{sink.target} can be reached from outside, and the present file does not have it so"
            yield Problem(sink.at, what, "listen on 127.0.0.1, or change that on the gateway first")
    ports = {channel.port for channel in old.channels.values()}
    for channel in new.channels.values():
        if channel.port not in ports and writes_files(channel.port):
            what = f"the port '{channel.port}' writes into a file, and the present file does not have it"
            yield Problem(channel.port_at, what, "name another port")
    here = Path(os.path.realpath(new.folder))
    for name in new.files:
        path = Path(os.path.realpath(name))
        if name in own:
            continue
        if not path.is_relative_to(here):
            what = f"'{name}' is not in the folder of the run file"
            yield Problem(new.at, f"{what}, and a rolled file writes nothing elsewhere", "name a file in that folder")
        elif path in file.companions or _is_taken(Path(name)):
            what = f"'{name}', or a file named after it, is there already, and neither this run nor the last has it"
            yield Problem(new.at, what, "name a file that is not there")


def _is_taken(path: Path) -> bool:
    """Whether a file is there, or one that the same sink would name so: those before it, parts of it."""
    if os.path.lexists(path):
        return True
    try:
        names = os.listdir(path.parent)
    except OSError:
        return False
    put_aside = f"{path.stem}."
    return any(
        one.startswith(path.name) or (path.suffix and one.startswith(put_aside) and one.endswith(path.suffix))
        for one in names
    )


def _in_essence(sink: SinkKind) -> str:
    """What a sink is but for which points go there, and how often."""
    return fingerprint(replace(sink, points=("*",), every=None))


def _is_local(host: str) -> bool:
    with suppress(ValueError):
        return ip_address(host).is_loopback
    return host == "localhost"


def _files_of_before(path: Path, file: ReplacedFile) -> tuple[str, ...]:
    """Those that the run of before wrote."""
    try:
        return load_run(path, file.before.read_text("utf-8")).files
    except (OSError, ValueError):
        return ()


def _utc(moment: datetime) -> str:
    return moment.isoformat(timespec="seconds").replace("+00:00", "Z")

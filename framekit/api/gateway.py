"""A run that is one of a fleet: it tells a broker how it is, and takes run files that are rolled out to it.

A rolled file is checked here as `framekit check` does it. What can be changed while the run goes on is changed so; for
everything else the run ends when no exchange is under way, and begins anew with the other file. The file of before is
kept beside it as NAME.before. At any moment the run file is the old one or the new one, whole.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import os
import secrets
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from framekit import __version__
from framekit.api.errors import RequestError
from framekit.api.fleet import (
    BIRTH,
    HEALTH,
    LARGEST_MESSAGE,
    NO,
    ONLINE,
    ROLL,
    ROLLED,
    YES,
    as_message,
    digest_of,
    from_message,
    signature,
    topic,
)
from framekit.api.run import RunCalls, content_of, reasons
from framekit.definition.problems import DefinitionError, Problem
from framekit.definition.sources import fingerprint
from framekit.run.edit import Edit
from framekit.run.model import RunModel
from framekit.runfile.fleet import FleetSection
from framekit.runfile.run_file import load_run
from framekit.sinks.broker import KEEPALIVE
from framekit.sinks.secrets import Secret

if TYPE_CHECKING:
    from paho.mqtt.client import Client

log = logging.getLogger(__name__)

HEALTH_EVERY = 2_000_000_000
"""How often a gateway looks at its health (ns); what has changed is told."""
MOST_TOLD = 50
"""So many problems of a file, and so many names of a kind of trouble, are told."""
SHORTEST_TOKEN = 12
LONGEST_WAIT = 60
"""Seconds until a lost broker is tried again, at most."""


class Gateway:
    """The place of one run file in its fleet, while runs of it come and go; `with` tells the fleet of its end.

    To be used in a running loop. `over` is set when the run that is at work has to end because `next_run` is to begin.
    Raises RequestError without the library, and for a token that cannot be read.
    """

    def __init__(self, path: Path, model: RunModel) -> None:
        fleet: FleetSection = model.fleet
        self.path, self.fleet, self.name = path, fleet, fleet.gateway
        self.over = asyncio.Event()
        self.next_run: RunModel | None = None
        self._model = model
        self._run: RunCalls | None = None
        self._loop = asyncio.get_running_loop()
        self._number = ""
        self._began = datetime.now(UTC)
        self._health: dict[str, Any] | None = None
        self._rolling: dict[str, Any] | None = None
        self._before: tuple[RunModel, bytes] | None = None
        self._failed: list[str] = []
        self._tasks: set[asyncio.Task[None]] = set()
        try:
            self._token = "" if fleet.token is None else fleet.token.read()
            if self._token and len(self._token) < SHORTEST_TOKEN:
                what = f"the token has {len(self._token)} characters"
                raise ValueError(f"{what} – give {SHORTEST_TOKEN} or more")
            self._client = fleet.access.client(f"framekit-{fleet.group}-{self.name}", reconnects=True)
        except ModuleNotFoundError:
            raise RequestError("fleet: needs the library paho-mqtt – pip install 'framekit[mqtt]'") from None
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
        if self._client.is_connected():
            self._client.publish(self._topic(ONLINE), NO, 1, retain=True).wait_for_publish(1)
        self._client.disconnect()
        self._client.loop_stop()

    def _topic(self, what: str) -> str:
        return topic(self.fleet.group, self.name, what)

    # ---- what it tells ------------------------------------------------------------------------------------

    def begins(self, run: RunCalls) -> None:
        """A run that is about to start is the one that is told of from now on."""
        self._run, self._health = run, None
        run.each(HEALTH_EVERY, self._look)

    def has_begun(self) -> None:
        """The run of `begins` has started, and tells of itself: with that a rolled file is applied, or refused."""
        self.over.clear()
        failed, self._failed = self._failed, []
        self.next_run = self._before = None
        if failed:
            self._refuse(failed)
        elif self._rolling is not None:
            self._end_rolling("begun anew")
        else:
            self._bear()

    def has_failed(self, why: list[str]) -> RunModel:
        """The next run could not begin: the file of before is put back. Gives its run, which is to begin instead."""
        assert self._before is not None
        self._model, content = self._before
        replace_whole(self.path, content)
        self._failed = why
        return self._model

    def _bear(self) -> None:
        """Tells what this gateway is. The number in it signs one rolled file."""
        self._number = secrets.token_hex(16) if self._token else ""
        content = content_of(self.path) or b""
        birth = {
            "run": self._model.name,
            "about": self._model.about,
            "version": __version__,
            "began": self._began.isoformat(timespec="seconds").replace("+00:00", "Z"),
            "file": digest_of(content),
            "channels": len(self._model.channels),
            "points": len(self._model.points),
            **({"number": self._number} if self._number else {}),
        }
        self._client.publish(self._topic(BIRTH), as_message(birth), 1, retain=True)
        self._client.publish(self._topic(ONLINE), YES, 1, retain=True)
        if self._health is not None:
            self._client.publish(self._topic(HEALTH), as_message(self._health), 1, retain=True)

    def _look(self) -> None:
        """Tells the health where it is another one."""
        if self._run is None:
            return
        health = health_of(self._run)
        if health != self._health:
            self._health = health
            if self._client.is_connected():
                self._client.publish(self._topic(HEALTH), as_message(health), 1, retain=True)

    # ---- rolled files -------------------------------------------------------------------------------------

    def _heard(self, payload: bytes) -> None:
        """A file comes. What is not signed rightly is answered with nothing but that."""
        data = from_message(payload)
        identity, text, signed = (data.get(key) for key in ("id", "file", "signature"))
        if not (isinstance(identity, str) and isinstance(text, str) and isinstance(signed, str)):
            log.warning("fleet: a message to %s is no rolled file", self._topic(ROLL))
            return
        self_said = {"id": identity[:64]}
        content = text.encode(errors="replace")
        wanted = signature(self._token, self.fleet.group, self.name, self._number, identity, content)
        if not self._number or not hmac.compare_digest(wanted, signed):
            log.warning("fleet: a file that was rolled out is not signed with the token, or was sent before")
            self._answer(self_said, problems=["it is not signed with the token of this gateway, or was sent before"])
            return
        if self._rolling is not None or self.next_run is not None:
            self._answer(self_said, problems=["another file is being applied – try again"])
            return
        self._rolling = self_said
        task = self._loop.create_task(self._roll(text, content))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _roll(self, text: str, content: bytes) -> None:
        log.info("fleet: a run file of %d bytes is rolled out", len(content))
        before = content_of(self.path)
        try:
            model = await asyncio.to_thread(load_run, self.path, text)
            problems = list(more_than(self._model, model, self.path.parent))
            if problems:
                raise DefinitionError(problems)
        except ValueError as error:
            self._refuse(reasons(error))
            return
        run = self._run
        if run is None or not run.running or before is None:
            self._refuse(["the run is not at work"])
            return

        def applied(edit: Edit) -> None:
            if self._put(content, before):
                self._model = model
                self._end_rolling(f"applied while it goes on: {edit}")

        def ended(edit: Edit) -> None:
            if self._put(content, before):
                self._before = self._model, before
                self._model = self.next_run = model
                self.over.set()

        try:
            run.edit(model, applied)
        except ValueError:  # it takes a new start, when no exchange is under way
            try:
                run.edit(replace(self._model, blocks=()), ended)
            except ValueError as error:
                self._refuse(reasons(error))

    def _put(self, content: bytes, before: bytes) -> bool:
        """The file is replaced, and kept as it was before; a refusal where the system does not let it."""
        try:
            replace_whole(self.path.with_name(f"{self.path.name}.before"), before)
            replace_whole(self.path, content)
        except OSError as error:
            self._refuse([f"the file cannot be replaced: {error.strerror or error}"])
            return False
        return True

    def _refuse(self, problems: list[str]) -> None:
        folder = f"{self.path.parent.resolve()}{os.sep}"
        told = [one.replace(folder, "") for one in problems[:MOST_TOLD]]
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
        if self._token:
            client.subscribe(self._topic(ROLL), 1)
        self._in_loop(self._bear)

    def _message(self, client: Client, data: Any, message: Any) -> None:
        if not message.retain:
            payload = bytes(message.payload[: LARGEST_MESSAGE + 1])
            self._in_loop(lambda: self._heard(payload))

    def _in_loop(self, action: Any) -> None:
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
        "down": [channel.number for channel in status.channels if channel.state != "open"][:MOST_TOLD],
        "failing": failing[:MOST_TOLD],
        "bad": [name for name, point in points.items() if point.quality != "good"][:MOST_TOLD],
        "sinks": sinks[:MOST_TOLD],
        "problems": run.problems[:MOST_TOLD],
    }


def more_than(old: RunModel, new: RunModel, folder: Path) -> Iterator[Problem]:
    """What a rolled file may not say: another fleet, secrets that the present file does not name, files elsewhere."""
    if new.fleet is None or fingerprint(new.fleet) != fingerprint(old.fleet):
        at = new.at if new.fleet is None else new.fleet.at
        yield Problem(at, "a rolled file stays in its fleet, and says the same of it", "change that on the gateway")
    known = set(_secrets(old))
    for sink in new.sinks:
        for secret in set(_secrets(sink)) - known:
            what = f"a rolled file names a secret that the present one does not: {secret.kind}:{secret.name}"
            yield Problem(sink.at, what, "name it on the gateway first")
    here = folder.resolve()
    for file in new.files:
        if file not in old.files and not Path(file).resolve().is_relative_to(here):
            what = f"'{file}' is not in the folder of the run file"
            yield Problem(new.at, f"{what}, and a rolled file writes nothing elsewhere", "name a file in that folder")


def _secrets(value: Any) -> Iterator[Secret]:
    """Those that parts of a run name."""
    if isinstance(value, RunModel):
        for part in (*value.sinks, value.fleet):
            yield from _secrets(part)
    elif is_dataclass(value) and not isinstance(value, type):
        for one in fields(value):
            part = getattr(value, one.name)
            if isinstance(part, Secret):
                yield part


def replace_whole(path: Path, content: bytes) -> None:
    """A file has this content from one moment to the next, whatever happens. Raises OSError."""
    part = path.with_name(f".{path.name}.part")
    with part.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    if path.exists():
        part.chmod(path.stat().st_mode & 0o777)
    os.replace(part, path)

"""A gateway of a fleet: a run that publishes its health to a broker and takes run files from there.

A rolled file is checked first (`rolled_file`). The gateway then replaces its run file and edits the run in place. If
the change needs a restart, the run ends as soon as no exchange is open, and starts with the new file. The old file is
restored if that fails. At any moment the run file is completely the old one or completely the new one.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import secrets
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from framekit import __version__
from framekit.api.errors import RequestError
from framekit.api.replaced_file import ReplacedFile, digest_of
from framekit.api.run import RunCalls, content_of
from framekit.definition.fingerprint import fingerprint
from framekit.definition.problems import DefinitionError, error_text, library_missing
from framekit.extras.fleet.fleet import (
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
from framekit.extras.fleet.rolled_file import MOST_REPORTED, check_apart, files_of_before, more_than, refusal
from framekit.extras.fleet.section import FleetSection
from framekit.run.edit import Edit
from framekit.run.model import RunModel
from framekit.runfile.run_file import load_run
from framekit.sinks.broker import KEEPALIVE

if TYPE_CHECKING:
    from paho.mqtt.client import Client

log = logging.getLogger(__name__)

HEALTH_EVERY = 2_000_000_000
"""Period of the health check (ns); changes are published."""
SHORTEST_TOKEN = 12
LONGEST_HOLD = 30
"""Longest time (s) for which a rolled file waits for the end of an exchange."""
LONGEST_WAIT = 60
"""Longest pause before a lost broker is tried again (s)."""


class Gateway:
    """The membership of one run file in its fleet, over all runs of the file; `with` publishes its end.

    `content` is the text that `model` was loaded from. Use it in a running loop. `over` is set when the current run
    must end because `next_run` must begin. Raises RequestError without the library, and for a token that cannot be
    read.
    """

    def __init__(self, path: Path, model: RunModel, content: bytes) -> None:
        fleet: FleetSection = model.fleet
        self.path, self.fleet, self.name = path, fleet, fleet.gateway
        self.over = asyncio.Event()
        self.next_run: RunModel | None = None
        self._file = ReplacedFile(path)
        self._model, self._content = model, content
        self._before: tuple[RunModel, bytes] | None = None
        """Model and content to restore if the trial of a rolled file fails; None without a trial."""
        self._failed: list[str] = []
        self._own_files = {*model.files, *files_of_before(path, self._file)}
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

    # ---- birth and health ---------------------------------------------------------------------------------

    def begins(self, run: RunCalls) -> None:
        """Publish the health of this run from now on; it starts next."""
        self._run, self._health = run, {}
        run.each(HEALTH_EVERY, self._look)

    def has_begun(self) -> None:
        """Publish the birth of the started run, and answer the rolled file that it runs or has failed to run."""
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

    def has_failed(self, error: Exception) -> RunModel:
        """Restore the previous file because the next run could not begin; return the previous run, to begin instead."""
        self._failed = [*refusal(error, self.path), *self._put_back()]
        return self._model

    def edited(self, model: RunModel, content: bytes) -> None:
        """Publish the run after an edit at the gateway itself."""
        self._model, self._content = model, content
        self._bear()

    def _bear(self) -> None:
        """Publish the birth of this gateway. Its number signs one rolled file."""
        if self._token and not self._number:
            self._number = secrets.token_hex(16)
        if not self._client.is_connected():
            return  # the connection publishes it later
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
        """Publish the health when it has changed, and every `SIGN_OF_LIFE` seconds."""
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
        """Accept a rolled file. Answer a badly signed file with an error only."""
        data = from_message(payload)
        identity, text, signed = (data.get(key) for key in ("id", "file", "signature"))
        if not (isinstance(identity, str) and isinstance(text, str) and isinstance(signed, str)):
            log.warning("fleet: a message to %s is no rolled file", self._topic(ROLL))
            return
        if data.get("instance") != self._instance:
            return  # it is for another gateway with the same name
        answer = {"id": identity[:64].encode(errors="backslashreplace").decode()}
        content = text.encode(errors="backslashreplace")
        wanted = signature(self._token, self.fleet.group, self.name, self._number, answer["id"], content)
        if not self._number or not hmac.compare_digest(wanted.encode(), signed.encode(errors="backslashreplace")):
            log.warning("fleet: a file that was rolled out is not signed with the token, or was sent before")
            self._answer(answer, problems=["it is not signed with the token of this gateway, or was sent before"])
            return
        self._number = ""
        if self._rolling is not None or self.next_run is not None:
            self._bear()
            self._answer(answer, problems=["another file is being applied – try again"])
            return
        self._rolling = answer
        task = self._loop.create_task(self._roll(content))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _roll(self, content: bytes) -> None:
        """Check a rolled file, then put it on trial and change the run; a refusal changes no file."""
        log.info("fleet: a run file of %d bytes is rolled out", len(content))
        if content == self._content == content_of(self.path):
            self._end_rolling("it is this file already; what it names beside counts from a new start on")
            return
        try:
            self._refuse_unfit(content)
            await check_apart(self.path, content)
            model = await asyncio.to_thread(self._loaded, content)
            run = self._run
            if run is None or not run.running:
                raise ValueError("the run is not at work")
            self._put(model, content)
        except ValueError as error:
            self._refuse(refusal(error, self.path))
            return
        except Exception as error:  # after any failure this gateway takes the next file
            log.exception("fleet: a rolled file")
            self._refuse(refusal(error, self.path))
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
            except ValueError:  # the change needs a restart, when no exchange is open
                run.edit(replace(now, blocks=()), ended)
        except Exception as error:
            waits.cancel()
            log.debug("fleet: a rolled file", exc_info=True)
            self._take_back(refusal(error, self.path))

    def _give_up(self, run: RunCalls, now: RunModel) -> None:
        """Refuse a file that waits too long for the end of an exchange; the wait holds all channels."""
        if self._before is None or self.next_run is not None:
            return
        run.edit(now)  # cancels the waiting edit and releases the channels
        self._take_back([f"an exchange has not ended within {LONGEST_HOLD} s – try again"])

    def _refuse_unfit(self, content: bytes) -> None:
        """Raise ValueError if the file is too large, or the present run file is not the one that was loaded."""
        if len(content) > LARGEST_FILE:
            raise ValueError(f"the file has {len(content)} bytes – {LARGEST_FILE} at most are rolled out")
        if content_of(self.path) != self._content:
            raise ValueError("the run file was edited at the gateway since the run began – start the run anew there")

    def _loaded(self, content: bytes) -> RunModel:
        """Return the run of a checked file. Raises DefinitionError if the file exceeds its rights."""
        model = load_run(self.path, content.decode())
        if problems := list(more_than(self._model, model, self._file, self._own_files)):
            raise DefinitionError(problems)
        return model

    def _put(self, model: RunModel, content: bytes) -> None:
        """Replace the run file by `content`, on trial. Raises ValueError; then the file is unchanged."""
        try:
            self._file.put(content)
        except OSError as error:
            raise ValueError(f"the file cannot be replaced: {error_text(error)}") from None
        self._before = self._model, self._content
        self._model, self._content = model, content

    def _keep(self) -> None:
        """End the trial; the new file stays."""
        self._before = None
        self._own_files |= set(self._model.files)
        try:
            self._file.keep()
        except OSError as error:
            log.warning("fleet: the trial of a rolled file is not noted to be over: %s", error)

    def _put_back(self) -> list[str]:
        """End the trial and restore the previous file; return the problems of the restoration."""
        if self._before is None:
            return []
        self._model, self._content = self._before
        self._before = None
        try:
            self._file.put_back()
        except OSError as error:
            return [f"the file of before cannot be put back: {error_text(error)}"]
        return []

    def _take_back(self, why: list[str]) -> None:
        self._refuse([*why, *self._put_back()])

    def _refuse(self, problems: list[str]) -> None:
        reported = problems[:MOST_REPORTED]
        if len(problems) > MOST_REPORTED:
            reported.append(f"and {len(problems) - MOST_REPORTED} more")
        log.warning("fleet: a rolled file is refused: %s", reported[0] if reported else "")
        self._end_rolling("", reported)

    def _end_rolling(self, how: str, problems: list[str] | None = None) -> None:
        """Answer the sender of the rolled file, after publishing the birth with a new number."""
        answer, self._rolling = self._rolling, None
        self._bear()
        if answer is not None:
            self._answer(answer, how, problems)

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
        """Handle a message to a topic of this gateway: a rolled file, or the health of another gateway with the same
        name.
        """
        if message.retain:
            return
        what = message.topic.rpartition("/")[2]
        payload = bytes(message.payload[: LARGEST_MESSAGE + 1])
        if what == ROLL:
            self._in_loop(lambda: self._heard(payload))
        elif what == HEALTH:
            if from_message(payload).get("instance") != self._instance:
                self._in_loop(self._is_not_alone)
        elif payload == NO:  # the will of an earlier connection; this gateway is online
            self._in_loop(self._bear)

    def _is_not_alone(self) -> None:
        if time.monotonic() - self._other_seen >= STALE_AFTER:
            log.warning("fleet: another gateway of the fleet '%s' is called '%s' too", self.fleet.group, self.name)
        self._other_seen = time.monotonic()

    def _in_loop(self, action: Callable[[], None]) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(action)


def health_of(run: RunCalls) -> dict[str, Any]:
    """Return the troubles of a run by kind; all lists are empty when all is well."""
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
        ][:MOST_REPORTED],
        "failing": failing[:MOST_REPORTED],
        "bad": [name for name, point in points.items() if point.quality != "good"][:MOST_REPORTED],
        "sinks": sinks[:MOST_REPORTED],
        "problems": run.problems[:MOST_REPORTED],
    }


def _utc(moment: datetime) -> str:
    return moment.isoformat(timespec="seconds").replace("+00:00", "Z")

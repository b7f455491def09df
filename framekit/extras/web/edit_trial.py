"""Try a protocol in the editor: one request to a simulated device, or some seconds of a run, on a virtual clock.

The line is simulated: no byte leaves the process, and an exchange takes no real time.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from framekit.api.errors import FramekitError
from framekit.api.monitor import field_rows
from framekit.api.rows import field_row, meaning_of
from framekit.api.run import VirtualRun
from framekit.api.settings import checked_station, line_settings
from framekit.codec.codec import compile_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import FormPart, Literally, Maybe
from framekit.definition.nodes import read_nodes
from framekit.definition.problems import DefinitionError, plural
from framekit.definition.schema import kind_of
from framekit.link.addresses import AddressGrammar
from framekit.link.events import Seen
from framekit.link.services.client import Done, ServiceClient, Transfer, TransferResult
from framekit.runfile.devices import load_devices
from framekit.runfile.run_file import load_run
from framekit.service.client import ClientService
from framekit.service.device import SIMULATED, port_for
from framekit.transport.clock import VirtualClock

Answer = dict[str, Any]

LONGEST = 60_000_000_000
"""Time limit of a request, in the time of the virtual clock (ns)."""
MOST_CALLS = 200_000
"""Largest number of timers of a trial."""
MOST_FRAMES = 100
"""Largest number of frames that are shown."""
RUN_FOR = "5 s"
"""Time of a run that is tried."""
_NUMBERS = (1, 0, 10)
"""Numbers that are tried in an address."""


def offer(path: Path) -> Answer:
    """Return the services that can be tried: name and arguments; with an address and a station to begin with."""
    try:
        if kind_of(read_nodes(path, noted=[])) == "run":
            return {"services": [], "run": RUN_FOR}
        device = load_devices(path, path.parent)[0]
    except (DefinitionError, FramekitError) as error:
        return {"services": [], "why": _reason(error)}
    protocol = device.protocol
    rows = {
        name: list(dict.fromkeys(one.name for row in found for one in row.takes))
        for name, found in protocol.services.items()
    }
    return {
        "services": [[name, takes] for name, takes in rows.items()],
        "address": next(addresses_of_forms(protocol), ""),
        "station": device.station,
        "why": "" if rows else f"'{protocol.name}' has no services that can be tried",
    }


def addresses_of_forms(protocol: Protocol) -> Iterator[str]:
    """Yield addresses that fit the forms of a protocol."""
    grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
    for form in protocol.addresses:
        for area in protocol.areas or ("",):
            for number in _NUMBERS:
                text = "".join(_filled(part, area, number) for part in form.parts)
                with suppress(ValueError):
                    grammar.parse(text)
                    yield text


def _filled(part: Literally | FormPart | Maybe, area: str, number: int) -> str:
    """Return a text for a part of an address form."""
    match part:
        case Literally(text=text):
            return text
        case FormPart(what="area"):
            return area
        case FormPart(what="number", least=least):
            return str(number).zfill(least if isinstance(least, int) else 1)
        case FormPart():
            return "A"
    return ""


def trial(path: Path, service: str, address: str, values: str, station: str) -> Answer:
    """Return the frames of a request and its result; of a run, its frames of the first seconds.

    `values`: elements to write, or arguments of a service as NAME=VALUE; separated by blanks.
    """
    try:
        if kind_of(read_nodes(path, noted=[])) == "run":
            return _run_trial(path)
        return _request_trial(path, service, address.strip(), values.split(), station.strip())
    except (DefinitionError, FramekitError, ValueError) as error:
        return {"why": _reason(error)}


def _reason(error: Exception) -> str:
    """Return the reason of an error; of a definition, its first problem."""
    if not isinstance(error, DefinitionError):
        return str(error)
    problem = error.problems[0]
    return f"{problem.what} – {problem.todo}" if problem.todo else problem.what


def _request_trial(path: Path, service: str, address: str, values: list[str], station: str) -> Answer:
    devices = load_devices(path, path.parent)
    protocol = devices[0].protocol
    named = station or ("" if devices[0].own is None else devices[0].station)
    settings = line_settings(protocol, "sim:device", station=named or None)
    own = checked_station(protocol, "1") if settings.names_own else None
    clock, seen = VirtualClock(), list[Seen]()
    port, services = port_for(settings.channel(), list(devices), clock)
    client = ClientService(
        protocol, port, clock, role=settings.role, line=settings.line, own=own, monitor=seen.append
    )  # fmt: skip
    for one in services:
        one.start()
    client.start()
    clock.run_for(0)
    results: list[TransferResult] = []

    def begin(asks: ServiceClient, now: int, done: Done) -> Transfer:
        if service == "read":
            return asks.read(address, station=settings.station, now=now, on_done=done)
        if service == "write":
            numbers = [_number(value) for value in values]
            return asks.write(address, numbers, station=settings.station, now=now, on_done=done)
        places = (address,) if address else ()
        return asks.call(service, _arguments(values), station=settings.station, addresses=places, now=now, on_done=done)

    client.request(begin, results.append)
    calls, end = 0, clock.now() + LONGEST
    while not results and calls < MOST_CALLS and clock.now() < end and clock.advance():
        calls += 1
    client.stop()
    for one in services:
        one.end()
    return {
        "result": _result(results),
        "frames": [_shown(protocol, one) for one in islice(filter(_is_shown, seen), MOST_FRAMES)],
    }


def _number(text: str) -> int:
    """Return a whole number. Raise ValueError."""
    try:
        return int(text, 0)
    except ValueError:
        raise ValueError(f"'{text}' is not a whole number – write 10 or 0x0A") from None


def _arguments(values: list[str]) -> dict[str, Any]:
    """Return arguments of `NAME=VALUE`: whole numbers, else texts. Raise ValueError."""
    found: dict[str, Any] = {}
    for text in values:
        name, equals, value = text.partition("=")
        if not equals:
            raise ValueError(f"'{text}' is not NAME=VALUE")
        found[name] = int(value, 0) if re.fullmatch(r"-?(0x[0-9A-Fa-f]+|[0-9]+)", value) else value
    return found


def _result(results: list[TransferResult]) -> str:
    """Return the end of a request in words."""
    if not results:
        return "The request has not ended"
    result = results[0]
    if not result.ok:
        return ": ".join(part for part in (result.outcome, result.cause or result.meaning) if part)
    given = [f"{name} {value}" for name, value in result.gives.items()]
    values = ["values " + ", ".join(map(str, result.values[:32]))] if result.values else []
    return "Done" + "".join(f" · {part}" for part in (*values, *given))


def _is_shown(seen: Seen) -> bool:
    return seen.kind in ("frame", "bad", "noise")


def _shown(protocol: Protocol, seen: Seen) -> list[Any]:
    """Return time (ms), direction, name, bytes, rows of fields and fault of a frame."""
    rows = field_rows(compile_protocol(protocol), protocol, seen) if seen.frame in protocol.frames else []
    fault = [seen.reason, seen.place] if seen.kind == "bad" else None
    fields = [[*field_row(row), row.offset, len(row.data)] for row in rows]
    return [f"{seen.at / 1e6:.3f}", seen.direction, meaning_of(seen), seen.raw.hex(), fields, fault]


def _run_trial(path: Path) -> Answer:
    """Return the frames of the first seconds of a run; sinks, its state and its fleet are left out."""
    model = load_run(path)
    real = next((one for one in model.channels.values() if not one.port.startswith(SIMULATED)), None)
    if real is not None:
        raise ValueError(f"Channel {real.number} has a real port – write port: sim:FILE to try the run")
    if model.jobs is not None:
        raise ValueError("A run with jobs opens real ports – try it with framekit run")
    model = replace(model, sinks=(), state=None, files=(), fleet=None)
    frames: list[list[Any]] = []

    def monitor(channel: int, seen: Seen) -> None:
        if len(frames) < MOST_FRAMES and _is_shown(seen):
            frames.append(_shown(model.channels[channel].protocol, seen))

    with VirtualRun(model, monitor=monitor) as run:
        run.run_for(RUN_FOR)
        blocks = run.blocks
    result = f"{RUN_FOR} of the run: {plural(sum(one.done for one in blocks), 'exchange')} done"
    failed = [f"{one.label} {one.last_failure}" for one in blocks if one.failed]
    return {"result": result + f", failed: {'; '.join(failed[:8])}" * bool(failed), "frames": frames}

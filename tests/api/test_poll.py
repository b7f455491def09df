"""`AsyncClient.poll`: values and types as `read` has them, ends and errors, on TCP and on simulated devices.

What takes time, and replies that are not good, is in tests/service/test_polling.py, on the virtual clock.
"""

from __future__ import annotations

import asyncio
import functools
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from api_world import device_file
from service.test_ending import DEVICE, PROTOCOL

import framekit

QUICK = {"reply_timeout": "50 ms"}
PATIENT = {"reply_timeout": "20 s"}
"""Time-out for replies that do arrive: a busy machine may need more than 50 ms for a reply."""


class Registers:
    """A Modbus device on TCP: `held` returns its registers for every request, `change` modifies its replies.

    `change` gets the number of the request and the good reply; if it returns None, the connection is closed.
    """

    def __init__(self) -> None:
        self.asked = 0
        self.held: Callable[[int], list[int]] = lambda number: [number, number + 1, number + 2]
        self.change: Callable[[int, bytes], list[bytes] | None] = lambda number, reply: [reply]

    async def __aenter__(self) -> Registers:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = f"tcp://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                request = await reader.readexactly(12)
                pieces = self.change(self.asked, self._reply(request))
                self.asked += 1
                if pieces is None:
                    break
                for piece in pieces:
                    writer.write(piece)
                    await writer.drain()
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        writer.close()

    def _reply(self, request: bytes) -> bytes:
        count = int.from_bytes(request[10:12], "big")
        words = (self.held(self.asked) * count)[:count]
        body = bytes([3, 2 * count]) + b"".join(word.to_bytes(2, "big") for word in words)
        return request[:4] + (len(body) + 1).to_bytes(2, "big") + request[6:7] + body


class Kept:
    """The values and errors that a poll has reported; `enough` waits for a number of them."""

    def __init__(self) -> None:
        self.values: list[tuple[Any, ...]] = []
        self.errors: list[framekit.FramekitError] = []
        self._news = asyncio.Event()

    def on_values(self, values: tuple[Any, ...]) -> None:
        self.values.append(values)
        self._news.set()

    def on_error(self, error: framekit.FramekitError) -> None:
        self.errors.append(error)
        self._news.set()

    async def enough(self, values: int = 0, errors: int = 0) -> None:
        while len(self.values) < values or len(self.errors) < errors:
            await self._news.wait()
            self._news.clear()


def run(scenario: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(scenario(), 180))


@pytest.fixture(params=["unwatched", "watched"])
def watch(request: pytest.FixtureRequest) -> dict[str, Any]:
    return {"monitor": lambda seen: None} if request.param == "watched" else {}


# ---- values -----------------------------------------------------------------------------------------------------


def test_values_are_those_of_each_reply(watch: dict[str, Any]) -> None:
    async def scenario() -> None:
        async with Registers() as device, framekit.aconnect("modbus-tcp", device.port, station=1, **watch) as client:
            kept = Kept()
            poll = client.poll("40001", 3, on_values=kept.on_values)
            await kept.enough(30)
            assert poll.is_running
            assert (
                repr(poll)
                == f"<Poll of 3 × word from 40001 on, without pause: {poll.reads} reads, 0 failures, running>"
            )
            poll.stop()
            await poll
            assert not poll.is_running and repr(poll).endswith(" reads, 0 failures, stopped>")
            assert kept.values == [(number, number + 1, number + 2) for number in range(len(kept.values))]
            assert (poll.reads, poll.failures) == (len(kept.values), 0)

    run(scenario)


TYPES: list[tuple[str, str | None, int, Any]] = [
    ("word", None, 4, [1, 2, 0xFFFF, 0]),
    ("int16", None, 2, [-2, 5]),
    ("uint32", "ABCD", 2, [0x12345678, 1]),
    ("float32", None, 2, [1.5, -2.25]),
    ("float32", "ABCD", 2, [1.5, -2.25]),
    ("float64", "DCBA", 1, [0.1]),
    ("string", None, 5, "Hello"),
]


@pytest.mark.parametrize(("type_", "order", "count", "values"), TYPES)
@pytest.mark.parametrize("protocol", ["modbus-tcp", "modbus-rtu"])
def test_types_are_those_of_read(
    tmp_path: Path, protocol: str, type_: str, order: framekit.Order | None, count: int, values: Any,
    watch: dict[str, Any],
) -> None:  # fmt: skip
    async def scenario() -> None:
        port = f"sim:{device_file(tmp_path, protocol)}"
        async with framekit.aconnect(protocol, port, station=7, **watch) as client:
            await client.write("40021", values, type=type_, order=order)
            kept = Kept()
            poll = client.poll("40021", count, type=type_, order=order, on_values=kept.on_values)
            await kept.enough(4)
            poll.stop()
            read = await client.read("40021", count, type=type_, order=order)
            assert set(kept.values) == {tuple(read)}
            assert list(read) == ([values] if isinstance(values, str) else values)

    run(scenario)


LINES: dict[str, tuple[str, str, str, dict[str, Any]]] = {
    "modbus-tcp": ("40001: [100, 200, 300]", "40001", "station: 7", {}),
    "modbus-rtu": ("40001: [100, 200, 300]", "40001", "station: 7", {}),
    "modbus-ascii": ("40001: [100, 200, 300]", "40001", "station: 7", {}),
    "mldp": ("D100: [100, 200, 300]", "D100", "station: 7", {}),
    "df1": ("N7:0: [100, -200, 300]", "N7:0", "station: 7", {"own": 1, "params": {"node": 1}}),
}
"""By protocol: device memory, address, station, and own parameters of the client."""


def _port(folder: Path, protocol: str) -> str:
    values, _, station, _ = LINES[protocol]
    path = folder / "there.device.yaml"
    own = "role: full\nparams: {node: 7}\n" if protocol == "df1" else ""
    text = f'device: there\nprotocol: {protocol}\n{station}\n{own}memory: {{set: {{"{values.split(": ")[0]}": '
    path.write_text(text + values.split(": ")[1] + "}}\n", encoding="utf-8")
    return f"sim:{path}"


@pytest.mark.parametrize("protocol", LINES)
def test_protocols_with_a_short_way_and_without(tmp_path: Path, protocol: str, watch: dict[str, Any]) -> None:
    async def scenario() -> None:
        held, address, _, settings = LINES[protocol]
        first = tuple(json.loads(held.partition(": ")[2]))
        role = {"role": "full"} if protocol == "df1" else {}
        port = _port(tmp_path, protocol)
        async with framekit.aconnect(protocol, port, station=7, **role, **settings, **watch) as client:
            kept = Kept()
            poll = client.poll(address, 3, on_values=kept.on_values)
            await kept.enough(3)
            assert set(kept.values) == {first}
            await client.write(address, [1, 2, 3])
            before = len(kept.values)
            read = await client.read(address, 3)
            await kept.enough(before + 4)
            poll.stop()
            assert tuple(read) == (1, 2, 3) == kept.values[-1]
            assert set(kept.values[before + 1 :]) == {(1, 2, 3)}

    run(scenario)


def test_bits(tmp_path: Path, watch: dict[str, Any]) -> None:
    async def scenario() -> None:
        port = f"sim:{device_file(tmp_path, 'modbus-tcp')}"
        async with framekit.aconnect("modbus-tcp", port, station=7, **watch) as client:
            kept = Kept()
            client.poll("00001", 3, on_values=kept.on_values)
            await kept.enough(4)
            assert tuple(await client.read("00001", 3)) == (1, 0, 1)
            await client.write("00002", 1)
            before = len(kept.values)
            await kept.enough(before + 3)
            assert kept.values[0] == (1, 0, 1) and kept.values[-1] == (1, 1, 1)

    run(scenario)


def test_places_that_usually_hold_something_else_are_read_so(tmp_path: Path) -> None:
    async def scenario() -> None:
        port = _port(tmp_path, "df1")
        async with framekit.aconnect("df1", port, station=7, role="full", own=1, params={"node": 1}) as client:
            await client.write("F8:0", [1.5, -2.25])
            kept = Kept()
            poll = client.poll("F8:0", 2, on_values=kept.on_values)
            await kept.enough(2)
            poll.stop()
            assert list(await client.read("F8:0", 2)) == [1.5, -2.25]
            assert set(kept.values) == {(1.5, -2.25)}

    run(scenario)


@pytest.mark.parametrize("how", ["two pieces", "byte by byte"])
def test_replies_in_pieces(how: str) -> None:
    async def scenario() -> None:
        async with Registers() as device, framekit.aconnect("modbus-tcp", device.port, station=1) as client:
            size = 1 if how == "byte by byte" else 7
            device.change = lambda number, reply: (
                [reply] if number % 3 else [reply[at : at + size] for at in range(0, len(reply), size)]
            )
            kept = Kept()
            poll = client.poll("40001", 2, on_values=kept.on_values)
            await kept.enough(20)
            poll.stop()
            assert kept.values == [(number, number + 1) for number in range(len(kept.values))]

    run(scenario)


# ---- side by side -------------------------------------------------------------------------------------------------


def test_two_polls_with_reads_and_writes_in_between(tmp_path: Path, watch: dict[str, Any]) -> None:
    async def scenario() -> None:
        port = f"sim:{device_file(tmp_path, 'modbus-tcp')}"
        async with framekit.aconnect("modbus-tcp", port, station=7, **watch) as client:
            first, second = Kept(), Kept()
            polls = [
                client.poll("40001", 2, on_values=first.on_values),
                client.poll("40003", 1, on_values=second.on_values, every=0.001),
            ]
            for number in range(20):
                await client.write("40003", number)
                assert (await client.read("40003"), await client.read("40001")) == ([number], [100])
            await first.enough(5)
            await second.enough(5)
            for poll in polls:
                poll.stop()
                await poll
            assert set(first.values) == {(100, 200)}
            numbers = [value for (value,) in second.values if value != 300]
            assert numbers == sorted(numbers), "never an older value after a newer one"

    run(scenario)


# ---- the end ----------------------------------------------------------------------------------------------------


def test_stopped_from_inside_and_twice() -> None:
    async def scenario() -> None:
        async with Registers() as device, framekit.aconnect("modbus-tcp", device.port, station=1) as client:
            values: list[tuple[int, ...]] = []

            def third(got: tuple[int, ...]) -> None:
                values.append(got)
                if len(values) == 5:
                    poll.stop()
                    poll.stop()

            poll = client.poll("40001", on_values=third)
            await poll
            await poll
            poll.stop()
            assert values == [(number,) for number in range(5)]
            assert (await client.read("40001")).value == 5, "nothing more has been asked"

    run(scenario)


@pytest.mark.parametrize("number", [1, 2, 5])
@pytest.mark.parametrize("type_", [None, "int16"])
def test_a_callback_that_raises_is_the_end(number: int, type_: str | None) -> None:
    async def scenario() -> None:
        async with Registers() as device, framekit.aconnect("modbus-tcp", device.port, station=1) as client:
            got: list[tuple[int, ...]] = []

            def raises(values: tuple[int, ...]) -> None:
                got.append(values)
                if len(got) == number:
                    raise LookupError("mine")

            poll = client.poll("40001", on_values=raises, type=type_)
            with pytest.raises(LookupError, match="mine"):
                await poll
            assert not poll.is_running and len(got) == number
            told = f"{poll.reads} reads, 0 failures, ended by LookupError('mine')>"
            assert repr(poll) == f"<Poll of 40001, without pause: {told}"
            assert (await client.read("40001")).value == number

    run(scenario)


def test_a_callback_for_errors_that_raises_is_the_end_as_well() -> None:
    async def scenario() -> None:
        async with (
            Registers() as device,
            framekit.aconnect("modbus-tcp", device.port, station=1, params=QUICK) as client,
        ):
            device.change = lambda number, reply: [reply] if number != 3 else []

            def raises(error: framekit.FramekitError) -> None:
                raise LookupError(type(error).__name__)

            poll = client.poll("40001", on_values=lambda values: None, on_error=raises)
            with pytest.raises(LookupError, match="NoReplyError"):
                await poll
            assert (poll.reads, poll.failures) == (3, 1)

    run(scenario)


def _refused(reply: bytes) -> list[bytes]:
    return [reply[:4] + b"\0\3" + reply[6:7] + b"\x83\2"]


def _too_long(reply: bytes) -> list[bytes]:
    return [reply[:4] + b"\0\7" + reply[6:8] + b"\4" + reply[9:] + b"\xab\xcd"]


FAILURES: dict[str, tuple[Callable[[bytes], list[bytes]], type[framekit.FramekitError]]] = {
    "no reply": (lambda reply: [], framekit.NoReplyError),
    "refused": (_refused, framekit.RefusedError),
    "a register more": (_too_long, framekit.ReplyError),
    "another number": (lambda reply: [bytes([reply[0] ^ 1]) + reply[1:]], framekit.NoReplyError),
}


def _patience(what: str) -> dict[str, str]:
    return QUICK if FAILURES[what][1] is framekit.NoReplyError else PATIENT


@pytest.mark.parametrize("what", FAILURES)
@pytest.mark.parametrize("number", [0, 1, 6])
def test_without_a_callback_an_error_is_the_end(what: str, number: int, watch: dict[str, Any]) -> None:
    async def scenario() -> None:
        make, kind = FAILURES[what]
        async with (
            Registers() as device,
            framekit.aconnect("modbus-tcp", device.port, station=1, params=_patience(what), **watch) as client,
        ):
            device.change = lambda asked, reply: make(reply) if asked == number else [reply]
            values: list[tuple[int, ...]] = []
            poll = client.poll("40001", on_values=values.append)
            with pytest.raises(kind):
                await poll
            assert values == [(asked,) for asked in range(number)]
            assert (poll.reads, poll.failures, poll.is_running) == (number, 1, False)
            assert (await client.read("40001")).value == number + 1

    run(scenario)


@pytest.mark.parametrize("what", FAILURES)
def test_with_a_callback_it_goes_on(what: str, watch: dict[str, Any]) -> None:
    async def scenario() -> None:
        make, kind = FAILURES[what]
        async with (
            Registers() as device,
            framekit.aconnect("modbus-tcp", device.port, station=1, params=_patience(what), **watch) as client,
        ):
            device.change = lambda asked, reply: make(reply) if asked in (0, 5, 6) else [reply]
            kept = Kept()
            poll = client.poll("40001", on_values=kept.on_values, on_error=kept.on_error)
            await kept.enough(12, 3)
            poll.stop()
            await poll
            assert [type(error) for error in kept.errors] == [kind] * 3
            wanted = [number for number in range(len(kept.values) + 3) if number not in (0, 5, 6)]
            assert kept.values == [(number,) for number in wanted]
            assert (poll.reads, poll.failures) == (len(kept.values), 3)

    run(scenario)


# ---- lines that close -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("every", [0.0, 60.0])
def test_closing_the_client_ends_its_polls(every: float) -> None:
    async def scenario() -> None:
        async with Registers() as device:
            client = await framekit.aconnect("modbus-tcp", device.port, station=1)
            kept = Kept()
            poll = client.poll("40001", on_values=kept.on_values, every=every)
            await kept.enough(1)
            await client.close()
            await poll
            told = len(kept.values)
            assert not poll.is_running and kept.errors == []
            with pytest.raises(framekit.LineClosedError):
                client.poll("40001", on_values=kept.on_values)
            await asyncio.sleep(0)
            assert len(kept.values) == told

    run(scenario)


def test_a_lost_connection_is_an_error_and_the_poll_goes_on_when_it_is_back() -> None:
    async def scenario() -> None:
        async with Registers() as device, framekit.aconnect("modbus-tcp", device.port, station=1) as client:
            device.change = lambda number, reply: None if number == 5 else [reply]
            kept = Kept()
            poll = client.poll("40001", on_values=kept.on_values, on_error=kept.on_error)
            await kept.enough(10, 1)
            poll.stop()
            assert {type(error) for error in kept.errors} == {framekit.LineClosedError}
            wanted = [number for number in range(len(kept.values) + 1) if number != 5]
            assert kept.values == [(number,) for number in wanted]

    run(scenario)


READING = (
    PROTOCOL.replace("{field: y, type: u8}", "{data: y, size: 1}")
    .replace("{answer: {y: 9}}", "{answer: {y: h'09'}}")
    .replace(
        "services:\n",
        """areas: {memory: {unit: byte, size: 100, access: rw}}
addresses: [{form: "B{start:dec}", area: memory}]
services:
  read: [{areas: [memory], limit: {count: 1}, request: {ask: {x: start}}, reply: {answer: {y: data}}}]
""",
    )
)
"""The protocol with sessions, and a byte that can be read."""


def test_closing_closes_the_session_although_a_poll_runs(tmp_path: Path) -> None:
    """Closing the client also ends its polls."""
    (tmp_path / "talk.yaml").write_text(READING, encoding="utf-8")
    (tmp_path / "there.device.yaml").write_text(DEVICE, encoding="utf-8")
    sent: list[str] = []

    async def scenario() -> None:
        port = f"sim:{tmp_path / 'there.device.yaml'}"
        client = framekit.aconnect(
            tmp_path / "talk.yaml", port, station=3, monitor=lambda seen: sent.append(seen.frame)
        )
        async with client:
            kept = Kept()
            client.poll("B1", on_values=kept.on_values)
            await kept.enough(3)

    run(scenario)
    ending = [frame for frame in sent if frame]
    assert ending[ending.index("bye") :][:3] == ["bye", "so_long", "bye"]


# ---- what cannot be asked -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"address": "4x"}, "is not an address"),
        ({"address": "40001", "count": 0}, "the count is 0"),
        ({"address": "40001", "type": "flaot32"}, "did you mean 'float32'"),
        ({"address": "40001", "station": "seven"}, "is not a whole number"),
        ({"address": "40001", "every": -1.0}, "every"),
        ({"address": "40001", "every": float("nan")}, "every"),
        ({"address": "40001", "every": float("inf")}, "every"),
        ({"address": "40001", "every": "1 s"}, "every is '1 s'"),
        ({"address": "40001", "every": None}, "every is None"),
        ({"address": 40001}, "write '40001'"),
        ({"address": ["40001", "40003"]}, "an address is a text"),
        ({"address": "40001", "count": 2.5}, "count is 2.5"),
    ],
)
def test_what_cannot_be_asked(tmp_path: Path, arguments: dict[str, Any], message: str) -> None:
    async def scenario() -> None:
        port = f"sim:{device_file(tmp_path, 'modbus-tcp')}"
        async with framekit.aconnect("modbus-tcp", port, station=7) as client:
            with pytest.raises(framekit.RequestError, match=message):
                client.poll(**arguments, on_values=lambda values: None)
            kept = Kept()
            poll = client.poll("40001", on_values=kept.on_values)
            await kept.enough(3)
            poll.stop()
            assert set(kept.values) == {(100,)}

    run(scenario)


async def _awaited(values: tuple[int, ...]) -> None: ...


@pytest.mark.parametrize("callback", [_awaited, functools.partial(_awaited), None, 3])
@pytest.mark.parametrize("name", ["on_values", "on_error"])
def test_callbacks_that_could_not_be_called(tmp_path: Path, name: str, callback: Any) -> None:
    """Calling a coroutine function as a callback would only create a coroutine; its values would be lost."""

    async def scenario() -> None:
        port = f"sim:{device_file(tmp_path, 'modbus-tcp')}"
        async with framekit.aconnect("modbus-tcp", port, station=7) as client:
            good: dict[str, Any] = {"on_values": lambda values: None, "on_error": lambda error: None}
            if name == "on_error" and callback is None:
                client.poll("40001", **good | {name: callback}).stop()
                return
            with pytest.raises(framekit.RequestError, match=f"{name} has to be a plain function"):
                client.poll("40001", **good | {name: callback})

    run(scenario)


# ---- waiting ------------------------------------------------------------------------------------------------------


def test_who_stops_waiting_stops_nothing_else() -> None:
    """Cancelling a waiter stops neither the poll nor other waiters; later waiters get the final error of the poll."""

    async def scenario() -> None:
        async with Registers() as device, framekit.aconnect("modbus-tcp", device.port, station=1) as client:
            kept = Kept()
            poll = client.poll("40001", on_values=kept.on_values)
            other = asyncio.ensure_future(poll)
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(poll, 0.001)
            assert poll.is_running and not other.done()
            await kept.enough(len(kept.values) + 2)
            device.change = lambda number, reply: None
            for waiting in (other, poll, poll):
                with pytest.raises(framekit.LineClosedError):
                    await waiting
            assert not poll.is_running

    run(scenario)

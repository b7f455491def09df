"""Read-only servers and runs: the protocol refuses writes, and the reader refuses files that could write.

With permitted writes, the log shows who wrote which values.
"""

from __future__ import annotations

import logging
import queue
import socket
from functools import partial
from pathlib import Path

import pytest
from link.service_loop import Loop

import framekit
from framekit.cli.main import main
from framekit.definition.load.protocol import load_protocol
from framekit.link.services.client import TransferResult
from framekit.memory.memory import DeviceMemory
from framekit.run.own_memory import AddressedMemory
from framekit.runfile.devices import memory_of

PLACES = [
    ("modbus-tcp", "40001", [1, 2]),
    ("modbus-tcp", "00001", [1]),
    ("mldp", "M100", [5]),
    ("host-link", "D0", [3]),
]


def written(protocol: str, address: str, values: list[int], **server: bool) -> tuple[Loop, TransferResult]:
    loop = Loop(protocol, **server)
    return loop, loop.do("write", address, values)


def contents(loop: Loop) -> list[bytes]:
    return [area.read_bytes(0, area.size_bytes) for area in loop.memory]


@pytest.mark.parametrize(("protocol", "address", "values"), PLACES)
def test_a_protocol_refuses_writes_and_serves_reads(protocol: str, address: str, values: list[int]) -> None:
    loop, result = written(protocol, address, values)
    assert result.ok
    assert any(map(any, contents(loop)))
    loop, result = written(protocol, address, values, read_only=True)
    assert not result.ok
    assert not any(map(any, contents(loop)))
    assert loop.server.counters.refused.total() == 1
    assert loop.do("read", address, count=len(values)).ok


@pytest.mark.usefixtures("each_loop")
def test_serve_with_read_only(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with framekit.serve("modbus-tcp", "tcp://127.0.0.1:0", initial={"40001": 7}, read_only=True) as server:
        place = ["modbus-tcp", "--port", server.port, "--station", "1", "40001"]
        assert main(["write", *place, "8"]) == 1
        assert "the device refused with code 0x0002: illegal data address" in capsys.readouterr().err
        assert main(["read", *place]) == 0
        assert capsys.readouterr().out == "40001  7\n"
        server.memory["40001"] = 9  # its own program still may
        assert main(["read", *place]) == 0
        assert capsys.readouterr().out == "40001  9\n"


@pytest.mark.usefixtures("each_loop")
def test_what_a_device_keeps_in_variables_is_refused_too(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "framekit.written")
    for read_only in (False, True):
        with (
            framekit.serve("ve-direct", "tcp://127.0.0.1:0", read_only=read_only) as server,
            framekit.connect("ve-direct", server.port) as client,
        ):
            if read_only:
                with pytest.raises(framekit.RefusedError):
                    client.call("set", {"register": 0xEDF0, "value": b"\x2a\x00"})
            else:
                client.call("set", {"register": 0xEDF0, "value": b"\x2a\x00"})
            assert client.call("get", {"register": 0xEDF0})["value"] == (0 if read_only else 42)
    (message,) = caplog.messages
    assert message.startswith("ve-direct: registers[60912]: 0 → 42, written by 127.0.0.1:")


WORDS = """protocol: words
extends: standard
station: {type: none}
line: {kind: stream, tcp: 1}
state:
  level: {scope: device, type: u8, initial: 3}
  asked: {scope: device, type: u8}
  seen: {scope: device, table: 0..9, holds: u8}
  mine: {type: u8}
groups:
  request: {from: client}
  reply: {from: server}
frames:
  ask: {group: request, body: [{const: 01}, {field: what, type: u8}]}
  told: {group: reply, body: [{const: 02}, {field: level, type: u8}]}
  no: {group: reply, body: [{const: 03}, {field: code, type: u8}]}
errors: {frame: no, code: code, answer: {no: {code: code}}, memory: {access: 9, unknown: 8, range: 7, no_service: 6}}
services:
"""
ROWS = {
    "set: {level: request.what}": {3: 0, 4: 9},
    "set: {mine: request.what}": {3: 0, 4: 0},
    "set: {asked: asked + 1}, no_write: yes": {3: 0, 4: 0},
    "set: {'seen[request.what]': 1}": {4: 9},
    "drop: {from: seen, when: key == request.what}": {4: 0},
}


@pytest.mark.parametrize("work", ROWS)
def test_which_work_of_a_row_is_a_write(work: str) -> None:
    service = (
        "  one:\n    - takes: {what: {type: number}}\n      request: {ask: {what: what}}\n"
        f"      serve: {{{work}}}\n      reply: {{told: {{level: level}}}}\n"
    )
    for what, code in ROWS[work].items():
        loop = Loop(WORDS + service, read_only=True)
        loop.do("call", "one", {"what": what})
        assert loop.log[-1][2].refusal == code, what
        assert loop.device["level"] == 3


def test_variables_that_sequences_change_are_named(caplog: pytest.LogCaptureFixture) -> None:
    with framekit.serve("uss", "tcp://127.0.0.1:0", read_only=True):
        pass
    (message,) = [message for message in caplog.messages if "only reads" in message]
    assert message.endswith(
        "but its sequences change variables by themselves: drive_control, drive_setpoint, drive_fault"
    )


def test_sequences_store_nothing_either() -> None:
    areas, grammar = memory_of(load_protocol("modbus-tcp"))
    access = AddressedMemory(DeviceMemory(areas), grammar)
    access.write("40001", b"\x01\x02")
    with pytest.raises(ValueError, match="40001 can only be read here"):
        access.as_read_only().write("40001", b"\x03\x04")
    assert access.as_read_only().read("40001", 2) == b"\x01\x02"


# ---- runs -------------------------------------------------------------------------------------------------------

RUN = """run: mixed
memory: masterlogic
channels:
  1: {{port: "tcp://127.0.0.1:1", protocol: modbus-tcp, station: 1}}
  2: {{port: "tcp-listen://127.0.0.1:{number}", protocol: modbus-tcp, role: server, own: 1, map: {{holding: M0}}}}
blocks:
  0: {{read: "40001", into: M100, channel: 1, every: 1 s}}
{more}"""
WRITES = """  1: {write: "40001", from: M100, channel: 1, every: 1 s}
  2: {call: identify, channel: 1, once: yes}
points:
  speed: {channel: 1, address: "40007", every: 1 s, access: rw}
  level: {channel: 1, address: "40008", every: 1 s}
"""


def free_number() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


States = queue.SimpleQueue[tuple[int, str]]


def note(states: States, channel: int, seen: framekit.Seen) -> None:
    states.put((channel, seen.kind))


def listening(states: States) -> None:
    """Wait until channel 2 listens."""
    while states.get(timeout=60) != (2, "open"):
        pass


def test_a_run_that_could_write_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "mixed.run.yaml"
    file.write_text(RUN.format(number=free_number(), more=WRITES), "utf-8")
    assert main(["run", str(file), "--read-only", "--for", "10ms"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(": ")[2] for line in lines] == [
        "block 1 writes into the other side, and this run only reads"
        " – leave it out, or run the file without --read-only",
        "block 2 calls a service, which may write, and this run only reads"
        " – leave it out, or run the file without --read-only",
        "point 'speed' can be written into a device, and this run only reads"
        " – leave access: rw out, or run the file without --read-only",
    ]
    assert lines[0].startswith(f"{file}:8:3: ")


@pytest.mark.usefixtures("each_loop")
def test_clients_of_a_run_that_only_reads_write_nothing(tmp_path: Path) -> None:
    from framekit.api.run import loaded, reads_only

    number = free_number()
    file = tmp_path / "mixed.run.yaml"
    file.write_text(RUN.format(number=number, more=""), "utf-8")
    for model, may in ((loaded(file), True), (reads_only(loaded(file)), False)):
        states = States()
        with framekit.Run(model, on_seen=partial(note, states)) as run:
            listening(states)
            with framekit.connect("modbus-tcp", f"tcp://127.0.0.1:{number}", station=1) as client:
                if may:
                    client.write("40001", [4711])
                else:
                    with pytest.raises(framekit.RefusedError):
                        client.write("40001", [4711])
            assert run.memory["M0"] == (4711 if may else 0)


def test_points_of_a_run_that_only_reads_are_written_by_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    from framekit.api.run import loaded, reads_only

    caplog.set_level(logging.WARNING, "framekit")
    file = tmp_path / "mixed.run.yaml"
    more = "points:\n  limit: {address: MW10, access: rw}\nsinks:\n  - {mqtt: '127.0.0.1:1', commands: yes}\n"
    file.write_text(RUN.format(number=free_number(), more=more), "utf-8")
    assert [point.is_writable for point in loaded(file).points] == [True]
    model = reads_only(loaded(file))
    assert [point.is_writable for point in model.points] == [False]  # so no sink and no page offers it
    with framekit.Run(model) as run:
        with pytest.raises(framekit.RequestError, match="'limit' can only be read: this run only reads"):
            run.points["limit"].write(777, who="10.9.9.9:1 by OPC UA")
        assert run.memory["MW10"] == 0
    assert "point limit: 777 was refused to 10.9.9.9:1 by OPC UA: this run only reads" in caplog.messages


# ---- who wrote what ---------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("each_loop")
def test_writes_are_logged_with_who_wrote(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "framekit.written")
    with (
        framekit.serve("modbus-tcp", "tcp://127.0.0.1:0", initial={"40001": [7, 8]}) as server,
        framekit.connect("modbus-tcp", server.port, station=1) as client,
    ):
        client.write("40001", [7, 9])
        client.write("00003", [1])
        client.write("40100", list(range(20)))
        client.read("40001", 2)
    messages = [record.getMessage() for record in caplog.records]
    who = messages[0].rpartition(" ")[2]
    assert who.startswith("127.0.0.1:")
    zeros, some = ", ".join(["0"] * 16), ", ".join(map(str, range(16)))
    assert messages == [
        f"modbus-tcp: 40001: 7, 8 → 7, 9, written by {who}",
        f"modbus-tcp: 00003: 0 → 1, written by {who}",
        f"modbus-tcp: 40100: {zeros} and 4 more → {some} and 4 more, written by {who}",
    ]


def test_nothing_is_done_for_a_log_that_is_off() -> None:
    loop, result = written("modbus-tcp", "40001", [1])
    assert result.ok
    assert type(loop.server.areas.unit("holding")).__name__ == "AreaUnit"


@pytest.mark.usefixtures("each_loop")
def test_a_channel_that_answers_logs_too(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "framekit.written")
    number = free_number()
    file = tmp_path / "mixed.run.yaml"
    file.write_text(RUN.format(number=number, more=""), "utf-8")
    states = States()
    with framekit.Run(file, on_seen=partial(note, states)):
        listening(states)
        with framekit.connect("modbus-tcp", f"tcp://127.0.0.1:{number}", station=1) as client:
            client.write("40001", [4711])
    (message,) = [record.getMessage() for record in caplog.records if record.name == "framekit.written"]
    assert message.startswith("channel 2: 40001: 0 → 4711, written by 127.0.0.1:")

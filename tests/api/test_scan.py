"""Scans find the devices that answer, at any speed, format and host, and never write."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path
from typing import Any

import pytest
from shipped import PROTOCOLS

import framekit
from framekit.api.check import check_file
from framekit.api.scan import FoundDevice, Scan, probe_of, stations_of
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.protocol import Protocol

STATIONS: dict[str, tuple[str, str]] = {"text": ("'AB'", "AB"), "bytes": ("'AB'", "AB")}
"""By type of stations: the `station` key of the device, and the stations of the scan (numbers: the device is 3)."""
OWN = {"ccm": 9, "df1": 0, "bacnet-mstp": 7, "dnp3-link": 9}
"""Own stations, for protocols whose requests contain them."""


def device_file(folder: Path, protocol: Protocol) -> list[Any] | None:
    """Write a device and return the stations of a scan for it; None without stations."""
    text = f"device: far\nprotocol: {protocol.name}\n"
    stations: list[Any] | None = None
    if protocol.station.type == "number":
        text, stations = f"{text}station: 3\n", [1, 2, 3, 4]
    elif protocol.station.type != "none":
        inside, outside = STATIONS[protocol.station.type]
        text, stations = f"{text}station: {inside}\n", [outside]
    (folder / "far.device.yaml").write_text(text, "utf-8")
    return stations


SLOW = ("ccm", "df1", "iec62056-21", "rk512-3964r", "snp", "snp-cmm", "snp-x")
"""Protocols whose exchange takes longer than `TIMEOUT`: they ask only the station that is present."""
TIMEOUT = "200 ms"


def has_client(protocol: Protocol) -> bool:
    """Return whether a role of the protocol sends requests of its own."""
    return protocol.asking_role is not None and bool(protocol.services)


@pytest.mark.parametrize("name", PROTOCOLS)
def test_every_shipped_protocol_with_a_client_finds_its_device(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    protocol = load_protocol(name)
    if not has_client(protocol):
        with pytest.raises(framekit.RequestError, match="has no harmless request to find devices"):
            framekit.scan(protocol, "sim:far.device.yaml")
        return
    stations = device_file(tmp_path, protocol)
    present = 3 if protocol.station.type == "number" else None if stations is None else stations[0]
    if name in SLOW and stations is not None:
        stations = [present]
    timeout = None if name in SLOW else TIMEOUT
    found = framekit.scan(protocol, "sim:far.device.yaml", stations=stations, own=OWN.get(name), timeout=timeout)
    answers = [(device.station if name != "snp-x" else "AB", device.answer) for device in found]
    if name == "fins-tcp":  # a node of FINS on TCP answers for the address that it is given
        assert (present, "answers") in answers
    else:
        assert answers == [(present, "answers")]


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_scan_sends_no_request_that_writes(name: str) -> None:
    protocol = load_protocol(name)
    if not has_client(protocol):
        with pytest.raises(framekit.RequestError, match="has no harmless request to find devices"):
            probe_of(protocol)
        return
    probe = probe_of(protocol)
    if probe.read is None:
        assert probe.call is not None
        assert not any(row.may_write(protocol.state) for row in protocol.services[probe.call])


def written(folder: Path, text: str) -> str:
    (folder / "own.yaml").write_text(text, "utf-8")
    return str(folder / "own.yaml")


OWN_PROTOCOL = """protocol: own
extends: standard
station: {type: number, range: 1..9}
frames:
  ask: {from: client, group: request, body: [{text: Q}, {field: station, type: u8}, {field: what, type: u8}]}
  alter: {from: client, group: request, body: [{text: W}, {field: station, type: u8}, {field: what, type: u8}]}
  tell: {from: server, echo: [station], body: [{field: station, type: u8}, {field: value, type: u8}]}
state:
  kept: {type: u8, scope: device}
services:
  state:
    - takes: {what: {type: number}}
      request: {ask: {station: station, what: what}}
      reply: {tell: {value: 7}}
      gives: {value: reply.value}
  change:
    - request: {alter: {station: station, what: 9}}
      serve: {set: {kept: 1}}
      reply: {tell: {value: 1}}
PROBE
"""


@pytest.mark.parametrize(
    ("probe", "problem"),
    [
        ("probe: {}", "the probe names no request – write one"),
        ("probe: {call: state, read: M1}", "the probe names two requests"),
        ("probe: {call: stat}", "there is no service 'stat' – did you mean 'state'?"),
        ("probe: {call: change}", "service 'change' writes, and a probe may not"),
        ("probe: {call: state, with: {wat: 1}}", "service 'state' takes no 'wat' – did you mean 'what'?"),
        ("probe: {read: M1}", "the probe reads, and there is no service read"),
        ("probe: {call: state, every: 1}", "'every'"),
    ],
)
def test_a_wrong_probe_is_an_error_of_the_definition(probe: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(framekit.DefinitionError) as error:
        load_protocol(written(tmp_path, OWN_PROTOCOL.replace("PROBE", probe)))
    (only,) = [problem for problem in error.value.problems if not problem.warning]
    assert problem in str(only) and only.at.line == 20


def test_a_probe_that_reads_an_unknown_address_is_an_error_of_the_check(tmp_path: Path) -> None:
    text = "protocol: own\nextends: modbus-rtu\nprobe: {read: M1}\n"
    (problem,) = [problem for problem in check_file(written(tmp_path, text)).problems if not problem.warning]
    assert str(problem).startswith(f"{tmp_path / 'own.yaml'}:3:8: 'M1' is not an address – write it like")
    with pytest.raises(framekit.RequestError, match="'M1' is not an address"):
        Scan(str(tmp_path / "own.yaml"), "sim:x.device.yaml")


@pytest.mark.parametrize(
    ("text", "stations"), [("1..3", ["1", "2", "3"]), ("7", ["7"]), ("1,5..6,1", ["1", "5", "6"]), ("A,B", ["A", "B"])]
)
def test_stations_as_text(text: str, stations: list[str]) -> None:
    assert stations_of(text) == stations


@pytest.mark.parametrize("text", ["", "1,", "3..1", "a..b", "0..99999999", "1..2..3"])
def test_wrong_stations(text: str) -> None:
    with pytest.raises(framekit.RequestError):
        stations_of(text)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"stations": ["300"]}, "station 300"),
        ({"hosts": ["10.0.0.0/28"]}, "has no place for the hosts"),
        ({"formats": ["9X9"]}, "9X9"),
        ({"speeds": [0]}, "speed"),
        ({"params": {"retrys": 1}}, "did you mean 'retries'"),
    ],
)
def test_options_that_do_not_fit(options: dict[str, Any], what: str) -> None:
    with pytest.raises(framekit.RequestError, match=what):
        Scan("modbus-rtu", "/dev/null", **options)


@pytest.mark.parametrize("name", ["ccm", "rk512-3964r"])
def test_a_time_limit_that_the_protocol_does_not_have(name: str) -> None:
    with pytest.raises(framekit.RequestError, match="has no parameter 'reply_timeout' – leave the time limit out"):
        Scan(name, "/dev/null", own=9, timeout="1 s")


def test_hosts() -> None:
    ports = [place.settings.port for place in Scan("modbus-tcp", "tcp://{host}", hosts=["10.0.0.0/30", "plc"])._places]
    assert ports == ["tcp://10.0.0.1:502", "tcp://10.0.0.2:502", "tcp://plc:502"]
    for hosts in (["10.0.0.0/8"], ["1.2.3.4/99"]):
        with pytest.raises(framekit.RequestError):
            Scan("modbus-tcp", "tcp://{host}", hosts=hosts)
    with pytest.raises(framekit.RequestError, match="no hosts are given"):
        Scan("modbus-tcp", "tcp://{host}")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
    return port


def test_several_hosts_over_tcp(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two addresses of this machine: a device listens at one of them."""

    async def scanned() -> tuple[list[FoundDevice], Scan]:
        port = free_port()
        async with framekit.aserve("modbus-tcp", f"tcp-listen://127.0.0.1:{port}", station=[1, 2]):
            scan = Scan(
                "modbus-tcp", f"tcp://{{host}}:{port}", hosts=["127.0.0.1", "127.0.0.2"], stations=[1, 2, 3],
                timeout=TIMEOUT,
            )  # fmt: skip
            return [device async for device in scan.devices()], scan

    found, scan = asyncio.run(scanned())
    assert [(device.station, device.answer) for device in found if device.port.startswith("tcp://127.0.0.1")] == [
        (1, "answers"), (2, "answers"),
    ]  # fmt: skip
    assert len(scan.unreachable) == 1 and scan.done == scan.total == 6


def test_a_port_that_cannot_be_opened() -> None:
    with pytest.raises(framekit.LineClosedError):
        framekit.scan("modbus-tcp", f"tcp://127.0.0.1:{free_port()}", stations=[1])


def test_a_device_that_refuses_the_probe_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.yaml").write_text("protocol: own\nextends: modbus-rtu\nprobe: {read: '465536'}\n", "utf-8")
    device = "device: far\nprotocol: modbus-rtu\nstation: 3\nfaults: {rules: [{fault: error_reply}]}\n"
    (tmp_path / "far.device.yaml").write_text(device, "utf-8")
    (found,) = framekit.scan("modbus-rtu", "sim:far.device.yaml", stations=[2, 3], timeout=TIMEOUT)
    assert (found.station, found.answer, found.line) == (3, "refuses", "19200 8E1") and "0x0002" in found.detail


def test_a_time_out_with_an_outcome_of_the_protocol_is_no_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far.device.yaml").write_text("device: far\nprotocol: snp\nstation: 'CD'\n", "utf-8")
    assert framekit.scan("snp", "sim:far.device.yaml", stations=["AB"], params={"own_t2": "10 ms"}) == []


def test_damaged_replies_are_told_from_good_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    device = "device: far\nprotocol: modbus-rtu\nstation: 3\nfaults: {rules: [{fault: wrong_check}]}\n"
    (tmp_path / "far.device.yaml").write_text(device, "utf-8")
    (found,) = framekit.scan("modbus-rtu", "sim:far.device.yaml", stations=[3], timeout=TIMEOUT)
    assert (found.station, found.answer) == (3, "damaged")


def test_each_speed_and_format_is_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far.device.yaml").write_text("device: far\nprotocol: modbus-rtu\nstation: 3\n", "utf-8")
    found = framekit.scan(
        "modbus-rtu", "sim:far.device.yaml", stations=[3], speeds=[9600, 19200], formats=["8N1", "8E1"]
    )
    assert [device.line for device in found] == ["9600 8N1", "9600 8E1", "19200 8N1", "19200 8E1"]

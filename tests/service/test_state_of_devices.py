"""Faults, passwords, identities and programs of simulated controllers: from device file, command line and API."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import framekit
from framekit.cli.main import main
from framekit.definition.problems import DefinitionError

SNP = """device: plc
protocol: snp
station: 33101A
state:
  plc_faults:
    initial:
      - {slot: 1, group: low CPU battery, action: diagnostic, code: 1, hour: 11, minute: 19, day: 7, month: 6, year: 90}
      - {slot: 2, group: 18}
  io_faults: {initial: [{reference: FF 00 00, slot: 3, bus: 127, group: 3, action: 2, category: 14}]}
  passwords: {initial: {2: GEHEIM, 3: TOP, 4: TOP}}
  program: {initial: "'MAIN'"}
  program_blocks: {initial: {0: 01 02 03, 5: AA}}
"""
CCM = """device: ccm
protocol: ccm
station: 5
state:
  cpu:
    initial: {run_status: 2, major: 16, minor: 35, snp_id: ABCDEF, cpu_firmware: 04 50, registers: 2048, inputs: 512}
  quick_data: {initial: 01 02 03 04}
"""
RTU = """device: rtu
protocol: ge-rtu
station: 1
state: {cpu: {initial: {run_status: 2, major: 12, minor: 94, snp_id: A70}}}
"""


def opened(folder: Path, text: str, protocol: str, **settings: Any) -> framekit.Client:
    """Return a client of a device file with this text."""
    file = folder / "one.device.yaml"
    file.write_text(text, encoding="utf-8")
    return framekit.connect(protocol, f"sim:{file}", **settings)


@pytest.fixture
def snp(tmp_path: Path) -> Iterator[framekit.Client]:
    with opened(tmp_path, SNP, "snp", station="33101A") as client:
        yield client


def test_fault_tables_of_a_device_file(snp: framekit.Client) -> None:
    table = snp.call("plc_faults")["faults"]
    assert (table["present"], table["since"]) == (2, 2)
    first, second = table["faults"]
    assert (first["slot"], first["group"], first["action"], first["hour"], first["year"]) == (1, 18, 2, 11, 90)
    assert (second["slot"], second["group"], second["code"]) == (2, 18, 0)
    (only,) = snp.call("io_faults")["faults"]["faults"]
    assert (only["reference"], only["bus"], only["category"]) == (b"\xff\0\0", 127, 14)
    assert snp.call("short_status")["plc"]["plc_fault"] == 1


def test_passwords_by_level(snp: framekit.Client) -> None:
    with pytest.raises(framekit.RefusedError, match="password invalid"):
        snp.call("change_level", {"level": 2})
    assert snp.call("change_level", {"level": 2, "password": "GEHEIM"})["level"] == 2
    assert snp.call("change_level", {"level": -1, "password": "TOP"})["level"] == 4
    assert snp.call("change_level", {"level": -1, "password": "GEHEIM"})["level"] == 2
    assert snp.call("change_level", {"level": 1})["level"] == 1
    with pytest.raises(framekit.RefusedError, match="password invalid"):
        snp.call("change_level", {"level": -1, "password": "WRONG"})
    assert snp.call("change_level", {"level": -1})["level"] == 1, "the highest that wants no password"


def test_one_password_of_every_level(tmp_path: Path) -> None:
    text = "device: plc\nprotocol: snp\nstation: A\nstate: {passwords: {initial: \"'AB1'\"}}\n"
    with opened(tmp_path, text, "snp", station="A") as client:
        assert client.call("change_level", {"level": -1, "password": "AB1"})["level"] == 4


def test_program_and_its_blocks(snp: framekit.Client) -> None:
    assert snp.call("program_names")["names"]["names"] == [{"name": "MAIN"}]
    snp.call("change_level", {"level": 4, "password": "TOP"})
    snp.call("logon", {"mode": "login"})
    assert snp.call("program_load", {"block_type": 5})["block"] == b"\xaa"


def test_scratch_pad_and_quick_data_of_ccm(tmp_path: Path) -> None:
    with opened(tmp_path, CCM, "ccm", own=1, station=5, role="master") as client:
        pad = client.read("SCRATCH0", 28)
        assert list(pad[:4]) == [2, 0, 16, 35] and bytes(pad[4:12]) == b"ABCDEF\0\0" and list(pad[12:14]) == [4, 0x50]
        assert list(pad[24:28]) == [0, 8, 0, 0], "2048 registers, the lowest byte first"
        assert client.call("read_quick")["data"] == b"\1\2\3\4"


def test_scratch_pad_of_rtu(tmp_path: Path) -> None:
    with opened(tmp_path, RTU, "ge-rtu", station=1) as client:
        assert client.call("read_scratch", {"address": 0, "count": 8})["values"] == b"\x02\0\x0c\x5eA70\0"
        assert client.call("identify")["running"] == 0


def test_state_from_a_program(tmp_path: Path) -> None:
    state = {"passwords": {2: "X2"}, "plc_faults": [{"slot": 7, "group": "user application fault"}], "program": "PRG"}
    with (
        framekit.serve("snp", "tcp://127.0.0.1:0", station="AB", params={"use_break": False}, state=state) as server,
        framekit.connect("snp", server.port, station="AB", params={"use_break": False}) as client,
    ):
        (fault,) = client.call("plc_faults")["faults"]["faults"]
        assert (fault["slot"], fault["group"]) == (7, 22)
        assert client.call("change_level", {"level": 2, "password": "X2"})["level"] == 2
        assert client.call("program_names")["names"]["names"] == [{"name": "PRG"}]
    with pytest.raises(DefinitionError, match="did you mean 'passwords'"):
        framekit.serve("snp", "tcp://127.0.0.1:0", station="AB", state={"password": {}})


def test_state_from_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    start = ["serve", "snp", "--port", "pty:", "--station", "AB", "--for", "10ms", "--quiet"]
    faults = "plc_faults=[{slot: 1, group: low CPU battery}]"
    assert main([*start, "--state", "passwords={2: X2}", "--state", faults, "--state", "program=MAIN"]) == 0
    assert main([*start, "--state", "passwords={9: X2}", "--state", "plc_faults=[{slot: 300}]"]) == 1
    errors = capsys.readouterr().err.splitlines()
    assert any("9 is no key of 'passwords'" in line for line in errors)
    assert any("300 does not fit: 'slot' holds 0 to 255" in line for line in errors)

"""Names of the manuals next to numbers in results, decoded frames and status words; codes in the manuals' notation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_world import SECOND, CommandWorld, text_words

import framekit
from framekit.cli.common import load
from framekit.cli.main import main
from framekit.extras.commreq.commands import application_of, blocks_of

DEVICE = """device: plc
protocol: snp
station: A1
state:
  plc_faults: {initial: [{slot: 1, group: low CPU battery, action: fatal, year: 90}]}
  io_faults: {initial: [{slot: 3, group: 3, action: 2}]}
"""
RTU = "device: rtu\nprotocol: ge-rtu\nstation: 1\nparams: {cpu_code: 36}\n"


def called(folder: Path, capsys: pytest.CaptureFixture[str], *words: str, text: str = DEVICE, more: str = "") -> str:
    """Return the output of `framekit call` for a device file with this text."""
    (folder / "one.device.yaml").write_text(text, encoding="utf-8")
    protocol, station = ("ge-rtu", "1") if text is RTU else ("snp", "A1")
    port = f"sim:{folder / 'one.device.yaml'}"
    main(["call", protocol, *words, "--port", port, "--station", station, *more.split()])
    printed = capsys.readouterr()
    return printed.out + printed.err


@pytest.mark.parametrize(
    ("service", "shown"),
    [
        ("plc_faults", "'group': '18 (low CPU battery)', 'action': '3 (fatal)'"),
        ("plc_faults", "{'cleared': {'second': 0, 'minute': 0, 'hour': 0, 'day': 0, 'month': 0, 'year': 0}"),
        ("io_faults", "'group': '3 (I/O module lost/missing)', 'action': '2 (diagnostic)'"),
        ("short_status", "'state': '2 (stop I/O disabled)'"),
        ("controller_id", "'major': '16 (Series 90-30 or 90-20)', 'minor': '35 (CPU 331)'"),
    ],
)
def test_results_have_names(tmp_path: Path, capsys: pytest.CaptureFixture[str], service: str, shown: str) -> None:
    assert shown in called(tmp_path, capsys, service)


def test_results_of_single_fields_have_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = called(tmp_path, capsys, "identify", text=RTU).splitlines()
    assert lines == ["device: 30 (Series 90-30)", "running: 255 (running)", "cpu: 36 (CPU 341)"]


def test_json_has_numbers_and_their_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(called(tmp_path, capsys, "plc_faults", more="--json"))
    assert found["results"]["faults"]["faults"][0]["group"] == 18
    assert found["names"] == {"faults.faults[0].group": "low CPU battery", "faults.faults[0].action": "fatal"}
    assert "names" not in json.loads(called(tmp_path, capsys, "get_time", more="--json"))


def test_answers_have_the_names_of_their_numbers(tmp_path: Path) -> None:
    (tmp_path / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
    with framekit.connect("snp", f"sim:{tmp_path / 'one.device.yaml'}", station="A1") as client:
        answer = client.call("short_status")
        assert answer["plc"]["state"] == 2
        assert answer.names == {"plc.state": "stop I/O disabled", "status.program_0": "none"}
        identity = client.call("controller_id")
        assert identity.names == {"controller.major": "Series 90-30 or 90-20", "controller.minor": "CPU 331"}


def test_decode_names_major_and_minor_of_an_error_of_snp_x(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["decode", "snp-x", "1B 58 81 00 00 0F 04 00 00 17 00 00 00 00 2D"]) == 0
    shown = capsys.readouterr().out
    assert "15 (SNP-X slave error)" in shown
    assert "4 (address or range)" in shown


def error_nack() -> list[str]:
    """Return a mailbox with the refusal 05F5 as hex pairs."""
    nack = "1B 4D 00 00 00 00 00 00 02 D1 10 0A 00 00 10 3A 00 00 01 01 05 F5"
    data = bytes.fromhex(nack).ljust(34, b"\0") + bytes.fromhex("17 00 00 00 00")
    check = 0
    for byte in data:
        check ^= byte
        check = (check << 1 | check >> 7) & 0xFF
    return [f"{byte:02X}" for byte in (*data, check)]


def test_json_of_decode_has_the_names_by_their_places(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["decode", "snp", "--from", "server", "--json", *error_nack()]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["fields"]["body"]["error_nack"]["minor"] == 245
    assert found["names"] == {
        "body.error_nack.major": "service request error", "body.error_nack.minor": "password invalid",
    }  # fmt: skip


RUN = """run: names
memory: masterlogic
channels: {1: {port: "sim:one.device.yaml", protocol: snp, role: master, station: A1}}
blocks: {0: {call: plc_faults, once: yes}}
"""


def test_json_of_a_run_has_the_names_of_numbers_in_frames_and_contents(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
    (tmp_path / "names.run.yaml").write_text(RUN, encoding="utf-8")
    main(["run", str(tmp_path / "names.run.yaml"), "--virtual", "--for", "2s", "--json", "--frames"])
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    names = {path: name for line in lines for path, name in line.get("names", {}).items()}
    assert names["plc_fault_table.faults[0].group"] == "low CPU battery"
    assert names["body.fault_table.table"] == "plc"


def test_decode_names_major_and_minor_of_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["decode", "snp", "--from", "server", *error_nack()]) == 0
    shown = capsys.readouterr().out
    assert "5 (service request error)" in shown and "245 (password invalid)" in shown


@pytest.mark.parametrize(
    ("protocol", "status", "meaning"),
    [
        ("snp", 0x8E0A, "port is not open"),
        ("snp", 0x060E, "modem answered BUSY"),
        ("snp", 0x0413, "status word location"),
        ("snp", 0x0055, "slave SNP task timed out before the service response arrived"),
        ("snp", 0x410D, "privilege level 2 is needed"),
        ("snp", 0x2F0C, "no buffer in time"),
        ("snp", 0xF505, "password invalid"),
        ("snp-x", 0x720F, "X-Buffer, block check code"),
        ("snp-x", 0x010F, "request code not supported or not valid now"),
        ("snp-x", 0x0013, "port configurator error"),
        ("ccm", 0x1702, "no valid acknowledge to a master enquiry"),
    ],
)
def test_status_words_have_names(protocol: str, status: int, meaning: str) -> None:
    known = load(protocol)
    blocks = blocks_of(application_of(known, None, protocol), known, "master")
    assert blocks.meaning(status) == meaning


FAULTY = "station: SNPID1\nmemory: {{set: {{R1: [{values}]}}}}\nfaults: {{seed: 1, rules: [{{fault: {fault}}}]}}\n"
ATTACH = [7200, *text_words("SNPID1"), 0, 0]


@pytest.mark.parametrize(
    ("fault", "status"),
    [
        ("wrong_check, frame: attach_response", 0x220C),
        ("no_reply, frame: attach_response", 0x040C),
    ],
)
def test_codes_of_attach(tmp_path: Path, fault: str, status: int) -> None:
    world = CommandWorld(tmp_path, "snp", FAULTY.format(fault=fault, values="1"))
    assert world.do(*ATTACH) == status


def test_a_reply_that_is_refused_twice(tmp_path: Path) -> None:
    """The manual's vectors have a missing buffer (2F0Ch), and a buffer that is refused twice."""
    world = CommandWorld(tmp_path, "snp", FAULTY.format(fault="wrong_check, frame: mailbox, from: 3 s", values="1, 2"))
    assert world.do(*ATTACH) == 1
    world.clock.run_for(3 * SECOND)
    assert world.do(7202, 8, 1, 2, 8, 100) == 0x290C
    outcomes = application_of(load("snp"), None, "snp").tables["outcomes"].entries
    assert (outcomes["no_buffer"], outcomes["damaged_twice"], outcomes["attach_parity"]) == (0x2F, 0x29, 0x21)


def test_a_service_that_the_family_lacks_is_not_supported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world = CommandWorld(tmp_path, "snp", "station: SNPID1\n")
    assert world.do(*ATTACH) == 1
    assert world.do(7204, 1, 1, 8, 100, *text_words("MAIN")) == 0x000B, "%P1 on a 90-30"


def test_system_bits_can_be_toggled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "level 2 is needed" in called(tmp_path, capsys, "toggle", "memory=S", "point=1")
    shown = called(tmp_path, capsys, "toggle", "memory=S", "point=1", more="--param privilege=2")
    assert "refused" not in shown
    assert "'R' is none of I, Q, T" in called(tmp_path, capsys, "toggle", "memory=R", "point=1")

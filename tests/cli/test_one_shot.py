"""`framekit read`, `write` and `call`: on real pseudo-terminals and TCP, with their output and exit status."""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from api_world import device_file, pymodbus_server

import framekit
from framekit.cli.main import main


def call(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    try:
        status = main(words)
    except SystemExit as ended:
        status = int(ended.code or 0)
    output = capsys.readouterr()
    assert "Traceback" not in output.out + output.err
    return status, output.out, output.err


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, framekit.Memory]]:
    """Yield a pseudo-terminal with our device, station 7, and the memory of the device."""
    with framekit.serve(device_file(tmp_path_factory.mktemp("bench")), "pty:", speed=19200) as device:
        yield device.port, device.memory


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["40001", "-1"], "-1 does not fit into a word: 0 to 65535 – for a number with sign write --type int16"),
        (["40001", "--type", "dword", "5", "-2"], "-2 does not fit into a dword: 0 to 4294967295 – for a number"),
        (["00001", "-1"], "-1 does not fit into a bit: 0 to 1"),
        (["50001", "-1"], "'50001' is not an address"),
        (["30001", "1"], "30001 is in area input_register, which can only be read"),
    ],
)
def test_what_cannot_be_written(
    bench: tuple[str, framekit.Memory], capsys: pytest.CaptureFixture[str], words: list[str], says: str
) -> None:
    status, out, err = call(capsys, "write", "modbus-rtu", "--port", bench[0], "--station", "7", *words)
    assert (status, out) == (2, "") and err.startswith(f"framekit write: {says}")


def test_read(bench: tuple[str, framekit.Memory], capsys: pytest.CaptureFixture[str]) -> None:
    line = ("modbus-rtu", "--port", bench[0], "--station", "7")
    assert call(capsys, "read", *line, "40001", "-n", "3") == (0, "40001  100 200 300\n", "")
    assert call(capsys, "read", *line, "40003", "00001") == (0, "40003  300\n00001  1\n", "")
    assert call(capsys, "read", *line, "40001", "40002", "-n", "2") == (0, "40001  100 200\n40002  200 300\n", "")
    status, out, _ = call(capsys, "read", *line, "40001", "40003", "--json")
    assert (status, json.loads(out)) == (
        0, {"station": 7, "addresses": ["40001", "40003"], "type": "word", "values": [100, 300]},
    )  # fmt: skip
    status, out, _ = call(capsys, "read", *line, "40001", "--every", "1ms", "--times", "3", "--json")
    assert (status, [json.loads(text)["values"] for text in out.splitlines()]) == (0, [[100], [100], [100]])


def test_write(bench: tuple[str, framekit.Memory], capsys: pytest.CaptureFixture[str]) -> None:
    line = ("modbus-rtu", "--port", bench[0], "--station", "7")
    assert call(capsys, "write", *line, "40011", "--type", "int16", "0x10", "-2") == (0, "", "")
    assert bench[1].read("40011", 2) == [0x10, 0xFFFE]
    assert call(capsys, "write", *line, "40011", "--type", "float32", "--order", "ABCD", "1.5", "-0.1") == (0, "", "")
    assert bench[1].read("40011", 2) == [0x3FC0, 0]
    shown = call(capsys, "read", *line, "40011", "-n", "2", "--type", "float32", "--order", "ABCD")
    assert shown == (0, "40011  1.5 -0.1\n", "")
    status, out, err = call(capsys, "read", *line, "40011", "--type", "float32")
    hint = "framekit read: 40011: 2.286919e-41, with --order ABCD it would be 1.5\n"
    assert (status, out, err) == (0, "40011  2.286919e-41\n", hint)
    status, out, _ = call(capsys, "write", *line, "40021", "Hello", "--type", "string", "-n", "8", "--json")
    assert (status, json.loads(out)) == (0, {"address": "40021", "written": 1})
    assert call(capsys, "read", *line, "40021", "-n", "8", "--type", "string") == (0, "40021  Hello\n", "")


def test_call(bench: tuple[str, framekit.Memory], capsys: pytest.CaptureFixture[str]) -> None:
    line = ("modbus-rtu", "--port", bench[0], "--station", "7")
    bench[1]["40031"] = 0x12
    assert call(capsys, "call", *line, "mask_write", "address=30", "and_mask=0xF2", "or_mask=0x25")[0] == 0
    assert bench[1]["40031"] == 0x12 & 0xF2 | 0x25 & ~0xF2
    assert call(capsys, "call", *line, "identify") == (0, "id: 66 6B 01\n", "")
    status, out, _ = call(capsys, "call", *line, "identify", "--json")
    assert (status, json.loads(out)) == (0, {"service": "identify", "results": {"id": "66 6B 01"}})


def test_the_frames_are_shown(bench: tuple[str, framekit.Memory], capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = call(capsys, "read", "modbus-rtu", "--port", bench[0], "--station", "7", "40001", "--frames")
    assert (status, out) == (0, "40001  100\n")
    assert "→ request_adu              8 07 03 00 00 00 01" in err and "← reply_adu" in err


def test_a_broadcast_has_been_sent_when_the_verb_ends(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The master polls first; a broadcast, which gets no reply, must be sent before the verb ends."""
    device = tmp_path / "slaves.device.yaml"
    device.write_text("device: slaves\nprotocol: df1\nrole: slave\nstation: [1, 2]\n", encoding="utf-8")
    line = ("df1", "--port", f"sim:{device}", "--role", "master", "--param", "normal_nodes=1", "--frames")
    status, out, err = call(capsys, "write", *line, "--station", "255", "N7:0", "5")
    assert (status, out) == (0, "")
    sent = [text.split()[1] for text in err.splitlines() if text.startswith("→")]
    assert sent[0] == "poll" and "master_message" in sent


def test_a_refusal(capsys: pytest.CaptureFixture[str]) -> None:
    with pymodbus_server() as port:
        line = ("modbus-tcp", "--port", port, "--station", "1")
        assert call(capsys, "read", *line, "40005", "-n", "2") == (0, "40005  1004 1005\n", "")
        message = "framekit read: the device refused with code 0x0002: illegal data address\n"
        assert call(capsys, "read", *line, "49000") == (1, "", message)
        status, out, err = call(capsys, "read", *line, "49000", "--json")
        assert (status, err) == (1, message)
        assert json.loads(out) == {
            "error": "refused", "message": "the device refused with code 0x0002: illegal data address",
            "code": 2, "meaning": "illegal data address",
        }  # fmt: skip
        assert call(capsys, "read", *line, "49000", "40001", "--every", "1ms", "--times", "2")[0] == 1


def test_nobody_answers(bench: tuple[str, framekit.Memory], capsys: pytest.CaptureFixture[str]) -> None:
    words = ("modbus-rtu", "--port", bench[0], "--station", "9", "40001", "--timeout", "20ms", "--retries", "0")
    status, out, err = call(capsys, "read", *words)
    assert (status, out) == (3, "")
    assert err.startswith("framekit read: the device did not answer: nothing came in time – check the station (9)")
    status, out, _ = call(capsys, "read", *words, "--json")
    assert (status, json.loads(out)["error"]) == (3, "no_reply")


def test_where_nothing_comes_on_a_serial_line_its_settings_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    here, far_end = os.openpty()
    port = os.ttyname(far_end)
    try:
        words = ("modbus-rtu", "--port", port, "--station", "3", "40001", "--timeout", "20ms", "--retries", "0")
        _, _, errors = call(capsys, "read", *words)
        _, _, other = call(capsys, "read", *words, "--speed", "9600", "--format", "8N1")
    finally:
        os.close(here)
        os.close(far_end)
    assert "– check the station (3), speed and format (19200 8E1) and the wires" in errors
    assert f"framekit record {port} --try" in errors and "(9600 8N1)" in other


def test_words_of_other_programs_lead_to_those_of_framekit(capsys: pytest.CaptureFixture[str]) -> None:
    for option, meant in (("--baud", "--speed"), ("--parity", "--format, such as 8E1"), ("--slave", "--station")):
        with pytest.raises(SystemExit):
            main(["read", "modbus-rtu", "--port", "/dev/none", "40001", f"{option}=1"])
        assert f"there is no option '{option}' – write {meant}" in capsys.readouterr().err


def test_the_address_says_what_it_holds(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    device = tmp_path / "one.device.yaml"
    device.write_text(
        'device: one\nprotocol: df1\nrole: full\nstation: 1\nmemory: {set: {"F8:0": [1.5, -2], "N7:0": 0xFFFF}}\n',
        encoding="utf-8",
    )
    line = ("df1", "--port", f"sim:{device}", "--role", "full", "--station", "1")
    assert call(capsys, "read", *line, "F8:0", "-n", "2") == (0, "F8:0  1.5 -2\n", "")
    assert call(capsys, "read", *line, "F8:0", "--type", "dword") == (0, f"F8:0  {0x3FC00000}\n", "")
    assert call(capsys, "read", *line, "F8:0", "N7:0") == (0, "F8:0  1.5\nN7:0  -1\n", "")
    assert call(capsys, "read", *line, "N7:0", "F8:1", "--type", "int16")[0] == 0
    status, out, _ = call(capsys, "read", *line, "F8:0", "N7:0", "--json")
    shown = json.loads(out)
    assert (status, shown["type"], shown["values"]) == (0, "float32, int16", [1.5, -1])
    status, _, err = call(capsys, "write", *line, "--frames", "F8:1", "0.5")
    assert status == 0 and "8A 01 00 00 00 00 3F 10 03" in err
    assert call(capsys, "write", *line, "F8:1", "much")[::2] == (2, "framekit write: 'much' is no float32\n")
    assert "'0.5' is no int16" in call(capsys, "write", *line, "N7:1", "0.5")[2]
    for place, text, octets in [("N7:1", "-2", "FE FF"), ("N7:1", "0xFFFE", "FE FF"), ("F8:1", "0x3FC00000", "C0 3F")]:
        status, _, err = call(capsys, "write", *line, "--frames", place, text)
        assert status == 0 and f"{octets} 10 03" in err
    assert "65535 does not fit into 16 bits with sign" in call(capsys, "write", *line, "N7:1", "65535")[2]
    assert "65536 does not fit into a word" in call(capsys, "write", *line, "N7:1", "0x10000")[2]
    assert call(capsys, "read", *line, "L11:0", "N7:0", "--type", "word")[0] == 0


@pytest.mark.parametrize(("there", "asker", "station"), [("slave", "master", 2), ("full", "full", 1)])
def test_nobody_acknowledges(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, there: str, asker: str, station: int
) -> None:
    """The device's link reports a missing acknowledgement by an error frame with a code; that is not a refusal."""
    device = tmp_path / "one.device.yaml"
    mute = "faults: {rules: [{fault: no_reply}]}\n" if there == "full" else ""
    device.write_text(f"device: one\nprotocol: df1\nrole: {there}\nstation: 1\n{mute}", encoding="utf-8")
    line = ("df1", "--port", f"sim:{device}", "--role", asker, "--station", str(station))
    words = (*line, "--param", "ack_timeout=20ms", "--param", "enq_limit=1", "N7:0")
    why = "delivery not guaranteed, no acknowledge"
    message = f"framekit read: the device did not answer: {why} – check the station ({station})\n"
    assert call(capsys, "read", *words) == (3, "", message)
    status, out, _ = call(capsys, "read", *words, "--json")
    assert (status, json.loads(out)["error"]) == (3, "no_reply")


@pytest.mark.parametrize(
    ("port", "message"),
    [
        ("/dev/no-such-port", "there is no such device"),
        ("tcp://127.0.0.1:1", "Connection refused"),
        ("tcp://no.such.host.invalid:1", "no connection to"),
    ],
)
def test_no_port(capsys: pytest.CaptureFixture[str], port: str, message: str) -> None:
    status, out, err = call(capsys, "read", "modbus-rtu", "--port", port, "--station", "1", "40001")
    assert (status, out) == (3, "")
    assert message in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("read", "40001"), "needs a station"),
        (("read", "--station", "7", "4x"), "is not an address"),
        (("read", "--station", "7", "40001", "-n", "0"), "the count is 0"),
        (("read", "--station", "7", "40001", "--type", "flot32"), "did you mean 'float32'"),
        (("read", "--station", "7", "40001", "--order", "ABC"), "invalid choice"),
        (("read", "--station", "7", "40001", "--param", "retries"), "is not NAME=VALUE"),
        (("read", "--station", "7", "40001", "--param", "retrys=1"), "did you mean 'retries'"),
        (("read", "--station", "7", "40001", "--timeout", "soon"), "is not a time"),
        (("read", "--station", "7", "40001", "--every", "soon"), "--every: 'soon' is not a time"),
        (("read", "--station", "7", "40001", "--every", "1ms", "--times", "-1"), "-1 is no number of readings"),
        (("read", "--station", "7", "40001", "--every", "1ms", "--times", "0"), "0 is no number of readings"),
        (
            ("read", "--station", "7", "40001", "--speed", "fast"),
            "'fast' is not a whole number – write digits",
        ),
        (("read", "--station", "7", "40001", "--speed"), "--speed has no value – write it after --speed"),
        (("read", "--station", "7", "0x10"), "; counted from 0: coil:0x10, input:0x10, holding:0x10"),
        (
            ("read", "--station", "7"),
            "missing: ADDRESS – for example: framekit read modbus-rtu --port /dev/ttyUSB0 --station 1 40001 -n 3",
        ),
        (("write", "--station", "7", "40001"), "missing: VALUE – for example: framekit write modbus-rtu --port "),
        (
            ("read", "--station", "7", "--evry=1s"),
            "there is no option '--evry' – did you mean '--every'?; missing: ADDRESS – for example: framekit read",
        ),
        (("read", "--station", "abc", "40001"), "station 'abc' is not a whole number – write it like 10 or 0x0A"),
        (
            ("write", "--station", "7", "40001", "1.5"),
            "'1.5' is no whole number – write --type float32 for a fraction, --type string for text",
        ),
        (("write", "--station", "7", "40001", "70000"), "does not fit into a word"),
        (("write", "--station", "7", "40001", "x", "--type", "float32"), "'x' is no float32"),
        (("call", "--station", "7", "nothing"), "there is no service 'nothing'"),
        (("call", "--station", "7", "mask_write", "address"), "is not NAME=VALUE"),
        (("call", "--station", "7", "mask_write", "adress=1"), "did you mean 'address'"),
    ],
)
def test_a_wrong_command_line(
    bench: tuple[str, framekit.Memory], capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    status, out, err = call(capsys, words[0], "modbus-rtu", "--port", bench[0], *words[1:])
    assert (status, out) == (2, "")
    assert message in err


def test_a_station_that_is_too_long(capsys: pytest.CaptureFixture[str]) -> None:
    """The station must be a text of at most 8 characters, which is padded, or 8 bytes."""
    words = ("--port", "sim:none.device.yaml", "--station", "UNIT77777", "%R1")
    status, _, err = call(capsys, "read", "snp-x", *words)
    assert status == 2
    assert "station 'UNIT77777' has 9 characters, at most 8 are possible – or write 8 bytes in hex" in err


def test_a_wrong_definition(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, _, err = call(capsys, "read", "modbus-rtx", "--port", f"sim:{device_file(tmp_path)}", "40001")
    assert status == 2 and "there is no definition 'modbus-rtx'" in err
    status, _, err = call(capsys, "read", "mldp", "--port", f"sim:{device_file(tmp_path)}", "--station", "1", "M0")
    assert status == 2 and "speaks modbus-rtu, this channel mldp" in err


def test_what_the_settings_forbid_is_not_sent(capsys: pytest.CaptureFixture[str]) -> None:
    device = Path(__file__).parents[2] / "examples" / "srtp-cpu.device.yaml"
    status, out, err = call(capsys, "write", "srtp", "--port", f"sim:{device}", "%R300", "5")
    assert (status, out) == (2, "") and err.endswith("it was not sent: the parameter allow has to be writes\n")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["read", "ZZ"], "'ZZ' is not an address"),
        (["read", "40001", "--type", "foo"], "'foo' is not a type – known: bit, byte, word, dword, lword, int8"),
        (["read", "40001", "--type", "wrod"], "'wrod' is not a type – did you mean 'word'"),
        (["read", "40001", "ZZ", "--every", "1s"], "'ZZ' is not an address"),
        (["write", "40001", "70000"], "70000 does not fit into a word"),
        (["write", "40001", "-1"], "-1 does not fit into a word: 0 to 65535 – for a number with sign"),
        (["write", "ZZ", "1"], "'ZZ' is not an address"),
    ],
)
def test_what_cannot_be_asked_is_told_where_there_is_no_line_either(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    verb, *rest = words
    line = ["modbus-tcp", "--station", "1", "--port", "tcp://127.0.0.1:1"]
    status, output, errors = call(capsys, verb, *line, *rest)
    assert (status, output) == (2, "") and errors.startswith(f"framekit {verb}: {says}")


SILENT = """
protocol: silent
extends: standard
line: {speed: {default: 9600}, format: {default: 8E1}}
groups: {request: {from: client}}
areas: {R: {unit: byte, size: 16}}
addresses: [{form: "R{start:dec}", area: R}]
frames:
  ask:  {group: request, body: [{const: ENQ}, {field: n, type: u8}]}
  more: {group: request, body: [{const: ACK}]}
  back: {from: server, body: [{const: STX}, {data: d, size: 1}, {const: ETX}]}
  sum:  {from: server, body: [{const: SOH}, {field: d, type: u8}, {const: ETX}]}
params: {total: {type: number, default: 300}}
services:
  read:
    - areas: [R]
      units: [byte]
      limit: {count: 1}
      request: {ask: {n: start}}
      reply: [{when: "data[0] < 100 or data[9] > 1", back: {d: data}}, {back: {d: data}}]
  get: [{request: {more: {}}, reply: {sum: {d: total}}, gives: {d: reply.d}}]
"""
SILENT_RUN = """
run: silent
memory: masterlogic
channels: {1: {port: "sim:silent.device.yaml", protocol: silent, params: {retries: 0}}}
blocks: {0: {call: get, once: yes}}
"""
TOO_LARGE = "simulated device 'd': main, step reply: 'd' is 300, more than 255"


def test_a_request_whose_reply_cannot_be_built_is_an_error_of_the_device(tmp_path: Path) -> None:
    (tmp_path / "silent.yaml").write_text(SILENT, "utf-8")
    path, slow = tmp_path / "silent.yaml", {"retries": 0, "reply_timeout": "2 s"}

    async def ask() -> Any:
        async with framekit.aserve(path, "pty:") as server, framekit.aconnect(path, server.port, params=slow) as one:
            with pytest.raises(framekit.NoReplyError):
                await one.call("get", params={"reply_timeout": "30 ms"})
            assert await one.read("R0") == [0]
            return server.status()[0]

    status = asyncio.run(ask())
    assert (status.services, status.errors, status.reasons) == (2, 1, {"expression": 1}), "the read was asked twice"


def test_a_simulated_device_that_cannot_build_its_reply_says_so_where_the_user_looks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("silent.yaml").write_text(SILENT, "utf-8")
    Path("silent.device.yaml").write_text("device: d\nprotocol: silent\nmemory: {set: {R1: 200}}\n", "utf-8")
    Path("silent.run.yaml").write_text(SILENT_RUN, "utf-8")
    line = ("silent.yaml", "--port", "sim:silent.device.yaml", "--retries", "0", "--timeout", "30ms")
    status, _, err = call(capsys, "call", *line, "get")
    assert status == 3 and err == f"framekit call: the device did not answer: nothing came in time – {TOO_LARGE}\n"
    status, _, err = call(capsys, "read", *line, "R1")
    assert status == 3 and "– simulated device 'd': serving 'ask': " in err
    assert call(capsys, "read", *line, "R0") == (0, "R0  0\n", "")
    _, out, _ = call(capsys, "run", "silent.run.yaml", "--virtual", "--for", "2s")
    assert f"ch 1   trouble {TOO_LARGE}\n" in out
    _, out, _ = call(capsys, "run", "silent.run.yaml", "--virtual", "--for", "2s", "--json")
    troubles = [row["reason"] for row in map(json.loads, out.splitlines()) if row["event"] == "trouble"]
    assert troubles == [TOO_LARGE]
    _, _, err = call(capsys, "run", "silent.run.yaml", "--virtual", "--for", "2s", "--log", "warning")
    assert f"channel 1: {TOO_LARGE}" in err
    seen: list[framekit.Seen] = []
    quick = {"retries": 0, "reply_timeout": "30 ms"}
    with framekit.connect("silent.yaml", "sim:silent.device.yaml", params=quick, monitor=seen.append) as client:
        with pytest.raises(framekit.NoReplyError, match=re.escape(TOO_LARGE)):
            client.call("get")
        assert [event.reason for event in seen if event.kind == "trouble"] == [TOO_LARGE]
    with framekit.serve("silent.device.yaml", "pty:", monitor=seen.append) as device:
        with framekit.connect("silent.yaml", device.port, params=quick) as client, pytest.raises(framekit.NoReplyError):
            client.read("R1")
        assert "serving 'ask'" in seen[-1].reason and seen[-1].kind == "trouble"


@pytest.mark.skipif(sys.platform == "win32", reason="the port of pyserial is tried on other systems")
def test_an_echo_is_reported_without_advice_about_the_station(capsys: pytest.CaptureFixture[str]) -> None:
    line = ["--port", "loop://", "--station", "1", "--retries", "0", "--timeout", "300 ms"]
    assert main(["read", "modbus-rtu", *line, "40001"]) == 3
    errors = capsys.readouterr().err
    assert errors == "framekit read: the device did not answer: you hear your own request: set `echo: yes`\n"


def test_a_scan_shows_stations_as_its_option_takes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "far.device.yaml").write_text("device: far\nprotocol: snp-x\nstation: 'AB'\n", "utf-8")
    words = ("scan", f"sim:{tmp_path / 'far.device.yaml'}", "snp-x", "--stations", "AB")
    assert main([*words]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:4] == ["19200", "8O1", "AB", "answers"]

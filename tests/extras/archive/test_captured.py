"""Values that are read from a capture of a line, compared with the values of the recorded run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from service.fault_world import LINKS, Link
from service.test_unfinished_requests import PLCS, SNP
from spread import spread

from framekit.api.monitor import decoder
from framekit.api.run import VirtualRun
from framekit.cli.main import main
from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.extras.archive.archive import captured_values
from framekit.extras.archive.overheard import KnownValue, Overheard
from framekit.link.frame_table import table_of
from framekit.link.scope import Scope
from framekit.link.values import Names
from framekit.runfile.devices import load_devices

BY_BUFFER = {"ccm", "host-link", "rk512-3964r"}
"""Protocols whose replies take several frames, so that a single frame gives no values."""
ADDRESSED = {link.protocol: link for link in (*LINKS, *SNP, *PLCS) if link.protocol not in BY_BUFFER}


def files(folder: Path, link: Link, number: int) -> Path:
    """Write a device with a number at the link's address, and a run that reads it."""
    station = (
        ""
        if link.station is None or link.protocol == "srtp"
        else f"station: {link.station!r}".replace("b'", "'").replace("\\x00", "")
    )
    own = ", ".join(filter(None, (f"protocol: {link.protocol}", station)))
    (folder / "d.device.yaml").write_text(
        f"device: d\n{own.replace(', ', chr(10))}\nmemory: {{set: {{'{link.address}': {number}}}}}\n"
    )
    path = folder / "r.run.yaml"
    path.write_text(
        f"run: r\nchannels:\n  1: {{port: 'sim:d.device.yaml', {own}}}\n"
        f"points:\n  p: {{channel: 1, address: '{link.address}'}}\n"
    )
    return path


@pytest.mark.parametrize("name", spread(ADDRESSED, 4))
def test_values_of_a_line_are_those_of_the_run(name: str, tmp_path: Path) -> None:
    link = ADDRESSED[name]
    run = VirtualRun(files(tmp_path, link, 77), capture=tmp_path / "line.pcap")
    run.run_for("5 s")
    value = run.points["p"].value
    run.stop()
    protocol = load_protocol(name, tmp_path)
    found = decoder(tmp_path / "line.pcap", protocol, line=None, params={}, client="out")
    values = {
        value.point.rpartition("/")[2]: value.value for value in captured_values(found.seen(), protocol, name, {})
    }
    assert value == 77 and 77 in values.values(), (value, values)


def test_what_is_written_is_known_by_its_reply(tmp_path: Path) -> None:
    path = files(tmp_path, ADDRESSED["modbus-rtu"], 77)
    path.write_text(path.read_text().replace("'40001'}", "'40001', access: rw}"))
    run = VirtualRun(path, capture=tmp_path / "line.pcap")
    run.run_for("1500 ms")
    run.points["p"].write(500)
    run.run_for("200 ms")
    run.stop()
    protocol = load_protocol("modbus-rtu", tmp_path)
    found = decoder(tmp_path / "line.pcap", protocol, line=None, params={}, client="out")
    values = list(captured_values(found.seen(), protocol, "modbus-rtu", {}))
    assert [(value.point, value.value) for value in values] == [("3/40001", 77), ("3/40001", 500)]
    assert 1_500_000_000 < values[1].time < 1_700_000_000


def test_a_reply_of_another_station_tells_nothing(tmp_path: Path) -> None:
    protocol = load_protocol("modbus-rtu", tmp_path)
    codec = compile_protocol(protocol)
    table, scope = table_of(protocol, codec), Names({}, Scope(protocol, params={}))
    memory = load_devices("modbus-rtu", tmp_path)[0].create_memory()
    line = Overheard(protocol, codec, memory, scope)

    def hear(frame: str, station: int, pdu: dict[str, Any]) -> list[KnownValue]:
        return line.hear(table.received(frame, {"station": station, "pdu": pdu}, None, None))

    assert not hear("request_adu", 3, {"read_holding": {"function": 3, "address": 0, "count": 1}})
    reply = {"read_holding_reply": {"function": 3, "bytes": 2, "values": b"\x00\x07"}}
    assert not hear("reply_adu", 4, reply)
    assert hear("reply_adu", 3, reply) == [KnownValue(3, "40001", 7)]
    assert not hear("reply_adu", 3, reply), "nothing has been asked for"


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        ("decode modbus-rtu 01 --values x.csv", 2, "--values has no effect without --capture"),
        ("decode --capture line.pcap modbus-rtu --values x.txt", 2, "write a name that ends in .csv"),
        ("decode --capture line.pcap modbus-rtu --values x.csv --to x.parquet", 2, "write different tables"),
        ("decode --capture line.pcap modbus-rtu --values x.csv --bad", 2, "--bad has no effect with --values"),
        ("decode --capture line.pcap slip --values x.csv", 2, "no frame of 'slip' asks for places of memory"),
        ("decode --capture line.pcap ccm --values x.csv", 1, "no request with a reply of one frame tells a value"),
        ("decode --capture none.pcap ccm --values x.csv", 2, "none.pcap"),
    ],
)
def test_what_cannot_be_told_is_said(
    words: str, status: int, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    run = VirtualRun(files(tmp_path, ADDRESSED["modbus-rtu"], 77), capture=tmp_path / "line.pcap")
    run.run_for("1500 ms")
    run.stop()
    assert main(words.split()) == status
    assert told in capsys.readouterr().err

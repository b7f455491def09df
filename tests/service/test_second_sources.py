"""Second sources named by vectors: each named program writes or reads the bytes of the vector.

Every vector that names a program has a case here, and vice versa. A program that is not installed is skipped.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from shipped import file_of

from framekit.definition.vectors import parse_wire

Made = dict[str, bytes]
"""Bytes by name of the vector, or of its frame if it has no name."""


class Port:
    """A port that records writes and returns the given bytes."""

    def __init__(self, incoming: bytes = b"") -> None:
        self.written, self.incoming = b"", incoming
        self.is_using = False

    def write(self, data: bytes) -> int:
        self.written += bytes(data)
        return len(data)

    writePort = write  # noqa: N815 - the name that dynamixel-sdk calls

    def clearPort(self) -> None:  # noqa: N802
        pass

    def setPacketTimeout(self, size: int) -> None:  # noqa: N802
        pass


def of_m_bus(wires: Made) -> Made:
    meterbus = pytest.importorskip("meterbus", reason="pyMeterBus is not installed")
    ping, request, select = Port(), Port(), Port()
    meterbus.send_ping_frame(ping, 1)
    meterbus.send_request_frame(request, 254)
    meterbus.send_select_frame(select, "12345678FFFFFFFF")
    plain = bytearray(select.written)
    assert plain[4] == 0x73
    plain[4] -= 0x20  # the peer sets the frame count bit; the check code changes accordingly
    plain[-2] = (plain[-2] - 0x20) & 0xFF
    name = "water meter 12345678 with three records"
    found = meterbus.load(wires[name])
    values = [float(record.parsed_value) for record in found.records]
    assert values == pytest.approx([12.565, 0.113, 218370]), "m3, m3/h, Wh"
    return {
        name: wires[name],
        "the meter with number 12345678 of any maker": bytes(plain),
        "snd_nke": ping.written,
        "req_ud2": request.written,
    }


def of_iec62056_21(wires: Made) -> Made:
    messages = pytest.importorskip("iec62056_21.messages", reason="iec62056-21 is not installed")
    sets = [messages.DataSet("0.0", "12345678"), messages.DataSet("1.8.0", "000123.4", "kWh")]
    block = messages.DataBlock([messages.DataLine([item]) for item in sets])
    made = {
        "any meter": messages.RequestMessage(),
        "one meter": messages.RequestMessage("12345678"),
        "readout at 9600 bit/s": messages.AckOptionSelectMessage("5", "0"),
        "two lines": messages.ReadoutDataMessage(block),
        "password": messages.CommandMessage("P", 1, messages.DataSet("", "00000000")),
        "read a register": messages.CommandMessage.for_single_read("1.8.0", "1"),
    }
    return {name: message.to_bytes() for name, message in made.items()}


def of_nmea0183(wires: Made) -> Made:
    pynmea2 = pytest.importorskip("pynmea2", reason="pynmea2 is not installed")
    return {name: str(pynmea2.parse(wire.decode(), check=True)).encode() + b"\r\n" for name, wire in wires.items()}


def of_ubx(wires: Made) -> Made:
    pyubx2 = pytest.importorskip("pyubx2", reason="pyubx2 is not installed")

    def made(kind: str, name: str, mode: int, **fields: Any) -> bytes:
        return bytes(pyubx2.UBXMessage(kind, name, mode, **fields).serialize())

    return {
        "poll_position": made("NAV", "NAV-PVT", pyubx2.POLL),
        "poll_version": made("MON", "MON-VER", pyubx2.POLL),
        "poll_rate": made("CFG", "CFG-RATE", pyubx2.POLL),
        "five solutions a second": made("CFG", "CFG-RATE", pyubx2.SET, measRate=200, navRate=1, timeRef=1),
        "NAV-PVT with every solution": made("CFG", "CFG-MSG", pyubx2.SET, payload=bytes([1, 7, 1])),
        "ack": made("ACK", "ACK-ACK", pyubx2.GET, clsID=6, msgID=1),
    }


def of_ve_direct(wires: Made) -> Made:
    vedirect = pytest.importorskip("vedirect", reason="vedirect is not installed")
    wire = wires["a solar charger"]
    assert vedirect.VEDirect.check_frame_checksum([wire])
    assert not vedirect.VEDirect.check_frame_checksum([wire[:-1]])
    reader = object.__new__(vedirect.VEDirect)  # made by itself it opens a port
    reader._data = {}
    reader.parse_pdu(wire.split(b"\r\n")[1:])
    assert (reader.battery_volts, reader.solar_volts, reader.solar_power) == (26.81, 33.47, 112)
    assert reader.device_serial == "HQ2132XXXXX"
    return {"a solar charger": wire}


def of_scpi(wires: Made) -> Made:
    pyvisa = pytest.importorskip("pyvisa", reason="PyVISA is not installed")
    sent: list[bytes] = []
    resource = SimpleNamespace(write_termination="\n", encoding="ascii", write_raw=sent.append)
    resource._write_termination, resource._encoding = "\n", "ascii"
    for line in ("*IDN?", "VOLT 12.5"):
        pyvisa.resources.MessageBasedResource.write(resource, line)
    from pyvisa.util import from_ieee_block, to_ieee_block

    block = "five bytes, LF among them"
    assert from_ieee_block(wires[block], "B") == [0, 10, 13, 255, 35]
    made = to_ieee_block([0, 10, 13, 255, 35], "B") + b"\n"
    return {"who are you": sent[0], "a command with an argument": sent[1], block: made}


def of_shdlc(wires: Made) -> Made:
    builder = pytest.importorskip(
        "sensirion_shdlc_driver.serial_frame_builder", reason="sensirion-shdlc-driver is not installed"
    )
    requests = {
        "serial number": (0, 0xD0, b"\x03"),
        "version": (0, 0xD1, b""),
        "station 7E is stuffed": (0x7E, 0xD1, b""),
        "reply delay": (0, 0x95, b"\0\x64"),
    }
    answered = {
        "serial number is 0123": (0, 0xD0, 0, b"0123\0"),
        "reply delay is set": (0, 0x95, 0, b""),
    }
    for name, found in answered.items():
        reader = builder.ShdlcSerialMisoFrameBuilder()
        assert reader.add_data(wires[name])
        assert reader.interpret_data() == found
    made = {name: builder.ShdlcSerialMosiFrameBuilder(*parts).to_bytes() for name, parts in requests.items()}
    return {**made, **{name: wires[name] for name in answered}}


def of_dynamixel(wires: Made) -> Made:
    sdk = pytest.importorskip("dynamixel_sdk", reason="dynamixel-sdk is not installed")
    packets = sdk.PacketHandler(2.0)

    def sent(send: Callable[[Port], Any]) -> bytes:
        port = Port()
        send(port)
        return port.written

    def positions(port: Port) -> None:
        group = sdk.GroupSyncRead(port, packets, 132, 4)
        assert group.addParam(1) and group.addParam(2)
        group.txPacket()

    def goals(port: Port) -> None:
        group = sdk.GroupSyncWrite(port, packets, 116, 4)
        assert group.addParam(1, [0x96, 0, 0, 0]) and group.addParam(2, [0xAA, 0, 0, 0])
        group.txPacket()

    def voltage(port: Port) -> None:
        group = sdk.GroupBulkRead(port, packets)
        assert group.addParam(1, 144, 2) and group.addParam(2, 146, 1)
        group.txPacket()

    def limits(port: Port) -> None:
        group = sdk.GroupBulkWrite(port, packets)
        assert group.addParam(1, 32, 2, [0xA0, 0]) and group.addParam(2, 31, 1, [0x50])
        group.txPacket()

    def only(size: int, instruction: int, *content: int) -> Callable[[Port], Any]:
        return lambda port: packets.txPacket(port, [0] * 4 + [1, size, 0, instruction, *content, 0, 0])

    return {
        name: sent(send)
        for name, send in {
            "ping": only(3, 1),
            "present position": lambda port: packets.readTx(port, 1, 132, 4),
            "goal position 512": lambda port: packets.writeTxOnly(port, 1, 116, 4, [0, 2, 0, 0]),
            "reboot": only(3, 8),
            "factory reset": only(4, 6, 1),
            "register goal velocity": lambda port: packets.regWriteTxOnly(port, 1, 104, 4, [0xC8, 0, 0, 0]),
            "do what is registered": only(3, 5),
            "present positions of two drives": positions,
            "goal positions of two drives": goals,
            "voltage of one drive and temperature of another": voltage,
            "limits of one drive and LED of another": limits,
        }.items()
    }


PROGRAMS: dict[str, Callable[[Made], Made]] = {
    "m-bus": of_m_bus,
    "iec62056-21": of_iec62056_21,
    "nmea0183": of_nmea0183,
    "ubx": of_ubx,
    "ve-direct": of_ve_direct,
    "scpi": of_scpi,
    "shdlc": of_shdlc,
    "dynamixel": of_dynamixel,
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_its_program_makes_what_vectors_say_of_it(name: str) -> None:
    vectors = yaml.load(file_of(f"{name}.vectors.yaml").read_text(encoding="utf-8"), yaml.BaseLoader)
    cases = [frame for frame in vectors["frames"] if "second_source" in frame]
    wires = {case.get("name", case["frame"]): parse_wire(case["bytes"]).exact for case in cases}
    assert len(wires) == len(cases) and None not in wires.values()
    assert PROGRAMS[name](wires) == wires

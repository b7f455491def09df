"""Users' notations for their devices: stations as text, Series 90 addresses, negative levels."""

from __future__ import annotations

from pathlib import Path

import pytest

import framekit
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError


def device(folder: Path, protocol: str, station: str, memory: str) -> str:
    file = folder / f"{protocol}.device.yaml"
    file.write_text(f"device: one\nprotocol: {protocol}\nstation: {station}\nmemory: {{set: {memory}}}\n")
    return f"sim:{file}"


@pytest.mark.parametrize("station", ["UNIT7", "55 4E 49 54 37 00 00 00", b"UNIT7\0\0\0"])
def test_a_station_of_bytes_is_given_as_text_too(tmp_path: Path, station: str | bytes) -> None:
    with framekit.connect("snp-x", device(tmp_path, "snp-x", "UNIT7", "{R1: [5, 6]}"), station=station) as client:
        assert client.read("R1", 2) == [5, 6]
    with pytest.raises(framekit.RequestError, match="'UNIT56789' has 9 characters, at most 8 are possible"):
        framekit.connect("snp-x", "loop://", station="UNIT56789")


@pytest.mark.parametrize("station", ["{type: bytes, pad: 00}", "{type: text, size: 8, pad: 00}"])
def test_a_fill_byte_that_fills_nothing_is_told(station: str) -> None:
    with pytest.raises(DefinitionError, match="pad fills texts for stations of type bytes with a size – leave pad out"):
        load_protocol_text(f"protocol: t\nstation: {station}\nframes: {{f: {{body: [{{const: AA}}]}}}}\n")


def test_ge_rtu_knows_the_addresses_of_the_series_90(tmp_path: Path) -> None:
    port = device(tmp_path, "ge-rtu", "1", '{"%R1": [5, 6], "%AI2": [9], "%I1": [1, 0, 1], "00001": [0, 1]}')
    with framekit.connect("ge-rtu", port, station=1) as client:
        assert client.read("%R1", 2) == client.read("40001", 2) == [5, 6]
        assert client.read("%AI2") == client.read("30002") == [9]
        assert client.read("%I1", 3) == client.read("10001", 3) == [1, 0, 1]
        assert client.read("%Q1", 2) == client.read("coil:0", 2) == [0, 1]
        client.write("%Q2", 0)
        assert client.read("00002") == [0]
        with pytest.raises(framekit.RequestError, match="%R1 to %R65536"):
            client.read("%R0")


def test_the_highest_level_of_a_password_is_asked_for_with_minus_one(tmp_path: Path) -> None:
    """SNP specification 12.1: FF (-1) selects the highest level with this password.

    Without passwords, none is required.
    """
    with framekit.connect("snp", device(tmp_path, "snp", "UNIT7", "{}"), station="UNIT7") as client:
        assert client.call("change_level", {"level": -1})["level"] == 4
        with pytest.raises(framekit.RefusedError, match="password invalid"):
            client.call("change_level", {"level": -1, "password": "SECRET"})
        with pytest.raises(framekit.RequestError, match=r"-2 is not in -1\.\.255"):
            client.call("change_level", {"level": -2})


@pytest.mark.parametrize("processor", ["plc3", "plc5", "plc5_250"])
def test_what_is_decoded_of_system_addresses_can_be_encoded(processor: str) -> None:
    """Every form of the manual's levels: short and long, with omitted levels that have a default, and symbols."""
    pccc = framekit.load("df1", params={"processor": processor})
    head = bytes.fromhex("01 02 0F 00 07 00 01 00 00 0A 00")
    decoded_count = 0
    for flags in range(256):
        levels = 8 if processor == "plc5_250" else 6 if processor == "plc3" else 4
        address = b"".join(bytes([n + 1]) for n in range(levels) if flags >> n & 1) or b"$N7:0\0"[processor == "plc3" :]
        for text in (address, address.replace(b"\x02", b"\xff\x02\x00")):
            data = head + bytes([flags]) + (b"\0" if flags == 255 and processor == "plc5_250" else b"") + text + b"\x14"
            try:
                frame = pccc.decode(data, "word_range_read")
            except framekit.FrameError:
                continue
            if frame.refusal is None:
                again = pccc.encode("word_range_read", **frame.fields)
                assert pccc.decode(again, "word_range_read").fields == frame.fields
                decoded_count += 1
    assert decoded_count >= 16


def test_one_port_for_two_protocols_over_one_memory(tmp_path: Path) -> None:
    """A break-free SNP slave that also accepts X-Attach: values of one protocol are read by the other (F037)."""
    file = tmp_path / "cpu.device.yaml"
    file.write_text("device: cpu\nprotocol: snp\nalso: snp-x\nstation: UNIT7\nparams: {use_break: no}\n")
    given = {"station": "UNIT7", "params": {"use_break": "no"}}
    with framekit.serve(file, "tcp://127.0.0.1:0") as server:
        with framekit.connect("snp-x", server.port, **given) as client:
            client.write("R2", [77])
        with framekit.connect("snp", server.port, **given) as client:
            assert client.read("R2") == [77]
    with framekit.connect("snp-x", f"sim:{file}", **given) as client:
        assert client.read("R2") == [0]


@pytest.mark.parametrize(
    ("also", "message"),
    [
        ("snp", "'snp' is no other protocol for this line – name a protocol, each once"),
        ("[snp-x, snp-x]", "'snp-x' is no other protocol for this line – name a protocol, each once"),
        ("modbus-rtu", "no area of 'modbus-rtu' is in the memory of this device – name a protocol for the same memory"),
        ("snpx", "there is no definition 'snpx' – did you mean"),
    ],
)
def test_a_second_protocol_that_does_not_fit_is_told(tmp_path: Path, also: str, message: str) -> None:
    file = tmp_path / "cpu.device.yaml"
    file.write_text(f"device: cpu\nprotocol: snp\nalso: {also}\nstation: UNIT7\n")
    with pytest.raises(DefinitionError) as error:
        framekit.serve(file, "tcp://127.0.0.1:0")
    assert message in str(error.value) and f"{file}:3:" in str(error.value)

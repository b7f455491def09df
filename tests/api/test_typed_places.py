"""Typed places: numbers of the type that the protocol declares.

Text is refused for elements with a form of their own.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import framekit
from framekit.api.errors import RequestError
from framekit.api.values import typed
from framekit.api.vectors import run_vectors
from framekit.codec.codec import compile_protocol
from framekit.link.services.rows import ServiceRows
from framekit.runfile.run_file import load_run


def test_text_does_not_go_into_structures() -> None:
    protocol = framekit.load("df1").definition
    grammar = ServiceRows(protocol, compile_protocol(protocol)).grammar
    assert typed(grammar, "N7:0", "string", None, 5).units == 3
    with pytest.raises(
        RequestError, match="ST9:0 is an element of 84 bytes with a form of its own – leave the type out"
    ):
        typed(grammar, "ST9:0", "string", None, 5)
    with pytest.raises(RequestError, match="T4:0 is an element of 6 bytes with a form of its own – write its bytes"):
        typed(grammar, "T4:0", "string", None, 5)


DEVICE = "device: one\nprotocol: df1\nrole: full\nstation: 1\n"
RUN = """
run: fractions
memory: masterlogic
channels:
  1: {port: "sim:one.device.yaml", protocol: df1, role: full, station: 1}
blocks:
  0: {write: "F8:0", values: [1.5], count: 2, every: 1 s}
  1: {write: ["F8:2", "N7:0"], values: [-2, 3], every: 1 s}
  2: {write: "F8:3", values: [0x3F800000], type: dword, every: 1 s}
  3: {write: "ST9:0", values: [ab], every: 1 s}
"""


def test_places_are_read_and_written_as_what_they_hold(tmp_path: Path) -> None:
    file = tmp_path / "one.device.yaml"
    file.write_text(DEVICE, encoding="utf-8")
    with framekit.connect("df1", f"sim:{file}", role="full", station=1) as client:
        client.write("F8:0", [1.5, -2])
        client.write_many({"F8:2": 0.25, "N7:0": 7})
        assert client.read("F8:0", 3) == [1.5, -2.0, 0.25]
        mixed = client.read_many(["N7:0", "F8:0", "B3:0/1"])
        assert (mixed, mixed.type) == ([7, 1.5, 0], "int16, float32, bit")
        assert client.read_many(["F8:0", "F8:1"], type="dword") == [0x3FC00000, 0xC0000000]
        assert client.place("F8:0").type == "float32"
        client.write("N7:1", [-1, 32767])
        client.write("L11:0", -100000)
        assert client.read("N7:1", 2) == [-1, 32767] and client.read("N7:1", type="word") == [0xFFFF]
        assert client.read("L11:0") == [-100000] and client.read("N7:1/15") == [1]
        with pytest.raises(RequestError, match="40000 does not fit into 16 bits with sign: -32768 to 32767"):
            client.write("N7:1", 40000)
        with pytest.raises(RequestError, match="'F8:' is not an address"):
            client.place("F8:")
        with pytest.raises(RequestError, match="order= is for numbers and text"):
            client.read_many(["F8:0", "B3:0"], order="ABCD")


def test_texts_stand_with_their_length(tmp_path: Path) -> None:
    file = tmp_path / "one.device.yaml"
    file.write_text(DEVICE + 'memory: {set: {"ST9:0": [hello, "line 2"]}}\n', encoding="utf-8")
    with framekit.connect("df1", f"sim:{file}", role="full", station=1) as client:
        assert client.read("ST9:0", 3) == ["hello", "line 2", ""]
        assert client.read("ST9:0", 4, type="word") == [5, 0x6865, 0x6C6C, 0x6F00]
        client.write("ST9:1", ["a" * 82, "ü"])
        client.write_many({"ST9:3": "odd", "N7:0": -1})
        mixed = client.read_many(["ST9:2", "N7:0", "ST9:1"])
        assert (mixed, mixed.type) == (["ü", -1, "a" * 82], "counted_string, int16")
        client.write("ST9:2", [90], type="word")
        assert client.read("ST9:2").value == "ü" + 81 * "\0", "a length beyond the element is all of it"
        for value, why in [
            ("x" * 83, "has 83 characters, there is room for 82"),
            (5, "5 is no text"),
            ("→", "'→' is no char"),
        ]:
            with pytest.raises(RequestError, match=why):
                client.write("ST9:0", value)
        assert client.read("ST9:3").value == "odd"


def test_constants_of_blocks_are_of_the_type_of_their_place(tmp_path: Path) -> None:
    (tmp_path / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
    file = tmp_path / "fractions.run.yaml"
    file.write_text(RUN, encoding="utf-8")
    assert [block.values for block in load_run(file).blocks] == [
        (0x3FC00000, 0x3FC00000), (0xC0000000, 3), (0x3F800000,), (0x61620002,),
    ]  # fmt: skip


def test_the_memory_of_a_server_goes_by_it_too() -> None:
    with framekit.serve("df1", "tcp://127.0.0.1:0", role="full", station=1) as server:
        server.memory["F8:0"] = 1.5
        assert server.memory["F8:0"] == 1.5
        assert server.memory.read("F8:0", type="dword") == [0x3FC00000]


def test_what_is_no_value_no_list_and_no_bytes_is_told(tmp_path: Path) -> None:
    file = tmp_path / "one.device.yaml"
    file.write_text(DEVICE, encoding="utf-8")
    with framekit.connect("df1", f"sim:{file}", role="full", station=1) as client:
        assert repr(client) == f"<Client of df1 on sim:{file}, station 1, open>"
        with pytest.raises(RequestError, match="None cannot be written – give a number, a text or a list of them"):
            client.write("N7:0", None)  # type: ignore[arg-type]
        for wrong in ("N7:0", []):
            with pytest.raises(RequestError, match="several addresses are a list with one at least"):
                client.read_many(wrong)
        with pytest.raises(RequestError, match="several addresses are a list with one at least"):
            client.write_many({})
    assert repr(client).endswith(", not open>")
    with pytest.raises(RequestError, match="a frame is bytes, such as bytes"):
        framekit.load("df1").decode("10 06")  # type: ignore[arg-type]
    with pytest.raises(RequestError, match="start values go into initial"):
        framekit.serve("df1", "pty:", station=1, memory={"N7:0": 5})  # type: ignore[arg-type]


def test_decimal_digits_of_four_bits(tmp_path: Path) -> None:
    """D files have words of four BCD digits (DF1 specification 4.1, D25)."""
    file = tmp_path / "slc.device.yaml"
    file.write_text(
        "device: slc\nprotocol: df1\nrole: full\nstation: 1\nparams: {processor: plc5}\n"
        'memory: {sizes: {"D12:0": 10}, set: {"D12:0": 1234, "N7:0": 0x0987, "N7:1": 0x1A2B}}\n'
    )
    with framekit.connect("df1", f"sim:{file}", station=1, role="full", params={"processor": "plc5"}) as client:
        assert client.read("D12:0") == [1234]
        assert client.read("D12:0", type="word") == [0x1234]
        client.write("D12:1", 9999)
        assert client.read("D12:1", type="word") == [0x9999]
        assert client.read("N7:0", type="bcd16") == [987]
        with pytest.raises(
            framekit.ReplyError, match="0x1A2B is no number in BCD: a digit is 0 to 9 – read it as word"
        ):
            client.read("N7:1", type="bcd16")
        with pytest.raises(framekit.RequestError, match="10000 does not fit into 4 decimal digits"):
            client.write("D12:1", 10000)
    (tmp_path / "meter.device.yaml").write_text("device: meter\nprotocol: modbus-rtu\nstation: 1\n")
    with framekit.connect("modbus-rtu", f"sim:{tmp_path / 'meter.device.yaml'}", station=1) as client:
        client.write("40001", 12345678, type="bcd32")
        assert client.read("40001", 2) == [0x5678, 0x1234]
        assert client.read("40001", type="bcd32") == [12345678]
        assert client.read("40001", type="bcd32", order="ABCD") == [56781234]
        client.write("40001", 0xA)
        with pytest.raises(framekit.ReplyError, match="read it as dword"):
            client.read("40001", type="bcd32")


def test_values_of_vectors_are_of_the_type_of_their_area(tmp_path: Path) -> None:
    definition = """
protocol: typed
extends: standard
station: {type: number, range: 0..9, default: 1}
groups: {request: {from: client}, answer: {from: server}}
areas: {F: {unit: dword, type: float32, size: 4}, I: {unit: dword, type: int32, size: 4}}
addresses: [{form: "{area}{start:dec}"}]
frames:
  GET: {group: request, body: [{const: ENQ}, {field: station, type: u8}, {field: start, type: u8}]}
  GOT: {group: answer, body: [{const: STX}, {field: station, type: u8}, {data: values, size: 4}]}
  PUT: {group: request, body: [{const: SOH}, {field: station, type: u8}, {field: start, type: u8}, {data: values, size: 4}]}
  HAS: {group: answer, body: [{const: ACK}, {field: station, type: u8}]}
services:
  read: [{areas: F, limit: {bytes: 4}, request: {GET: {station: station, start: start}}, reply: {GOT: {station: station, values: data}}}]
  write: [{areas: F, limit: {bytes: 4}, request: {PUT: {station: station, start: start, values: data}}, reply: {HAS: {station: station}}}]
"""  # noqa: E501
    vectors = """
vectors: typed
conversations:
  - {name: read, role: client, do: {read: F1}, script: [{send: 05 01 01}, {receive: 02 01 3F C0 00 00}], result: {values: [1.5]}}
  - {name: write, role: client, do: {write: F1, values: 1.5}, script: [{send: 01 01 01 3F C0 00 00}, {receive: 06 01}]}
  - {name: raw, role: client, do: {write: F1, values: 0x3FC00000}, script: [{send: 01 01 01 3F C0 00 00}, {receive: 06 01}]}
  - {name: serve, role: server, own: 1, memory: {F1: -2, I0: -2}, script: [{receive: 05 01 01}, {send: 02 01 C0 00 00 00}], result: {memory: {F1: -2.0, I0: -2}}}
  - {name: wrong, role: server, own: 1, memory: {F1: 3}, script: [{receive: 01 01 01 3F C0 00 00}, {send: 06 01}], result: {memory: {F1: 1.75}}}
"""  # noqa: E501
    (tmp_path / "typed.yaml").write_text(definition, "utf-8")
    (tmp_path / "typed.vectors.yaml").write_text(vectors, "utf-8")
    results = {result.name: result.problems for result in run_vectors(tmp_path / "typed.yaml")}
    (problem,) = results.pop("wrong")
    assert results == dict.fromkeys(("read", "write", "raw", "serve"), ())
    assert problem.endswith("F1 holds [1.5] afterwards, expected [1.75]")

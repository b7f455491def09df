"""Frames that are decoded together with their inner frame: the same values and faults as decoding in two steps."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from shipped import PROTOCOLS
from spread import spread

from framekit.codec.ambiguity import sample_context
from framekit.codec.codec import code_of, compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.functions import FrameFunctions, module_of
from framekit.codec.python.decode import MOST_PAIRS, pairs_of
from framekit.codec.python.generate import generate_source, normal_protocol
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.frames import StaticSizes
from framekit.definition.model.protocol import Protocol


def pairs(protocol: Protocol) -> list[tuple[str, str]]:
    """Return every frame and inner frame that are decoded together."""
    shapes = StaticSizes(normal_protocol(protocol).frames)
    return [(name, pair.inside_name) for name, frame in shapes.frames.items() for pair in pairs_of(shapes, frame)]


class Both:
    """The functions of a protocol that decode two frames together, and those that decode them in two steps."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.together = compile_protocol(protocol)
        self.apart = FrameFunctions(module_of(protocol.name, code_of(protocol)))
        self.context = sample_context(protocol)
        self.sampler = Sampler(self.together, self.context)
        self.random = Random(protocol.name)
        for name, table in self.tables(self.apart).items():
            assert any(table), name
            table[:] = [None] * 256

    def tables(self, functions: FrameFunctions) -> dict[str, list[Any]]:
        return {name: value for name, value in vars(functions.module).items() if name.endswith("_FUSED")}

    def compare(self, frame: str, inside: str) -> bool:
        """Assert that samples and damaged bytes decode alike.

        Return whether the two frames were ever decoded together.
        """
        reader = self.reader(frame, inside)
        found = False
        for sample in self.sampler.samples(inside):
            data = self.around(frame, inside, sample.values)
            if data is None:
                continue
            found = found or self.read(reader, data) == self.read(self.apart.decoders[frame], data)
            for damaged in [data, *(self.damaged(data) for _ in range(12))]:
                one, other = self.apart.decoders[frame], self.together.decoders[frame]
                assert self.read(one, damaged) == self.read(other, damaged), damaged.hex(" ")
        return found

    def reader(self, frame: str, inside: str) -> Any:
        """Return the function that decodes both frames."""
        tables = self.tables(self.together).values()
        doc = f"Read `{frame}` with `{inside}` inside."
        return next(
            function for table in tables for function in table if function is not None and function.__doc__ == doc
        )

    def around(self, frame: str, inside: str, fields: Any) -> bytes | None:
        """Return the bytes of the frame around the inner frame."""
        for sample in self.sampler.samples(frame):
            name = next(name for name, value in sample.values.items() if isinstance(value, dict))
            try:
                return self.together.encode(frame, {**sample.values, name: {inside: fields}}, self.context)
            except EncodeError:  # too long for the frame around it
                continue
        return None

    def read(self, decode: Any, data: bytes) -> Any:
        try:
            return decode(data, self.context)
        except FrameError as error:
            return error.cause, error.segment, error.offset, error.refuse, str(error)
        except ValueError:
            return None

    def damaged(self, data: bytes) -> bytes:
        changed = bytearray(data)
        for _ in range(self.random.choice([1, 1, 2])):
            place = self.random.randrange(len(changed))
            match self.random.randrange(5):
                case 0:
                    del changed[place]
                case 1:
                    changed.insert(place, self.random.randrange(256))
                case 2:
                    del changed[max(place, 1) :]
                case _:
                    changed[place] ^= 1 << self.random.randrange(8)
        return bytes(changed)


@pytest.mark.parametrize("name", spread(PROTOCOLS, 6, 2))
def test_shipped_frames_are_read_alike(name: str) -> None:
    both = Both(load_protocol(name))
    for frame, inside in pairs(both.protocol):
        assert both.compare(frame, inside), (frame, inside)


def test_frames_of_shipped_protocols_are_joined() -> None:
    assert all(pairs(load_protocol(name)) for name in ("modbus-rtu", "modbus-tcp", "ge-rtu"))
    assert ("reply_adu", "read_holding_reply") in pairs(load_protocol("modbus-rtu"))


# ---- what may be joined -------------------------------------------------------------------------------------

FIXED = "{group: inside, body: [{field: kind, type: u8, is: 1}, {field: a, type: u16}, {field: b, type: u8}]}"
LONG = "{group: inside, body: [{field: kind, type: u8, is: 2}, {length: n, type: u8, of: [d]}, {data: d, size: n}]}"
REST = "{group: inside, body: [{field: kind, type: u8, is: 3}, {data: d, size: rest}]}"
SUM = "{check: sum8}"
INNER = "{inner: pdu, of: inside}"


def protocol_of(head: str, tail: str, *frames: str, keys: str = "", more: str = "") -> Protocol:
    """Return a protocol with the frame `f` of these segments, around frames named `x0`, `x1` …"""
    lines = ["protocol: joined", "order: big", *([more] if more else []), "groups:", "  inside: {}", "frames:"]
    lines.append(f"  f: {{{keys}body: [{head}{tail}]}}")
    lines += [f"  x{place}: {frame}" for place, frame in enumerate(frames)]
    return load_protocol_text("\n".join(lines), "joined")


STATION = "{field: station, type: u8}, "
SIZED = f"{{length: n1, type: u16, of: [station, pdu]}}, {STATION}{{inner: pdu, of: inside, size: n1 - 1}}"


@pytest.mark.parametrize(
    ("head", "tail"),
    [
        (STATION, f"{INNER}, {SUM}"),
        ("", f"{INNER}, {SUM}"),
        ("{const: 1B}, ", f"{INNER}, {{const: 03}}, {SUM}"),
        (STATION, f"{INNER}, {{check: crc16-modbus, order: little}}"),
        (STATION, f"{INNER}, {{check: sum8, over: [pdu]}}"),
        ("", SIZED),
        (STATION, "{inner: pdu, of: inside, size: rest}"),
    ],
)
def test_frames_around_others(head: str, tail: str) -> None:
    both = Both(protocol_of(head, tail, FIXED, LONG, REST))
    assert pairs(both.protocol) == [("f", "x0"), ("f", "x1"), ("f", "x2")]
    for frame, inside in pairs(both.protocol):
        assert both.compare(frame, inside)


def test_a_frame_of_fixed_size_is_filled_up() -> None:
    both = Both(protocol_of(STATION, f"{INNER}, {SUM}", FIXED, keys="size: 12, fill: 20, "))
    assert pairs(both.protocol) == [("f", "x0")]
    assert both.compare("f", "x0")
    assert not pairs(protocol_of(STATION, INNER, FIXED, LONG, keys="size: 12, "))  # their ends must be searched


def test_the_longest_frame_is_not_longer() -> None:
    both = Both(protocol_of(STATION, f"{INNER}, {SUM}", LONG, keys="max: 20, "))
    data = bytes((1, 2, 40, *range(40)))
    data += bytes((sum(data) & 0xFF,))
    assert pairs(both.protocol) == [("f", "x0")]
    assert both.read(both.together.decoders["f"], data)[0] == "too_long"
    assert both.compare("f", "x0")


@pytest.mark.parametrize(
    ("frame", "head", "tail"),
    [
        (FIXED, "{field: a, type: u8}, ", f"{INNER}, {SUM}"),  # one name, two fields
        (FIXED, "{field: pdu_, type: u8, when: 1 == 1}, ", f"{INNER}, {SUM}"),  # no fixed place
        (FIXED, STATION, f"{INNER}, {{data: more, size: rest}}, {{check: sum8, over: pdu..here}}"),
        (LONG, STATION, f"{INNER}, {{data: more, size: rest}}"),  # its end must be searched
        ("{group: inside, body: [{field: kind, type: u8, is: 1}, {check: sum8}]}", STATION, f"{INNER}, {SUM}"),
        (
            "{group: inside, body: [{field: kind, type: u8, is: 1}, {field: a, type: u8, when: kind == 1}]}",
            STATION,
            f"{INNER}, {SUM}",
        ),
        (
            "{group: inside, body: [{field: kind, type: u8, is: 1}, {require: station == 1}]}",  # a name outside
            STATION,
            f"{INNER}, {SUM}",
        ),
        (f"{REST[:-1]}, max: 8}}", STATION, f"{INNER}, {SUM}"),
        (f"{FIXED[:-1]}, refuse: 3}}", STATION, f"{INNER}, {SUM}"),
    ],
)
def test_frames_that_are_read_one_after_the_other(frame: str, head: str, tail: str) -> None:
    protocol = protocol_of(head, tail, frame)
    assert pairs(protocol) == []
    assert "_FUSED" not in generate_source(protocol)


def test_there_is_a_bound() -> None:
    frames = [f"{{group: inside, body: [{{field: kind, type: u8, is: {number}}}]}}" for number in range(MOST_PAIRS + 5)]
    both = Both(protocol_of(STATION, f"{INNER}, {SUM}", *frames))
    assert len(pairs(both.protocol)) == MOST_PAIRS
    last = {"station": 1, "pdu": {f"x{MOST_PAIRS + 4}": {}}}
    data = both.together.encode("f", last)
    assert both.together.decode("f", data) == both.apart.decode("f", data)


def test_a_module_that_stands_alone_reads_them_so() -> None:
    names: dict[str, Any] = {"__name__": "alone"}
    exec(compile(generate_source(load_protocol("modbus-rtu")), "alone", "exec"), names)
    data = names["encode_reply_adu"]({"station": 17, "pdu": {"read_holding_reply": {"values": b"\1\2"}}})
    fused = names["REPLY_ADU_FUSED"][3]
    assert fused(data, names["DEFAULTS"]) == names["decode_reply_adu"](data)
    with pytest.raises(ValueError, match=r"^$"):
        fused(data[:-1], names["DEFAULTS"])

"""pymavlink, an independent implementation: every message both ways with random values, heartbeats over UDP.

Skipped only if it is not installed.
"""

from __future__ import annotations

import socket
from random import Random
from typing import Any

import pytest

import framekit

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from pymavlink.dialects.v20 import common

KNOWN = {message.msgname: message for message in common.mavlink_map.values()}
CODEC = framekit.load("mavlink2")
MESSAGES = sorted(name for name in KNOWN if name in CODEC.frames)
BOUNDS = {"uint8_t": (0, 8), "uint16_t": (0, 16), "uint32_t": (0, 32), "uint64_t": (0, 64)}
BOUNDS |= {"int8_t": (1, 8), "int16_t": (1, 16), "int32_t": (1, 32), "int64_t": (1, 64)}


def drawn(random: Random, kind: str) -> Any:
    if kind in ("float", "double"):
        return random.choice((0.0, random.randrange(-(2**20), 2**20) / 16))
    signed, bits = BOUNDS[kind]
    low = -(1 << bits - 1) if signed else 0
    return random.choice((0, random.randrange(low, low + (1 << bits))))


def values_of(random: Random, message: Any) -> dict[str, Any]:
    """Return a value for each field, many of them 0, so payloads are shortened."""
    values: dict[str, Any] = {}
    for name, kind in zip(message.fieldnames, message.fieldtypes, strict=True):
        size = message.array_lengths[message.ordered_fieldnames.index(name)]
        if kind == "char":
            values[name] = bytes(random.randrange(65, 91) for _ in range(random.randrange(size + 1)))
        elif size:
            values[name] = [drawn(random, kind) for _ in range(size)]
        else:
            values[name] = drawn(random, kind)
    return values


def ours(message: Any, values: dict[str, Any]) -> dict[str, Any]:
    """Return the values as framekit decodes them: texts are padded with zeros."""
    found = {}
    for name, value in values.items():
        size = message.array_lengths[message.ordered_fieldnames.index(name)]
        found[f"{name}_" if f"{name}_" in NAMES else name] = (
            value.ljust(size, b"\0") if isinstance(value, bytes) else value
        )
    return found


NAMES = {"sequence_", "system_", "component_", "id_", "n_", "payload_", "incompatible_", "compatible_"}


def test_the_file_has_the_messages_of_the_tool() -> None:
    assert len(MESSAGES) == len(CODEC.frames) == 37


@pytest.mark.parametrize("name", MESSAGES)
def test_every_message_both_ways(name: str) -> None:
    random, message = Random(name), KNOWN[name]
    mav = common.MAVLink(None, srcSystem=7, srcComponent=9)
    reader = common.MAVLink(None)
    for _ in range(60):
        values = values_of(random, message)
        wire = message(**values).pack(mav)
        expected = ours(message, values)
        found = CODEC.decode(bytes(wire))
        assert found.name == name
        assert {field: found[field] for field in expected} == expected
        assert (found["system"], found["component"], found["id"]) == (7, 9, message.id)
        built = CODEC.encode(name, sequence=mav.seq, system=7, component=9, **expected)
        assert built == wire
        theirs = reader.parse_char(built)
        assert theirs.get_type() == name and theirs.get_srcSystem() == 7
        assert bytes(theirs.get_msgbuf()) == built
        mav.seq = (mav.seq + 1) % 256


def test_heartbeats_over_udp(monkeypatch: pytest.MonkeyPatch) -> None:
    """pymavlink's own connection accepts framekit's heartbeat, and its answer is decoded."""
    monkeypatch.setenv("MAVLINK20", "1")
    from pymavlink import mavutil

    here = mavutil.mavlink_connection("udpin:127.0.0.1:0", source_system=42, dialect="common")
    fields = {"custom_mode": 5, "type": 2, "autopilot": 3, "base_mode": 81, "system_status": 4, "mavlink_version": 3}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours_:
        ours_.settimeout(20)
        try:
            wire = CODEC.encode("HEARTBEAT", sequence=1, system=7, component=1, **fields)
            ours_.sendto(wire, here.port.getsockname())
            got = here.recv_match(type="HEARTBEAT", blocking=True, timeout=20)
            assert got is not None and {name: getattr(got, name) for name in fields} == fields
            here.mav.heartbeat_send(6, 8, 0, 0, 4)
            answer = CODEC.decode(ours_.recv(300))
            assert (answer.name, answer["system"], answer["type"], answer["autopilot"]) == ("HEARTBEAT", 42, 6, 8)
        finally:
            here.close()

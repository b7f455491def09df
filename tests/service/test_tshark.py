"""tshark, an independent program, decodes frames built by framekit: good and damaged frames, compared field by field.

All frames go into one capture and tshark runs once. Skipped only if the program is not installed.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from random import Random
from struct import pack
from typing import Any, NamedTuple

import pytest

import framekit

TSHARK = shutil.which("tshark")
pytestmark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed")

MSTP, RAW_IP = 165, 101
"""Link types of captures: an MS/TP frame, an IP packet."""
FIELDS = {
    "bacnet-mstp": {
        "type": "mstp.frame_type", "destination": "mstp.dst", "source": "mstp.src", "size": "mstp.len",
    },
    "dnp3-link": {
        "size": "dnp3.len", "dir": "dnp3.ctl.dir", "prm": "dnp3.ctl.prm", "fcb": "dnp3.ctl.fcb", "fcv": "dnp3.ctl.fcv",
        "destination": "dnp3.dst", "source": "dnp3.src", "fin": "dnp3.tr.fin", "fir": "dnp3.tr.fir",
        "number": "dnp3.tr.seq",
    },
    "fins-tcp": {
        "gateways": "omron.gct", "to_network": "omron.dna", "to_node": "omron.da1", "to_unit": "omron.da2",
        "from_network": "omron.sna", "from_node": "omron.sa1", "from_unit": "omron.sa2", "sid": "omron.sid",
    },
}  # fmt: skip
"""Names of fields: framekit → tshark."""
FAULTS = ("mstp.checksum.status", "dnp3.hdr.CRC.incorrect", "dnp3.data_chunk.CRC.incorrect")
FIRST_DAMAGED = {"bacnet-mstp": 7, "dnp3-link": 10}
"""First offset of damage: with a wrong size or another DNP3 header on TCP, tshark would decode another protocol."""
PORTS = {"dnp3-link": 20000, "fins-tcp": 9600}


class Sent(NamedTuple):
    """A frame in the capture; `values` are the values that framekit decodes, or None if it is damaged."""

    protocol: str
    data: bytes
    values: dict[str, Any] | None


def frames_of_mstp(random: Random) -> list[tuple[str, dict[str, Any]]]:
    def ends() -> dict[str, Any]:
        return {"destination": random.randrange(256), "source": random.randrange(255)}

    short = ("token", "poll_for_master", "reply_to_poll_for_master", "test_request_empty", "reply_postponed")
    long = ("test_request", "test_response")
    found = [(name, ends()) for name in short]
    return found + [
        (name, {**ends(), "data": random.randbytes(size)}) for name in long for size in (1, 2, 17, 255, 501)
    ]


def frames_of_dnp3(random: Random) -> list[tuple[str, dict[str, Any]]]:
    def ends(**more: Any) -> dict[str, Any]:
        return {"dir": random.randrange(2), "destination": random.randrange(1 << 16), "source": 7, **more}

    found = [(name, ends(fcb=random.randrange(2))) for name in ("reset_link", "test_link", "request_link_status")]
    found += [(name, ends(dfc=0)) for name in ("ack", "nack", "link_status", "not_supported")]
    for size in (0, 1, 14, 15, 16, 31, 32, 249):  # no application message begins here: fir is 0
        transport = {"fin": random.randrange(2), "fir": 0, "number": random.randrange(64)}
        found.append(("unconfirmed_user_data", ends(fcb=0, **transport, segment=random.randbytes(size))))
        found.append(("confirmed_user_data", ends(fcb=1, **transport, segment=random.randbytes(size))))
    return found


def frames_of_fins(random: Random) -> list[tuple[str, dict[str, Any]]]:
    names = [*FIELDS["fins-tcp"]]
    header = {name: random.randrange(256) for name in names} | {
        "gateways": 2,
        "gateway": 1,
        "response": 0,
        "no_reply": 0,
    }
    read = {"read": {"area": 0x82, "address": random.randrange(1 << 16), "bit": 0, "count": 3}}
    return [("from_client", {"content": {"command_frame": {**header, "fins": read}}})]


MADE = {"bacnet-mstp": frames_of_mstp, "dnp3-link": frames_of_dnp3, "fins-tcp": frames_of_fins}


def all_frames() -> list[Sent]:
    """Return frames of all protocols; frames with a check code also with a damaged byte."""
    random, found = Random(17), list[Sent]()
    for protocol, make in MADE.items():
        codec = framekit.load(protocol)
        for frame, values in make(random):
            data = codec.encode(frame, **values)
            found.append(Sent(protocol, data, read(codec, frame, data)))
            first = FIRST_DAMAGED.get(protocol, len(data))
            if len(data) > first:
                wrong = bytearray(data)
                wrong[random.randrange(first, len(data))] ^= 1 << random.randrange(8)
                found.append(Sent(protocol, bytes(wrong), None))
    return found


def read(codec: Any, frame: str, data: bytes) -> dict[str, Any]:
    values = dict(codec.decode(data, frame).fields)
    inner = values.get("content")
    return values if inner is None else {**values, **dict(inner["command_frame"])}


def packet(protocol: str, data: bytes, number: int) -> bytes:
    """Return the frame as it is captured: the frame itself, or the TCP packet that carries it."""
    if protocol not in PORTS:
        return data
    tcp = pack(">HHIIBBHHH", 40000 + number, PORTS[protocol], 1, 1, 5 << 4, 0x18, 8192, 0, 0)
    address = bytes((127, 0, 0, 1))
    size = 20 + len(tcp) + len(data)
    return pack(">BBHHHBBH4s4s", 0x45, 0, size, number, 0, 64, 6, 0, address, address) + tcp + data


def capture(frames: list[Sent]) -> bytes:
    """Return a pcapng file with an interface for each link type."""

    def block(kind: int, content: bytes) -> bytes:
        content += bytes(-len(content) % 4)
        size = len(content) + 12
        return pack("<II", kind, size) + content + pack("<I", size)

    blocks = [block(0x0A0D0D0A, pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))]
    blocks += [block(1, pack("<HHI", link, 0, 0)) for link in (MSTP, RAW_IP)]
    for number, one in enumerate(frames):
        data = packet(one.protocol, one.data, number)
        head = pack("<IIIII", int(one.protocol in PORTS), 0, number, len(data), len(data))
        blocks.append(block(6, head + data))
    return b"".join(blocks)


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Sent, dict[str, str]]]:
    """Return every frame with the fields that tshark finds in it, by tshark's names."""
    assert TSHARK is not None
    frames = all_frames()
    file: Path = tmp_path_factory.mktemp("capture") / "frames.pcapng"
    file.write_bytes(capture(frames))
    wanted = list(dict.fromkeys([*(name for names in FIELDS.values() for name in names.values()), *FAULTS]))
    options = ["-T", "fields", "-E", "separator=|", *(word for name in wanted for word in ("-e", name))]
    done = subprocess.run([TSHARK, "-n", "-r", file, *options], capture_output=True, text=True, timeout=60, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == len(frames)
    return [
        (one, {name: text for name, text in zip(wanted, line.split("|"), strict=True) if text})
        for one, line in zip(frames, lines, strict=True)
    ]


@pytest.mark.parametrize("protocol", FIELDS)
def test_both_read_the_same_values(protocol: str, seen: list[tuple[Sent, dict[str, str]]]) -> None:
    compared = 0
    for one, found in seen:
        if one.protocol != protocol or one.values is None:
            continue
        for name, theirs in FIELDS[protocol].items():
            if name in one.values:
                assert int(found[theirs].split(",")[0], 0) == one.values[name], (one, name)
                compared += 1
    assert compared >= 8


def is_bad(found: dict[str, str]) -> bool:
    """Return whether tshark reports a wrong check code; it reports only codes that it has compared."""
    return "0" in found.get("mstp.checksum.status", "").split(",") or any(name in found for name in FAULTS[1:])


@pytest.mark.parametrize("protocol", ["bacnet-mstp", "dnp3-link"])
def test_both_tell_wrong_check_codes(protocol: str, seen: list[tuple[Sent, dict[str, str]]]) -> None:
    judged = [(one.values is None, is_bad(found)) for one, found in seen if one.protocol == protocol]
    assert {ours for ours, _ in judged} == {True, False}
    assert [ours for ours, _ in judged] == [theirs for _, theirs in judged]

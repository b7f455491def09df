"""tshark with a generated dissector: captures of frames, and tshark's fields compared with the values of framekit."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from itertools import islice
from pathlib import Path
from struct import pack
from typing import Any
from xml.etree.ElementTree import Element, iterparse

import pytest
from shipped import vectors_of
from strategies import base_context
from test_construct_vectors import plain_values

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.codec.functions import candidates, fitting, nearest
from framekit.codec.plain import PlainValues
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.frames import everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Bits, Field
from framekit.extras.wireshark.generate import generate_dissector, preference_of, prefix_of
from framekit.extras.wireshark.source import identifier
from framekit.service.capture import GLOBAL_HEADER, PcapRecords
from framekit.transport.port import LineEvent

TSHARK = shutil.which("tshark")
needs_tshark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed")
HEADER = 12
"""Bytes before the data in a record of a serial line."""
SECOND = 1_000_000_000


@dataclass
class Shown:
    """A field of tshark: name, value as text, displayed text, and its bytes in the frame."""

    name: str
    value: str
    text: str
    first: int
    size: int


@dataclass
class Packet:
    """A packet in tshark: the frames with their fields, and the expert infos."""

    frames: list[str] = field(default_factory=list)
    fields: list[Shown] = field(default_factory=list)
    experts: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    shown_by: set[str] = field(default_factory=set)
    """Prefixes of the protocols that have fields of it."""

    def value(self, name: str) -> str | None:
        return next((field.value for field in self.fields if field.name.endswith(name)), None)


def run(script: Path, capture: Path, *options: str) -> str:
    """Return the output of tshark; assert that the script raised no error."""
    assert TSHARK is not None
    words = [TSHARK, "-n", "-X", f"lua_script:{script}", "-r", str(capture), *options]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    assert "Lua" not in done.stderr, done.stderr
    assert "Lua Error" not in done.stdout, done.stdout[:2000]
    return done.stdout


def packets_of(pdml: str, *prefixes: str) -> list[Packet]:
    """Return the packets of tshark's PDML that have fields of one of the protocols."""
    found: list[Packet] = []
    for _, element in iterparse(StringIO(pdml)):
        if element.tag == "packet":
            packet = Packet()
            for proto in element.findall("proto"):
                prefix = proto.get("name") or ""
                if prefix in prefixes:
                    packet.shown_by.add(prefix)
                    _collect(proto, packet, prefix)
            found.append(packet)
            element.clear()
    return found


def _collect(element: Element, packet: Packet, prefix: str) -> None:
    for one in element.findall("field"):
        name, value = one.get("name") or "", one.get("show") or ""
        if name == "_ws.expert":
            infos = {inner.get("name") or "": inner.get("show") or "" for inner in one.findall("field")}
            packet.messages.append(infos.get("_ws.expert.message", ""))
            packet.experts += [info.rpartition(".")[2] for info in infos if info.startswith(f"{prefix}.expert.")]
            continue
        if name == f"{prefix}.frame":
            packet.frames.append(value)
        else:
            place = int(one.get("pos") or 0) - HEADER
            if name.startswith("_ws."):  # a text without a field
                name, value = "", "" if one.find("field[@name='_ws.expert']") is not None else one.get("showname") or ""
            packet.fields.append(Shown(name, value, one.get("showname") or value, place, int(one.get("size") or 0)))
        _collect(one, packet, prefix)


def serial_capture(path: Path, frames: Sequence[bytes], ways: Sequence[str] = ()) -> None:
    """Write a capture of a serial line with a record for each frame, ten seconds apart."""
    records = PcapRecords(0)
    data = [GLOBAL_HEADER]
    for number, frame in enumerate(frames):
        way: Any = ways[number] if ways else "in"
        data.append(records.of(LineEvent("data", (number + 1) * 10 * SECOND, way, frame)))
    path.write_bytes(b"".join(data))


# ---- vectors through tshark -------------------------------------------------------------------------------------


@dataclass
class Trial:
    """The results for the vectors of a protocol; `differences` are those between tshark and framekit."""

    frames: set[str] = field(default_factory=set)
    vectors: int = 0
    fields: int = 0
    bad: int = 0
    checks: int = 0
    left_out: int = 0
    differences: list[str] = field(default_factory=list)


def groups_of(name: str, protocol: Protocol) -> Iterator[tuple[dict[str, Any], list[bytes]]]:
    """Yield the bytes of the vectors of a protocol, grouped by the parameters and the state they need."""
    found: dict[str, tuple[dict[str, Any], list[bytes]]] = {}
    codec, plain = compile_protocol(protocol), PlainValues(protocol)
    for vector in vectors_of(name).frames:
        given, data = plain_values(protocol, vector), vector.wire.exact
        if data is None and vector.frame is not None:  # compute its check code
            values = plain.from_plain(vector.frame, vector.values or {})
            data = codec.encode(vector.frame, values, base_context(protocol) | given)
        given.pop("request", None)
        if data:
            found.setdefault(repr(sorted(given.items())), (given, []))[1].append(data)
    yield from found.values()


@dataclass(frozen=True)
class DissectorInput:
    """Frames of one protocol and one context; the first `good` frames are vectors. `found` takes the results."""

    protocol: Protocol
    context: Mapping[str, Any]
    frames: list[bytes]
    found: Trial
    good: int = 0


def trials(names: Sequence[str], folder: Path) -> dict[str, Trial]:
    """Run tshark on all vectors of shipped protocols, and on each with a damaged bit."""
    found: dict[str, Trial] = {name: Trial() for name in names}
    rounds: list[list[DissectorInput]] = []  # each protocol at most once, since its preferences differ
    for name in names:
        protocol = load_protocol(name)
        for number, (given, frames) in enumerate(groups_of(name, protocol)):
            damaged = [_damaged(frame, place) for place, frame in enumerate(frames)]
            every = [*frames, *damaged, frames[0]]  # a good frame at the end flushes the last damaged frame
            comparison = DissectorInput(protocol, base_context(protocol) | given, every, found[name], len(frames))
            rounds += [[]] if number == len(rounds) else []
            rounds[number].append(comparison)
            found[name].vectors += len(frames)
    for number, comparisons in enumerate(rounds):
        compare(comparisons, folder / f"{number}")
    return found


def preferences(protocol: Protocol, context: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Return the settings of Wireshark's preferences for a context: parameter → preference and text."""
    source, found = generate_dissector(protocol, base_context(protocol)).source, {}
    for parameter in protocol.params.values():
        key, value = preference_of(parameter), context.get(parameter.name)
        if f'key = "{key}"' in source and value != base_context(protocol)[parameter.name]:
            found[parameter.name] = (key, str(value).upper() if parameter.type == "flag" else str(value))
    return found


def _damaged(frame: bytes, seed: int) -> bytes:
    """Return the frame with one bit inverted, mostly in the bytes that a check code covers."""
    place = (7 * seed + 3) % len(frame)
    return frame[:place] + bytes((frame[place] ^ 1 << seed % 8,)) + frame[place + 1 :]


DISPATCH = """
local dispatch = Proto("fk_dispatch", "Test: each packet to the dissector of its protocol")
local parts = { PARTS }
function dispatch.dissector(tvb, pinfo, tree)
  for _, part in ipairs(parts) do
    if pinfo.number <= part[1] then
      return Dissector.get(part[2]):call(tvb, pinfo, tree)
    end
  end
end
DissectorTable.get("rtacser.data"):add_for_decode_as(dispatch)
"""
"""A script that passes each packet to the dissector of its protocol, by packet number."""


def compare(comparisons: Sequence[DissectorInput], place: Path) -> None:
    """Run tshark once over the frames of all these protocols: compare its fields with the values of framekit."""
    place.mkdir(parents=True, exist_ok=True)
    prefixes = [prefix_of(comparison.protocol) for comparison in comparisons]
    assert len({*prefixes}) == len(comparisons), "a protocol has one set of preferences"
    options, parts, last = [], [], 0
    for one, prefix in zip(comparisons, prefixes, strict=True):
        preferred, base = preferences(one.protocol, one.context), base_context(one.protocol)
        made_with = {name: base.get(name) if name in preferred else one.context[name] for name in one.context}
        script = place / f"{prefix}.lua"
        script.write_text(generate_dissector(one.protocol, made_with).source, encoding="utf-8")
        options += ["-X", f"lua_script:{script}"]
        chosen = {"side": "not looked at", "follows": "FALSE", **dict(preferred.values())}
        options += [word for name, text in chosen.items() for word in ("-o", f"{prefix}.{name}:{text}")]
        last += len(one.frames)
        parts.append(f'{{ {last}, "{prefix}" }}')
    dispatch, capture = place / "dispatch.lua", place / "frames.pcap"
    dispatch.write_text(DISPATCH.replace("PARTS", ", ".join(parts)))
    serial_capture(capture, [frame for comparison in comparisons for frame in comparison.frames])
    pdml = run(dispatch, capture, "-2", "-T", "pdml", "-d", "rtacser.data,fk_dispatch", *options)
    packets = iter(packets_of(pdml, *prefixes))
    for one, prefix in zip(comparisons, prefixes, strict=True):
        own = [*islice(packets, len(one.frames))]
        assert len(own) == len(one.frames) and all(packet.shown_by == {prefix} for packet in own)
        _compare_packets(one, own)
    assert next(packets, None) is None


def _compare_packets(comparison: DissectorInput, packets: Sequence[Packet]) -> None:
    """Compare the packets of one protocol with framekit's values."""
    protocol, context, found = comparison.protocol, comparison.context, comparison.found
    codec = compile_protocol(protocol)
    for number, (data, packet) in enumerate(zip(comparison.frames, packets, strict=True)):
        fits, faults = fitting(codec, protocol.frames, data, candidates(protocol), context)
        differ = found.differences
        shown = f"{protocol.name} {data.hex(' ')}:"
        if {"unsaid", "unverified"} & {*packet.experts}:
            found.left_out += 1
        elif not fits:
            found.bad += 1
            best = nearest(faults)
            ends = best is not None and codec.measure(best[0], data, ctx=context) > 0
            differ += [f"{shown} {problem}" for problem in _told(packet, best, ends)]
            found.checks += best is not None and best[1].cause == "check"
        elif fits[0].refusal is not None and number >= comparison.good > 0 and packet.frames != [fits[0].frame]:
            found.bad += 1  # a damaged frame that would be refused alone may be another frame in a stream
        elif packet.frames != [fits[0].frame]:
            differ.append(f"{shown} {fits[0].frame}, tshark shows {packet.frames} {packet.experts} {packet.messages}")
        else:
            found.frames |= {fits[0].frame}
            _, spans, _ = codec.trace(fits[0].frame, data, context)
            wanted = list(expected(spans, data))
            found.fields += len(wanted)
            differ += [f"{shown} {difference}" for difference in _fields_differ(protocol, wanted, packet.fields)]


def _told(packet: Packet, best: tuple[str, FrameError] | None, ends: bool) -> Iterator[str]:
    """Yield a message if tshark does not report a bad frame, or not its wrong check code.

    The bad frame may contain a good frame. `ends`: the receiver can find the end of the frame in a stream; it cannot if
    no inner frame fits.
    """
    if not packet.experts:
        yield f"is bad ({best}), tshark says nothing"
        return
    is_check = best is not None and best[1].cause == "check" and best[1].also is None
    if is_check and ends and not packet.frames and "check" not in packet.experts:
        yield f"has a wrong check code, tshark says {packet.experts}"


Wanted = tuple[str, Any, int, int]


def expected(spans: Sequence[tuple[str, int, int, Any]], data: bytes) -> Iterator[Wanted]:
    """Yield the decoded values: name, value, first byte, number of bytes (-1: not compared); list items one by one."""
    for path, first, last, value in spans:
        name = identifier(path.rpartition(".")[2].partition("[")[0])
        if isinstance(value, list):
            for one in value or ["none"]:
                yield name, one, first, -1
        else:
            same = not isinstance(value, bytes) or data[first:last] == value
            yield name, value, first, last - first if same else -1


def _fields_differ(protocol: Protocol, wanted: list[Wanted], fields: list[Shown]) -> Iterator[str]:
    labels = [field for field in fields if field.name or ": " in field.value]
    if len(labels) != len(wanted):
        yield f"{len(wanted)} fields {wanted}, tshark shows {[(label.name, label.value) for label in labels]}"
        return
    names = numbers_with_names(protocol)
    for (name, value, first, size), one in zip(wanted, labels, strict=True):
        own = one.name.rpartition(".")[2].removesuffix("_") if one.name else identifier(one.value.partition(": ")[0])
        shown = one.value if one.name else one.value.partition(": ")[2]
        if own != name or not is_same(value, shown):
            yield f"{name} is {value!r}, tshark shows {one.name} {one.value!r}"
        elif size > 0 and (one.first, one.size) != (first, size):
            yield f"{name} is byte {first} to {first + size}, tshark shows {one.first} to {one.first + one.size}"
        some = names.get(name, [{}]) if one.name and type(value) is int else [{}]
        if all(value in each for each in some) and not any(each[value] in one.text for each in some):
            yield f"{name} {value} has a name, tshark shows {one.text}"


def numbers_with_names(protocol: Protocol) -> dict[str, list[Mapping[int, str]]]:
    """Return, by value name, the named numbers of each field of that name."""
    found: dict[str, list[Mapping[int, str]]] = {}
    for frame in protocol.frames.values():
        for one in everything(frame.segments):
            if isinstance(one, Field):
                found.setdefault(identifier(one.name), []).append(one.values or {})
            for part in one.parts if isinstance(one, Bits) else ():
                found.setdefault(identifier(part.name), []).append(part.values or {})
    return found


def is_same(value: Any, shown: str) -> bool:
    if value is None:
        return shown == "nothing"
    if isinstance(value, (bytes, bytearray)):
        return bytes.fromhex(shown.replace(":", " ")) == value
    if isinstance(value, str):
        plain = value.replace("\0", "␀")
        return shown in (plain, re.sub(r"[\r\n\t]", " ", plain), _escaped(plain))  # XML replaces line feeds by spaces
    if isinstance(value, int):
        return shown == str(int(value))
    return float(shown) == pytest.approx(float(value), rel=1e-6)  # the precision of tshark's output


def _escaped(value: str) -> str:
    """Return a text with control characters as tshark shows them."""
    words = {"\r": "r", "\n": "n", "\t": "t", "\a": "a", "\b": "b", "\v": "v", "\f": "f", "\\": "\\", '"': '"'}
    signs = (
        f"\\{words[sign]}" if sign in words else sign if sign.isprintable() else f"\\x{ord(sign):02x}" for sign in value
    )
    return "".join(signs)


# ---- comparisons of TCP --------------------------------------------------------------------------------------------

RAW_IP = 101
CLIENT_PORT = 40_000


def udp_capture(path: Path, port: int, datagrams: Sequence[bytes]) -> None:
    """Write a capture of datagrams to a port."""
    data = [pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 0xFFFF, RAW_IP)]
    for number, content in enumerate(datagrams):
        udp = pack(">HHHH", CLIENT_PORT, port, 8 + len(content), 0)
        size = 20 + len(udp) + len(content)
        ip = pack(">BBHHHBBH4s4s", 0x45, 0, size, number, 0, 64, 17, 0, bytes((10, 0, 0, 1)), bytes((10, 0, 0, 2)))
        data += [pack("<IIII", number + 1, 0, size, size), ip, udp, content]
    path.write_bytes(b"".join(data))


def tcp_capture(path: Path, port: int, segments: Sequence[tuple[str, bytes]], step: int = SECOND // 100) -> None:
    """Write a capture of one connection: segments of the `client` and the `server`, `step` nanoseconds apart."""
    sent = {"client": 1, "server": 1}
    ports = {"client": (CLIENT_PORT, port), "server": (port, CLIENT_PORT)}
    ends = {"client": bytes((10, 0, 0, 1)), "server": bytes((10, 0, 0, 2))}
    data = [pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 0xFFFF, RAW_IP)]
    for number, (sender, content) in enumerate(segments):
        receiver = "server" if sender == "client" else "client"
        tcp = pack(">HHIIBBHHH", *ports[sender], sent[sender], sent[receiver], 5 << 4, 0x18, 8192, 0, 0)
        sent[sender] += len(content)
        size = 20 + len(tcp) + len(content)
        ip = pack(">BBHHHBBH4s4s", 0x45, 0, size, number, 0, 64, 6, 0, ends[sender], ends[receiver])
        seconds, rest = divmod((number + 1) * step, SECOND)
        data += [pack("<IIII", seconds, rest, size, size), ip, tcp, content]
    path.write_bytes(b"".join(data))

"""Bytes of TCP and UDP in pcap files, as programs such as tcpdump keep them. Needs dpkt."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from framekit.guess.model import Direction, HeardBytes

SECOND = 1_000_000_000


class NetworkCaptureError(ValueError):
    """A file that holds no TCP or UDP, or cannot be read; the text says what to do."""


class _Packet(NamedTuple):
    time: int
    place: tuple[Any, ...]
    sequence: int | None
    data: bytes


def chunks_of_pcap(path: Path) -> list[HeardBytes]:
    """The bytes of the connections in their order; what was sent again counts once. Who speaks first is `out`.

    Raises NetworkCaptureError.
    """
    try:
        import dpkt
    except ModuleNotFoundError:
        raise NetworkCaptureError(f"{path}: TCP and UDP need dpkt – pip install 'framekit[pcap]'") from None
    try:
        with path.open("rb") as file:
            packets = list(_packets(dpkt, dpkt.pcap.UniversalReader(file)))
    except (OSError, ValueError, dpkt.dpkt.Error) as error:
        raise NetworkCaptureError(f"{path}: {error}") from None
    found: list[HeardBytes] = []
    ways: dict[frozenset[Any], Any] = {}
    next_byte: dict[Any, int] = {}
    for packet in packets:
        source = packet.place[0]
        first = ways.setdefault(frozenset(packet.place), source)
        way: Direction = "out" if source == first else "in"
        data = packet.data
        if packet.sequence is not None:
            wanted = next_byte.get(packet.place, packet.sequence)
            again = (wanted - packet.sequence) % (1 << 32)
            if again < 1 << 31:
                data = data[again:]
            next_byte[packet.place] = (packet.sequence + len(packet.data)) % (1 << 32)
        if data:
            found.append(HeardBytes(packet.time, way, data))
    if not found:
        raise NetworkCaptureError(f"{path} has no bytes of TCP or UDP")
    return found


def _packets(dpkt: Any, reader: Any) -> Iterator[_Packet]:
    links = {
        dpkt.pcap.DLT_EN10MB: dpkt.ethernet.Ethernet, dpkt.pcap.DLT_LINUX_SLL: dpkt.sll.SLL,
        dpkt.pcap.DLT_LINUX_SLL2: dpkt.sll2.SLL2, dpkt.pcap.DLT_RAW: dpkt.ip.IP, 101: dpkt.ip.IP,
        dpkt.pcap.DLT_NULL: dpkt.loopback.Loopback,
    }  # fmt: skip
    read = links.get(reader.datalink())
    if read is None:
        raise NetworkCaptureError(f"the link type {reader.datalink()} is not read – record with tcpdump")
    for time, raw in reader:
        try:
            packet = read(raw)
        except dpkt.dpkt.Error:
            continue
        ip = packet if isinstance(packet, dpkt.ip.IP) else packet.data
        inner = getattr(ip, "data", None)
        if isinstance(inner, (dpkt.tcp.TCP, dpkt.udp.UDP)) and inner.data:
            place = ((ip.src, inner.sport), (ip.dst, inner.dport))
            yield _Packet(round(time * SECOND), place, getattr(inner, "seq", None), bytes(inner.data))

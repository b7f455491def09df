"""After stray bytes and incomplete frames, an idle server still answers the next good request."""

from __future__ import annotations

import pytest
from service.fault_world import LINKS, MS, SECOND, FaultWorld, Link
from shipped import PROTOCOLS
from spread import spread

from framekit.definition.load.protocol import load_protocol

SNP = (
    Link("snp", "master", "slave", station="A", address="%R1", format="8O1", me=""),
    Link("snp-x", "master", "slave", station=b"A".ljust(8, b"\0"), address="%R1", format="8O1", me=bytes(8)),
)
PLCS = (
    *(
        Link(name, format=None, station=None, address="D100")
        for name in ("melsec-mc-3e", "melsec-mc-3e-ascii", "melsec-mc-4e")
    ),
    Link("fins-tcp", format=None, station=0, address="D100"),
    Link("host-link", address="D100", format="7E2"),
    Link("mewtocol", address="DT100", format="8O1"),
)
INSTRUMENTS = (
    Link("m-bus", station=5, service="readout"),
    Link("nmea0183", format="8N1", station=None, service="position"),
    Link("ubx", format="8N1", station=None, service="position"),
    Link("ve-direct", format="8N1", station=None, service="product"),
    Link("shdlc", format="8N1", service="version"),
    Link("dynamixel", format="8N1", service="ping"),
    Link("iec62056-21", format="7E1", speed=300, station="", me="", service="readout"),
    Link("dnp3-link", format="8N1", station=1024, service="link_status"),
    Link("bacnet-mstp", format="8N1", station=5, service="poll"),
    Link("osdp", format="8N1", station=5, service="identify"),
    Link("scpi", format=None, station=None, service="identify"),
)
ALL = (*LINKS, *SNP, *PLCS, *INSTRUMENTS)
LATER = 900 * MS
"""Time after which clients usually repeat a request."""

WHOLE = {"ccm-peer": {b"\x05"}}
"""Stray bytes that form a request: bytes after them are answered by the protocol's rules, the next request as usual."""


class World(FaultWorld):
    """A fault world that records the client's transmissions."""

    def __init__(self, link: Link) -> None:
        self.sent: list[bytes] = []
        super().__init__(link)
        transmit = self.line.transmit

        def noted(sender: object, data: bytes, start: int, marked: int | None = None) -> int:
            if sender is self.port:
                self.sent.append(bytes(data))
            return transmit(sender, data, start, marked)  # type: ignore[arg-type]

        self.line.transmit = noted  # type: ignore[method-assign]
        self.exchange()
        self.read()

    def read(self) -> str:
        """Read once; return the outcome."""
        self.number = 1
        return self.exchange()

    def stray(self, data: bytes, pause: int) -> None:
        """Send stray bytes a second after the last frame, followed by silence."""
        self.clock.run_for(SECOND)
        while not self.driver.is_open:
            self.clock.run_for(SECOND)
        self.port.write(data)
        self.clock.run_for(round(len(data) * self.line.character_time) + pause)

    def strays(self) -> list[bytes]:
        """Return single bytes and incomplete frames of the client.

        It is every sixth of all single bytes and of all beginnings of frames, different ones for each protocol, and all
        of `some_strays`.
        """
        pieces = {data[:size] for data in self.sent for size in range(2, len(data))}
        every = [*(bytes([byte]) for byte in range(256)), *sorted(pieces)]
        first = ALL.index(self.link) % 6
        return sorted({*every[first::6], *self.some_strays()})

    def some_strays(self) -> list[bytes]:
        """Return single bytes (starts and ends of frames, and others), and incomplete beginnings of frames."""
        ends = {byte for data in self.sent for byte in (*data[:2], data[-1])}
        pieces = {data[:size] for data in self.sent for size in (2, 3, 5, 8, len(data) // 2, len(data) - 1)}
        pieces = {piece for piece in pieces if len(piece) > 1} - {*self.sent}
        return [*(bytes([byte]) for byte in sorted(ends | {*range(0, 256, 32)})), *sorted(pieces)]


def test_every_server_is_tried() -> None:
    def answers(name: str) -> set[str]:
        roles = load_protocol(name).roles
        return {role for role in roles if role not in ("client", "master")}

    tested = {(link.protocol, link.answering) for link in ALL}
    names = set(PROTOCOLS) - {"standard", "snp-cmm"}  # the slave of snp-cmm is that of snp
    assert {(name, role) for name in names for role in answers(name)} == tested


SESSIONS = [link for link in ALL if link.format is None or link.protocol in ("snp", "snp-x")]
"""Links on which an unfinished frame ends the session or the connection; the next exchange opens it again."""

OTHERS = [link for link in ALL if link not in SESSIONS]
QUIET = [link for link in OTHERS if str(link) != "df1-master"]
"""Links that are silent between exchanges; a DF1 master polls all the time."""


@pytest.mark.parametrize("link", spread(QUIET, 3), ids=str)
def test_the_first_request_after_a_stray_piece_and_a_pause_is_answered(link: Link) -> None:
    world = World(link)
    for data in world.strays():
        world.stray(data, LATER)
        if data in WHOLE.get(str(link), ()):
            world.clock.run_for(10 * SECOND)
        world.seen.clear()
        assert world.read() == "ok", data.hex()
        assert world.seen["repeated"] == 0, data.hex()


@pytest.mark.parametrize("link", spread(OTHERS, 3, 1), ids=str)
def test_a_request_right_behind_a_stray_piece_is_answered_within_the_usual_repeats(link: Link) -> None:
    world = World(link)
    check_at_once(world, world.some_strays())


@pytest.mark.long
@pytest.mark.parametrize("link", OTHERS, ids=str)
def test_a_request_right_behind_any_stray_piece_is_answered_within_the_usual_repeats(link: Link) -> None:
    world = World(link)
    check_at_once(world, world.strays())


def check_at_once(world: World, strays: list[bytes]) -> None:
    link = world.link
    for data in strays:
        world.stray(data, 0)
        assert world.read() == "ok" or data in WHOLE.get(str(link), ()), data.hex()
        assert world.read() == "ok", data.hex()


@pytest.mark.parametrize("link", SESSIONS, ids=str)
def test_a_stray_piece_costs_a_session_and_no_more(link: Link) -> None:
    world = World(link)
    check_sessions(world, world.some_strays())


@pytest.mark.long
@pytest.mark.parametrize("link", SESSIONS, ids=str)
def test_no_stray_piece_at_all_costs_more_than_a_session(link: Link) -> None:
    world = World(link)
    check_sessions(world, world.strays())


def check_sessions(world: World, strays: list[bytes]) -> None:
    """Assert that a stream recovers from strays: an unfinished frame ends after 10 s, since the network may be slow."""
    wait = 11 * SECOND if world.link.format is None else SECOND
    for pause in (0, max(LATER, wait)):
        for data in strays:
            world.stray(data, pause)
            world.read()
            world.clock.run_for(wait)
            assert world.read() == "ok", data.hex()

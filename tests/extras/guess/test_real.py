"""Guess frames that other programs have built, without any hint about their protocols."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

import pytest

from framekit.extras.guess.checks import cut_at
from framekit.extras.guess.guess import guess
from framekit.extras.guess.model import Direction, Guess, HeardBytes


def guess_of(frames: Sequence[bytes], ways: tuple[Direction, Direction] = ("", "")) -> Guess:
    """Return the guess for frames without times; two directions alternate."""
    return guess([HeardBytes(None, ways[at % 2], bytes(frame)) for at, frame in enumerate(frames)])


def check_of(found: Guess) -> tuple[str, int, str]:
    """Return the name or kind of the check code, the first covered byte, and its order."""
    assert found.check is not None and found.check.evidence.holds >= 0.95 * found.check.evidence.of
    method, place = found.check.method, found.check.place
    own = f"{method.kind}{method.width}{f' {method.complement}' if method.complement else ''}"
    return found.check.name or own, place.start, place.order if place.size > 1 and place.form == "binary" else ""


def modbus(framer: str) -> Guess:
    pytest.importorskip("pymodbus")
    from pymodbus import framer as framers
    from pymodbus.pdu import DecodePDU
    from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadHoldingRegistersResponse

    rng, out = random.Random(1), list[bytes]()
    made = getattr(framers, framer)(DecodePDU(False))
    for number in range(1, 31):
        count, station = rng.randrange(1, 6), rng.choice([1, 2, 9])
        request: Any = ReadHoldingRegistersRequest(address=rng.randrange(500), count=count, dev_id=station)
        reply: Any = ReadHoldingRegistersResponse(
            registers=[rng.randrange(1 << 16) for _ in range(count)], dev_id=station
        )
        request.transaction_id = reply.transaction_id = number
        out += [made.buildFrame(request), made.buildFrame(reply)]
    return guess_of(out, ("out", "in"))


def test_modbus_by_pymodbus() -> None:
    found = modbus("FramerRTU")
    assert check_of(found) == ("crc16-modbus", 0, "little")
    reply_kind = next(kind for kind in found.kinds if kind.side == "server")
    assert {"copy_0", "copy_1", "count", "data"} <= {field.name for field in reply_kind.fields}
    found = modbus("FramerAscii")
    assert found.framing is not None and (found.framing.start, found.framing.end) == (b":", b"\r\n")
    assert found.framing.stuffing is not None and found.framing.stuffing.kind == "hex"
    assert check_of(found) == ("lrc8", 1, "")
    reply_kind = next(kind for kind in found.kinds if kind.side == "server")
    assert {"copy_1", "copy_2", "count", "data"} <= {field.name for field in reply_kind.fields}
    found = modbus("FramerSocket")
    assert found.framing is not None and found.framing.length is not None and found.check is None
    assert (found.framing.length.offset, found.framing.length.width, found.framing.length.plus) == (4, 2, 6)


def test_nmea_by_pynmea2() -> None:
    pynmea2 = pytest.importorskip("pynmea2")
    rng, out = random.Random(2), list[bytes]()
    for second in range(40):
        place = (f"1929.{rng.randrange(1000):03}", "S", f"02410.{rng.randrange(1000):03}", "E")
        time, height, course = f"1844{second:02}", f"{rng.randrange(300)}.0", str(rng.randrange(360))
        words = (time, *place, "1", "04", "2.6", height, "M", "-33.9", "M", "", "0000")
        out.append(f"{pynmea2.GGA('GP', 'GGA', words)}\r\n".encode())
        out.append(
            f"{pynmea2.RMC('GP', 'RMC', (time, 'A', *place, '0.1', course, '191194', '020.3', 'E'))}\r\n".encode()
        )
    found = guess_of(out)
    assert found.framing is not None and (found.framing.start, found.framing.end) == (b"$", b"\r\n")
    assert found.check is not None and found.check.evidence.holds == found.check.evidence.of
    assert (found.check.name, found.check.place.form, found.check.place.tail) == ("xor8", "hex", 2)
    assert (found.check.place.start, found.check.place.stop) == (1, 1)  # between $ and *


def test_ubx_by_pyubx2() -> None:
    pyubx2 = pytest.importorskip("pyubx2")
    rng, out = random.Random(3), list[bytes]()
    for at in range(30):
        status = pyubx2.UBXMessage("NAV", "NAV-STATUS", pyubx2.GET, iTOW=at * 1000, gpsFix=rng.randrange(4))
        where = {"lon": rng.random(), "lat": rng.random(), "height": rng.randrange(5000)}
        out += [
            status.serialize(),
            pyubx2.UBXMessage("NAV", "NAV-POSLLH", pyubx2.GET, iTOW=at * 1000, **where).serialize(),
        ]
    found = guess_of(out)
    assert found.framing is not None and found.framing.length is not None
    assert (found.framing.length.offset, found.framing.length.order, found.framing.length.plus) == (4, "little", 8)
    assert check_of(found) == ("fold16", 2, "little")


def test_cobs_by_cobs() -> None:
    cobs = pytest.importorskip("cobs.cobs")
    rng = random.Random(4)
    plain = [bytes(rng.choice([0, rng.randrange(256)]) for _ in range(rng.randrange(5, 40))) for _ in range(40)]
    found = guess_of([cobs.encode(content) + b"\0" for content in plain])
    assert found.framing is not None and found.framing.stuffing is not None and found.framing.stuffing.kind == "cobs"


class Line:
    """A write-only line for a library."""

    is_using = False

    def __init__(self) -> None:
        self.out: list[bytes] = []

    def clearPort(self) -> None:  # noqa: N802
        """Do nothing; the interface of the library demands the method."""

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802
        self.out.append(bytes(packet))
        self.is_using = False
        return len(packet)


@pytest.mark.parametrize(
    ("version", "offset", "check"), [(1.0, 3, ("sum8 ones", 2, "")), (2.0, 5, ("crc16-umts", 0, "little"))]
)
def test_dynamixel_by_its_maker(version: float, offset: int, check: tuple[str, int, str]) -> None:
    sdk = pytest.importorskip("dynamixel_sdk")
    rng, line, handler = random.Random(5), Line(), sdk.PacketHandler(version)
    for _ in range(40):
        handler.write2ByteTxOnly(line, rng.randrange(1, 5), rng.randrange(20, 60), rng.randrange(1 << 16))
        line.is_using = False
        handler.write4ByteTxOnly(line, rng.randrange(1, 5), rng.randrange(20, 60), rng.randrange(1 << 32))
        line.is_using = False
    found = guess_of(line.out)
    assert found.framing is not None and found.framing.length is not None and found.framing.length.offset == offset
    assert check_of(found) == check


def test_shdlc_by_its_maker() -> None:
    frames = pytest.importorskip("sensirion_shdlc_driver.serial_frame_builder")
    rng, out = random.Random(6), list[bytes]()
    for _ in range(60):
        data = bytes(rng.randrange(256) for _ in range(rng.randrange(6)))
        out.append(
            frames.ShdlcSerialMosiFrameBuilder(rng.randrange(4), rng.choice([0xD0, 0xD1, 0x90]), data).to_bytes()
        )
    found = guess_of(out)
    assert found.framing is not None and found.framing.stuffing is not None
    assert (found.framing.end, found.framing.stuffing.escape, found.framing.stuffing.xor) == (b"~", 0x7D, 0x20)
    assert check_of(found) == ("sum8 ones", 1, "")


def test_of_a_check_with_a_secret_byte_nothing_is_said() -> None:
    dialect = pytest.importorskip("pymavlink.dialects.v20.common")
    rng, out = random.Random(7), list[bytes]()
    made: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    for at in range(40):
        turn = [rng.random() for _ in range(6)]
        for message in (
            made.heartbeat_encode(2, 3, rng.randrange(200), rng.randrange(1 << 32), 3),
            made.attitude_encode(at, *turn),
        ):
            out.append(bytes(message.pack(made)))
            made.seq = (made.seq + 1) % 256
    found = guess_of(out)
    assert found.framing is not None and found.framing.length is not None and found.framing.length.offset == 1
    assert found.check is None or cut_at(found.check.place, out[0]) is None

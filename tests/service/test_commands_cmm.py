"""Commands of SNP and SNP-X on one line (snp-cmm), with a simulated PLC that takes both."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from command_world import CommandWorld, text_words

from framekit.transport.simulated_line import SimulatedPort, Transmission

DEVICE = """station: SNPID1
also: snp-x
memory: {sizes: {R1: 2000}, set: {R1: [0x0155, 22, 33, 44], I1: [1, 0, 1, 1, 0, 0, 1, 0, 1, 1]}}
"""
ATTACH = [7200, *text_words("SNPID1"), 0, 0]
ID, NULL, ALL = text_words("SNPID1"), [0, 0, 0, 0], [0xFFFF] * 4
R, IN = 8, 70


@pytest.fixture
def world(tmp_path: Path) -> CommandWorld:
    return CommandWorld(tmp_path, "snp-cmm", DEVICE)


def test_both_kinds_on_one_line(world: CommandWorld) -> None:
    assert world.do(*ATTACH) == 1
    assert world.do(7202, R, 1, 4, R, 100) == 1
    assert world.do(7101, *ID, 0, R, 1, 4, R, 110) == 1
    assert world.own("R", 100, 4) == world.own("R", 110, 4) == [0x0155, 22, 33, 44]
    assert world.do(7202, R, 1, 1, R, 120) == 0x030C, "the X session has ended the other"
    assert world.do(*ATTACH) == 1
    assert world.do(7202, R, 2, 1, R, 120) == 1
    assert world.own("R", 120) == [22]
    assert world.do(7101, *ID, 0, R, 3, 1, R, 120) == 1, "and the other way round"
    assert world.own("R", 120) == [33]


def test_an_x_session_stays_open(world: CommandWorld) -> None:
    sent: list[str] = []
    world.service.channels[1].driver.monitor = lambda seen: sent.append(seen.frame)
    for number in (1, 2, 3):
        assert world.do(7101, *ID, 0, R, number, 1, R, 120) == 1
    assert sent.count("x_attach") <= 1


def test_small_and_large_writes_and_points(world: CommandWorld) -> None:
    world.put("R", 100, *range(1, 501))
    assert world.do(7102, *ID, 0, R, 301, 1, R, 100) == 1
    assert world.do(7102, *NULL, 0, R, 1001, 400, R, 100) == 1
    assert world.at("R", 301, 2) == [1, 0] and world.at("R", 1001, 401) == [*range(1, 401), 0]
    assert world.do(7101, *ID, 0, IN, 3, 1, R, 120, R, 32) == 1
    assert world.own("R", 120) == [0b11010011]
    assert world.own("R", 32)[0] >> 12 == 2, "stopped"


def test_broadcast(world: CommandWorld) -> None:
    world.put("R", 100, 7, 8)
    assert world.do(7102, *ALL, 1, R, 401, 1, R, 100) == 1
    assert world.do(7102, *ALL, 1, R, 403, 2, R, 100) == 1
    assert world.at("R", 401, 4) == [7, 0, 7, 8]
    assert world.do(7101, *ID, 1, R, 401, 1, R, 120) == 1


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ([7101, *ID, 2, R, 1, 1, R, 100], 0x1D0C),
        ([7101, *ALL, 1, R, 1, 1, R, 100], 0x1E0C),
        ([7102, *ALL, 0, R, 1, 1, R, 100], 0x1F0C),
        ([7101, *NULL, 1, R, 1, 1, R, 100], 0x1F0C),
        ([7101, *ID, 0, R, 1, 501, R, 100], 0x1C0C),
        ([7101, *ID, 0, 99, 1, 1, R, 100], 0x0A0C),
        ([7101, *ID, 0, R, 0, 1, R, 100], 0x0B0C),
        ([7101, *ID, 0, R, 1, 1, 99, 100], 0x060C),
        ([7101, *ID, 0, R, 2000, 2, R, 100], 0x040F),
        ([7101, *text_words("OTHER"), 0, R, 1, 1, R, 100], 0x460C),
        ([7101, *ID, 0, R, 1], 0x0C0C),
    ],
)
def test_refusals(world: CommandWorld, words: list[int], code: int) -> None:
    assert world.do(*words) == code
    (status,) = world.service.status()
    assert status.last_failure is not None and status.last_failure.meaning


READ, WRITE = [7101, *ID, 0, R, 1, 4, R, 100], [7102, *ID, 0, R, 1, 4, R, 100]
MESSAGES = {
    "attach response": (READ, 0x40, lambda data: data[:2] == b"\x1bX" and data[10] == 0x80),
    "response": (READ, 0x60, lambda data: data[:3] == b"\x1bX\x81"),
    "intermediate response": (WRITE, 0x70, lambda data: data[:2] == b"\x1bx"),
}
"""A command, the code of a parity fault in its message of this name, and how that message begins."""
FAULTS: dict[str, tuple[int, Callable[[Transmission], None]]] = {
    "parity": (0, lambda sent: sent.flip(12, 1)),
    "framing": (1, lambda sent: sent.flip(12, 1 << 9)),
    "check": (2, lambda sent: sent.flip(12, 3)),
    "silence": (6, lambda sent: sent.truncate(0)),
}
"""The place of a fault after that code, and what it does."""


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("message", MESSAGES)
def test_the_status_word_says_which_message_is_at_fault(world: CommandWorld, message: str, fault: str) -> None:
    words, first, is_message = MESSAGES[message]
    place, damage = FAULTS[fault]
    ports = [device.driver.port for device in world.service.devices]

    def on_line(sent: Transmission) -> None:
        if is_message(bytes(sent.data)):
            damage(sent)

    for port in ports:
        assert isinstance(port, SimulatedPort)
        port.fault = on_line
    assert world.do(*words) == (first + place) << 8 | 0x0C
    for port in ports:
        assert isinstance(port, SimulatedPort)
        port.fault = None
    assert world.do(*words) == 1, "the session is opened anew"


@pytest.mark.parametrize(("message", "code"), [("response", 0x630C), ("intermediate response", 0x730C)])
def test_another_message_in_its_place(world: CommandWorld, message: str, code: int) -> None:
    words, _, is_message = MESSAGES[message]
    _, _, is_attached = MESSAGES["attach response"]
    attached = bytearray()

    def on_line(sent: Transmission) -> None:
        if is_attached(bytes(sent.data)):
            attached[:] = sent.data
        elif is_message(bytes(sent.data)):
            sent.data[:] = attached

    for device in world.service.devices:
        assert isinstance(device.driver.port, SimulatedPort)
        device.driver.port.fault = on_line
    assert world.do(*words) == code


def with_check(data: bytearray) -> None:
    """Set the check code of a message that was changed."""
    check = 0
    for byte in data[:-1]:
        check ^= byte
        check = (check << 1 | check >> 7) & 0xFF
    data[-1] = check


@pytest.mark.parametrize("protocol", ["snp-x", "snp-cmm"])
@pytest.mark.parametrize(
    ("message", "place", "value", "code"),
    [
        ("attach response", -5, 0x54, 0x440C),
        ("attach response", -4, 9, 0x440C),
        ("attach response", 10, 0x8F, 0x450C),
        ("response", -5, 0x54, 0x640C),
        ("response", 2, 0x82, 0x650C),
        ("intermediate response", -5, 0x54, 0x740C),
        ("intermediate response", 2, 0x81, 0x750C),
    ],
)
def test_a_wrong_next_message_and_a_wrong_code(
    tmp_path: Path, protocol: str, message: str, place: int, value: int, code: int
) -> None:
    device = DEVICE
    if protocol == "snp-x":
        device = DEVICE.replace("also: snp-x\n", "")
    world = CommandWorld(tmp_path, protocol, device)
    words, _, is_message = MESSAGES[message]

    def on_line(sent: Transmission) -> None:
        if is_message(bytes(sent.data)):
            sent.data[place] = value
            with_check(sent.data)

    for one in world.service.devices:
        assert isinstance(one.driver.port, SimulatedPort)
        one.driver.port.fault = on_line
    assert world.do(*words) == code

"""Commands 7400 (Autodial) with a simulated modem, and FFF0h (Serial Port Setup)."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_world import RUN, SECOND, STATUS, CommandWorld, text_words
from spread import spread

from framekit.link.events import Seen
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

MODEM = """protocol: modem
extends: snp
state: {commands: {scope: device, type: u8}}
frames:
  dialled: {from: client, body: [{text: AT}, {data: text, size: rest, never: [0D]}, {const: 0D}]}
  spoken:  {from: server, body: [{const: 0D 0A}, {text: %s}, {const: 0D 0A}]}
sequences:
  slave:
    steps:
      - step: idle
        receive: [{frame: dialled, set: {commands: commands + 1}, then: next}]
        on_noise: again
        on_bad: again
      - step: speak
        when: %d
        send: spoken
        then: idle
      - {step: silent, then: idle}
"""


def words_of(text: str) -> list[int]:
    """Return a modem command as a block: 7400, timeout 30 s, number of bytes, the bytes."""
    data = text.encode() + b"\0" * (len(text) % 2)
    return [7400, 30, len(text), *(data[at] | data[at + 1] << 8 for at in range(0, len(data), 2))]


class Port:
    """A run with an SNP master whose only device has a protocol of its own."""

    def __init__(self, folder: Path, protocol: str) -> None:
        (folder / "other.yaml").write_text(protocol, encoding="utf-8")
        (folder / "there.device.yaml").write_text("device: there\nprotocol: other.yaml\n", encoding="utf-8")
        (folder / "port.run.yaml").write_text(RUN.format(protocol="snp", settings=""), encoding="utf-8")
        self.clock = VirtualClock()
        self.service = RunService(load_run(folder / "port.run.yaml"), self.clock)
        self.service.start()
        self.clock.run_for(SECOND)

    def do(self, *words: int) -> int:
        """Execute a command; return the status word."""
        self.service.memory.write("R", "word", STATUS - 1, [0])
        self.service.memory.write("R", "word", 0, [len(words), 0, 8, STATUS - 1, 0, 0, *words])
        self.service.fire(0)
        self.clock.run_for(60 * SECOND)
        (status,) = self.service.memory.read("R", "word", STATUS - 1, 1)
        return status


@pytest.mark.parametrize(
    ("answer", "code"),
    spread([
        ("CONNECT 9600", 0x0001), ("OK", 0x0001), ("", 0x050E), ("BUSY", 0x060E), ("NO CARRIER", 0x070E),
        ("NO DIALTONE", 0x080E), ("ERROR", 0x090E), ("RING", 0x0A0E), ("DELAYED", 0x0B0E),
    ], 4),
)  # fmt: skip
def test_the_status_has_the_answer_of_the_modem(tmp_path: Path, answer: str, code: int) -> None:
    port = Port(tmp_path, MODEM % (answer or "OK", bool(answer)))
    assert port.do(*words_of("ATDT2345678\r")) == code
    assert port.service.devices[0].engine.scope["commands"] == 1


def test_the_next_session_has_the_settings_of_port_setup(tmp_path: Path) -> None:
    lines: list[str] = []

    def note(channel: int, seen: Seen) -> None:
        lines.extend([seen.reason] if seen.kind == "line" else [])

    world = CommandWorld(tmp_path, "snp", "station: SNPID1\nmemory: {set: {R1: [341, 22]}}\n", "", note)
    attach, read = [7200, *text_words("SNPID1"), 0, 0], [7202, 8, 1, 2, 8, 100]
    setup = [0xFFF0, 1, 1, 5, 2, 1, 1, 0, 1, 1, 0, 1]  # 9600 bits a second, even parity, two stop bits
    assert world.do(*attach) == 1
    assert world.do(*setup) == 1 and not lines
    assert world.do(*read) == 0x030C, "a new session is needed"
    assert world.do(*attach) != 1, "the slave has 19200 8O1"
    assert lines and {*lines[:1]} == {"9600 8E2"}
    setup[3:5], setup[9] = [6, 1], 0
    assert world.do(*setup) == 1
    assert world.do(*attach) == 1 and world.do(*read) == 1
    assert world.own("R", 100, 2) == [341, 22]


def test_port_setup_of_a_slave_holds_at_once_and_after_each_session(tmp_path: Path) -> None:
    lines: list[str] = []

    def note(channel: int, seen: Seen) -> None:
        lines.extend([seen.reason] if seen.kind == "line" else [])

    world = CommandWorld(tmp_path, "snp", "role: master\nstation: SNPID1\n", ", role: slave, own: OLDID", note)
    setup = [0xFFF0, 1, 0, 5, 2, 1, 0, 3, 1, 0, 0, 1]  # slave, 9600 bits a second, even parity, no time-outs
    assert world.do(*setup) == 1
    assert lines == ["9600 8E1"]
    scope = world.service.channels[1].engine.scope
    assert (scope["own_t2"], scope["own_t3p"], scope["cpu_id"]) == (0, 0, "OLDID")
    assert world.do(*setup, *text_words("NEWID1")) == 1
    assert scope["cpu_id"] == "NEWID1"
    setup[2] = 1
    assert world.do(*setup) == 0x0513, "the channel is a slave"


def test_autodial_on_a_port_that_is_lost(tmp_path: Path) -> None:
    port = Port(tmp_path, MODEM % ("OK", False))
    driver = port.service.channels[1].driver
    port.clock.call_at(port.clock.now() + 10 * SECOND, lambda: driver.closed(port.clock.now(), "pulled"))
    assert port.do(*words_of("ATDT2345678\r")) == 0x040E

"""Command 7400 (Autodial) with a simulated modem: the command goes out after the escape, the status has the answer."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_world import RUN, SECOND, STATUS

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


def status_after(folder: Path, answer: str, command: str) -> tuple[int, int]:
    """Return the status word of 7400, and the number of commands that the modem got."""
    (folder / "modem.yaml").write_text(MODEM % (answer or "OK", bool(answer)), encoding="utf-8")
    (folder / "there.device.yaml").write_text("device: there\nprotocol: modem.yaml\n", encoding="utf-8")
    (folder / "dial.run.yaml").write_text(RUN.format(protocol="snp", settings=""), encoding="utf-8")
    clock = VirtualClock()
    service = RunService(load_run(folder / "dial.run.yaml"), clock)
    service.start()
    clock.run_for(SECOND)
    words = words_of(command)
    service.memory.write("R", "word", 0, [len(words), 0, 8, STATUS - 1, 0, 0, *words])
    service.fire(0)
    clock.run_for(60 * SECOND)
    (status,) = service.memory.read("R", "word", STATUS - 1, 1)
    return status, service.devices[0].engine.scope["commands"]


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        ("CONNECT 9600", 0x0001), ("OK", 0x0001), ("", 0x050E), ("BUSY", 0x060E), ("NO CARRIER", 0x070E),
        ("NO DIALTONE", 0x080E), ("ERROR", 0x090E), ("RING", 0x0A0E), ("DELAYED", 0x0B0E),
    ],
)  # fmt: skip
def test_the_status_has_the_answer_of_the_modem(tmp_path: Path, answer: str, code: int) -> None:
    assert status_after(tmp_path, answer, "ATDT2345678\r") == (code, 1)

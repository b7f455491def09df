"""One channel at 115200 baud on the simulated line, READs without pause: the used share of the line's limit.

The limit is the time of the characters of request and reply, and of the silence before each of them. The clock is
virtual: the figure shows whether the procedure loses time, not how fast the machine is.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.row import Row, Target
from framekit.definition.times import parse_format
from framekit.link.services.client import TransferResult
from framekit.runfile.devices import load_devices
from framekit.service.client import ClientService
from framekit.service.device import DeviceService
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated_line import SimulatedLine

NAME = "Line use: one channel at 115200, READs back to back"
TARGET = "≥ 98 % of the limit that bits and mandatory gaps set"
DEVICE = "{device: pump, protocol: modbus-rtu, station: 1}\n"
SIMULATED = 20_000_000_000
GAP = 1_750_000
"""Silence before each transmission, above 19200 baud (ns)."""
REQUEST_SIZE = 8


def run(rounds: int) -> list[Row]:
    """Measure once; `rounds` is ignored, since simulated time is always the same."""
    return [_measure(count) for count in (1, 10, 125)]


def _measure(registers: int) -> Row:
    clock, settings = VirtualClock(), parse_format("8N1", 115200)
    line = SimulatedLine(clock, settings)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "pump.device.yaml"
        file.write_text(DEVICE, encoding="utf-8")
        (device,) = load_devices(file, Path(folder))
    answering = DeviceService(device, line.port("device"), clock, settings)
    client = ClientService(device.protocol, line.port("client"), clock, role="client", line=settings)
    answering.start()
    client.start()
    done = 0

    def ask() -> None:
        client.request(
            lambda services, now, ended: services.read(
                "40001", station=1, count=registers, now=now, on_done=ended
            ),
            ended,
        )  # fmt: skip

    def ended(result: TransferResult) -> None:
        nonlocal done
        assert result.ok, result
        done += 1
        ask()

    clock.run_for(1_000_000_000)
    ask()
    begin = clock.now()
    clock.run_for(SIMULATED)
    bits = (REQUEST_SIZE + 5 + 2 * registers) * settings.character_bits
    limit = SIMULATED / (bits * 1e9 / settings.speed + 2 * GAP)
    assert clock.now() - begin == SIMULATED
    figure = 100 * done / limit
    details = {"exchanges a second": round(done * 1e9 / SIMULATED, 2), "limit": round(limit * 1e9 / SIMULATED, 2)}
    what = f"READ of {registers} registers"
    return Row(what, "bits and gaps", figure, figure, figure, Target("at least", 98), "%", details)

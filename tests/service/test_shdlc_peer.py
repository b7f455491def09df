"""sensirion-shdlc-driver, an independent master, with a simulated device on a real terminal.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from random import Random

import pytest
from peer_world import at_work, pty_device

import framekit
from framekit.definition.times import LineFormat

driver = pytest.importorskip("sensirion_shdlc_driver", reason="sensirion-shdlc-driver is not installed")

DEVICE = """
device: peer
protocol: shdlc
station: 0x11
params: {serial_number: 00112233AABBCCDD, answer_delay: 0 ms}
"""
LINE = LineFormat(115200)


def asking(path: str) -> None:
    from sensirion_shdlc_driver.command import ShdlcCommand
    from sensirion_shdlc_driver.errors import ShdlcDeviceError, ShdlcTimeoutError

    with driver.ShdlcSerialPort(port=path, baudrate=115200) as port:
        device = driver.ShdlcDevice(driver.ShdlcConnection(port), slave_address=0x11)
        assert device.get_product_name() == "framekit"
        assert device.get_article_code() == "1-100000-01"
        assert device.get_serial_number() == "00112233AABBCCDD"
        version = device.get_version()
        assert (version.firmware.major, version.hardware.major) == (1, 1)
        assert device.get_error_state() == (0, 0)
        assert device.get_slave_address() == 0x11
        device.set_reply_delay(0x1113)  # both bytes are stuffed
        assert device.get_reply_delay() == 0x1113
        assert device.get_system_up_time() >= 0
        with pytest.raises(ShdlcDeviceError) as refused:
            device.execute(ShdlcCommand(id=0x55, data=b"", max_response_time=0.5))
        assert refused.value.error_code == 2
        other = driver.ShdlcDevice(driver.ShdlcConnection(port), slave_address=0x12)
        with pytest.raises(ShdlcTimeoutError):
            other.execute(ShdlcCommand(id=0x90, data=b"", max_response_time=0.1))


def test_it_asks_a_simulated_device(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with pty_device(tmp_path, DEVICE, LINE) as (path, _):
            await at_work(asking, path)

    asyncio.run(scenario())


def test_frames_of_any_content_are_built_alike() -> None:
    from sensirion_shdlc_driver.serial_frame_builder import ShdlcSerialMosiFrameBuilder as Builder

    random = Random(1)
    codec = framekit.load("shdlc")
    for size in range(256):
        content = bytes(random.choice([0x7E, 0x7D, 0x11, 0x13, random.randrange(256)]) for _ in range(size))
        station = random.randrange(256)
        written = Builder(station, 0x30, content).to_bytes()
        command = {"other_command": {"command": 0x30, "content": content}}
        assert codec.encode("mosi", station=station, command=command) == written
        found = codec.decode(written, "mosi").fields
        assert found["command"]["other_command"]["content"] == content

"""dnp3py, an independent master and outstation, with a client and a simulated outstation on real TCP.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from random import Random
from typing import Any

import pytest
from peer_world import WAIT, tcp_device

import framekit

builder = pytest.importorskip("dnp3.datalink.builder", reason="dnp3py is not installed")
pytest.importorskip("dnp3.outstation.tcp_runner", reason="dnp3py is not installed")

DEVICE = "device: peer\nprotocol: dnp3-link\nstation: 1024\n"
READ_CLASS_0 = bytes.fromhex("C3 01 3C 01 06")
"""A request of the application layer; our link layer carries it as bytes."""


def asking(number: int) -> None:
    with framekit.connect("dnp3-link", f"tcp://127.0.0.1:{number}", station=1024) as client:
        assert client.call("link_status")["busy"] == 0
        client.call("reset_link")
        client.call("test_link")
        for segment in (READ_CLASS_0[:2], READ_CLASS_0[2:]):  # both parts of one fragment
            first = segment[0] == 0xC3
            client.call("send", {"segment": segment, "number": 0 if first else 1, "fir": first, "fin": not first})
        assert client.call("link_status")["busy"] == 0


def test_its_outstation_is_asked() -> None:
    from dnp3.outstation.config import OutstationConfig
    from dnp3.outstation.outstation import Outstation
    from dnp3.outstation.tcp_runner import OutstationTcpRunner

    requests: list[bytes] = []

    class RecordingOutstation(Outstation):
        def process_request(self, data: bytes, *args: Any, **more: Any) -> Any:
            requests.append(data)
            return super().process_request(data, *args, **more)

    async def scenario() -> None:
        runner = OutstationTcpRunner(
            RecordingOutstation(OutstationConfig(address=1024, master_address=1)), "127.0.0.1", 0
        )
        running = asyncio.create_task(runner.run())
        async with asyncio.timeout(WAIT):
            while runner.local_address is None:
                await asyncio.sleep(0.01)
            await asyncio.to_thread(asking, runner.local_address[1])
        await runner.stop()
        await running

    asyncio.run(scenario())
    assert requests == [READ_CLASS_0]


def test_its_frames_are_answered_by_a_simulated_outstation(tmp_path: Path) -> None:
    """The test sends the frames of its master, since its runner requests no link status and sends no confirmed data."""
    from dnp3.datalink.parser import FrameParser

    async def scenario() -> None:
        async with tcp_device(tmp_path, DEVICE) as (number, _), asyncio.timeout(WAIT):
            reader, writer = await asyncio.open_connection("127.0.0.1", number)
            parser = FrameParser()

            async def ask(frame: Any) -> tuple[int, bytes]:
                writer.write(frame.to_bytes())
                while True:
                    for reply in parser.feed(await reader.read(300)):
                        assert (reply.header.destination, reply.header.source) == (1, 1024)
                        return int(reply.header.control.function_code), reply.user_data

            assert await ask(builder.build_request_link_status(1024, 1, True)) == (11, b"")
            assert await ask(builder.build_reset_link_state(1024, 1, True)) == (0, b"")
            assert await ask(builder.build_test_link_state(1024, 1, True, True)) == (0, b"")
            segment = bytes([0xC0, *range(100)])
            assert await ask(builder.build_confirmed_user_data(1024, 1, True, False, segment)) == (0, b"")
            assert await ask(builder.build_confirmed_user_data(1024, 1, True, True, segment)) == (0, b"")
            writer.close()

    asyncio.run(scenario())


def test_frames_of_any_content_are_built_alike() -> None:
    random = Random(1)
    codec = framekit.load("dnp3-link")
    for size in range(1, 250):
        segment = random.randbytes(size)
        fcb, number = random.randrange(2), random.randrange(64)
        written = builder.build_confirmed_user_data(7, 1, True, bool(fcb), bytes([0xC0 | number]) + segment).to_bytes()
        fields = {"dir": 1, "fcb": fcb, "destination": 7, "source": 1, "fin": 1, "fir": 1, "number": number}
        assert codec.encode("confirmed_user_data", segment=segment, **fields) == written
        found = codec.decode(written)
        assert found.name == "confirmed_user_data"
        assert (found["segment"], found["number"], found["fcb"]) == (segment, number, fcb)

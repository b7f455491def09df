"""An independent implementation, df1py3, as a peer on the virtual clock.

Frames of random payloads with many 10h bytes in both directions, and its client with a simulated processor. Skipped
only if it is not installed.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import pytest

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import FrameError
from framekit.definition.load.protocol import load_protocol
from framekit.definition.times import parse_format
from framekit.link.values import Names
from framekit.runfile.devices import load_devices
from framekit.service.device import DeviceService
from framekit.transport.clock import VirtualClock
from framekit.transport.port import PortEvents
from framekit.transport.simulated_line import SimulatedLine

pytest.importorskip("df1", reason="df1py3 is not installed")

from df1.commands import Command0FA2, Command0FAA, Command0FAB
from df1.file_type import FileType
from df1.models.base_data_frame import BaseDataFrame
from df1.models.base_plc import BasePlc
from df1.models.df1_base import TIMER, Df1BaseClient
from df1.models.receive_buffer import ReceiveBuffer
from df1.replies import Reply4f, ReplyNak

ROUNDS = 2000
DEVICE = """device: peer
protocol: df1
role: full
station: 1
memory:
  sizes: {"N10:0": 64}
  set: {"N7:0": [0x1010, 0x1003, 0x0310], "F8:0": 0x40100000, "T4:2.ACC": 16}
"""
NAMES = Names({"check_kind": "crc", "max_packet": 250, "processor": "slc", "node": 0, "tns": 0})


@cache
def codec() -> Codec:
    return compile_protocol(load_protocol("df1"))


def payload(random: Random, most: int) -> bytes:
    """Return random bytes; about every second is 10h, and other control characters are frequent."""
    return bytes(
        0x10 if random.random() < 0.5 else random.choice([2, 3, 5, 6, 0x15, random.randrange(256)])
        for _ in range(random.randrange(most + 1))
    )


def words(data: bytes) -> list[int]:
    return [low | high << 8 for low, high in zip(data[::2], data[1::2], strict=False)]


def test_what_it_sends_is_read_here() -> None:
    random = Random(1)
    for _ in range(ROUNDS):
        data = payload(random, 230)
        values = words(data)
        dst, src, tns = (random.choice([0x10, random.randrange(255)]) for _ in range(3))
        tns |= random.choice([0, 0x10, 0xFF]) << 8
        element, sub = (random.choice([0x10, random.randrange(255)]) for _ in range(2))
        place = {"file": 7, "file_type": 0x89, "element": element, "sub": sub}
        kind = random.randrange(3)
        if kind == 0:
            frame, expected = Command0FA2(), {"size": len(data), **place}
            frame.init_with_params(
                bytes_to_read=len(data), table=7, file_type=FileType.INTEGER, start=element, start_sub=sub,
                dst=dst, src=src, tns=tns,
            )  # fmt: skip
        elif kind == 1:
            frame, expected = (
                Command0FAA(),
                {**place, "data": b"".join(value.to_bytes(2, "little") for value in values)},
            )
            frame.init_with_params(
                table=7, file_type=FileType.INTEGER, start=element, start_sub=sub, data_to_write=values,
                dst=dst, src=src, tns=tns,
            )  # fmt: skip
        else:
            mask, value = random.choice([0x1010, random.randrange(65536)]), 0x1010
            frame, expected = Command0FAB(), {**place, "mask": mask, "value": value}
            frame.init_with_params(
                table=7, file_type=FileType.INTEGER, start=element, start_sub=sub, bit_mask=mask, data_to_write=[value],
                dst=dst, src=src, tns=tns,
            )  # fmt: skip
        (fields,) = codec().decode("message", bytes(frame.get_bytes()), NAMES)["packet"].values()
        expected |= {"dst": dst, "src": src, "tns": tns, "cmd": 0x0F, "sts": 0}
        assert {name: fields[name] for name in expected} == expected


def test_what_is_sent_here_is_read_by_it() -> None:
    random = Random(2)
    for _ in range(ROUNDS):
        data = payload(random, 244)
        tns = random.choice([0x1010, random.randrange(65536)])
        packet = {"reply": {"dst": 0x10, "src": 1, "cmd": 0x0F, "tns": tns, "data": data}}
        sent = codec().encode("message", {"packet": packet}, NAMES)
        frame = Reply4f(buffer=list(sent))
        assert frame.is_valid()
        assert (frame.tns, bytes(frame._get_command_data())) == (tns, data)
        again = BaseDataFrame()
        again.init_with_params(cmd=0x4F, dst=0x10, src=1, tns=tns, data=data)
        assert bytes(again.get_bytes()) == sent


def test_both_refuse_the_same_damage() -> None:
    random = Random(3)
    packet = {"reply": {"dst": 0, "src": 1, "cmd": 0x0F, "tns": 7, "data": bytes(range(0x20, 0x60))}}
    good = codec().encode("message", {"packet": packet}, NAMES)
    for _ in range(ROUNDS // 4):
        damaged = bytearray(good)
        damaged[random.randrange(12, 60)] ^= random.choice([1, 2, 4, 8])
        with pytest.raises(FrameError):
            codec().decode("message", bytes(damaged), NAMES)
        assert not Reply4f(buffer=list(damaged)).is_valid()


def test_it_finds_the_frames_of_a_stream() -> None:
    random = Random(4)
    buffer, found, sent = ReceiveBuffer(), [], []
    for tns in range(30):
        packet = {"reply": {"dst": 0, "src": 0x10, "cmd": 0x0F, "tns": tns, "data": payload(random, 100)}}
        sent.append(codec().encode("message", {"packet": packet}, NAMES))
        for byte in sent[-1]:
            buffer.extend([byte])
            found.extend(bytes(frame) for frame in buffer.pop_left_frames())
    assert found == sent


class Wire(BasePlc, PortEvents):
    """The peer's transport to a simulated device: after a transmission, time runs until the device is silent."""

    def __init__(self, line: SimulatedLine, clock: VirtualClock) -> None:
        super().__init__()
        self.clock, self.sending = clock, False
        self.port = line.port("peer")
        self.port.open(self)

    def received(self, data: bytes, now: int, faults: Any = ()) -> None:
        self._on_bytes_received(bytearray(data))

    def send_bytes(self, buffer: bytearray) -> None:
        self.port.write(bytes(buffer))
        if not self.sending:
            self.sending = True
            self.clock.run_for(1_000_000_000)
            self.sending = False

    def is_clearing_comm(self) -> bool:
        return False

    def is_pending_command(self) -> bool:
        return False

    def clear_buffer(self) -> None:
        return

    def close(self) -> None:
        return


def write(client: Df1BaseClient, values: list[int]) -> bool:
    command = client.create_command(Command0FAA, table=10, file_type=FileType.INTEGER, start=16, data_to_write=values)
    return isinstance(client.send_command(command), Reply4f)


@pytest.fixture
def peer(tmp_path: Path) -> Iterator[tuple[Df1BaseClient, DeviceService]]:
    """Return the peer's client, and a simulated processor on the same line.

    Header bytes of 10h are avoided, since the client misreads them, as it does a check code 10 05. So the first
    transaction number is 2021h, and not random.
    """
    (tmp_path / "peer.device.yaml").write_text(DEVICE)
    clock = VirtualClock()
    line = SimulatedLine(clock, parse_format("8N1", 19200))
    device = DeviceService(load_devices(tmp_path / "peer.device.yaml", tmp_path)[0], line.port("device"), clock, None)
    device.start()
    client = Df1BaseClient(src=0, dst=1, seq_sleep_time=0)
    client._last_tns = 0x2020
    client._plc = Wire(line, clock)
    client._plc.bytes_received.append(client._bytes_received)
    clock.run_for(0)
    yield client, device
    device.stop()


def test_its_client_and_a_simulated_processor(peer: tuple[Df1BaseClient, DeviceService]) -> None:
    client, device = peer
    assert client.read_integer(start=0, total_int=3) == [0x1010, 0x1003, 0x0310]
    assert client.read_float(start=0, total_float=1) == [2.25]
    assert client.read_timer(start=2, category=TIMER.ACC) == [16]
    values = [0x1010, 0x0210, 0x1002, 0x1505, 16]
    assert write(client, values)
    assert device.memory.read("file10", "word", 16, 5) == values
    assert client.read_integer(file_table=10, start=16, total_int=5) == values
    assert not any(isinstance(exchange["command"], ReplyNak) for exchange in client.comm_history)


def test_random_words_through_both(peer: tuple[Df1BaseClient, DeviceService]) -> None:
    client, device = peer
    random = Random(5)
    for _ in range(40):
        values = [random.choice([0x1010, random.randrange(65536)]) for _ in range(random.randrange(1, 48))]
        assert write(client, values)
        assert device.memory.read("file10", "word", 16, len(values)) == values
        assert client.read_integer(file_table=10, start=16, total_int=len(values)) == values


def test_a_refusal_reaches_its_client(peer: tuple[Df1BaseClient, DeviceService]) -> None:
    client, _ = peer
    command = client.create_command(Command0FA2, bytes_to_read=2, table=99, file_type=FileType.INTEGER, start=0)
    reply = client.send_command(command)
    assert reply.sts.value == 0xF0

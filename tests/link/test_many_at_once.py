"""More frames in one piece than are handled in one turn: every frame is answered."""

from __future__ import annotations

from collections import deque

import pytest
from link.service_loop import codec_of

from framekit.definition.times import NEVER
from framekit.link import engine as engines
from framekit.link.engine import Engine
from framekit.link.events import Seen, Send
from framekit.link.sequences.state import MOST_STEPS
from framekit.link.services.server import MemoryServer
from framekit.link.values import FrameValue
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

STEPS_OF_ONE = 3
READ = bytes.fromhex("0000 0006 01 03 0000 0001")


def test_requests_that_come_in_one_piece_are_all_answered() -> None:
    protocol, codec = codec_of("modbus-tcp")
    memory = DeviceMemory(memory_of(protocol)[0])
    engine = Engine(protocol, codec, "server", own=1, server=MemoryServer(protocol, codec, memory))
    engine.opened(0)
    count = MOST_STEPS // STEPS_OF_ONE + 100
    requests = [number.to_bytes(2, "big") + READ for number in range(count)]
    waiting = deque(engine.receive(b"".join(requests), 1000))
    answered = []
    while waiting:
        command = waiting.popleft()
        assert isinstance(command, Send)
        answered.append(int.from_bytes(command.data[:2], "big"))
        waiting.extend(engine.sent(1000))
    assert answered == list(range(count))
    assert engine.counters.not_taken == 0 and engine.deadline == NEVER


def test_frames_without_end_in_one_piece_are_no_circle(monkeypatch: pytest.MonkeyPatch) -> None:
    protocol, codec = codec_of("modbus-tcp")
    monkeypatch.setattr(engines, "MOST_ROUNDS", 50)
    taken: list[FrameValue] = []
    seen: list[Seen] = []
    engine = Engine(protocol, codec, None, on_frame=taken.append, monitor=seen.append)
    engine.opened(0)
    engine.receive(b"".join(number.to_bytes(2, "big") + READ for number in range(300)), 1000)
    assert [frame.fields["transaction"] for frame in taken] == list(range(300))
    assert [event for event in seen if event.kind == "trouble"] == []

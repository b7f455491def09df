"""Shipped protocols with streams of their own frames, damage and noise: events do not depend on cuts, no exceptions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link.link_world import MS, cut_at, feed
from shipped import file_of, vectors_of
from spread import spread

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.definition.sources import shipped_definitions
from framekit.link.conversation import default_line
from framekit.link.engine import Engine
from framekit.link.events import Exchange
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope
from framekit.link.services.server import MemoryServer
from framekit.link.values import Names
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

VECTORS = sorted(file.name.split(".")[0] for file in shipped_definitions("*.vectors.yaml"))
NAMES = [name for name in VECTORS if "\nprotocol: " in "\n" + file_of(f"{name}.yaml").read_text(encoding="utf-8")]
"""Protocols, without applications, which have no line and so no stream."""


@cache
def loaded(name: str) -> tuple[Any, Any, list[bytes]]:
    protocol = load_protocol(name)
    samples = [case.wire.exact for case in vectors_of(name).frames]
    return protocol, compile_protocol(protocol), [data for data in samples if data]


def receiver(name: str, resync: str = "") -> Receiver:
    protocol, codec, _ = loaded(name)
    if resync:
        protocol = replace(protocol, receiver=replace(protocol.receiver, resync=resync))
    names = Names({"request": None, "buffer": b""}, Scope(protocol, line=default_line(protocol)))
    return Receiver(codec, protocol, names)


def streams(name: str) -> st.SearchStrategy[bytes]:
    samples = loaded(name)[2]
    damaged = st.tuples(st.sampled_from(samples), st.integers(0, 300), st.integers(1, 255)).map(
        lambda item: (
            item[0][: item[1] % len(item[0])]
            + bytes([item[0][item[1] % len(item[0])] ^ item[2]])
            + item[0][item[1] % len(item[0]) + 1 :]
        )
    )
    letters = sorted({byte for data in samples for byte in data[:3]})
    noise = st.builds(
        lambda seed, few, size: (
            bytes(Random(seed).choices(letters, k=size)) if few else Random(seed).randbytes(size)
        ),
        st.integers(0, 1 << 32), st.booleans(), st.integers(1, 600),
    )  # fmt: skip
    part = st.one_of(st.sampled_from(samples), damaged, st.binary(max_size=5), noise)
    return st.lists(part, max_size=6).map(b"".join)


@pytest.mark.parametrize("name", spread(NAMES, 3, 1))
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_cutting_changes_nothing(name: str, data: st.DataObject) -> None:
    stream = data.draw(streams(name))
    places = data.draw(st.lists(st.integers(0, 5000), max_size=8))
    names = receiver(name).table.on_line
    some = data.draw(st.integers(0, len(names)))
    expected, others = names[:some], names[some:]
    whole = feed(receiver(name), [stream], expected, others)
    assert feed(receiver(name), cut_at(stream, places), expected, others) == whole
    assert feed(receiver(name), [stream[at : at + 1] for at in range(len(stream))], expected, others) == whole


@pytest.mark.parametrize("pieces", [[62], [61, 62, 63], [*range(1, 65)]])
def test_noise_goes_on_behind_a_delimiter_that_comes_last(pieces: list[int]) -> None:
    """Only the following bytes decide whether a delimiter fills a pause or begins a bad frame that is not reported."""
    stream = bytes.fromhex(
        "d0d07d5e7e7dd05e7d7ed17e5ed07e5ed1d1d0d15e95d1957d007d7ed1d17dd05ed0"
        "7e00957dd095007dd0555ed0557e55d1d07d005e7ed1007e957ed07ed1"
    )
    whole = feed(receiver("shdlc"), [stream], (), receiver("shdlc").table.on_line)
    assert whole[-1] == ("noise", b"~\xd0~\xd1", 59, True)
    assert feed(receiver("shdlc"), cut_at(stream, pieces), (), receiver("shdlc").table.on_line) == whole


@pytest.mark.parametrize("name", spread(["shdlc", "df1", "modbus-rtu"], 3))
@given(data=st.data())
@settings(max_examples=15, deadline=None)
def test_cutting_changes_nothing_where_the_first_bad_frame_ends_all(name: str, data: st.DataObject) -> None:
    stream = data.draw(streams(name))
    places = data.draw(st.lists(st.integers(0, 5000), max_size=8))
    names = receiver(name).table.on_line
    some = data.draw(st.integers(0, len(names)))
    expected, others = names[:some], names[some:]
    whole = feed(receiver(name, "never"), [stream], expected, others)
    assert feed(receiver(name, "never"), cut_at(stream, places), expected, others) == whole
    assert feed(receiver(name, "never"), [stream[at : at + 1] for at in range(len(stream))], expected, others) == whole


def test_a_frame_stands_inside_another_only_where_that_one_has_begun() -> None:
    """The stream has escaped bytes that cannot be the station before the region, then bytes that it may contain."""
    stream, names = bytes.fromhex("10 01 05 00 10 02 10 15"), receiver("df1").table.on_line
    whole = feed(receiver("df1"), [stream], (), names)
    assert [event[1] for event in whole if event[0] != "noise"] == ["master_message", "nak", "message"]
    assert feed(receiver("df1"), [stream[at : at + 1] for at in range(len(stream))], (), names) == whole


EVENTS = ("bytes", "time", "exchange", "break", "lost")


@pytest.mark.parametrize("name", spread(NAMES, 3, 2))
@given(data=st.data())
@settings(max_examples=15, deadline=None)
def test_an_engine_survives_everything_that_may_happen(name: str, data: st.DataObject) -> None:
    protocol, codec, _ = loaded(name)
    role = data.draw(st.sampled_from([*protocol.roles, None]))
    server = MemoryServer(protocol, codec, DeviceMemory(memory_of(protocol)[0])) if protocol.services else None
    engine = Engine(protocol, codec, role, own=1 if protocol.station.type == "number" else None, server=server)
    now, started, ended = 0, 0, 0
    engine.opened(now)

    def done(outcome: Any) -> None:
        nonlocal ended
        ended += 1

    for kind in data.draw(st.lists(st.sampled_from(EVENTS), max_size=12)):
        if kind == "bytes":
            engine.receive(data.draw(streams(name)), now)
        elif kind == "time":
            now = max(now, min(engine.deadline, now + data.draw(st.integers(0, 3000)) * MS))
            engine.sent(now)
            engine.tick(now)
        elif kind == "exchange":
            started += 1
            engine.start(Exchange(station=1, expected=tuple(protocol.frames)[:3], on_done=done), now)
        elif kind == "break":
            engine.line_break(now)
        else:
            engine.closed(now, "gone")
            engine.opened(now)
        assert engine.deadline >= now
    engine.closed(now, "the end")
    assert started == ended, "every exchange is told how it ended, exactly once"

"""What takes a frame out of a buffer finds what measuring and decoding find, and nothing that they do not."""

from __future__ import annotations

import random

import pytest
from link.test_shipped_streams import NAMES, loaded, receiver

from framekit.codec.errors import FrameError
from framekit.link.frame_info import FrameInfo, Take
from framekit.link.receiver import Receiver


def takers(one: Receiver) -> list[FrameInfo]:
    return [one.table.infos[name] for name in one.table.on_line if one.table.infos[name].take is not None]


def taker(info: FrameInfo, data: bytes, place: int) -> Take:
    """What a receiver takes a frame with: together with the one inside it, where that is possible."""
    assert info.take is not None
    if info.together is None or place + info.together[0] >= len(data):
        return info.take
    return info.together[1][data[place + info.together[0]]] or info.take


def as_measured(info: FrameInfo, data: bytes, place: int, one: Receiver) -> tuple[bytes | None, object] | None:
    """None and its size, if nothing is wrong but its check code; None and 0, if it is surely none."""
    size = info.measure(data, place, len(data), one._names, 0)
    if size <= 0:
        return None if size else (None, 0)
    raw = data[place : place + size]
    try:
        return raw, info.decode(raw, one._names)
    except FrameError as error:
        if info.intact is not None and not info.intact(raw):
            assert error.refuse is None
            return None, size
        return None


def is_begun(info: FrameInfo, data: bytes, place: int, one: Receiver) -> bool:
    return one._quiet < info.measure(data, place, len(data), one._names, 0) < 0


@pytest.mark.parametrize("name", NAMES)
def test_what_is_taken_is_what_is_measured_and_decoded(name: str) -> None:
    choose, one, samples = random.Random(name), receiver(name), loaded(name)[2]
    good = sure = wrong = 0
    for sample in samples:
        before, behind = choose.randbytes(choose.randrange(4)), choose.choice((b"", sample, choose.randbytes(5)))
        for info in takers(one):
            data, place = before + sample + behind, len(before)
            taken = taker(info, data, place)(data, place, len(data), one._names)
            measured = as_measured(info, data, place, one)
            assert taken in (None, measured) or (taken == () and is_begun(info, data, place, one))
            good += measured is not None and measured[0] is not None
            sure += bool(taken) and taken[0] is not None
            bad = bytearray(data)
            bad[place + choose.randrange(len(sample))] ^= choose.randrange(1, 256)
            taken = taker(info, bytes(bad), place)(bytes(bad), place, len(bad), one._names)
            if taken != () or not is_begun(info, bytes(bad), place, one):
                assert taken in (None, as_measured(info, bytes(bad), place, one))
            wrong += bool(taken) and taken[0] is None
            cut = data[: place + choose.randrange(len(sample))]
            taken = taker(info, cut, place)(cut, place, len(cut), one._names)
            assert taken in (None, as_measured(info, cut, place, one)) or (
                taken == () and is_begun(info, cut, place, one)
            )
    assert sure * 2 >= good, (
        "what is none of those inside, or only the second best, is left to those who look with care"
    )
    assert wrong or not any(info.intact and info.together for info in takers(one))


def test_most_protocols_have_frames_that_are_taken() -> None:
    """Replies of Modbus out of one buffer, DF1 without what stands in its frames, MLDP between its ends."""
    found = {name: {info.name for info in takers(receiver(name))} for name in NAMES}
    assert found["modbus-rtu"] == {"request_adu", "reply_adu"}
    assert "message" in found["df1"]
    assert {"read_individual_reply", "read_continuous_reply"} <= found["mldp"]

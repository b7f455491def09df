"""Behaviour of all ports: the same checks on every pair of ports."""

from __future__ import annotations

import pytest
from transport.real_world import PAIRS, Pair, on_pair

pytestmark = [pytest.mark.parametrize("kind", PAIRS), pytest.mark.usefixtures("each_loop")]


def test_every_byte_arrives_both_ways(kind: str) -> None:
    async def check(pair: Pair) -> None:
        message = bytes(range(256))
        pair.left.write(message)
        assert await pair.there.bytes(256) == message
        pair.right.write(message[::-1])
        assert await pair.here.bytes(256) == message[::-1]

    on_pair(kind, check)


def test_many_pieces_arrive_in_order(kind: str) -> None:
    async def check(pair: Pair) -> None:
        pieces = [bytes([number]) * (number % 17 + 1) for number in range(200)]
        for piece in pieces:
            pair.left.write(piece)
        whole = b"".join(pieces)
        assert await pair.there.bytes(len(whole)) == whole

    on_pair(kind, check)


def test_more_than_a_driver_takes_at_once(kind: str) -> None:
    async def check(pair: Pair) -> None:
        message = bytes(number * 7 % 251 for number in range(50_000))
        pair.left.write(message)
        assert await pair.there.bytes(len(message)) == message

    on_pair(kind, check)


def test_sent_is_told_once_when_everything_has_left(kind: str) -> None:
    async def check(pair: Pair) -> None:
        pair.left.write(b"one")
        pair.left.write(b"two")
        await pair.here.until("sent")
        assert await pair.there.bytes(6) == b"onetwo"
        pair.left.write(b"three")
        await pair.here.until("sent")
        assert pair.here.seen == ["opened", "sent", "sent"]
        assert "sent" not in pair.there.seen

    on_pair(kind, check)


def test_nothing_is_told_from_inside_of_a_call(kind: str) -> None:
    async def check(pair: Pair) -> None:
        before = len(pair.here.seen), len(pair.there.seen)
        pair.left.write(b"x")
        pair.left.write(b"")
        pair.left.send_break(1000)
        pair.left.set_rts(True)
        assert (len(pair.here.seen), len(pair.there.seen)) == before
        await pair.here.until("sent")
        assert await pair.there.bytes(1) == b"x"

    on_pair(kind, check)


def test_nothing_to_send_is_sent(kind: str) -> None:
    async def check(pair: Pair) -> None:
        pair.left.write(b"")
        await pair.here.until("sent")
        pair.left.write(b"x")
        assert await pair.there.bytes(1) == b"x"

    on_pair(kind, check)


def test_a_break_is_sent_and_bytes_follow_it(kind: str) -> None:
    async def check(pair: Pair) -> None:
        pair.left.write(b"before")
        pair.left.send_break(2_000_000)
        pair.left.write(b"behind")
        await pair.here.until("sent")
        assert await pair.there.bytes(12) == b"beforebehind"
        assert pair.here.seen.count("sent") == 1
        assert ("break" in pair.there.seen) == (kind == "simulated line")

    on_pair(kind, check)


def test_times_do_not_go_back(kind: str) -> None:
    async def check(pair: Pair) -> None:
        begin = pair.here.times[0]
        for _ in range(5):
            pair.left.write(b"ask")
            await pair.there.bytes(3)
            pair.right.write(b"answer")
            await pair.here.bytes(6)
        received = [now for kind, now in zip(pair.here.seen, pair.here.times, strict=True) if kind == "received"]
        assert received == sorted(received)
        assert begin <= received[0] and received[-1] <= pair.clock.now()

    on_pair(kind, check)


def test_who_closes_is_told_nothing_more_and_may_go_on_calling(kind: str) -> None:
    async def check(pair: Pair) -> None:
        pair.left.write(b"x")
        pair.left.close()
        seen = list(pair.here.seen)
        pair.right.write(b"is anybody there?")
        for _ in range(2):
            pair.left.write(b"into the void")
            pair.left.send_break(1000)
            pair.left.set_rts(True)
            pair.left.close()
        await pair.again()
        pair.left.write(b"again")
        found = b""
        while b"again" not in found:
            found += await pair.there.bytes(1)
        assert b"void" not in found
        assert seen == ["opened"]

    on_pair(kind, check)


def test_a_port_that_has_been_closed_opens_again(kind: str) -> None:
    async def check(pair: Pair) -> None:
        for number in range(3):
            await pair.again()
            pair.left.write(bytes([number]))
            assert await pair.there.bytes(1) == bytes([number])
            pair.right.write(b"yes")
            assert await pair.here.bytes(3) == b"yes"

    on_pair(kind, check)


def test_a_port_that_is_pulled_says_so_once(kind: str) -> None:
    async def check(pair: Pair) -> None:
        pair.pull()
        reason = await pair.here.until("closed")
        assert reason and isinstance(reason, str)
        pair.left.write(b"into the void")
        pair.left.close()
        assert pair.here.seen.count("closed") == 1

    on_pair(kind, check)


def test_ports_say_what_they_are(kind: str) -> None:
    async def check(pair: Pair) -> None:
        for port in (pair.left, pair.right):
            assert port.name in port.describes()
            assert (port.settings is None) == (" at " not in port.describes())

    on_pair(kind, check)

"""The simulated line: bit-exact times, several ports, coalescing, collisions, breaks, opening and closing."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from line_faults import Faults, lose
from transport.line_world import SECOND, World

from framekit.link.events import LineFault
from framekit.transport.simulated_line import Transmission

# ---- times --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "speed", "character"),
    [("8N1", 9600, 1_041_667), ("8E1", 19200, 572_917), ("7E2", 300, 36_666_667), ("5N1.5", 50, 150_000_000)],
)
@pytest.mark.parametrize("options", [{}, {"granularity": 1}, {"granularity": 2}])
def test_characters_take_their_bit_times(text: str, speed: int, character: int, options: dict[str, int]) -> None:
    world = World(2, text, speed, **options)
    world.ports[0].write(b"\x01\x02\x03")
    world.ports[0].write(b"\x04")
    world.clock.run_for(SECOND)
    assert world.listeners[1].characters() == [(number * character, number) for number in (1, 2, 3, 4)]
    assert world.listeners[0].sent_at == [4 * character], "once, for everything handed over"


def test_later_bytes_start_when_handed_over() -> None:
    world = World()
    world.ports[0].write(b"a")
    world.clock.run_until(10 * world.character)
    world.ports[0].write(b"b")
    world.clock.run_for(SECOND)
    assert world.listeners[1].characters() == [(world.character, ord("a")), (11 * world.character, ord("b"))]
    assert world.listeners[0].sent_at == [world.character, 11 * world.character]


def test_nothing_to_send_is_sent_at_once() -> None:
    world = World()
    world.ports[0].write(b"")
    world.clock.run_for(0)
    assert world.listeners[0].sent_at == [0]
    assert world.line.transmissions == 0


def test_a_line_of_seven_bits_carries_no_eighth() -> None:
    world = World(2, "7E1")
    world.ports[0].write(b"\x85\x05\xff")
    world.clock.run_for(SECOND)
    assert world.listeners[1].bytes == b"\x05\x05\x7f"


def test_latency_delays_what_is_heard_but_not_what_is_sent() -> None:
    world = World(2, latency=1000)
    world.ports[0].write(b"ab")
    world.clock.run_for(SECOND)
    assert [now for now, _ in world.listeners[1].characters()] == [
        world.character + 1000,
        2 * world.character + 1000,
    ]
    assert world.listeners[0].sent_at == [2 * world.character]


# ---- who hears ----------------------------------------------------------------------------------------------


def test_everybody_on_the_line_hears_but_the_sender() -> None:
    world = World(4)
    world.ports[1].write(b"x")
    world.clock.run_for(SECOND)
    assert [listener.bytes for listener in world.listeners] == [b"x", b"", b"x", b"x"]


def test_an_echo_lets_the_sender_hear_itself() -> None:
    world = World(2, echo=True)
    world.ports[0].write(b"x")
    world.clock.run_for(SECOND)
    assert world.listeners[0].characters() == world.listeners[1].characters() == [(world.character, ord("x"))]


def test_both_may_talk_at_once_on_a_full_duplex_line() -> None:
    world = World()
    world.ports[0].write(b"left")
    world.ports[1].write(b"right")
    world.clock.run_for(SECOND)
    assert (world.listeners[0].bytes, world.listeners[1].bytes) == (b"right", b"left")
    assert world.listeners[0].faults == world.listeners[1].faults == []


# ---- coalescing ---------------------------------------------------------------------------------------------


def test_a_transmission_is_one_event_when_nothing_else_happens() -> None:
    world = World()
    world.ports[0].write(bytes(25))
    world.clock.run_for(SECOND)
    assert world.listeners[1].data == [(25 * world.character, bytes(25))]


@pytest.mark.parametrize(("offset", "heard"), [(-1, 9), (0, 10), (1, 10)])
def test_whatever_else_happens_finds_what_is_complete(offset: int, heard: int) -> None:
    """A timer that fires while characters arrive must see those received so far.

    At equal times, characters come first.
    """
    world = World()
    found: list[int] = []
    when = 10 * world.character + offset
    world.clock.call_at(when, lambda: found.append(len(world.listeners[1].bytes)))
    world.ports[0].write(bytes(25))
    world.clock.run_for(SECOND)
    assert found == [heard]
    assert [len(data) for _, data in world.listeners[1].data] == [heard, 25 - heard]


def test_a_gap_timer_set_anew_by_each_character_never_runs_out() -> None:
    """Like a receiver for which a frame ends after a silence of one and a half characters."""
    world = World()
    listener, cut = world.listeners[1], []
    gap = world.character * 3 // 2

    def look(known: int) -> None:
        last = listener.data[-1][0]
        if world.clock.now() - last >= gap:
            cut.append(known)
        if len(listener.bytes) < 25:
            world.clock.call_at(last + gap, lambda: look(len(listener.bytes)))

    world.clock.call_at(5 * world.character, lambda: look(0))
    world.ports[0].write(bytes(25))
    world.clock.run_for(SECOND)
    assert cut == [] and len(listener.bytes) == 25
    assert len(listener.data) > 10, "from the first look on, it was told character by character"


Writes = st.lists(
    st.tuples(st.integers(0, 2), st.integers(0, 30), st.binary(min_size=1, max_size=12)), min_size=1, max_size=8
)
SomeFaults = st.fixed_dictionaries({
    "bit_errors": st.sampled_from([0.0, 0.02]),
    "byte_errors": st.sampled_from([0.0, 0.1]),
    "drop": st.sampled_from([0.0, 0.2]),
    "truncate": st.sampled_from([0.0, 0.3]),
    "extra": st.sampled_from([0.0, 0.3]),
    "delay": st.sampled_from([0, 5_000_000]),
    "echo": st.booleans(),
    "seed": st.integers(0, 9),
})  # fmt: skip


def hold_up(transmission: Transmission) -> None:
    """Add pauses in the middle, and lose a character."""
    if len(transmission.data) > 4 and transmission.number % 2:
        transmission.pause(2, 3_000_000)
        lose(transmission, 3)


@settings(max_examples=60, deadline=None)
@given(
    Writes,
    SomeFaults,
    st.booleans(),
    st.sampled_from([{}, {"granularity": 3}]),
    st.lists(st.integers(0, 60_000_000), max_size=5),
)
def test_however_it_is_told_the_characters_and_times_are_the_same(
    writes: list[tuple[int, int, bytes]],
    faults: dict[str, float],
    full_duplex: bool,
    options: dict[str, object],
    looks: list[int],
) -> None:
    def outcome(**options: object) -> list[object]:
        injected = Faults(**faults)  # type: ignore[arg-type]

        def fault(transmission: Transmission) -> None:
            injected(transmission)
            hold_up(transmission)

        world = World(3, "8E1", 9600, full_duplex=full_duplex, fault=fault, **options)
        for port, characters, data in writes:
            when = characters * world.character + port
            world.clock.call_at(when, lambda port=port, data=data: world.ports[port].write(data))
        for when in looks:
            world.clock.call_at(when, lambda: None)
        world.clock.run_for(SECOND)
        assert world.clock.next_call is None
        return [
            found
            for listener in world.listeners
            for found in (
                sorted(listener.characters()),
                sorted((listener.characters()[index], fault.value) for index, fault in listener.faults),
                listener.sent_at,
            )
        ]

    assert outcome(**options) == outcome(granularity=1)


# ---- collisions ---------------------------------------------------------------------------------------------


def collided(**options: object) -> World:
    """Port 1 begins two and a half characters after port 0, which sends four; port 2 listens."""
    world = World(3, full_duplex=False, **options)
    world.ports[0].write(b"aaaa")
    when = 2 * world.character + world.character // 2
    world.clock.call_at(when, lambda: world.ports[1].write(b"bbb"))
    world.clock.run_for(SECOND)
    return world


def test_who_talks_at_the_same_time_damages_what_overlaps() -> None:
    heard = collided().listeners[2].bytes
    assert heard[:2] == b"aa", "characters before the collision are whole"
    assert heard[2] != ord("a") and heard[3] != ord("a")
    assert heard[4:] == b"b", "of the other, only what begins behind"


def test_half_of_the_damaged_characters_have_no_stop_bit() -> None:
    flagged = [len(collided(seed=seed).listeners[2].faults) for seed in range(40)]
    assert set(flagged) == {0, 1, 2}
    faults = {fault for seed in range(10) for _, fault in collided(seed=seed).listeners[2].faults}
    assert faults == {LineFault.FRAMING}


def test_collisions_are_repeatable() -> None:
    first, again, other = collided(seed=1), collided(seed=1), collided(seed=2)
    assert first.listeners[2].characters() == again.listeners[2].characters()
    assert first.listeners[2].bytes != other.listeners[2].bytes


def test_who_answers_at_the_instant_the_line_is_free_damages_nothing() -> None:
    world = World(3, full_duplex=False)
    world.ports[0].write(b"aa")
    world.clock.call_at(2 * world.character, lambda: world.ports[1].write(b"bb"))
    world.clock.run_for(SECOND)
    assert world.listeners[2].bytes == b"aabb" and world.listeners[2].faults == []


# ---- breaks -------------------------------------------------------------------------------------------------


def test_a_break_reaches_the_others_and_bytes_wait_for_its_end() -> None:
    world = World()
    world.ports[0].write(b"a")
    world.ports[0].send_break(5_000_000)
    world.ports[0].write(b"x")
    world.clock.run_for(SECOND)
    character = world.character
    assert world.listeners[1].events == [("opened", 0), ("break", 2 * character)]
    assert world.listeners[1].characters() == [(character, ord("a")), (2 * character + 5_000_000, ord("x"))]
    assert world.listeners[0].sent_at == [2 * character + 5_000_000]


def test_a_break_no_longer_than_a_character_is_none() -> None:
    world = World()
    world.ports[0].send_break(world.character)
    world.clock.run_for(SECOND)
    assert world.listeners[1].events == [("opened", 0)]
    assert world.listeners[0].sent_at == [world.character]


def test_a_break_on_a_shared_pair_damages_what_others_send() -> None:
    world = World(3, full_duplex=False)
    world.ports[0].write(b"aaaa")
    world.clock.call_at(world.character, lambda: world.ports[1].send_break(2 * world.character))
    world.clock.run_for(SECOND)
    heard = world.listeners[2].bytes
    assert heard[0] == heard[3] == ord("a") and ord("a") not in heard[1:3]


def test_who_talks_into_a_break_is_damaged() -> None:
    world = World(3, full_duplex=False)
    world.ports[1].send_break(4 * world.character)
    world.clock.call_at(3 * world.character, lambda: world.ports[0].write(b"aa"))
    world.clock.run_for(SECOND)
    heard = world.listeners[2].bytes
    assert heard[0] != ord("a") and heard[1] == ord("a")


# ---- opening and closing ------------------------------------------------------------------------------------


def test_a_closed_port_sends_and_hears_nothing() -> None:
    world = World()
    world.ports[1].close()
    world.ports[1].close()
    world.ports[0].write(b"a")
    world.ports[1].write(b"b")
    world.ports[1].send_break(SECOND)
    world.clock.run_for(SECOND)
    assert world.listeners[1].data == [] and world.listeners[0].data == []
    assert world.listeners[1].events == [("opened", 0)], "who closes is told nothing"


def test_who_closes_in_the_middle_has_sent_only_what_was_complete() -> None:
    world = World()
    world.ports[0].write(bytes(range(10)))
    world.clock.call_at(3 * world.character + 1, world.ports[0].close)
    world.clock.run_for(SECOND)
    assert world.listeners[1].bytes == bytes(range(3))
    assert world.listeners[0].sent_at == []
    assert world.clock.next_call is None


def test_who_opens_in_the_middle_hears_what_begins_behind() -> None:
    world = World()
    world.ports[1].close()
    world.ports[0].write(bytes(range(10)))
    world.clock.run_until(3 * world.character + 1)
    world.ports[1].open(world.listeners[1])
    world.clock.run_for(SECOND)
    assert world.listeners[1].characters() == [((index + 1) * world.character, index) for index in range(4, 10)]


def test_a_pulled_port_says_so_and_comes_back_when_it_is_there() -> None:
    world = World()
    port, listener = world.ports[1], world.listeners[1]
    port.present = False
    port.pull("gone")
    port.open(listener)
    world.ports[0].write(b"x")
    world.clock.run_for(SECOND)
    assert [event for event, _ in listener.events] == ["opened", "closed: gone", "closed: port 1 is not there"]
    port.present = True
    port.open(listener)
    world.clock.run_for(0)
    world.ports[0].write(b"y")
    world.clock.run_for(SECOND)
    assert listener.bytes == b"y"


def test_control_lines_are_told_and_rts_is_kept() -> None:
    world = World()
    world.ports[0].set_rts(True)
    world.ports[1].signal({"cts": True})
    assert world.ports[0].rts and world.listeners[1].lines == [{"cts": True}]


# ---- streams ------------------------------------------------------------------------------------------------


def test_a_stream_has_latency_and_no_bit_times() -> None:
    world = World(2, None, latency=700)
    world.ports[0].write(b"hel")
    world.ports[0].write(b"lo")
    world.ports[0].send_break(SECOND)
    world.clock.run_for(1000)
    assert b"".join(data for now, data in world.listeners[1].data if now == 700) == b"hello"
    assert world.listeners[0].sent_at == []
    world.clock.run_for(SECOND)
    assert len(world.listeners[0].sent_at) == 1


def test_a_stream_keeps_its_order_whatever_the_delay() -> None:
    world = World(2, None, fault=Faults(delay=1000, seed=3))
    for number in range(20):
        world.ports[0].write(bytes([number]))
    world.clock.run_for(SECOND)
    assert world.listeners[1].bytes == bytes(range(20))


def test_a_connection_needs_two_and_ends_for_both() -> None:
    world = World(1, None, latency=50)
    first, mine = world.ports[0], world.listeners[0]
    assert mine.events == [], "nobody to connect to"
    other = World(1, None).listeners[0]
    second = world.line.port("second")
    other.port = second
    second.open(other)
    world.clock.run_for(0)
    assert [event for event, _ in mine.events] == [event for event, _ in other.events] == ["opened"]
    first.write(b"last words")
    first.close()
    first.open(mine)
    world.clock.run_for(SECOND)
    assert other.bytes == b"last words"
    assert other.events[-1] == ("closed: the other side has closed the connection", 50)
    assert len(mine.events) == 1, "waits for the other to connect again"
    second.open(other)
    world.clock.run_for(0)
    assert mine.events[-1] == other.events[-1] == ("opened", SECOND)


def test_bytes_of_an_old_connection_do_not_come_out_of_a_new_one() -> None:
    world = World(2, None, latency=1000)
    left, right = world.ports
    left.write(b"question")
    world.clock.run_until(900)
    right.write(b"too late")
    left.close()
    left.open(world.listeners[0])
    right.close()
    right.open(world.listeners[1])
    world.clock.run_for(SECOND)
    assert world.listeners[0].bytes == world.listeners[1].bytes == b""
    left.write(b"new")
    world.clock.run_for(SECOND)
    assert world.listeners[1].bytes == b"new"

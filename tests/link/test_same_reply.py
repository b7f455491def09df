"""What is learned from a reply: never more than the definition makes certain. The long way is the measure of it."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from link.made_up_reads import ASKED, FLAT, HANDED_OVER, READS, TOLD, VALUES, Pair, Reply, changed, with_values

OTHER = with_values(b"\xff123")
WHEN = '"it.pdu.frame in expected"'


def _with_sum(reply: Reply) -> Reply:
    return lambda asked: reply(asked) + bytes([sum(reply(asked)) & 0xFF])


def _followed(end: bytes, reply: Reply) -> Reply:
    return lambda asked: reply(asked) + end


def _line(values: bytes) -> Reply:
    """A frame that ends at the first carriage return."""
    return lambda asked: asked[:3] + b"\3" + values + b"\r"


def _flat(values: bytes) -> Reply:
    return lambda asked: asked[:3] + bytes([len(values)]) + values


# ---- what is learned ------------------------------------------------------------------------------------------------


def test_a_reply_is_known_but_for_its_data_and_what_the_request_got_anew() -> None:
    pair = Pair()
    assert pair.read(with_values(), with_values()) == [True, True]
    same = pair.same
    assert same is not None and (same.start, same.end) == (5, 9)
    assert pair.read(with_values(b"abcd"), OTHER, with_values(bytes(4))) == [True, True, True]
    assert [one.values for one in pair.short.results[-3:]] == [[0x6162, 0x6364], [0xFF31, 0x3233], [0, 0]]
    assert pair.same is same, "once is enough"


def test_every_other_byte_has_to_be_what_it_was() -> None:
    pair = Pair()
    pair.read(with_values(), with_values())
    assert pair.same is not None
    sent = b"\0\x07\1\3\3\1\2"
    reply = with_values()(sent)
    assert pair.same.fits(reply, sent)
    for place in range(len(reply)):
        for bit in range(8):
            damaged = bytearray(reply)
            damaged[place] ^= 1 << bit
            assert pair.same.fits(bytes(damaged), sent) is (5 <= place < 9)
    assert not pair.same.fits(reply + b"\0", sent) and not pair.same.fits(reply[:-1], sent)
    assert not pair.same.fits(reply, b"\0\x08" + sent[2:])


@pytest.mark.parametrize("place", range(9))
def test_a_reply_damaged_anywhere_comes_to_what_it_always_came_to(place: int) -> None:
    pair = Pair()
    pair.read(with_values(), with_values())

    def damaged(asked: bytes) -> bytes:
        reply = bytearray(with_values()(asked))
        reply[place] ^= 1
        return bytes(reply)

    assert pair.read(damaged, with_values(b"wxyz")) == [place > 4, True]


def test_the_fields_beside_the_data_are_those_of_each_reply() -> None:
    pair = Pair(FLAT)
    assert pair.read(_flat(b"\0\1\0\2"), _flat(b"\0\1\0\2"), _flat(b"abcd")) == [True, True, True]
    assert pair.same is not None
    reply = pair.short.results[-1].reply
    assert reply is not None and reply.fields["tag"] == 3
    assert reply.raw == pair.short.results[-1].raw == b"\0\3\1\4abcd"


def test_a_check_code_at_the_end_is_looked_at() -> None:
    pair = Pair(changed((TOLD, f"{TOLD}, {{check: sum8}}")))
    assert pair.read(*[_with_sum(with_values())] * 2, _with_sum(OTHER)) == [True] * 3
    assert pair.same is not None
    assert pair.read(_followed(b"\0", OTHER), _with_sum(OTHER)) == [False, True]


def test_digits_of_either_case_are_one_number() -> None:
    text = READS.replace("{field: tag, type: u16}", "{field: tag, type: hex, size: 4}")
    pair = Pair(changed(("{type: u16}", "{type: u16, initial: 8}"), text=text))

    def answer(asked: bytes) -> bytes:
        return asked[:5] + b"\5\3\0\1\0\2"

    assert pair.read(answer, answer, answer) == [True] * 3
    assert pair.same is not None
    assert pair.read(lambda asked: answer(asked.lower())) == [True], "looked at with care, and good"


def test_what_stands_beside_the_data_has_to_stay_as_it_was() -> None:
    pair = Pair(changed((TOLD, f"{TOLD}, {{field: state, type: u8, values: {{0: good, 1: fair}}, only: values}}")))
    assert pair.read(*[_followed(b"\0", with_values())] * 2, _followed(b"\0", OTHER)) == [True] * 3
    assert pair.same is not None
    assert pair.read(_followed(b"\1", OTHER), _followed(b"\2", OTHER)) == [True, False]


@pytest.mark.parametrize("first", [b"\0\1\0\2\0\3", b"\0\1", b""], ids=["longer", "shorter", "empty"])
def test_nothing_is_learned_from_a_reply_that_does_not_bring_what_was_asked_for(first: bytes) -> None:
    pair = Pair()
    pair.read(with_values(first), with_values(first), with_values(first))
    assert not any(one.ok for one in pair.short.results) or pair.same is None
    assert pair.read(with_values(), with_values()) == [True, True]
    assert pair.same is not None and pair.same.end - pair.same.start == 4
    assert pair.read(with_values(first), OTHER) == [False, True]


def test_a_reply_that_announces_something_takes_the_long_way() -> None:
    pair = Pair(
        changed(
            (
                f"echo: [tag, station], body: [{TOLD}]",
                f"echo: [tag, station], announces: {{heard: tag}}, body: [{TOLD}]",
            ),
            ("{number: {type: u16}}", "{number: {type: u16}, heard: {type: u16}}"),
        )
    )
    for number in range(1, 5):
        assert pair.read(with_values()) == [True]
        assert [side.engine.scope["heard"] for side in (pair.short, pair.long)] == [number, number]
    assert pair.request is None


# ---- what is not ----------------------------------------------------------------------------------------------------

NOT_LEARNED: dict[str, tuple[list[tuple[str, str]], list[Reply]]] = {
    "the frame asks something of its data": (
        [(VALUES, f"{VALUES}, {{require: 'values[0] < 9'}}")], [OTHER],
    ),
    "it is refused for its data": (
        [(VALUES, f"{VALUES}, {{require: 'values[0] < 9', refuse: 4}}")], [OTHER],
    ),
    "a value is worked out from the data": (
        [(VALUES, f"{VALUES}, {{value: first, read: 'values[0]'}}")], [OTHER],
    ),
    "a row looks at the data": (
        [(WHEN, '"it.pdu.frame in expected and it.pdu.values[0] < 9"')], [OTHER],
    ),
    "a row measures something": (
        [(WHEN, '"it.pdu.frame in expected and len(it.pdu.values) < 9"')], [OTHER],
    ),
    "a row compares the whole frame": (
        [(WHEN, '"it.pdu.frame in expected and it.pdu != request"')], [OTHER],
    ),
    "another row looks at the data": (
        [("          - {frame: answer", "          - {frame: answer, when: 'it.pdu.values[0] > 9', then: again}\n"
          "          - {frame: answer")], [OTHER],
    ),
    "a row looks at a variable": (
        [(WHEN, '"it.pdu.frame in expected and number < 4"')], [with_values()] * 4,
    ),
    "a row looks at the number that the request got anew": (
        [(WHEN, '"it.pdu.frame in expected and it.tag < 4"')], [with_values()] * 4,
    ),
    "the frame asks something of the number that the request got anew": (
        [(TOLD, f"{TOLD}, {{require: 'tag < 4'}}")], [with_values()] * 4,
    ),
    "the number may be refused": (
        [(TOLD, TOLD.replace("{field: tag, type: u16}", "{field: tag, type: u16, range: 0..3}"))], [with_values()] * 4,
    ),
    "a row works something out": (
        [("local: {result: frame}", "local: {result: frame, share: u8}"),
         (HANDED_OVER, "set: {result: it.pdu, share: '7 // it.pdu.values[1]'}")], [with_values(b"\0\0\0\0"), OTHER],
    ),
    "the result is worked out": (
        [("gives: {reply: result}", "gives: {reply: 'result if result.values[0] < 9 else none()'}")], [OTHER],
    ),
    "there is another result": (
        [("gives: {reply: result}", "gives: {reply: result, again: result}")], [OTHER],
    ),
    "data are swapped": ([(VALUES, "{data: values, size: rest, swap: 2}")], [OTHER]),
    "data are in a choice": ([(VALUES, f"{{choose: function, cases: {{3: [{VALUES}]}}}}")], [OTHER]),
    "a part may be absent": (
        [("type: u8, is: 3}, {data", "type: u8, is: 3}, {field: more, type: u8, when: function == 4}, {data")], [OTHER],
    ),
    "a frame before it would be taken for some data": (
        [("  read_reply:", "  odd: {group: told, body: [{field: function, type: u8, is: 3}, {data: some, size: 3}, "
          "{const: FF}]}\n  read_reply:")], [with_values(b"abc\xff"), OTHER],
    ),
    "a frame before it would be refused for some data": (
        [("  read_reply:", "  odd: {group: told, body: [{field: function, type: u8, is: 3}, {data: some, size: 3}, "
          "{const: FF, refuse: 7}]}\n  read_reply:")], [with_values(b"abc\xff"), OTHER],
    ),
}  # fmt: skip
"""By what is done to the protocol: the words changed, and replies that may come to something else than the first."""


@pytest.mark.parametrize("what", NOT_LEARNED)
def test_nothing_is_learned_where(what: str) -> None:
    changes, replies = NOT_LEARNED[what]
    pair = Pair(changed(*changes))
    begun = pair.read(with_values(), with_values())
    assert begun == [True, True] or "taken" in what or "refused for some" in what
    pair.read(*replies)
    assert pair.request is not None, "there is a short way"
    assert pair.same is None


@pytest.mark.parametrize(
    "how", ["{require: 'number < 5'}", "{require: 'number < 5', refuse: 4}", "{value: v, read: number}"]
)
@pytest.mark.parametrize("flat", [True, False], ids=["flat", "in a frame"])
def test_nothing_is_learned_where_another_frame_stands_beside_the_data(how: str, flat: bool) -> None:
    before = f"{'' if flat else 'answer:     {from: server, '}echo: [tag, station], body: [{{field: tag"
    pair = Pair(
        changed(
            (before, before.replace("body: [", "body: [{inner: mark, of: [stamp]}, ")),
            (
                "  read:\n    group",
                f"  stamp: {{from: server, body: [{{field: more, type: u8}}, {how}]}}\n  read:\n    group",
            ),
            text=FLAT if flat else READS,
        )
    )
    reply = _flat(b"\0\1\0\2") if flat else with_values()
    good = pair.read(*[lambda asked: b"\7" + reply(asked)] * 8)
    assert good == [True] * 4 + ["refuse" not in how] * 4
    assert pair.request is not None and pair.same is None


@pytest.mark.parametrize(
    ("echo", "whose"),
    [
        ("answer:     {from: server, echo: [tag, station]", "answer: {from: server, echo: {tag: tag, station: MORE}"),
        ("told:  {from: server, echo: [function]}", "told:  {from: server, echo: {function: MORE}}"),
    ],
)
def test_a_reply_that_repeats_what_a_variable_makes_of_it_takes_the_long_way(echo: str, whose: str) -> None:
    field = "station" if "station" in echo else "function"
    pair = Pair(changed((echo, whose.replace("MORE", f"'{field} if number < 5 else 9'"))))
    assert pair.read(*[with_values()] * 8) == [True] * 4 + [False] * 4
    assert pair.same is None


@pytest.mark.parametrize("check", ["sum8, verify: warn", "sum8, as: hex"])
def test_a_check_code_that_is_not_the_last_word_teaches_nothing(check: str) -> None:
    pair = Pair(changed((TOLD, f"{TOLD}, {{check: {check}}}")))
    code = (lambda asked: b"%02X" % (sum(with_values()(asked)) & 0xFF)) if "hex" in check else (lambda _: b"\0")
    assert pair.read(*[lambda asked: with_values()(asked) + code(asked)] * 2) == [True, True]
    assert pair.same is None


def test_a_check_code_before_the_end_teaches_nothing() -> None:
    pair = Pair(changed((TOLD, f"{TOLD}, {{check: sum8}}, {{const: 03}}")))
    good = _followed(b"\3", _with_sum(with_values()))
    assert pair.read(good, good, _followed(b"\0\3", OTHER), _followed(b"\3", _with_sum(OTHER))) == [
        True, True, False, True,
    ]  # fmt: skip
    assert pair.same is None


def test_a_check_code_in_the_frame_inside_teaches_nothing() -> None:
    pair = Pair(changed((VALUES, "{data: values, size: 4}, {check: sum8, over: [values]}")))

    def answer(values: bytes, code: int) -> Reply:
        return lambda asked: asked[:3] + b"\6\3" + values + bytes([code])

    assert pair.read(answer(b"\0\1\0\2", 3), answer(b"\0\1\0\2", 3), answer(b"\0\1\0\3", 3)) == [True, True, False]
    assert pair.same is None


def test_nothing_is_learned_where_a_byte_of_the_data_could_be_the_end() -> None:
    group = (
        "  line: {from: server, head: [{field: tag, type: u16}, {field: station, type: u8}], tail: [{const: 0D}], "
        "delimited: yes, echo: [tag, station]}\nframes:\n"
    )
    text = changed(("frames:\n", group), (f"{{from: server, echo: [tag, station], body: [{TOLD}]}}", "XX"))
    pair = Pair(text.replace("XX", "{group: line, body: [{inner: pdu, of: told}]}"))
    assert pair.read(_line(b"\0\1\0\2"), _line(b"\0\1\0\2")) == [True, True]
    assert pair.same is None
    assert pair.read(_line(b"\r123"), _line(b"abc\r"), _line(b"abcd")) == [False, False, True]


def test_nothing_is_learned_where_the_data_reach_to_a_constant() -> None:
    text = changed(
        ("{length: n, type: u8, of: [values]}, {data: values, size: n}", "{data: values, size: rest}, {const: 0D}"),
        text=FLAT,
    )
    pair = Pair(text)

    def answer(values: bytes) -> Reply:
        return lambda asked: asked[:3] + values + b"\r"

    assert pair.read(answer(b"\0\1\0\2"), answer(b"\0\1\0\2"), answer(b"\r123"), answer(b"abcd")) == [
        True, True, False, True,
    ]  # fmt: skip
    assert pair.same is None


def test_nothing_is_learned_where_something_longer_every_time_stands_before_the_number() -> None:
    pair = Pair(
        changed(
            (ASKED, f"{{length: m, type: u8, of: [cookie]}}, {{data: cookie, size: m}}, {ASKED}"),
            ("{number: {type: u16}}", "{number: {type: u16}, cookie: {type: bytes}}"),
            ("{number: number + 1}", "{number: number + 1, cookie: \"cookie + h'0009'\"}"),
            ("{ask: {tag:", "{ask: {cookie: cookie, tag:"),
        )
    )

    def answer(asked: bytes) -> bytes:
        at = 1 + asked[0]
        return asked[at : at + 3] + b"\5\3\0\1\0\2"

    def of_before(asked: bytes) -> bytes:
        return b"\0\x09" + answer(asked)[2:]

    assert pair.read(answer, answer, of_before, of_before, answer) == [True, True, False, False, True]
    assert pair.same is None


# ---- at random ------------------------------------------------------------------------------------------------------

USUAL: dict[str, tuple[str, Callable[[bytes], Reply]]] = {
    "a frame in a frame": (READS, with_values),
    "one frame": (FLAT, _flat),
    "a check code": (changed((TOLD, f"{TOLD}, {{check: sum8}}")), lambda values: _with_sum(with_values(values))),
    "a table of values": (
        changed((TOLD, f"{TOLD}, {{field: state, type: u8, values: {{0: good, 1: fair}}, only: values}}")),
        lambda values: _followed(b"\0", with_values(values)),
    ),
    "bits": (
        changed((TOLD, f"{TOLD}, {{bits: {{low: 0-3, high: 4-7}}, of: u8}}")),
        lambda values: _followed(b"\x12", with_values(values)),
    ),
}
TELLING = bytes.fromhex("00 01 02 03 04 05 0D 10 7F 80 83 FF")


def _spoiled(reply: bytes, kind: str, at: int, byte: int) -> bytes:
    match kind:
        case "changed":
            return reply[:at] + bytes([byte]) + reply[at + 1 :]
        case "more":
            return reply[:at] + bytes([byte]) + reply[at:]
        case "less":
            return reply[:at] + reply[at + 1 :]
        case "twice":
            return 2 * reply
    return reply


@pytest.mark.parametrize("what", USUAL)
@pytest.mark.parametrize("seed", range(3))
def test_whatever_comes_both_ways_judge_alike(what: str, seed: int) -> None:
    text, usual = USUAL[what]
    chance, pair = random.Random(seed), Pair(text)
    pair.read(usual(b"\0\1\0\2"), usual(b"\0\1\0\2"))
    assert pair.same is not None
    ended: list[bool] = []
    for _ in range(60):
        values = bytes(chance.choice(TELLING) for _ in range(chance.choice((4, 4, 4, 4, 6))))
        kind = chance.choice(("good", "good", "changed", "changed", "more", "less", "twice"))
        place, byte = chance.random(), chance.choice(TELLING)

        def reply(
            asked: bytes, values: bytes = values, kind: str = kind, place: float = place, byte: int = byte
        ) -> bytes:
            whole = usual(values)(asked)
            return _spoiled(whole, kind, int(place * len(whole)), byte)

        ended += pair.read(reply)
    assert {True, False} == set(ended)

"""The client: requests of a transfer, evaluation of replies, and refused transfers."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link.service_loop import Loop

from framekit.link.addresses import AddressError
from framekit.link.events import Outcome, ServiceDone
from framekit.link.packing import PackingError
from framekit.link.services.client import ServiceError
from framekit.link.values import FrameValue

WORDS = """
protocol: words
station: {type: number, default: 9}
order: big
params: {most: {type: number, default: 8}}
groups:
  request: {from: client, head: [{field: station, type: u8}]}
  reply: {from: server, echo: [station], head: [{field: station, type: u8}]}
frames:
  read:  {group: request, body: [{field: f, type: u8, is: 1}, {field: code, type: u8}, {field: start, type: u16}, {field: bytes, type: u8}]}
  write: {group: request, body: [{field: f, type: u8, is: 2}, {field: code, type: u8}, {field: start, type: u16}, {length: bytes, type: u8, of: [data]}, {data: data, size: bytes}]}
  pick:  {group: request, body: [{field: f, type: u8, is: 3}, {field: what, type: u8, values: {1: one, 2: two}}, {field: size, type: u8}]}
  data:  {group: reply, body: [{field: f, type: u8, is: 1}, {length: bytes, type: u8, of: [data]}, {data: data, size: bytes}]}
  done:  {group: reply, body: [{field: f, type: u8, is: 2}]}
  picked: {group: reply, body: [{field: f, type: u8, is: 3}, {data: data, size: 4, pad: 00}]}
  no:    {group: reply, body: [{field: f, type: u8, is: 0x80}, {field: code, type: u8, values: {1: odd}}]}
layouts:
  pair: [{field: low, type: u8}, {field: high, type: u8}]
tables:
  reasons: {1: unknown area, 2: beyond the area, 3: read only, 4: no such service, 9: odd address}
areas:
  D: {unit: word, size: 100, code: 1}
  C: {unit: bit, size: 64, code: 2}
addresses:
  - {form: "{area}{start:dec}"}
errors:
  frame: "no"
  code: code
  names: reasons
  answer: {"no": {code: code}}
  memory: {unknown: 1, range: 2, access: 3, no_service: 4}
services:
  read:
    - areas: [D]
      limit: {bytes: most}
      request: {read: {station: station, code: code, start: start, bytes: bytes}}
      reply: {data: {data: data}}
      packing: {order: big}
    - areas: [C]
      limit: {bytes: 2}
      align: {bits: 8}
      request: {read: {station: station, code: code, start: start, bytes: bytes}}
      reply: {data: {data: data}}
  write:
    - name: words
      areas: [D]
      limit: {bytes: most}
      request: {write: {station: station, code: code, start: start, data: data}}
      reply: {done: {}}
      refuse: [{when: "request.start == 13", code: 9}]
      packing: {order: big}
    - areas: [C]
      align: {bits: 8}
      request: {write: {station: station, code: code, start: start, data: data}}
      reply: {done: {}}
  pick:
    - name: one
      takes: {what: {type: text}, size: {type: number, default: 2, range: 1..4}}
      when: what == 'one'
      request: {pick: {station: station, what: what, size: size}}
      gives: {pair: {pair: reply.data}, size: request.size}
      reply: {picked: {data: "h'01 02'"}}
    - name: other
      takes: {what: {type: text}, size: {type: number, default: 2, range: 1..4}}
      request: {pick: {station: station, what: what, size: size}}
      reply: {picked: {data: "h'0A 0B 0C 0D'"}}
"""  # noqa: E501


def words(**params: Any) -> Loop:
    return Loop(WORDS, params=params)


# ---- limits, alignment, units ---------------------------------------------------------------------------------------


def test_transfers_beyond_the_limit_are_cut_into_whole_units_and_joined() -> None:
    loop = words()
    loop.memory.write("D", "word", 0, range(100))
    result = loop.do("read", "D3", count=11)
    assert result.ok and result.values == list(range(3, 14)) and result.exchanges == 3
    assert [raw[3:6] for raw in loop.requests] == [b"\0\3\x08", b"\0\7\x08", b"\0\x0b\6"]
    assert result.data == b"".join(value.to_bytes(2, "little") for value in range(3, 14))


def test_the_limit_counts_whole_units_only() -> None:
    loop = words(most=7)
    assert loop.do("read", "D0", count=4).exchanges == 2
    with pytest.raises(ServiceError, match="not even one word"):
        words(most=1).do("read", "D0")


def test_a_part_that_fails_fails_the_whole_and_says_what_was_written() -> None:
    loop = words()
    result = loop.do("write", "D5", range(20))
    assert not result.ok and (result.outcome, result.code, result.meaning) == ("refused", 9, "odd address")
    assert (result.exchanges, result.written, result.values) == (3, 8, [])
    assert loop.memory.read("D", "word", 5, 12) == [*range(8), 0, 0, 0, 0]


def test_a_read_that_fails_gives_nothing() -> None:
    loop = words()
    loop.outcomes = []
    loop.memory.write("D", "word", 0, range(100))
    first = loop.serve
    loop.serve = lambda *a, **k: first(*a, **k) if len(loop.log) < 1 else first(FrameValue("x", {"station": 1}), b"")  # type: ignore[method-assign]
    result = loop.do("read", "D0", count=6)
    assert not result.ok and result.values == [] and result.data == b"" and result.exchanges == 2
    assert result.code == 4 and result.meaning == "no such service"


def test_a_read_is_widened_to_what_the_row_aligns_to_and_cut() -> None:
    loop = words()
    loop.memory.write("C", "bit", 0, [0, 0, 0, 1, 0, 1, 1, 0] * 8)
    result = loop.do("read", "C3", count=20)
    assert result.values == ([0, 0, 0, 1, 0, 1, 1, 0] * 8)[3:23] and result.exchanges == 2
    assert [raw[3:6] for raw in loop.requests] == [b"\0\0\2", b"\0\x10\1"]


def test_a_write_that_is_not_aligned_finds_no_row() -> None:
    with pytest.raises(ServiceError, match="no request can write 3 × bit from C3"):
        words().do("write", "C3", [1, 0, 1])
    assert words().do("write", "C8", [1] * 8).ok


@pytest.mark.parametrize(
    ("unit", "address", "values"),
    [
        ("dword", "D4", [0x11223344, 5]),
        ("dword", "D5", [0x11223344]),
        ("lword", "D3", [1 << 63]),
        ("byte", "D6", [1, 2, 3, 4]),
    ],
)
def test_units_the_area_does_not_have_are_carried_in_its_own(unit: str, address: str, values: list[int]) -> None:
    loop = words()
    assert loop.do("write", address, values, unit=unit).ok
    assert loop.do("read", address, unit=unit, count=len(values)).values == values
    low_word_first = values[0] & 0xFFFF if unit != "byte" else 0x0201
    assert loop.memory.read("D", "word", int(address[1:]))[0] == low_word_first


def test_part_of_a_unit_can_be_read_but_not_written() -> None:
    loop = words()
    loop.memory.write("D", "word", 2, [0x8001])
    assert loop.do("read", "D2", unit="bit", count=17).values == [1] + [0] * 14 + [1, 0]
    with pytest.raises(ServiceError, match="no request can write"):
        loop.do("write", "D2", [1], unit="bit")


@given(st.integers(0, 90), st.data())
@settings(max_examples=60)
def test_bits_and_words_read_as_they_were_written(start: int, data: st.DataObject) -> None:
    loop = words(most=data.draw(st.integers(2, 20)))
    values = data.draw(st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=100 - start))
    assert loop.do("write", f"D{start}" if start != 13 else "D12", values[:1]).ok
    if not start <= 13 < start + len(values):
        assert loop.do("write", f"D{start}", values).written == len(values)
        assert loop.do("read", f"D{start}", count=len(values)).values == values


# ---- lists of variables ----------------------------------------------------------------------------------------------


def test_bits_of_the_ascii_protocol_go_as_lists_of_sixteen() -> None:
    loop = Loop("mldp")
    bits = [1, 0, 1, 1] * 5
    assert loop.do("write", "%MX4", bits).exchanges == 2
    result = loop.do("read", "M00004", count=20)
    assert result.values == bits and result.exchanges == 2
    assert loop.requests[2].startswith(b"\x0501rSS10" + b"04%MX404%MX5")


def test_variables_go_together_as_long_as_their_unit_is_the_same() -> None:
    loop = Loop("mldp")
    addresses = ["M100", "%PW5", "D7", "%MD3", "%MD4", "M00003"]
    assert loop.do("write_variables", addresses, [1, 2, 3, 4, 5, 1]).written == 6
    result = loop.do("read_variables", addresses)
    assert result.values == [1, 2, 3, 4, 5, 1] and result.exchanges == 3
    assert loop.requests[3].startswith(b"\x0501rSS03" + b"06%MW100" + b"04%PW5")


def test_a_list_is_cut_where_its_bytes_are_too_many() -> None:
    loop = Loop("mldp", params={"max_bytes": 60})
    addresses = [f"%ML{place}" for place in range(16)]
    assert loop.do("write_variables", addresses, range(16)).exchanges == 3
    assert loop.do("read_variables", addresses).values == list(range(16))
    assert [raw[6:8] for raw in loop.requests] == [b"07", b"07", b"02"] * 2


def test_protocols_without_lists_take_variables_one_by_one() -> None:
    loop = Loop("modbus-rtu")
    addresses = ["40001", "40010", "00003"]
    assert loop.do("write_variables", addresses, [7, 8, 1]).exchanges == 3
    result = loop.do("read_variables", addresses)
    assert result.values == [7, 8, 1] and result.exchanges == 3
    assert [raw[0] for raw in loop.requests] == [6, 6, 5, 3, 3, 1]


def test_variables_in_another_unit_than_the_addresses_say() -> None:
    loop = Loop("mldp")
    loop.memory.write("M", "word", 10, [0x1122, 0x3344])
    assert loop.do("read_variables", ["M10", "M00100"], unit="dword").values == [0x33441122, 0x33441122]


def test_as_many_values_as_addresses() -> None:
    with pytest.raises(ServiceError, match="2 addresses for 1 values"):
        Loop("mldp").do("write_variables", ["M1", "M2"], [1])


# ---- the guide's numbers ---------------------------------------------------------------------------------------------


def test_modbus_limits_single_writes_and_functions() -> None:
    loop = Loop("modbus-rtu", params={"limit_write_words": 120})
    loop.do("write", "40001", [5])
    loop.do("write", "00005", [1])
    loop.do("write", "40001", range(130))
    loop.do("write", "00001", [1, 0, 1])
    loop.do("read", "10005", count=2001)
    assert [raw[0] for raw in loop.requests] == [6, 5, 16, 16, 15, 2, 2]
    assert loop.requests[0] == b"\6\0\0\0\5" and loop.requests[1] == b"\5\0\4\xff\0"
    assert loop.requests[4] == b"\x0f\0\0\0\3\1\5"
    assert [int.from_bytes(raw[3:5]) for raw in (*loop.requests[2:4], *loop.requests[5:])] == [120, 10, 2000, 1]


def test_modbus_without_single_writes() -> None:
    loop = Loop("modbus-rtu", params={"single_writes": 0})
    loop.do("write", "40001", [5])
    assert loop.requests[0][0] == 16


def test_input_points_as_words_of_the_own_memory() -> None:
    loop = Loop("modbus-rtu")
    loop.memory.write("input", "word", 0, [0x1234, 0x5678])
    assert loop.do("read", "10001", unit="word", count=2).values == [0x1234, 0x5678]
    assert loop.do("read", "10005", unit="word").values == [0x8123]
    assert loop.requests == [b"\2\0\0\0\x20", b"\2\0\4\0\x10"]


# ---- replies ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("data", [b"\0\1", b"\0\1\0\2\0\3", b"", b"\0\1\0"])
def test_a_reply_with_another_number_of_bytes_is_a_failure(data: bytes) -> None:
    loop = words()
    loop.damage = lambda reply: FrameValue(reply.frame, {**reply.fields, "data": data})
    result = loop.do("read", "D0", count=2)
    assert not result.ok and result.outcome == "unfit_reply" and result.values == []
    assert f"take 4 bytes, not {len(data)}" in result.cause


@pytest.mark.parametrize("blocks", [0, 1, 3])
def test_a_reply_with_another_number_of_blocks_is_a_failure(blocks: int) -> None:
    loop = Loop("mldp")
    loop.damage = lambda reply: FrameValue(reply.frame, {**reply.fields, "values": [{"data": b"\0\1"}] * blocks})
    result = loop.do("read_variables", ["M1", "M2"])
    assert not result.ok and result.outcome == "unfit_reply" and result.values == []


def test_a_continuous_reply_has_one_block() -> None:
    loop = Loop("mldp")
    loop.damage = lambda reply: FrameValue(
        reply.frame, {**reply.fields, "values": [{"data": b"\0\1"}, {"data": b"\0\2"}]}
    )
    assert loop.do("read", "M1", count=2).cause == "the reply has 2 blocks, not 1"


def test_both_forms_of_a_reply_are_accepted() -> None:
    for blocks_field in (0, 1):
        loop = Loop("mldp", params={"blocks_field": blocks_field})
        loop.memory.write("M", "word", 5, [77])
        assert loop.do("read", "M5").values == [77]
        assert loop.log[0][2].reply is not None
        assert loop.log[0][2].reply.frame == ("read_continuous_reply" if blocks_field else "read_continuous_short")


def test_a_reply_of_another_service_is_a_failure() -> None:
    loop = words()
    loop.outcomes = [Outcome(True, reply=FrameValue("done", {"station": 1}))]
    result = loop.do("read", "D0")
    assert (result.ok, result.outcome, result.cause) == (False, "unfit_reply", "'done' is no reply to 'read 1'")


def test_a_read_without_a_reply_is_a_failure_and_a_write_is_not() -> None:
    loop = words()
    loop.outcomes = [Outcome(True), Outcome(True)]
    assert loop.do("read", "D0").outcome == "unfit_reply"
    result = loop.do("write", "D0", [1])
    assert result.ok and result.written == 1


def test_what_the_sequence_failed_with_is_handed_on() -> None:
    loop = words()
    loop.outcomes = [Outcome(False, "no_reply", "nothing came in time")]
    result = loop.do("read", "D0")
    assert (result.ok, result.outcome, result.cause, result.exchanges) == (False, "no_reply", "nothing came in time", 1)


def test_a_refusal_that_ends_a_sequence_keeps_its_code() -> None:
    loop = words()
    loop.outcomes = [Outcome(False, "fatal", reply=FrameValue("no", {"code": 9}))]
    result = loop.do("read", "D0")
    assert (result.outcome, result.code, result.meaning) == ("fatal", 9, "odd address")


def test_a_code_without_a_name_is_still_told() -> None:
    loop = words()
    loop.outcomes = [Outcome(True, reply=FrameValue("no", {"code": 77}))]
    result = loop.do("read", "D0")
    assert (result.outcome, result.code, result.meaning) == ("refused", 77, "")


# ---- stations, arguments ---------------------------------------------------------------------------------------------


def test_the_station_stands_in_the_request_or_its_default_does() -> None:
    loop = words()
    loop.do("read", "D0", station=5)
    loop.do("read", "D0", station=None)
    assert [raw[0] for raw in loop.requests] == [5, 9]


def test_names_of_one_transfer_go_before_parameters() -> None:
    loop = words()
    assert loop.do("read", "D0", count=4, params={"most": 2}).exchanges == 4
    assert loop.do("read", "D0", count=4).exchanges == 1


def test_calls_choose_their_row_by_arguments_and_give_results() -> None:
    loop = words()
    result = loop.do("call", "pick", {"what": "one"})
    assert result.gives == {"pair": {"low": 1, "high": 2}, "size": 2}
    other = loop.do("call", "pick", {"what": "two", "size": 4})
    assert other.gives == {} and other.reply is not None and other.reply.fields["data"] == b"\n\x0b\x0c\r"
    assert loop.requests == [b"\1\3\1\2", b"\1\3\2\4"]


@pytest.mark.parametrize(
    ("service", "arguments", "says"),
    [
        ("pick", {}, "'pick' needs the argument 'what'"),
        ("pick", {"sise": 2}, "needs the argument 'what'; 'pick' takes no argument 'sise' – did you mean 'size'"),
        (
            "pick",
            {"sise": 2, "wat": 1, "size": 9},
            "'pick': argument 'size': 9 is not in 1..4; 'pick' needs the argument 'what'; "
            "'pick' takes no arguments 'sise' and 'wat' – known: what, size",
        ),
        ("pick", {"what": "one", "sise": 2}, "takes no argument 'sise' – did you mean 'size'"),
        ("pick", {"what": "one", "size": 9}, "argument 'size': 9 is not in 1..4"),
        ("pick", {"what": 3}, "argument 'what': 3 is not a text"),
        ("read", {}, "there is no service 'read' to call – known: pick"),
        ("pik", {}, "there is no service 'pik'"),
    ],
)
def test_calls_that_cannot_be_made_say_why(service: str, arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(ServiceError) as error:
        words().do("call", service, arguments)
    assert says in str(error.value)


def test_monitors_are_registered_by_address_and_run() -> None:
    loop = Loop("mldp")
    loop.memory.write("M", "word", 0, [0x2342, 7, 8])
    assert loop.do("call", "register_monitor", {"register": 1}, addresses=["M0"]).ok
    assert loop.do("call", "register_monitor", {"register": 2}, addresses=["M0"], count=3).ok
    assert loop.do("call", "register_monitor", {"register": 3}, addresses=["M1", "M0"]).ok
    assert loop.requests[0].startswith(b"\x0501x01RSS01" + b"04%MW0")
    assert loop.requests[1].startswith(b"\x0501x02RSB" + b"04%MW003")
    found = [loop.do("call", "run_monitor", {"register": number}).gives["values"] for number in (1, 2, 3)]
    assert found == [[b"\x23\x42"], [b"\x23\x42\0\7\0\x08"], [b"\0\7", b"\x23\x42"]]
    with pytest.raises(ServiceError, match="fits these arguments and no address"):
        loop.do("call", "register_monitor", {"register": 1})
    with pytest.raises(ServiceError, match="at most 16"):
        loop.do("call", "register_monitor", {"register": 1}, addresses=["M0"] * 17)


class RecordedOutcomes(ServiceDone):
    """An `ask` step that records its outcomes."""

    def __init__(self) -> None:
        self.params: dict[str, Any] = {}
        self.outcomes: list[Outcome] = []

    def __call__(self, outcome: Outcome) -> None:
        self.outcomes.append(outcome)


def test_asked_for_by_a_sequence_a_refusal_is_a_failure() -> None:
    loop = Loop("mldp")
    noted = RecordedOutcomes()
    loop.client.ask("run_monitor", {"register": 4}, 1, noted)
    assert [(outcome.ok, outcome.outcome, outcome.cause) for outcome in noted.outcomes] == [
        (False, "refused", "run of an unregistered monitor")
    ]


# ---- what is refused before anything is sent -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "arguments", "options", "error"),
    [
        ("read", ("X5",), {}, AddressError),
        ("read", ("D100",), {}, AddressError),
        ("read", ("D99",), {"count": 2}, AddressError),
        ("read", ("D0",), {"count": 0}, ServiceError),
        ("write", ("D0", []), {}, ServiceError),
        ("write", ("D0", [65536]), {}, PackingError),
        ("write", ("C0", [2] * 8), {}, PackingError),
        ("read", ("D0",), {"unit": "page"}, ValueError),
    ],
)
def test_what_cannot_be_asked_is_refused_at_once(
    method: str, arguments: tuple[Any, ...], options: dict[str, Any], error: type[Exception]
) -> None:
    loop = words()
    with pytest.raises(error):
        loop.do(method, *arguments, **options)
    assert loop.log == []


def test_an_area_without_a_write_row_is_refused_at_once() -> None:
    with pytest.raises(ServiceError, match="30010 is in area input_register, which can only be read"):
        Loop("modbus-rtu").do("write", "30010", [1])

"""The record of a list that has a value in one of its fields: in services, for clients and devices."""

from __future__ import annotations

import pytest
from link.service_loop import Loop

TABLE = """\
protocol: table
station: {type: none}
line: {kind: stream, tcp: 4000}
extends: standard
groups: {request: {from: client}, reply: {from: server}}
frames:
  PUT:
    group: request
    body:
      - {const: 01}
      - {field: wanted, type: u8}
      - {count: n, type: u8, of: items}
      - {repeat: items, times: n, of: [{field: id, type: u8}, {field: v, type: u16}]}
  TOLD: {group: reply, body: [{const: 02}, {field: v, type: u16}, {field: last, type: u16}]}
services:
  put:
    - takes: {id: {type: number}, items: {type: list}}
      request: {PUT: {wanted: id, items: items}}
      refuse: [{when: "request.wanted not in request.items.id", code: 4}]
      reply:
        TOLD:
          v: "request.items[find(request.items.id, request.wanted)].v"
          last: "request.items[find_last(request.items.id, request.wanted)].v"
      gives: {v: reply.v, last: reply.last, own: "request.items[find(request.items.id, id)].v"}
"""
ITEMS = [{"id": 1, "v": 500}, {"id": 3, "v": 700}, {"id": 9, "v": 8}, {"id": 3, "v": 701}]


@pytest.mark.parametrize(("wanted", "first", "last"), [(1, 500, 500), (3, 700, 701), (9, 8, 8)])
def test_the_item_with_that_field(wanted: int, first: int, last: int) -> None:
    loop = Loop(TABLE)
    result = loop.do("call", "put", {"id": wanted, "items": ITEMS})
    assert result.ok, result.cause
    assert result.gives == {"v": first, "last": last, "own": first}


def test_where_no_item_has_it_the_device_refuses() -> None:
    loop = Loop(TABLE)
    served = loop.serve(loop.request(bytes.fromhex("01 04 01 03 00 07")))
    assert (served.refusal, loop.troubles) == (4, [])


def test_an_item_that_is_not_there_is_nothing() -> None:
    """The result of a missing item is absent; `either` replaces an absent value."""
    text = TABLE.replace('      refuse: [{when: "request.wanted not in request.items.id", code: 4}]\n', "")
    none = 'none: "request.items[find(request.items.id, 77)].v"'
    text = text.replace("gives: {v: reply.v, ", f"gives: {{v: reply.v, {none}, ")
    text = text.replace("find(request.items.id, request.wanted)].v", "find(request.items.id, request.wanted)].v, 5)")
    text = text.replace('v: "request.items', 'v: "either(request.items')
    loop = Loop(text)
    result = loop.do("call", "put", {"id": 3, "items": ITEMS})
    assert result.ok, result.cause
    assert result.gives == {"v": 700, "none": None, "last": 701, "own": 700}
    served = loop.serve(loop.request(bytes.fromhex("01 04 01 04 00 07")))
    assert served.reply is not None and served.reply.fields["v"] == 7
    served = loop.serve(loop.request(bytes.fromhex("01 04 01 03 00 07")))
    assert served.reply is not None and served.reply.fields["v"] == 5

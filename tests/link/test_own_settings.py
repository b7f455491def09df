"""The requests that a server accepts by their parameters: padded values, defaults, secrets, refusals."""

from __future__ import annotations

import pytest
from link.test_own_station import answers

SETTINGS = """\
protocol: settings
extends: standard
station: {type: number, range: 0..9, default: 1}
params:
  id: {type: bytes, default: 01}
  title: {type: text, default: "'ab'"}
  net: {type: number, default: 7}
  version: {type: number, default: 3}
  password: {type: bytes, secret: yes}
groups:
  request: {from: client, head: [{const: 55}, {field: station, type: u8}]}
  reply: {from: server}
frames:
  by_id: {group: request, body: [{const: 01}, {data: id, size: 4, pad: "00"}]}
  by_title: {group: request, body: [{const: 02}, {field: title, type: ascii, size: 4, pad: 20}]}
  by_net: {group: request, body: [{const: 03}, {field: net, type: u8, default: net}]}
  by_version: {group: request, body: [{const: 04}, {field: version, type: u8}]}
  by_password: {group: request, body: [{const: 05}, {data: password, size: 2}]}
  done: {group: reply, body: [{const: 06}]}
  no: {group: reply, body: [{const: 15}, {field: code, type: u8}]}
errors: {frame: no, code: code, answer: {no: {code: code}}}
services:
  by_id: [{request: {by_id: {station: station, id: id}}, reply: {done: {}}}]
  by_title: [{request: {by_title: {station: station, title: title}}, reply: {done: {}}}]
  by_net: [{request: {by_net: {station: station}}, reply: {done: {}}}]
  by_version:
    - {request: {by_version: {station: station, version: version}}, reply: {done: {}},
       refuse: [{when: request.version != version, code: 7}]}
  by_password: [{request: {by_password: {station: station, password: password}}, reply: {done: {}}}]
"""


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        ("01 01 00 00 00", "06"),
        ("01 01 00 00 01", ""),
        ("01 02 00 00 00", ""),
        ("02 61 62 20 20", "06"),
        ("02 61 62 63 20", ""),
        ("03 07", "06"),
        ("03 08", ""),
        ("04 03", "06"),
        ("04 04", "15 07"),
        ("05 01 02", "06"),
    ],
)
@pytest.mark.parametrize("title", ["'ab'", "'ab  '"])
def test_a_device_takes_what_its_own_client_sends(request_: str, reply: str, title: str) -> None:
    text = SETTINGS.replace("\"'ab'\"", f'"{title}"')
    assert b"".join(answers(text, f"55 01 {request_}", own=1)).hex(" ") == reply

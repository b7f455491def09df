"""The name under which a bad frame is reported if it may be one of several frames."""

from __future__ import annotations

from link_world import feed, receiver_of

GROUP = """
protocol: p
groups:
  any:
    head:
      - {field: sync, type: u8, default: 0xC8, values: {0xC8: fc}, only: values}
      - {length: n, type: u8, of: [type, body], plus: 1}
      - {field: type, type: u8}
    tail: [{check: sum8, over: type..here}]
frames:
  mode: {group: any, where: {type: 0x21}, body: [{field: mode, type: ascii, end: 00}]}
  pair: {group: any, where: {type: 0x22}, body: [{field: a, type: u8}, {field: b, type: u8}]}
  other: {group: any, body: [{data: d, size: n - 2}]}
receiver: {gap: 50 ms}
"""


def test_a_wrong_check_code_is_that_of_the_frame_of_which_nothing_else_is_wrong() -> None:
    """The frame whose `where` does not fit also has a wrong check code, at another offset or at the same."""
    for data in (bytes.fromhex("C8 05 7F 01 02 03 04 05 06 00 77"), bytes.fromhex("C8 04 7F 01 02 77")):
        found = feed(receiver_of(GROUP), [data], ("mode", "pair", "other"))
        assert found[0][:3] == ("bad", "other", "check")

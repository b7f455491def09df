"""Definitions drawn at random, and definitions that once failed: accepted definitions never crash and round-trip."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from itertools import combinations_with_replacement
from pathlib import Path
from random import Random
from typing import Any

import pytest
from definition_trial import Trial
from drawn_definitions import DRAWN, DrawnDefinition
from spread import many, spread

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError

FOUND: dict[str, tuple[str, dict[str, Any], str]] = {
    "a check code behind data, over what comes later": (
        "[{length: n, type: u8, of: [x]}, {length: m, type: u8, of: [d]}, {data: x, size: n},"
        " {check: sum8, over: [d, m]}, {data: d, size: m}]",
        {"x": b"a", "d": b"bc"},
        "01 02 61 C7 62 63",
    ),
    "a check over what fills a frame up, and bytes that are not on the wire": (
        "[{field: v, type: u8, when: k}, {data: d, size: 1}], size: 7, fill: 2A, group: filled_and_more",
        {"k": 0, "d": b"x"},
        "00 78 2A 2A 2A 2A 23",
    ),
    "a frame inside called line, which hides the line": (
        "[{inner: line, of: [counted]}, {value: v, read: len(line.counted.r)}, {field: a, type: u8}]",
        {"line": {"counted": {"r": [7]}}, "a": 9},
        "31 37 09",
    ),
    "a check over a check in digits: it is worked out once, on what stood before it": (
        "[{field: f, type: u8}, {include: digits, as: r}, {check: sum16, size: 4, name: s}, {field: a, type: u8},"
        " {check: crc8, over: r..a}]",
        {"f": 2, "r": {}, "a": 1},
        "02 30 32 00 00 00 64 01 23",
    ),
    "a check over a list whose items hold digits: the list counts as it stands": (
        "[{count: n, type: u8, of: r}, {repeat: r, times: n, of: [{field: k, type: u8},"
        " {wrap: hex, of: [{field: b, type: u8}]}]}, {check: sum8, over: r..here}]",
        {"r": [{"k": 1, "b": 1}, {"k": 2, "b": 1}]},
        "02 01 30 31 02 30 31 C5",
    ),
    "a count of items in a case": (
        "[{field: k, type: u8}, {count: c, type: u8, of: xs}, "
        "{choose: k, cases: {1: [{repeat: xs, times: 2, of: u8}]}, else: []}]",
        {"k": 1, "xs": [5, 6]},
        "01 02 05 06",
    ),
    "a count of items in an optional part": (
        "[{count: c, type: u8, of: xs}, {optional: [{repeat: xs, times: 2, of: u8}]}]",
        {"xs": [5, 6]},
        "02 05 06",
    ),
    "a value in the range of a check takes no bytes": (
        "[{field: w, type: u8}, {value: a, read: w}, {field: v, type: u8}, {check: sum8, over: w..here}]",
        {"w": 5, "v": 6},
        "05 06 0B",
    ),
    "a record in a case": (
        "[{field: k, type: u8}, {choose: k, cases: {0: [{include: hop, as: d1}]}, else: []}, {const: 7E}]",
        {"k": 0, "d1": {"a": 3}},
        "00 03 7E",
    ),
    "a record in a case that is not taken": (
        "[{field: k, type: u8}, {choose: k, cases: {0: [{include: hop, as: d1}]}, else: []}, {const: 7E}]",
        {"k": 1},
        "01 7E",
    ),
    "a record in an optional part": (
        "[{field: k, type: u8}, {optional: [{include: hop, as: d1}]}, {const: 7E}]",
        {"k": 1, "d1": {"a": 3}},
        "01 03 7E",
    ),
    "a condition on a field of a record": (
        "[{include: hop, as: h}, {field: b, type: u8, when: h.a == 0}, {const: 7E}]",
        {"h": {"a": 0}, "b": 5},
        "00 05 7E",
    ),
    "a condition on a field of a record that is not there": (
        "[{field: k, type: u8}, {include: hop, as: h, when: k}, {field: b, type: u8, when: k and h.a == 0}]",
        {"k": 0},
        "00",
    ),
    "a condition on a record in an item": (
        "[{repeat: xs, times: 2, of: [{include: hop, as: h}]}, {field: b, type: u8, when: 'xs[0].h.a'}, {const: 7E}]",
        {"xs": [{"h": {"a": 1}}, {"h": {"a": 0}}], "b": 5},
        "01 00 05 7E",
    ),
    "a condition on a record in an item that may be without it": (
        "[{field: k, type: u8}, {repeat: xs, times: 2, of: [{field: f, type: u8}, {include: hop, as: h, when: f}]},"
        " {field: b, type: u8, when: 'xs[0].h.a == 3'}, {const: 7E}]",
        {"k": 1, "xs": [{"f": 1, "h": {"a": 3}}, {"f": 0}], "b": 5},
        "01 01 03 00 05 7E",
    ),
    "a condition on what a case of an item holds": (
        "[{repeat: xs, times: 2, of: [{field: f, type: u8},"
        " {choose: f, cases: {1: [{field: a, type: u8}]}, else: []}]}, {field: b, type: u8, when: 'xs[0].a == 3'},"
        " {const: 7E}]",
        {"xs": [{"f": 1, "a": 3}, {"f": 0}], "b": 5},
        "01 03 00 05 7E",
    ),
    "a condition on a record in a wrap in a case": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{wrap: hex, of: [{include: hop, as: h}]}]}, else: []},"
        " {field: b, type: u8, when: h.a == 1}, {const: 7E}]",
        {"k": 2},
        "02 7E",
    ),
    "a size by a record in a record that is not there": (
        "[{field: k, type: u8}, {include: outer, as: r, when: k}, {data: d, size: 'either(r.i.a, 1)'}]",
        {"k": 0, "d": b"x"},
        "00 78",
    ),
    "a condition on a record in a record in a wrap in a case": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{wrap: hex, of: [{include: outer, as: r}]}]}, else: []},"
        " {field: b, type: u8, when: r.i.a == 1}, {const: 7E}]",
        {"k": 2},
        "02 7E",
    ),
    "a length of computed size": (
        "[{field: s, type: u8}, {length: n, type: uint, size: s, of: [d]}, {data: d, size: n}]",
        {"s": 2, "d": b"abc"},
        "02 00 03 61 62 63",
    ),
    "bits of computed size": (
        "[{field: s, type: u8}, {bits: {a: 0-3, b: 12}, of: uint, size: s}, {const: 7E}]",
        {"s": 2, "a": 5, "b": 1},
        "02 10 05 7E",
    ),
    "a range that begins with what is not there begins at its place": (
        "[{field: k, type: u8}, {const: 33, name: c, when: k}, {const: 44}, {check: sum8, over: c..here}]",
        {"k": 0},
        "00 44 44",
    ),
    "a range that begins inside a wrap that is not there": (
        "[{wrap: {escape: DLE}, of: [{field: w, type: u8}], when: 3 > 4}, {const: 10 03},"
        " {check: sum8, over: w..here}]",
        {},
        "10 03 13",
    ),
    "a count of a list that is not there": (
        "[{field: k, type: u8}, {count: n, type: u8, of: r}, {repeat: r, times: rest, of: u8, when: k > 3}]",
        {"k": 0},
        "00 00",
    ),
    "a field that a record leaves out is nothing": (
        "[{field: k, type: u8}, {include: part, as: p}, {require: p.b != 77}]",
        {"k": 0, "p": {"a": 1}},
        "00 01",
    ),
    "nothing is worked out for bits that are not there": (
        "[{field: k, type: u8}, {bits: {x: 0-2, y: 3-5}, of: u8, build: {x: y + 1}, when: k}]",
        {"k": 0},
        "00",
    ),
    "nothing is worked out for a field that is not there": (
        "[{field: k, type: u8}, {field: x, type: u8, when: k}, {field: y, type: u8, is: x + 1, when: k}]",
        {"k": 0},
        "00",
    ),
    "a value that is not there agrees with everything": (
        "[{field: k, type: u8}, {value: v, read: k * 2, build: k + 5, when: k == 2}]",
        {"k": 1},
        "01",
    ),
    "data that are filled up are as long as they must be": (
        "[{field: k, type: u8}, {data: d, size: k // 2, pad: 00, min: 2}]",
        {"k": 5, "d": b"a"},
        "05 61 00",
    ),
    "what an optional part leaves out has no default": (
        "[{field: k, type: u8}, {optional: [{field: x, type: u8, default: 5}]}, {value: v, read: 'either(x, 9)'}]",
        {"k": 5},
        "05",
    ),
    "what is in a hex part goes by a field before it": (
        "[{field: k, type: u8}, {wrap: hex, of: [{field: x, type: u8, when: k > 3}]}, {check: sum8}]",
        {"k": 5, "x": 3},
        "05 30 33 68",
    ),
    "a hex part with nothing in it": (
        "[{field: k, type: u8}, {wrap: hex, of: [{field: x, type: u8, when: k > 3}]}, {check: sum8}]",
        {"k": 1},
        "01 01",
    ),
    "what is in a hex part goes by a field of a record before it": (
        "[{include: hop, as: h}, {wrap: hex, of: [{data: x, size: h.a}]}, {check: sum8}]",
        {"h": {"a": 2}, "x": b"ab"},
        "02 36 31 36 32 D1",
    ),
    "a length counts what data are filled up with": (
        "[{field: k, type: u8}, {length: n, type: u8, of: [d, e]}, {data: d, size: k, pad: 2E}, {data: e, size: rest}]",
        {"k": 3, "d": b"a", "e": b"b"},
        "03 04 61 2E 2E 62",
    ),
    "a length counts what a text is filled up with": (
        "[{field: k, type: u8}, {length: n, type: u8, of: [t, e]}, {field: t, type: ascii, size: k, pad: 2E},"
        " {data: e, size: rest}]",
        {"k": 3, "t": "a", "e": b"b"},
        "03 04 61 2E 2E 62",
    ),
    "data that are filled up have their whole length": (
        "[{field: k, type: u8}, {data: d, size: k, pad: 2E}, {field: n, type: u8, is: len(d)}]",
        {"k": 3, "d": b"a"},
        "03 61 2E 2E 03",
    ),
    "a check in an item covers its own item": (
        "[{count: n, type: u8, of: r},"
        " {repeat: r, times: n, of: [{field: a, type: u8}, {check: sum8, over: a..here}]}]",
        {"r": [{"a": 3}, {"a": 4}]},
        "02 03 03 04 04",
    ),
    "a check over digits covers what they stand for": (
        "[{wrap: hex, of: [{bits: {a: 0-2}, of: oct, size: 3}], name: w}, {check: sum8, over: [w]}]",
        {"a": 6},
        "33 30 33 30 33 36 96",
    ),
    "a check over an optional part": (
        "[{optional: [{field: a, type: u8}, {field: b, type: u8}], name: o}, {check: sum8, over: [o]}]",
        {"a": 3, "b": 4},
        "03 04 07",
    ),
    "an optional part that is not there adds nothing to a check": (
        "[{field: k, type: u8}, {optional: [{field: a, type: u8}], name: o}, {check: sum8, over: [k, o]}]",
        {"k": 9},
        "09 09",
    ),
    "a list that is not there is nothing": (
        "[{field: k, type: u8}, {repeat: r, times: 2, of: u8, when: k}, {value: v, read: r == none()}]",
        {"k": 0},
        "00",
    ),
    "data that are not there are nothing": (
        "[{field: k, type: u8}, {data: d, size: 2, when: k}, {value: v, read: d == none()}]",
        {"k": 0},
        "00",
    ),
    "what fills a frame up is in the range of a check": (
        "[{const: 05, name: c}, {data: d, size: k}], group: filled, size: 6, fill: 2A",
        {"k": 1, "d": b"a"},
        "01 05 61 2A 2A BA",
    ),
    "a wrap in an item of a list ends in it": (
        "[{count: n, type: u8, of: r},"
        " {repeat: r, times: n, of: [{wrap: {escape: DLE}, of: [{data: a, size: rest}]}, {const: 10 03}]}]",
        {"r": [{"a": b"x\x10"}, {"a": b""}]},
        "02 78 10 10 10 03 10 03",
    ),
    "what `where` fixes has its default where it is not there": (
        "[{field: a, type: u8, when: x == 3}, {field: b, type: u8, when: y == none()}],"
        " group: maybe, where: {x: [1, 2], y: 1}",
        {"t": 0, "a": 8, "b": 9},
        "00 08 09",
    ),
    "what `where` fixes is nothing where it is not there": (
        "[{field: a, type: u8, when: y == none()}], group: maybe, where: {x: 1, y: [1, 2]}",
        {"t": 0, "a": 8},
        "00 08",
    ),
    "what `where` builds has its default where it is not there": (
        "[{field: a, type: u8, when: x == 3}, {field: b, type: u8, when: y == none()}],"
        " group: maybe, where: {x: {build: 5}, y: {build: 6}}",
        {"t": 0, "a": 8, "b": 9},
        "00 08 09",
    ),
    "a time is fixed by `where`": ("[], group: timed, where: {t: [20 ms, 0 ms]}", {}, "02"),
    "a length in any number of digits, where 0 means another": (
        "[{field: k, type: u8}, {length: n, type: hex, size: k, of: [d], zero_means: 2}, {data: d, size: rest}]",
        {"k": 2, "d": b"abc"},
        "02 30 33 61 62 63",
    ),
    "a text that its end marks before a body that its tail ends": (
        "[{field: a, type: dec, size: 2}], group: behind_text",
        {"t": "abc", "a": 7},
        "61 62 63 00 30 37 03",
    ),
    "an optional part of a record before a constant that may stand in what follows": (
        "[{include: perhaps, as: r}, {text: '0'}, {count: n, type: u8, of: l}, {repeat: l, times: rest, of: dec,"
        " size: 1}, {const: 7E}]",
        {"r": {}, "l": [0, 0, 5]},
        "30 03 30 30 35 7E",
    ),
    "a frame inside may be empty data": (
        "[{field: k, type: u8}, {inner: i, of: [open]}]",
        {"k": 3, "i": {"open": {"d": b""}}},
        "03",
    ),
    "a value of a wrap that is not there is nothing": (
        "[{field: k, type: u8}, {wrap: {escape: DLE}, of: [{length: n, type: u8, of: [d]}, {data: d, size: n}],"
        " when: k},"
        " {const: 10 03}, {field: x, type: u8, when: n == 2}]",
        {"k": 0},
        "00 10 03",
    ),
    "a length in a case counts what stands behind the cases": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{length: n, type: u8, of: [d]}]}, else: []},"
        " {data: d, size: rest}]",
        {"k": 1, "d": b"ab"},
        "01 02 61 62",
    ),
    "a length under a condition counts what stands behind it": (
        "[{field: k, type: u8}, {length: n, type: u8, of: [d], when: k}, {data: d, size: rest}]",
        {"k": 1, "d": b"ab"},
        "01 02 61 62",
    ),
    "a count under a condition counts what stands behind it": (
        "[{field: k, type: u8}, {count: n, type: u8, of: r, when: k}, {repeat: r, times: rest, of: u8}]",
        {"k": 1, "r": [7, 8]},
        "01 02 07 08",
    ),
    "a length in a wrap counts what stands behind it": (
        "[{wrap: {escape: DLE}, of: [{length: n, type: u8, of: [d]}]}, {const: 10 03}, {data: d, size: rest}]",
        {"d": b"ab"},
        "02 10 03 61 62",
    ),
    "a count in digits counts what stands behind them": (
        "[{wrap: hex, of: [{count: n, type: u8, of: r}]}, {repeat: r, times: rest, of: u8}]",
        {"r": [7, 8]},
        "30 32 07 08",
    ),
    "a field under a condition is what comes later": (
        "[{field: k, type: u8}, {field: z, type: u8, is: w, when: k}, {field: w, type: u8}]",
        {"k": 1, "w": 3},
        "01 03 03",
    ),
    "a length of a record of any size": (
        "[{length: n, type: u8, of: [r]}, {include: sized, as: r}]",
        {"r": {"m": 2, "d": b"ab"}},
        "03 02 61 62",
    ),
    "a length of cases with a wrap in them": (
        "[{field: k, type: u8}, {length: n, type: u8, of: [c]}, {choose: k, name: c,"
        " cases: {1: [{wrap: hex, of: [{field: z, type: u8}, {data: d, size: z}]}]}, else: []}]",
        {"k": 1, "z": 2, "d": b"ab"},
        "01 06 30 32 36 31 36 32",
    ),
    "a check over a wrap that may be absent covers what is in it": (
        "[{field: k, type: u8}, {wrap: {escape: DLE}, of: [{data: d, size: 1}], when: k, name: w}, {const: 10 03},"
        " {check: sum8, over: w..here}]",
        {"k": 1, "d": b"\x10"},
        "01 10 10 10 03 23",
    ),
    "a check over a record that may be absent covers what is in its wrap": (
        "[{field: k, type: u8}, {include: wrapped, as: r, when: k}, {check: sum8, over: r..here}]",
        {"k": 1, "r": {"a": 5, "d": b"a"}},
        "01 05 36 31 66",
    ),
    "a check over cases with a check of their own covers what is in their wrap": (
        "[{field: k, type: u8}, {choose: k, name: c, cases: {1: [{wrap: hex, of: [{data: d, size: 2},"
        " {check: xor8}]}]}, else: []}, {check: sum8, over: c..here}]",
        {"k": 1, "d": b"ab"},
        "01 36 31 36 32 30 33 C6",
    ),
    "a check over a check before another one": (
        "[{const: 7E, name: a}, {check: sum8, name: b}, {check: crc16-modbus}, {check: xor8, over: a..b}]",
        {},
        "7E 7E 30 A0 00",
    ),
    "a check over a wrap with two checks": (
        "[{wrap: hex, of: [{data: d, size: 1}, {check: sum8}, {check: xor8}], name: w}, {check: sum8, over: [w]}]",
        {"d": b"a"},
        "36 31 36 31 30 30 C2",
    ),
    "a length before conversion of what is not there": (
        "[{field: k, type: u8}, {length: n, type: u8, of: [d], plain: yes},"
        " {data: d, size: n, convert: hex_to_ascii, when: k}]",
        {"k": 0},
        "00 00",
    ),
    "a field of a record that is not there is nothing": (
        "[{field: k, type: u8}, {include: outer, as: r, when: k}, {require: r.i.a != 77}]",
        {"k": 0},
        "00",
    ),
    "a field of a record in a case that is not taken is nothing": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{include: outer, as: r}]}, else: []}, {require: r.i.a != 77}]",
        {"k": 0},
        "00",
    ),
    "a field that has a default, of a record in a case": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{include: default, as: r}]}, else: []}, {require: r.a == 3}]",
        {"k": 1},
        "01 03",
    ),
    "a length of cases with a check of their own": (
        "[{field: k, type: u8}, {choose: k, name: c, cases: {1: [{data: d, size: 2}, {check: crc16-modbus}],"
        " 2: [{check: sum8}]}, else: []}, {length: n, type: u8, of: [c]}]",
        {"k": 1, "d": b"ab"},
        "01 61 62 79 88 04",
    ),
    "a check in a case over what another case holds": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{const: 30, when: k > 3}, {check: xor8}],"
        " 2: [{check: xor8, over: k..here}]}, else: []}]",
        {"k": 2},
        "02 02",
    ),
    "a condition on a value of another case": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{bits: {b: 0-2}, of: u8}],"
        " 2: [{field: a, type: u8, when: 'either(b, 2) > 1'}]}, else: []}]",
        {"k": 2, "a": 7},
        "02 07",
    ),
    "a condition on what a case in a wrap before it does not hold": (
        "[{field: k, type: u8}, {wrap: {escape: DLE}, of: [{choose: k, cases: {1: [{length: n, type: u8, of: [d]},"
        " {data: d, size: n}]}, else: []}]}, {const: 10 03}, {check: sum8, when: n != none()}]",
        {"k": 0},
        "00 10 03",
    ),
    "a body that begins with a condition, behind a head of any size": (
        "[{require: 3 < 4}, {field: t, type: ascii, size: 2}], group: behind_list",
        {"r": [6], "t": "ab"},
        "36 61 62 03",
    ),
    "a field of a record of a record in the items of a list": (
        "[{repeat: r, times: 2, of: [{include: outer, as: o}]}, {value: v, read: 'sum(r.o.i.a)'}]",
        {"r": [{"o": {"i": {"a": 2}}}, {"o": {"i": {"a": 3}}}]},
        "02 03",
    ),
    "a body that ends at its tail behind a frame inside": (
        "[], group: behind_frame",
        {"i": {"counted": {"r": []}}},
        "30 03",
    ),
    "a body that ends at its tail behind a list": (
        "[], group: behind_list",
        {"r": [6, 7]},
        "36 37 03",
    ),
    "a frame inside that reaches as far as the constant in its item": (
        "[{repeat: r, times: 1, of: [{inner: i, of: [word], size: rest}, {const: 10 02}]}, {const: 03}]",
        {"r": [{"i": {"word": {}}}]},
        "61 62 10 02 03",
    ),
    "digits of fixed size in every item": (
        "[{repeat: r, times: 2, of: [{wrap: hex, of: [{skip: 1}]}]}]",
        {"r": [{}, {}]},
        "30 30 30 30",
    ),
    "a rest before a record with a condition of its own": (
        "[{field: k, type: u8}, {data: d, size: rest}, {include: ended, as: r}]",
        {"k": 1, "d": b"ax", "r": {"k": 9}},
        "01 61 78 61 62 09 00",
    ),
    "a rest before a record with a condition on what stands before it": (
        "[{field: t, type: u8}, {data: d, size: rest}, {include: told, as: r}, {check: sum8}]",
        {"t": 5, "d": b"a", "r": {}},
        "05 61 61 62 00 29",
    ),
    "a field of a record has the name of one around it": (
        "[{field: b, type: u8}, {include: named_alike, as: r}]",
        {"b": 1, "r": {"b": 9}},
        "01 0A 09",
    ),
    "nothing but what is skipped before a list of numbers": (
        "[{skip: 1}, {repeat: r, times: rest, of: int, size: 2}, {const: 7E}]",
        {"r": [8]},
        "00 00 08 7E",
    ),
    "a default with a condition in it, of what may be absent": (
        "[{repeat: values_before, times: 1, of: [{field: which, type: u8}, {field: value, type: u8,"
        " default: 4 if sum(values_before.which) > 2 else 1, when: which % 2 == 0}]}]",
        {"values_before": [{"which": 2}]},
        "02 01",
    ),
    "a frame inside an item of which a value is asked for": (
        "[{repeat: r, times: 1, of: [{field: a, type: u8}, {inner: i, of: [word], when: a > 1}]},"
        " {data: d, size: sum(r.a)}]",
        {"r": [{"a": 1}], "d": b"x"},
        "01 78",
    ),
    "a size by what is in a wrap in a record": (
        "[{field: k, type: u8}, {include: doubled, as: r}, {check: sum8}]",
        {"k": 1, "r": {"n": 2, "d": b"ab"}},
        "01 02 10 03 61 62 D9",
    ),
    "a size behind a record by what is in a wrap in it": (
        "[{include: stuffed, as: r}, {data: e, size: r.n}, {const: 7E}]",
        {"r": {"n": 1, "d": b"a"}, "e": b"b"},
        "01 61 10 03 62 7E",
    ),
    "a size by what is in a wrap in an item": (
        "[{count: n, type: u8, of: r}, {repeat: r, times: n, of: [{include: doubled}]}, {check: sum8}]",
        {"r": [{"n": 1, "d": b"a"}, {"n": 2, "d": b"aa"}]},
        "02 01 10 03 61 02 10 03 61 61 4E",
    ),
    "a length that counts a number worked out from it": (
        "[{field: a, type: u8, is: 7 - n}, {length: n, type: u8, of: [d, a]}, {data: d, size: rest}]",
        {"d": b"ab"},
        "04 03 61 62",
    ),
    "a length before conversion in an optional part, of what is under a condition": (
        "[{field: k, type: u8}, {optional: [{length: n, type: u8, of: [d], plain: yes},"
        " {data: d, size: n, convert: hex_to_ascii, when: k}, {field: a, type: u8}]}]",
        {"k": 1, "d": b"a", "a": 5},
        "01 01 36 31 05",
    ),
    "an optional part that is not there before a constant": (
        "[{optional: [{field: a, type: u8}]}, {const: 05}, {inner: i, of: [word]}, {const: 03}]",
        {"i": {"word": {}}},
        "05 61 62 03",
    ),
    "a rest in a record before what is under a condition on it": (
        "[{include: counted, as: r}, {field: x, type: u8, when: r.n > 3}]",
        {"r": {"d": b"abc"}},
        "03 61 62 63",
    ),
    "a field of a record that is worked out from what comes later": (
        "[{include: by_later, as: r}, {field: t, type: u8}]",
        {"r": {}, "t": 4},
        "05 04",
    ),
    "a record without values in a record": (
        "[{include: hollow, as: r}, {field: b, type: u8, when: r.a > 1}]",
        {"r": {"a": 1}},
        "78 00 01",
    ),
    "a range by places behind what takes no bytes": (
        "[{require: 3 < 300}, {field: a, type: u16}, {check: sum8, over: 0..1}]",
        {"a": 8},
        "00 08 08",
    ),
    "a length that counts what a case in another case holds": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{choose: k, cases: {1: [{field: a, type: u8}]}, else: []}],"
        " 2: [{length: n, type: u8, of: [d, a]}, {data: d, size: rest}]}, else: []}]",
        {"k": 2, "d": b"ab"},
        "02 02 61 62",
    ),
    "bits of a number with a sign": (
        "[{bits: {a: 0-2, b: 7}, of: i8}]",
        {"a": 4, "b": 1},
        "84",
    ),
    "bits of a record that are not there are nothing": (
        "[{include: maybe_bits, as: r}, {require: r.x != 0}]",
        {"r": {"k": 0}},
        "00",
    ),
}
"""Test name: body, values, encoded bytes."""
DAMAGED: dict[str, tuple[str, str, str]] = {
    "a field of a record that comes of what is later": (
        "[{include: by_later, as: r}, {field: t, type: u8}]", "07 04", "value"
    ),
    "a length of what is not there": (
        "[{field: k, type: u8}, {length: n, type: u8, of: [d]}, {data: d, size: n, when: k}]", "00 04", "length"
    ),
    "a length of what another case holds": (
        "[{field: k, type: u8}, {length: n, type: u8, of: [d]},"
        " {choose: k, cases: {1: [{data: d, size: n}]}, else: []}]",
        "02 04",
        "length",
    ),
    "a count under a condition": (
        "[{field: k, type: u8}, {count: n, type: u8, of: r, when: k}, {repeat: r, times: rest, of: u8}]",
        "01 02 07",
        "length",
    ),
    "text with the byte that ends the body": (
        "[{field: t, type: ascii, size: 3}], group: ended", "61 03 62 03", "short"
    ),
    "a frame inside that is none of those that may be there": (
        "[{inner: i, of: [word, counted]}], size: 5, fill: 00", "78 79 00 00 00", "constant"
    ),
    "text with the byte that ends the body behind a head of any size": (
        "[{field: t, type: ascii, size: 3}], group: behind_list", "36 61 03 62 03", "short"
    ),
}  # fmt: skip
"""Test name: body, damaged bytes, cause of the fault."""
UNSENDABLE: dict[str, tuple[str, dict[str, Any], str]] = {
    "a number in no digits": (
        "[{field: k, type: u8}, {field: x, type: hex, size: k}]",
        {"k": 0, "x": 0},
        "the values do not fit into this frame: 0 does not fit into 0 hex digits",
    ),
    "data that hold the constant that ends them": (
        "[{data: d, size: rest}, {const: 10 03}, {field: k, type: u8}, {data: e, size: k}]",
        {"d": b"\x10\x03", "k": 1, "e": b"a"},
        "'d' holds 10 03, which ends it",
    ),
    "data that make that constant with its first byte": (
        "[{data: d, size: rest}, {const: 03 03}, {field: k, type: u8}, {data: e, size: k}]",
        {"d": b"a\x03", "k": 1, "e": b"a"},
        "'d' holds 03 03, which ends it",
    ),
    "a list that holds the constant that ends it": (
        "[{repeat: r, times: rest, of: u16}, {const: 03}, {field: k, type: u8}, {data: e, size: k}]",
        {"r": [3], "k": 1, "e": b"a"},
        "'r' holds 03, which ends it",
    ),
    "a frame inside whose size is not there": (
        "[{field: k, type: u8}, {field: n, type: u8, when: k}, {inner: i, of: [word], size: n}]",
        {"k": 0, "i": {"word": {}}},
        "the size of 'i' cannot be told: a value it is worked out from is not there",
    ),
    "data whose size is not there": (
        "[{field: k, type: u8}, {field: n, type: u8, when: k}, {data: d, size: n}]",
        {"k": 0, "d": b"a"},
        "the size of 'd' cannot be told: a value it is worked out from is not there",
    ),
}
"""Test name: body, values, error message."""
REFUSED: dict[str, tuple[str, str]] = {
    "a check over everything before it, in a record under a condition": (
        "[{field: k, type: u8}, {include: checked, as: r, when: k}]",
        "a check in a record under a condition has to say what it covers – name it in over:",
    ),
    "a check over everything before it, in a record of what may be left out": (
        "[{field: k, type: u8}, {optional: [{include: checked, as: r}]}]",
        "a check in a record of a case has to say what it covers – name it in over:",
    ),
    "a record that is read inside itself": (
        "[{field: k, type: u8}, {include: itself, as: r}]",
        "'r' is read inside 'r' itself – write the name of a field alone, without 'r'",
    ),
    "digits in an item of which only what they stand for tells the size": (
        "[{field: k, type: u8}, {count: n, type: u8, of: r},"
        " {repeat: r, times: n, of: [{wrap: hex, of: [{data: d, size: k}]}]}]",
        "nothing shows where the wrap part ends in an item of a list",
    ),
    "digits of which only a wrap in them tells the size": (
        "[{field: k, type: u8}, {wrap: hex, of: [{include: doubled, as: r}]}, {check: sum8}]",
        "only 'n' in a wrap tells how many digits there are around it",
    ),
    "a range that ends inside a wrap under a condition": (
        "[{field: k, type: u8}, {wrap: hex, of: [{field: a, type: u8}, {field: b, type: u8}], when: k},"
        " {check: sum8, over: k..a}]",
        "the range of a check ends in a part under a condition: 'a' – name the wrap part, or what stands beside it",
    ),
    "a check over a wrap under a condition and over a part of it": (
        "[{field: k, type: u8}, {wrap: hex, of: [{field: a, type: u8}], when: k, name: w},"
        " {check: sum8, over: [w, a]}]",
        "a check covers what stands in a part under a condition: 'a'",
    ),
    "bits that depend on what is worked out from them": (
        "[{field: k, type: u8, is: x + 1}, {optional: [{field: a, type: u8, when: k > 1}, {bits: {x: 0-3}, of: u8}]}]",
        "'x' has no value where an expression reads it",
    ),
    "a default of a record's field by itself": (
        "[{field: k, type: u8}, {include: circle, as: r}]",
        "'a' cannot be computed from itself – name another value",
    ),
    "a frame inside that takes the rest in an item": (
        "[{count: n, type: u8, of: r}, {repeat: r, times: n, of: [{inner: i, of: [word], size: rest}]}]",
        "nothing shows where 'i' ends in an item of 'r' – give it a size, or put a constant behind it",
    ),
    "a default that comes later": (
        "[{field: k, type: u8}, {field: a, type: u8, default: b + 1, when: k}, {bits: {b: 0-2}, of: u8}]",
        "the default of what may be absent uses 'b', which is read only later – move 'b' before it",
    ),
    "a tail that may be absent": (
        "[{field: a, type: hex, size: 2}], group: maybe_ended",
        "the tail of 'f' must begin with a constant that is always there – delimited bodies end there",
    ),
    "bits that may hold the byte that ends the body": (
        "[{bits: {a: 0-7}, of: u8}], group: ended",
        "the bits part may hold 03, the byte that ends the body of 'f'",
    ),
    "items that may hold the byte that ends the body": (
        "[{repeat: r, times: 2, of: [{field: a, type: u8}]}], group: ended",
        "'a' may hold 03, the byte that ends the body of 'f'",
    ),
    "a frame inside that may hold the byte that ends the body": (
        "[{inner: i, of: [open]}], group: ended",
        "'d' may hold 03, the byte that ends the body of 'f'",
    ),
    "a frame inside that only silence ends in what is filled up": (
        "[{inner: i, of: [open]}], size: 9, fill: 00",
        "nothing shows where the content of 'f' ends and what fills it up begins",
    ),
    "a mark of computed size": (
        "[{field: s, type: u8}, {field: a, type: hex, size: s, long: {mark: 200, type: u16}}]",
        "'a' has a computed size, so its mark for long: has none – give a size that is a number, or leave long out",
    ),
    "bits computed from themselves": (
        "[{bits: {b: 0-2}, of: u8, build: {b: 7 - b}}]",
        "'b' cannot be computed from itself – name another value",
    ),
    "a field computed from itself": (
        "[{field: b, type: u8, default: b + 1}]",
        "'b' cannot be computed from itself – name another value",
    ),
    "the length of a number in a value": (
        "[{field: a, type: u8}, {value: v, read: len(a)}]",
        "'len' takes a text, bytes, a list, a table or a frame here, this is a number",
    ),
    "the length of a number with names": (
        "[{field: a, type: u8, values: {1: A}}, {field: b, type: u8, is: len(a)}]",
        "'len' takes a text, bytes, a list, a table or a frame here, this is a number",
    ),
    "a size by a length that is there on another condition": (
        "[{field: k, type: u8}, {length: n, type: u8, of: [d], when: k}, {data: d, size: n, when: k > 3}]",
        "the size of 'd' is 'n', and 'n' may be absent – give both the same when: k",
    ),
    "a rest in what is filled up": (
        "[{data: d, size: rest}, {const: 03}], size: 9, fill: 00",
        "'d' reaches to the end of the body, and would read what fills 'f' up",
    ),
    "a frame inside that only silence ends, and a size behind it": (
        "[{inner: i, of: [open]}, {field: n, type: u8}, {data: d, size: n}, {const: 7E}]",
        "nothing shows where 'i' ends and 'd' begins – give it a size",
    ),
    "a frame inside that may be nothing": (
        "[{field: k, type: u8}, {inner: i, of: [nothing]}]",
        "'nothing' may take no bytes, so nothing shows that it is there",
    ),
    "digits that a constant may be read as": (
        "[{wrap: hex, of: [{data: a, size: rest}]}, {text: ab}, {data: b, size: rest}]",
        "two parts take the rest: nothing shows where the wrap part ends",
    ),
    "a rest in a case": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{data: a, size: rest}]}, else: []}, {data: b, size: rest}]",
        "two parts take the rest: nothing shows where the choose part ends",
    ),
    "rests in a wrap": (
        "[{wrap: {escape: DLE}, of: [{data: a, size: rest}, {data: b, size: rest}]}, {const: 10 03}]",
        "two parts take the rest: nothing shows where 'a' ends",
    ),
    "a region that no escape byte need end": (
        "[{field: k, type: u8}, {wrap: {escape: DLE}, of: [{data: a, size: k}]}, {const: 10 03, when: k}, {text: ab}]",
        "nothing shows where the wrap part ends: no 10 need follow it",
    ),
    "a region in an item that no escape byte need end in this item": (
        "[{count: n, type: u8, of: r}, {repeat: r, times: n, of: [{wrap: {escape: DLE}, of: [{data: a, size: rest}]}]},"
        " {const: 10 03}]",
        "nothing shows where the wrap part ends: no 10 need follow it",
    ),
    "a region in a case that no escape byte need end": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{wrap: {escape: DLE}, of: [{data: a, size: k}]}]}, else: []},"
        " {text: ab}]",
        "nothing shows where the wrap part ends: no 10 need follow it",
    ),
    "a time that the unit cannot count": (
        "[{field: a, type: u8}], group: timed, where: {t: 25 ms}",
        "25 ms is between two values of 't', which counts 10 ms",
    ),
    "a time that is too long": (
        "[{field: a, type: u8}], group: timed, where: {t: 1 h}",
        "1 h does not fit: 't' holds 0 ms to 2550 ms",
    ),
    "a range in another case": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{field: a, type: u8}], 2: [{check: sum8, over: a..here}]}}]",
        "the range of a check ends in a case: 'a'",
    ),
    "a range of a record without bytes": (
        "[{field: k, type: u8}, {include: held, as: v}, {field: a, type: u8}, {check: sum8, over: v..here}]",
        "'v' takes no bytes – name segments that stand on the wire",
    ),
    "a check over a part of a case": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{field: a, type: u8}]}, else: []}, {check: sum8, over: [a]}]",
        "a check covers what stands in a case: 'a' – name the choose part, or what stands beside it",
    ),
    "a check over a part of what is optional": (
        "[{field: k, type: u8}, {optional: [{field: a, type: u8}]}, {check: sum8, over: [k, a]}]",
        "a check covers what stands in an optional part: 'a' – name the optional part, or what stands beside it",
    ),
    "a number with a sign whose 0 means another": (
        "[{field: a, type: i8, zero_means: 9}]",
        "'a' has a sign: its 0 stands between other numbers and cannot mean 9",
    ),
    "a length over a wrap whose check covers what stands before it": (
        "[{field: k, type: u8}, {wrap: {escape: DLE}, of: [{const: 10, name: c}, {check: sum8, over: [k, c]}],"
        " name: w}, {const: 10 03}, {length: n, type: u8, of: [d, w]}, {data: d, size: rest}]",
        "a length counts a check code that covers what stands before it – let it count what stands beside the check",
    ),
    "a range that begins with what takes no bytes": (
        "[{field: k, type: u8}, {value: v, read: k}, {field: a, type: u8}, {check: sum8, over: v..here}]",
        "'v' takes no bytes – name segments that stand on the wire",
    ),
}
"""Test name: body, error message of `check`."""


PART = "part: [{field: a, type: u8}, {field: b, type: u8, when: a > 3}]"


FRAMES = (
    "open: {body: [{data: d, size: rest}]}, nothing: {body: [{const: 05, when: 1 == 2}]}, word: {body: [{text: ab}]},"
    " counted: {body: [{count: n, type: dec, size: 1, of: r}, {repeat: r, times: n, of: dec, size: 1}]}"
)


def protocol_of(body: str) -> str:
    layouts = (
        f"layouts: {{hop: [{{field: a, type: u8}}], {PART}, held: [{{require: k > 3}}],"
        " circle: [{field: a, type: u8, default: r.a * 2, when: 3 > 3}],"
        " default: [{field: a, type: u8, default: 3}], inner: [{field: a, type: u8}], outer: [{include: inner, as: i}],"
        " sized: [{field: m, type: u8}, {data: d, size: m}],"
        " maybe_bits: [{field: k, type: u8}, {bits: {x: 0-3}, of: u8, when: k}],"
        " stuffed: [{wrap: {escape: DLE}, of: [{field: n, type: u8}, {data: d, size: rest}]}, {const: 10 03}],"
        " perhaps: [{optional: [{field: a, type: u8}, {check: sum8, over: [a]}]}],"
        " checked: [{check: xor8}], digits: [{check: xor8, as: HEX}], by_later: [{field: a, type: u8, is: t + 1}],"
        " counted: [{length: n, type: u8, of: [d]}, {data: d, size: rest}],"
        " nothing: [{skip: 1}], hollow: [{text: x}, {include: nothing, as: e}, {field: a, type: u8}],"
        " ended: [{text: ab}, {field: k, type: u8}, {skip: 1, when: k > 4}],"
        " told: [{text: ab}, {skip: 1, when: t > 3}],"
        " named_alike: [{field: a, type: u8, is: b + 1}, {field: b, type: u8}],"
        " itself: [{field: a, type: u8}, {field: b, type: u8, is: r.a + 1}],"
        " doubled: [{wrap: {escape: DLE}, of: [{field: n, type: u8}]}, {const: 10 03}, {data: d, size: n}],"
        " wrapped: [{field: a, type: u8}, {wrap: hex, of: [{data: d, size: rest}]}]}"
    )
    groups = (
        "groups: {filled: {head: [{field: k, type: u8}], tail: [{check: sum8, over: c..here}]},"
        " filled_and_more: {head: [{field: k, type: u8}],"
        " tail: [{check: sum8, over: [k..here, {bytes: \"h'01 02'\"}]}]},"
        " ended: {tail: [{const: 03}], delimited: yes},"
        " behind_frame: {head: [{inner: i, of: [counted]}], tail: [{const: 03}], delimited: yes},"
        " behind_text: {head: [{field: t, type: ascii, end: 00}], tail: [{const: 03}], delimited: yes},"
        " behind_list: {head: [{repeat: r, times: rest, of: dec, size: 1}], tail: [{const: 03}], delimited: yes},"
        " maybe: {head: [{field: t, type: u8}, {field: x, type: u8, default: 3, when: t},"
        " {field: y, type: u8, when: t}]},"
        " timed: {head: [{field: t, type: u8, unit: 10 ms}]},"
        " maybe_ended: {tail: [{const: 03, when: 1 == 1}], delimited: yes}}"
    )
    return f"protocol: found\n{layouts}\n{groups}\nframes: {{f: {{body: {body}}}, {FRAMES}}}"


@pytest.mark.parametrize("title", spread(FOUND, 3))
def test_definitions_that_once_went_wrong(title: str) -> None:
    body, values, data = FOUND[title]
    assert Trial(protocol_of(body), values).run() == bytes.fromhex(data)


@pytest.mark.parametrize("title", DAMAGED)
def test_damage_is_found_by_decoding_and_by_diagnosis(title: str) -> None:
    body, data, cause = DAMAGED[title]
    codec = compile_protocol(load_protocol_text(protocol_of(body), "found"))
    with pytest.raises(FrameError) as caught:
        codec.decode("f", bytes.fromhex(data))
    _, _, fault = codec.trace("f", bytes.fromhex(data))
    assert fault is not None
    assert (caught.value.cause, fault.cause) == (cause, cause)


@pytest.mark.parametrize("title", UNSENDABLE)
def test_what_could_not_be_read_again_is_not_sent(title: str) -> None:
    body, values, message = UNSENDABLE[title]
    codec = compile_protocol(load_protocol_text(protocol_of(body), "found"))
    with pytest.raises(EncodeError) as caught:
        codec.encode("f", values)
    assert str(caught.value) == message


def test_a_delimited_body_never_holds_what_ends_it() -> None:
    """Also with a fixed size, where all bytes could be packed at once."""
    text = """
protocol: ended
groups: {g: {head: [{text: '0'}], tail: [{const: 03}], delimited: yes}}
frames: {f: {group: g, body: [{field: a, type: ascii, size: 2}]}}
"""
    codec = compile_protocol(load_protocol_text(text, "ended"))
    assert codec.encode("f", {"a": "\x04\x05"}) == b"0\x04\x05\x03"
    for held in ("\x04\x03", "\x03\x04"):
        with pytest.raises(EncodeError, match="the body holds 03, which ends it"):
            codec.encode("f", {"a": held})


@pytest.mark.parametrize("title", REFUSED)
def test_what_cannot_round_trip_is_refused(title: str) -> None:
    body, what = REFUSED[title]
    with pytest.raises(DefinitionError) as caught:
        compile_protocol(load_protocol_text(protocol_of(body), "found"))
    assert what in str(caught.value)


def test_a_frame_inside_that_is_broken_itself_is_all_that_is_told() -> None:
    body = "[{field: k, type: u8}, {wrap: {escape: DLE}, of: [{inner: i, of: [other]}]}, {const: 10 03}]"
    with pytest.raises(DefinitionError) as caught:
        load_protocol_text(f"protocol: p\nframes: {{f: {{body: {body}}}, other: {{body: [{{}}]}}}}", "p")
    assert [problem.what for problem in caught.value.problems] == ["a segment of frame 'other' has no kind"]


def test_a_size_may_go_by_a_length_with_more_conditions() -> None:
    body = "[{field: k, type: u8}, {length: n, type: u8, of: [d], when: k}, {data: d, size: n, when: k and k > 3}]"
    assert Trial(protocol_of(body), {"k": 4, "d": b"ab"}).run() == b"\x04\x02ab"


def test_a_frame_inside_that_check_calls_the_beginning_of_another_need_not_be_read_as_sent() -> None:
    frames = "long: {body: [{field: a, type: u16}, {text: XY, refuse: 4}]}, short: {body: [{field: b, type: u8}]}"
    body = "[{inner: i, of: [long, short]}, {field: c, type: u16}, {data: d, size: rest}, {const: 03}]"
    values = {"i": {"short": {"b": 1}}, "c": 2, "d": b"a"}
    assert Trial(f"protocol: p\nframes: {{f: {{body: {body}}}, {frames}}}", values).run() is None


@pytest.mark.parametrize(
    "wrap", ["{wrap: hex, of: [%s]}, {const: 03}", "{wrap: {escape: DLE}, of: [%s]}, {const: 10 03}"]
)
def test_an_end_that_stands_behind_the_longest_frame_is_none(wrap: str) -> None:
    """The bytes arrive whole or in pieces."""
    body = f"[{{field: k, type: u8}}, {wrap % '{field: a, type: u8, when: k}'}]"
    codec = compile_protocol(load_protocol_text(f"protocol: p\nframes: {{f: {{body: {body}, max: 7}}}}", "p"))
    assert codec.measure("f", b"\x0130\x10\x03") > 0
    assert codec.measure("f", b"\x01" + b"30" * 4 + b"\x10\x03") == codec.LOST
    assert codec.measure("f", b"\x01" + b"30" * 4) == codec.LOST


def test_what_is_missing_is_named_with_its_record() -> None:
    hop = "layouts: {hop: [{field: a, type: u8}, {field: b, type: u8, when: a == 1}, {data: c, size: 1, when: a == 2}]}"
    records = "[{include: hop, as: one}, {include: hop, as: two}, {repeat: r, times: 2, of: [{include: hop}]}]"
    codec = compile_protocol(load_protocol_text(f"protocol: p\n{hop}\nframes: {{f: {{body: {records}}}}}", "p"))
    plain = {"a": 0}
    for name, values in (
        ("two.b", {"one": plain, "two": {"a": 1}, "r": [plain, plain]}),
        ("two.c", {"one": plain, "two": {"a": 2}, "r": [plain, plain]}),
        ("r[1].b", {"one": plain, "two": plain, "r": [plain, {"a": 1}]}),
    ):
        with pytest.raises(EncodeError) as caught:
            codec.encode("f", values)
        assert (caught.value.field, str(caught.value)) == (name, f"'{name}' is missing")


def test_a_record_has_to_be_given_unless_the_definition_has_a_value_for_all_in_it() -> None:
    """An implicit 0 of bits is not a value of the definition."""
    kinds = {
        "plain": "{bits: {a: 0-3, b: 4-7}, of: u8}",
        "computed": "{bits: {a: 0-3, b: 4-7}, of: u8, is: {a: 1}, build: {b: 2}}",
        "partly": "{bits: {a: 0-3, b: 4-7}, of: u8, is: {a: 1}}",
        "digits": "{wrap: hex, of: [{field: a, type: u8}]}",
        "default": "{field: a, type: u8, default: 3}, {data: d, size: 1, pad: 2E}",
        "held": "{include: plain, as: p}",
    }
    layouts = ", ".join(f"{name}: [{body}]" for name, body in kinds.items())
    frames = ", ".join(f"{name}: {{body: [{{include: {name}, as: r}}]}}" for name in kinds)
    codec = compile_protocol(load_protocol_text(f"protocol: p\nlayouts: {{{layouts}}}\nframes: {{{frames}}}", "p"))
    sent = {}
    for name in kinds:
        try:
            sent[name] = codec.encode(name, {}).hex(" ")
        except EncodeError as error:
            sent[name] = str(error)
    missing = dict.fromkeys(("plain", "partly", "digits", "held"), "'r' is missing")
    assert sent == missing | {"computed": "21", "default": "03 2e"}
    assert codec.encode("plain", {"r": {"b": 1}}) == b"\x10"


def test_a_default_that_is_built_decides_on_what_follows() -> None:
    """Of a record, and of the frame itself."""
    layouts = "layouts: {hop: [{bits: {s: 1-7, last: 0}, of: u8, build: {last: 0}}]}"
    body = (
        "[{include: hop, as: one}, {include: hop, as: two, when: one.last == 0}, {field: a, type: u8, build: 3},"
        " {field: b, type: u8, when: a == 3}]"
    )
    values = {"one": {"s": 1}, "two": {"s": 2}, "b": 9}
    assert Trial(f"protocol: p\n{layouts}\nframes: {{f: {{body: {body}}}}}", values).run() == b"\x02\x04\x03\x09"


def test_what_is_quoted_in_a_table_is_a_text() -> None:
    tables = """{b: {1: '0', 2: ' ', 3: B, 4: 7, 5: "h'10 3A'", 6: "'x'", 7: 50 ms, 8: '50 ms', 9: "", 10: 'yes'}}"""
    protocol = load_protocol_text(f"protocol: p\ntables: {tables}\nframes: {{f: {{body: [{{const: 01}}]}}}}", "p")
    found = dict(protocol.tables["b"].entries)
    wanted = ["0", " ", "B", 7, b"\x10\x3a", "x", 50_000_000, "50 ms", "", "yes"]
    assert list(found.values()) == wanted


PAIRS = tuple(combinations_with_replacement(DRAWN, 2))
ROUNDS = int(os.environ.get("FRAMEKIT_DRAWN", "1"))
"""Number of definitions per pair of kinds; FRAMEKIT_DRAWN=50 takes minutes and many thousand definitions."""
SEGMENTS = Path(__file__).parents[2] / "schemas" / "protocol.schema.json"


def result_of(seed: str, kinds: tuple[str, ...], *, more: bool = False, alike: bool = False) -> str:
    """Return the result for a definition with these kinds: `refused`, `built`, or `unbuilt` if no values fit."""
    drawn = DrawnDefinition(seed, kinds, more=more, alike=alike)
    try:
        trial = Trial(drawn.text, drawn.values, seed)
    except DefinitionError as error:
        assert all(problem.at.line >= 1 and problem.what for problem in error.problems)
        return "refused"
    return "unbuilt" if trial.run() is None else "built"


@pytest.mark.parametrize("kind", DRAWN)
def test_what_check_takes_never_crashes_and_round_trips(kind: str) -> None:
    """In pairs with every kind from this kind on."""
    results = []
    for pair in PAIRS:
        if pair[0] == kind:
            for number in range(ROUNDS):
                seed = f"{' '.join(pair)} {number}"
                try:
                    results.append(result_of(seed, pair))
                except Exception as error:
                    raise AssertionError(f"DrawnDefinition({seed!r}, {pair!r}): {error}") from error
    assert len(results) >= ROUNDS


ASKED = os.environ.get("FRAMEKIT_DEFINITIONS", "")
"""Seeds for the long tests instead of their usual seeds: a number of each kind, or a range (10000-16000)."""
START, _, END = ASKED.rpartition("-")


PIECE = 100
"""Number of seeds that a long test tries."""


def firsts(usual: int, whole: int) -> range:
    """Return the first seeds of the pieces that are tried."""
    return range(int(START or 0), int(END or many(usual, whole)), PIECE)


def results_of(first: int, trial: Callable[[int], str]) -> list[str]:
    """Return the results of a piece. Raises AssertionError with the seeds that fail."""
    results, failed = [], {}
    for seed in range(first, first + PIECE):
        try:
            results.append(trial(seed))
        except Exception as error:
            failed[seed] = str(error)
    assert not failed
    return results


@pytest.mark.long
@pytest.mark.parametrize("first", firsts(300, 4000))
def test_thousands_of_definitions_hold(first: int) -> None:
    """With any number of segments; `result_of("612", ())` repeats a failing seed."""
    results = results_of(first, lambda seed: result_of(str(seed), ()))
    assert results.count("built") > PIECE // 5


@pytest.mark.long
@pytest.mark.parametrize("first", firsts(200, 4000))
def test_definitions_with_parameters_state_and_more_functions_hold(first: int) -> None:
    """`result_of("m612", (), more=True)` repeats a failing seed."""
    results = results_of(first, lambda seed: result_of(f"m{seed}", (), more=True))
    assert results.count("built") > PIECE // 5


HELD = ("include", "repeat", "include", "choose", "check", "check", "length", "count", "data", "field", "wrap", "inner")
"""Kinds that contain segments or refer to segments by name."""


def result_with_equal_names(seed: int) -> str:
    """Return the result for a definition whose records, items and cases have the same names."""
    kinds = tuple(Random(seed).choices(HELD, k=3))
    return result_of(f"s{seed}", kinds, more=seed % 3 == 0, alike=True)


def test_records_items_and_cases_may_have_the_same_names() -> None:
    results = [result_with_equal_names(seed) for seed in range(50)]
    assert results.count("built") > 3


@pytest.mark.long
@pytest.mark.parametrize("first", firsts(300, 4000))
def test_many_records_items_and_cases_have_the_same_names(first: int) -> None:
    assert results_of(first, result_with_equal_names).count("built") > PIECE // 25


def test_a_few_definitions_with_parameters_and_state_hold() -> None:
    results = [result_of(f"m{seed}", (), more=True) for seed in range(60)]
    assert results.count("built") > 10


def test_half_of_what_is_drawn_is_taken_and_built() -> None:
    results = [result_of(str(seed), ()) for seed in range(60)]
    assert results.count("built") > 10


def test_every_kind_and_key_of_the_schema_is_drawn() -> None:
    """A new kind or key must take part in the trial."""
    known = json.loads(SEGMENTS.read_text("utf-8"))["$defs"]
    wanted = {
        (kind, key) for kind in DRAWN for key in known[f"{kind}_segment"]["properties"] if key != kind or kind in DRAWN
    }
    used = {kind for seed in range(700) for kind in DrawnDefinition(seed).used}
    assert known["segment"]["dependentSchemas"].keys() == set(DRAWN)
    assert wanted - used == {("data", "shows")}, "it changes only what displays show"

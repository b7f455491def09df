"""Bounds of a definition: a value beyond a bound is refused, with place and remedy, before it costs memory or time."""

from __future__ import annotations

import cProfile
import pstats
from pathlib import Path
from typing import Any

import pytest
from construct_oracle import compile_construct
from small_protocol import small_protocol
from spread import spread

from framekit.api.check import check_file
from framekit.codec.ambiguity import ALIKE
from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError
from framekit.codec.samples import MOST_ITEMS, Sampler
from framekit.codec.support import digits, times
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError

NUMBER = 10**12
REFUSED = {
    f"[{{data: x, size: {NUMBER}}}]": "not possible: 0 to 1048576 are",
    f"[{{data: x, size: {NUMBER}, pad: 00}}]": "not possible: 0 to 1048576 are",
    f"[{{field: x, type: ascii, size: {NUMBER}, pad: 20}}]": "not possible: 0 to 1048576 are",
    "[{field: x, type: uint, size: 1048576}]": "256 are possible",
    "[{field: x, type: bcd, size: 1048576}]": "256 are possible",
    f"[{{skip: {NUMBER}}}]": "not possible: 0 to 1048576 are",
    "[{skip: -1}]": "not possible: 0 to 1048576 are",
    f"[{{repeat: x, times: {NUMBER}, of: u8}}]": "not possible: 0 to 1048576 are",
    f"[{{repeat: x, times: {NUMBER}, of: [{{const: 00}}]}}]": "not possible: 0 to 1048576 are",
    f"[{{require: \"len('a' * {NUMBER}) == 1\"}}]": "multiplies numbers",
    f"[{{require: \"len({NUMBER} * h'41') == 1\"}}]": "multiplies numbers",
    f'[{{require: "len([1] * {NUMBER}) == 1"}}]': "multiplies numbers",
    f'[{{require: "1 << {NUMBER} == 1"}}]': "256 are possible",
    f'[{{require: "{"-" * 3000}1 == 1"}}]': "too many operators in a row",
    f'[{{require: "{"1 + " * 3000}1 == 1"}}]': "too many operators in a row",
    f'[{{field: a, type: u8}}, {{require: "a{".a" * 3000} == 1"}}]': "too many operators in a row",
    f'[{{require: "{"(" * 3000}1{")" * 3000} == 1"}}]': "nested too deeply",
    "[{data: a, size: 1048576}, {const: 01}]": "takes at least 1048577 bytes, 1048576 are possible",
    "[{repeat: a, times: 1048576, of: [{repeat: b, times: 1048576, of: u8}]}]": "takes at least 1099511627776 bytes",
    "[{field: h, type: u8}, {repeat: a, times: 2000, of: [{repeat: b, times: 2000, of: u8, when: h == 1}]}]": (
        "the lists in 'f' have 4002000 items together, 1048576 are possible"
    ),
}


@pytest.mark.parametrize("body", REFUSED)
def test_what_has_no_bound_is_refused(body: str) -> None:
    with pytest.raises(DefinitionError, match=REFUSED[body]) as caught:
        small_protocol(body)
    assert all(len(str(problem)) < 400 for problem in caught.value.problems)


@pytest.mark.parametrize("keys", [f"size: {NUMBER}, fill: 00", f"max: {NUMBER}"])
def test_a_frame_of_any_size_is_refused(keys: str) -> None:
    with pytest.raises(DefinitionError, match="not possible: 0 to 1048576 are"):
        small_protocol("[{const: 01}]", keys=keys)


def test_a_default_without_bound_is_refused() -> None:
    with pytest.raises(DefinitionError, match="256 are possible"):
        small_protocol("[{data: x, size: p}]", f'params: {{p: {{type: number, default: "1 << {NUMBER}"}}}}')


def test_an_area_of_any_size_is_refused() -> None:
    areas = f"areas: {{D: {{unit: word, size: {NUMBER}}}}}\naddresses: [{{form: 'D{{start:dec}}', area: D}}]"
    with pytest.raises(DefinitionError, match="not possible: 0 to 16777216 are"):
        load_protocol_text(f"protocol: x\nframes: {{f: {{body: [{{const: 01}}]}}}}\n{areas}\n")


def test_a_form_of_many_optional_parts_is_refused() -> None:
    form = "[D]" * 20 + "{start:dec}"
    text = "protocol: x\nframes: {f: {body: [{const: 01}]}}\nareas: {D: {unit: word, size: 10}}\n"
    with pytest.raises(DefinitionError, match="it has 20 optional parts, 4 are possible"):
        load_protocol_text(f"{text}addresses: [{{form: '{form}', area: D}}]\n")


def test_what_the_line_says_multiplies_numbers_only() -> None:
    body = '[{field: n, type: u32}, {field: a, type: KIND, size: 3}, {require: "len(a * n) == 0"}]'
    codec = compile_protocol(small_protocol(body.replace("KIND", "bytes")))
    with pytest.raises(EncodeError):
        codec.encoders["f"]({"n": 0xFFFFFFFF, "a": b"abc"}, {})
    with pytest.raises(DefinitionError, match="a text and a number do not go together"):
        small_protocol(body.replace("KIND", "ascii"))
    with pytest.raises(TypeError):
        times("abc", 0xFFFFFFFF)  # type: ignore[arg-type]
    assert times(70_000, 70_000) == 4_900_000_000


@pytest.mark.parametrize(
    "part",
    [
        "field: a, type: ascii, size: n, pad: 20",
        "data: a, size: n, pad: 00",
        "field: a, type: uint, size: n",
        "field: a, type: dec, size: n",
        "field: a, type: hex, size: n",
        "field: a, type: bcd, size: n",
    ],
)
@pytest.mark.parametrize("compiled", [compile_protocol, compile_construct])
def test_what_is_filled_up_to_a_computed_size_has_a_bound(compiled: Any, part: str) -> None:
    codec = compiled(small_protocol(f"[{{field: n, type: u32}}, {{{part}}}]"))
    value = "x" if "ascii" in part else b"x" if "data" in part else 1
    with pytest.raises(EncodeError, match="4294967295 bytes or digits are too many, 1048576 are possible"):
        codec.encode("f", {"n": 0xFFFFFFFF, "a": value}, {})
    assert len(codec.encode("f", {"n": 8, "a": value}, {})) == 12


def test_samples_of_long_lists_have_a_bound() -> None:
    codec = compile_protocol(small_protocol("[{repeat: a, times: 1000, of: [{repeat: b, times: 1000, of: u8}]}]"))
    sampler = Sampler(codec, {})
    assert len(sampler.samples("f")) < 8
    assert sampler._items <= MOST_ITEMS + 1000


def test_digits_have_a_bound() -> None:
    assert digits(5, 4096) == "5".rjust(4096, "0")
    with pytest.raises(ValueError, match="4097 digits are too many"):
        digits(5, 4097)


def work(path: Path, frames: int, body: str) -> int:
    """Return the number of calls of checking a definition with this number of small frames."""
    bodies = (f"  F{n}: {{body: [{body.format(high=n >> 8, low=n & 255)}]}}\n" for n in range(frames))
    path.write_text("protocol: many\nframes:\n" + "".join(bodies))
    profile = cProfile.Profile()
    with profile:
        checked = check_file(str(path))
    assert checked.what.startswith(f"protocol many, {frames} frame")
    return sum(row[1] for row in pstats.Stats(profile).stats.values())  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "body",
    spread(
        [
            "{{field: a, type: u8}}, {{const: {low:02X}}}, {{field: b, type: u16, is: {high}}}",
            "{{const: {high:02X} {low:02X}}}, {{field: a, type: u8}}",
            "{{field: a, type: u8}}",
        ],
        3,
    ),
)
@pytest.mark.long
def test_a_check_of_twice_as_many_frames_is_twice_the_work(tmp_path: Path, body: str) -> None:
    path = tmp_path / "many.protocol.yaml"
    work(path, 1, body)  # load everything that is loaded once
    few, some, many = (work(path, frames, body) for frames in (30, 60, 120))
    assert many - some < 2.2 * (some - few)


def test_a_size_behind_values_in_a_row_is_compiled_in_work_that_grows_with_them() -> None:
    def compiling(values: int) -> int:
        row = "".join(f"{{value: v{n}, read: v{n - 1} + v{n - 1}}}, " for n in range(1, values + 1))
        body = f"[{{field: v0, type: u8}}, {row}{{data: d, size: v{values}}}]"
        protocol = load_protocol_text(f"protocol: row\nframes: {{F: {{body: {body}}}}}\n")
        profile = cProfile.Profile()
        with profile:
            compile_protocol(protocol)
        return sum(row[1] for row in pstats.Stats(profile).stats.values())  # type: ignore[attr-defined]

    compiling(1)  # load everything that is loaded once
    assert compiling(12) < 4 * compiling(6)


def test_frames_that_hold_the_next_one_twice_are_each_looked_at_once() -> None:
    def loading(levels: int) -> int:
        groups = "".join(f"  g{n}: {{from: both}}\n" for n in range(levels + 1))
        inner = "{{const: {0:02X}}}, {{inner: x, of: g{1}}}, {{inner: y, of: g{1}}}"
        bodies = [*(inner.format(n, n + 1) for n in range(levels)), "{field: z, type: ascii, end: 00}"]
        frames = "".join(f"  f{n}: {{group: g{n}, body: [{body}]}}\n" for n, body in enumerate(bodies))
        profile = cProfile.Profile()
        with profile:
            load_protocol_text(f"protocol: twice\ngroups:\n{groups}frames:\n{frames}")
        return sum(row[1] for row in pstats.Stats(profile).stats.values())  # type: ignore[attr-defined]

    loading(1)  # load everything that is loaded once
    assert loading(32) < 2.5 * loading(16)


@pytest.mark.long
def test_frames_that_no_constant_tells_apart_have_a_bound(tmp_path: Path) -> None:
    path = tmp_path / "alike.protocol.yaml"
    path.write_text(
        "protocol: alike\nframes:\n"
        + "".join(
            f"  F{n}: {{body: [{{field: a, type: u16}}, {{require: a == {n}}}, {{field: b, type: u8}}]}}\n"
            for n in range(ALIKE + 10)
        )
    )
    (problem,) = check_file(str(path)).problems
    assert problem.what == f"no constant tells 'F{ALIKE + 1}' from more than {ALIKE} frames that are tried before it"


def test_what_includes_a_layout_that_is_too_large_is_not_read() -> None:
    """Each of these layouts contains the previous layout twice, so all layouts after the twelfth are too large."""
    twice = [f"  L{number}: [{{include: L{number - 1}}}, {{include: L{number - 1}}}]" for number in range(1, 26)]
    layouts = ["  L0: [{const: 06}]", *twice]
    text = "\n".join(["protocol: bomb", "layouts:", *layouts, "frames:", "  f: {body: [{include: L25}]}"])
    profile = cProfile.Profile()
    with profile, pytest.raises(DefinitionError, match="more than 4000 segments") as error:
        load_protocol_text(text, "bomb")
    assert len(error.value.problems) == 1
    calls = {name: called[1] for (_, _, name), called in pstats.Stats(profile).stats.items()}
    assert calls["_number"] < 8 * 4000


def rows(count: int) -> str:
    """Return a definition with this number of services, whose requests differ in a constant."""
    services = "".join(f"  s{n}: [{{request: {{ASK: {{x: {n}}}}}, reply: {{ANS: {{}}}}}}]\n" for n in range(count))
    asked = "{group: request, body: [{const: 02}, {field: x, type: u16}]}"
    frames = f"{{ASK: {asked}, ANS: {{from: server, body: [{{const: 03}}]}}}}"
    head = "protocol: many\nextends: standard\ngroups: {request: {from: client}}\n"
    return f"{head}frames: {frames}\nservices:\n{services}"


def forms(count: int) -> str:
    """Return a definition with this number of areas, each with a form of addresses of its own."""
    areas = "".join(f"  A{n}: {{unit: word, size: 10}}\n" for n in range(count))
    addresses = "".join(f'  - {{form: "A{n}.{{start:dec}}", area: A{n}}}\n' for n in range(count))
    return f"protocol: many\nframes: {{f: {{body: [{{const: 01}}]}}}}\nareas:\n{areas}addresses:\n{addresses}"


def wrong_keys(count: int) -> str:
    """Return a definition with the same mistake in this number of frames."""
    frames = "".join(f"  F{n}: {{body: [{{const: 02}}], fram: client}}\n" for n in range(count))
    return f"protocol: many\nframes:\n{frames}"


@pytest.mark.parametrize("text", [rows, forms, wrong_keys])
def test_a_check_of_twice_as_many_parts_is_twice_the_work(text: Any, tmp_path: Path) -> None:
    path, calls = tmp_path / "many.yaml", []
    for count in (30, 60, 120, 240):  # the first one fills caches
        path.write_text(text(count))
        profile = cProfile.Profile()
        with profile:
            check_file(str(path))
        calls.append(sum(row[1] for row in pstats.Stats(profile).stats.values()))  # type: ignore[attr-defined]
    assert calls[3] - calls[2] < 2.4 * (calls[2] - calls[1])

"""Names for the fields of a guess: nameable bytes, effect on neighbouring bytes, and the resulting definition."""

from __future__ import annotations

import random
import struct
from itertools import pairwise
from pathlib import Path

import pytest

from framekit.api.check import check_file
from framekit.api.imports import ProtocolNameError, protocol_name
from framekit.api.vectors import run_vectors
from framekit.codec.checks import compute
from framekit.definition.model.checks import ready_methods
from framekit.extras.guess.draft import DraftError, NamedGuess, drafted, write_definition
from framekit.extras.guess.guess import guess
from framekit.extras.guess.model import Guess, HeardBytes
from framekit.extras.guess.naming import TYPES, FieldNaming, NamingError, named, number_of, orders_of, types_of
from framekit.extras.guess.texts import decimal_keys

MODBUS = ready_methods()["crc16-modbus"]


def framed(data: bytes) -> bytes:
    return data + compute(MODBUS, data).to_bytes(2, "little")


def polled(count: int = 40) -> list[HeardBytes]:
    """Return polls of a meter for a station and an element.

    Replies hold a float, a status byte and a text of varying size.
    """
    rng, chunks = random.Random(11), list[HeardBytes]()
    for at in range(count):
        head = bytes([0xA5, rng.choice([3, 4])])
        reply = struct.pack(">f", 20 + at / 4) + bytes([rng.choice([0, 1, 0x80])])
        reply += bytes(rng.randrange(97, 123) for _ in range(rng.randrange(2, 9)))
        now = at * 500_000_000
        chunks.append(HeardBytes(now, "out", framed(head + bytes([rng.randrange(9), 0x10]))))
        chunks.append(HeardBytes(now + 20_000_000, "in", framed(head + bytes([len(reply)]) + reply)))
    return chunks


@pytest.fixture(scope="module")
def meter() -> Guess:
    return guess(polled())


def told_fields(found: Guess, kind: str = "told") -> list[tuple[str, int, int]]:
    return [
        (field.name, field.offset, field.size) for each in found.kinds if each.name == kind for field in each.fields
    ]


def test_named_bytes_take_their_place(meter: Guess) -> None:
    before = told_fields(meter)
    found = named(meter, [FieldNaming("told", 3, 4, "level", "f32"), FieldNaming("told", 7, 1, "status", "bits")])
    assert ("level", 3, 4) in told_fields(found) and ("status", 7, 1) in told_fields(found)
    assert told_fields(meter) == before
    draft = drafted(found, "meter", "line")
    assert draft.problems == ()
    assert "- {field: level, type: f32}  # 40 values, 20 to 29.75" in draft.text
    assert "bits: {status_0: 0, status_1: 1," in draft.text


def test_a_name_for_what_a_reply_repeats_goes_for_both_sides(meter: Guess) -> None:
    found = named(meter, [FieldNaming("told", 1, 1, "station", "u8")])
    assert ("station", 1, 1) in told_fields(found) and ("station", 1, 1) in told_fields(found, "asked")
    text = drafted(found, "meter", "line").text
    assert "echo: [copy_0, station]" in text or "echo: [station]" in text
    found = named(meter, [FieldNaming("asked", 1, 2, "what", "u16")])  # a field over a copy and another byte
    draft = drafted(found, "meter", "line")
    assert draft.problems == () and "copy_1]" not in draft.text


def test_data_of_any_size_has_a_name_and_parts(meter: Guess) -> None:
    data = next(field for kind in meter.kinds if kind.name == "told" for field in kind.fields if not field.size)
    whole = named(meter, [FieldNaming("told", data.offset, 0, "all_of_it", "bytes")])
    assert "of: [all_of_it]" in drafted(whole, "meter", "line").text
    parted = named(meter, [FieldNaming("told", data.offset + 1, 2, "second", "u16", "little")])
    names = [name for name, _, _ in told_fields(parted)]
    assert names[names.index("second") - 1] == "unknown_2" and names[names.index("second") + 1] == data.name
    assert drafted(parted, "meter", "line").problems == ()


@pytest.mark.parametrize(
    ("naming", "told"),
    [
        (FieldNaming("told", 2, 1, "x", "u8"), r"byte 2 of 'told' belongs to the count"),
        (FieldNaming("asked", 4, 2, "x", "u16"), r"bytes 4 to 5 of 'asked' belong to the check"),
        (FieldNaming("asked", 2, 1, "copy_1", "u8"), r"'asked' has a field 'copy_1' already – give another name"),
        (FieldNaming("told", 7, 1, "a-b", "u8"), r"'a-b' is no name – write a letter"),
        (FieldNaming("told", 7, 1, "", "u8"), r"'' is no name"),
        (FieldNaming("told", 7, 1, "x}, {const: 00", "u8"), r"is no name"),
        (FieldNaming("told", 7, 1, "if", "u8"), r"'if' has a meaning of its own"),
        (FieldNaming("told", 7, 1, "x", "u16"), r"byte 7: 1 byte can be no u16"),
        (FieldNaming("told", 3, 4, "x", "text"), r"40 of 40 frames have something else there than a text"),
        (FieldNaming("told", 3, 4, "x", "f32", "up"), r"has no order 'up'"),
        (FieldNaming("told", 3, 4, "x", "hex"), r"there is no type 'hex'"),
        (FieldNaming("told", 13, 4, "x", "f32"), r"not all frames of 'told' have bytes 13 to 16"),
        (FieldNaming("told", 1 << 40, 1, "x", "u8"), r"not all frames of 'told' have byte"),
        (FieldNaming("other", 3, 4, "x", "f32"), r"there is no kind of frames 'other'"),
    ],
)
def test_what_is_refused(meter: Guess, naming: FieldNaming, told: str) -> None:
    with pytest.raises(NamingError, match=told):
        named(meter, [naming])


def test_a_field_does_not_go_over_the_place_where_the_check_begins() -> None:
    rng = random.Random(14)
    frames = []
    for _ in range(40):
        inner = bytes(rng.randrange(256) for _ in range(rng.choice([5, 7])))
        frames.append(bytes([0x55, rng.randrange(8)]) + framed(inner))
    found = guess([HeardBytes(None, "", frame) for frame in frames])
    (kind,) = found.kinds
    assert kind.check is not None and kind.check.place.start == 2
    with pytest.raises(NamingError, match="the check begins to count at byte 2"):
        named(found, [FieldNaming(kind.name, 1, 2, "x", "u16")])
    for words in ("yes", "null", "here", "rest", "body"):
        draft = drafted(named(found, [FieldNaming(kind.name, 2, 2, words, "u16")]), "own", "line")
        assert draft.problems == ()


def test_whatever_is_named_the_definition_reads_all_frames(meter: Guess) -> None:
    rng, accepted = random.Random(12), 0
    for number in range(60):
        kind = rng.choice(["asked", "told"])
        size = rng.choice([1, 2, 4])
        type_ = rng.choice([one for one, what in TYPES.items() if what.takes(size)])
        naming = FieldNaming(kind, rng.randrange(10), size, f"n{number}", type_, rng.choice(orders_of(type_, size)))
        try:
            found = named(meter, [naming])
        except NamingError:
            continue
        accepted += 1
        for each in found.kinds:
            places = [(field.offset, field.size) for field in each.fields if field.offset >= 0]
            assert all(first + size == second for (first, size), (second, _) in pairwise(places))
        if accepted % 5 == 1:
            assert drafted(found, "meter", "line").problems == ()
    assert accepted > 15


def test_types_in_all_orders() -> None:
    data = struct.pack(">f", -2.5)
    swapped = {"big": data, "little": data[::-1], "BADC": data[1::-1] + data[:1:-1], "CDAB": data[2:] + data[:2]}
    assert {order: number_of("f32", order, text) for order, text in swapped.items()} == dict.fromkeys(swapped, -2.5)
    assert number_of("i16", "little", b"\xfe\xff") == -2 and number_of("bcd", "big", b"\x12\x99") == 1299
    assert number_of("bcd", "big", b"\x1a") is None and number_of("f32", "big", b"\x7f\xc0\0\0") is None
    assert types_of([b"12", b"ab"])[0] == ("text", "big") and ("bcd", "big") not in types_of([b"\xfa\0"])


@pytest.mark.parametrize(
    ("form", "keys"),
    [
        ("%+06.1f", ", sign: always, decimals: 1"),
        ("%6.2f", ", pad: 20, decimals: 2"),
        ("%05d", ""),
        ("%5d", ", pad: 20"),
    ],
)
def test_a_number_as_text_is_a_number(form: str, keys: str) -> None:
    frames = [b"\x02T " + (form % (at * 7 % 99 + at % 10 / 10)).encode() + b" C\x03" for at in range(40)]
    found = guess([HeardBytes(None, "", frame) for frame in frames])
    naming = FieldNaming("frame", 3, len(form % 1), "level", "decimal")
    draft = drafted(named(found, [naming]), "meter", "line")
    assert draft.problems == () and f"type: decimal, size: {naming.size}{keys}}}" in draft.text
    assert types_of([frame[3 : naming.end] for frame in frames])[:2] == [("text", "big"), ("decimal", "big")]


def test_text_that_is_no_number_of_one_form_is_no_decimal() -> None:
    assert decimal_keys([b"1.25", b"12.5"]) is None and decimal_keys([b"+1", b"22"]) is None
    assert decimal_keys([b"12", b"-2"]) == "" and decimal_keys([b"1a"]) is None


def test_the_file_is_written_anew_with_each_name(meter: Guess, tmp_path: Path) -> None:
    path = tmp_path / "meter.yaml"
    write_definition(meter, path, "line")
    names = NamedGuess(meter, "meter", "line", path)
    names.give(FieldNaming("told", 3, 4, "level", "f32"))
    names.give(FieldNaming("told", 1, 1, "station", "u8"))
    assert [problem for problem in check_file(str(path)).problems if not problem.warning] == []
    assert all(not case.problems for case in run_vectors(path))
    assert "level" in path.read_text("utf-8") and "station" in path.read_text("utf-8")
    good = path.read_text("utf-8")
    with pytest.raises(NamingError, match="already"):
        names.give(FieldNaming("told", 7, 1, "level", "u8"))
    assert path.read_text("utf-8") == good
    names.give(FieldNaming("told", 3, 2, "high", "u16"))  # the overlapping name `level` is removed
    assert [naming.name for naming in names.namings] == ["station", "high"]
    names.forget("asked", 1)  # the name that the reply got, too
    assert [naming.name for naming in names.namings] == ["high"]
    names.forget("told", 3)
    assert path.read_text("utf-8") == drafted(meter, "meter", "line").text
    assert sorted(file.name for file in tmp_path.iterdir()) == ["meter.vectors.yaml", "meter.yaml"]
    with pytest.raises(NamingError, match="these bytes have no name"):
        names.forget("told", 3)


def test_a_file_that_people_have_changed_is_not_replaced(meter: Guess, tmp_path: Path) -> None:
    path = tmp_path / "meter.yaml"
    write_definition(meter, path, "line")
    names = NamedGuess(meter, "meter", "line", path)
    path.write_text(path.read_text("utf-8") + "# mine\n", "utf-8")
    with pytest.raises(NamingError, match=r"meter\.yaml has been changed since it was written"):
        names.give(FieldNaming("told", 3, 4, "level", "f32"))
    assert path.read_text("utf-8").endswith("# mine\n") and names.namings == []
    path.unlink()
    with pytest.raises(NamingError, match=r"meter\.yaml is gone"):
        names.give(FieldNaming("told", 3, 4, "level", "f32"))


def test_a_name_that_makes_the_definition_wrong_is_refused(
    meter: Guess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("framekit.extras.guess.naming.WORDS", frozenset())
    path = tmp_path / "meter.yaml"
    write_definition(meter, path, "line")
    names = NamedGuess(meter, "meter", "line", path)
    before = path.read_text("utf-8")
    wrong = FieldNaming("told", 1, 1, "if", "u8")
    with pytest.raises(NamingError, match=r"meter\.yaml:\d+:\d+: in the expression"):
        names.give(wrong)
    assert path.read_text("utf-8") == before and names.guess is meter
    assert path.with_name("meter.vectors.yaml").exists()
    assert write_definition(named(meter, [wrong]), path, "line").problems  # the problems that the command line reports
    assert not path.with_name("meter.vectors.yaml").exists()


def test_what_is_no_definition_is_told(tmp_path: Path) -> None:
    with pytest.raises(DraftError, match="no frames were found"):
        drafted(guess([]), "meter", "line")
    with pytest.raises(ProtocolNameError, match="is no name of a protocol"):
        protocol_name(tmp_path / "A B.yaml")

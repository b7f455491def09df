"""Check methods: every catalogue CRC proves its parameters, and all implementations of a method agree."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from operator import or_, xor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from framekit.codec import support
from framekit.codec.checks import compute, function_of, ready_methods, size_of, source_of
from framekit.definition.expression import parse_expression
from framekit.definition.model.checks import MACS, SIMPLE, CatalogueEntry, CheckMethod, crc_catalogue
from framekit.definition.problems import Position
from tests.check_methods import from_crc, from_ready

NINE = b"123456789"
REQUEST = bytes.fromhex("05 32 30 72 53 53 30 31 30 36 25 4D 57 31 30 30 04")


def by_bits(method: CheckMethod, data: bytes) -> int:
    """Compute a CRC by definition: bitwise division of the message as one polynomial."""
    width = method.width
    register = method.initial
    for byte in data:
        for bit in range(8):
            incoming = byte >> (bit if method.refin else 7 - bit) & 1
            register ^= incoming << width - 1
            register = (register << 1) ^ (method.poly | 1 << width if register >> width - 1 else 0)
    if method.refout:
        register = int(f"{register:0{width}b}"[::-1], 2)
    return register ^ method.xorout


# --- catalogue ------------------------------------------------------------------------------------------------------


def test_the_catalogue_is_whole() -> None:
    names = [name for entry in crc_catalogue() for name in (entry.method.name, *entry.aliases)]
    assert len(crc_catalogue()) == 113
    assert len(names) == len(set(names))
    assert all(name == name.lower() for name in names)
    assert set(ready_methods()) == {*names, *(method.name for method in SIMPLE), "lrc", *MACS}


@pytest.mark.parametrize("entry", crc_catalogue(), ids=lambda entry: entry.method.name)
def test_every_crc_gives_its_check_value(entry: CatalogueEntry) -> None:
    assert entry.method.fault() is None
    assert compute(entry.method, NINE) == entry.check
    assert by_bits(entry.method, NINE) == entry.check


@pytest.mark.parametrize("entry", crc_catalogue(), ids=lambda entry: entry.method.name)
def test_every_crc_by_its_own_fast_way_and_by_the_general_one(entry: CatalogueEntry) -> None:
    method = entry.method
    table = support.make_crc_table(method.width, method.poly, method.refin)
    for data in (b"", b"\0", bytes(range(256)), bytearray(REQUEST)):
        general = support.crc(data, table, method.width, method.initial, method.refin, method.refout, method.xorout)
        assert compute(method, data) == general


@given(st.data())
def test_crcs_of_ones_own(data: st.DataObject) -> None:
    width = data.draw(st.integers(1, 64))
    code = st.integers(0, (1 << width) - 1)
    method = from_crc(
        "own",
        width=width,
        poly=data.draw(st.one_of(code, st.sampled_from([0x1021, 0x04C11DB7])).filter(lambda p: 0 < p < 1 << width)),
        init=data.draw(code),
        refin=data.draw(st.booleans()),
        refout=data.draw(st.booleans()),
        xorout=data.draw(code),
    )
    message = data.draw(st.binary(max_size=10))
    assert compute(method, message) == by_bits(method, message)


@pytest.mark.parametrize(("width", "poly"), [(16, 0x1021), (32, 0x04C11DB7)])
@given(st.booleans(), st.booleans(), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF), st.binary(max_size=10))
def test_polynomials_of_the_standard_library_with_any_parameters(
    width: int, poly: int, refin: bool, refout: bool, init: int, xorout: int, data: bytes
) -> None:
    method = from_crc("own", width=width, poly=poly, init=init, refin=refin, refout=refout, xorout=xorout)
    assert compute(method, data) == by_bits(method, data)


def test_aliases_are_the_same_method() -> None:
    ready = ready_methods()
    assert ready["crc16"] is ready["arc"] is ready["crc16-arc"]
    assert ready["crc32"] is ready["crc32-iso-hdlc"]
    assert ready["lrc"] is ready["lrc8"]
    assert ready["x-25"].name == "crc16-ibm-sdlc"


def test_asking_for_names_makes_no_table(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> tuple[int, ...]:
        raise AssertionError("a table was made")

    monkeypatch.setattr(support, "make_crc_table", never)
    crc_catalogue.cache_clear()
    ready_methods.cache_clear()
    assert "crc16-arc" in ready_methods()
    assert source_of(from_ready("crc24")).makers == ("make_crc_table",)


# --- simple methods -------------------------------------------------------------------------------------------------


def test_the_worked_request() -> None:
    assert compute(from_ready("sum16"), REQUEST) == 0x3A4
    assert compute(from_ready("sum8"), REQUEST) == 0xA4
    assert compute(from_ready("sum7"), REQUEST) == 0x24
    assert compute(from_ready("lrc8"), REQUEST) == 0x5C


@given(st.binary(max_size=80))
def test_ready_methods_by_their_definitions(data: bytes) -> None:
    assert compute(from_ready("sum32"), data) == sum(data)
    assert compute(from_ready("xor8"), data) == reduce(xor, data, 0)
    assert compute(from_ready("xor7"), data) == reduce(xor, data, 0) & 0x7F
    assert compute(from_ready("or8"), data) == reduce(or_, data, 0)
    assert compute(from_ready("mul8"), data) == support.multiply(data)
    assert compute(from_ready("wsum16"), data) == support.word_sum_big(data)
    assert compute(from_ready("wsum16-little"), data) == support.word_sum_little(data)
    assert compute(from_ready("wsum32"), data) == support.word_sum_big(data, 0xFFFFFFFF)
    assert compute(from_ready("xor16"), data) == support.xor_words(data, 2)
    assert compute(from_ready("xor16-little"), data) == support.xor_words(data, 2, True)


@pytest.mark.parametrize("kind", ["sum", "word_sum", "xor", "sum7", "xor7", "or", "multiply"])
@given(st.data())
def test_initial_width_complement_and_mask(kind: str, data: st.DataObject) -> None:
    width = data.draw(st.sampled_from([8, 16] if kind == "xor" else [4, 7, 8, 12, 16]))
    code = st.integers(0, (1 << width) - 1)
    method = CheckMethod(
        name="own",
        kind=kind,  # type: ignore[arg-type]
        width=width,
        order=data.draw(st.sampled_from(["big", "little"])),
        initial=data.draw(code),
        complement=data.draw(st.sampled_from([None, "ones", "twos"])),
        mask=data.draw(st.one_of(st.none(), code)),
    )
    assert method.fault() is None
    message = data.draw(st.binary(max_size=20))
    assert compute(method, message) == by_words(method, message)


def by_words(method: CheckMethod, data: bytes) -> int:
    """Compute a simple method word by word, as its docstring defines it."""
    size = 2 if method.kind == "word_sum" else (method.width + 7) // 8 if method.kind == "xor" else 1
    data += b"\0" * (-len(data) % size)
    code = method.initial
    for place in range(0, len(data), size):
        word = int.from_bytes(data[place : place + size], method.order)
        match method.kind:
            case "sum" | "sum7" | "word_sum":
                code += word
            case "xor" | "xor7":
                code ^= word
            case "or":
                code |= word
            case "multiply":
                code *= word
    bits = (1 << (min(method.width, 7) if method.kind in ("sum7", "xor7") else method.width)) - 1
    code = {None: code, "ones": ~code, "twos": -code}[method.complement] & bits
    return code if method.mask is None else code & method.mask


def test_complement_and_mask_of_a_crc() -> None:
    plain = from_ready("crc16-arc")
    code = compute(plain, NINE)
    assert compute(replace(plain, complement="ones"), NINE) == code ^ 0xFFFF
    assert compute(replace(plain, mask=0x00FF), NINE) == code & 0xFF


# --- parameters -----------------------------------------------------------------------------------------------------


def test_sizes() -> None:
    sizes = {"sum8": 1, "sum7": 1, "sum16": 2, "crc16-modbus": 2, "crc24": 3, "crc5-usb": 1, "crc12-umts": 2}
    assert {name: size_of(ready_methods()[name]) for name in sizes} == sizes


def test_adjusted_ready_methods() -> None:
    bcc = from_ready("sum8", name="bcc", complement="twos")
    assert (bcc.name, bcc.complement) == ("bcc", "twos")
    assert compute(bcc, REQUEST) == compute(from_ready("lrc"), REQUEST)
    with pytest.raises(KeyError):
        from_ready("sum9")


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        ({"initial": 256}, "initial 0x100 does not fit into 8 bits"),
        ({"mask": -1}, "mask -0x1 does not fit into 8 bits"),
        ({"width": 0}, "0 bits is not possible"),
        ({"complement": "threes"}, "not 'threes'"),
        ({"order": "middle"}, "not 'middle'"),
        ({"kind": "guess"}, "'guess' is no kind of check"),
        ({"kind": "crc"}, "needs its polynomial"),
        ({"kind": "fold"}, "belongs to a fold"),
        ({"kind": "xor", "width": 12}, "whole bytes"),
    ],
)
def test_parameters_that_do_not_fit(overrides: dict[str, object], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        from_ready("sum8", **overrides)


def test_a_fold_is_left_to_the_compilers() -> None:
    fold = CheckMethod(name="own", kind="fold", expression=parse_expression("acc ^ byte", Position("own.yaml", 1, 1)))
    assert fold.fault() is None
    with pytest.raises(TypeError, match="fold 'own'"):
        compute(fold, NINE)


# --- source ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["sum8", "lrc8", "xor7", "crc16-arc", "crc16-xmodem", "x-25", "crc32", "crc12-umts"])
def test_source_names_everything_it_uses(name: str) -> None:
    method = ready_methods()[name]
    source = source_of(method, "frame[1:]")
    names: dict[str, object] = {name: getattr(support, name) for name in (*source.functions, *source.makers)}
    for line in (*source.imports, *(f"{constant} = {text}" for constant, text in source.constants)):
        exec(line, names)
    names["frame"] = b"#" + NINE
    assert eval(source.expression, names) == compute(method, NINE)


def test_methods_of_one_polynomial_share_their_table() -> None:
    assert source_of(from_ready("crc16-arc")).constants == source_of(from_ready("crc16-modbus")).constants
    assert function_of(from_ready("crc16-arc")) is function_of(from_ready("arc"))


def test_simple_sums_are_written_without_a_call() -> None:
    assert source_of(from_ready("sum8")).expression == "sum(data) & 0xff"
    assert source_of(from_ready("lrc8")).expression == "-sum(data) & 0xff"

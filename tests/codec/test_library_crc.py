"""CRCs of the compiled library: equal to ours on any bytes, for every CRC with a name."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from framekit.codec.checks import function_of, library_crc, residue_of, source_of
from framekit.codec.python.generate import generate_source
from framekit.codec.support import crc, make_crc_table
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.checks import CheckMethod, crc_catalogue
from framekit.definition.model.frames import parts_of
from framekit.definition.model.segments import Check
from framekit.definition.sources import shipped_definitions
from tests.check_methods import from_crc

BY_LIBRARY = [entry.method for entry in crc_catalogue() if library_crc(entry.method) is not None]

OF_THEIR_OWN = {"mstp-header"}
"""Check methods of shipped frames that the library lacks; they are computed by a table."""


def shipped_methods() -> Iterator[CheckMethod]:
    seen = set()
    for path in shipped_definitions():
        if "." not in path.stem:
            for check in parts_of(load_protocol(path.stem).frames, Check):
                if check.method.kind == "crc" and check.method not in seen:
                    seen.add(check.method)
                    yield check.method


def own_code(method: CheckMethod, data: bytes) -> int:
    table = make_crc_table(method.width, method.poly, method.refin)
    return crc(data, table, method.width, method.initial, method.refin, method.refout, method.xorout)


@pytest.mark.parametrize("method", BY_LIBRARY, ids=lambda method: method.name)
def test_the_library_gives_our_codes(method: CheckMethod) -> None:
    choose, computed = random.Random(method.name), function_of(method)
    for size in (0, 1, 2, 3, 6, 25, 255, 1000):
        data = choose.randbytes(size)
        assert computed(data) == own_code(method, data)
        assert computed(bytearray(data)) == own_code(method, data)


def test_every_crc_of_shipped_frames_is_the_librarys() -> None:
    methods = list(shipped_methods())
    assert methods
    for method in methods:
        assert library_crc(method) is not None or method.name in OF_THEIR_OWN, method.name


def test_parameters_that_the_library_does_not_have_are_computed_by_a_table() -> None:
    method = from_crc("own", width=16, poly=0x3D65, init=0x1234, refin=True, refout=True, xorout=0x00FF)
    assert library_crc(method) is None
    data = bytes(range(100))
    assert function_of(method)(data) == own_code(method, data)
    difference = from_crc("other", width=16, poly=0x8005, init=0xFFFF, refin=True, refout=True, xorout=0x1234)
    found = library_crc(difference)
    assert found is not None and found.xor == 0x1234
    assert function_of(difference)(data) == own_code(difference, data)


def test_a_module_that_stands_alone_has_tables_instead() -> None:
    protocol = load_protocol("modbus-rtu")
    assert "fastcrc" not in generate_source(protocol)
    assert "make_crc_words" in generate_source(protocol)
    assert "from fastcrc.crc16 import" in generate_source(protocol, standalone=False)
    assert "make_crc_words" not in generate_source(protocol, standalone=False)
    method = next(shipped_methods())
    assert not any("fastcrc" in line for line in source_of(method).imports)


@pytest.mark.parametrize("method", [entry.method for entry in crc_catalogue()], ids=lambda method: method.name)
def test_over_bytes_with_their_own_code_a_crc_is_always_the_same(method: CheckMethod) -> None:
    """A CRC over data with its own right code is a constant, if the code has the order in which the register shifts."""
    choose, size = random.Random(method.name), method.width // 8
    order = "little" if method.refin else "big"
    residue = residue_of(method, size, order)
    if method.width % 8 or method.refin != method.refout:
        assert residue is None
        return
    for length in (0, 1, 7, 250):
        data = choose.randbytes(length)
        code = own_code(method, data)
        assert function_of(method)(data + code.to_bytes(size, order)) == residue
        assert function_of(method)(data + (code ^ 1).to_bytes(size, order)) != residue
    assert residue_of(method, size + 1, order) is None
    if size > 1:
        assert residue_of(method, size, "big" if order == "little" else "little") is None

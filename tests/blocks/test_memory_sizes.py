"""Sizes that a device file gives to memory areas of its protocol, also to areas that differ by address only."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.definition.problems import DefinitionError
from framekit.link.addresses import AddressError
from framekit.runfile.devices import Device, DeviceSettings, load_devices

FILE = "device: one\nprotocol: {protocol}\nrole: {role}\nstation: 1\nmemory: {memory}\n"


def device(folder: Path, memory: str, protocol: str = "df1", role: str = "full") -> Device:
    path = folder / "one.device.yaml"
    path.write_text(FILE.format(protocol=protocol, role=role, memory=memory))
    return load_devices(path, folder)[0]


def test_an_area_is_as_large_as_said_or_not_there(tmp_path: Path) -> None:
    made = device(tmp_path, '{sizes: {"N7:0": 20, "N10:0": 3, "T20:0": 2, "F8:0": 0}, set: {"N10:2": 5}}')
    memory = made.create_memory()
    assert {name: memory.area(name).size for name in ("file7", "file10", "file20")} == {
        "file7": 20, "file10": 3, "file20": 2,
    }  # fmt: skip
    assert memory.area("file20").unit == "6 bytes"
    assert memory.read("file10", "word", 0, 3) == [0, 0, 5]
    assert memory.area("file3").size == 1000, "others keep the protocol's size"
    with pytest.raises(LookupError):
        memory.area("file8")
    assert made.areas_without_memory() == []


def test_start_values_are_of_the_type_of_their_place(tmp_path: Path) -> None:
    made = device(tmp_path, '{set: {"F8:0": [1.5, -2, 0x3F800000], "PD13:0.SP": 0.5, "N7:0": -2}}')
    memory = made.create_memory()
    assert memory.read("file8", "dword", 0, 3) == [0x3FC00000, 0xC0000000, 0x3F800000]
    assert memory.read("file7", "word", 0, 1) == [0xFFFE]
    with pytest.raises(DefinitionError, match=r"'1\.5' is not a whole number"):
        device(tmp_path, '{set: {"N7:0": 1.5}}')
    with pytest.raises(DefinitionError, match="'nan' is no float32"):
        device(tmp_path, '{set: {"F8:0": nan}}')


def test_places_are_judged_by_the_sizes(tmp_path: Path) -> None:
    grammar = device(tmp_path, '{sizes: {"N7:0": 2000, "N10:0": 3}}').grammar
    assert grammar.parse("N7:1999").start == 1999
    for text, why in [("N7:2000", "has word 0 to 1999"), ("N10:3", "has word 0 to 2"), ("N21:0", "does not have")]:
        with pytest.raises(AddressError, match=why):
            grammar.parse(text)


def test_a_size_in_the_unit_of_the_address(tmp_path: Path) -> None:
    memory = device(tmp_path, '{sizes: {"000": 64}}').create_memory()
    assert memory.area("PLC2").size_bits == 64 * 16


def test_sizes_of_settings_are_added_to_those_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "one.device.yaml"
    path.write_text(FILE.format(protocol="df1", role="full", memory='{sizes: {"N7:0": 20, "N10:0": 3}}'))
    (made,) = load_devices(path, tmp_path, DeviceSettings(sizes={"N10:0": "5", "N11:0": "7"}))
    memory = made.create_memory()
    assert [memory.area(f"file{number}").size for number in (7, 10, 11)] == [20, 5, 7]


def test_other_protocols_have_sizes_too(tmp_path: Path) -> None:
    memory = device(tmp_path, "{sizes: {40001: 10}}", "modbus-rtu", "server").create_memory()
    assert memory.area("holding").size == 10


def test_a_start_value_in_an_area_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DefinitionError, match="N20:0 is in file20, which this memory does not have"):
        device(tmp_path, '{set: {"N20:0": 1}}')

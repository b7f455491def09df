"""The protocol of a device: shared with all other devices, unless the device has rules of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.definition.load.protocol import load_protocol
from framekit.definition.problems import DefinitionError
from framekit.runfile.devices import load_devices


def device(folder: Path, more: str = "", protocol: str = "modbus-rtu") -> Path:
    path = folder / "one.device.yaml"
    path.write_text(f"device: one\nprotocol: {protocol}\nstation: 1\n{more}", encoding="utf-8")
    return path


@pytest.mark.parametrize("more", ["", "params: {limit_write_words: 12}\nmemory: {set: {40001: 5}}\n"])
def test_devices_without_rules_share_the_protocol(tmp_path: Path, more: str) -> None:
    found = load_devices(device(tmp_path, more), tmp_path)[0]
    assert found.protocol is load_protocol("modbus-rtu")
    assert found.name == "one"


def test_a_device_with_rules_has_a_protocol_for_itself(tmp_path: Path) -> None:
    found = load_devices(device(tmp_path, "state: {counted: {scope: device, type: u32}}\n"), tmp_path)[0]
    assert found.protocol is not load_protocol("modbus-rtu")
    assert "counted" in found.protocol.state and "counted" not in load_protocol("modbus-rtu").state


@pytest.mark.parametrize(
    ("protocol", "says"),
    [
        ("commreq", "'commreq' has no line of its own"),
        ("broken", "unknown key"),
        ("nobody", "there is no definition 'nobody'"),
    ],
)
def test_a_protocol_that_is_none_is_told(tmp_path: Path, protocol: str, says: str) -> None:
    (tmp_path / "broken.yaml").write_text("protocol: broken\nframe: {}\n", encoding="utf-8")
    with pytest.raises(DefinitionError) as caught:
        load_devices(device(tmp_path, protocol=protocol), tmp_path)[0]
    assert says in str(caught.value)

"""The name of a line is the same for all spellings of a device, or of a host and port."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.transport.schemes import line_of


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("COM3", "com3:"),
        ("COM12", r"\\.\COM12"),
        ("tcp://Gateway:4001", "tcp://gateway:4001"),
        ("tcp://gateway:4001", "rfc2217://gateway:4001?logging=debug"),
        ("/dev/ttyS0", "spy:///dev/ttyS0?file=traffic.txt"),
        ("/dev/ttyS0", "/dev/../dev/ttyS0"),
    ],
)
def test_spellings_of_a_line(one: str, other: str) -> None:
    assert line_of(one) == line_of(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("COM3", "COM4"),
        ("tcp://gateway:4001", "tcp://gateway:4002"),
        ("/dev/ttyS0", "/dev/ttyS1"),
        ("sim:one.device.yaml", "sim:two.device.yaml"),
    ],
)
def test_different_lines(one: str, other: str) -> None:
    assert line_of(one) != line_of(other)


def test_a_link_to_a_device(tmp_path: Path) -> None:
    device, link = tmp_path / "ttyUSB0", tmp_path / "by-id"
    device.touch()
    link.symlink_to(device)
    assert line_of(str(link)) == line_of(str(device)) == str(device.resolve())

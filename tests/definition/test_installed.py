"""Entry points of installed packages: the library for them is imported only if a metadata file names the group."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import pytest

from framekit.definition.installed import entry_points_of, may_name

GROUP = "framekit.made_up"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Create a folder, the only entry of `sys.path`, with a package of another entry point group."""
    other = tmp_path / "other-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text(f"[{GROUP}.other]\nlamp = lamp\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), str(tmp_path / "missing")])
    return tmp_path


@pytest.mark.parametrize("folder", ["acme-1.0.dist-info", "Acme.egg-info", "EGG-INFO"])
def test_a_group_is_found_in_every_kind_of_metadata(site: Path, folder: str) -> None:
    assert not may_name(GROUP) and entry_points_of(GROUP) == []
    (site / folder).mkdir()
    (site / folder / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.0\n")
    (site / folder / "PKG-INFO").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.0\n")
    (site / folder / "entry_points.txt").write_text(f"[{GROUP}]\nlamp = acme:LAMP\n")
    assert may_name(GROUP)
    if folder != "EGG-INFO":  # EGG-INFO only counts inside a folder `NAME.egg`
        assert [(point.name, point.value) for point in entry_points_of(GROUP)] == [("lamp", "acme:LAMP")]


def test_an_archive_on_the_path_may_name_any_group(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = site / "acme.whl"
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("acme-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: acme\nVersion: 1.0\n")
        file.writestr("acme-1.0.dist-info/entry_points.txt", f"[{GROUP}]\nlamp = acme:LAMP\n")
    monkeypatch.setattr(sys, "path", [str(site), str(archive)])
    assert [point.name for point in entry_points_of(GROUP)] == ["lamp"]


def test_a_finder_of_its_own_may_name_any_group(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Finder:
        """A finder of packages outside of `sys.path`."""

        def find_distributions(self, context: object) -> list[object]:
            return []

    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path, Finder()])
    assert may_name(GROUP) and entry_points_of(GROUP) == []

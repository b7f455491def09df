"""Modules of installed extension packages: imported before a definition is read; a failed import is reported."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from framekit.codec.cache import cache_folder, cached_codec
from framekit.definition import brought, schema
from framekit.definition.load import protocol as library
from framekit.definition.load.protocol import load_protocol
from framekit.definition.problems import DefinitionError

SMALL = "protocol: small\nframes:\n  one: {body: [{const: 01}]}\n"


@pytest.fixture
def small(tmp_path: Path) -> Iterator[Path]:
    file = tmp_path / "small.yaml"
    file.write_text(SMALL)
    brought.import_installed.cache_clear()
    yield file
    brought.import_installed.cache_clear()


def installed(folder: Path, monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    """Write the metadata of a package with that extension to a folder of `sys.path`."""
    info = folder / "site" / "made_up-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: made-up\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{brought.ENTRY_POINTS}]\nmade-up = {module}\n")
    monkeypatch.syspath_prepend(str(info.parent))


def test_an_installed_extension_is_imported(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (small.parent / "made_up_extension.py").write_text("MARK = 1\n")
    monkeypatch.syspath_prepend(str(small.parent))
    installed(small.parent, monkeypatch, "made_up_extension")
    load_protocol(str(small))
    assert sys.modules.pop("made_up_extension").MARK == 1


def test_an_extension_that_cannot_be_used_is_told(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(small.parent, monkeypatch, "no_such_extension")
    with pytest.raises(DefinitionError) as caught:
        load_protocol(str(small))
    assert str(caught.value) == (
        f"{small}:1:1: the extension 'made-up' of no_such_extension can't be used: ModuleNotFoundError: "
        "No module named 'no_such_extension' – mend it, or remove that package"
    )


def test_what_was_kept_counts_no_more_when_a_brought_module_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "made_up_kind.py"
    file.write_text("MARK = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(brought, "MODULES", [])
    assert brought.states() == []
    __import__("made_up_kind")
    brought.bring("made_up_kind")
    before = brought.states()
    file.write_text("MARK = 22\n")
    del sys.modules["made_up_kind"]
    assert len(before) == 1
    assert brought.states() != before


@pytest.fixture
def counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Record the kinds of files that are validated by their schema, with a separate cache."""
    monkeypatch.setenv("FRAMEKIT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(brought, "MODULES", [])
    found: list[str] = []
    validator = schema._validator

    def noting(kind: schema.Kind) -> object:
        found.append(kind)
        return validator(kind)

    monkeypatch.setattr(schema, "_validator", noting)
    return found


def new_process() -> None:
    """Reset all import and load caches, as if a process began."""
    library._kept.clear()
    brought.import_installed.cache_clear()
    brought.MODULES.clear()
    sys.modules.pop("made_up_bringer", None)


BRINGER = "from framekit.definition.brought import bring\nbring(__name__)\n"


@pytest.mark.skipif(cache_folder() is None, reason="nothing is kept here")
def test_with_an_extension_a_definition_is_compiled_once(
    small: Path, counted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (small.parent / "made_up_bringer.py").write_text(BRINGER)
    monkeypatch.syspath_prepend(str(small.parent))
    installed(small.parent, monkeypatch, "made_up_bringer")
    for _ in range(3):
        new_process()
        cached_codec(small, small.parent)
    new_process()
    assert counted == ["protocol"]


@pytest.mark.parametrize("text", [BRINGER, "1 / 0\n"], ids=["whole", "broken"])
@pytest.mark.skipif(cache_folder() is None, reason="nothing is kept here")
def test_what_was_kept_before_an_extension_came_counts_no_more(
    text: str, small: Path, counted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    cached_codec(small, small.parent)
    (small.parent / "made_up_bringer.py").write_text(text)
    monkeypatch.syspath_prepend(str(small.parent))
    installed(small.parent, monkeypatch, "made_up_bringer")
    new_process()
    if text == BRINGER:
        cached_codec(small, small.parent)
    else:
        with pytest.raises(DefinitionError, match="the extension 'made-up' of made_up_bringer can't be used: ZeroDiv"):
            cached_codec(small, small.parent)
    new_process()
    assert counted == ["protocol", "protocol"]

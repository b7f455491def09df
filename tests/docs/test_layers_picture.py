"""The picture of the layers shows the layers of the contract that lint-imports checks."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _tools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))


def test_it_names_all_layers_and_extras_in_order() -> None:
    import layers_picture

    texts = [element.text for element in ElementTree.fromstring(layers_picture.picture()).iter() if element.text]
    names = [layer.name for layer in layers_picture.layers()]
    assert names[0] == "extras" and names[-1] == "definition" and len(names) == 12
    assert [text for text in texts if text in names] == names
    assert set(layers_picture.extras()) <= set(texts)


def test_the_picture_of_the_docs_is_the_newest() -> None:
    import layers_picture

    shown = layers_picture.PICTURE.read_text("utf-8")
    assert shown == layers_picture.picture(), "run python tools/layers_picture.py"

"""The picture of the layers: `python tools/layers_picture.py` writes `docs/images/layers.svg`.

The layers and their order are those of the contract in `pyproject.toml`; the sentence of a layer is the first of its
package; the boxes of the extras are the folders of `framekit/extras`.
"""

from __future__ import annotations

import ast
import tomllib
from html import escape
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "images" / "layers.svg"
WIDTH, BAR, GAP, EDGE = 920, 40, 8, 16
NAME_WIDTH, BOX = 130, 22
"""Pixels: width of the picture; height of a layer, of a gap, margin; width of a name; height of the box of an extra."""
STYLE = """\
.back { fill: #ffffff } .bar { fill: #eef2f7; stroke: #c3ccd8 } .extra { fill: #e3f1ea; stroke: #a9cdb9 }
text { font-family: system-ui, "DejaVu Sans", sans-serif; font-size: 13px; fill: #1d2733 }
.name { font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-weight: 600 }
.small { font-size: 12px; fill: #55606e } .arrow { stroke: #55606e; fill: none; stroke-width: 1.5 }
@media (prefers-color-scheme: dark) {
.back { fill: #14181d } .bar { fill: #1f2630; stroke: #3a4553 } .extra { fill: #1d2f27; stroke: #3b5a4b }
text { fill: #e4e9ef } .small { fill: #9aa6b4 } .arrow { stroke: #9aa6b4 } }"""


class Layer(NamedTuple):
    """A layer: its package, and the first sentence of its docstring."""

    name: str
    sentence: str


def layers() -> list[Layer]:
    """Return the layers of the contract, the highest first, without single modules."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    (contract,) = (
        contract for contract in settings["tool"]["importlinter"]["contracts"] if contract["type"] == "layers"
    )
    folders = [ROOT / name.replace(".", "/") for name in contract["layers"]]
    return [_layer(folder) for folder in folders if folder.is_dir()]


def _layer(folder: Path) -> Layer:
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text("utf-8"))) or ""
    return Layer(folder.name, " ".join(text.split()).split(". ")[0].rstrip("."))


def extras() -> list[str]:
    """Return the names of the extras."""
    return sorted(path.parent.name for path in (ROOT / "framekit" / "extras").glob("*/__init__.py"))


def picture() -> str:
    """Return the SVG: a bar for each layer, and a box for each extra within the first."""
    lines: list[str] = []
    top = EDGE
    for layer in layers():
        boxes = _boxes(extras(), top + BAR) if layer.name == "extras" else []
        height = BAR + (boxes[-1][1] + BOX + GAP - top - BAR if boxes else 0)
        lines.append(
            f'<rect class="bar" x="{EDGE + 24}" y="{top}" width="{WIDTH - 2 * EDGE - 24}" height="{height}" rx="6"/>'
        )
        lines.append(_text("name", EDGE + 38, top + 25, layer.name))
        lines.append(_text("", EDGE + 38 + NAME_WIDTH, top + 25, layer.sentence))
        for left, high, wide, name in boxes:
            lines.append(f'<rect class="extra" x="{left}" y="{high}" width="{wide}" height="{BOX}" rx="4"/>')
            lines.append(_text("small", left + 8, high + 15, name))
        top += height + GAP
    bottom = top - GAP
    arrow = f"M {EDGE + 10} {EDGE + 4} V {bottom - 6} m -5 -8 l 5 8 l 5 -8"
    lines.append(f'<path class="arrow" d="{arrow}"/>')
    lines.append(
        _text(
            "small",
            EDGE + 24,
            bottom + 22,
            "A layer imports only layers below it. The core, all below extras, imports no extra.",
        )
    )
    size = f'viewBox="0 0 {WIDTH} {bottom + 36}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img" aria-label="The layers of framekit">'
    back = f'<rect class="back" width="{WIDTH}" height="{bottom + 36}"/>'
    return "\n".join([head, f"<style>\n{STYLE}\n</style>", back, *lines, "</svg>", ""])


def _boxes(names: list[str], top: int) -> list[tuple[int, int, int, str]]:
    """Return left, top and width of the box of each extra, in rows."""
    boxes: list[tuple[int, int, int, str]] = []
    first = left = EDGE + 38
    for name in names:
        wide = 18 + 7 * len(name)
        if left + wide > WIDTH - 2 * EDGE:
            left, top = first, top + BOX + GAP
        boxes.append((left, top, wide, name))
        left += wide + GAP
    return boxes


def _text(kind: str, left: int, base: int, text: str) -> str:
    return f'<text class="{kind}" x="{left}" y="{base}">{escape(text)}</text>'


if __name__ == "__main__":
    PICTURE.write_text(picture(), "utf-8")
    print(PICTURE.relative_to(ROOT))

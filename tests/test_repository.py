"""Rules that hold for the whole repository: no protocol's name in the code, layers, sizes of modules."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CODE = sorted((ROOT / "framekit").rglob("*.py"))
NAMES = re.compile(r"\b(mldp|modbus|snpx?|snp-x|df1|pccc|ccm|srtp|xgt|commreq)\b", re.IGNORECASE)
LAYERS = ["definition", "codec", "memory", "link", "transport", "run", "runfile", "service", "api", "cli"]


VERB = re.compile(r'^    "commreq": "')
"""A verb that users know by the name of the instruction it stands for."""


def test_no_protocol_is_named_in_the_code() -> None:
    named = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in CODE
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if NAMES.search(line) and not VERB.match(line)
    ]
    assert named == []


@pytest.mark.parametrize("path", CODE, ids=lambda path: str(path.relative_to(ROOT / "framekit")))
def test_imports_point_down_only(path: Path) -> None:
    layer = path.relative_to(ROOT / "framekit").parts[0]
    if layer not in LAYERS:
        return
    above = LAYERS[LAYERS.index(layer) + 1 :]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for module in modules:
            parts = module.split(".")
            assert parts[0] != "framekit" or len(parts) < 2 or parts[1] not in above, f"{path}: {module}"


def test_every_module_says_what_it_is_for() -> None:
    silent = [
        str(path.relative_to(ROOT))
        for path in CODE
        if not ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert silent == []

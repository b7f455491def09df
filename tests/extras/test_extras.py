"""The core works without the extras: no module outside `framekit/extras` imports them when it is imported."""

import ast
from pathlib import Path

import pytest

from framekit.cli import verb_table
from framekit.table_of_extras import EXTRAS, GENERATORS, IMPORTERS, OPTIONS, SCHEMAS, SECTIONS, load

ROOT = Path(__file__).parents[2] / "framekit"


def imported_at_once(tree: ast.Module) -> list[str]:
    """Return the modules that a module imports when it is imported, without imports for type checkers."""
    found: list[str] = []
    pending: list[ast.AST] = list(tree.body)
    while pending:
        node = pending.pop()
        if isinstance(node, ast.Import):
            found += [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [node.module or "", *(f"{node.module}.{name.name}" for name in node.names)]
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            pending += node.orelse
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            pending += ast.iter_child_nodes(node)
    return found


def test_only_functions_import_extras() -> None:
    outside = [path for path in ROOT.rglob("*.py") if (ROOT / "extras") not in path.parents]
    imports = {path: imported_at_once(ast.parse(path.read_text("utf-8"))) for path in outside}
    assert len(imports) > 200
    assert [
        str(path) for path, names in imports.items() if any(f"{name}.".startswith("framekit.extras.") for name in names)
    ] == []


def test_imports_in_classes_and_conditions_count() -> None:
    at_once = "if True:\n    import a\nclass B:\n    from c import d\n"
    text = at_once + "if TYPE_CHECKING:\n    import e\ndef f():\n    import g\n"
    assert sorted(imported_at_once(ast.parse(text))) == ["a", "c", "c.d"]


def test_each_folder_of_extras_has_a_row() -> None:
    folders = {path.name for path in (ROOT / "extras").iterdir() if (path / "__init__.py").exists()}
    assert folders == EXTRAS.keys()


BROUGHT = [
    *(target for table in (OPTIONS, SECTIONS, SCHEMAS) for target in table.values()),
    *(row.target for table in (GENERATORS, IMPORTERS) for row in table.values()),
]


@pytest.mark.parametrize("target", BROUGHT)
def test_what_an_extra_brings_exists(target: str) -> None:
    assert callable(load(target))


def test_help_names_the_verbs_of_an_extra_without_its_library_and_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name in ("starlette", "textual") else object())
    lines = [line for line in verb_table.overview().splitlines() if "pip install" in line]
    assert len(lines) == 1
    assert lines[0].startswith("  edit ") and lines[0].endswith("– first pip install 'framekit[web]'")


def test_extras_that_need_libraries_are_named_as_their_pip_extra() -> None:
    assert [name for name, extra in EXTRAS.items() if extra.library] == ["web", "screen"]
    assert all(extra.pip == (name if extra.library else "") for name, extra in EXTRAS.items())

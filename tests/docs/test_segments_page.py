"""`docs/segments.md` is what its generator makes of the cases."""

from __future__ import annotations

import importlib.util
from pathlib import Path

HERE = Path(__file__).parent


def test_the_page_is_up_to_date() -> None:
    spec = importlib.util.spec_from_file_location("segments_table", HERE / "segments_table.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PAGE.read_text(encoding="utf-8") == module.page(), "run python tests/docs/segments_table.py"

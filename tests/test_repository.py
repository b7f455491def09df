"""Rules for the whole repository: the code names no protocol, and every module has a docstring."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
CODE = sorted((ROOT / "framekit").rglob("*.py"))
NAMES = re.compile(r"\b(mldp|modbus|snpx?|snp-x|df1|pccc|ccm|srtp|xgt|commreq)\b", re.IGNORECASE)


COMMAND_BLOCKS = re.compile(
    r"framekit[./]extras[./]commreq|commreq\.(section|jobs|job_profiles)|commreq_verb|(add|run)_commreq|[`\"]commreq[`\"]"
    r"|framekit commreq"
)
"""References to the extra and its verb, which users know by the name of the instruction."""


def test_no_protocol_is_named_in_the_code() -> None:
    named = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in CODE
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if NAMES.search(COMMAND_BLOCKS.sub("", line))
    ]
    assert named == []


def test_every_module_says_what_it_is_for() -> None:
    silent = [
        str(path.relative_to(ROOT))
        for path in CODE
        if not ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert silent == []

"""What the short tests try of a large matrix: a sample, spread over all of it. The long tests try the whole."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

TRANSFERS = [100, pytest.param(1000, marks=pytest.mark.long)]
"""So many transfers of all sizes."""


def spread(cases: Iterable[Any], every: int) -> list[Any]:
    """For `parametrize`: one case in `every` is short, from the first on; the others are long."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=[pytest.mark.long] if place % every else [])
        for place, case in enumerate(cases)
    ]

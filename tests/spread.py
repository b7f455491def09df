"""What the short tests try of a large matrix: a sample, spread over all of it. The long tests try the whole."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

TRANSFERS = [100, pytest.param(300, marks=pytest.mark.long)]
"""So many transfers of all sizes."""

LARGE = {"df1", "pccc", "snp", "srtp"}
"""Protocols that take seconds to load and compile: the short tests of services have them."""


def spread(cases: Iterable[Any], every: int, first: int = 0) -> list[Any]:
    """For `parametrize`: one case in `every` is short, from `first` on; the others are long, and so are large ones."""
    found, short = [], first
    for place, case in enumerate(cases):
        values = case if isinstance(case, tuple) else (case,)
        is_short = place >= short and not any(isinstance(value, str) and value in LARGE for value in values)
        if is_short:
            short = max(short, first) + every
        found.append(pytest.param(*values, marks=[] if is_short else [pytest.mark.long]))
    return found

"""Select samples of a large test matrix: short tests run an evenly spread sample, long tests run the whole matrix."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import pytest

TRANSFERS = [100, pytest.param(300, marks=pytest.mark.long)]
"""Numbers of transfers of all sizes."""

LARGE = {"df1", "pccc", "snp", "srtp"}
"""Protocols that take seconds to load and compile; the short tests of services use them."""


WHOLE = "FRAMEKIT_WHOLE" in os.environ
"""Whether the long tests try all cases of the largest matrices (minutes to hours), or only a part."""


def many(usual: int, whole: int) -> int:
    """Return how many cases a long test tries: `usual`, or `whole` with `FRAMEKIT_WHOLE`."""
    return whole if WHOLE else usual


def spread(cases: Iterable[Any], every: int, first: int = 0, part: int = 1) -> list[Any]:
    """Select cases for `parametrize`: one case in `every` is short, from `first` on.

    The others are long, and so are large cases. For a matrix too large for the long tests, one case in `part` is
    selected, unless the whole matrix is requested.
    """
    found, short = [], first
    for place, case in enumerate([*cases][:: 1 if WHOLE else part]):
        values = case if isinstance(case, tuple) else (case,)
        is_short = place >= short and not any(isinstance(value, str) and value in LARGE for value in values)
        if is_short:
            short = max(short, first) + every
        found.append(pytest.param(*values, marks=[] if is_short else [pytest.mark.long]))
    return found

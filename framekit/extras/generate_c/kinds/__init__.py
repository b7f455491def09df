"""Write C for each kind of segment: a module for one or several similar kinds, and rows in `KINDS`."""

from collections.abc import Mapping

from framekit.definition.model.segments import Segment
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.kinds import (
    bits,
    check,
    choose,
    const,
    counted,
    data,
    field,
    inner,
    repeat,
    value,
    wrap,
)

MODULES = (bits, check, choose, const, counted, data, field, inner, repeat, value, wrap)
KINDS: Mapping[type[Segment], CKind] = {kind.model: kind for module in MODULES for kind in module.KINDS}
"""The row of each kind, by its model class."""

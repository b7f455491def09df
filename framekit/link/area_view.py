"""What the word `area` means in expressions: the name of an area that has the definition's columns behind a dot.

Used by addresses and by service rows. It knows no memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.definition.model.services import Area
from framekit.definition.model.values import Constant, Table
from framekit.link.variables import table_values


class AreaView(str):
    """An area's name. `area.COLUMN` is its value; a column that names a table is that table."""

    columns: Mapping[str, Any]

    def language_attribute(self, name: str) -> Any:
        """Raises KeyError for a column the area does not have."""
        return self.columns[name]


def area_views(areas: Mapping[str, Area], tables: Mapping[str, Table]) -> dict[str, AreaView]:
    """The views of all areas."""
    values = {name: table_values(table) for name, table in tables.items()}

    def column(value: Constant) -> Any:
        return values[value] if isinstance(value, str) and value in values else value

    views = {}
    for name, area in areas.items():
        view = AreaView(name)
        view.columns = {"size": area.size, **{key: column(value) for key, value in area.columns.items()}}
        views[name] = view
    return views


def code_of(area: Area, unit: str) -> Constant | None:
    """What names the area on the wire when it is addressed in `unit`; an only code stands for every unit."""
    if unit in area.codes:
        return area.codes[unit]
    return next(iter(area.codes.values())) if len(area.codes) == 1 else None

"""Numbers in files for places that usually hold a type of number: `1.5` for a place of floating-point numbers.

How they travel is not known here.
"""

from __future__ import annotations

import re

from framekit.definition.load.reader import Reader
from framekit.definition.nodes import Node
from framekit.memory.errors import MemoryValueError
from framekit.memory.views import NumberView, view_of

_FRACTION = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")


def number_for(reader: Reader, node: Node, type_: str | None) -> int:
    """What an element holds for the number that stands there: the number itself where the place has no type.

    `0x…` is always what the element holds. Raises Broken.
    """
    text = reader.text(node)
    view = None if type_ is None or "x" in text.lower() else view_of(type_)
    if not isinstance(view, NumberView):
        return reader.number(node)
    if view.kind == "float" and not _FRACTION.fullmatch(text.strip()):
        raise reader.broken(node.at, f"'{text}' is no {type_}", "write a number such as 1.5")
    try:
        number = float(text) if view.kind == "float" else reader.number(node)
        return int.from_bytes(view.write([number]), "little")
    except MemoryValueError as error:
        raise reader.broken(node.at, str(error), "correct it") from None

"""Values in files for places that usually hold a type: `1.5` where floating-point numbers stand, texts where texts do.

How they travel is not known here.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from framekit.definition.load.reader import Reader
from framekit.definition.model.services import COUNTED_STRING
from framekit.definition.nodes import Node
from framekit.link.addresses import Address
from framekit.memory.memory import MemoryValueError
from framekit.memory.views import CountedTextView, NumberView, view_of

_FRACTION = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")


def number_for(reader: Reader, node: Node, place: Address | None) -> int:
    """What an element at a place holds for what stands there: the number itself where nothing says its type.

    `0x…` is always what the element holds, but for texts. Raises Broken.
    """
    text = reader.text(node)
    type_ = None if place is None else place.type
    if place is not None and type_ == COUNTED_STRING:
        texts = CountedTextView(place.unit_bits // 8)
        return _element(reader, node, lambda: texts.write([text]))
    view = None if type_ is None or "x" in text.lower() else view_of(type_)
    if not isinstance(view, NumberView):
        return reader.number(node)
    if view.kind == "float" and not _FRACTION.fullmatch(text.strip()):
        raise reader.broken(node.at, f"'{text}' is no {type_}", "write a number such as 1.5")
    number = float(text) if view.kind == "float" else reader.number(node)
    return _element(reader, node, lambda: view.write([number]))


def _element(reader: Reader, node: Node, write: Callable[[], bytes]) -> int:
    """The element with these bytes. Raises Broken for a value that does not fit."""
    try:
        return int.from_bytes(write(), "little")
    except MemoryValueError as error:
        raise reader.broken(node.at, str(error), "correct it") from None

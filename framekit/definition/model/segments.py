"""The segments of a frame, one class a kind. Guide: segments.

A new kind is a module of `definition/kinds`, and a row of the list below. Sizes are in bytes unless a docstring gives
another unit.
"""

from __future__ import annotations

from framekit.definition.kinds.base import Segment, Segments, add_kind, lack_default, sizes_of
from framekit.definition.kinds.bits import Bits, BitsPart
from framekit.definition.kinds.check import Check
from framekit.definition.kinds.choose import Choose, Optional
from framekit.definition.kinds.const import Const, Fill, Skip, TextKeys
from framekit.definition.kinds.counted import Count, Length
from framekit.definition.kinds.data import Data
from framekit.definition.kinds.field import Field, Long
from framekit.definition.kinds.inner import Inner, Nested
from framekit.definition.kinds.repeat import (
    INDEX,
    ITEM_WORDS,
    LAST,
    PLAIN,
    PREVIOUS,
    IncludeKeys,
    ItemEnd,
    Record,
    Repeat,
)
from framekit.definition.kinds.value import Require, Value
from framekit.definition.kinds.wrap import Wrap
from framekit.definition.load.reader import MOST_BYTES
from framekit.definition.wire_types import ANY, NOTHING, FieldType, Order, Size, Sizes, either, exactly, of_any_frame

add_kind(
    Field, IncludeKeys, Const, Data, TextKeys, Length, Count, Bits, Repeat, Check, Skip, Require, Value, Inner, Wrap,
    Choose, Optional,
)  # fmt: skip

__all__ = [
    "ANY", "INDEX", "ITEM_WORDS", "LAST", "MOST_BYTES", "NOTHING", "PLAIN", "PREVIOUS", "Bits", "BitsPart", "Check",
    "Choose", "Const", "Count", "Data", "Field", "FieldType", "Fill", "Inner", "ItemEnd", "Length", "Long", "Nested",
    "Optional", "Order", "Record", "Repeat", "Require", "Segment", "Segments", "Size", "Sizes", "Skip", "Value",
    "Wrap", "either", "exactly", "lack_default", "of_any_frame", "sizes_of",
]  # fmt: skip

"""Import every segment kind and register it.

To add a kind, write a module in this package and add its class to the list below.
"""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind, register
from framekit.codec.kinds.bits import BitsKind
from framekit.codec.kinds.check import CheckKind
from framekit.codec.kinds.choose import ChooseKind, OptionalKind
from framekit.codec.kinds.const import ConstKind, FillKind, SkipKind
from framekit.codec.kinds.counted import CountKind, LengthKind
from framekit.codec.kinds.data import DataKind
from framekit.codec.kinds.field import FieldKind
from framekit.codec.kinds.inner import InnerKind, NestedKind
from framekit.codec.kinds.repeat import ItemEndKind, RecordKind, RepeatKind
from framekit.codec.kinds.value import RequireKind, ValueKind
from framekit.codec.kinds.wrap import WrapKind

__all__ = ["SegmentKind", "register"]

register(
    ConstKind,
    SkipKind,
    FillKind,
    FieldKind,
    LengthKind,
    CountKind,
    BitsKind,
    DataKind,
    ValueKind,
    RequireKind,
    CheckKind,
    RecordKind,
    RepeatKind,
    ItemEndKind,
    ChooseKind,
    OptionalKind,
    WrapKind,
    InnerKind,
    NestedKind,
)

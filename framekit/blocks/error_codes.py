"""The codes that a block's failures have in memory: one table for all protocols, `error_codes.csv`.

Every outcome of an exchange has a word from FF01 on. A device that refuses has a code of its own, which goes before the
table's where a word can hold it. No protocol's codes are known here.
"""

from __future__ import annotations

import csv
import enum
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

TABLE = Path(__file__).with_name("error_codes.csv")
FIRST_OWN = 0xFF00
"""Words from here on are framekit's own; those below are the codes of devices."""


class ErrorCode(enum.IntEnum):
    """framekit's word for each way an exchange can fail; the table says what it means and what to do."""

    NONE = 0
    NO_REPLY = 0xFF01
    TIMEOUT = 0xFF02
    DAMAGED_REPLY = 0xFF03
    UNFIT_REPLY = 0xFF04
    EXHAUSTED = 0xFF05
    DAMAGED_FRAME = 0xFF06
    LATE_REPLIES = 0xFF07
    REFUSED = 0xFF10
    CLOSED = 0xFF20
    CANCELLED = 0xFF21
    ABANDONED = 0xFF22
    NO_SEQUENCE = 0xFF23
    QUEUE_FULL = 0xFF24
    EXPRESSION = 0xFF25
    CIRCLE = 0xFF26
    CANNOT_STORE = 0xFF30
    CANNOT_SEND = 0xFF31
    BAD_SETTING = 0xFF32
    NOT_ALLOWED = 0xFF33
    DEAD = 0xFF40
    INTERRUPTED = 0xFF41
    FAILED = 0xFFFF


@dataclass(frozen=True, slots=True)
class ErrorMeaning:
    """A row of the table: the outcome's name, what it means, what to do."""

    code: ErrorCode
    name: str
    meaning: str
    advice: str


@cache
def error_table() -> Mapping[str, ErrorMeaning]:
    """The rows of the table by the name of the outcome, in the order of their codes."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = [
            ErrorMeaning(ErrorCode(int(row["code"], 16)), row["name"], row["meaning"], row["advice"])
            for row in csv.DictReader(file)
        ]
    return MappingProxyType({row.name: row for row in rows})


def error_code(outcome: str) -> ErrorCode:
    """framekit's code of an outcome; `NONE` for '' (all is well), `FAILED` for a name that a protocol gives itself."""
    if not outcome:
        return ErrorCode.NONE
    row = error_table().get(outcome)
    return ErrorCode.FAILED if row is None else row.code


def status_word(outcome: str, device_code: int | None) -> int:
    """What STATUS shows: the code the device refused with, where it is a word of its own, else framekit's.

    Codes of 0, negative ones and those from FF00 on are none of their own: they would be taken for something else.
    """
    if outcome and device_code is not None:
        return device_code if 0 < device_code < FIRST_OWN else ErrorCode.REFUSED
    return error_code(outcome)

"""A run controlled by hand: lines such as `fire 3`, `disable 2`, `enable set 2`, carried out on a run at work.

Where the lines come from, and who reads the answers, is not known here.
"""

from __future__ import annotations

import re

from framekit.run.model import BLOCKS_IN_SET
from framekit.service.run import RunService

COMMANDS = "fire N, enable N, disable N (a block, SET.BLOCK, set N or channel N), reset or stop"

_BLOCK = re.compile(r"(fire|enable|disable)\s+(?:block\s+)?(?:([0-9]+)\.)?([0-9]+)")
_WHOLE = re.compile(r"(enable|disable)\s+(set|channel)\s+([0-9]+)")


class ControlError(ValueError):
    """A line that cannot be carried out; a sentence with what to do."""


def carry_out(service: RunService, line: str) -> None:
    """Carries one line out; empty ones and those that begin with # do nothing. Raises ControlError."""
    words = line.split("#")[0].strip().lower()
    if not words:
        return
    if words == "reset":
        service.reset()
        return
    whole = _WHOLE.fullmatch(words)
    if whole is not None:
        _switch(service, whole[2], int(whole[3]), whole[1] == "enable")
        return
    match = _BLOCK.fullmatch(words)
    if match is None:
        raise ControlError(f"'{words}' is no command – write {COMMANDS}")
    verb, set_number, block = match[1], int("1" if match[2] is None else match[2]), int(match[3])
    number = BLOCKS_IN_SET * (set_number - 1) + block
    if block >= BLOCKS_IN_SET or number not in service.states:
        known = ", ".join(_name(one) for one in sorted(service.states))
        raise ControlError(f"there is no block {words.split()[-1]} – known: {known}")
    if verb == "fire":
        try:
            service.fire(number)
        except ValueError as error:
            raise ControlError(str(error)) from None
    else:
        service.enable(number, verb == "enable")


def _switch(service: RunService, what: str, number: int, on: bool) -> None:
    """A set or a channel on or off. Raises ControlError for one there is not."""
    known = service.run.sets if what == "set" else service.channels
    if number not in known:
        raise ControlError(f"there is no {what} {number} – known: {', '.join(map(str, sorted(known)))}")
    if what == "set":
        service.enable_set(number, on)
    else:
        service.enable_channel(number, on)


def _name(number: int) -> str:
    """A block as lines name it."""
    set_number, block = divmod(number, BLOCKS_IN_SET)
    return f"{set_number + 1}.{block}" if set_number else str(block)

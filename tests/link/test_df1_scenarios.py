"""Every sequence of specification 1.13, and of the tables before it, is a conversation of the vectors, both ends."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from shipped import vectors_of

FULL = {
    "FD-1": ("FD-1:", "a command is acknowledged, executed and answered"),
    "FD-2": ("FD-2: a refused", "FD-2 at the receiver"),
    "FD-3": ("FD-3: a lost", "FD-3 at the receiver"),
    "FD-4": ("FD-4: acknowledge lost", "FD-4 at the receiver"),
    "FD-5": ("FD-5: the other side", "FD-5 at the receiver"),
    "FD-6": ("FD-6: a damaged reply", "FD-6 at the replier"),
    "FD-7": ("the acknowledge of a reply is repeated", "FD-7: the acknowledge of a reply"),
    "FD-8": ("FD-8: the originator", "FD-8: the originator"),
    "1.10 transmitter": (
        "the NAK limit", "the ENQ limit", "other symbols are ignored", "an acknowledge and a refusal that nobody",
    ),
    "1.10 receiver": (
        "an enquiry before anything", "a control symbol in a message", "a message within", "an enquiry within",
        "a start of a master", "a character with a parity", "a character with a framing", "a character with an overrun",
        "a message that is too short", "a message that is too long", "packets for others are left", "duplicates are",
        "without room the acknowledge", "noise turns an acknowledge", "an acknowledge inside a reply",
    ),
    "1.12": tuple(f"1.12 {module}:" for module in ("common", "kf2", "ke", "kg", "kgm", "ka_1775", "ke_1785")),
}  # fmt: skip
HALF = {
    "HD-1": ("HD-1: message", "HD-1 at the slave"),
    "HD-2": ("HD-2, HD-3:", "HD-2 at the slave"),
    "HD-3": ("HD-2, HD-3:", "HD-3 at the slave"),
    "HD-4": ("HD-4:", "polls and messages of others"),
    "HD-5": ("HD-5: a damaged", "HD-5 at the slave"),
    "HD-6": ("HD-6: a duplicate", "HD-6 at the slave"),
    "HD-7": ("HD-2, HD-3:", "HD-7, HD-8 at the slave"),
    "HD-8": ("HD-8: a message without", "HD-7, HD-8 at the slave"),
}
TABLES = {
    "master": (
        "HD-1: message", "nodes of the priority list", "HD-2, HD-3:", "three times without an acknowledge", "HD-4:",
        "HD-6: a duplicate", "HD-5: a damaged", "an inactive node is polled once", "a node that does not answer",
        "a message of one slave", "one message a poll", "the link reset of a master",
    ),
    "slave": (
        "HD-1 at the slave", "a broadcast is executed", "other slaves", "a header without a station",
        "a header that something else", "a control symbol in a message: no answer", "HD-2 at the slave",
        "too short, too long", "a message that is too long: no answer", "a character with a parity error in a message:",
        "HD-3 at the slave", "a broadcast that comes twice", "HD-7, HD-8 at the slave", "polls and messages of others",
        "HD-6 at the slave", "HD-5 at the slave", "a message that nobody acknowledges", "the next message goes out",
        "the link reset drops", "the link reset of the master",
    ),
}  # fmt: skip
"""The rows of the tables of 1.11 in order, and the further duties of a master."""


def names_of(role: str) -> Iterator[str]:
    """Return the names of the conversations of one role."""
    return (case.name for case in vectors_of("df1").conversations if case.role == role)


@pytest.mark.parametrize("row", FULL)
def test_full_duplex(row: str) -> None:
    for name in FULL[row]:
        assert any(conversation.startswith(name) for conversation in names_of("full")), name


@pytest.mark.parametrize("row", HALF)
def test_half_duplex_at_master_and_slave(row: str) -> None:
    for role, name in zip(("master", "slave"), HALF[row], strict=True):
        assert any(conversation.startswith(name) for conversation in names_of(role)), (role, name)


@pytest.mark.parametrize("role", TABLES)
def test_tables_of_half_duplex(role: str) -> None:
    for name in TABLES[role]:
        assert any(conversation.startswith(name) for conversation in names_of(role)), (role, name)

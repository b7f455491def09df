"""The command set is complete: every command has a frame, a vector, a service and processors that execute it."""

from __future__ import annotations

from functools import cache
from typing import Any

from shipped import file_of, vectors_of

from framekit.definition.expression import Number
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Bits, Field

INDEX = {
    *(0x0000, 0x0100, 0x0200, 0x0300, 0x0400, 0x0500, 0x0800),
    *range(0x0600, 0x060B),
    *(0x0700, 0x0701, 0x0703, 0x0704, 0x0705, 0x0706),
    *range(0x0F00, 0x0F0B),
    *(0x0F11, 0x0F12, 0x0F17, 0x0F18, 0x0F26, 0x0F29, 0x0F3A, 0x0F41, 0x0F50, 0x0F52, 0x0F53, 0x0F55, 0x0F57, 0x0F5E),
    *(0x0F67, 0x0F68, 0x0F79, 0x0F80, 0x0F81, 0x0F82, 0x0F88, 0x0F8F),
    *(0x0FA1, 0x0FA2, 0x0FA7, 0x0FA9, 0x0FAA, 0x0FAB, 0x0FAF),
}
"""CMD and FNC of the index of commands, specification 3.2."""

BY_ALL = {0x0100, 0x0800, 0x0600, 0x0601, 0x0603, 0x0607}
"""Commands that every processor executes, apart from 0F/03 and others."""

WITH_DATA = {
    *(0x0100, 0x0400, 0x0600, 0x0601, 0x0603, 0x0609, 0x0F01, 0x0F04, 0x0F09, 0x0F17, 0x0F29, 0x0F53, 0x0F68, 0x0F79),
    *(0x0F81, 0x0FA1, 0x0FA2, 0x0FA7),
}
"""Commands whose good reply has data after the header."""


@cache
def protocol() -> Protocol:
    return load_protocol(file_of("df1.yaml"))


def code_of(frame: Frame) -> int | None:
    """Return CMD and FNC of a command; None for replies and link frames."""
    cmd = fnc = None
    for segment in frame.segments:
        for part in segment.parts if isinstance(segment, Bits) else ():
            if part.name == "is_reply" and part.constants == (1,):
                return None
            if part.name == "cmd" and part.constants:
                cmd = part.constants[0]
        if isinstance(segment, Field) and segment.name == "fnc" and segment.is_ is not None:
            assert isinstance(segment.is_.root, Number)
            fnc = segment.is_.root.value
    return None if cmd is None else int(cmd) << 8 | (fnc or 0)


@cache
def commands() -> dict[str, int]:
    """Return CMD and FNC by frame name."""
    codes = {name: code_of(frame) for name, frame in protocol().frames.items()}
    return {name: code for name, code in codes.items() if code is not None}


def test_every_command_of_the_index_is_a_frame() -> None:
    assert set(commands().values()) <= INDEX
    assert set(commands().values()) >= INDEX


def test_every_command_has_a_vector() -> None:
    tested = {case.frame for case in vectors_of("pccc").frames}
    assert set(commands()) - tested == set()


def test_every_command_has_a_vector_of_its_reply() -> None:
    """The vectors are named by CMD and FNC and refer to a command by its number; replies with data have data."""
    replied: dict[str, list[Any]] = {}
    cases = vectors_of("pccc").frames
    for case in cases:
        if case.frame == "reply":
            replied.setdefault(case.name.split(" ")[0].rstrip(":"), []).append(case.values)
    numbers = {case.values["tns"] for case in cases if case.frame != "reply"}
    for code in commands().values():
        cmd, fnc = code >> 8, code & 0xFF
        name = f"{cmd:02X}/{fnc:02X}" if cmd in (6, 7, 0xF) else f"{cmd:02X}"
        assert name in replied, name
        assert any(reply["tns"] in numbers and int(reply["cmd"], 0) == cmd for reply in replied[name]), name
        assert any(reply["data"] and reply["sts"] == "0" for reply in replied[name]) == (code in WITH_DATA), name


def test_every_vector_has_a_source() -> None:
    assert all(case.source for case in vectors_of("pccc").frames)


def test_every_command_has_a_service_to_call() -> None:
    called = {
        row.request.frame
        for name, rows in protocol().services.items()
        for row in rows
        if name not in ("read", "write") and row.request is not None
    }
    assert set(commands()) - called == set()


def test_the_processors_of_every_command_are_known() -> None:
    executed_by = protocol().tables["executed_by"].entries
    known = set(protocol().params["processor"].choices)
    assert set(executed_by) == INDEX - BY_ALL
    assert all(set(processors) <= known for processors in executed_by.values())

"""Read `modem:` of a channel: how the modem is set up, the number that it dials or the ring it answers, hanging up."""

from __future__ import annotations

import re
from functools import partial
from typing import get_args

from framekit.definition.load.reader import Reader
from framekit.definition.nodes import Mapping, Node
from framekit.definition.times import NEVER, Dialling, HangUp, Modem, readable_time
from framekit.transport.schemes import scheme_of

OF_DIALLING = ("extension", "connect_within", "retries", "pause", "rest")
"""Keys that only matter for a modem that dials."""
OF_CALLS = ("dial", "answer", "hang_up", "guard")
"""Keys that only matter for a modem with calls."""

LONGEST_COMMAND = 60
"""Most characters of a dial command with its `AT`. V.250 only asks modems for 40; a modem refuses more by ERROR."""
LONGEST_WITHIN = 30_000_000_000
"""Longest `within` (ns): a run does not end before its modems have replied to hanging up."""
LONGEST_GUARD = 10_000_000_000
"""Longest `guard` (ns); register S12 of V.250 modems ends at 5.1 s."""
MOST_RETRIES = 1000

_SEPARATORS = str.maketrans("", "", " -./()")
_NUMBER = re.compile(r"[TP]?[0-9A-D*#+,W@!]+")
_EXTENSION = re.compile(r"[0-9A-D*#,W@!]+")


def read_limit(reader: Reader, key: str, node: Node, longest: int = NEVER) -> int:
    """Return a time limit in ns; it is longer than 0, ends, and is not over `longest`. Raise Broken."""
    time = reader.time(node)
    if not 0 < time < NEVER:
        raise reader.broken(node.at, f"'{reader.text(node)}' is no {key}", "give a time such as 500 ms")
    if time > longest:
        todo = f"give {readable_time(longest)} or less"
        raise reader.broken(node.at, f"'{reader.text(node)}' is too long for {key}", todo)
    return time


def read_modem(reader: Reader, node: Node, port: str) -> Modem | None:
    """Read `none`, or the mapping of a modem on this port; wrong keys are noted and have their default."""
    if not isinstance(node, Mapping):
        return None
    usual = Modem()
    kind = reader.tried(reader.text, node.get("type"))
    is_dedicated = kind == "dedicated"
    _conflicts(reader, node, is_dedicated, port)
    init = reader.tried(partial(_init, reader), node.get("init"))
    within = reader.tried(partial(read_limit, reader, "within", longest=LONGEST_WITHIN), node.get("within"))
    guard = reader.tried(partial(read_limit, reader, "guard", longest=LONGEST_GUARD), node.get("guard"))
    rings = reader.tried(partial(_rings, reader), node.get("answer"))
    dialling = None if is_dedicated else reader.tried(partial(_dialling, reader, node), node.get("dial"))
    answers = not is_dedicated and node.get("dial") is None
    return Modem(
        init=usual.init if init is None else init,
        answer=(rings or 1) if answers else None,
        dialling=dialling,
        reply_within=within or usual.reply_within,
        hang_up=_hang_up(reader, node, usual),
        guard=guard or usual.guard,
    )


def _conflicts(reader: Reader, keys: Mapping, is_dedicated: bool, port: str) -> None:
    """Note keys that have no effect together, or on this port."""
    found = {key: node for key in (*OF_DIALLING, *OF_CALLS) if (node := keys.get(key)) is not None}
    scheme = scheme_of(port)
    if scheme is not None and scheme.open is None:
        reader.note(keys.at, f"a modem is on a port that framekit opens, and '{port}' waits for others", "leave it out")
    if is_dedicated:
        for key, node in found.items():
            reader.note(node.at, f"a dedicated line has no calls, and '{key}' is for calls", f"leave {key} out")
        return
    dial = found.get("dial")
    if dial is None:
        for key in OF_DIALLING:
            if key in found:
                reader.note(found[key].at, f"'{key}' is for a modem that dials", 'add dial: "NUMBER"')
    elif "answer" in found:
        reader.note(found["answer"].at, "a modem that dials answers no calls", "leave answer or dial out")
    by_dtr = "hang_up" in found and reader.text(found["hang_up"]) == "dtr"
    if by_dtr and "guard" in found:
        reader.note(found["guard"].at, "DTR hangs up without an escape sequence", "leave guard out")
    if by_dtr and scheme is not None and not scheme.wires:
        reader.note(found["hang_up"].at, f"'{port}' has no DTR wire", "use hang_up: escape")


def _init(reader: Reader, node: Node) -> str:
    """Return the commands of `init`. Raise Broken."""
    text = reader.text(node)
    if not (text.isascii() and text.isprintable()):
        raise reader.broken(node.at, "a modem command is printable ASCII", "write it like ATZ;ATE0")
    return text


def _rings(reader: Reader, node: Node) -> int:
    rings = reader.number(node)
    if not 1 <= rings <= 255:
        raise reader.broken(node.at, f"a modem cannot answer at ring {rings}", "give 1 to 255")
    return rings


def _hang_up(reader: Reader, keys: Mapping, usual: Modem) -> HangUp:
    """Return the way of hanging up; the schema has reported other words."""
    node = keys.get("hang_up")
    words: tuple[HangUp, ...] = get_args(HangUp)
    text = usual.hang_up if node is None else reader.text(node)
    return next((word for word in words if word == text), usual.hang_up)


def _dialling(reader: Reader, keys: Mapping, node: Node) -> Dialling | None:
    """Read the keys of a call. Raise Broken for a wrong number."""
    usual = Dialling(number="")
    times = {
        key: reader.tried(partial(read_limit, reader, key), keys.get(key)) or getattr(usual, key)
        for key in ("connect_within", "pause", "rest")
    }
    retries = reader.tried(partial(_retries, reader), keys.get("retries"))
    extension = reader.tried(partial(_digits, reader, "extension", _EXTENSION), keys.get("extension"))
    dialling = Dialling(
        number=_digits(reader, "number", _NUMBER, node),
        extension=extension or "",
        retries=usual.retries if retries is None else retries,
        **times,
    )
    if len(dialling.command) > LONGEST_COMMAND:
        what = f"the dial command {dialling.command} has {len(dialling.command)} characters"
        raise reader.broken(node.at, what, f"modems take {LONGEST_COMMAND} at most: shorten dial or extension")
    return dialling


def _retries(reader: Reader, node: Node) -> int:
    retries = reader.number(node)
    if not 0 <= retries <= MOST_RETRIES:
        raise reader.broken(node.at, f"{retries} is no number of further calls", f"give 0 to {MOST_RETRIES}")
    return retries


def _digits(reader: Reader, name: str, form: re.Pattern[str], node: Node) -> str:
    """Return a number to dial without its separators. Raise Broken."""
    text = reader.text(node)
    digits = text.translate(_SEPARATORS).upper()
    if form.fullmatch(digits) is None or not any(digit.isalnum() for digit in digits):
        todo = "digits, * # A B C D, a comma for a pause, W, @ and ! of the modem; T or P first for tones or pulses"
        raise reader.broken(node.at, f"'{text}' is no {name} to dial", f"write {todo}")
    return digits

"""Words of other programs, and the hint at the word of framekit for each.

They are words of mbpoll, modpoll, pymodbus, minimalmodbus, pyserial and of sniffers of serial lines.
"""

from __future__ import annotations

import re
from collections.abc import Collection

_READS_AGAIN = "write framekit read with --every, such as --every 1s"
_RUNS = "framekit run carries out a run file; its sinks keep values"
_LISTS = "framekit frames lists the protocols, framekit frames PROTOCOL its frames"
_SIMULATES = "framekit serve simulates a device"
_LISTENS = "framekit monitor listens to a line of a known protocol, framekit record to any line"
_FINDS = "framekit scan finds stations, framekit record --try speed and format"
_CHECKS = "framekit check checks files"
_DECODES = "framekit decode reads the bytes of a frame"
_ENCODES = "framekit encode makes the bytes of a frame"
_IMPORTS = "framekit import makes points of a register list, a definition of a protocol file"

VERBS_MEANT = {
    **dict.fromkeys(("poll", "mbpoll", "watch"), _READS_AGAIN),
    **dict.fromkeys(("log", "logger", "collect", "gateway", "start", "daemon", "exec"), _RUNS),
    **dict.fromkeys(("list", "ls", "protocols", "show"), _LISTS),
    **dict.fromkeys(("simulate", "simulator", "slave", "server", "device"), _SIMULATES),
    **dict.fromkeys(("sniff", "listen", "spy", "dump", "capture"), _LISTENS),
    **dict.fromkeys(("discover", "find", "search", "detect"), _FINDS),
    **dict.fromkeys(("validate", "lint", "verify"), _CHECKS),
    **dict.fromkeys(("decode-frame", "decode_frame", "parse"), _DECODES),
    **dict.fromkeys(("encode-frame", "encode_frame", "build"), _ENCODES),
    **dict.fromkeys(("points", "convert"), _IMPORTS),
    **dict.fromkeys(("get", "readreg"), "framekit read reads values"),
    **dict.fromkeys(("put", "send", "writereg"), "framekit write writes values"),
    **dict.fromkeys(("init", "create", "scaffold"), "framekit new protocol NAME lays out a protocol"),
    **dict.fromkeys(("compile", "codegen", "dissector"), "framekit generate writes code"),
    "version": "write framekit --version",
}
"""Verbs of other programs."""

_STATION = "write --station"
_SPEED = "write --speed"
_FORMAT = "write --format, such as 8E1"
_ADDRESS = "write addresses without an option, such as 40001 or holding:0x10"
_PROTOCOL = "write the name of the protocol: framekit frames lists them"
_EVERY = "write --every, such as --every 1s"
OPTIONS_MEANT = {
    **dict.fromkeys(("--baud", "--baudrate", "--baud-rate", "--bitrate"), _SPEED),
    **dict.fromkeys(("--parity", "--stopbits", "--databits", "--bytesize", "--stop-bits", "--data-bits"), _FORMAT),
    **dict.fromkeys(("--slave", "--slave-id", "--slave-address", "--unit", "--unit-id", "--device-id"), _STATION),
    **dict.fromkeys(("--address", "--register", "--reference", "--start", "--offset"), _ADDRESS),
    **dict.fromkeys(("--quantity", "--length", "--num"), "write -n"),
    **dict.fromkeys(("--host", "--ip", "--server"), "write --port tcp://HOST:PORT"),
    **dict.fromkeys(("--device", "--serial", "--tty"), "write --port"),
    **dict.fromkeys(("--interval", "--period", "--poll", "--rate"), _EVERY),
    "--set": "write --param NAME=VALUE",
    **dict.fromkeys(("--method", "--mode", "--framer"), _PROTOCOL),
}
"""Options of other programs. They matter only for verbs that do not have them."""

LETTERS_MEANT = {
    "-a": _STATION,
    "-b": _SPEED,
    "-r": _ADDRESS,
    "-c": "write -n",
    "-t": f"{_ADDRESS}, and --type for numbers such as float32",
    "-m": _PROTOCOL,
    "-P": _FORMAT,
    "-d": _FORMAT,
    "-s": _FORMAT,
    "-l": _EVERY,
    "-o": "write --timeout, such as --timeout 2s",
    "-p": "write --port",
    "-u": _STATION,
    "-q": "leave it out",
    "-0": "write addresses from 0 with their area, such as holding:0",
    "-1": "leave it out: without --every values are read once",
}
"""Options of mbpoll and modpoll."""
_ONE_EXCHANGE = ("read", "write", "call", "scan")
"""The verbs for which hints without an option hold, such as that at the form of addresses."""


def option_meant(verb: str, option: str, known: Collection[str]) -> str:
    """Return the hint for an option of another program, or '' if it names no option of the verb. `known`: those.

    A letter may have its value attached, as in `-a1`.
    """
    hint = OPTIONS_MEANT.get(option, "")
    if not hint and re.match(r"-[A-Za-z](\d|$)|-[01]$", option):
        hint = LETTERS_MEANT.get(option[:2], "")
    if verb == "scan" and (hint or f"write {option}").startswith("write --port"):
        return "write the port first: framekit scan PORT PROTOCOL"
    named = re.match(r"write (-\S+?)(?=[ ,]|$)", hint)
    if named is None:
        return hint if verb in _ONE_EXCHANGE else ""
    option = next((one for one in (named[1], f"{named[1]}s") if one in known), "")
    return hint.replace(named[1], option, 1) if option else ""

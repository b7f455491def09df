"""`framekit decode PROTOCOL HEX`: which frame some bytes are, with every field, its offset and its bytes."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    add_json,
    add_protocol,
    add_settings,
    hex_bytes,
    load,
    print_json,
    scope_of,
    spaced,
    table,
)
from framekit.cli.main import Failure

if TYPE_CHECKING:
    from framekit.codec.codec import Codec
    from framekit.codec.errors import FrameError
    from framekit.definition.model.protocol import Protocol
    from framekit.link.scope import Scope


@dataclass(frozen=True, slots=True)
class Fit:
    """A frame that the bytes are; `refusal` is the code a server would refuse it with."""

    frame: str
    fields: dict[str, Any]
    refusal: int | None = None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_protocol(parser)
    parser.add_argument("bytes", metavar="HEX", nargs="+", help="the bytes as hex digits, or - for standard input")
    parser.add_argument("--frame", help="try this frame only")
    parser.add_argument("--from", dest="side", choices=("client", "server"), help="which side sent the bytes")
    add_settings(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from framekit.codec.codec import compile_protocol

    protocol = load(arguments.protocol)
    codec = compile_protocol(protocol)
    scope = scope_of(protocol, arguments.set)
    data = hex_bytes(" ".join(arguments.bytes))
    fits, faults = fitting(codec, protocol, data, scope, candidates(protocol, arguments.frame, arguments.side))
    if not fits:
        print(f"framekit decode: {reason(faults, data)}", file=sys.stderr)
        return 1
    if arguments.json:
        print_json(as_json(protocol, fits))
    else:
        print("\n\n".join(as_text(codec, protocol, fit, data, scope) for fit in fits))
    return 0


def candidates(protocol: Protocol, frame: str | None, side: str | None) -> list[str]:
    """The frames to try: one, or all that stand on the line and may come from that side."""
    from framekit.definition.problems import did_you_mean

    if frame is not None:
        if frame not in protocol.frames and frame not in protocol.groups:
            hint = did_you_mean(frame, [*protocol.frames, *protocol.groups])
            raise Failure(f"'{protocol.name}' has no frame '{frame}'" + (f" – {hint}" if hint else ""))
        return list(protocol.frames_of(frame))
    found = [one for one in protocol.frames.values() if not one.inner]
    if side is not None:
        found = [one for one in found if one.side in (side, "both")]
    return [one.name for one in sorted(found, key=lambda one: one.refuse is not None or one.side == "none")]


def fitting(
    codec: Codec, protocol: Protocol, data: bytes, scope: Scope, names: list[str]
) -> tuple[list[Fit], list[tuple[str, FrameError]]]:
    """The frames that the bytes are, and why they are not the others. Catch-all frames count only alone."""
    from framekit.codec.errors import FrameError

    fits: list[Fit] = []
    faults: list[tuple[str, FrameError]] = []
    for name in names:
        frame = protocol.frames[name]
        if fits and (frame.refuse is not None or frame.side == "none"):
            continue
        try:
            fits.append(Fit(name, codec.decode(name, data, scope), frame.refuse))
        except FrameError as error:
            if error.refuse is not None and error.cause != "check":
                fits.append(Fit(name, error.fields, error.refuse))
            faults.append((name, error))
    whole = [fit for fit in fits if fit.refusal is None]
    known = [fit for fit in whole if not holds_unknown(fit.fields)]
    return known or whole or fits, faults


def holds_unknown(fields: dict[str, Any]) -> bool:
    """Whether a frame inside is none that the protocol knows."""
    return any(isinstance(value, dict) and ("unknown" in value or holds_unknown(value)) for value in fields.values())


def reason(faults: list[tuple[str, FrameError]], data: bytes) -> str:
    """Why the bytes are no frame: what the frame that fits best has to say."""
    if not data:
        return "there are no bytes to decode"
    if not faults:
        return "this protocol has no frames that could be tried"
    name, error = max(faults, key=lambda fault: (fault[1].cause == "check", fault[1].offset))
    return f"no frame fits; nearest is '{name}': {error}"


def as_json(protocol: Protocol, fits: list[Fit]) -> dict[str, Any]:
    from framekit.codec.plain import PlainValues

    plain = PlainValues(protocol)
    shown: list[dict[str, Any]] = []
    for fit in fits:
        one: dict[str, Any] = {"frame": fit.frame, "fields": plain.to_plain(fit.frame, fit.fields)}
        if fit.refusal is not None:
            one["refused"] = fit.refusal
        shown.append(one)
    return shown[0] | ({"others": shown[1:]} if len(shown) > 1 else {})


def as_text(codec: Codec, protocol: Protocol, fit: Fit, data: bytes, scope: Scope) -> str:
    """The frame's name and a table of its fields."""
    from framekit.codec.plain import PlainValues

    _, spans, _ = codec.trace(fit.frame, data, scope)
    plain = PlainValues(protocol)
    rows = []
    for path, start, end, value in spans:
        shown = plain.to_plain("", {"": value})[""]
        rows.append((path, str(start), spaced(data[start:end]), "" if shown is None else f"{shown}"))
    refused = "" if fit.refusal is None else f"  (a server refuses it with 0x{fit.refusal:04X})"
    return f"{fit.frame}{refused}\n" + table(rows, ("field", "offset", "bytes", "value"))

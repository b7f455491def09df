"""`framekit decode PROTOCOL HEX`: which frame some bytes are, with every field, its offset and its bytes.

With `--capture FILE` it is a whole capture.
"""

from __future__ import annotations

import argparse
import sys
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
from framekit.cli.decode_capture import add_capture_arguments, decode_capture
from framekit.cli.main import Failure

if TYPE_CHECKING:
    from framekit.codec.codec import Codec
    from framekit.definition.model.protocol import Protocol
    from framekit.link.fitting import Fit
    from framekit.link.scope import Scope


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_protocol(parser)
    bytes_ = parser.add_argument(
        "bytes", metavar="HEX", nargs="+", help="the bytes as hex digits, or - for standard input"
    )
    parser.add_argument("--frame", help="try this frame only")
    parser.add_argument("--from", dest="side", choices=("client", "server"), help="which side sent the bytes")
    add_settings(parser)
    add_json(parser)
    add_capture_arguments(parser, bytes_)


def run(arguments: argparse.Namespace) -> int:
    from framekit.codec.codec import compile_protocol
    from framekit.link.fitting import fitting, reason

    protocol = load(arguments.protocol)
    if arguments.capture is not None:
        return decode_capture(protocol, arguments)
    codec = compile_protocol(protocol)
    scope = scope_of(protocol, arguments.set)
    data = hex_bytes(" ".join(arguments.bytes))
    fits, faults = fitting(codec, data, tried(protocol, arguments.frame, arguments.side), scope)
    if not fits:
        print(f"framekit decode: {reason(faults, data)}", file=sys.stderr)
        return 1
    if arguments.json:
        print_json(as_json(protocol, fits))
    else:
        print("\n\n".join(as_text(codec, protocol, fit, data, scope) for fit in fits))
    return 0


def tried(protocol: Protocol, frame: str | None, side: str | None) -> list[str]:
    """The frames to try. Raises Failure for one there is not."""
    from framekit.definition.problems import did_you_mean
    from framekit.link.fitting import candidates

    if frame is not None and frame not in protocol.frames and frame not in protocol.groups:
        hint = did_you_mean(frame, [*protocol.frames, *protocol.groups])
        raise Failure(f"'{protocol.name}' has no frame '{frame}'" + (f" – {hint}" if hint else ""))
    return candidates(protocol, frame, side)


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

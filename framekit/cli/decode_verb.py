"""`framekit decode PROTOCOL HEX`: which frame some bytes are, with every field, its offset and its bytes.

With `--capture FILE` it is a whole capture.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    add_json,
    add_protocol,
    add_settings,
    hex_bytes,
    load_codec,
    print_json,
    scope_of,
    spaced,
    table,
)
from framekit.cli.decode_capture import add_capture_arguments, decode_capture
from framekit.cli.main import WrongWords
from framekit.link.codes import code_text

if TYPE_CHECKING:
    from framekit.codec.stored import StoredCodec
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
    from framekit.link.fitting import fitting, reason

    codec = load_codec(arguments.protocol)
    if arguments.capture is not None:
        return decode_capture(codec.protocol, arguments)
    names = context(codec, arguments.set)
    data = hex_bytes(" ".join(arguments.bytes))
    tried = frames_tried(codec, arguments.frame, arguments.side)
    fits, faults = fitting(codec, codec.catalogue, data, tried, names)
    if not fits:
        print(f"framekit decode: {reason(faults, data)}", file=sys.stderr)
        return 1
    if arguments.json:
        print_json(as_json(codec, fits, data, names))
    else:
        print("\n\n".join(as_text(codec, fit, data, names) for fit in fits))
    return 0


class StartNames(dict[str, Any]):
    """The start values of parameters and state; those that only the whole definition knows are looked up there."""

    def __init__(self, codec: StoredCodec) -> None:
        super().__init__(codec.defaults)
        self._codec = codec
        self._scope: Scope | None = None

    def __missing__(self, name: str) -> Any:
        if self._scope is None:
            self._scope = scope_of(self._codec.protocol, ())
        return self._scope[name]

    def get(self, name: str, default: Any = None) -> Any:
        try:
            return self[name]
        except KeyError:
            return default


def context(codec: StoredCodec, settings: list[str]) -> Mapping[str, Any]:
    """What the bytes depend on: as the definition starts, or with these settings. Raises WrongWords."""
    return scope_of(codec.protocol, settings) if settings else StartNames(codec)


def frames_tried(codec: StoredCodec, frame: str | None, side: str | None) -> list[str]:
    """The frames to try. Raises WrongWords for one there is not."""
    from framekit.link.fitting import candidates, of_side

    if frame is None:
        return of_side(codec.catalogue, side)
    from framekit.definition.problems import did_you_mean

    protocol = codec.protocol
    if frame not in protocol.frames and frame not in protocol.groups:
        hint = did_you_mean(frame, [*protocol.frames, *protocol.groups])
        raise WrongWords(f"'{protocol.name}' has no frame '{frame}'" + (f" – {hint}" if hint else ""))
    return candidates(protocol, frame, side)


def as_json(codec: StoredCodec, fits: list[Fit], data: bytes, names: Mapping[str, Any]) -> dict[str, Any]:
    from framekit.codec.plain import PlainValues

    plain = PlainValues(codec.protocol)
    shown: list[dict[str, Any]] = []
    for fit in fits:
        one: dict[str, Any] = {"frame": fit.frame, "fields": plain.to_plain(fit.frame, fit.fields)}
        if fit.refusal is not None:
            one["refused"] = fit.refusal
        if warnings := codec.check_warnings(fit.frame, data, names):
            one["warnings"] = warnings
        shown.append(one)
    return shown[0] | ({"others": shown[1:]} if len(shown) > 1 else {})


def as_text(codec: StoredCodec, fit: Fit, data: bytes, names: Mapping[str, Any]) -> str:
    """The frame's name and a table of its fields."""
    from framekit.codec.shown import shown

    _, spans, _ = codec.trace(fit.frame, data, names)
    rows = []
    for path, start, end, value in spans:
        text = "" if value is None else f"{shown(value)}"
        rows.append((path, str(start), spaced(data[start:end]), text))
    refused = "" if fit.refusal is None else f"  (a server refuses it with {code_text(fit.refusal)})"
    warned = "".join(f"\nwarning: {text}" for text in codec.check_warnings(fit.frame, data, names))
    return f"{fit.frame}{refused}{warned}\n" + table(rows, ("field", "offset", "bytes", "value"))

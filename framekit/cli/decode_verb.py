"""The verb `decode`: name the frame that some bytes are, with its fields; or decode a capture.

Bytes are decoded by the cached functions alone: the definition is read only if a message or a setting needs it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    NAMES_HELP,
    WordsError,
    add,
    hex_bytes,
    load_codec,
    print_json,
    scope_of,
    table,
    tell_error,
)
from framekit.codec.functions import candidates, damage, likely, of_side, other_sides, reason
from framekit.codec.shown import code_text, shown, with_name

if TYPE_CHECKING:
    from framekit.api.settings import Names
    from framekit.codec.cache import CachedCodec
    from framekit.codec.errors import FrameError
    from framekit.codec.functions import Fit


class _Instead(argparse.Action):
    """An option that replaces a required argument."""

    def __init__(self, *words: Any, instead_of: argparse.Action, **options: Any) -> None:
        super().__init__(*words, **options)
        self._instead_of = instead_of

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        setattr(namespace, self.dest, values)
        self._instead_of.required = False


def add_capture_arguments(parser: argparse.ArgumentParser, bytes_: argparse.Action) -> None:
    """Add the options for decoding a capture instead of `bytes_`; PROTOCOL, --set and --json have been added."""
    parser.add_argument(
        "--capture", metavar="FILE", type=Path, action=_Instead, instead_of=bytes_,
        help="decode a capture (pcap or JSON lines) instead; with --to also several: 'DIR/*.pcap'",
    )  # fmt: skip
    parser.add_argument(
        "--to", metavar="OUT.parquet", type=Path,
        help="write rows to a table, a folder with a Parquet file for each capture, and print the counts only",
    )  # fmt: skip
    parser.add_argument(
        "--values", metavar="OUT.csv", type=Path,
        help="write what requests and replies say of the values in devices to a table, as a sink does",
    )  # fmt: skip
    parser.add_argument("--jobs", metavar="N", type=int, help="with --to: so many processes; default: one a core")
    parser.add_argument(
        "--engine",
        metavar="dask://HOST:PORT",
        help="with --to: the workers of this cluster decode, which see the same files",
    )
    parser.add_argument(
        "--client", choices=("in", "out"), default="out",
        help="direction of the client's frames in a capture that has both; default: out",
    )  # fmt: skip
    add(parser, "--ascii", help="show bytes of a capture as ASCII")
    add(parser, "--speed", "--format", "--filter", "--frame-name", "--bad")


def add_decode_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "protocol")
    bytes_ = parser.add_argument(
        "bytes", metavar="HEX", nargs="+", help="the bytes as hex digits, or - for standard input"
    )
    parser.add_argument("--frame", help="try this frame only")
    parser.add_argument("--from", dest="side", choices=("client", "server"), help="which side sent the bytes")
    add(parser, "--param", help=NAMES_HELP)
    add(parser, "--json")
    add_capture_arguments(parser, bytes_)


def run_decode(arguments: argparse.Namespace) -> int:
    codec = load_codec(arguments.protocol)
    if arguments.capture is not None:
        from framekit.cli.capture_decoding import decode_capture

        return decode_capture(codec.protocol, arguments)
    for option in ("to", "values", "jobs", "engine"):
        if getattr(arguments, option) is not None:
            raise WordsError(f"--{option} has no effect without --capture – add it, or remove this")
    names = context(codec, arguments.param)
    data = hex_bytes(" ".join(arguments.bytes))
    tried = frames_tried(codec, arguments.frame, arguments.side)
    fits, faults = likely(codec, codec.catalogue, data, tried, names)
    if not fits:
        tell_error(arguments, "no_frame", reason(codec, faults, data, names))
        return 1
    inside = {fit.frame: fault for fit in fits if (fault := damage(codec, fit.frame, data, names)) is not None}
    is_open = arguments.frame is None and arguments.side is None
    others = [*other_sides(codec, codec.catalogue, data, fits, names)] if is_open else []
    if arguments.json:
        bad = [{"frame": name, "from": codec.catalogue[name].side, "fault": str(fault)} for name, fault in others]
        print_json(as_json(codec, fits, data, names, inside) | ({"other_side": bad} if bad else {}))
    else:
        print("\n\n".join(as_text(codec, fit, data, names) for fit in fits))
        for name, fault in others:
            side = codec.catalogue[name].side
            print(f"\nas {name} from the {side} it is bad: {fault} – say who sent it: --from {side}")
    if not inside:
        return 0
    if not arguments.json:
        frame, fault = next(iter(inside.items()))
        tell_error(arguments, "bad_frame", f"{frame} is bad: {fault}")
    return 1


class StartNames(dict[str, Any]):
    """The start values of parameters and state; the whole definition is read for values that only it has."""

    def __init__(self, codec: CachedCodec) -> None:
        super().__init__(codec.defaults)
        self._codec = codec
        self._scope: Names | None = None

    def __missing__(self, name: str) -> Any:
        if self._scope is None:
            self._scope = scope_of(self._codec.protocol, ())
        return self._scope[name]

    def get(self, name: str, default: Any = None) -> Any:
        try:
            return self[name]
        except KeyError:
            return default


def context(codec: CachedCodec, settings: list[str]) -> Mapping[str, Any]:
    """Return the names that bytes depend on: start values, or these settings. Raises WordsError."""
    return scope_of(codec.protocol, settings) if settings else StartNames(codec)


def frames_tried(codec: CachedCodec, frame: str | None, side: str | None) -> list[str]:
    """Return the names of the frames to try. Raises WordsError for an unknown frame."""
    if frame is None:
        return of_side(codec.catalogue, side)
    protocol = codec.protocol
    if frame not in protocol.frames and frame not in protocol.groups:
        from framekit.definition.problems import no_such

        raise WordsError(no_such(f"'{protocol.name}' has no frame", frame, [*protocol.frames, *protocol.groups]))
    return candidates(protocol, frame, side)


def as_json(
    codec: CachedCodec, fits: list[Fit], data: bytes, names: Mapping[str, Any], faults: Mapping[str, FrameError]
) -> dict[str, Any]:
    """Return the frames with their fields; `faults`: the faults inside of frames, by their names."""
    from framekit.codec.contents import contents_of

    contents = contents_of(codec.protocol, codec)
    shown: list[dict[str, Any]] = []
    for fit in fits:
        one: dict[str, Any] = {"frame": fit.frame, "fields": contents.to_plain(fit.frame, fit.fields)}
        if numbers := contents.names(fit.frame, fit.fields):
            one["names"] = numbers
        if fit.refusal is not None:
            one["refused"] = fit.refusal
        if fit.frame in faults:
            one["bad"] = str(faults[fit.frame])
        if warnings := codec.check_warnings(fit.frame, data, names):
            one["warnings"] = warnings
        shown.append(one)
    return shown[0] | ({"others": shown[1:]} if len(shown) > 1 else {})


def as_text(codec: CachedCodec, fit: Fit, data: bytes, names: Mapping[str, Any]) -> str:
    """Return the frame's name and a table of its fields."""
    _, spans, fault = codec.trace(fit.frame, data, names)
    rows, named = [], codec.catalogue[fit.frame].names
    for path, start, end, value in spans:
        text = "" if value is None else f"{with_name(named, path, shown(value))}"
        rows.append((path, str(start), shown(data[start:end]), text))
    if codec.catalogue[fit.frame].shows:
        from framekit.codec.contents import contents_of

        content = contents_of(codec.protocol, codec).rows(fit.frame, fit.fields)
        rows += [(path, "", "", str(value)) for path, value in content]
    why = "" if fault is None else f": {fault}"
    refused = "" if fit.refusal is None else f"  (a server refuses it with {code_text(fit.refusal)}{why})"
    warned = "".join(f"\nwarning: {text}" for text in codec.check_warnings(fit.frame, data, names))
    return f"{fit.frame}{refused}{warned}\n" + table(rows, ("field", "offset", "bytes", "value"))

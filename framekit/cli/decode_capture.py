"""`framekit decode --capture FILE PROTOCOL`: every frame of a capture, with time, direction, fields and reasons."""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import assignment, existing, print_json
from framekit.cli.line_options import add_filter, add_line, filter_of, line_of
from framekit.cli.main import Failure, WrongWords
from framekit.cli.seen_output import seen_data, seen_text

if TYPE_CHECKING:
    from framekit.codec.plain import PlainValues
    from framekit.definition.model.protocol import Protocol
    from framekit.link.observe import Seen

DAY = 86_400_000_000_000


class _Instead(argparse.Action):
    """An option in the place of an argument that has to be there without it."""

    def __init__(self, *words: Any, instead_of: argparse.Action, **options: Any) -> None:
        super().__init__(*words, **options)
        self._instead_of = instead_of

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        setattr(namespace, self.dest, values)
        self._instead_of.required = False


def add_capture_arguments(parser: argparse.ArgumentParser, bytes_: argparse.Action) -> None:
    """What decoding a capture takes beside PROTOCOL, --set and --json, in the place of `bytes_`."""
    parser.add_argument(
        "--capture", metavar="FILE", type=Path, action=_Instead, instead_of=bytes_,
        help="decode a capture (pcap or JSON lines) instead",
    )  # fmt: skip
    parser.add_argument(
        "--client", choices=("in", "out"), default="out",
        help="direction of the client's frames in a capture that has both; default: out",
    )  # fmt: skip
    parser.add_argument("--ascii", action="store_true", help="show bytes of a capture as ASCII")
    add_line(parser)
    add_filter(parser)


def decode_capture(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Prints everything; 1 when there was a bad frame or noise. Raises Failure."""
    from framekit.codec.plain import PlainValues
    from framekit.link.parameters import ParameterError
    from framekit.service.capture import CaptureError
    from framekit.service.capture_decode import CaptureDecoder
    from framekit.service.frame_log import result_of

    wanted, plain = filter_of(arguments), PlainValues(protocol)
    counts: Counter[str] = Counter()
    try:
        decoder = CaptureDecoder(
            existing(arguments.capture),
            protocol,
            line=line_of(protocol, arguments),
            params=dict(assignment(text) for text in arguments.set),
            client=arguments.client,
        )
        for channel, seen in decoder.seen():
            if seen.kind != "noise" or not seen.reason:  # what a bad frame left is part of that
                counts[seen.kind] += 1
            if not wanted.takes(channel, seen):
                continue
            if arguments.json:
                print_json(
                    seen_data(
                        seen, seen.at / 1e9, plain, time_ns=seen.at, channel=channel, result=result_of(protocol, seen)
                    )
                )
            else:
                print(_text(plain, channel, seen, arguments.ascii))
    except CaptureError as error:
        raise Failure(str(error)) from None
    except ParameterError as error:
        raise WrongWords(str(error)) from None
    if decoder.is_cut:
        print(f"{arguments.capture}: the last record is not whole – its writer was stopped", file=sys.stderr)
    if not arguments.json:
        print(f"{counts['frame']} frames, {counts['bad']} bad, {counts['noise']} times noise")
    return 1 if counts["bad"] or counts["noise"] else 0


def _text(plain: PlainValues, channel: int, seen: Seen, as_ascii: bool) -> str:
    """The line of a frame and, below it, its fields."""
    text = seen_text(seen, time_text(seen.at), f"ch {channel}", as_ascii)
    fields = plain.to_plain(seen.frame, seen.fields)
    shown = "  ".join(f"{name}={_plain(value)}" for name, value in fields.items())
    return f"{text}\n{'':10}{shown}" if shown else text


def _plain(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, (dict, list)) else str(value)


def time_text(at: int) -> str:
    """A time of a capture: the clock, with the date where it is a real one."""
    seconds, rest = divmod(at, 1_000_000_000)
    moment = datetime.fromtimestamp(seconds, UTC)
    date = "" if at < DAY else f"{moment:%Y-%m-%d} "
    return f"{date}{moment:%H:%M:%S}.{rest // 1000:06d}"

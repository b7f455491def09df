"""`framekit encode PROTOCOL FRAME [FIELD=VALUE …]`: the bytes of a frame, as hex."""

from __future__ import annotations

import argparse

from framekit.cli.common import add_json, add_protocol, add_settings, assignment, load, print_json, scope_of, spaced
from framekit.cli.main import WrongWords


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_protocol(parser)
    parser.add_argument("frame", metavar="FRAME", help="name of a frame; `framekit frames PROTOCOL` lists them")
    parser.add_argument("fields", nargs="*", metavar="FIELD=VALUE", help="value of a field; JSON for lists and records")
    add_settings(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from framekit.codec.codec import compile_protocol
    from framekit.codec.encode_hints import with_hint
    from framekit.codec.errors import EncodeError
    from framekit.codec.plain import PlainValues
    from framekit.definition.problems import did_you_mean

    protocol = load(arguments.protocol)
    if arguments.frame not in protocol.frames:
        hint = did_you_mean(arguments.frame, protocol.frames)
        raise WrongWords(f"'{protocol.name}' has no frame '{arguments.frame}'" + (f" – {hint}" if hint else ""))
    given = dict(assignment(text) for text in arguments.fields)
    scope = scope_of(protocol, arguments.set)
    try:
        fields = PlainValues(protocol).from_plain(arguments.frame, given)
        data = compile_protocol(protocol).encode(arguments.frame, fields, scope)
    except EncodeError as error:
        raise WrongWords(f"frame '{arguments.frame}': {with_hint(error, protocol, arguments.frame, given)}") from None
    if arguments.json:
        print_json({"frame": arguments.frame, "bytes": spaced(data)})
    else:
        print(spaced(data))
    return 0

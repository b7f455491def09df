"""`framekit write PROTOCOL --port PORT --station N ADDRESS VALUE …`: puts values into a device."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from framekit.cli.common import print_json
from framekit.cli.one_shot import add_line, add_type, carry_out

if TYPE_CHECKING:
    from framekit.api.client import Client
    from framekit.api.typed import Value
    from framekit.link.addresses import Address, AddressGrammar


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_line(parser)
    parser.add_argument("address", metavar="ADDRESS", help="as the protocol writes addresses")
    parser.add_argument("values", nargs="+", metavar="VALUE", help="decimal, 0x…, or as --type says")
    parser.add_argument("-n", "--count", type=int, metavar="COUNT", help="characters of a string, filled up with 00")
    add_type(parser)


def run(arguments: argparse.Namespace) -> int:
    def values_at(place: Address) -> list[Value]:
        values = [
            value_of(text, arguments.type) if arguments.type else value_at(place, text) for text in arguments.values
        ]
        refuse_signs(place.unit, values, arguments.type or place.type)
        return values

    def check(grammar: AddressGrammar) -> None:
        from framekit.api.errors import RequestError
        from framekit.api.typed import typed
        from framekit.link.packing import PackingError, memory_of

        several = arguments.count or len(arguments.values)
        how = typed(grammar, arguments.address, arguments.type, arguments.order, several)
        try:
            memory_of(how.numbers(values_at(grammar.parse(arguments.address))), how.unit or how.place)
        except PackingError as error:
            raise RequestError(str(error)) from None

    def write(client: Client) -> None:
        values = values_at(client.place(arguments.address))
        client.write(arguments.address, values, type=arguments.type, order=arguments.order, count=arguments.count)
        if arguments.json:
            print_json({"address": arguments.address, "written": len(values)})

    return carry_out(arguments, write, check=check)


def refuse_signs(place: str, values: list[Value], type_: str | None) -> None:
    """Elements of a memory have no sign: a negative number needs a type that says how it stands in them.

    Raises RequestError.
    """
    from framekit.api.errors import RequestError
    from framekit.definition.model.services import UNIT_BITS

    negative = next((value for value in values if isinstance(value, (int, float)) and value < 0), None)
    if negative is None or (type_ is not None and type_ not in UNIT_BITS):
        return
    unit = type_ or place
    bits = UNIT_BITS.get(unit, 0)
    hint = f" – for a number with sign write --type int{bits}" if bits in (8, 16, 32, 64) else ""
    raise RequestError(f"{negative} does not fit into a {unit}: 0 to {(1 << bits) - 1 if bits else '…'}{hint}")


def value_at(place: Address, text: str) -> Value:
    """A value for what a place usually holds; `0x…` is the element as it stands. Raises RequestError."""
    from framekit.definition.model.services import NUMBER_BITS
    from framekit.link.packing import PackingError, memory_of
    from framekit.memory.memory import MemoryValueError
    from framekit.memory.views import NumberView, view_of

    view = None if place.type not in NUMBER_BITS or "x" not in text.lower() else view_of(str(place.type))
    if not isinstance(view, NumberView):
        return value_of(text, place.type)
    try:
        return view.read(memory_of([int(value_of(text, None))], place.unit))[0]
    except (PackingError, MemoryValueError) as error:
        from framekit.api.errors import RequestError

        raise RequestError(str(error)) from None


def value_of(text: str, type_: str | None) -> Value:
    """A value from its text. Raises RequestError."""
    from framekit.api.errors import RequestError
    from framekit.definition.load.scalars import parse_number
    from framekit.definition.model.services import COUNTED_STRING

    if type_ in ("string", COUNTED_STRING):
        return text
    try:
        if type_ in ("float32", "float64"):
            return float(text)
        return parse_number(text)
    except ValueError:
        what = type_ or "whole number"
        hint = (
            "" if type_ in ("float32", "float64") else " – write --type float32 for a fraction, --type string for text"
        )
        raise RequestError(f"'{text}' is no {what}{hint}") from None

"""Places of memory by the words of a definition: area, memory, code or text, with unit, start and count.

The same words name places of a device's memory and places of the other side. Language reference, section 12.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.definition.model.protocol import Protocol
from framekit.link.addresses import Address, AddressGrammar
from framekit.link.area_view import code_of
from framekit.link.backwards import Codes
from framekit.link.device_areas import DeviceAreas, Span
from framekit.memory.memory import UnknownAreaError, unit_bits


def codes_of(protocol: Protocol) -> Codes:
    """What stands for areas on the wire, with the areas and the unit each counts in."""
    codes: Codes = {}
    for area in protocol.areas.values():
        for unit in dict.fromkeys((*area.codes, area.unit)):
            code = code_of(area, unit)
            if code is not None:
                codes.setdefault(code, []).append((area.name, unit))
    return codes


def span_of(areas: DeviceAreas, grammar: AddressGrammar, codes: Codes, given: Mapping[str, Any]) -> Span:
    """The place of a device's memory that the words mean. Raises UnknownAreaError."""
    start, count, unit = int(given.get("start", 0)), int(given.get("count", 1)), given.get("unit")
    if "memory" in given:
        return areas.memory_span(str(given["memory"]), unit, start, count)
    if "text" in given:
        address = grammar.parse(str(given["text"]), unit, check=False)
        return areas.span(address.area, address.unit, address.start + start, count)
    if "code" in given:
        area, own = _coded(codes, given["code"])
        return areas.span(area, unit or own, start, count)
    return areas.span(str(given["area"]), unit, start, count)


def address_of(grammar: AddressGrammar, codes: Codes, given: Mapping[str, Any]) -> Address:
    """The place of the other side that the words mean. Raises UnknownAreaError and AddressError."""
    start, unit = int(given.get("start", 0)), given.get("unit")
    if "text" in given:
        address = grammar.parse(str(given["text"]), unit, check=False)
        return address if start == 0 else grammar.advance(address, start)
    area, own = _coded(codes, given["code"]) if "code" in given else (str(given["area"]), None)
    if area not in grammar.areas:
        raise UnknownAreaError(f"there is no area '{area}'")
    address = Address(area, unit or own or grammar.areas[area].unit, start)
    unit_bits(address.unit)
    return address


def _coded(codes: Codes, code: Any) -> tuple[str, str]:
    found = codes.get(code)
    if not found:
        raise UnknownAreaError(f"no area has the code {code}")
    return found[0]

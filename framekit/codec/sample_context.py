"""What frames may ask for besides their fields, at start values or plausible ones, so that samples of them can be made.

No engine runs: the station is the first that is allowed, the line has a usual speed, announced sizes are small numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName, evaluate, start_values
from framekit.definition.model.protocol import Parameter, Protocol, StateVariable

ANNOUNCED = 16
"""What a size is that an earlier frame would have announced."""


class SampleLine:
    """`line` of the language at a usual speed."""

    speed = 9600

    def chars(self, numerator: int, denominator: int = 1) -> int:
        return 1_041_667 * numerator // denominator

    def bits(self, numerator: int, denominator: int = 1) -> int:
        return 104_167 * numerator // denominator

    def language_attribute(self, name: str) -> int:
        if name != "speed":
            raise KeyError(name)
        return self.speed


def sample_context(protocol: Protocol) -> dict[str, Any]:
    """A context for encoding and decoding frames of this protocol; names it cannot give a value are left out."""
    station = _station(protocol)
    clock = dict.fromkeys(("second", "minute", "hour", "day", "month", "year", "weekday"), 7)
    context: dict[str, Any] = {
        "buffer": b"", "role": "client", "station": station, "own": station, "clock": clock, "now": 0,
        "line": SampleLine(),
    }  # fmt: skip
    context |= start_values(protocol)
    for variable in protocol.state.values():
        if variable.announced:
            context[variable.name] = ANNOUNCED
    items: list[Parameter | StateVariable] = [*protocol.params.values(), *protocol.state.values()]
    for _ in range(3):  # defaults may stand on other defaults
        for item in items:
            if item.name not in context:
                context |= _worked_out(item, context)
    return context


def _station(protocol: Protocol) -> Any:
    station = protocol.station
    if station.type == "text":
        return "A" * min(station.size or 1, 8)
    if station.type == "bytes":
        return bytes(station.size or 1)
    low, high = station.limits or (1, 1)
    return min(max(low, 1), high)


def _worked_out(item: Parameter | StateVariable, context: Mapping[str, Any]) -> dict[str, Any]:
    expression = item.initial if isinstance(item, StateVariable) else item.is_ or item.default
    if expression is None:
        return {}
    try:
        return {item.name: evaluate(expression.root, context.__getitem__)}
    except (MissingName, *EVALUATION_ERRORS):
        return {}

"""Hypothesis strategies that draw valid values of a frame from its model, together with a context.

Computed values are left out. The drawn values respect types, limits, tables, sizes, `where`, conditions and the cases
of choices. If a condition is too complex to be solved, several attempts are made before an example is discarded.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from construct_oracle import ConstructCodec, compile_construct
from construct_oracle.evaluate import evaluate
from construct_oracle.names import Names
from hypothesis import assume
from hypothesis import strategies as st
from strategy_records import TRIES, Maker
from strategy_values import Draw

from framekit.codec.errors import EncodeError
from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName, start_values
from framekit.codec.python.runtime import RangeTable
from framekit.definition.expression import names_in
from framekit.definition.model.frames import expressions_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import Parameter, StateVariable

# ---- context ------------------------------------------------------------------------------------------------


def base_context(protocol: Protocol) -> dict[str, Any]:
    """Return all names except fields that expressions of frames may use, with start values or plausible values."""
    context: dict[str, Any] = {
        "buffer": b"",
        "role": "client",
        "station": 1,
        "own": 1,
        "clock": dict.fromkeys(("second", "minute", "hour", "day", "month", "year", "weekday"), 7),
    }
    context |= start_values(protocol)
    for parameter in protocol.params.values():
        if parameter.secret and context.get(parameter.name) is None:
            context[parameter.name] = "A" if parameter.type == "text" else bytes(range(parameter.size or 16))
    for variable in protocol.state.values():
        if variable.announced and variable.keys is not None:  # as if earlier frames had announced it for every key
            value = bytes(range(16)) if variable.type == "bytes" else 3
            context[variable.name] = RangeTable({}, ((*variable.keys, value),))
    for _ in range(3):  # defaults may depend on other defaults
        items: list[Parameter | StateVariable] = [*protocol.params.values(), *protocol.state.values()]
        for item in items:
            if item.name not in context and not (isinstance(item, StateVariable) and item.keys):
                context |= _worked_out(item, context)
    for name in protocol.tables:
        context.pop(name, None)
    return context


def _worked_out(item: Parameter | StateVariable, context: Mapping[str, Any]) -> dict[str, Any]:
    expression = item.initial if isinstance(item, StateVariable) else item.is_ or item.default
    if expression is None:
        return {}
    try:
        return {item.name: evaluate(expression.root, Names(context, {}).__getitem__)}
    except (MissingName, *EVALUATION_ERRORS):
        return {}


class FrameValues:
    """Draw values of the frames of a protocol."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.codec: ConstructCodec = compile_construct(protocol)
        self.context = base_context(protocol)

    def frame(self, name: str) -> st.SearchStrategy[tuple[dict[str, Any], dict[str, Any]]]:
        """Draw values of the frame, and a context for them."""
        return _drawn(self, name)

    def drawn(self, draw: Draw, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
        context = self._context(draw, name)
        for effort in range(TRIES):
            maker = Maker(draw, self.protocol, self.codec, context, small=effort > TRIES // 2)
            values = maker.frame(name)
            if values is not None and (effort > TRIES - 2 or self._can_be_built(name, values, context)):
                return values, context
        assume(False)
        raise AssertionError

    def _can_be_built(self, name: str, values: dict[str, Any], context: dict[str, Any]) -> bool:
        """Return whether the frame can be encoded; computed lengths and sums may exceed their type."""
        try:
            self.codec.encode(name, values, context)
        except EncodeError:
            return False
        return True

    def _context(self, draw: Draw, frame: str) -> dict[str, Any]:
        """Draw a context with sizes that earlier frames have announced."""
        context = dict(self.context)
        segments = self.protocol.frames[frame].segments
        mentioned = {word for expression in expressions_of(segments) for word in names_in(expression.root)}
        for variable in self.protocol.state.values():
            if variable.announced and variable.keys is None and variable.name in mentioned:
                context[variable.name] = draw(st.integers(8, 40) | st.integers(1, 300))
        return context


@st.composite
def _drawn(draw: Draw, values: FrameValues, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Draw as `FrameValues.frame`: Hypothesis reads the source of each function that it makes a strategy of."""
    return values.drawn(draw, name)

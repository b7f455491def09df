"""Arguments of a service call: checked against what the row takes, completed with its defaults.

It knows rows and names, no engine and no addresses.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from framekit.definition.model.protocol import Parameter
from framekit.definition.model.services import Argument
from framekit.definition.problems import NOWHERE, did_you_mean
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression
from framekit.link.parameters import ParameterError, given_value
from framekit.link.requests import ServiceError
from framekit.link.service_rows import RowFacts

TYPES = ("time", "number", "flag", "choice", "text", "bytes", "list")
"""The types of arguments that are checked; values of any other type are taken as they are."""


def arguments_of(facts: RowFacts, given: Mapping[str, Any], names: Names) -> dict[str, Any]:
    """The values of all arguments of a row, by name. Raises ServiceError for one that is unknown, missing or unfit."""
    row = facts.row
    known = {argument.name for argument in row.takes}
    for name in given:
        if name not in known:
            hint = did_you_mean(name, known)
            raise ServiceError(f"'{row.service}' takes no argument '{name}'" + (f" – {hint}" if hint else ""))
    values = {argument.name: _value(row.service, argument, given, names) for argument in row.takes}
    for name, numbers in facts.named_numbers.items():
        if isinstance(values.get(name), str):
            values[name] = numbers.get(values[name], values[name])
    return values


def _value(service: str, argument: Argument, given: Mapping[str, Any], names: Names) -> Any:
    if argument.name not in given:
        if argument.default is None:
            raise ServiceError(f"'{service}' needs the argument '{argument.name}'")
        try:
            return compile_expression(argument.default)(names)
        except EVALUATION_ERRORS as error:
            raise ServiceError(f"the default of '{argument.name}' cannot be worked out: {error!r}") from None
    value = given[argument.name]
    if argument.type not in TYPES:
        return value
    try:
        return given_value(_as_parameter(argument), value)
    except ParameterError as error:
        raise ServiceError(f"'{service}': {str(error).replace('parameter', 'argument', 1)}") from None


def _as_parameter(argument: Argument) -> Parameter:
    return Parameter(
        name=argument.name,
        type=cast(Any, argument.type),
        default=None,
        is_=None,
        limits=argument.limits,
        choices=argument.choices,
        doc="",
        at=NOWHERE,
        items=cast(Any, argument.items),
    )

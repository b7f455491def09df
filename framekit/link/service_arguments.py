"""Arguments of a service call: checked against what the row takes, completed with its defaults.

It knows rows and names, no engine and no addresses.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, cast

from framekit.codec.shown import explain
from framekit.definition.model.protocol import Parameter
from framekit.definition.model.services import Argument, ServiceRow
from framekit.definition.problems import NOWHERE, did_you_mean, listed
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression
from framekit.link.parameters import ParameterError, given_value
from framekit.link.requests import ServiceError
from framekit.link.services.rows import RowFacts

TYPES = ("time", "number", "flag", "choice", "text", "bytes", "list")
"""The types of arguments that are checked; values of any other type are taken as they are."""


def arguments_of(facts: RowFacts, given: Mapping[str, Any], names: Names) -> dict[str, Any]:
    """The values of all arguments of a row, by name. Raises ServiceError for all that are unknown, missing or unfit."""
    row = facts.row
    values: dict[str, Any] = {}
    problems: list[str] = []
    for argument in row.takes:
        if argument.name in given or argument.default is not None:
            try:
                values[argument.name] = _value(row.service, argument, given, names)
            except ServiceError as error:
                problems.append(str(error))
    if problems or len(values) < len(row.takes) or not given.keys() <= values.keys():
        raise ServiceError("; ".join([*problems, *_misnamed(row, given)]))
    for name, numbers in facts.named_numbers.items():
        if isinstance(values.get(name), str):
            values[name] = numbers.get(values[name], values[name])
    return values


def _misnamed(row: ServiceRow, given: Mapping[str, Any]) -> Iterator[str]:
    """Arguments without which the row cannot be called, and those that it does not take."""
    known = [argument.name for argument in row.takes]
    missing = [f"'{one.name}'" for one in row.takes if one.default is None and one.name not in given]
    if missing:
        yield f"'{row.service}' needs the argument{'s' * (len(missing) > 1)} {listed(missing)}"
    unknown = [name for name in given if name not in known]
    if len(unknown) == 1:
        hint = did_you_mean(unknown[0], known)
        yield f"'{row.service}' takes no argument '{unknown[0]}'" + (f" – {hint}" if hint else "")
    elif unknown:
        hint = f" – known: {', '.join(known)}" if known else ""
        yield f"'{row.service}' takes no arguments {listed(repr(name) for name in unknown)}{hint}"


def _value(service: str, argument: Argument, given: Mapping[str, Any], names: Names) -> Any:
    if argument.name not in given:
        assert argument.default is not None
        try:
            return compile_expression(argument.default)(names)
        except EVALUATION_ERRORS as error:
            raise ServiceError(f"the default of '{argument.name}' cannot be worked out: {explain(error)}") from None
    try:
        return checked(argument, given[argument.name])
    except ParameterError as error:
        raise ServiceError(f"'{service}': {str(error).replace('parameter', 'argument', 1)}") from None


def checked(argument: Argument, value: Any) -> Any:
    """The value as the argument takes it. Raises ParameterError."""
    return given_value(_as_parameter(argument), value) if argument.type in TYPES else value


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

"""The protocol-level names of one engine: parameters, state, tables, the times of its line, and built-in names.

Levels above (the names of a service row, the variables of a sequence, an arrived frame) have this as their last parent.
It knows no sequences and no wire; callers pass the time. The clock of a simulated device runs with that time, can be
set, and starts at a given time: the clock of the computer is not read.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from datetime import datetime, timedelta
from secrets import token_bytes
from typing import Any
from weakref import ref

from framekit.codec.checks import compute
from framekit.codec.ciphers import bytes_given
from framekit.definition.expression import ENGINE_FUNCTIONS, Call, Expression, is_constant, names_in, walk
from framekit.definition.model.checks import ready_methods
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import StateVariable
from framekit.definition.start_values import StartValues, empty_record
from framekit.definition.times import LineFormat
from framekit.link.values import Formula, Names, attribute, compile_expression, compile_optional
from framekit.link.variables import (
    ParameterError,
    StateTable,
    check_value,
    depending,
    empty_of,
    fit_of,
    given_value,
    lasting,
    table_values,
)

MOST_RANDOM = 4096


class LinkFunctions:
    """What expressions of every link find under the name `functions`. `random`: where random bytes come from."""

    def __init__(self, scope: Scope) -> None:
        self._scope = scope
        self.make_random: Callable[[int], bytes] = token_bytes

    def random(self, size: int) -> bytes:
        """Return `size` unpredictable bytes. Raise ValueError for too many."""
        if not 0 <= size <= MOST_RANDOM:
            raise ValueError(f"{size} random bytes are not possible")
        return self.make_random(size)

    def code(self, name: str, data: bytes) -> bytes:
        """Return the check code `name` over `data`, the highest byte first. Raise KeyError, ValueError, TypeError."""
        method = self._scope.protocol.checks.get(name) or ready_methods()[name]
        if method.kind == "code" and method.expression is not None:
            found = compile_expression(method.expression)(Names({"data": bytes(data)}, self._scope))
            return bytes_given(found, name)
        return compute(method, data).to_bytes(method.size, "big")


class LineTimes:
    """`line` of the language: its speed, and how long characters and bits take. On a stream they take no time.

    `line`: as it is now; `own`: as it is by itself. Both None on a stream.
    """

    __slots__ = ("_bit", "character", "line", "own", "speed")

    def __init__(self, line: LineFormat | None) -> None:
        self.own = line
        self.change(line)

    def change(self, line: LineFormat | None) -> None:
        """Set the present speed and format."""
        self.line = line
        self.speed = 0 if line is None else line.speed
        self._bit = 0.0 if line is None else 1_000_000_000 / line.speed
        self.character = 0.0 if line is None else self._bit * line.character_bits

    def chars(self, numerator: int, denominator: int = 1) -> int:
        """Return the duration of numerator / denominator characters in nanoseconds."""
        return round(self.character * numerator / denominator)

    def bits(self, numerator: int, denominator: int = 1) -> int:
        """Return the duration of numerator / denominator bits in nanoseconds."""
        return round(self._bit * numerator / denominator)

    def language_attribute(self, name: str) -> int:
        if name == "speed":
            return self.speed
        raise KeyError(name)


# ---- the clock of a simulated device -------------------------------------------------------------------------

DEFAULT_START = datetime(2000, 1, 1)
_TIME, _DATE = ("second", "minute", "hour"), ("day", "month", "year")
_MODES = {1: _TIME + _DATE, 2: _TIME, 3: _DATE, "both": _TIME + _DATE, "time": _TIME, "date": _DATE}


def moment(at: datetime) -> dict[str, int]:
    """Return a moment as the language sees it: second, minute, hour, day, month, year, weekday (1 = Sunday)."""
    return {
        "second": at.second,
        "minute": at.minute,
        "hour": at.hour,
        "day": at.day,
        "month": at.month,
        "year": at.year,
        "weekday": at.isoweekday() % 7 + 1,
    }


def with_date(clock: Mapping[str, int], frame: Any, mode: int | str) -> dict[str, int]:
    """Return `clock` with the parts that `mode` names (1 both, 2 time, 3 date) replaced by the fields of a frame.

    Years below 100 are of 1970 to 2069. Raise ValueError for a date that does not exist.
    """
    parts = dict(clock)
    for name in _MODES[mode]:
        parts[name] = attribute(frame, name)
    return moment(_datetime(parts))


def _datetime(parts: Mapping[str, int]) -> datetime:
    year = parts["year"]
    if year < 100:
        year += 1900 if year >= 70 else 2000
    return datetime(year, parts["month"], parts["day"], parts["hour"], parts["minute"], parts["second"])


class DeviceClock:
    """A clock that stood at `start` when the engine's time was `now` (ns)."""

    __slots__ = ("_now", "_start")

    def __init__(self, now: int, start: datetime = DEFAULT_START) -> None:
        self._now, self._start = now, start

    def read(self, now: int) -> dict[str, int]:
        return moment(self._start + timedelta(microseconds=(now - self._now) // 1000))

    def set(self, to: Mapping[str, int], now: int) -> None:
        """Raise KeyError or ValueError when `to` is no moment."""
        self._start, self._now = _datetime(to), now


class DeviceState(Names):
    """Variables of scope `device` by name, filled by the first engine of the device.

    `changes` grows whenever one of them changes; `clock` is None until an engine has begun.
    """

    __slots__ = ("changes", "clock")

    def __init__(self) -> None:
        super().__init__()
        self.changes = 0
        self.clock: DeviceClock | None = None


# ---- names ---------------------------------------------------------------------------------------------


class Scope(Names):
    """Names of a protocol's engine. Engines that play one device share its `device` variables and its clock.

    `settings` grows whenever a parameter gets another value.
    """

    __slots__ = (
        "__weakref__",
        "_anew",
        "_beneath",
        "_cache",
        "_expressions",
        "_fits",
        "_lasting",
        "_overrides",
        "_remembered",
        "clock",
        "device",
        "followers",
        "line",
        "now",
        "protocol",
        "settings",
        "writes",
    )  # fmt: skip

    def __init__(
        self,
        protocol: Protocol,
        *,
        role: str | None = None,
        own: Any = None,
        line: LineFormat | None = None,
        params: Mapping[str, Any] | None = None,
        now: int = 0,
        clock_start: datetime = DEFAULT_START,
        device: DeviceState | None = None,
    ) -> None:
        """Raise ParameterError for unknown parameters and values that do not fit."""
        self.device = DeviceState() if device is None else device
        super().__init__(parent=self.device, formulas={})
        self.protocol = protocol
        self.now = now
        self.writes = 0
        self.settings = 0
        self.followers: list[ref[Scope]] = []
        """Further names of this line: their sessions end with the session of the line."""
        self._overrides: list[dict[str, Any]] = []
        self._beneath: dict[str, Any] = {}
        if self.device.clock is None:
            self.device.clock = DeviceClock(now, clock_start)
        self.clock = self.device.clock
        self.line = LineTimes(line)
        self._cache: dict[str, tuple[int, Any]] = {}
        self._remembered: tuple[int, dict[Any, Any]] = 0, {}
        self._lasting: frozenset[str] = frozenset()
        self._expressions: dict[str, Expression] = {}
        self._anew: dict[frozenset[str], dict[str, Formula]] = {}
        self.update({name: table_values(table) for name, table in protocol.tables.items()})
        self.update(role=role or "", line=self.line, own=_own_station(protocol, own))
        assert self.formulas is not None
        formulas: dict[str, Formula] = {"now": lambda _: self.now, "clock": lambda _: self.clock.read(self.now)}
        formulas["station"] = lambda names: names["own"]
        self.formulas = formulas
        self._add_parameters(formulas, params or {})
        self._fits = {
            name: fit_of(variable.type, variable.values, variable.size) for name, variable in protocol.state.items()
        }
        for variable in protocol.state.values():
            if variable.scope != "device":
                self[variable.name] = self._start_value(variable)
            elif variable.name not in self.device:
                self.device[variable.name] = self._start_value(variable)

    @property
    def version(self) -> int:
        """Return a number that grows whenever a variable or parameter changes."""
        return self.writes + self.device.changes

    @property
    def remembered(self) -> dict[Any, Any]:
        """Return the cache for results that depend on these names; a changed variable or parameter clears it."""
        version, found = self._remembered
        if version != self.version:
            self._remembered = self.version, (found := {})
        return found

    def _put(self, name: str, value: Any) -> None:
        """Set a variable at its keeper."""
        if name in self.device:
            self.device[name] = value
            self.device.changes += 1
        else:
            self[name] = value
            self.writes += 1

    # ---- parameters ---------------------------------------------------------------------------------------

    def _add_parameters(self, formulas: dict[str, Formula], given: Mapping[str, Any]) -> None:
        parameters = self.protocol.params
        for name in given:
            if name not in parameters:
                raise ParameterError(name, f"'{self.protocol.name}' has no such parameter")
        for name, parameter in parameters.items():
            value = given_value(parameter, given[name]) if name in given else parameter.is_ or parameter.default
            if isinstance(value, Expression) and is_constant(value):
                self[name] = compile_expression(value)(self)
            elif isinstance(value, Expression):
                formulas[name] = self._formula(name, value)
                self._expressions[name] = value
            elif value is not None:
                self[name] = value
            elif parameter.type == "list":
                self[name] = []
            elif parameter.secret:  # unknown: frames that need it are not good
                self[name] = None
        self._lasting = lasting({name: item for name, item in parameters.items() if name in formulas}, given)

    def _formula(self, name: str, expression: Expression) -> Formula:
        """Return the function of a computed parameter.

        Its result is cached until a variable or parameter changes, unless it depends on the time or an exchange.
        """
        evaluate = compile_expression(expression)

        def formula(_: Names) -> Any:
            version = self.writes + self.device.changes
            found = self._cache.get(name)
            if found is not None and found[0] == version:
                return found[1]
            value = evaluate(self)
            if name in self._lasting:
                self._cache[name] = (version, value)
            return value

        return formula

    def formulas_for(self, given: Iterable[str]) -> Mapping[str, Formula] | None:
        """Return the formulas of parameters that depend on `given`, directly or through others, or None.

        An exchange that overrides these names evaluates the formulas on its own names.
        """
        names = frozenset(given)
        anew = self._anew.get(names)
        if anew is None:
            found = depending(self._expressions, names) - names
            anew = self._anew[names] = {name: compile_expression(self._expressions[name]) for name in found}
        return {name: formula for name, formula in anew.items() if not dict.__contains__(self, name)} or None

    # ---- state --------------------------------------------------------------------------------------------

    def _start_value(self, variable: StateVariable) -> Any:
        initial = compile_optional(variable.initial)
        fit = self._fits[variable.name]
        if variable.given is not None:
            return self._given_start(variable)
        if variable.keys is not None:
            fill = None if initial is None else lambda: fit(initial(self))
            return StateTable(variable.keys, fit_of(variable.type, size=variable.size), fill)
        if initial is not None:
            return fit(initial(self))
        if variable.announced:
            return None
        layout = self.protocol.layouts.get(variable.layout or "")
        if variable.type == "record" and layout is not None:
            return empty_record(layout.segments)
        return empty_of(variable.type, variable.size)

    def _given_start(self, variable: StateVariable) -> Any:
        """Return the start value of a variable that is given as constants."""
        value = StartValues(self.protocol.layouts).of(variable)
        if variable.keys is None:
            return self._fits[variable.name](value)
        table = StateTable(variable.keys, fit_of(variable.type, size=variable.size), None)
        for key, entry in (value or {}).items():
            table.put(key, entry)
        return table

    def changes(self, expression: Expression) -> bool:
        """Return whether the value of an expression may change although the parameters remain."""
        root = expression.root
        if any(isinstance(node, Call) and node.function in ENGINE_FUNCTIONS for node in walk(root)):
            return True
        names = names_in(root) - {"station"}
        if names & _OF_EXCHANGES or any(name in self.protocol.state for name in names):
            return True
        formulas = names & (self.formulas or {}).keys()
        return any(name not in self._expressions or self.changes(self._expressions[name]) for name in formulas)

    def set(self, name: str, value: Any) -> None:
        """Set a variable or a parameter. Raise KeyError (no such name), TypeError or ValueError (does not fit)."""
        fit = self._fits.get(name)
        if fit is not None:
            most = self.protocol.state[name].most
            fitted = fit(value)
            self._put(name, fitted[-most:] if most is not None and type(fitted) is list else fitted)
        elif name == "clock":
            self.clock.set(value, self.now)
            self.device.changes += 1
        else:
            parameter = self.protocol.params[name]
            if parameter.is_ is not None:
                raise ParameterError(name, f"it is always {parameter.is_} and cannot be set")
            check_value(parameter, value)
            self.settings += 1
            self._put(name, fit_of(parameter.type)(value))

    def worked_out(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return checked values for parameters; other names keep their values. Raise ParameterError."""
        found = dict(given)
        for name in given.keys() & self.protocol.params.keys():
            taken = given_value(self.protocol.params[name], given[name])
            found[name] = compile_expression(taken)(self) if isinstance(taken, Expression) else taken
        return found

    def override(self, given: Mapping[str, Any]) -> Callable[[], None]:
        """Give parameters other values; the result restores the previous values, independently of other overrides.

        Raise ParameterError, KeyError for unknown parameters, without any change.
        """
        for name in given.keys() - self.protocol.params.keys():
            raise KeyError(name)
        layer = self.worked_out(given)
        for name in layer:
            if not any(name in other for other in self._overrides):
                self._beneath[name] = dict.get(self, name, _NOT_THERE)
        self._overrides.append(layer)
        self._overridden(layer)

        def back() -> None:
            self._overrides[:] = [other for other in self._overrides if other is not layer]
            self._overridden(layer)

        return back

    def _overridden(self, names: Iterable[str]) -> None:
        """Give each of these parameters its latest override, or its own value if no override remains."""
        for name in names:
            given = [layer[name] for layer in self._overrides if name in layer]
            value = given[-1] if given else self._beneath.pop(name)
            if value is _NOT_THERE:
                self.pop(name, None)
            else:
                self[name] = value
        self.writes += 1
        self.settings += 1

    def change_line(self, line: LineFormat | None) -> None:
        """Set another speed and format of the line; cached results that depend on them are dropped."""
        self.line.change(line)
        self.writes += 1
        self.settings += 1

    def set_entry(self, name: str, key: Any, value: Any) -> None:
        """Set an entry of a table, an item of a list or a field of a record variable."""
        holder = self[name]
        if isinstance(holder, StateTable):
            holder.put(key, value)
            self._put(name, holder)
        else:
            changed = holder.copy()
            changed[key] = value
            self._put(name, changed)

    def drop_entry(self, name: str, key: Any) -> None:
        """Take an entry out of a table. Raise KeyError if it has none."""
        holder = self[name]
        del holder[key]
        self._put(name, holder)

    def reset_session(self, but: Collection[str] = ()) -> None:
        """Reset session variables to their start values, except `but`; also those of followers."""
        for variable in self.protocol.state.values():
            if variable.scope == "session" and variable.name not in but:
                self[variable.name] = self._start_value(variable)
        self.writes += 1
        self.followers = [follower for follower in self.followers if follower() is not None]
        for follower in self.followers:
            if (scope := follower()) is not None:
                scope.reset_session()

    def published(self, of_device: bool) -> dict[str, Any]:
        """Return the variables that are shown as status; with `of_device` also those of the device."""
        shown = [one for one in self.protocol.state.values() if one.publish and (of_device or one.scope != "device")]
        return {variable.name: self[variable.name] for variable in shown}


def _own_station(protocol: Protocol, own: Any) -> Any:
    if own is not None or protocol.station.default is None:
        return own
    return compile_expression(protocol.station.default)(Names())


_NOT_THERE = object()
_OF_EXCHANGES = frozenset({"request", "reply", "buffer"})


class CommandScope(Scope):
    """Names of an application of commands on one channel, whose names are `channel`; sessions end with its."""

    __slots__ = ("channel", "shared")

    def __init__(self, application: Protocol, channel: Scope) -> None:
        super().__init__(application, role=channel["role"], own=channel["own"], now=channel.now)
        self.channel = channel
        theirs = channel.protocol.state.keys() | channel.protocol.params.keys()
        self.shared = frozenset((application.state.keys() | application.params.keys()) & theirs)
        assert self.formulas is not None
        formulas: dict[str, Formula] = dict(self.formulas)
        for name in (*self.shared, "now", "clock", "line", "station"):
            self.pop(name, None)
            self.device.pop(name, None)
            formulas[name] = _of(channel, name)
        self.formulas = formulas
        channel.followers.append(ref(self))

    def reset_session(self, but: Collection[str] = ()) -> None:
        """Reset the session variables of the application; those of the channel stay."""
        super().reset_session(self.shared)

    def set(self, name: str, value: Any) -> None:
        """Set a variable or a parameter; a name of the channel is set in the scope of the channel."""
        if name in self.shared or name == "clock":
            self.channel.set(name, value)
        else:
            super().set(name, value)

    def set_entry(self, name: str, key: Any, value: Any) -> None:
        """Set an entry; an entry of a variable of the channel is set in the scope of the channel."""
        if name in self.shared:
            self.channel.set_entry(name, key, value)
        else:
            super().set_entry(name, key, value)

    def drop_entry(self, name: str, key: Any) -> None:
        """Drop an entry; an entry of a variable of the channel is dropped in the scope of the channel."""
        if name in self.shared:
            self.channel.drop_entry(name, key)
        else:
            super().drop_entry(name, key)


def _of(channel: Scope, name: str) -> Callable[[Names], Any]:
    return lambda names: channel[name]

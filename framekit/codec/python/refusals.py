"""Why values cannot be sent: the rules of a frame's values, and the first value that breaks one.

Pasted into generated modules, whose encoders ask it when something went wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from framekit.codec.errors import EncodeError
from framekit.codec.support import Unfit

Context = Mapping[str, Any]


class Rule(NamedTuple):
    """What a value must be. `least` and `most` limit numbers, and the length of texts, bytes and lists.

    `names` (name → number) may be given instead of the number, `only` those. A number is a multiple of `unit`.
    `inside`: the rules of a mapping or of the items of a list ('' for items that are plain values).
    """

    type: str
    least: int | None = None
    most: int | None = None
    needed: bool = False
    names: Any = ()
    only: bool = False
    unit: int = 1
    inside: Any = None


Rules = Mapping[str, Rule]


def check_given(
    values: Context,
    rules: Rules,
    computed: Context,
    path: str = "",
    elsewhere: tuple[str, ...] = (),
    absent: tuple[str, ...] = (),
) -> None:
    """Every value must be known, and what is computed must be as computed.

    `elsewhere`: names of cases not taken. `absent`: names of what is not there; None may be given for them. Raises
    EncodeError.
    """
    if elsewhere or not values.keys() <= rules.keys():
        for name in values:
            if name not in rules or name in elsewhere:
                raise EncodeError(f"{path}{name}", f"there is no '{path}{name}' in this frame")
    for name in absent:
        if values.get(name) is not None:
            raise EncodeError(path + name, f"'{path}{name}' is not part of this frame, but {values[name]!r} is given")
    for name, right in computed.items():
        if name in values and name not in absent:
            given = values[name]
            if rules[name].names and isinstance(given, str):
                given = rules[name].names.get(given, given)
            if given != right:
                raise EncodeError(path + name, f"'{path}{name}' is computed as {right!r}, not {given!r}")


def encode_error(values: Any, rules: Rules, error: Exception) -> EncodeError:
    """What is wrong with the values, in one sentence."""
    if isinstance(error, EncodeError):
        return error
    found = find_misfit(values, rules, "") if isinstance(values, Mapping) else None
    if found is not None:
        return found
    missing = path_of(error.args[0], rules) if isinstance(error, KeyError) else None
    if missing is not None:
        return EncodeError(missing, f"'{missing}' is missing")
    if isinstance(error, KeyError) and isinstance(error.args[0], str):
        name = error.args[0]
        return EncodeError("", name if " " in name else f"'{name}' is needed to build this frame: give it in ctx")
    why = str(error) if isinstance(error, Unfit) else "what is computed from them cannot be worked out or sent"
    return EncodeError("", f"the values do not fit into this frame: {why}")


def path_of(name: Any, rules: Rules) -> str | None:
    """The path of the value of that name, None if there is none."""
    if name in rules:
        return str(name)
    for outer, rule in rules.items():
        inner = path_of(name, rule.inside) if rule.inside else None
        if inner is not None:
            return f"{outer}.{inner}"
    return None


def find_misfit(values: Context, rules: Rules, path: str) -> EncodeError | None:
    """The first value that breaks its rule, or, if that is one that is missing, all that are."""
    for name in values:
        if name not in rules:
            return EncodeError(f"{path}{name}", f"there is no '{path}{name}' in this frame")
    for name, rule in rules.items():
        if name in values:
            found = misfit_of(values[name], rule, path + name)
        elif rule.needed:
            found = missing_error([one for one in rules if rules[one].needed and one not in values], path)
        else:
            found = None
        if found is not None:
            return found
    return None


def missing_error(names: list[str], path: str) -> EncodeError | None:
    """Values that are not there."""
    if not names:
        return None
    *some, last = [f"'{path}{name}'" for name in names]
    verb = f"{', '.join(some)} and {last} are" if some else f"{last} is"
    return EncodeError(path + names[0], f"{verb} missing", tuple(path + name for name in names[1:]))


def misfit_of(value: Any, rule: Rule, name: str) -> EncodeError | None:
    """What is wrong with one value."""
    if rule.names and (isinstance(value, str) or (rule.only and isinstance(value, (int, float)))):
        if value in rule.names or value in rule.names.values():
            return None
        return EncodeError(name, f"'{name}' is one of {', '.join(rule.names)}, not {value!r}")
    kinds: dict[str, Any] = {"number": int, "float": (int, float), "text": str, "bytes": (bytes, bytearray)}
    kinds |= {"digits": (bytes, bytearray), "list": (list, tuple), "mapping": Mapping, "any": object}
    if not isinstance(value, kinds[rule.type]):
        return EncodeError(name, f"'{name}' must be a {rule.type}, not {type(value).__name__}")
    if rule.type in ("number", "float"):
        size, what = value, f"'{name}' is {value}"
    else:
        size = len(value) if rule.type in ("text", "bytes", "digits", "list") else 0
        what = f"'{name}' has a length of {size}"
    if rule.least is not None and size < rule.least:
        return EncodeError(name, f"{what}, less than {rule.least}")
    if rule.most is not None and size > rule.most:
        return EncodeError(name, f"{what}, more than {rule.most}")
    if rule.unit != 1 and value % rule.unit:
        return EncodeError(name, f"{what}, no multiple of {rule.unit}")
    if rule.type == "digits" and (size % 2 or value.strip(b"0123456789ABCDEFabcdef")):
        return EncodeError(name, f"'{name}' is not made of pairs of hex digits")
    if rule.type == "text" and any(ord(sign) > 255 for sign in value):
        return EncodeError(name, f"'{name}' has characters that are no bytes")
    return None if rule.inside is None else misfit_inside(value, rule.inside, name)


def misfit_inside(value: Any, rules: Rules, name: str) -> EncodeError | None:
    """What is wrong in a mapping or in the items of a list."""
    if isinstance(value, Mapping):
        return find_misfit(value, rules, f"{name}.")
    for place, item in enumerate(value):
        path = f"{name}[{place}]"
        if "" in rules:
            found = misfit_of(item, rules[""], path)
        elif isinstance(item, Mapping):
            found = find_misfit(item, rules, f"{path}.")
        else:
            found = EncodeError(path, f"'{path}' must be a mapping of fields")
        if found is not None:
            return found
    return None


def needed(values: Context, name: str, path: str) -> Any:
    """A value of a record that has to be there. Raises EncodeError."""
    if name not in values:
        raise EncodeError(path + name, f"'{path}{name}' is missing")
    return values[name]


def check_size(name: str, found: int, wanted: int | None) -> None:
    """A value must be as long as another one says. Raises EncodeError."""
    if wanted is None:
        raise EncodeError(name, f"the size of '{name}' cannot be told: a value it is worked out from is not there")
    if found != wanted:
        raise EncodeError(name, f"'{name}' has a length of {found}, it must be {wanted}")


NEEDS: dict[str, tuple[str, ...]] = {
    "check_given": ("Rule",),
    "encode_error": ("Unfit", "find_misfit", "path_of"),
    "find_misfit": ("Rule", "misfit_of", "missing_error"),
    "misfit_of": ("Rule", "misfit_inside"),
    "misfit_inside": ("find_misfit", "misfit_of"),
}
IMPORTS: dict[str, tuple[str, ...]] = {"Rule": ("from typing import NamedTuple",)}

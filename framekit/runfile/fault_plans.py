"""Read fault plans: a file `NAME.faults.yaml`, or a plan inside a device or run file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from framekit.definition.load.documents import load_file
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.frames import parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check
from framekit.definition.nodes import Mapping, Node
from framekit.definition.problems import NOWHERE, DefinitionError, Position, Problem, did_you_mean
from framekit.definition.sources import INSIDE, leaves_folder
from framekit.definition.times import NEVER
from framekit.link.frame_faults import station_fields
from framekit.run.model import FaultPlan, FaultRule

SUFFIX = ".faults.yaml"

SETTINGS = {
    "delay": ("time",),
    "jitter": ("time",),
    "truncate": ("bytes",),
    "extra": ("bytes", "data", "place"),
    "split": ("time", "bytes"),
    "error_reply": ("code",),
    "stray": ("time", "bytes", "data"),
    "disconnect": ("time",),
}
"""The settings of each kind of fault, apart from its frequency."""

NEEDED = {"delay": "time", "jitter": "time", "noise": "rate", "stray": "time"}


def load_fault_plan(name: str | Path, folder: Path | None = None, at: Position = NOWHERE) -> FaultPlan:
    """Return the plan in a file (a Path, or a name with a suffix), or `NAME.faults.yaml` in `folder`.

    `at` is the position of the name. Raise DefinitionError with all problems.
    """
    path = _find(name, folder or Path.cwd(), at)
    return load_file(
        path, "faults", lambda reader, root: _PlanLoader(reader).plan(root, reader.text(root.get("faults")))
    )


def read_fault_plan(
    reader: Reader, node: Node | None, folder: Path, protocol: Protocol | None, *, line: bool = False
) -> FaultPlan | None:
    """Return the plan under `faults:` of another file, given by name or in place; None if missing. Problems are noted.

    `line`: the plan applies to a whole line, not only to the frames that one device sends. Without a protocol only the
    plan itself is checked.
    """
    if node is None:
        return None
    if isinstance(node, Mapping):
        plan = _PlanLoader(reader).plan(node, "faults")
        reader.problems.extend(() if protocol is None else mismatches(plan, protocol, line=line))
        return plan
    with reader.going_on():
        name = reader.text(node)
        if leaves_folder(name, folder):
            raise reader.broken(node.at, f"'{name}' leaves the folder of this file", INSIDE)
        try:
            plan = load_fault_plan(name, folder, node.at)
        except DefinitionError as error:
            reader.problems.extend(error.problems)
            return None
        for problem in () if protocol is None else mismatches(plan, protocol, line=line):
            reader.note(node.at, problem.what, problem.todo)
        return plan
    return None


def _find(name: str | Path, folder: Path, at: Position) -> Path:
    if isinstance(name, Path) and os.path.isfile(name):
        return name
    for candidate in (folder / name, folder / f"{name}{SUFFIX}"):
        if os.path.isfile(candidate):
            return candidate
    at = Position(str(name), 0, 0) if at is NOWHERE else at
    plans = {path.name for path in folder.glob(f"*{SUFFIX}")}
    if Path(name).suffix in (".yaml", ".yml"):
        what, todo = f"there is no file '{name}'", did_you_mean(str(name), plans) or "check its name and folder"
    else:
        known = {plan.removesuffix(SUFFIX) for plan in plans}
        what, todo = f"there is no fault plan '{name}'", did_you_mean(str(name), known)
        todo = todo or f"write the file {Path(name).name}{SUFFIX}"
    raise DefinitionError([Problem(at, what, todo)])


class _PlanLoader:
    """Reads one plan. Problems go to the reader."""

    def __init__(self, reader: Reader) -> None:
        self.reader = reader

    def plan(self, root: Mapping, name: str) -> FaultPlan:
        rules: list[FaultRule] = []
        seed = 0
        with self.reader.going_on():
            seed = 0 if (node := root.get("seed")) is None else self.reader.number(node)
        for item in self.reader.items(root.get("rules")):
            with self.reader.going_on():
                rules.append(self.rule(self.reader.mapping(item)))
        return FaultPlan(name=name, seed=seed, rules=tuple(rules), at=root.at)

    def rule(self, keys: Mapping) -> FaultRule:
        """Return one rule. Raise Broken after all its keys have been read."""
        reader, before = self.reader, len(self.reader.problems)
        kind = reader.text(keys.get("fault"))
        self._settings(kind, keys)
        place, of = keys.get("place"), keys.get("of")
        begin, end = reader.tried(reader.time, keys.get("from")), reader.tried(reader.time, keys.get("until"))
        rule = FaultRule(
            kind=kind,  # type: ignore[arg-type]  # the schema knows them
            of=None if of is None else reader.text(of),  # type: ignore[arg-type]
            rate=reader.tried(self._share, keys.get("rate")),
            every=reader.tried(self._positive, keys.get("every")),
            times=reader.tried(self._positive, keys.get("times")),
            begin=begin or 0,
            end=NEVER if end is None else end,
            frame=reader.tried(reader.text, keys.get("frame")),
            time=reader.tried(partial(self._time, kind), keys.get("time")),
            size=reader.tried(self._positive, keys.get("bytes")),
            data=reader.tried(reader.bytes, keys.get("data")),
            before=place is not None and reader.text(place) == "before",
            code=reader.tried(reader.number, keys.get("code")),
            at=keys.at,
        )
        if len(reader.problems) > before:
            raise Broken("a key of the rule")
        if rule.end <= rule.begin:
            raise reader.broken(keys.at, "the window ends before it begins", "give an until behind from")
        return rule

    def _settings(self, kind: str, keys: Mapping) -> None:
        reader = self.reader
        allowed = SETTINGS.get(kind, ())
        for key in ("time", "bytes", "data", "place", "code"):
            node = keys.get(key)
            if node is not None and key not in allowed:
                reader.note(node.at, f"'{key}' means nothing for {kind}", "leave it out")
        rate, every = keys.get("rate"), keys.get("every")
        if rate is not None and every is not None:
            reader.note(every.at, "a rule has a rate or every, not both", "write two rules")
        elif every is not None and kind in ("noise", "stray"):
            what = f"{kind} comes by itself, not with frames"
            reader.note(every.at, what, "give a rate for each bit" if kind == "noise" else "give the time between two")
        if (data := keys.get("data")) is not None and keys.get("bytes") is not None:
            reader.note(data.at, "there are data and bytes", "leave one of them out")
        needed = NEEDED.get(kind)
        if needed is not None and keys.get(needed) is None:
            reader.note(keys.at, f"{kind} needs '{needed}'", f"add {needed}:")

    def _share(self, node: Node) -> float:
        """Return a share written as `0.05`, `5 %` or `1/20`. Raise Broken."""
        text = self.reader.text(node).strip()
        try:
            if "/" in text:
                above, _, below = text.partition("/")
                share = int(above) / int(below)
            else:
                share = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
        except (ValueError, ZeroDivisionError):
            raise self.reader.broken(node.at, f"'{text}' is no share", "write it like 0.05, 5 % or 1/20") from None
        if not 0 <= share <= 1:
            raise self.reader.broken(node.at, f"'{text}' is no probability", "give one from 0 to 1")
        return share

    def _positive(self, node: Node) -> int:
        number = self.reader.number(node)
        if number < 1:
            raise self.reader.broken(node.at, f"{number} is too little here", "give 1 or more")
        return number

    def _time(self, kind: str, node: Node) -> int:
        time = self.reader.time(node)
        if not 0 < time < NEVER:
            raise self.reader.broken(
                node.at, f"'{self.reader.text(node)}' is no time for {kind}", "give one such as 100 ms"
            )
        return time


def mismatches(plan: FaultPlan, protocol: Protocol, *, line: bool) -> Iterator[Problem]:
    """Yield rules that cannot be applied, such as a wrong check code in a protocol without check codes.

    `line`: the plan applies to a whole line; without it, to a device, which sends no requests.
    """
    for rule in plan.rules:
        if rule.of == "requests" and not line:
            what = "a device sends replies only, and this rule is about requests"
            yield Problem(rule.at, what, "put the plan on the channel of a run, or leave this rule out")
        if rule.frame is not None and rule.frame not in protocol.frames:
            hint = did_you_mean(rule.frame, protocol.frames)
            yield Problem(rule.at, f"'{protocol.name}' has no frame '{rule.frame}'", hint)
        elif rule.kind == "wrong_check" and not _has_check(protocol, rule.frame):
            where = f"frame '{rule.frame}'" if rule.frame else f"'{protocol.name}'"
            yield Problem(rule.at, f"{where} has no check code that could be wrong", "leave this rule out")
        elif rule.kind == "wrong_station" and not station_fields(protocol):
            yield Problem(rule.at, f"frames of '{protocol.name}' name no station", "leave this rule out")
        elif rule.kind == "error_reply" and not protocol.services:
            yield Problem(rule.at, f"'{protocol.name}' has no services that could be refused", "leave this rule out")


OFFERED = FaultPlan(
    name="offered",
    rules=(
        FaultRule(kind="no_reply", is_on=False),
        FaultRule(kind="delay", time=500_000_000, is_on=False),
        FaultRule(kind="wrong_check", is_on=False),
        FaultRule(kind="wrong_station", is_on=False),
        FaultRule(kind="error_reply", is_on=False),
        FaultRule(kind="truncate", is_on=False),
        FaultRule(kind="extra", is_on=False),
        FaultRule(kind="disconnect", times=1, is_on=False),
    ),
)
"""Faults that a user can switch on while a device is served; all are off at the start."""


def offered_faults(protocol: Protocol) -> FaultPlan:
    """Return the offered faults that a device of this protocol can have."""
    rules = (
        rule for rule in OFFERED.rules if not any(mismatches(replace(OFFERED, rules=(rule,)), protocol, line=False))
    )
    return replace(OFFERED, rules=tuple(rules))


def _has_check(protocol: Protocol, frame: str | None) -> bool:
    frames: Iterable[str] = protocol.frames if frame is None else (frame,)
    return any(True for name in frames for _ in parts_of(protocol.frames[name].segments, Check))

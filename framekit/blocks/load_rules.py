"""Reads how a channel treats its line and stations: silences, dead stations, joined reads, time-outs and repeats.

The same keys may stand in the run (for every channel), in a channel and, some of them, for a station and in a block.
"""

from __future__ import annotations

import re
from typing import Any

from framekit.blocks.given import parse_station, read_params
from framekit.blocks.model import DeadRule, Merge, Silence, StationRules
from framekit.definition.load.reader import Reader
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Mapping, Node
from framekit.definition.times import NEVER, LineFormat
from framekit.link.line_times import LineTimes
from framekit.link.parameters import ParameterError, given_value

PARAMETERS = {
    "retries": "retries",
    "timeout": "reply_timeout",
    "reply_timeout": "reply_timeout",
    "byte_timeout": "byte_timeout",
}
"""Keys that are short for a parameter of the protocol, where it has one of this name."""

OCCASIONS = ("between", "connect", "station")

_LINE_TIME = re.compile(r"\s*(\d+)(?:\.(\d+))?\s*(char|bit)s?\s*")


class RulesLoader:
    """Reads rules; what is wrong is noted, and left out."""

    def __init__(self, reader: Reader, root: Mapping) -> None:
        self.reader = reader
        self.root = root

    def _node(self, keys: Mapping, name: str) -> Node | None:
        """A key of the channel, else of the run."""
        node = keys.get(name)
        return self.root.get(name) if node is None else node

    # ---- silences -----------------------------------------------------------------------------------------

    def silence(self, keys: Mapping, line: LineFormat | None) -> Silence:
        """`silence: TIME` or times for several occasions; `pause: TIME` is the one between two exchanges."""
        pause, node = keys.get("pause"), self._node(keys, "silence")
        found = {"between": 0 if pause is None else self.time(pause, line)}
        if isinstance(node, Mapping):
            found |= {name: self.time(value, line) for name in OCCASIONS if (value := node.get(name)) is not None}
        elif node is not None:
            found["between"] = self.time(node, line)
        if pause is not None and keys.get("silence") is not None:
            self.reader.note(pause.at, "pause and silence say the same", "leave pause out")
        return Silence(**found)

    def time(self, node: Node, line: LineFormat | None) -> int:
        """A time, also in characters or bits of the line (ns); 0 for what is none."""
        match = _LINE_TIME.fullmatch(self.reader.text(node))
        with self.reader.going_on():
            if match is None:
                return self.reader.time(node)
            if line is None:
                raise self.reader.broken(node.at, "a connection has no characters or bits", "give a time such as 5 ms")
            digits = match[2] or ""
            times = LineTimes(line)
            count = times.chars if match[3] == "char" else times.bits
            return count(int(match[1] + digits), 10 ** len(digits))
        return 0

    def _number(self, node: Node | None, usual: int) -> int:
        with self.reader.going_on():
            return usual if node is None else self.reader.number(node)
        return usual

    # ---- stations -----------------------------------------------------------------------------------------

    def dead(self, keys: Mapping) -> DeadRule | None:
        return self._dead(self._node(keys, "dead"))

    def _dead(self, node: Node | None) -> DeadRule | None:
        """`dead: no` or `{failures, after, every}`; without it the usual rule."""
        usual = DeadRule()
        if not isinstance(node, Mapping):
            return usual if node is None else None
        failures, after, every = node.get("failures"), node.get("after"), node.get("every")
        rule = DeadRule(
            failures=self._number(failures, usual.failures),
            after=usual.after if after is None else self.time(after, None),
            every=usual.every if every is None else self.time(every, None),
        )
        if failures is not None and rule.failures < 1:
            self.reader.note(failures.at, "a station cannot be dead before it failed", "give 1 or more")
        if every is not None and rule.every < 1:
            self.reader.note(every.at, "a dead station is asked now and then", "give a time such as 60 s")
        return rule

    def stations(self, keys: Mapping, protocol: Protocol) -> dict[Any, StationRules]:
        """`stations: {STATION: {params, retries, timeout, dead}}`."""
        found: dict[Any, StationRules] = {}
        for entry in self.reader.entries(keys.get("stations")):
            with self.reader.going_on():
                try:
                    station = parse_station(entry.key.text, protocol)
                except ValueError as error:
                    what, _, todo = str(error).partition(" – ")
                    raise self.reader.broken(entry.key.at, what, todo) from None
                own = self.reader.mapping(entry.value)
                dead = own.get("dead")
                found[station] = StationRules(
                    params=self.params(own, protocol), dead=self._dead(dead), own_dead=dead is not None
                )
        return found

    def params(self, keys: Mapping, protocol: Protocol) -> dict[str, Any]:
        """`params:` and the keys that are short for one of them, in their YAML form, each tried."""
        found = read_params(self.reader, self.reader.entries(keys.get("params")), protocol)
        for key, name in PARAMETERS.items():
            node = keys.get(key)
            if node is None:
                continue
            with self.reader.going_on():
                parameter = protocol.params.get(name)
                if parameter is None:
                    kind = "number" if key == "retries" else "time"
                    known = ", ".join(one for one, it in protocol.params.items() if it.type == kind)
                    what = f"'{protocol.name}' has no parameter '{name}'"
                    what += "" if key == name else f", which {key} stands for"
                    raise self.reader.broken(
                        node.at, what, f"set these by params: {known}" if known else "leave it out"
                    )
                if name in found:
                    raise self.reader.broken(node.at, f"'{name}' stands in params too", "leave one of them out")
                text = self.reader.text(node)
                if parameter.type == "time" and not 0 < self.reader.time(node) < NEVER:
                    raise self.reader.broken(node.at, f"'{text}' is no {key}", "give a time such as 500 ms")
                try:
                    given_value(parameter, text)
                except ParameterError as error:
                    what, _, todo = str(error).partition(" – ")
                    raise self.reader.broken(node.at, what, todo) from None
                found[name] = text
        return found

    # ---- joined reads -------------------------------------------------------------------------------------

    def merge(self, keys: Mapping) -> Merge | None:
        """`merge: yes|no` or `{gap, max}`; off without it."""
        node = self._node(keys, "merge")
        if node is None:
            return None
        if not isinstance(node, Mapping):
            return Merge() if self.reader.flag(node, default=False) else None
        gap, most = node.get("gap"), node.get("max")
        merge = Merge(gap=self._number(gap, 0), most=None if most is None else self._number(most, 1))
        if merge.gap < 0 or (merge.most is not None and merge.most < 1):
            self.reader.note(node.at, "these limits join nothing", "give a gap of 0 or more, and a max of 1 or more")
        return merge

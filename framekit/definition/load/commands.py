"""Command blocks of a definition: the `block` of a service row, and the section `commands`."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from framekit.definition.expression.syntax import Expression, Text
from framekit.definition.load.reader import Reader
from framekit.definition.load.values import ValueLoader
from framekit.definition.model.commands import After, BlockWork, CommandCall, CommandRules, JobWork, PlaceOf
from framekit.definition.model.values import Value
from framekit.definition.nodes import Mapping, Node
from framekit.definition.problems import did_you_mean

SESSION_WORDS = ("new", "end")
JOBS = ("job", "abort", "inspect")
DEFAULT_MOST = 512
"""The most words of a command block where the definition does not say."""

WordOrValue = Callable[[str, Node], Value]


class CommandLoader:
    """Reads blocks and the section; `word_or_value` reads the parts of a place."""

    def __init__(self, values: ValueLoader, word_or_value: WordOrValue) -> None:
        self.values = values
        self.reader: Reader = values.reader
        self._word_or_value = word_or_value

    def block(self, node: Node) -> BlockWork:
        """The exchange that a request asks for. Raises Broken."""
        reader, values, keys = self.reader, self.values, self.reader.mapping(node)
        kinds = [key for key in ("read", "write", "call") if key in keys]
        for one, other in pairwise(kinds):
            at = keys.get(other)
            reader.note(node.at if at is None else at.at, f"a block has {one} and {other}", "leave one of them out")
        for kind, own in (("read", "into"), ("write", "from")):
            if kind in keys and not {own, "then"} & {*_words(keys)} and "data" not in _words(keys.get(kind)):
                reader.note(node.at, f"a block has {kind}, but no {own}", f"add {own}: with a place of the own memory")
            if own in keys and kind not in keys and "inspect" not in keys:
                reader.note(node.at, f"a block has {own}, but no {kind}", f"add {kind}: with a place of the other side")
        return BlockWork(
            station=reader.maybe(values.value, keys.get("station")),
            params=values.fields(keys.get("params")),
            session=reader.maybe(self._session, keys.get("session")),
            read=self._place(keys.get("read")),
            write=self._place(keys.get("write")),
            into=self._place(keys.get("into")),
            source=self._place(keys.get("from")),
            calls=self._calls(keys.get("call")),
            then=self._then(keys.get("then")),
            job=self._job(keys),
            at=keys.at,
        )

    def _job(self, keys: Mapping) -> JobWork | None:
        """The command to the run's jobs, if it is one."""
        kind = next((name for name in JOBS if name in keys), None)
        if kind is None:
            return None
        reader, values = self.reader, self.values
        if kind == "job" and not {"read", "write", "report"} & {*_words(keys)}:
            reader.note(keys.at, "a job moves nothing", "add read:, write: or report:")
        return JobWork(
            kind=kind,
            slot=values.value(keys.get(kind) or keys),
            report=self._place(keys.get("report")),
            host=reader.maybe(values.value, keys.get("host")),
            every=reader.maybe(values.value, keys.get("every")),
            late=reader.maybe(values.value, keys.get("late")),
            times=reader.maybe(values.value, keys.get("times")),
            at=keys.at,
        )

    def _session(self, node: Node) -> Expression:
        """A bare word, or an expression that gives one."""
        scalar = self.reader.scalar(node)
        if scalar.text in SESSION_WORDS:
            return Expression(scalar.text, Text(scalar.at, scalar.text))
        return self.reader.expression(node)

    def _place(self, node: Node | None) -> PlaceOf | None:
        if node is None:
            return None
        entries = self.reader.entries(node)
        return {entry.key.text: self._word_or_value(entry.key.text, entry.value) for entry in entries}

    def _calls(self, node: Node | None) -> tuple[CommandCall, ...]:
        calls = []
        for item in () if node is None else self.reader.items(node):
            for entry in self.reader.entries(item):
                calls.append(
                    CommandCall(service=entry.key.text, arguments=self.values.fields(entry.value), at=entry.key.at)
                )
        return tuple(calls)

    def _then(self, node: Node | None) -> tuple[After, ...]:
        return tuple(self._after(self.reader.mapping(item)) for item in self.reader.items(node))

    def _after(self, keys: Mapping) -> After:
        return After(
            when=self.reader.maybe(self.reader.expression, keys.get("when")),
            set=self.values.settings(keys.get("set")),
            store=self._place(keys.get("store")),
            at=keys.at,
        )

    def rules(self, node: Node) -> CommandRules:
        """The section `commands` of an application. Raises Broken."""
        reader, keys = self.reader, self.reader.mapping(node)
        frame = keys.get("frame")
        if frame is not None and reader.text(frame) not in self.values.frames.outlines:
            known = list(self.values.frames.outlines)
            what = f"there is no frame '{reader.text(frame)}'"
            raise reader.broken(frame.at, what, did_you_mean(reader.text(frame), known))
        missing = [name for name in ("frame", "request", "status", "failed") if name not in keys]
        if missing:
            raise reader.broken(keys.at, f"commands: has no {', '.join(missing)}", "add it")
        request, failed, most = keys.get("request"), keys.get("failed"), keys.get("most")
        return CommandRules(
            frame=reader.maybe(reader.text, frame) or "",
            request=reader.maybe(reader.text, request) or "",
            most=DEFAULT_MOST if most is None else reader.number(most),
            status=self._place(keys.get("status")) or {},
            done=reader.maybe(reader.expression, keys.get("done")),
            failed=reader.expression(failed),
            meaning=reader.maybe(reader.expression, keys.get("meaning")),
            waits=reader.maybe(reader.expression, keys.get("waits")),
            then=self._then(keys.get("then")),
            at=keys.at,
        )


def _words(node: Node | None) -> list[str]:
    """The keys of a mapping."""
    return [entry.key.text for entry in node.entries] if isinstance(node, Mapping) else []

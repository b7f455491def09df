"""The short way of an exchange: one request that is repeated, made into bytes and its reply into values at once.

Most exchanges are one question and one answer, and nothing else happens meanwhile. For these the steps of the sequence
are worked out beforehand, as far as they are the same every time. It only says what the steps would have come to:
whatever is not that plain is left to them (see `direct_lane`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from framekit.definition.times import NEVER
from framekit.link.direct_plan import DirectPlan, changes
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names
from framekit.link.exchange import Exchange, Outcome
from framekit.link.frame_info import FrameInfo
from framekit.link.frame_table import FrameTable, echoed
from framekit.link.interest import Interest
from framekit.link.machine import arguments_of
from framekit.link.patching import patch_of
from framekit.link.runs import Dealing
from framekit.link.same_reply import SameReply, learn
from framekit.link.scope import Scope
from framekit.link.values import FrameValue, frames_in, plain


class NotPlainError(Exception):
    """The short way is none for this request."""


class Echo:
    """What frames have to repeat: fields with the same value every time, and fields that the request got anew."""

    __slots__ = ("changing", "fixed")

    def __init__(self, fixed: tuple[tuple[str, Any], ...], changing: tuple[str, ...]) -> None:
        self.fixed = fixed
        self.changing = changing

    def holds(self, fields: dict[str, Any], sent: dict[str, Any]) -> bool:
        """Whether a reply with these fields repeats what was sent."""
        for name, wanted in self.fixed:
            if name in fields and fields[name] != wanted:
                return False
        return all(name not in fields or fields[name] == sent[name] for name in self.changing)


class DirectRequest:
    """One request of a plan, for as long as no parameter changes.

    `data_fields`: where replies, by their frames, bring data and nothing else that matters, `data_size` bytes of them;
    `same` is what has been learned from one of them. Raises NotPlainError, and EVALUATION_ERRORS for what cannot be
    worked out now.
    """

    data_fields: Mapping[str, str] | None = None
    data_size = 0
    same: SameReply | None = None

    def __init__(self, plan: DirectPlan, table: FrameTable, scope: Scope, exchange: Exchange) -> None:
        self.plan = plan
        self.scope = scope
        self.settings = scope.settings
        self._table = table
        dealing = Dealing(scope, exchange, True)
        self._request = dealing.request
        sequence = plan.sequence
        self._fresh = {**sequence.variables(), **arguments_of(sequence, dealing), "it": None}
        self.names = Names({**dealing.names, **self._fresh}, scope)
        self.station, self.outside_session = exchange.station, exchange.outside_session
        self._guards = tuple(self._conditions())
        self._within = NEVER if plan.within is None else int(plan.within(self.names))
        self.fixed_within = None if plan.within_changes else self._within
        self._settings = tuple(
            (scope.setter(name), compute, self._read_in(reads)) for name, compute, reads in plan.settings
        )
        self._is_fresh = False
        self._prepare_frame()
        self._prepare_replies(exchange.expected)

    def _conditions(self) -> Iterator[tuple[Evaluate, bool]]:
        """The conditions that have to be asked every time."""
        for condition in self.plan.conditions:
            if condition.changes:
                yield condition.holds, condition.wanted
            elif bool(condition.holds(self.names)) is not condition.wanted:
                raise NotPlainError

    def _read_in(self, names: Collection[str]) -> Names:
        """Where these names are found with the fewest steps."""
        return self.scope if self.names.keys().isdisjoint(names) else self.names

    def _prepare_frame(self) -> None:
        plan = self.plan
        self._made: FrameValue = plan.send(self.names)
        self.info = info = self._table.infos[self._made.frame]
        self._changing = tuple(
            (name, compute, self._read_in(reads)) for name, compute, changes, reads in plan.fields if changes
        )
        self._changes = changing = {name for name, *_ in self._changing}
        of_others = info.computed or changing & info.numbers.keys() or changing & {name for _, name, _ in info.shape}
        if info.announces or (changing and of_others):
            raise NotPlainError
        self.fields: dict[str, Any] = plain(self._made.fields)
        data = info.encode(self.fields, self.names)
        frames = [self._table.infos[name].frame.segments for name in frames_in(self._made)]
        worked_out = changes(frames, self.scope)
        self._data = None if changing or worked_out else data
        self._sent = self._made.copy()
        self._table.mark_sent(self._sent, data, self.names)
        alone = len(self._changing) == 1 and not worked_out
        self._patch = patch_of(self._sent, self._changing[0][0], self._table.infos) if alone else None

    def _prepare_replies(self, expected: tuple[str, ...]) -> None:
        step = self.plan.step
        interest = Interest(self._table, step.names(expected), ())
        infos = [info for name in interest.expected if (info := self._table.infos[name]).on_line]
        self._interest = None if len(infos) == 1 else interest
        self._only = infos[0] if len(infos) == 1 else None
        self._echoes: dict[str, Echo | None] = {}
        self._rows = {info.name: step.matching(info.name, expected) for info in infos}
        if not infos or any(info.announces or self._echo_of(info) is None for info in infos):
            raise NotPlainError

    # ---- asking -------------------------------------------------------------------------------------------

    def begin(self) -> bytes | None:
        """What is to be sent now; None: the steps go another way this time, nothing has been done.

        Raises EVALUATION_ERRORS.
        """
        names = self.names
        if not self._is_fresh:
            names.update(self._fresh)
            self._is_fresh = True
        for holds, wanted in self._guards:
            if bool(holds(names)) is not wanted:
                return None
        for put, compute, where in self._settings:
            put(compute(where))
        if self._data is not None:
            return self._data
        fields, patch = self.fields, self._patch
        for name, compute, where in self._changing:
            fields[name] = value = compute(where)
            if patch is not None and (data := patch(value)) is not None:
                return data
        return self.info.encode(fields, names)

    def within(self) -> int:
        """How long the reply may take (ns)."""
        if self.fixed_within is None and self.plan.within is not None:
            return int(self.plan.within(self.names))
        return self._within

    def sent_value(self, data: bytes) -> FrameValue:
        """The frame that these bytes are, as a sequence that sends it has it."""
        value = self._made.copy()
        for name, *_ in self._changing:
            value.fields[name] = self.fields[name]
        self._table.mark_sent(value, data, self.names)
        return value

    # ---- answers ------------------------------------------------------------------------------------------

    def take(self, data: bytes, sent: bytes, context: Names) -> tuple[FrameValue, Outcome] | None:
        """The reply to `sent` that these bytes are, and how the exchange ends with it; None for anything else."""
        info = self._only or self._likely(data)
        if info is None:
            return None
        try:
            if info.measure(data, 0, len(data), context, 0) != len(data):
                return None
            fields = info.decode(data, context)
            value = self._table.received_as(info, fields, data, None)
            found = self._end(info, value, data) if self._repeats(info, value) else None
        except (NotPlainError, *EVALUATION_ERRORS):
            return None
        if self.data_fields is not None and found is not None:
            self._learn(value, found[1], sent)
        return found

    def _learn(self, whole: FrameValue, outcome: Outcome, sent: bytes) -> None:
        """Learns from the first reply that brings as many data as were asked for."""
        reply, fields = outcome.reply, self.data_fields
        if reply is None or fields is None or reply.frame not in fields:
            return
        found = reply.fields.get(fields[reply.frame])
        if type(found) is not bytes or len(found) != self.data_size:
            return
        self.data_fields = None
        if self._only is not None and self.plan.hands_over:
            self.same = learn(
                self._table.infos, self.scope, self.plan.rows, self.sent_value(sent), self._changes, whole, reply,
                fields[reply.frame],
            )  # fmt: skip

    def _likely(self, data: bytes) -> FrameInfo | None:
        """The only frame waited for that these bytes may be; None if there is none, or more than one."""
        left = None if self._interest is None or not data else self._interest.left(data, 0)
        return None if left is None else left.alone

    def _repeats(self, info: FrameInfo, value: FrameValue) -> bool:
        """Whether a frame, and those in it, repeat what they have to."""
        echo = self._echoes[info.name] if info.name in self._echoes else self._echo_of(info)
        if echo is None or not echo.holds(value.fields, self.fields):
            return False
        for kind, name, _ in info.shape:
            inner = value.fields.get(name) if kind == "inner" else None
            if type(inner) is FrameValue and not self._repeats(self._table.infos[inner.frame], inner):
                return False
        return True

    def _echo_of(self, info: FrameInfo) -> Echo | None:
        """What a frame has to repeat; None if that cannot be said beforehand."""
        fixed: list[tuple[str, Any]] = []
        changing: list[str] = []
        self._echoes[info.name] = None
        for field, plain_name, evaluate in info.echo:
            if plain_name is None and changes(info.frame.echo[field], self.scope):
                return None
            found = self._repeated(plain_name, evaluate)
            if found is None:
                continue
            wanted, is_same = found
            if is_same:
                fixed.append((field, wanted))
            elif plain_name == field:
                changing.append(field)
            else:
                return None
        echo = self._echoes[info.name] = Echo(tuple(fixed), tuple(changing))
        return echo

    def _repeated(self, plain_name: str | None, evaluate: Evaluate) -> tuple[Any, bool] | None:
        """What is repeated, of the first that has it, and whether it is the same every time. Raises NotPlainError."""
        for source in (self._request, self._sent):
            if source is None:
                continue
            try:
                wanted = echoed(plain_name, evaluate, source, self.names)
            except EVALUATION_ERRORS:
                continue
            if source is self._request or self._data is not None:
                return wanted, True
            if plain_name in self._changes or plain_name in self._made.fields:
                return wanted, plain_name not in self._changes
            raise NotPlainError
        return None

    def _end(self, info: FrameInfo, value: FrameValue, data: bytes) -> tuple[FrameValue, Outcome] | None:
        """What the first row that fits makes of the reply; None if that is not the end."""
        names = self.names
        self._is_fresh = False
        names["it"] = value
        for row in self._rows[info.name]:
            if row.when is None or row.when(names):
                break
        else:
            return None
        settings = self.plan.endings.get(row)
        if settings is None:
            return None
        for name, fit, compute in settings:
            names[name] = fit(compute(names))
        results = {name: evaluate(names) for name, evaluate in self.plan.sequence.gives}
        reply, buffer = results.get("reply"), results.get("buffer", b"")
        return value, Outcome(
            True,
            reply=reply if type(reply) is FrameValue else None,
            buffer=buffer if isinstance(buffer, bytes) else b"",
            results=results,
            raw=data,
        )

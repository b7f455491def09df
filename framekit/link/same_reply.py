"""What the next reply to a repeated request looks like, byte by byte, but for its data and what the request got anew.

Learned from a reply that has been judged with all care: one that differs from it nowhere else is judged alike. Where
the definition does not make that certain, nothing is learned.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from framekit.codec.python.choices import fixed_bytes
from framekit.definition.expression.syntax import Attribute, Call, Expression, Name, names_in, walk
from framekit.definition.model.procedure import Row
from framekit.definition.model.segments import Check, Data, Field, Inner
from framekit.definition.model.walk import expressions_of
from framekit.link.frame_info import FrameInfo
from framekit.link.intact import Intact
from framekit.link.scope import Scope
from framekit.link.spans import Span, spans_of
from framekit.link.values import FrameValue, frames_in

Bytes = tuple[int, int, bytes]
"""From where to where a reply has which bytes."""
Pair = tuple[int, int, int, int]
"""From where to where a reply has what the request has from where to where."""


class SameReply:
    """A reply as it will be again; its data stand from `start` to `end`."""

    __slots__ = ("_changing", "_code", "_field", "_like", "_repeated", "_same", "_size", "end", "start")

    def __init__(
        self, like: FrameValue, changing: tuple[str, ...], size: int, same: tuple[Bytes, ...],
        repeated: tuple[Pair, ...], data: Span, code: Intact | None,
    ) -> None:  # fmt: skip
        self.start, self.end = data.start, data.end
        self._like, self._field = like, str(data.segment.name)
        self._changing = changing
        self._size = size
        self._same = same
        self._repeated = repeated
        self._code = code

    def fits(self, reply: bytes, sent: bytes) -> bool:
        """Whether these bytes are the reply to what was sent, whatever its data."""
        if len(reply) != self._size:
            return False
        for start, end, wanted in self._same:
            if reply[start:end] != wanted:
                return False
        for start, end, first, last in self._repeated:
            if reply[start:end] != sent[first:last]:
                return False
        return self._code is None or self._code(reply)

    def value(self, data: bytes, raw: bytes, sent: Mapping[str, Any]) -> FrameValue:
        """The frame that has brought these data, in the bytes `raw`; `sent` are the fields of the request."""
        like = self._like
        fields = {**like.fields, self._field: data}
        for name in self._changing:
            fields[name] = sent[name]
        return FrameValue(like.frame, fields, None if like.raw is None else raw)


def learn(
    infos: Mapping[str, FrameInfo], scope: Scope, rows: Iterable[Row], sent: FrameValue, changing: Collection[str],
    whole: FrameValue, reply: FrameValue, field: str,
) -> SameReply | None:  # fmt: skip
    """What is to be learned from a frame `whole` that answers `sent`; `reply`, it or in it, has its data in `field`.

    `rows` have judged it. Of what was sent, the `changing` fields are others every time. None where what is made of a
    reply may depend on its data, or on anything else that may change.
    """
    raw, asked = whole.raw, sent.raw
    info = infos[whole.frame]
    if raw is None or asked is None or whole.refusal is not None:
        return None
    holder = [name for name, value in whole.fields.items() if value is reply]
    if list(frames_in(whole)) != [whole.frame, *([] if reply is whole else [reply.frame])]:
        return None
    if reply is not whole and not holder:
        return None
    if _depends(infos, scope, rows, {whole.frame, reply.frame}, {field, *changing}, holder):
        return None
    spans, its = spans_of(whole, len(raw), infos), spans_of(sent, len(asked), infos)
    if spans is None or its is None:
        return None
    data = [one for one in spans if one.frame == reply.frame and one.segment.name == field]
    if len(data) != 1 or not _has_a_place(data[0], infos, whole, holder):
        return None
    if any(isinstance(span.segment, Data) and span.segment.name in changing for span in its):
        return None
    repeated: list[Pair] = []
    free = {data[0]}
    for span in spans:
        if isinstance(span.segment, Check):
            if span is not spans[-1] or info.intact is None or span.segment.form != "raw":
                return None
            free.add(span)
        elif span.segment.name in changing:
            source = [one for one in its if one.frame == sent.frame and one.segment.name == span.segment.name]
            if span.frame != whole.frame or len(source) != 1 or not _same_form(span, source[0]):
                return None
            repeated.append((span.start, span.end, source[0].start, source[0].end))
            free.add(span)
    same = _between(raw, spans, free)
    if reply is not whole and not _only_this(infos, whole, reply, raw, same, spans):
        return None
    code = info.intact if isinstance(spans[-1].segment, Check) else None
    own = tuple(name for name in changing if reply is whole and name in whole.fields)
    return SameReply(reply, own, len(raw), same, tuple(repeated), data[0], code)


def _has_a_place(data: Span, infos: Mapping[str, FrameInfo], whole: FrameValue, holder: Collection[str]) -> bool:
    """Whether these data end where a number says so, and not where a byte is found that could be one of them."""
    frames = [infos[whole.frame].frame, infos[data.frame].frame]
    if not isinstance(data.segment, Data) or any(frame.delimited for frame in frames):
        return False
    if data.segment.size != "rest":
        return True
    room = [part.size for part in frames[0].segments if isinstance(part, Inner) and part.name in holder]
    return frames[1].segments[-1] is data.segment and bool(room) and None not in room


def _only_this(
    infos: Mapping[str, FrameInfo], whole: FrameValue, reply: FrameValue, raw: bytes, same: Iterable[Bytes],
    spans: Iterable[Span],
) -> bool:  # fmt: skip
    """Whether bytes that stay the same contradict every frame that would be taken before `reply`."""
    begin = next(span.start for span in spans if span.frame == reply.frame)
    kept = {place for start, end, _ in same for place in range(start, end)}
    for segment in infos[whole.frame].frame.segments:
        if isinstance(segment, Inner) and reply.frame in segment.frames:
            for name in segment.frames[: segment.frames.index(reply.frame)]:
                wanted = fixed_bytes(infos[name].frame.segments)
                if not any(begin + at in kept and raw[begin + at] not in values for at, values in wanted):
                    return False
    return True


def _depends(
    infos: Mapping[str, FrameInfo], scope: Scope, rows: Iterable[Row], frames: Collection[str], fields: Collection[str],
    holder: Collection[str],
) -> bool:  # fmt: skip
    """Whether reading these frames, or a row that judges them, may come to something else with other values."""
    data = {*fields, *holder}
    for frame in frames:
        for expression in expressions_of(infos[frame].frame.segments):
            if names_in(expression.root) & data or scope.changes(expression):
                return True
    conditions = [row.when for row in rows if row.when is not None]
    return any(_looks_at(one, fields, holder) or scope.changes(one, within_exchange=False) for one in conditions)


def _looks_at(condition: Expression, fields: Collection[str], holder: Collection[str]) -> bool:
    """Whether a condition may look at one of these fields of what came, `it`, or at all of a frame."""
    nodes = list(walk(condition.root))
    parts = [node.value for node in nodes if isinstance(node, Attribute)]
    for node in nodes:
        if isinstance(node, Call) or (isinstance(node, Attribute) and node.name in fields):
            return True
        is_frame = node.name in holder if isinstance(node, Attribute) else isinstance(node, Name) and node.name == "it"
        if is_frame and not any(node is part for part in parts):
            return True
    return False


def _same_form(one: Span, other: Span) -> bool:
    """Whether equal values of both stand there as equal bytes, and nothing else may be wrong with them."""
    mine, its = one.segment, other.segment
    if not isinstance(mine, Field) or not isinstance(its, Field):
        return False
    return mine.type == its.type and all(
        getattr(mine, name) == getattr(its, name)
        for name in ("values", "only", "limits", "plus", "unit", "long", "zero_means", "constants", "is_")
    )


def _between(raw: bytes, spans: Iterable[Span], free: Collection[Span]) -> tuple[Bytes, ...]:
    """The bytes that stand everywhere else, in as few pieces as possible."""
    found: list[Bytes] = []
    for span in spans:
        if span not in free and span.end > span.start:
            start = span.start
            if found and found[-1][1] == start:
                start = found.pop()[0]
            found.append((start, span.end, raw[start : span.end]))
    return tuple(found)

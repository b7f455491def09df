"""Command blocks as words: read from memory as the frame that an application of commands says, and made from fields.

Sans-I/O. What the command then does, and on which channel, is not known here.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from framekit.codec.plain import PlainValues
from framekit.definition.model.commands import CommandRules
from framekit.definition.model.frame_sizes import fixed_size
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Inner, Length
from framekit.definition.model.walk import parts_of
from framekit.definition.problems import plural
from framekit.link.arrivals import BadFrame, FrameArrived
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.frame_table import Codec, FrameTable
from framekit.link.receiver import Receiver
from framekit.link.values import FrameValue


class CommandFaultError(ValueError):
    """The words are no command block at all, or its status word has no place; no status word can tell of it.

    `segment` is the one at fault, where it is one, `found` what it holds.
    """

    def __init__(self, message: str, segment: str = "", found: str = "") -> None:
        super().__init__(message)
        self.segment = segment
        self.found = found


class StatusPlaceError(CommandFaultError):
    """The words are a command whose status word has no place."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command block that has been read: the whole record, the request inside it, and its bytes in memory's form.

    `request.refusal` is the code of a request that is to be refused as it stands.
    """

    block: FrameValue
    request: FrameValue
    raw: bytes


class CommandWords:
    """Reads and makes the command blocks of one application. Raises ValueError when it has none."""

    def __init__(self, application: Protocol, codec: Codec, table: FrameTable, names: Names) -> None:
        self.application = application
        self.rules = rules_of(application)
        self._codec = codec
        self._table = table
        self._names = names
        segments = application.frames[self.rules.frame].segments
        before = itertools.takewhile(lambda segment: segment.name != self.rules.request, segments)
        self.head_size = sum(fixed_size(segment) or 0 for segment in before)
        """Bytes of a block before the request."""
        counts = (one.name for one in segments if isinstance(one, Length) and self.rules.request in one.of)
        self.length = next(counts, "")

    def read(self, data: bytes) -> Command:
        """The command that begins at the first of these bytes; what comes behind it is not looked at.

        Raises CommandFaultError.
        """
        receiver = Receiver(self._codec, self.application, self._names, self._table)
        receiver.append(data, 0)
        found = receiver.next((self.rules.frame,))
        if isinstance(found, FrameArrived):
            request = found.value.fields.get(self.rules.request)
            if isinstance(request, FrameValue):
                return Command(found.value, request, found.raw)
            raise CommandFaultError("it holds no command that is known")
        if isinstance(found, BadFrame):
            text = f"'{found.segment}' is {found.found}, expected {found.expected}"
            raise CommandFaultError(text, found.segment, found.found)
        raise CommandFaultError("it has more words than there are")

    def head_misfit(self, data: bytes) -> str:
        """How the length that a head says and what stands behind the head disagree; '' where neither can be told.

        It is for words that are no command by themselves: those that are one need no head.
        """
        behind = data[self.head_size :]
        there = plural(len(behind) // 2, "word")
        try:
            said = len(self.read(data + bytes(2 * self.rules.most)).raw) - self.head_size
        except CommandFaultError as error:
            is_head = self.is_known(behind) or (len(data) == self.head_size and error.found == "0")
            return f"{error} ({there} behind the head)" if is_head and error.segment == self.length else ""
        return "" if said == len(behind) else f"the head says {plural(said // 2, 'word')}, and {there} stand behind it"

    def is_known(self, data: bytes) -> bool:
        """Whether these bytes are a request that does not exist to be refused."""
        try:
            name, _ = self.read_request(data)
        except CommandFaultError:
            return False
        return self.application.frames[name].refuse is None

    def make(self, request: str, fields: Mapping[str, Any], head: Mapping[str, Any]) -> bytes:
        """The bytes of a command with these plain values, the usual ones where none are given.

        Raises ValueError (EncodeError) naming what does not fit.
        """
        known = PlainValues(self.application).from_plain(
            self.rules.frame, {**head, self.rules.request: {request: dict(fields)}}
        )
        return self._table.encode(FrameValue(self.rules.frame, known), self._names)

    def read_request(self, data: bytes) -> tuple[str, dict[str, Any]]:
        """The request that exactly these bytes are, by its name, and its fields. Raises CommandFaultError."""
        for name in self.requests:
            try:
                return name, self._table.infos[name].decode(data, self._names)
            except EVALUATION_ERRORS:
                continue
        raise CommandFaultError("these words are no command")

    @property
    def requests(self) -> tuple[str, ...]:
        """The commands there are, by the names of their frames; those that exist to be refused come last."""
        frame = self.application.frames[self.rules.frame]
        return tuple(
            name for inner in parts_of(frame, Inner) if inner.name == self.rules.request for name in inner.frames
        )

    def head(self) -> tuple[str, ...]:
        """The fields of a block beside the request."""
        return tuple(
            segment.name
            for segment in self.application.frames[self.rules.frame].segments
            if segment.name and segment.name != self.rules.request
        )


def rules_of(application: Protocol) -> CommandRules:
    """How an application's records are command blocks. Raises ValueError when it has none."""
    if application.commands is None:
        raise ValueError(f"'{application.name}' has no command blocks")
    return application.commands


def words_of(data: bytes) -> list[int]:
    """Bytes in memory's form as words of 16 bits."""
    return [int.from_bytes(data[at : at + 2], "little") for at in range(0, len(data), 2)]


def bytes_of(words: list[int]) -> bytes:
    """Words of 16 bits, also negative ones, in memory's form. Raises ValueError for a number that is none."""
    for word in words:
        if not -0x8000 <= word <= 0xFFFF:
            raise ValueError(f"{word} is no word of 16 bits: 0 to 65535")
    return b"".join((word & 0xFFFF).to_bytes(2, "little") for word in words)

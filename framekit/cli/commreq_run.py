"""Command blocks carried out on a port, one after the other, over an own memory; what each did is printed."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from framekit.cli.common import assignment, print_json
from framekit.cli.main import WrongWords
from framekit.link.codes import code_text

if TYPE_CHECKING:
    from framekit.api.client import Client
    from framekit.blocks.command_meaning import Meaning
    from framekit.blocks.commands import CommandBlocks, CommandEnd
    from framekit.definition.model.protocol import Protocol
    from framekit.link.addresses import AddressGrammar
    from framekit.link.services.areas import Span
    from framekit.memory.memory import DeviceMemory

FAULT, REFUSED, NO_ANSWER = 2, 1, 3
"""Exit statuses: no command block, refused by the port or the device, no good answer came."""

JUDGED = ("refused", "no_such_place", "no_own_place", "cannot_send", "cannot_store", "not_allowed")
"""Outcomes of commands that were answered, or that nothing was sent for."""


class CommandOutput:
    """What commands do to an own memory, printed. `memory` begins with zeros and what --set puts there."""

    def __init__(self, blocks: CommandBlocks, protocol: Protocol, arguments: argparse.Namespace) -> None:
        self.blocks = blocks
        self.protocol = protocol
        self.arguments = arguments
        self.memory: DeviceMemory = blocks.areas.memory
        self.grammar: AddressGrammar = blocks.server.shared.grammar
        for text in arguments.set:
            self._put(text)

    def _put(self, text: str) -> None:
        """A start value of the own memory. Raises WrongWords."""
        from framekit.definition.load.scalars import parse_number
        from framekit.memory.memory import DeviceMemoryError

        address, values = assignment(text)
        try:
            place = self.grammar.parse(address)
            numbers = [parse_number(value) for value in str(values).split(",")]
            self.memory.write(place.area, place.unit, place.start, numbers, force=True)
        except (ValueError, DeviceMemoryError) as error:
            raise WrongWords(f"--set {text}: {error}") from None

    def content(self) -> dict[str, bytes]:
        """The memory as it is now."""
        return {area.name: area.read_bytes(0, area.size_bytes) for area in self.memory}

    def meaning(self, data: bytes) -> tuple[Meaning, Span]:
        """What a command means, and the place of its status word. Raises CommandFaultError, DeviceMemoryError."""
        from framekit.blocks.command_meaning import meaning_of

        command = self.blocks.words.read(data)
        return meaning_of(command, self.blocks, self.protocol, judge=False), self.blocks.status_place(command)

    def fault(self, why: str) -> int:
        """Tells that words are no command; the exit status."""
        print(f"framekit {self.arguments.verb}: this is no command block: {why}", file=sys.stderr)
        return FAULT

    def show(self, meaning: Meaning, place: Span, end: CommandEnd, before: dict[str, bytes]) -> None:
        """How a command ended, with what it changed."""
        changes = self.changes(before, place)
        if self.arguments.json:
            print_json(_as_json(meaning, end, changes))
            return
        word = {self._address(place.memory, place.unit, one) for one in _places(place)}
        self._print(meaning, end, {address: changes[address] for address in changes if address not in word})

    def _print(self, meaning: Meaning, end: CommandEnd, changes: dict[str, list[int]]) -> None:
        from framekit.cli.commreq_verb import command_line

        print(command_line(meaning))
        for number, line in enumerate(meaning.does):
            print(f"{'' if number else 'does':<9}{line}")
        self.show_changes(changes)
        failed = "" if end.failure is None or end.failure.outcome == "refused" else f" ({end.failure.outcome})"
        print(f"status   {meaning.status} = {code_text(end.status)} {end.meaning}".rstrip() + failed)

    def show_changes(self, changes: dict[str, list[int]]) -> None:
        """What is otherwise in the memory."""
        for address, values in changes.items():
            print(f"{address:<8} {' '.join(map(str, values))}", flush=True)

    def changes(self, before: dict[str, bytes], status: Span | None = None) -> dict[str, list[int]]:
        """The elements that are others now: the address of the first of each run, with the values from there on.

        The status word is a run by itself.
        """
        from framekit.link.packing import values_of
        from framekit.memory.memory import unit_bits

        found: dict[str, list[int]] = {}
        word = {} if status is None else {status.memory: (status.start, status.start + status.count)}
        for area in self.memory:
            now = area.read_bytes(0, area.size_bytes)
            if now == before[area.name]:
                continue
            count = len(now) * 8 // unit_bits(area.unit)
            old, new = values_of(before[area.name], area.unit, count), values_of(now, area.unit, count)
            last = -2
            values: list[int] = []
            for place in (place for place in range(count) if old[place] != new[place]):
                if place != last + 1 or place in word.get(area.name, ()):
                    values = found.setdefault(self._address(area.name, area.unit, place), [])
                values.append(new[place])
                last = place
        return found

    def _address(self, area: str, unit: str, place: int) -> str:
        """A place of the own memory as the application writes it; in words where it has no form for that."""
        from framekit.link.addresses import Address, AddressError

        address = Address(area, unit, place)
        try:
            return self.grammar.print(address) if area in self.grammar.areas else str(address)
        except AddressError:
            return str(address)


class CommandRun:
    """The commands of one call: they share the line, the session and the memory."""

    def __init__(self, client: Client, blocks: CommandBlocks, arguments: argparse.Namespace) -> None:
        self.client = client
        self.blocks = blocks
        self.output = CommandOutput(blocks, client.protocol, arguments)

    def carry_out(self, data: bytes) -> int:
        """Carries a command out and prints what came of it; the exit status."""
        from framekit.blocks.command_words import CommandFaultError
        from framekit.memory.memory import DeviceMemoryError

        try:
            meaning, place = self.output.meaning(data)
        except (CommandFaultError, DeviceMemoryError) as error:
            return self.output.fault(str(error))
        before = self.output.content()
        end = self.client.command(self.blocks, data)
        if end.fault:
            return self.output.fault(end.fault)
        self.output.show(meaning, place, end, before)
        if end.failure is None:
            return 0
        return REFUSED if end.failure.outcome in JUDGED else NO_ANSWER


def _places(span: Span) -> range:
    return range(span.start, span.start + span.count)


def _as_json(meaning: Meaning, end: CommandEnd, changes: dict[str, list[int]]) -> dict[str, Any]:
    return {
        "command": meaning.request, "words": meaning.words, "does": meaning.does, "memory": changes,
        "status": end.status, "meaning": end.meaning, "outcome": "" if end.failure is None else end.failure.outcome,
    }  # fmt: skip

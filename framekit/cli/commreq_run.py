"""Command blocks carried out on a port, one after the other, over an own memory; what each did is printed."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from framekit.cli.common import assignment, print_json
from framekit.cli.main import WrongWords

if TYPE_CHECKING:
    from framekit.api.client import Client
    from framekit.blocks.command_meaning import Meaning
    from framekit.blocks.commands import CommandBlocks, CommandEnd
    from framekit.link.addresses import AddressGrammar
    from framekit.link.device_areas import Span
    from framekit.memory.memory import DeviceMemory

FAULT, REFUSED, NO_ANSWER = 2, 1, 3
"""Exit statuses: no command block, refused by the port or the device, no good answer came."""

JUDGED = ("refused", "no_such_place", "no_own_place", "cannot_send", "cannot_store")
"""Outcomes of commands that were answered, or that nothing was sent for."""


class CommandRun:
    """The commands of one call: they share the line, the session and the memory."""

    def __init__(self, client: Client, blocks: CommandBlocks, arguments: argparse.Namespace) -> None:
        self.client = client
        self.blocks = blocks
        self.arguments = arguments
        self.memory: DeviceMemory = blocks.areas.memory
        self.grammar: AddressGrammar = blocks.server.shared.grammar
        for text in arguments.set:
            self._put(text)

    def _put(self, text: str) -> None:
        """A start value of the own memory. Raises WrongWords."""
        from framekit.definition.load.scalars import parse_number
        from framekit.memory.errors import DeviceMemoryError

        address, values = assignment(text)
        try:
            place = self.grammar.parse(address)
            numbers = [parse_number(value) for value in str(values).split(",")]
            self.memory.write(place.area, place.unit, place.start, numbers, force=True)
        except (ValueError, DeviceMemoryError) as error:
            raise WrongWords(f"--set {text}: {error}") from None

    def carry_out(self, data: bytes) -> int:
        """Carries a command out and prints what came of it; the exit status."""
        from framekit.blocks.command_meaning import meaning_of
        from framekit.blocks.command_words import CommandFaultError

        try:
            command = self.blocks.words.read(data)
            meaning = meaning_of(command, self.blocks, self.client.protocol, judge=False)
        except CommandFaultError as error:
            return self._fault(str(error))
        before = {area.name: area.read_bytes(0, area.size_bytes) for area in self.memory}
        end = self.client.command(self.blocks, data)
        if end.fault:
            return self._fault(end.fault)
        status = self.blocks.status_place(command)
        changes = self._changes(before, status)
        if self.arguments.json:
            print_json(_as_json(meaning, end, changes))
        else:
            word = {self._address(status.memory, status.unit, place) for place in _places(status)}
            self._print(meaning, end, {address: changes[address] for address in changes if address not in word})
        if end.failure is None:
            return 0
        return REFUSED if end.failure.outcome in JUDGED else NO_ANSWER

    def _fault(self, why: str) -> int:
        print(f"framekit {self.arguments.verb}: this is no command block: {why}", file=sys.stderr)
        return FAULT

    def _print(self, meaning: Meaning, end: CommandEnd, changes: dict[str, list[int]]) -> None:
        from framekit.cli.commreq_verb import command_line

        print(command_line(meaning))
        for number, line in enumerate(meaning.does):
            print(f"{'' if number else 'does':<9}{line}")
        for address, values in changes.items():
            print(f"{address:<8} {' '.join(map(str, values))}")
        failed = "" if end.failure is None or end.failure.outcome == "refused" else f" ({end.failure.outcome})"
        print(f"status   {meaning.status} = {end.status:04X}h {end.meaning}".rstrip() + failed)

    def _changes(self, before: dict[str, bytes], status: Span) -> dict[str, list[int]]:
        """The elements that are others now: the address of the first of each run, with the values from there on.

        The status word is a run by itself.
        """
        from framekit.link.packing import values_of
        from framekit.memory.numbers import unit_bits

        found: dict[str, list[int]] = {}
        word = _places(status)
        for area in self.memory:
            now = area.read_bytes(0, area.size_bytes)
            if now == before[area.name]:
                continue
            count = len(now) * 8 // unit_bits(area.unit)
            old, new = values_of(before[area.name], area.unit, count), values_of(now, area.unit, count)
            last = -2
            values: list[int] = []
            for place in (place for place in range(count) if old[place] != new[place]):
                if place != last + 1 or (area.name == status.memory and place in (word.start, word.stop)):
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


def _places(span: Span) -> range:
    return range(span.start, span.start + span.count)


def _as_json(meaning: Meaning, end: CommandEnd, changes: dict[str, list[int]]) -> dict[str, Any]:
    return {
        "command": meaning.request, "words": meaning.words, "does": meaning.does, "memory": changes,
        "status": end.status, "meaning": end.meaning, "outcome": "" if end.failure is None else end.failure.outcome,
    }  # fmt: skip

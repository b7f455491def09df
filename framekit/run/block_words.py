"""The words in memory that belong to the blocks of a run: they show the state of the blocks and hold their settings."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import UNIT_BITS
from framekit.definition.problems import Problem, did_you_mean
from framekit.definition.times import NEVER
from framekit.link.addresses import AddressError, AddressGrammar
from framekit.link.packing import memory_of, values_of
from framekit.memory.memory import Area, DeviceMemory, LateArea, unit_bits
from framekit.memory.profile import BlockItem, BlockWords, MemoryProfile
from framekit.run.block_state import ITEMS, PULSES, BlockState, BlockStatus, Shown
from framekit.run.model import Block
from framekit.run.own_memory import fixed_bytes, parts_of, read_piece

Key = tuple[int, int]
"""Set and number of a block."""

_COUNTED = (16, 32, 64)
"""The sizes that a count can have, in bits."""


def status_sections(sections: Iterable[BlockWords]) -> tuple[BlockWords, ...]:
    """Return the sections of a profile that show the state of blocks."""
    return tuple(section for section in sections if any(name in ITEMS or name in PULSES for name in section.items))


class StatusWords:
    """Show blocks in the words of the `sections` that show state, also in areas that are read-only for others.

    `pulse` is the length of a pulse in nanoseconds. A section has no effect on blocks outside its range.

    With a clock (`now`) the words are written late, when their area is accessed, until a watch needs each change at
    once. `wake` is called at that moment, because `deadline` counts from then on.
    """

    def __init__(
        self,
        memory: DeviceMemory,
        sections: Iterable[BlockWords],
        pulse: int,
        now: Callable[[], int] | None = None,
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        self._memory = memory
        self._sections = status_sections(sections)
        self._pulse = pulse
        self.deadline = NEVER
        """The time at which `tick` must end a pulse; NEVER while words are written late."""
        self._wake = wake
        self._late: dict[Key, tuple[Shown, bool | None, int]] = {}
        """Blocks whose words are not written yet: the state, whether the last exchange ended well (None: no exchange
        ended), and when it ended."""
        areas = [memory.area(section.area) for section in self._sections]
        self._now = now if areas and all(isinstance(area, LateArea) for area in areas) else None
        """The time while words are written late; None when they are written at once."""
        self._ends: list[tuple[int, Key]] = []
        self._end_of: dict[Key, int] = {}
        self._places: dict[Key, tuple[_WordPlace, ...]] = {}
        self._layouts = {id(section): _Layout(section) for section in self._sections}
        shown = {name for section in self._sections for name in section.items}
        self.shows_starts = any(name in shown for name in ("started_count", "waiting", "running", "overrun_count"))
        if self._now is not None:
            for area in areas:
                if isinstance(area, LateArea):
                    area.own(self.bring, self._be_prompt)

    # ---- events -------------------------------------------------------------------------------------------

    def show(self, key: Key, status: Shown) -> None:
        """Show the state of a block; its pulses stay as they are."""
        if self._now is not None:
            self._late.setdefault(key, (status, None, 0))
            return
        for place in self._places_of(key):
            place.show(status)

    def completed(self, key: Key, status: Shown, ok: bool, now: int) -> None:
        """Show the counts after the end of an exchange, then the pulse for a normal or an abnormal completion."""
        if self._now is not None:
            self._late[key] = status, ok, now
        else:
            self._write(key, status, ok, now)

    def bring(self) -> None:
        """Write all words that are late, as they are now."""
        if self._now is None:
            return
        if self._late:
            late, self._late = self._late, {}
            for key, (status, ok, at) in late.items():
                if ok is None:
                    for place in self._places_of(key):
                        place.show(status)
                else:
                    self._write(key, status, ok, at)
        if self._ends:
            self.tick(self._now())

    def _be_prompt(self) -> None:
        """Write each change at once from now on."""
        if self._now is not None:
            self.bring()
            self._now = None
            self._note_deadline()
            self._wake()

    def _write(self, key: Key, status: Shown, ok: bool, now: int) -> None:
        pulses = False
        for place in self._places.get(key) or self._places_of(key):
            pulses |= place.completed(status, PULSES[0] if ok else PULSES[1])
        if pulses:
            end = now + self._pulse
            if key not in self._end_of:
                heapq.heappush(self._ends, (end, key))
                self._note_deadline()
            self._end_of[key] = end

    def forget(self, key: Key) -> None:
        """Set the words of a block that no longer exists to 0."""
        self.bring()
        if self._end_of.pop(key, None) is not None:
            self._ends = [entry for entry in self._ends if entry[1] != key]
            heapq.heapify(self._ends)
            self._note_deadline()
        for place in self._places_of(key):
            place.clear()
        self._places.pop(key, None)

    # ---- time ---------------------------------------------------------------------------------------------

    def _note_deadline(self) -> None:
        self.deadline = self._ends[0][0] if self._ends and self._now is None else NEVER

    def tick(self, now: int) -> None:
        """End the pulses whose time is over."""
        while self._ends and self._ends[0][0] <= now:
            key = self._ends[0][1]
            end = self._end_of[key]
            if end > now:  # another pulse has begun since
                heapq.heapreplace(self._ends, (end, key))
                continue
            heapq.heappop(self._ends)
            del self._end_of[key]
            for place in self._places_of(key):
                place.end_pulses()
        self._note_deadline()

    # ---- words --------------------------------------------------------------------------------------------

    def _places_of(self, key: Key) -> tuple[_WordPlace, ...]:
        found = self._places.get(key)
        if found is None:
            places = [(one, first, self._layouts[id(one)]) for one, first in words_of(self._sections, key)]
            found = self._places[key] = tuple(
                _WordPlace(self._memory.area(one.area), first, layout)
                for one, first, layout in places
                if layout.shows_something
            )
        return found


class _Layout:
    """The bits of one section for a block; its words are read and written as one number.

    `content(block)` returns the bits of the present counts and flags in the number. `rest` is a mask of the bits that
    are not in `content`; it includes the pulses.
    """

    __slots__ = ("content", "every_pulse", "pulses", "rest", "shows_something", "size")

    def __init__(self, section: BlockWords) -> None:
        self.size = 2 * section.words
        self.pulses = dict.fromkeys(PULSES, 0)
        parts, owned = [], 0
        for name, item in section.items.items():
            known, first = ITEMS.get(name), 16 * item.word
            if name in self.pulses and item.bit is not None:
                self.pulses[name] = 1 << first + item.bit
            elif known is not None and item.bit is not None:
                parts.append(f"({1 << first + item.bit} if {known} else 0)")
                owned |= 1 << first + item.bit
            elif known is not None and (bits := UNIT_BITS[item.unit]) in _COUNTED:
                mask = (1 << bits) - 1  # bits beyond a counter's size are lost, so it wraps to 0
                parts.append(f"({known} & {mask}) << {first}")
                owned |= mask << first
        self.every_pulse = sum(self.pulses.values())
        self.rest = (1 << 8 * self.size) - 1 & ~owned
        self.shows_something = bool(parts or self.every_pulse)
        self.content: Callable[[Shown], int] = eval(f"lambda block: {' | '.join(parts) or 0}")


class _WordPlace:
    """The words of one block in one section."""

    __slots__ = ("_every_pulse", "_layout", "_pulses", "_read", "_size", "_write")

    def __init__(self, area: Area, first: int, layout: _Layout) -> None:
        self._layout, self._size = layout, layout.size
        self._pulses, self._every_pulse = layout.pulses, layout.every_pulse
        self._read = Area.bytes_reader(area, 2 * first, self._size)  # as the owner of the area: without `bring`
        self._write = Area.bytes_writer(area, 2 * first, self._size)

    def show(self, status: Shown) -> None:
        """Show the present counts; the pulses stay as they are."""
        before = int.from_bytes(self._read(), "little")
        number = before & self._layout.rest | self._layout.content(status)
        if number != before:
            self._write(number.to_bytes(self._size, "little"))

    def completed(self, status: Shown, kind: str) -> bool:
        """Show the end of an exchange and return whether the section has a pulse for its kind.

        Pulses that are still on end first; then the counts and the pulse are written together.
        """
        layout, pulse, before = self._layout, self._pulses[kind], int.from_bytes(self._read(), "little")
        if before & self._every_pulse:
            before &= ~self._every_pulse
            self._write(before.to_bytes(self._size, "little"))
        number = before & layout.rest | layout.content(status) | pulse
        if number != before:
            self._write(number.to_bytes(self._size, "little"))
        return pulse != 0

    def end_pulses(self) -> None:
        """End the pulses that are on."""
        number = int.from_bytes(self._read(), "little")
        if number & self._every_pulse:
            self._write((number & ~self._every_pulse).to_bytes(self._size, "little"))

    def clear(self) -> None:
        """Set everything that this place shows to 0."""
        left = int.from_bytes(self._read(), "little") & self._layout.rest & ~self._every_pulse
        self._write(left.to_bytes(self._size, "little"))


def words_of(sections: Iterable[BlockWords], key: Key) -> Iterator[tuple[BlockWords, int]]:
    """Yield the sections that have words for a block, each with the number of the first word."""
    for section in sections:
        if 1 <= key[0] <= section.sets and 0 <= key[1] < section.blocks:
            yield section, section.base(*key)


def put_item(words: list[int], item: BlockItem, value: int) -> None:
    """Write a number to an item of a block; bits beyond its size are lost, so counters wrap to 0."""
    if item.bit is not None:
        mask = 1 << item.bit
        words[item.word] = words[item.word] | mask if value else words[item.word] & ~mask
        return
    for at in range(UNIT_BITS[item.unit] // 16):
        words[item.word + at] = value >> 16 * at & 0xFFFF


def get_item(words: list[int], item: BlockItem) -> int:
    """Return the number of an item of a block."""
    if item.bit is not None:
        return words[item.word] >> item.bit & 1
    return sum(words[item.word + at] << 16 * at for at in range(UNIT_BITS[item.unit] // 16))


SLOTS = 4
"""The number of variables of a block that have settings."""

PLACES = {f"{kind}_{number}": (kind, number - 1) for kind in ("read", "write") for number in range(1, SLOTS + 1)}
SIZES = {f"{name}_size": slot for name, slot in PLACES.items()}
SETTINGS = ("station", *PLACES, *SIZES)
"""The settings that the words of a block can show or change, by the names that memory profiles use."""

KINDS = {"read": "read", "receive": "read", "write": "write", "send": "write"}


class SettingError(ValueError):
    """A number in memory that a block cannot work with."""


@dataclass(frozen=True, slots=True)
class _Slot:
    """A variable of a block."""

    text: str
    """The address of the variable, as text."""
    size: int
    sets: str | None = None
    """The key that the size sets: `count`, the name of a field, or None if the size is fixed."""


class Given:
    """The words of one section for a block as the run defines them, from word `first` of `area` on.

    `holds()` returns whether memory still contains these words.
    """

    __slots__ = ("area", "first", "holds", "section", "words")

    def __init__(self, section: BlockWords, area: Area, first: int, words: list[int]) -> None:
        self.section = section
        self.area = area
        self.first = first
        self.words = words
        self.holds = area.holder(2 * first, memory_of(words, "word"))

    def put(self, item: BlockItem, value: int) -> None:
        """Change the value of one item."""
        put_item(self.words, item, value)
        self.holds = self.area.holder(2 * self.first, memory_of(self.words, "word"))


class BlockSettings:
    """Show the settings of blocks in the words of the `sections` that have settings, and read them back each time."""

    def __init__(self, memory: DeviceMemory, sections: Iterable[BlockWords]) -> None:
        self._memory = memory
        self._sections = tuple(section for section in sections if any(name in SETTINGS for name in section.items))
        self._protocols: dict[Key, Protocol] = {}
        self._given: dict[Key, list[Given]] = {}
        self._grammars: dict[str, AddressGrammar] = {}
        """The address grammars of protocols, by name, for addresses from memory."""

    def show(self, block: Block, protocol: Protocol) -> Sequence[Given]:
        """Write the settings of a block, as the run defines them, to its words."""
        key = (block.set, block.number)
        self._protocols[key] = protocol
        shown = []
        for section, first in words_of(self._sections, key):
            words = [0] * section.words
            for item, value in self._items(section, block, protocol):
                put_item(words, item, value)
            area = self._memory.area(section.area)
            area.write("word", first, words, force=True)
            shown.append(Given(section, area, first, words))
        self._given[key] = shown
        return shown

    def look(self, state: BlockState) -> Block:
        """Return the effective block and keep it as `effective` in its state."""
        state.effective, block = None, state.block
        for given in state.given:
            if block.station_from is not None or not given.holds():
                block = self.effective(block)
                break
        state.effective = block
        return block

    def forget(self, key: Key) -> None:
        """Set the words of a block that no longer exists to 0."""
        self._protocols.pop(key, None)
        for given in self._given.pop(key, ()):
            given.area.write("word", given.first, [0] * len(given.words), force=True)

    # ---- settings in the words ----------------------------------------------------------------------------

    def _items(self, section: BlockWords, block: Block, protocol: Protocol) -> list[tuple[BlockItem, int]]:
        found = []
        slots = slots_of(block, protocol)
        kind = KINDS.get(block.instruction)
        for name, item in section.items.items():
            if name == "station" and isinstance(block.station, int):
                found.append((item, block.station))
            elif name in PLACES and PLACES[name][0] == kind and PLACES[name][1] < len(slots):
                text = slots[PLACES[name][1]].text
                found += _as_words(text, item)
            elif name in SIZES and SIZES[name][0] == kind and SIZES[name][1] < len(slots):
                found.append((item, slots[SIZES[name][1]].size))
        return found

    def effective(self, block: Block) -> Block:
        """Return the block with the settings in memory; the same object while its words are unchanged.

        Restore words that are shown only, if something else was written there.

        Raise SettingError for a station, an address or a size that the block cannot work with.
        """
        changed = block
        for given in self._given.get((block.set, block.number), ()):
            if block.station_from is not None:
                self._show_station(given, block)
            if not given.holds():
                words = given.area.read("word", given.first, len(given.words))
                changed = self._changed(changed, given, words)
        return changed

    def _show_station(self, given: Given, block: Block) -> None:
        """Show a station that the run takes from another place; it cannot be changed in these words."""
        item, place = given.section.items.get("station"), block.station_from
        if item is None or place is None or self._protocols[block.set, block.number].station.type != "number":
            return
        number = values_of(read_piece(self._memory, place, place.address.unit_bits), place.address.unit, 1)[0]
        given.put(item, number)
        words = given.area.read("word", given.first, len(given.words))
        put_item(words, item, number)
        given.area.write("word", given.first, words, force=True)

    def _changed(self, block: Block, given: Given, words: list[int]) -> Block:
        section, shown = given.section, list(given.words)
        settable = [(item, slot, get_item(words, item)) for item, slot in self._settable(block, section)]
        for item, _, value in settable:
            put_item(shown, item, value)
        targets = [(item, at) for item, at in _targets_in(block, section) if _text_in(words, item)]
        for item, _ in targets:
            shown[item.word : item.word + item.words] = words[item.word : item.word + item.words]
        if shown != words:
            given.area.write("word", given.first, shown, force=True)
        for item, slot, value in settable:
            if value != get_item(given.words, item):
                where = f"{section.area} word {section.base(block.set, block.number) + item.word}"
                with_it = self._with_station if slot is None else partial(self._with_size, slot)
                block = with_it(block, value, where)
        for item, at in targets:
            text = _text_in(words, item)
            if text != _text_in(given.words, item):
                where = f"{section.area} word {section.base(block.set, block.number) + item.word}"
                block = self._with_target(block, at, text, where)
        return block

    def _settable(self, block: Block, section: BlockWords) -> Iterator[tuple[BlockItem, _Slot | None]]:
        """Yield the items whose changes have an effect, each with its variable; None: the station."""
        slots = slots_of(block, self._protocols[block.set, block.number])
        kind = KINDS.get(block.instruction)
        for name, item in section.items.items():
            if name == "station" and isinstance(block.station, int) and block.station_from is None:
                yield item, None
            elif name in SIZES and SIZES[name][0] == kind and SIZES[name][1] < len(slots):
                slot = slots[SIZES[name][1]]
                if slot.sets is not None:
                    yield item, slot

    def _with_station(self, block: Block, station: int, where: str) -> Block:
        limits = self._protocols[block.set, block.number].station.limits
        if limits is not None and not limits[0] <= station <= limits[1]:
            raise SettingError(f"station {station} in {where} is not in {limits[0]}..{limits[1]}")
        return replace(block, station=station)

    def _with_target(self, block: Block, at: int, text: str, where: str) -> Block:
        """Return the block with another address of the other side, which has the same unit."""
        protocol = self._protocols[block.set, block.number]
        grammar = self._grammars.get(protocol.name)
        if grammar is None:
            grammar = self._grammars[protocol.name] = AddressGrammar(
                protocol.addresses, protocol.areas, protocol.tables
            )
        try:
            address = grammar.parse(text, block.unit)
            grammar.check(address, block.count if len(block.targets) == 1 else 1)
        except AddressError as error:
            raise SettingError(f"'{text}' in {where}: {error}") from None
        if (block.unit or address.unit) != block.units[at]:
            raise SettingError(f"'{text}' in {where} is a {address.unit}, and the block moves {block.units[at]}s")
        if block.instruction == "write" and protocol.areas[address.area].access == "read":
            raise SettingError(f"'{text}' in {where} is in area {address.area}, which can only be read")
        return replace(block, targets=(*block.targets[:at], text, *block.targets[at + 1 :]))

    def _with_size(self, slot: _Slot, block: Block, size: int, where: str) -> Block:
        assert slot.sets is not None
        if size < 1:
            raise SettingError(f"the size in {where} is 0: that moves nothing")
        if slot.sets != "count":
            return replace(block, sizes={**block.sizes, slot.sets: size})
        place = block.places[0]
        if place.address.first_bit + size * unit_bits(block.units[0]) > self._memory.area(place.address.area).size_bits:
            raise SettingError(f"the size {size} in {where} leaves no room from {place.text} on")
        return replace(block, count=size)


def slots_of(block: Block, protocol: Protocol) -> list[_Slot]:
    """Return the variables of a block, at most four: targets of READ and WRITE, else fields of a frame."""
    if block.instruction in ("read", "write"):
        if len(block.targets) > 1:
            return [_Slot(text, 1) for text in block.targets[:SLOTS]]
        settable = "count" if block.places and block.values is None else None
        return [_Slot(text, block.count, settable) for text in block.targets]
    if block.frame is None:
        return []
    parts = dict(parts_of(protocol.frames[block.frame].segments))
    fixed = {name: fixed_bytes(parts[name]) for name in block.data}
    return [
        _Slot(place.text, block.sizes.get(name) or fixed[name] or 0, name if name in block.sizes else None)
        for name, place in list(block.data.items())[:SLOTS]
    ]


def _targets_in(block: Block, section: BlockWords) -> Iterator[tuple[BlockItem, int]]:
    """Yield the items with addresses of the other side, each with the number of its variable."""
    if block.instruction in ("read", "write"):
        for name, item in section.items.items():
            if name in PLACES and PLACES[name][0] == block.instruction and PLACES[name][1] < len(block.targets):
                yield item, PLACES[name][1]


def _text_in(words: Sequence[int], item: BlockItem) -> str:
    """Return the address in the words of an item; other characters than those of addresses remain, and fit no form."""
    data = b"".join(word.to_bytes(2, "little") for word in words[item.word : item.word + item.words])
    return data.rstrip(b"\0").decode("latin-1")


def _as_words(text: str, item: BlockItem) -> list[tuple[BlockItem, int]]:
    """Return an address as text, two characters a word, the first in the low byte; an empty list if it is too long."""
    data = text.encode("ascii", "replace").ljust(2 * item.words, b"\0")
    if len(data) > 2 * item.words:
        return []
    return [
        (BlockItem(word=item.word + at), int.from_bytes(data[2 * at : 2 * at + 2], "little"))
        for at in range(item.words)
    ]


def check_items(sections: Iterable[BlockWords]) -> Iterator[Problem]:
    """Yield a problem for each item of a profile that blocks do not have."""
    known = {*ITEMS, *PULSES, *SETTINGS}
    for section in sections:
        for name in section.items:
            if name not in known:
                yield Problem(section.at, f"'{name}' in '{section.name}' is nothing a block has", _hint(name, known))


def _hint(name: str, known: set[str]) -> str:
    return did_you_mean(name, known) or f"known: {', '.join(sorted(known))}"


class BlockMemory:
    """The words of all blocks in `memory`; with `shown` false all of it is plain memory.

    `areas`: the names of the areas that contain the words.
    """

    def __init__(
        self,
        memory: DeviceMemory,
        profile: MemoryProfile,
        shown: bool = True,
        now: Callable[[], int] | None = None,
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        self._sections = sections = tuple(profile.flags.values()) if shown else ()
        self.areas = {section.area for section in sections}
        self.words = StatusWords(memory, sections, profile.scan, now, wake)
        self.settings = BlockSettings(memory, sections)

    def add(self, state: BlockState, protocol: Protocol | None) -> None:
        """Show the state of a new block, and its settings if a protocol is given."""
        if protocol is not None:
            state.given = self.settings.show(state.block, protocol)
        self.words.show(state.key, state)

    def remove(self, block: Block) -> None:
        """Set the words of a block that no longer exists to 0; they are free memory."""
        self.settings.forget((block.set, block.number))
        self.words.forget((block.set, block.number))

    def changed(self, state: BlockState) -> None:
        """Show a change of the state of a block, for example whether it is enabled."""
        self.words.show(state.key, state)

    def places(self, block: Block) -> list[tuple[str, int, int]]:
        """Return the words of a block: area, first word, number of words."""
        found = words_of(self._sections, (block.set, block.number))
        return [(section.area, first, section.words) for section, first in found]


def status_of(state: BlockState) -> BlockStatus:
    """Return the present state and counters of a block."""
    block = state.block
    return BlockStatus(
        set=block.set,
        block=block.number,
        name=block.name,
        instruction=block.instruction,
        channel=block.channel,
        enabled=state.enabled,
        waiting=state.waiting,
        started=state.started,
        done=state.done,
        failed=state.failed,
        overruns=state.overruns,
        dead=state.dead,
        last_failure=state.last_failure,
        last_end=state.last_end,
    )

"""The frozen texts: generated source, frames found by receivers, damaged frames, conversations.

Each case is a name and a text. All random choices have fixed seeds, and the frames come from `frames/*.txt`, so a text
changes only if the code that makes it changes. Cases that are `quick` are part of every test run.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from random import Random
from typing import Any

from shipped import APPLICATIONS, FRAMES, PROTOCOLS

from framekit import __version__
from framekit.api.vectors import make_side
from framekit.codec.ambiguity import ANNOUNCED
from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.codec.python.generate import generate_source
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.frames import names_read_in
from framekit.definition.sources import find_definition
from framekit.definition.vectors import Conversation
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived
from framekit.link.conversation import SideUnderTest, default_line, run_conversation
from framekit.link.events import CharacterFault, LineFault, Seen
from framekit.link.listener import Listener
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope
from framekit.link.values import Names, plain
from tests.shipped import load_vectors

NAMES = [*PROTOCOLS, *APPLICATIONS]
KEPT_FRAMES = Path(__file__).parent / "frames"
DAMAGED = 50_000
"""Approximate number of damaged frames of all protocols together."""

SOME = 16
"""Number of damaged frames per frame in every test run."""

TRIES = 40_000
"""Attempts to draw a frame whose values depend on each other."""

STREAMS = 10
"""Number of streams of every kind and protocol."""

MS = 1_000_000
HOUR = 3_600_000 * MS


@dataclass(frozen=True, slots=True)
class Case:
    """A frozen text: `name` is a path from the general to the particular; `make` returns the text."""

    name: str
    make: Callable[[], str]
    quick: bool = True


class Shipped:
    """A shipped protocol or application."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.protocol = load_protocol(name)

    @cached_property
    def codec(self) -> Any:
        return compile_protocol(self.protocol)

    def names(self, frame: str = "") -> Names:
        """Return the context of receivers; for a single frame, with the size that an earlier frame has announced."""
        role = next(iter(self.protocol.roles), None)
        scope = Scope(self.protocol, role=role, line=default_line(self.protocol))
        read = names_read_in(self.protocol.frames[frame].segments) if frame else set()
        announced = {
            variable.name: ANNOUNCED
            for variable in self.protocol.state.values()
            if variable.announced and variable.name in read
        }
        return Names({"request": None, "buffer": b"", **announced}, scope)

    # ---- frames -------------------------------------------------------------------------------------------

    @cached_property
    def frames(self) -> dict[str, list[bytes]]:
        """Return the stored frames by name."""
        file, found = KEPT_FRAMES / f"{self.name}.txt", dict[str, list[bytes]]()
        for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
            name, _, data = line.partition(" ")
            if name in self.protocol.frames:
                found.setdefault(name, []).append(bytes.fromhex(data))
        return found

    def draw_frames(self) -> str:
        """Return the frames to store: the stored frames, and some of every frame that has none yet."""
        lines = []
        for name in self.protocol.frames:
            drawn, tries = list[bytes](), 40
            while not drawn and name not in self.frames and tries <= TRIES:
                samples = Sampler(self.codec, self.names(name)).samples(name, 3, tries)
                drawn, tries = [sample.data for sample in samples if 0 < len(sample.data) <= 200], 10 * tries
            lines += [f"{name} {data.hex(' ')}" for data in self.frames.get(name) or drawn]
        return "".join(f"{line}\n" for line in lines)

    @cached_property
    def on_line(self) -> list[bytes]:
        """Return frames as transmitted: those of the vectors, and stored frames that are not inner frames."""
        file = find_definition(f"{self.name}.vectors.yaml", FRAMES)
        exact = [case.wire.exact for case in load_vectors(file).frames] if file is not None else []
        names = Receiver(self.codec, self.protocol, self.names()).table.on_line
        return [data for data in exact if data] + [data for name in names for data in self.frames.get(name, ())]


# ---- generated source -------------------------------------------------------------------------------------


KINDS = ("encode", "decode", "measure", "extent", "diagnose", "build")


def sources(shipped: Shipped) -> Iterator[Case]:
    """Yield the generated modules, internal and stand-alone, divided by kind of function."""

    def part(standalone: bool, kind: str) -> str:
        return parts_of(shipped, standalone).get(kind, "")

    for title, standalone in (("inside", False), ("standalone", True)):
        for kind in (*KINDS, "rest"):
            yield Case(f"source/{title}/{kind}", partial(part, standalone, kind), not standalone)


@cache
def parts_of(shipped: Shipped, standalone: bool) -> dict[str, str]:
    """Return the text of a generated module by kind of function; `rest` is the code outside functions of frames."""
    text = generate_source(shipped.protocol, standalone=standalone).replace(
        f"framekit {__version__}", "framekit VERSION"
    )
    lines, parts = text.splitlines(), dict[str, list[str]]()
    for node in ast.parse(text).body:
        kind = node.name.strip("_").split("_")[0] if isinstance(node, ast.FunctionDef) else ""
        kind = kind if kind in KINDS else "rest"
        parts.setdefault(kind, []).append("\n".join(lines[node.lineno - 1 : node.end_lineno]) + "\n")
    return {kind: "\n".join(some) for kind, some in parts.items()}


# ---- damaged frames ---------------------------------------------------------------------------------------


def damaged(data: bytes, choose: Random) -> bytes:
    """Return a frame as a bad line could deliver it."""
    place, kind, found = choose.randrange(len(data)), choose.randrange(10), bytearray(data)
    if kind < 4:
        found[place] ^= choose.randrange(1, 256)
    elif kind == 4:
        found[place] ^= 1 << choose.randrange(8)
    elif kind == 5:
        del found[place:]
    elif kind == 6:
        del found[place : place + choose.randrange(1, 4)]
    elif kind == 7:
        found[place:place] = choose.randbytes(choose.randrange(1, 4))
    elif kind == 8:
        found += choose.choice((data[:3], choose.randbytes(choose.randrange(1, 4))))
    else:
        for _ in range(3):
            found[choose.randrange(len(found))] = choose.choice((0x00, 0xFF, 0x10, 0x30, choose.randrange(256)))
    return bytes(found)


def damage(shipped: Shipped) -> Iterator[Case]:
    """Yield cases of damaged frames: cause, segment, offset and refusal; the messages are cases of their own."""
    for name in shipped.frames:
        for part, size in (("some", SOME), ("more", damaged_each() - SOME)):
            yield Case(f"damage/{name}/{part}", partial(_damage, shipped, name, part, size), part == "some")
            yield Case(f"message/{name}/{part}", partial(_message, shipped, name, part, size), part == "some")


def _damage(shipped: Shipped, name: str, part: str, count: int) -> str:
    return found_in(shipped, name, part, count)[0]


def _message(shipped: Shipped, name: str, part: str, count: int) -> str:
    return found_in(shipped, name, part, count)[1]


@cache
def damaged_each() -> int:
    """Return the number of damaged frames per frame."""
    lines = (line for file in KEPT_FRAMES.glob("*.txt") for line in file.read_text(encoding="utf-8").splitlines())
    return DAMAGED // (len(list(lines)) // 3)


@cache
def found_in(shipped: Shipped, name: str, part: str, count: int) -> tuple[str, str]:
    """Return the faults of damaged frames, and their messages."""
    choose, names, samples = Random(f"{shipped.name} {name} {part}"), shipped.names(name), shipped.frames[name]
    found, words = [], []
    for _ in range(count):
        data = damaged(choose.choice(samples), choose)
        measured = _measured(shipped, name, data, names)
        what, message = _decoded(shipped, name, data, names)
        found.append(f"{data.hex(' ')}\n  measure {measured}, {what}\n")
        words.append(f"{data.hex(' ')}\n  {message}\n" if message else "")
    return "".join(found), "".join(words)


def _measured(shipped: Shipped, name: str, data: bytes, names: Names) -> str:
    codec = shipped.codec
    try:
        size = codec.frames[name].measure(data, 0, len(data), names, 0)
    except Exception as error:  # every exception is part of the frozen text
        return type(error).__name__
    return {codec.QUIET: "QUIET", codec.LOST: "LOST"}.get(size, str(size))


def _decoded(shipped: Shipped, name: str, data: bytes, names: Names) -> tuple[str, str]:
    try:
        return f"good {shipped.codec.frames[name].decode(data, names)!r}", ""
    except FrameError as error:
        refusal = "" if error.refuse is None else f" refused with {error.refuse:#x} {dict(error.fields)!r}"
        where = f"{error.cause} {error.segment or '-'} at {error.offset}"
        return where + refusal, f"{error.expected} | {error.found} | {error}"
    except Exception as error:  # every exception is part of the frozen text
        return type(error).__name__, str(error)


# ---- what receivers find ----------------------------------------------------------------------------------


def stream(shipped: Shipped, choose: Random, most: int = 14) -> bytes:
    """Return whole and damaged frames with noise between them: random bytes, first bytes of frames, nested frames."""
    samples, parts = shipped.on_line, list[bytes]()
    letters = sorted({byte for data in samples for byte in data[:3]})
    for _ in range(choose.randrange(1, most)):
        frame, kind = bytearray(choose.choice(samples)), choose.randrange(20)
        if kind < 4:
            frame = bytearray(damaged(bytes(frame), choose))
        elif kind < 7:
            frame[:0] = choose.randbytes(choose.randrange(1, 9))
        elif kind < 9:
            frame[:0] = bytes(choose.choices(letters, k=choose.randrange(1, 30)))
        elif kind < 11:
            place = choose.randrange(len(frame) + 1)
            frame[place:place] = min(choose.sample(samples, min(5, len(samples))), key=len)
        parts.append(bytes(frame))
    return b"".join(parts)


def noise(shipped: Shipped, choose: Random) -> bytes:
    """Return noise with few frames: random bytes, first bytes of frames, repeated starts."""
    samples, found = shipped.on_line, b""
    letters = sorted({byte for data in samples for byte in data[:3]})
    while len(found) < 1500:
        kind, size = choose.randrange(5), choose.randrange(1, 400)
        if kind == 0:
            found += choose.randbytes(size)
        elif kind == 1:
            found += bytes(choose.choices(letters, k=size))
        elif kind == 2:
            found += choose.choice(samples)[: choose.randrange(1, 6)] * choose.randrange(1, 40)
        elif kind == 3:
            found += bytes([choose.choice((0, 3, 0x10, 0xFF, choose.randrange(256)))]) * size
        else:
            found += choose.choice(samples)
    return found


def cut(data: bytes, choose: Random, longest: int) -> list[bytes]:
    found, place = [], 0
    while place < len(data):
        size = choose.randrange(1, longest)
        found.append(data[place : place + size])
        place += size
    return found


def streams(shipped: Shipped) -> Iterator[Case]:
    """Yield cases of streams in a receiver: whole, cut, with pauses and damaged characters, and in noise."""
    for number in range(STREAMS if shipped.on_line else 0):
        for kind in ("whole", "cut", "strange", "noise"):
            yield Case(f"stream/{kind}/{number}", partial(_stream_text, shipped, kind, number), number < 2)
        for kind in ("either", "client"):
            yield Case(f"capture/{kind}/{number}", partial(_heard, shipped, kind, number), number < 2)


def _stream_text(shipped: Shipped, kind: str, number: int) -> str:
    choose = Random(f"{shipped.name} {number}")
    data, expected = stream(shipped, choose), choose.choice(list(expectations(shipped)))
    choose = Random(f"{shipped.name} {kind} {number}")
    if kind == "noise":
        return received(shipped, cut(noise(shipped, choose), choose, 700), expected, choose)
    pieces = [data] if kind == "whole" else cut(data, choose, 24)
    return received(shipped, pieces, expected, choose, kind == "strange")


def _heard(shipped: Shipped, kind: str, number: int) -> str:
    choose = Random(f"{shipped.name} {number}")
    return heard(shipped, stream(shipped, choose) + noise(shipped, choose), "in" if kind == "client" else None, choose)


def expectations(shipped: Shipped) -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Yield pairs of frame names: expected frames, and other frames."""
    table = Receiver(shipped.codec, shipped.protocol, shipped.names()).table
    yield table.on_line, ()
    for side in ("client", "server"):
        names = tuple(it for it in table.on_line if table.infos[it].frame.side in (side, "both"))
        rest = tuple(it for it in table.on_line if it not in names)
        yield from ((names, ()), (names, rest), (names[:1], ()), (names[:1], rest), ((), names))


def received(
    shipped: Shipped,
    pieces: Iterable[bytes],
    expected: tuple[tuple[str, ...], tuple[str, ...]],
    choose: Random,
    strange: bool = False,
) -> str:
    receiver, now = Receiver(shipped.codec, shipped.protocol, shipped.names()), 0
    lines = [f"expected {' '.join(expected[0])}, others {' '.join(expected[1])}"]
    state = ""

    def take() -> None:
        nonlocal state
        while (event := receiver.next(*expected)) is not None:
            lines.append(arrival_text(event))
            if isinstance(event, FrameArrived) and choose.randrange(4) == 0:
                other = receiver.other_reading()
                lines.append("  or none other" if other is None else f"  or {arrival_text(other)}")
        waits = f"{' '.join(receiver.waiting)} since {receiver.waiting_since}" if receiver.waiting else "nothing"
        after = f"  waits for {waits}, until {receiver.deadline}{', broken' if receiver.broken else ''}"
        if after != state:
            lines.append(after)
            state = after
        if receiver.broken:
            lines.extend(arrival_text(event) for event in receiver.reset())

    for piece in pieces:
        now += choose.choice((0, 1, 40, 3000)) * MS if strange else len(piece) * MS // 2
        faults = [CharacterFault(0, LineFault.PARITY)] if strange and choose.randrange(10) == 0 else []
        receiver.append(piece, now, faults)
        take()
        if strange and choose.randrange(5) == 0:
            now += choose.choice((1, 100, 5000)) * MS
            receiver.tick(now)
            take()
        if strange and choose.randrange(20) == 0:
            receiver.cut()
            take()
    receiver.tick(now + HOUR)
    take()
    receiver.cut()
    take()
    lines.extend(arrival_text(event) for event in receiver.flush())
    return "".join(f"{line}\n" for line in lines)


def arrival_text(event: Arrival) -> str:
    if isinstance(event, FrameArrived):
        value = event.value
        refusal = "" if value.refusal is None else f", refused with {value.refusal:#x}"
        fields = plain(value)[value.frame]
        return f"{event.offset} {value.frame}{refusal} {event.raw.hex()} {event.times} {fields!r}"
    times = event.started_at, event.ended_at
    if isinstance(event, BadFrame):
        fault = f"{event.cause} {event.segment or '-'} at {event.place}"
        return f"{event.offset} bad {event.frame}: {fault} {event.raw.hex()} {times}"
    return f"{event.offset} {'skipped' if event.skipped else 'noise'} {event.data.hex()} {times}"


def heard(shipped: Shipped, data: bytes, client: Any, choose: Random) -> str:
    """Return the frames that a listener on the line finds; with `client`, each side has a wire of its own."""
    seen: list[Seen] = []
    listener = Listener(
        shipped.protocol, shipped.codec, seen.append, client=client, line=default_line(shipped.protocol)
    )
    direction, now = "in", 0
    for piece in cut(data, choose, 200):
        if client is not None and choose.randrange(3) == 0:
            direction = "out" if direction == "in" else "in"
        now += len(piece) * MS // 2 + choose.choice((0, 0, 0, 5000)) * MS
        listener.receive(piece, now, (), "in" if direction == "in" else "out")
    listener.ended(now + HOUR)
    return "".join(f"{shown(event)}\n" for event in seen)


def shown(seen: Seen) -> str:
    where = f" {seen.segment or '-'} at {seen.place}" if seen.kind == "bad" else ""
    fields = f" {seen.fields!r}" if seen.fields else ""
    again = " again" if seen.repeated else ""
    what = f"{seen.direction or '-'} {seen.kind} {seen.frame}{again} {seen.raw.hex()}"
    return f"{seen.started_at}..{seen.at} {what} {seen.reason}{where}{fields}"


# ---- conversations ----------------------------------------------------------------------------------------


def conversations(shipped: Shipped) -> Iterator[Case]:
    """Yield a case for each conversation of the vectors: the monitor output of the tested side, in order."""
    file = find_definition(f"{shipped.name}.vectors.yaml", FRAMES)
    known: dict[str, int] = {}
    for number, case in enumerate(load_vectors(file).conversations if file is not None else ()):
        known[case.name] = again = known.get(case.name, 0) + 1
        title = case.name if again == 1 else f"{case.name} ({again})"
        yield Case(f"conversation/{title}", partial(_trace, shipped, case), number % 20 == 0)


def _trace(shipped: Shipped, case: Conversation) -> str:
    seen: list[Seen] = []

    def side(case: Conversation, protocol: Any, codec: Any) -> SideUnderTest:
        made = make_side(case, protocol, codec)
        made.monitor = seen.append
        return made

    problems = run_conversation(case, shipped.protocol, shipped.codec, side)
    return "".join(f"{line}\n" for line in (*map(shown, seen), *problems))


# ---- all of it --------------------------------------------------------------------------------------------


def cases(shipped: Shipped) -> Iterator[Case]:
    """Yield all cases of a protocol."""
    yield from sources(shipped)
    yield from damage(shipped)
    if shipped.protocol.kind == "protocol":
        yield from streams(shipped)
    yield from conversations(shipped)

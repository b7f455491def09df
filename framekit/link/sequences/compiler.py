"""The sequences of a protocol as one Python module: a generator a sequence.

Everything that can be known when the protocol is loaded is resolved here: variables are locals, rows comparisons in
their order, each wait of a step is a constant. Parameters and state are looked up every time. A generator yields
waits, is sent frames and events, and returns its results, or its failure.
"""

from __future__ import annotations

import builtins
import re
from types import CodeType
from typing import Any

from framekit.codec.python.source import Source, literal, quoted
from framekit.definition.model.frames import parts_of
from framekit.definition.model.procedure import LineChange, Sequence, Target
from framekit.definition.model.protocol import Protocol
from framekit.definition.sources import current_cache
from framekit.definition.times import NEVER
from framekit.link import late
from framekit.link.awaited_replies import Replies, replies_of
from framekit.link.frame_table import FrameTable, ProtocolCodec, made_once, table_of
from framekit.link.sequences import runtime
from framekit.link.sequences import state as runs
from framekit.link.sequences.writing import (
    ADDED_FUNCTIONS,
    BLOCKS,
    OF_EXCHANGE,
    Frames,
    StepWriter,
    empty_value,
    own_variables,
)
from framekit.link.value_source import SourceModule, globals_of
from framekit.link.variables import fit_of


class Program:
    """The frames and sequences of a protocol, ready for engines; those of one codec share it."""

    def __init__(self, protocol: Protocol, codec: ProtocolCodec) -> None:
        self.protocol = protocol
        self.table = table = table_of(protocol, codec)
        cache = current_cache()

        def make() -> CodeType:
            return compile(sequence_source(protocol, table), f"<sequences of {protocol.name}>", "exec")

        code = make() if cache is None else cache.code(protocol, "generators", make)
        self.sequences, self.need_names, self.shown_later = load_sequences(code, protocol, table)
        targets = parts_of((tuple(protocol.sequences.values()), tuple(protocol.services.values())), Target)
        self.changes = any(target.field is not None for target in targets)
        self._replies: dict[str | None, Replies] = {}

    def replies_of(self, role: str | None) -> Replies:
        """Return what exchanges of a role wait for."""
        found = self._replies.get(role)
        if found is None:
            found = self._replies[role] = replies_of(self.protocol, None if role is None else self.protocol.roles[role])
        return found


def program_of(protocol: Protocol, codec: ProtocolCodec) -> Program:
    """Return the program of a protocol, made once for a codec."""
    return made_once(protocol, codec, Program, lambda: Program(protocol, codec))


def sequence_source(protocol: Protocol, table: FrameTable) -> str:
    """Return the source of the module of a protocol's sequences."""
    module = SourceModule()
    frames = Frames(protocol, table)
    held = _of_exchanges(protocol)
    listening = {lane.listen for role in protocol.roles.values() for lane in role.lanes}
    for number, sequence in enumerate(protocol.sequences.values()):
        name = sequence.name
        _SequenceWriter(module, frames, sequence, number, name in held, name in listening).write()
    own = {name for sequence in protocol.sequences.values() for name in own_variables(sequence, protocol)}
    needing = tuple(name for name in protocol.frames if frames.reads(name) & (OF_EXCHANGE | own))
    module.functions.add()
    module.functions.add()
    module.functions.add(f"NEED_NAMES.update({literal(needing)})")
    targets = parts_of((tuple(protocol.sequences.values()), tuple(protocol.services.values())), Target)
    changes = any(target.field is not None for target in targets)
    if not changes:
        module.functions.add(f"SHOWN_LATER.update({literal(_shown_later(protocol, frames, own))})")
    return module.text(f"The sequences of {protocol.name}.")


def _shown_later(protocol: Protocol, frames: Frames, own: set[str]) -> dict[str, tuple[str, ...]]:
    """Return the frames that can be decoded later, each with the parameters and constants to keep when it is sent.

    They depend on names that do not change.
    """
    fixed = {*protocol.params, *protocol.tables, "own", "role", "line"}
    changing = {*OF_EXCHANGE, *own, *protocol.state, "now", "clock", "functions"}
    if next(parts_of(tuple(protocol.sequences.values()), LineChange), None) is not None:
        changing.add("line")
    read = {name: frames.reads(name) for name in protocol.frames}
    return {name: tuple(sorted(found & fixed)) for name, found in read.items() if not found & changing}


def load_sequences(
    code: CodeType, protocol: Protocol, table: FrameTable
) -> tuple[dict[str, runs.CompiledSequence], set[str], dict[str, tuple[str, ...]]]:
    """Run compiled code; return its sequences, the frames that need names of an exchange, and `SHOWN_LATER`."""
    found: dict[str, runs.CompiledSequence] = {}
    need_names: set[str] = set()
    later: dict[str, tuple[str, ...]] = {}
    state = protocol.state.values()
    names: dict[str, Any] = {
        **globals_of(table),
        **_GLOBALS,
        **ADDED_FUNCTIONS,
        "__builtins__": _BUILTINS,
        "SEQUENCES": found,
        "NEED_NAMES": need_names,
        "SHOWN_LATER": later,
        "FIT": fit_of,
        "FITS": {one.name: fit_of(one.type, one.values, one.size) for one in state},
    }
    exec(code, names)
    return found, need_names, later


def _of_exchanges(protocol: Protocol) -> set[str]:
    """Return the sequences that exchanges, or what opens and closes their sessions, may run."""
    waiting = list(protocol.exchanged)
    for session in protocol.sessions.values():
        waiting += [*session.open, *session.close, *([session.keep_alive_run] if session.keep_alive_run else ())]
    waiting += [name for name in protocol.sequences if not protocol.roles]
    return {sequence.name for sequence in protocol.called_from(waiting)}


class _SequenceWriter:
    """Writes one sequence. `held`: replies to earlier requests may hold it back; `listens`: a lane may listen with it.

    A listener that has come to its end begins anew in the same generator.
    """

    def __init__(
        self, module: SourceModule, frames: Frames, sequence: Sequence, number: int, held: bool, listens: bool
    ) -> None:
        self.module = module
        self.listens = listens
        self.sequence = sequence
        self.number = number
        self.protocol = frames.protocol
        self.own = own_variables(sequence, frames.protocol)
        self.body = Source()
        self.steps = [
            StepWriter(module, frames, sequence, number, index, held, self.body, listens)
            for index in range(len(sequence.steps))
        ]

    def write(self) -> None:
        """Write the generator and its sequence."""
        out, sequence, body = self.module.functions, self.sequence, self.body
        for step in self.steps:
            body.comment(f"step {step.step.name}")
            step.write()
        out.add()
        out.add()
        out.comment(sequence.name)
        with out.block(f"def q{self.number}(run, x, given):"):
            used = set(re.findall(r"\w+", "\n".join(body.lines)))
            self._begin(out, used)
            out.add(f"pc, outcome = {-1 if self.listens else 0}, None")
            if not self.listens:
                self._variables(out, used)
            with out.block("try:"), out.block("while True:"):
                if self.listens:
                    with out.block("if pc < 0:"):
                        self._variables(out, used)
                        out.add("pc = 0")
                out.extend(body)
                last = len(self.steps) * BLOCKS
                with out.block(f"if pc < {last}:"):
                    self.steps[-1].out = out
                    self.steps[-1].end()
                out.add("break")
            with out.block("except EVALUATION_ERRORS as error:"):
                names = tuple(step.step.name for step in self.steps)
                out.add(f"outcome = trouble(run, x, {literal(names)}[min(pc // {BLOCKS}, {len(names) - 1})], error)")
            out.add("results = {}")
            for name, expression in sequence.gives.items():
                with out.block("try:"):
                    out.add(f"results[{quoted(name)}] = {self.steps[-1].expression(expression)}")
                with out.block("except EVALUATION_ERRORS:"):
                    out.add("pass")
            out.add("return Failed(outcome, results)")
        out.add()
        out.add()
        name, takes = quoted(sequence.name), literal(tuple(sequence.takes))
        out.add(f"SEQUENCES[{name}] = CompiledSequence({name}, q{self.number}, {takes}, {bool(sequence.always)})")

    def _begin(self, out: Source, used: set[str]) -> None:
        """Write the beginning of the generator, with those locals that are used."""
        out.add("m = run.machine")
        if used & {"s", "device"}:
            out.add("s = m.scope")
        for name, source in (("n", "x.names"), ("late", "m.late"), ("device", "s.device")):
            if name in used:
                out.add(f"{name} = {source}")
        if "yield" not in used:
            with out.block("if False:"):
                out.add("yield")

    def _variables(self, out: Source, used: set[str]) -> None:
        """Write the values that variables have at the beginning of the sequence."""
        sequence, first = self.sequence, self.steps[0]
        for name in ("it", "sent", "parts", "part", "cause", "frame"):
            if name in used:
                out.add(f"{name} = None")
        for name in ("resends", "part_index"):
            if name in used:
                out.add(f"{name} = 0")
        for name in self.own:
            if name in sequence.takes or name not in sequence.local:
                text = quoted(name)
                other = f"x.{name}" if name in OF_EXCHANGE else f"x.get({text})"
                out.add(f"{first.slot(name)} = given[{text}] if {text} in given else {other}")
            else:
                out.add(f"{first.slot(name)} = {empty_value(sequence.local[name])}")
        for counter in (counter for step in self.steps for counter in step.counters):
            out.add(f"{counter} = 0")


# ---- names for generators ----------------------------------------------------------------------------------------


_USED = (
    "begin_part", "change_line", "count", "cut_parts", "decoded", "hold_break", "listens_again", "named",
    "needs_names", "own_line", "put", "send_built", "send_made", "send_value", "serve", "set_field", "trouble",
    "unclear",
)  # fmt: skip
_OF_RUNS = (
    "AGAIN", "BREAK", "BYTE", "CLOSED", "GO", "NOISE", "NOT_SENT", "NOT_TAKEN", "RESTART", "TIMEOUT", "Asking", "Bad",
    "Changing", "CompiledSequence", "Failed", "Item", "Other", "ParkedCall", "ParkedHold", "Pause", "State", "Wait",
)  # fmt: skip
_GLOBALS: dict[str, Any] = {
    **{name: getattr(runtime, name) for name in _USED},
    **{name: getattr(runs, name) for name in _OF_RUNS},
    **{name: getattr(late, name) for name in ("is_held", "missed", "replied", "still_due")},
    "NEVER": NEVER,
    "__name__": "framekit_sequences",
}
_BUILTINS = {
    name: getattr(builtins, name)
    for name in ("abs", "dict", "frozenset", "int", "len", "max", "min", "str", "sum", "type")
}

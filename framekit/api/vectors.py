"""Execution of the vectors of a definition: every frame case, and every conversation against a whole client or
device.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import definition_path, load_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import DefinitionError, Problem, parted
from framekit.definition.vectors import Conversation, Vectors, check_vectors, read_vectors
from framekit.link.addresses import AddressError, AddressGrammar
from framekit.link.conversation import CaseStarter, SideUnderTest, elements_of, run_conversation, run_frame_vector
from framekit.link.engine import Engine
from framekit.link.events import Ask
from framekit.link.frame_table import ProtocolCodec
from framekit.link.packing import typed_at
from framekit.link.services.client import ServiceClient
from framekit.link.services.server import MemoryServer
from framekit.memory.memory import DeviceMemory
from framekit.run.own_memory import AddressedMemory
from framekit.runfile.devices import memory_of

SUFFIX = ".vectors.yaml"


@dataclass(frozen=True, slots=True)
class CaseResult:
    """Result of a case: its name, and its differences; no differences if it passes."""

    kind: str
    name: str
    problems: tuple[str, ...]


def vectors_path(definition: Path) -> Path:
    """Return the path of the vectors of a definition, whether they exist or not."""
    return definition.with_name(definition.stem + SUFFIX)


def vector_problems(vectors: Vectors, protocol: Protocol) -> list[Problem]:
    """Return a problem for every name in the cases that the protocol or the memory lacks."""
    problems = check_vectors(vectors, protocol)
    _, here = memory_of(protocol)
    grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
    for case in vectors.conversations:
        asked = [
            (key, text)
            for key in ("read", "write")
            for text in _addresses((case.do or {}).get(key))
            if key in protocol.services
        ]
        problems += _no_addresses(case, grammar, [(f"do.{key}", text) for key, text in asked])
        problems += _no_addresses(case, here, [(f"memory.{text}", text) for text in case.memory])
        problems += _no_addresses(case, here, [("result", text) for text in case.result.memory])
    return problems


def _of_another(vectors: Vectors, protocol: str | Path, folder: Path | None) -> Iterator[Problem]:
    """Report vectors that name another definition than the one in the same folder."""
    path = definition_path(protocol, folder)
    try:
        named = definition_path(vectors.protocol, path.parent)
    except DefinitionError as error:
        yield from (Problem(vectors.protocol_at, problem.what, problem.todo) for problem in error.problems)
        return
    if named.resolve() != path.resolve():
        what = f"these are vectors of '{vectors.protocol}', and they stand beside {path.name}"
        yield Problem(vectors.protocol_at, what, f"write vectors: {path.stem}, or rename the file")


def _addresses(asked: Any) -> list[str]:
    """Return the addresses of a read or write: a single address, a list, or the keys of a mapping to values."""
    return [str(text) for text in ([asked] if isinstance(asked, str) else asked or ())]


def _no_addresses(case: Conversation, grammar: AddressGrammar, given: list[tuple[str, str]]) -> Iterator[Problem]:
    for key, text in given:
        try:
            grammar.parse(text, check=False)
        except AddressError as error:
            yield Problem(case.places.get(key, case.at), *parted(error))


def run_vectors(
    protocol: str | Path, folder: Path | None = None, progress: Callable[[int, int], None] = lambda done, of: None
) -> list[CaseResult]:  # fmt: skip
    """Run all cases; return an empty list without vectors. Raises DefinitionError if definition or vectors are wrong.

    `progress` gets the number of finished cases, and of all cases.
    """
    loaded = load_protocol(protocol, folder)
    path = vectors_path(definition_path(protocol, folder))
    if not os.path.isfile(path):
        return []
    codec = compile_protocol(loaded)
    vectors, wrong = read_vectors(path)
    if vectors is not None:
        wrong += list(_of_another(vectors, protocol, folder)) or vector_problems(vectors, loaded)
    if vectors is None or wrong:
        raise DefinitionError(wrong)
    results, count = list[CaseResult](), len(vectors.frames) + len(vectors.conversations)
    for vector in vectors.frames:
        name = vector.name or vector.frame or str(vector.wire)[:32]
        results.append(CaseResult("frame", name, tuple(run_frame_vector(vector, loaded, codec))))
        progress(len(results), count)
    for case in vectors.conversations:
        problems = run_conversation(case, loaded, codec, make_side)
        results.append(CaseResult("conversation", case.name, tuple(problems)))
        progress(len(results), count)
    return results


def make_side(case: Conversation, protocol: Protocol, codec: ProtocolCodec) -> SideUnderTest:
    """Return a client with its services, or a device with a memory, as the case describes it."""
    areas, grammar = memory_of(protocol)
    memory = DeviceMemory(areas)
    for text, value in case.memory.items():
        place = grammar.parse(text)
        values = value if isinstance(value, list) else [value]
        numbers = elements_of(typed_at(grammar, text, None, None, len(values)), values)
        memory.area(place.area).write_from(place.first_bit, place.unit, numbers, force=True)
    sides: dict[Engine, ServiceClient] = {}

    def client(engine: Engine) -> ServiceClient:
        if engine not in sides:
            sides[engine] = ServiceClient(protocol, codec, engine)
        return sides[engine]

    def ask(engine: Engine) -> Ask:
        return client(engine).ask

    return SideUnderTest(
        server=MemoryServer(protocol, codec, memory) if protocol.services else None,
        memory=AddressedMemory(memory, grammar),
        ask=ask if protocol.services else None,
        start=CaseStarter(protocol, codec).start,
        read_memory=lambda text, count: _read(memory, grammar, text, count),
        typed=lambda text, count: typed_at(grammar, text, None, None, count),
    )


def _read(memory: DeviceMemory, grammar: AddressGrammar, text: str, count: int) -> list[int]:
    place = grammar.parse(text)
    return memory.area(place.area).read_from(place.first_bit, place.unit, count)

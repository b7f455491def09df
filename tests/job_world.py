"""A job table without a network: the test ends connections and transfers, and `notes` records every event."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from shipped import file_of

from framekit.definition.times import NEVER
from framekit.extras.commreq.job_profiles import load_job_profile
from framekit.extras.commreq.job_table import Attempt, JobTable
from framekit.link.addresses import Address
from framekit.memory.profile import load_profile
from framekit.run.block_state import Failure
from framekit.run.model import JobCommand, JobProfile, Order, OwnPlace
from framekit.run.own_memory import addresses_of

MS = 1_000_000
SECOND = 1_000_000_000
GRAMMAR = addresses_of(load_profile("masterlogic"))


def place(text: str) -> OwnPlace:
    return OwnPlace(address=GRAMMAR.parse(text), text=text)


class JobWorld:
    """The host of a job table.

    `notes` are the written events in order. `takes` is the duration of a transfer in ns; None: the test ends transfers.
    """

    def __init__(self, profile: JobProfile | None = None, takes: int | None = None) -> None:
        self.table = JobTable(profile or load_job_profile("ge-channels"), self)
        self.now = 0
        self.takes = takes
        self.notes: list[tuple[Any, ...]] = []
        self.answers: list[tuple[int, int | None]] = []
        self.connecting: list[Attempt] = []
        self.running: list[tuple[int, Attempt]] = []
        self.starts: list[tuple[int, int]] = []
        self.ends: list[tuple[int, Attempt]] = []
        self.refuse_words = False
        self.connects = True
        self.next_failure: Failure | None = None
        self.ids = 0
        self.table.start(0)

    # ---- what the table wants -----------------------------------------------------------------------------

    def connect(self, attempt: Attempt) -> None:
        self.connecting.append(attempt)
        if self.connects:
            self.table.connected(attempt, self.now)

    def begin(self, attempt: Attempt) -> None:
        self.starts.append((self.now, attempt.slot))
        self.running.append((self.now, attempt))
        if self.takes is not None:
            self.ends.append((self.now + self.takes, attempt))

    def write_words(self, place: OwnPlace, words: tuple[int, ...]) -> bool:
        if not self.refuse_words:
            self.notes.append(("words", self.now, place.text, *words))
        return not self.refuse_words

    def write_bits(self, bits: tuple[int, ...]) -> None:
        self.notes.append(("bits", self.now, tuple(number for number, bit in enumerate(bits, 1) if bit)))

    def answered(self, command: JobCommand, word: int | None) -> None:
        self.answers.append((command.id, word))

    # ---- what tests do ------------------------------------------------------------------------------------

    def command(self, kind: str, slot: int | None, **more: Any) -> int:
        self.ids += 1
        status = more.pop("status", f"D{slot or 0}")
        command = JobCommand(
            kind=kind, slot=slot, status=None if status is None else place(status), id=self.ids, **more
        )  # type: ignore[arg-type]
        self.table.take(command, self.now)
        return self.ids

    def job(self, slot: int, *, status: str | None = "", kind: str = "read", **more: Any) -> int:
        order = Order(slot=slot, kind=kind, place=place("M0"), remote="R1", **more)  # type: ignore[arg-type]
        return self.command("job", slot, order=order, **({} if status == "" else {"status": status}))

    def end(self, slot: int, failure: Failure | None = None) -> None:
        """End the transfer of a slot now."""
        at = next(index for index, (_, attempt) in enumerate(self.running) if attempt.slot == slot)
        _, attempt = self.running.pop(at)
        self.finish(attempt, failure)

    def finish(self, attempt: Attempt, failure: Failure | None = None) -> None:
        def store() -> None:
            self.notes.append(("data", self.now, attempt.slot))

        self.table.ended(attempt, failure, self.now, store)

    def run(self, until: int) -> None:
        """Advance time to `until`; transfers of a fixed duration end by themselves."""
        while True:
            ending = min((at for at, _ in self.ends), default=NEVER)
            due = min(self.table.deadline, ending)
            if due > until:
                break
            self.now = max(self.now, due)
            if ending <= self.now:
                index = next(index for index, (at, _) in enumerate(self.ends) if at == ending)
                _, attempt = self.ends.pop(index)
                self.running = [job for job in self.running if job[1] is not attempt]
                failure, self.next_failure = self.next_failure, None
                self.finish(attempt, failure)
            self.table.tick(self.now)
        self.now = until

    def bits(self) -> tuple[int, ...]:
        """Return the bits that are set."""
        shown = [note[2] for note in self.notes if note[0] == "bits"]
        return shown[-1] if shown else ()

    def words(self, text: str) -> list[int]:
        """Return all values that were written to a word, in order."""
        return [note[3] for note in self.notes if note[0] == "words" and note[2] == text]


def profile_with(folder: Path, old: str, new: str) -> JobProfile:
    """Return the shipped profile with a replacement in its text."""
    shipped = file_of("ge-channels.jobs.yaml")
    text = shipped.read_text(encoding="utf-8")
    assert old in text
    path = folder / "changed.jobs.yaml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return load_job_profile(path)


def address(text: str) -> Address:
    return GRAMMAR.parse(text)

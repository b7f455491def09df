"""Counts services that no block asks for: those a device has been asked for, and the transfers of jobs.

Which request is which service is not known here.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from framekit.definition.model.protocol import Protocol
from framekit.link.codes import code_text
from framekit.link.services.server import ServiceCounters


@dataclass(slots=True)
class ChannelCounters:
    """What a channel does beside the exchanges of blocks: requests `served` here, and transfers of jobs."""

    served: ServiceCounters = field(default_factory=ServiceCounters)
    done: int = 0
    failed: Counter[str] = field(default_factory=Counter)

    def ended(self, failure: str) -> None:
        """A transfer of a job has ended, with a failure of that name or, '', well."""
        if failure:
            self.failed[failure] += 1
        else:
            self.done += 1

    def add(self, other: ChannelCounters) -> None:
        """What another channel counted, whose place this one takes."""
        self.served.done += other.served.done
        self.served.refused.update(other.served.refused)
        self.done += other.done
        self.failed.update(other.failed)

    def clear(self) -> None:
        """Counting begins anew."""
        self.served.done = self.done = 0
        self.served.refused.clear()
        self.failed.clear()

    @property
    def services(self) -> int:
        return self.served.done + self.done

    def reasons(self, protocol: Protocol) -> Counter[str]:
        """The errors by what they were."""
        refused = {refusal_text(protocol, code): count for code, count in self.served.refused.items()}
        return self.failed + Counter(refused)


def refusal_text(protocol: Protocol, code: int) -> str:
    """A refusal with its code in the protocol's way and what that means, where the protocol says it."""
    names = () if protocol.errors is None else protocol.errors.names
    ordered = sorted(names, key=lambda item: item.when is not None)  # which side it was does not show here
    tables = (protocol.tables[item.table].entries for item in ordered if item.table in protocol.tables)
    meaning = next((str(table[code]) for table in tables if code in table), "")
    return f"refused {code_text(code)}" + (f" {meaning}" if meaning else "")

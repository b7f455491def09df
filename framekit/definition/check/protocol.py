"""All checks of a protocol, one after the other."""

from __future__ import annotations

from framekit.definition.check.frames import check_frame
from framekit.definition.check.names import NameChecker
from framekit.definition.check.procedure import check_procedure
from framekit.definition.check.profiles import check_profile
from framekit.definition.check.services import check_services
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import Problem


def check_protocol(protocol: Protocol) -> list[Problem]:
    """Everything wrong with a protocol that loaded; warnings among it."""
    problems = NameChecker(protocol).check()
    for frame in protocol.frames.values():
        problems += check_frame(protocol, frame)
    return [*problems, *check_profile(protocol), *check_procedure(protocol), *check_services(protocol)]

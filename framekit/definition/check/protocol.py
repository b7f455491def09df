"""All checks of a protocol, one after the other."""

from __future__ import annotations

from collections.abc import Collection

from framekit.definition.check.addresses import check_forms
from framekit.definition.check.commands import check_commands
from framekit.definition.check.frames import check_frame
from framekit.definition.check.names import NameChecker
from framekit.definition.check.procedure import check_procedure
from framekit.definition.check.profiles import check_profile
from framekit.definition.check.sections import check_sections
from framekit.definition.check.services import check_services
from framekit.definition.check.typed import check_kinds
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import Problem


def check_protocol(protocol: Protocol, broken: Collection[str] = ()) -> list[Problem]:
    """Everything wrong with a protocol that loaded; warnings among it.

    `broken`: names of things that could not be loaded, whose problems have been told; that they are missing is none.
    """
    problems = NameChecker(protocol, broken).check()
    for frame in protocol.frames.values():
        problems += check_frame(protocol, frame)
    problems += check_sections(protocol)
    problems += check_profile(protocol)
    problems += check_procedure(protocol, broken)
    problems += check_services(protocol, broken)
    problems += check_commands(protocol, broken)
    if not broken:
        problems += check_forms(protocol.addresses, protocol.areas, protocol.tables)
    told = {problem.at for problem in problems}
    return [*problems, *(problem for problem in check_kinds(protocol) if problem.at not in told)]

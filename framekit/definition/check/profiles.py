"""Profiles: sets of limits that a protocol may declare, for tools and devices that can do less than the language."""

from __future__ import annotations

from collections.abc import Callable

from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check, Const, Data, Field, Segment, Skip
from framekit.definition.problems import Problem, did_you_mean

MOST_VARIABLES = 4


def check_profile(protocol: Protocol) -> list[Problem]:
    """What goes beyond the protocol's profile, if it declares one."""
    if protocol.profile is None:
        return []
    if protocol.profile not in PROFILES:
        hint = did_you_mean(protocol.profile, PROFILES)
        return [Problem(protocol.profile_at, f"there is no profile '{protocol.profile}'", hint)]
    check = PROFILES[protocol.profile]
    return [problem for frame in protocol.frames.values() for problem in check(frame)]


def _user_frames(frame: Frame) -> list[Problem]:
    """User-defined frames of the Snet tool (guide, chapter 7): heads of constants, four variables a body, and so on."""
    found = []
    for segment in frame.head:
        if not isinstance(segment, Const):
            found.append(Problem(segment.at, "a head holds only constants in this profile", "move it to the body"))
    for segment in frame.tail:
        if not isinstance(segment, (Const, Check)):
            found.append(
                Problem(segment.at, "a tail holds only constants and a check in this profile", "move it to the body")
            )
    found += _body(frame)
    return found


def _body(frame: Frame) -> list[Problem]:
    found = []
    variables: list[Segment] = []
    for segment in frame.body:
        if isinstance(segment, (Data, Field)):
            variables.append(segment)
        elif not isinstance(segment, (Const, Skip)):
            found.append(
                Problem(
                    segment.at, "a body holds only constants and variables in this profile", "leave the profile out"
                )
            )
    for segment in variables[MOST_VARIABLES:]:
        found.append(
            Problem(
                segment.at,
                f"the body has more than {MOST_VARIABLES} variables",
                "split the frame, or leave the profile out",
            )
        )
    if frame.side == "server":
        for segment in variables:
            if isinstance(segment, Data) and segment.size == "rest" and segment is not frame.body[-1]:
                found.append(
                    Problem(
                        segment.at, "a variable-size variable must be the last of a received body", "move it to the end"
                    )
                )
    return found


PROFILES: dict[str, Callable[[Frame], list[Problem]]] = {"snet-user-frames": _user_frames}

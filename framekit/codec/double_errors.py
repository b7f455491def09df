"""Check codes that hold little: how many of the errors of two bits pass, tried out on samples.

A parity bit of every character would show most of them; a code of 8 bits alone lets through several of a hundred. The
share is measured with the frame as a whole, so that constants, digits and lengths help where they do. Reference,
section 14.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any

from framekit.codec.codec import Codec
from framekit.codec.evaluate import evaluate
from framekit.codec.samples import Sample, Sampler
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check
from framekit.definition.model.walk import parts_of
from framekit.definition.problems import Problem
from framekit.definition.times import parse_format

WEAK = 8
"""Bits of a check code that is looked at."""

TRIALS = 600
"""Errors of two bits that are tried on a frame."""

WORTH_TELLING = 0.005


def check_weak_codes(codec: Codec, sampler: Sampler) -> list[Problem]:
    """One warning, for the frame that lets the most through; none on lines with parity."""
    protocol = codec.protocol
    if protocol.line.kind != "serial" or parse_format(protocol.line.format, protocol.line.speed or 1).parity != "N":
        return []
    shares = [
        (passing(codec, frame.name, sample, sampler.context), frame, check)
        for frame in protocol.frames.values()
        if (check := _weak_check(frame)) is not None and (sample := _longest(sampler, frame, check)) is not None
    ]
    if not shares:
        return []
    share, frame, check = max(shares, key=lambda one: one[0])
    if share < WORTH_TELLING:
        return []
    what = f"{_percent(share)} of the errors of two bits pass in '{frame.name}'"
    told = f"{what}: its check code has {check.method.width} bits, the line no parity"
    return [Problem(check.at, told, _todo(protocol), warning=True)]


def passing(codec: Codec, frame: str, sample: Sample, context: Mapping[str, Any]) -> float:
    """The share of damaged samples (two bits turned over) that are read as good frames with other values."""
    random_ = random.Random(f"framekit {frame}")
    passed = 0
    for _ in range(TRIALS):
        damaged = bytearray(sample.data)
        for place in random_.sample(range(len(damaged) * 8), 2):
            damaged[place // 8] ^= 1 << place % 8
        try:
            passed += codec.decode(frame, bytes(damaged), context) != sample.read
        except (KeyError, TypeError, IndexError, ValueError, ArithmeticError, AttributeError):
            continue
    return passed / TRIALS


def _weak_check(frame: Frame) -> Check | None:
    """The frame's check code, if all it has are weak ones."""
    checks = [check for check in parts_of(frame.segments, Check) if check.verify == "error"]
    return checks[0] if checks and all(check.method.width <= WEAK for check in checks) else None


def _longest(sampler: Sampler, frame: Frame, check: Check) -> Sample | None:
    """The longest sample that has its check code."""
    there = [sample for sample in sampler.samples(frame.name) if _is_there(check, sample, sampler.context)]
    return max(there, key=lambda sample: len(sample.data), default=None)


def _is_there(check: Check, sample: Sample, context: Mapping[str, Any]) -> bool:
    if check.when is None:
        return True
    try:
        return bool(evaluate(check.when.root, {**context, **sample.read}.__getitem__))
    except (KeyError, TypeError, IndexError, ValueError, ArithmeticError, AttributeError):
        return False


def _percent(share: float) -> str:
    return f"about {share * 100:.0f} %" if share >= 0.01 else "about 1 %"


def _todo(protocol: Protocol) -> str:
    bits = protocol.line.format[0]
    return f"use a format with parity, such as {bits}E1, where the device offers one"

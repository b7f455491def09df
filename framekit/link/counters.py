"""Counters of a link engine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class LinkCounters:
    """Frames by themselves sent, good frames received, those among them nobody took, bad frames, bytes of noise."""

    sent: int = 0
    received: int = 0
    not_taken: int = 0
    bad: int = 0
    noise_bytes: int = 0

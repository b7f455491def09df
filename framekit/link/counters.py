"""Counters of a link engine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class LinkCounters:
    """Frames by themselves sent, good frames received, those not taken, bad frames, bytes of noise.

    `late`: those not taken that were replies whose exchange was over, or that answered a repeated request again.
    """

    sent: int = 0
    received: int = 0
    not_taken: int = 0
    late: int = 0
    bad: int = 0
    noise_bytes: int = 0

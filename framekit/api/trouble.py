"""Troubles, for callers of the API that report their own: the classes of `framekit.run.trouble`."""

from __future__ import annotations

from framekit.run.trouble import SampleCount as SampleCount
from framekit.run.trouble import Troubles as Troubles
from framekit.run.trouble import TroubleSource as TroubleSource

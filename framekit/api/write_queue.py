"""The queue of records that a thread writes, for callers of the API: `framekit.service.write_queue`."""

from __future__ import annotations

from framekit.service.write_queue import WriteQueue as WriteQueue

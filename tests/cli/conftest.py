"""What a verb switches on for its process, `--log` above all, ends with its test."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def log_as_before() -> Iterator[None]:
    """The handlers and the level of framekit's log as they were: another test's standard error is closed by then."""
    logger = logging.getLogger("framekit")
    handlers, level = list(logger.handlers), logger.level
    yield
    logger.handlers[:] = handlers
    logger.setLevel(level)

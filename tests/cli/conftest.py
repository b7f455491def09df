"""Undo the process-wide settings of a verb, mainly those of `--log`, after each test."""

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

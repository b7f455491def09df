"""Undo the process-wide settings of a verb, mainly those of `--log`, after each test."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def log_as_before() -> Iterator[None]:
    """Restore the handlers and the level of framekit's log.

    A handler may refer to the closed standard error of a test.
    """
    logger = logging.getLogger("framekit")
    handlers, level = list(logger.handlers), logger.level
    yield
    logger.handlers[:] = handlers
    logger.setLevel(level)

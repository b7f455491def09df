"""Configure all tests: no time limits, few examples in short tests, and a cache of the loaded shipped definitions."""

import gc
import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import settings
from shipped import FRAMES
from spread import many

from framekit.api.event_loop import LOOP_VARIABLE
from framekit.codec import codec
from framekit.codec.cache import CacheFolder, DefinitionCache, cache_folder
from framekit.definition.load import protocol as library
from framekit.definition.model.protocol import Protocol
from framekit.definition.sources import Sources, cached_by

settings.register_profile("long", deadline=None, max_examples=many(25, 200))
settings.register_profile("short", deadline=None, max_examples=15)

gc.set_threshold(
    100_000, 50, 100
)  # thousands of tests keep many objects; examining them again and again costs a fifth of the time

codec.MOST_KEPT = library.MOST_KEPT = 512
"""Hundreds of small definitions are used between two tests of a shipped definition, which takes seconds to compile."""


class ShippedKeeper(DefinitionCache):
    """Cache the shipped definitions in the user's cache folder, also for the next test process."""

    def loaded(self, path: Path) -> tuple[Protocol, Sources] | None:
        return super().loaded(path) if FRAMES in path.parents else None

    def was_loaded(self, path: Path, protocol: Protocol, sources: Sources) -> None:
        if FRAMES in path.parents:
            super().was_loaded(path, protocol, sources)


def pytest_configure(config: pytest.Config) -> None:
    settings.load_profile("short" if "not long" in config.option.markexpr else "long")
    cache = cache_folder()
    if cache is not None:
        keeping = ExitStack()
        keeping.enter_context(cached_by(ShippedKeeper(CacheFolder(cache))))
        config.add_cleanup(keeping.close)


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return the number of workers for `-n auto`: one more than processors, since many tests wait for programs."""
    return (os.cpu_count() or 1) + 1


@pytest.fixture
def small_heap(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Exclude the objects that earlier tests keep alive from the garbage collections of this test.

    Each collection takes a second with them.
    """
    unfreeze = gc.unfreeze
    gc.freeze()
    monkeypatch.setattr(gc, "unfreeze", gc.freeze)  # objects that the test itself freezes stay frozen until its end
    yield
    unfreeze()


os.environ.setdefault(LOOP_VARIABLE, "asyncio")
"""Most tests run in asyncio's loop, which is always installed; `FRAMEKIT_LOOP=uvloop make test` uses the other."""


@pytest.fixture(scope="module", params=["asyncio", "uvloop"])
def each_loop(request: pytest.FixtureRequest) -> Iterator[str]:
    """Run the tests of a module in both event loops; skip uvloop if it is not installed."""
    library: str = request.param
    pytest.importorskip(library)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(LOOP_VARIABLE, library)
        yield library


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the tests by duration, the longest first; a long test at the end would leave the other processors idle."""
    items.sort(key=minutes_of, reverse=True)


def minutes_of(item: pytest.Item) -> float:
    """Return the expected duration of a long test in minutes, from its marker `long(minutes=1)`."""
    long = item.get_closest_marker("long")
    return 0 if long is None else long.kwargs.get("minutes", 0.1)

"""The page that Prometheus fetches: values, quality, counters; read with the library's own parser."""

from __future__ import annotations

import socket
import sys
import urllib.request
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from points.test_sinks import run_file

from framekit.api.run import Run, loaded
from framekit.definition.problems import DefinitionError

pytest.importorskip("prometheus_client", reason="prometheus-client is not installed")


def metrics(port: int) -> dict[str, dict[str, float]]:
    """Return the values by name and by their most distinctive label."""
    from prometheus_client.parser import text_string_to_metric_families

    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as reply:
        text = reply.read().decode()
    found: dict[str, dict[str, float]] = {}
    for family in text_string_to_metric_families(text):
        for one in family.samples:
            labels: Any = one.labels
            key = labels.get("point") or labels.get("block") or labels.get("channel") or labels.get("kind")
            found.setdefault(one.name, {})[key] = one.value
    return found


def test_values_and_counters_are_fetched(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    run = Run(run_file(tmp_path, f"{{prometheus: {port}}}"))
    with run:
        run.next_end(-1, timeout=10)
        found = metrics(port)
        assert {"framekit_line_load", "framekit_channel_errors_total"}.isdisjoint(found)  # no speed, no errors
        assert found["framekit_channel_open"] == {"1": 1}
        assert found["framekit_block_done_total"]["p0"] >= 1
        assert found["framekit_channel_bytes_in_total"]["1"] > 9
        assert found["framekit_sink_dropped_total"] == {"prometheus": 0}
        for _ in range(100):
            if found["framekit_sink_taken_total"]["prometheus"] >= 2:
                break
            found = metrics(port)
        assert found["framekit_point_value"] == {"temperature": 21.7, "state": 2}
        assert found["framekit_point_good"] == {"temperature": 1, "state": 1}
        assert found["framekit_point_time_seconds"]["state"] > 1.7e9
        assert found["framekit_info"] == {None: 1}
        if sys.platform == "linux":
            assert found["process_resident_memory_bytes"][None] > 1e6
            assert found["process_start_time_seconds"][None] > 1.7e9
    with pytest.raises(OSError):
        metrics(port)


def test_two_sinks_of_one_kind_and_target_are_two_series() -> None:
    from framekit.run.status import RunStatus, SinkStatus
    from framekit.sinks.prometheus import _of_sinks

    one = SinkStatus(kind="influx", target="there", written=1, waiting=0, dropped=0)
    status = cast(RunStatus, SimpleNamespace(run="plant", sinks=[one, one]))
    for family in _of_sinks(status):
        assert [sample.labels["sink"] for sample in family.samples] == ["1", "2"]


@pytest.mark.parametrize(
    ("sink", "problem"),
    [
        ("{prometheus: 70000}", "'70000' is no place to listen on"),
        ('{prometheus: "gateway:9101"}', "'gateway:9101' is no place to listen on"),
        ("{prometheus: 9101, every: 2 s}", "'every' has no effect"),
    ],
)
def test_what_is_wrong_with_it(tmp_path: Path, sink: str, problem: str) -> None:
    with pytest.raises(DefinitionError, match=problem):
        loaded(run_file(tmp_path, sink))


def test_a_missing_library_is_told_in_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("framekit.sinks.base.find_spec", lambda name: None)
    with pytest.raises(DefinitionError) as error:
        loaded(run_file(tmp_path, "{prometheus: 9101}"))
    (problem,) = error.value.problems
    message = "the library prometheus-client, which is not installed – install it: pip install prometheus-client"
    assert str(problem).endswith(message)

"""Sinks: destinations of the values of a run's points. One module and one row of `SINKS` for each kind."""

from framekit.sinks.base import SINKS as SINKS
from framekit.sinks.base import Sink as Sink
from framekit.sinks.base import SinkKind as SinkKind
from framekit.sinks.base import add_sink as add_sink
from framekit.sinks.files import CsvFile, JsonLines
from framekit.sinks.influx import Influx
from framekit.sinks.mqtt import Mqtt
from framekit.sinks.opcua import Opcua
from framekit.sinks.parquet import ParquetFiles
from framekit.sinks.postgres import Postgres
from framekit.sinks.prometheus import Prometheus
from framekit.sinks.sparkplug import Sparkplug
from framekit.sinks.sqlite import SqliteHistory

SINKS.update(
    {
        "csv": CsvFile,
        "jsonl": JsonLines,
        "sqlite": SqliteHistory,
        "parquet": ParquetFiles,
        "prometheus": Prometheus,
        "mqtt": Mqtt,
        "sparkplug": Sparkplug,
        "influx": Influx,
        "postgres": Postgres,
        "opcua": Opcua,
    }
)

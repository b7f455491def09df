"""A history of values in PostgreSQL: one table, filled by COPY in batches; ready to be a hypertable of TimescaleDB.

A batch is stored completely or not at all, and existing rows are left unchanged: repetitions after a kill or a lost
connection create no duplicates.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, ClassVar
from urllib.parse import parse_qsl, urlsplit

from framekit.definition.keys import TEXT, Form, KeyReading, key, ref
from framekit.definition.tree import Node
from framekit.run.model import Point
from framekit.run.points import PointValue
from framekit.sinks.base import Host, NeverTakenError, Sampled, Sink, not_installed
from framekit.sinks.secrets import SECRET, Secret
from framekit.sinks.store import NetworkSink

if TYPE_CHECKING:
    import psycopg

logging.getLogger("psycopg").addHandler(logging.NullHandler())  # its errors are troubles of the run

MOST_ROWS = 5_000
"""Largest number of rows in a batch, unless one sample has more."""

LONGEST_ANSWER = 10
"""Time limit for the answer of a server (s)."""

_COLUMNS = "time, run, point, value, words, unit, quality, reason"


SECRETS = {"password", "sslpassword", "passfile", "service", "servicefile"}
"""Options of libpq that contain secrets, or read them from another place."""


def read_database(reading: KeyReading, node: Node) -> str:
    """Parse `postgresql://HOST:PORT/DATABASE`. Raises Broken."""
    text = reading.reader.text(node).strip()
    try:
        found = urlsplit(text)
        options = {name.lower() for name, _ in parse_qsl(found.query, keep_blank_values=True)}
        is_address = found.scheme in ("postgresql", "postgres") and len(found.path) > 1 and not found.fragment
        has_user = found.username is not None or "user" in options
        has_secret = found.password is not None or bool(options & SECRETS)
    except ValueError:
        is_address = has_user = has_secret = False
    if has_secret:
        raise reading.reader.broken(node.at, "a secret does not stand in a run file", "use user: and password:")
    if has_user:
        raise reading.reader.broken(node.at, "the user's name has a key of its own", "use user:")
    if not is_address:
        raise reading.reader.broken(node.at, f"'{text}' names no database", "write it like postgresql://HOST/DATABASE")
    return text


@dataclass(frozen=True, slots=True, kw_only=True)
class Postgres(NetworkSink):
    """A table of a PostgreSQL database; it is created if it is missing."""

    word: ClassVar[str] = "postgres"
    postgres: str = key(
        "postgres", Form(ref("text"), read_database), "The database: postgresql://HOST:5432/DATABASE, with the options "
        "of libpq behind ?, such as sslmode=verify-full.",
    )  # fmt: skip
    table: str = key("table", TEXT, "The table; schema.table for one in a schema.", default="history")
    user: str = key("user", TEXT, "The user's name.", default="")
    password: Secret | None = key("password", SECRET, "Where the password stands: env:NAME or file:NAME.", default=None)

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        yield from not_installed("psycopg", "psycopg")
        if self.password is not None and not self.user:
            yield "password", "'password' has no effect without user", "add user:, or remove it"
        parts = self.table.split(".")
        if len(parts) > 2 or not all(parts) or "\0" in self.table:
            yield "table", f"'{self.table}' is no name of a table", "write table, or schema.table"

    @property
    def target(self) -> str:
        """Return the database without its options."""
        return self.postgres.partition("?")[0]

    @property
    def has_secret(self) -> bool:
        return True  # the system may give one: a variable of the environment, a file of the user

    def make(self) -> Sink:
        return PostgresSink(self)


class PostgresSink(Sink):
    """Writes rows. Raises psycopg.Error, OSError, ValueError.

    Column `value` has the exact number (numeric); `words` has texts, and the words of `enum`. Both are null if the
    quality is not good.
    """

    def __init__(self, kind: Postgres) -> None:
        self.kind = kind
        self._run = ""
        self._units: Mapping[str, str] = {}
        self._connection: psycopg.Connection[Any] | None = None

    def meet(self, host: Host) -> None:
        self._run = host.run

    def open(self, points: Sequence[Point]) -> None:
        import psycopg

        kind = self.kind
        self._units = {point.name: point.unit for point in points}
        options: dict[str, Any] = {"connect_timeout": LONGEST_ANSWER, "application_name": f"framekit {self._run}"}
        options |= {"tcp_user_timeout": LONGEST_ANSWER * 1000}  # a server that is no longer there
        options |= {"keepalives_idle": LONGEST_ANSWER, "keepalives_interval": 2, "keepalives_count": 3}
        if kind.user:
            options |= {"user": kind.user}
        if kind.password is not None:
            options |= {"password": kind.password.read()}
        self._connection = connection = psycopg.connect(kind.postgres, autocommit=True, **options)
        connection.execute(f"SET statement_timeout = '{LONGEST_ANSWER}s'")
        if connection.execute("SELECT to_regclass(%s)", (self._name.as_string(connection),)).fetchone() == (None,):
            connection.execute(self._sql(
                "CREATE TABLE IF NOT EXISTS {table} (time timestamptz NOT NULL, run text NOT NULL, "
                "point text NOT NULL, value numeric, words text, unit text NOT NULL, quality text NOT NULL, "
                "reason text NOT NULL, PRIMARY KEY (run, point, time))"
            ))  # fmt: skip
        connection.execute(self._sql("CREATE TEMP TABLE incoming (LIKE {table}) ON COMMIT DELETE ROWS"))

    @property
    def _name(self) -> psycopg.sql.Identifier:
        from psycopg.sql import Identifier

        return Identifier(*self.kind.table.split("."))

    def _sql(self, text: Any) -> psycopg.sql.Composed:
        from psycopg.sql import SQL

        return SQL(text).format(table=self._name)

    def write(self, samples: Sequence[Sampled]) -> int:
        import psycopg

        connection = self._connection
        assert connection is not None
        rows: list[tuple[Any, ...]] = []
        count = 0
        for sample in samples:
            if count and len(rows) + len(sample.values) > MOST_ROWS:
                break
            rows += [self.row(sample.time, one) for one in sample.values]
            count += 1
        try:
            with connection.transaction(), connection.cursor() as cursor:
                with cursor.copy(f"COPY incoming ({_COLUMNS}) FROM STDIN") as copy:
                    for row in rows:
                        copy.write_row(row)
                cursor.execute(self._sql(
                    f"INSERT INTO {{table}} ({_COLUMNS}) SELECT {_COLUMNS} FROM incoming ON CONFLICT DO NOTHING"
                ))  # fmt: skip
        except (psycopg.DataError, psycopg.IntegrityError) as error:
            if count > 1:  # one of them is wrong: fewer at once find it
                return self.write(samples[: count // 2])
            raise NeverTakenError(str(error).partition("\n")[0]) from None
        return count

    def row(self, time: int, one: PointValue) -> tuple[Any, ...]:
        """Return a value as a row; `␀` replaces character 0, which PostgreSQL does not support in texts."""
        seconds, rest = divmod(time, 1_000_000_000)
        moment = datetime.fromtimestamp(seconds, UTC).replace(microsecond=rest // 1000)
        value = one.value if one.quality == "good" else None
        words = value.replace("\0", "␀") if isinstance(value, str) else None
        number = value if words is None else one.number
        if not isinstance(number, (int, float)):  # a text of the device
            number = None
        reason = one.reason.replace("\0", "␀")
        return (moment, self._run, one.name, number, words, self._units.get(one.name, ""), one.quality, reason)

    def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

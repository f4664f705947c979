"""Questions to a data set of many captures, by DuckDB."""

from __future__ import annotations

import base64
import os
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from ..columns import TABLES, extra
from ..errors import Unsupported

if TYPE_CHECKING:
    import duckdb
    import pandas

__all__ = ["QUESTIONS", "Dataset", "Question", "open"]

SCHEMA = "polepair-columns/1"
"""The version of the tables that the questions are for."""

SCHEMA_ID = re.compile(rb"polepair-columns/[0-9]+")

PARTITIONS = "date date, site varchar"
_COMMON = "t timestamp, t_ns bigint, source varchar, bus varchar, "
_COLUMNS = {
    "frames": _COMMON + "dir tinyint, protocol varchar, can_id integer, flags integer, data blob, file varchar, "
    "file_pos bigint, seq bigint, ",
    "signals": _COMMON + "axis integer, signal varchar, value double, value_i bigint, unit varchar, quality smallint, "
    "req_id bigint, frame_seq bigint, ",
    "transactions": "t_req_ns bigint, t_rep_ns bigint, rtt_us bigint, axis integer, op varchar, outcome varchar, "
    "retries smallint, source varchar, bus varchar, ",
    "events": _COMMON + "axis integer, event varchar, name varchar, code bigint, text varchar, cause varchar, "
    "remedy varchar, frame_seq bigint, ",
}
"""Column types of tables, for data sets in which no capture has a row of the table."""


class Question(NamedTuple):
    """A query by a name."""

    name: str
    about: str
    sql: str


QUESTIONS = {
    question.name: question
    for question in (
        Question(
            "captures",
            "Captures, with their frames and their span.",
            """select site, file, any_value(source) as source, string_agg(distinct protocol, ', ') as protocols,
                      min(t) as first, max(t) as last, count(*) as frames
               from frames group by site, file order by site, first nulls last, file""",
        ),
        Question(
            "faults-by-week",
            "Faults of each drive, week by week.",
            """select site, source, bus, axis, time_bucket(interval 7 days, t) as week, name as fault, code,
                      count(*) as times, any_value(cause) as cause, any_value(remedy) as remedy
               from events where event = 'fault' group by site, source, bus, axis, week, fault, code
               order by week, site, source, bus, axis, times desc""",
        ),
        Question(
            "restarts",
            "Drives that started again, with the times.",
            """select site, source, bus, axis, count(*) as restarts, min(t) as first, max(t) as last
               from events where event = 'state' and name = 'nmt' and text like '%boot-up'
               group by site, source, bus, axis order by restarts desc, site, source, bus, axis""",
        ),
        Question(
            "slowest-answers",
            "The twenty answers that took longest.",
            """select site, source, bus, axis, op, rtt_us, outcome, retries, make_timestamp_ns(t_req_ns) as asked
               from transactions where rtt_us is not null order by rtt_us desc, t_req_ns limit 20""",
        ),
        Question(
            "answer-times",
            "How long each drive takes to answer, in microseconds.",
            """select site, source, bus, axis, count(*) as answers, median(rtt_us)::bigint as median_us,
                      quantile_cont(rtt_us, 0.99)::bigint as p99_us, max(rtt_us) as longest_us
               from transactions where rtt_us is not null group by site, source, bus, axis
               order by p99_us desc, site, source, bus, axis""",
        ),
        Question(
            "unanswered",
            "Requests that were not done, by drive and operation.",
            """select site, source, bus, axis, op, outcome, count(*) as times
               from transactions where outcome <> 'done' group by site, source, bus, axis, op, outcome
               order by times desc, site, source, bus, axis, op""",
        ),
        Question(
            "retries",
            "Requests that were sent again, day by day.",
            """select site, source, bus, date, count(*) as requests, sum(retries)::bigint as retries,
                      round(100.0 * count(*) filter (retries > 0) / count(*), 2) as percent
               from transactions group by site, source, bus, date having sum(retries) > 0
               order by date, site, source, bus""",
        ),
        Question(
            "temperature-against-torque",
            "Each drive's temperature and torque, hour by hour.",
            """select site, source, bus, axis, date_trunc('hour', t) as hour,
                      round(avg(value) filter (signal like 'Temp/%'), 2) as temperature,
                      round(avg(abs(value)) filter (signal = 'Actual/Torque'), 4) as torque,
                      round(max(abs(value)) filter (signal = 'Actual/Torque'), 4) as highest_torque
               from signals where quality = 0 and (signal like 'Temp/%' or signal = 'Actual/Torque')
               group by site, source, bus, axis, hour order by site, source, bus, axis, hour""",
        ),
        Question(
            "speeds",
            "Slowest, fastest and mean speed of each drive, in its unit.",
            """select site, source, bus, axis, unit, round(min(value), 3) as slowest, round(max(value), 3) as fastest,
                      round(avg(abs(value)), 3) as mean, count(*) as readings
               from signals where signal = 'Actual/Velocity' and quality = 0 group by site, source, bus, axis, unit
               order by site, source, bus, axis""",
        ),
        Question(
            "bus-load",
            "Frames and bits of each CAN bus in its busiest second (stuff bits not counted).",
            """with seconds as (
                   select site, source, bus, date_trunc('second', t) as second, count(*) as frames,
                          sum(8 * octet_length(data) + if(flags & 1 = 1, 67, 47))::bigint as bits
                   from frames where can_id is not null and t is not null and flags & 4 = 0
                   group by site, source, bus, second)
               select site, source, bus, max(frames) as frames_a_second, max(bits) as bits_a_second,
                      round(max(bits) / 5000.0, 1) as percent_of_500k, arg_max(second, bits) as busiest
               from seconds group by site, source, bus order by bits_a_second desc""",
        ),
        Question(
            "broken-frames",
            "Frames whose check fails or that break their protocol, and error frames, day by day.",
            """select site, source, bus, date, count(*) as frames, count(*) filter (flags & 32 <> 0) as check_fails,
                      count(*) filter (flags & 256 <> 0) as breaks_protocol, count(*) filter (flags & 4 <> 0) as errors
               from frames group by site, source, bus, date having count(*) filter (flags & (32 + 256 + 4) <> 0) > 0
               order by date, site, source, bus""",
        ),
        Question(
            "odd",
            "What a healthy bus does not do.",
            """select site, source, bus, axis, name, count(*) as times, any_value(text) as example
               from events where event = 'odd' group by site, source, bus, axis, name
               order by times desc, site, source, bus, axis""",
        ),
        Question(
            "coverage",
            "Hours of each day for which a bus was recorded.",
            """select site, source, bus, date, count(distinct date_trunc('hour', t)) as hours, count(*) as frames
               from frames where t is not null group by site, source, bus, date order by site, source, bus, date""",
        ),
    )
}
"""The questions of `Dataset.ask`, by their names."""


class Dataset:
    """A data set as DuckDB's views `frames`, `signals`, `transactions` and `events`.

    `connection` is DuckDB's own, for any further query. Close it with `close()` or by `with`.
    """

    __slots__ = ("connection", "root")

    def __init__(self, root: str, connection: duckdb.DuckDBPyConnection) -> None:
        self.root = root
        self.connection = connection

    def __enter__(self) -> Dataset:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes DuckDB's connection."""
        self.connection.close()

    def sql(self, query: str, parameters: Sequence[object] = ()) -> duckdb.DuckDBPyRelation:
        """A query of your own. Errors: DuckDB's."""
        return self.connection.sql(query, params=list(parameters))

    def ask(self, question: str) -> duckdb.DuckDBPyRelation:
        """One of `QUESTIONS`, by its name. Errors: `Unsupported` for another."""
        known = QUESTIONS.get(question)
        if known is None:
            raise Unsupported(f"there is no question `{question}`: {', '.join(QUESTIONS)}")
        return self.sql(known.sql)

    def to_pandas(self, question: str) -> pandas.DataFrame:
        """The answer to a question as pandas has it; needs pandas."""
        return self.ask(question).df()


def _has_parts(connection: Any, pattern: str) -> bool:
    (found,) = connection.execute("select count(*) from glob(?)", [pattern]).fetchone()
    return bool(found)


def _check_schema(connection: Any, pattern: str) -> None:
    """Refuses tables of another version than the questions are for. Looks into the first and the last file."""
    files = connection.execute("select unnest([min(file), max(file)]) from glob(?)", [pattern]).fetchall()
    for (file,) in files:
        pairs = connection.execute(
            "select value from parquet_kv_metadata(?) where decode(key) = 'ARROW:schema'", [file]
        ).fetchall()
        found = [SCHEMA_ID.search(base64.b64decode(value)) for (value,) in pairs]
        versions = {match.group().decode() for match in found if match}
        if versions != {SCHEMA}:
            what = ", ".join(sorted(versions)) or "no table of polepair"
            raise Unsupported(
                f"{file} is {what}, and this version reads {SCHEMA}: decode the captures again with this version"
            )


def open(
    dataset: str | os.PathLike[str],
    *,
    connection: duckdb.DuckDBPyConnection | None = None,
    storage_options: Mapping[str, Any] | None = None,
) -> Dataset:
    """Opens a data set that `polepair decode CAPTURES -o DATASET` has made. Nothing of it is changed.

    A data set in a bucket (`s3://plant/dataset`) is read by fsspec, with these `storage_options`. `connection` is a
    connection of your own, which has to have that access itself. Errors: `FileNotFoundError` where there is no data
    set, `Unsupported` for tables of another version.
    """
    root = os.fspath(dataset).rstrip("/\\") or os.sep
    own = connection
    if own is None:
        own = extra("duckdb", "polepair[fleet]").connect()
        if "://" in root:
            core = extra("fsspec.core", "polepair[fleet]")
            own.register_filesystem(core.url_to_fs(root, **(storage_options or {}))[0])
    patterns = {table: f"{root}/{table}/**/*.parquet" for table in TABLES}
    present = {table: _has_parts(own, pattern) for table, pattern in patterns.items()}
    if not any(present.values()):
        raise FileNotFoundError(f"there is no data set in {root}: make one with `polepair decode CAPTURES -o {root}`")
    for table, pattern in patterns.items():
        if present[table]:
            _check_schema(own, pattern)
            quoted = pattern.replace("'", "''")
            source = f"read_parquet('{quoted}', hive_partitioning = true, hive_types = {{'date': date}})"
            # Days, hours and weeks are those of UTC, as the dates of the partitions, whatever the session's zone.
            columns = "*" if table == "transactions" else "* replace (t at time zone 'UTC' as t)"
            own.execute(f"create or replace temp view {table} as select {columns} from {source}")
        else:
            own.execute(f"create or replace temp table _{table} ({_COLUMNS[table]}{PARTITIONS})")
            own.execute(f"create or replace temp view {table} as select * from _{table}")
    return Dataset(root, own)

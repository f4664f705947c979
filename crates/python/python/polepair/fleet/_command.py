"""The command line: `polepair fleet`, `python -m polepair.fleet`."""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Sequence

from ..columns import extra
from ..errors import PolepairError
from ._decode import Progress, Report, decode
from ._questions import QUESTIONS, Dataset, open

__all__ = ["main"]

CSV_ROWS = 10_000
"""Rows of CSV that are fetched at once."""
FAILED_MAX = 20
"""Failures that are shown with their reasons."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line, and gives its exit code: 0, 1 where captures failed, 2 for a wrong call."""
    given = _parser().parse_args(arguments)
    try:
        if given.command == "questions":
            return _print_questions()
        return _decode(given) if given.command == "decode" else _answer(given)
    except PolepairError as error:
        hint = f"\n  try: {error.hint}" if error.hint else ""
        print(f"error: {error} ({error.code}){hint}", file=sys.stderr)
    except (OSError, ImportError) as error:
        print(f"error: {error}", file=sys.stderr)
    except KeyboardInterrupt:
        print("interrupted: the same command goes on", file=sys.stderr)
        return 130
    return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="polepair fleet", description="Captures of many machines: one data set, and questions to it."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    decoder = commands.add_parser(
        "decode",
        help="decode a folder or bucket of captures to a data set",
        description="Decodes a folder or bucket of captures to a data set of Parquet files. What the data set has "
        "already is left as it is, so the same command goes on after an interruption.",
    )
    decoder.add_argument("source", metavar="SOURCE", help="folder or bucket of captures: captures, s3://plant/captures")
    decoder.add_argument("out", metavar="OUT", help="folder or bucket of the data set")
    decoder.add_argument("--ray", metavar="ADDRESS", help="decode on a Ray cluster: auto, local, ray://HOST:10001")
    decoder.add_argument("--workers", type=int, metavar="N", help="threads without Ray [default: one for each core]")
    decoder.add_argument("--as", dest="protocols", metavar="PROTO[@ID],…", help="protocols [default: detected]")
    decoder.add_argument("--profile", metavar="NAME", help="drive whose names are used")
    decoder.add_argument("--from", dest="format", metavar="FORMAT", help="file format [default: detected]")
    decoder.add_argument(
        "--site",
        metavar="NAME",
        help="name of the site, for the partition; {0} is the first folder of a capture below SOURCE [default: local]",
    )
    decoder.add_argument(
        "--gateway", metavar="NAME", help="name of the recording device; {0}, {1} and {folder} too [default: local]"
    )
    decoder.add_argument("--tables", metavar="TABLE,…", default="", help="tables to write [default: all]")
    decoder.add_argument("--retries", type=int, default=2, metavar="N", help="attempts after a failed read or write")
    asker = commands.add_parser("ask", help="answer one of the questions that `questions` lists")
    asker.add_argument("dataset", metavar="DATASET", help="folder or bucket of the data set")
    asker.add_argument("question", choices=QUESTIONS, metavar="QUESTION", help=", ".join(QUESTIONS))
    sql = commands.add_parser("sql", help="answer a query of your own over frames, signals, transactions and events")
    sql.add_argument("dataset", metavar="DATASET", help="folder or bucket of the data set")
    sql.add_argument("query", metavar="QUERY", help="a query in DuckDB's SQL")
    for command in (asker, sql):
        command.add_argument("--csv", action="store_true", help="print all rows as CSV instead of a table")
    commands.add_parser("questions", help="list the questions")
    return parser


def _print_questions() -> int:
    for question in QUESTIONS.values():
        print(f"{question.name:28}{question.about}")
    return 0


def _decode(given: argparse.Namespace) -> int:
    line = _ProgressLine()
    report = decode(
        given.source,
        given.out,
        ray=given.ray,
        workers=given.workers,
        protocols=given.protocols,
        profile=given.profile,
        format=given.format,
        site=given.site,
        gateway=given.gateway,
        tables=[table for table in given.tables.split(",") if table],
        retries=given.retries,
        progress=line.show,
    )
    line.end()
    _print_report(report)
    return 1 if report.failed else 0


def _print_report(report: Report) -> None:
    for name, note in report.notes:
        print(f"note: {name}: {note}", file=sys.stderr)
    for outcome in report.failed[:FAILED_MAX]:
        print(f"failed: {outcome.capture.name}: {outcome.reason}", file=sys.stderr)
    if len(report.failed) > FAILED_MAX:
        print(f"failed: {len(report.failed) - FAILED_MAX} more", file=sys.stderr)
    print(report)


class _ProgressLine:
    """Shows the progress in one line of a terminal."""

    def __init__(self) -> None:
        self._shown = sys.stderr.isatty()
        self._began = time.monotonic()

    def show(self, now: Progress) -> None:
        if self._shown:
            rate = now.size / 1e6 / max(time.monotonic() - self._began, 0.1)
            failed = f", {now.failed} failed" if now.failed else ""
            sys.stderr.write(
                f"\r\x1b[K{now.captures} of {now.of_captures} captures, {now.size / 1e6:,.0f} of "
                f"{now.of_size / 1e6:,.0f} MB, {rate:,.0f} MB/s{failed}"
            )
            sys.stderr.flush()

    def end(self) -> None:
        if self._shown:
            sys.stderr.write("\r\x1b[K")


def _answer(given: argparse.Namespace) -> int:
    with open(given.dataset) as data:
        query = QUESTIONS[given.question].sql if given.command == "ask" else given.query
        try:
            if given.csv:
                _print_csv(data, query)
            elif (answer := data.sql(query)) is not None:
                print(answer)
        except extra("duckdb", "polepair[fleet]").Error as error:
            print(f"error: the query: {error}", file=sys.stderr)
            return 2
    return 0


def _print_csv(data: Dataset, query: str) -> None:
    cursor = data.connection.execute(query)
    writer = csv.writer(sys.stdout)
    writer.writerow([column[0] for column in cursor.description or []])
    while rows := cursor.fetchmany(CSV_ROWS):
        writer.writerows(rows)

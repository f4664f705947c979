"""Captures of many machines: decodes them to one data set and answers questions; needs `polepair[fleet]`.

    from polepair import fleet

    fleet.decode("captures", "dataset", protocols="canopen")             # or ray="auto", on a cluster
    with fleet.open("dataset") as data:
        print(data.ask("faults-by-week"))
        print(data.sql("select axis, max(value) from signals where signal = 'Actual/Torque' group by all"))

`polepair fleet decode captures dataset` and `polepair fleet ask dataset faults-by-week` do the same. Captures and
data set may be in folders or buckets (`s3://captures`, with s3fs). `docs/reference/columns.md` has the tables; `t` is a
timestamp in UTC here.
"""

from ._decode import Capture, Job, Outcome, Progress, Report, decode
from ._questions import QUESTIONS, Dataset, Question, open

__all__ = [
    "QUESTIONS",
    "Capture",
    "Dataset",
    "Job",
    "Outcome",
    "Progress",
    "Question",
    "Report",
    "decode",
    "open",
]

"""Reads a scope's Parquet file with two foreign readers, and tells what is in it as JSON."""

import json
import sys

import duckdb
import pyarrow.parquet as pq

(path,) = sys.argv[1:]
table = pq.read_table(path)
columns = ", ".join(f'count("{name}")' for name in table.column_names)
counted = duckdb.sql(f"select count(*), {columns} from read_parquet('{path}')").fetchall()[0]
times = table["time"].to_numpy()
told = {
    "names": table.column_names,
    "types": sorted({str(field.type) for field in table.schema}),
    "units": json.loads(table.schema.metadata[b"units"]),
    "time_zero": table.schema.metadata[b"time_zero"].decode(),
    "rows": table.num_rows,
    "nulls": [table[name].null_count for name in table.column_names],
    "rising": bool((times[1:] > times[:-1]).all()),
    "counted": counted,
}
print(json.dumps(told))

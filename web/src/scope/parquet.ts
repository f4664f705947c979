// The picture's samples as a Parquet file: the rows of the CSV, as numbers. It is made here, by
// hyparquet-writer, so that what was recorded leaves this computer only if its owner sends it.

import { ByteWriter, ParquetWriter } from "hyparquet-writer";
import { type Exported, rows } from "./export";

/** Rows that are held as columns before they are written. */
const GROUP_ROWS = 65_536;

type Schema = ConstructorParameters<typeof ParquetWriter>[0]["schema"];

/**
 * `time` and a column for each channel, null where it has no sample. The file's metadata `units` says
 * the unit of each column as JSON, `time_zero` the time of day at which `time` is 0.
 */
export function parquet(
  channels: Exported[],
  from: number,
  to: number,
  timeZero: string,
): ArrayBuffer {
  const names = distinct(["time", ...channels.map((each) => each.name)]);
  const units = ["s", ...channels.map((each) => each.unit)];
  const schema: Schema = [
    { name: "scope", num_children: names.length },
    ...names.map((name, i) => ({
      name,
      type: "DOUBLE" as const,
      repetition_type: i ? ("OPTIONAL" as const) : ("REQUIRED" as const),
    })),
  ];
  const writer = new ByteWriter();
  const file = new ParquetWriter({
    writer,
    schema,
    createdBy: "polepair",
    kvMetadata: [
      {
        key: "units",
        value: JSON.stringify(Object.fromEntries(names.map((n, i) => [n, units[i]]))),
      },
      { key: "time_zero", value: timeZero },
    ],
  });
  let columns: (number | null)[][] = names.map(() => []);
  const flush = (): void => {
    const columnData = columns.map((data, i) => ({
      name: names[i] ?? "",
      data,
      encoding: "PLAIN" as const,
    }));
    file.write({ columnData, rowGroupSize: GROUP_ROWS });
    columns = names.map(() => []);
  };
  rows(channels, from, to, (time, values) => {
    columns[0]?.push(time);
    for (let i = 0; i < values.length; i++) {
      const value = values[i] ?? Number.NaN;
      columns[i + 1]?.push(Number.isNaN(value) ? null : value);
    }
    if (columns[0]?.length === GROUP_ROWS) flush();
  });
  if (columns[0]?.length) flush();
  file.finish();
  return writer.getBuffer();
}

/** No two alike: readers go by names. */
function distinct(names: string[]): string[] {
  const known = new Set<string>();
  return names.map((name) => {
    let free = name;
    for (let n = 2; known.has(free); n++) free = `${name} ${n}`;
    known.add(free);
    return free;
  });
}

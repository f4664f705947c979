// The picture: uPlot draws axes, grid and selection; curves are drawn here, from columns that keep
// spikes, with gaps as gaps.

import uPlot from "uplot";
import type { Columns } from "./decimate";
import type { Gap } from "./trace";

/** Dashes in CSS pixels, and in columns: a canvas takes long over dashes of a thousand points. */
const DASH = [5, 3];
const DASH_COLUMNS = 8;
const DASHED_MAX = 200;
/** Up to so many curves are drawn a little thicker; hairlines are several times as fast. */
const THICK_MAX = 4;
const FONT = "11px system-ui, sans-serif";
const POINTS_FROM_PX = 10;

export interface Curve {
  columns: Columns;
  gaps: readonly Gap[];
  name: string;
  /** Displayed unit; curves of one unit share an axis. */
  unit: string;
  factor: number;
  colour: string;
  dashed: boolean;
  /** Known at every time, not sampled: it gets no dots. */
  exact?: boolean;
}

/** A band across the picture, in the unit of the wire. */
export interface Band {
  unit: string;
  factor: number;
  low: number;
  high: number;
}

export interface Mark {
  time: number;
  label: string;
}

export interface Frame {
  curves: Curve[];
  bands?: Band[];
  marks: Mark[];
  from: number;
  to: number;
  /** The time that the axis calls 0. */
  origin: number;
  /** Which colours are shown: asking the browser for them at each picture makes it work out styles. */
  dark: boolean;
}

export interface Handlers {
  zoomed(from: number, to: number): void;
  clicked(time: number, second: boolean): void;
}

export class Plot {
  private chart: uPlot | null = null;
  private built = "";
  /** CSS pixels across the curves' area; asked of the browser only when it may have changed. */
  width = 0;
  private frame: Frame = { curves: [], marks: [], from: 0, to: 1, origin: 0, dark: false };
  private ink = "";
  private readonly watcher: ResizeObserver;

  constructor(
    private readonly host: HTMLElement,
    private readonly handlers: Handlers,
  ) {
    this.watcher = new ResizeObserver(() => this.chart?.setSize(this.size()));
    this.width = host.clientWidth;
    this.watcher.observe(host);
  }

  destroy(): void {
    this.watcher.disconnect();
    this.chart?.destroy();
  }

  get canvas(): HTMLCanvasElement | null {
    return this.chart?.ctx.canvas ?? null;
  }

  draw(frame: Frame): void {
    this.frame = frame;
    const units = [...new Set(frame.curves.map((curve) => curve.unit))];
    const labels = units.map((unit) => label(frame.curves, unit));
    const key = JSON.stringify([labels, frame.dark]);
    if (key !== this.built || !this.chart) this.build(units, labels, key);
    this.chart?.batch((chart: uPlot) => {
      chart.setScale("x", { min: frame.from - frame.origin, max: frame.to - frame.origin });
      for (const unit of units) chart.setScale(scale(unit), range(frame.curves, unit));
      // Room for the axes is found anew. Outside of the batch this would draw it all a second time.
      chart.redraw(false, true);
    });
  }

  private size(): { width: number; height: number } {
    return {
      width: Math.max(this.host.clientWidth, 80),
      height: Math.max(this.host.clientHeight, 60),
    };
  }

  private build(units: string[], labels: string[], key: string): void {
    this.chart?.destroy();
    this.built = key;
    this.ink = this.resolve("--ink");
    const line = this.resolve("--line");
    const axis = {
      stroke: this.resolve("--soft"),
      font: FONT,
      labelFont: FONT,
      labelSize: 14,
      labelGap: 0,
      grid: { stroke: line, width: 1 },
      ticks: { stroke: line, width: 1, size: 4 },
    };
    this.chart = new uPlot(
      {
        ...this.size(),
        padding: [8, units.length > 1 ? 0 : 10, 0, 0],
        legend: { show: false },
        cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false } },
        scales: { x: { time: false } },
        axes: [
          { ...axis, size: 24, values: (_, ticks) => ticks.map((tick) => `${round(tick)} s`) },
          ...units.map((unit, i) => ({
            ...axis,
            scale: scale(unit),
            side: i % 2 ? 1 : 3,
            size: (_: uPlot, ticks: string[] | null) => width(ticks),
            label: labels[i] ?? "",
            grid: { ...axis.grid, show: i === 0 },
          })),
        ],
        series: [
          {},
          ...units.map((unit) => ({ scale: scale(unit), show: true, paths: () => null })),
        ],
        hooks: {
          draw: [(chart) => this.paint(chart)],
          drawClear: [(chart) => (this.width = chart.bbox.width / (devicePixelRatio || 1))],
          setSelect: [(chart) => this.selected(chart)],
          ready: [(chart) => this.listen(chart)],
        },
      },
      [[0, 1], ...units.map(() => [null, null])],
      this.host,
    );
  }

  /** Value of a custom property in the current theme. */
  private resolve(property: string): string {
    const probe = document.createElement("i");
    probe.style.color = `var(${property})`;
    this.host.append(probe);
    const colour = getComputedStyle(probe).color;
    probe.remove();
    return colour;
  }

  private listen(chart: uPlot): void {
    chart.over.addEventListener("click", (event) => {
      if (chart.select.width > 2) return;
      const at = chart.posToVal(event.offsetX, "x") + this.frame.origin;
      this.handlers.clicked(at, event.shiftKey);
    });
  }

  private selected(chart: uPlot): void {
    const { left, width } = chart.select;
    if (width < 4) return;
    const from = chart.posToVal(left, "x") + this.frame.origin;
    const to = chart.posToVal(left + width, "x") + this.frame.origin;
    chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.handlers.zoomed(from, to);
  }

  private paint(chart: uPlot): void {
    const { ctx, bbox } = chart;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (const band of this.frame.bands ?? []) this.band(chart, band);
    for (const curve of this.frame.curves) this.curve(chart, curve);
    for (const mark of this.frame.marks) this.mark(chart, mark);
    ctx.restore();
  }

  private band(chart: uPlot, { unit, factor, low, high }: Band): void {
    const { ctx, bbox } = chart;
    const at = (value: number): number => chart.valToPos(value * factor, scale(unit), true);
    const [top, bottom] = [at(high), at(low)].sort((a, b) => a - b) as [number, number];
    ctx.fillStyle = this.ink;
    ctx.globalAlpha = 0.1;
    ctx.fillRect(bbox.left, top, bbox.width, Math.max(bottom - top, devicePixelRatio || 1));
    ctx.globalAlpha = 1;
  }

  private curve(chart: uPlot, curve: Curve): void {
    const { ctx, bbox } = chart;
    const { min = 0, max = 1 } = chart.scales[scale(curve.unit)] ?? {};
    const { from, to } = this.frame;
    const ratio = devicePixelRatio || 1;
    const across = bbox.width / (to - from);
    const up = (curve.factor * bbox.height) / ((max ?? 1) - (min ?? 0));
    const base = bbox.top + bbox.height + ((min ?? 0) * bbox.height) / ((max ?? 1) - (min ?? 0));
    const x = (time: number): number => bbox.left + (time - from) * across;
    const { columns } = curve;
    ctx.fillStyle = curve.colour;
    ctx.globalAlpha = 0.16;
    for (const gap of curve.gaps) {
      if (gap.to < from || gap.from > to) continue;
      ctx.fillRect(
        x(gap.from),
        bbox.top,
        Math.max((gap.to - gap.from) * across, 2 * ratio),
        bbox.height,
      );
    }
    ctx.globalAlpha = 1;
    ctx.strokeStyle = curve.colour;
    ctx.lineWidth = (this.frame.curves.length > THICK_MAX ? 1 : 1.5) * ratio;
    ctx.lineJoin = "bevel";
    const few = columns.count < DASHED_MAX;
    if (curve.dashed && few) ctx.setLineDash(DASH.map((each) => each * ratio));
    const column = (to - from) / columns.room;
    // A dash's gap leaves out the line between columns, never a column: no spike hides in it.
    const left = (time: number): boolean =>
      curve.dashed && !few && Math.floor(time / column) % DASH_COLUMNS >= 5;
    ctx.beginPath();
    for (let i = 0; i < columns.count; i++) {
      const time = columns.time[i] ?? 0;
      const at = x(time);
      const first = base - (columns.first[i] ?? 0) * up;
      if (i === 0 || columns.broken[i] || left(time)) ctx.moveTo(at, first);
      else ctx.lineTo(at, first);
      const low = columns.min[i] ?? 0;
      const high = columns.max[i] ?? 0;
      if (low === high) continue;
      ctx.lineTo(at, base - low * up);
      ctx.lineTo(at, base - high * up);
      ctx.lineTo(at, base - (columns.last[i] ?? 0) * up);
    }
    ctx.stroke();
    ctx.setLineDash([]);
    if (!curve.exact && columns.count && bbox.width / columns.count > POINTS_FROM_PX * ratio)
      this.points(ctx, curve, x, base, up);
  }

  /** Samples that are far apart are dots, so that the line is not taken for samples. */
  private points(
    ctx: CanvasRenderingContext2D,
    { columns, colour: fill }: Curve,
    x: (time: number) => number,
    base: number,
    up: number,
  ): void {
    const size = 3 * (devicePixelRatio || 1);
    ctx.fillStyle = fill;
    for (let i = 0; i < columns.count; i++) {
      const y = base - (columns.first[i] ?? 0) * up;
      ctx.fillRect(x(columns.time[i] ?? 0) - size / 2, y - size / 2, size, size);
    }
  }

  private mark(chart: uPlot, mark: Mark): void {
    const { ctx, bbox } = chart;
    const ratio = devicePixelRatio || 1;
    const at =
      bbox.left + ((mark.time - this.frame.from) * bbox.width) / (this.frame.to - this.frame.from);
    ctx.strokeStyle = ctx.fillStyle = this.ink;
    ctx.lineWidth = ratio;
    ctx.setLineDash([3 * ratio, 3 * ratio]);
    ctx.beginPath();
    ctx.moveTo(at, bbox.top);
    ctx.lineTo(at, bbox.top + bbox.height);
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.font = `bold ${11 * ratio}px system-ui, sans-serif`;
    ctx.textBaseline = "top";
    ctx.textAlign = "left";
    ctx.fillText(mark.label, at + 4 * ratio, bbox.top + 3 * ratio);
  }
}

/** uPlot's key for a unit; units without a word have one too. */
function scale(unit: string): string {
  return `y ${unit}`;
}

/** Room for an axis: its longest number and its label. */
function width(ticks: string[] | null): number {
  const longest = Math.max(3, ...(ticks ?? []).map((tick) => tick.length));
  return 26 + longest * 6.5;
}

/** Label of an axis: its signals, each once, and their unit. */
function label(curves: Curve[], unit: string): string {
  const names = curves.filter((curve) => curve.unit === unit).map((curve) => curve.name);
  return `${[...new Set(names)].join(", ")}${unit && ` [${unit}]`}`;
}

function range(curves: Curve[], unit: string): { min: number; max: number } {
  let low = Number.POSITIVE_INFINITY;
  let high = Number.NEGATIVE_INFINITY;
  for (const curve of curves) {
    if (curve.unit !== unit) continue;
    for (let i = 0; i < curve.columns.count; i++) {
      low = Math.min(low, (curve.columns.min[i] ?? low) * curve.factor);
      high = Math.max(high, (curve.columns.max[i] ?? high) * curve.factor);
    }
  }
  if (low > high) return { min: 0, max: 1 };
  if (low === high) return { min: low - 1, max: high + 1 };
  const [min, max] = uPlot.rangeNum(low, high, 0.1, true);
  return { min: min ?? low, max: max ?? high };
}

function round(value: number): string {
  return String(Number(value.toFixed(6)));
}

// Strip charts of the last seconds, drawn by uPlot. Of each bin of time the lowest and the highest value are kept, so
// that no peak is lost.
import { make } from "drive/panels.js";

export const WINDOW = 20; // s of simulated time
export const BIN = 0.2; // s
const FRAME = 0.01; // s between two samples, as FRAME in page.py
const FONT = '11px system-ui, "Segoe UI", sans-serif';

export class History {
  constructor(charts, bin = BIN) {
    this.bin = bin;
    this.names = [...new Set(charts.flatMap((chart) => chart.curves.map((curve) => curve.name)))];
    this.clear();
  }

  clear() {
    this.bins = new Map(); // number -> { low, lowAt, high, highAt } of each name, in order
  }

  // one sample; those of a restart begin anew
  add(t, values) {
    const number = Math.floor(t / this.bin + 1e-9);
    if (number < this.last) this.clear();
    this.last = number;
    if (!this.bins.has(number)) this.bins.set(number, this.names.map(() => ({ low: Infinity, high: -Infinity, lowAt: t, highAt: t })));
    this.names.forEach((name, k) => {
      const [bin, value] = [this.bins.get(number)[k], values[name] ?? NaN];
      if (value < bin.low) [bin.low, bin.lowAt] = [value, t];
      if (value > bin.high) [bin.high, bin.highAt] = [value, t];
    });
    const oldest = number - Math.round(WINDOW / this.bin);
    for (const key of this.bins.keys()) if (key < oldest) this.bins.delete(key);
  }

  // a bin as the server has it: its first and its second extreme of each name
  put(number, first, second) {
    this.bins.delete(number);
    const named = (row) => Object.fromEntries(this.names.map((name, k) => [name, row[k] ?? NaN]));
    this.add(number * this.bin, named(first));
    this.add((number + 0.5) * this.bin, named(second));
  }

  // two points for each bin, its begin and its last sample: a value that only rises is a straight line, without stairs
  curves(end) {
    const numbers = [...this.bins.keys()].sort((a, b) => a - b);
    const time = numbers.flatMap((number) => [number * this.bin - end, Math.min((number + 1) * this.bin - FRAME - end, 0)]);
    const pair = ({ low, high, lowAt, highAt }) => (high < low ? [null, null] : lowAt <= highAt ? [low, high] : [high, low]);
    const columns = this.names.map((name, k) => [name, numbers.flatMap((number) => pair(this.bins.get(number)[k]))]);
    return { time, columns: Object.fromEntries(columns) };
  }
}

// upper end of the axis for these values
export function end({ ends }, values) {
  const peak = values.reduce((a, b) => Math.max(a, Math.abs(b) || 0), 0);
  return ends.find((one) => one >= peak) ?? ends[ends.length - 1];
}

export class Charts {
  constructor(place, charts, names) {
    place.replaceChildren();
    this.turn = 0;
    this.charts = charts.map((chart) => ({ ...chart, curves: chart.curves.filter((curve) => names.has(curve.name)) }))
      .filter((chart) => chart.curves.length)
      .map((chart) => new StripChart(place, chart));
  }

  // one: only one of them, in turn, for a slow browser
  show(curves, one = false) {
    this.turn += 1;
    this.charts.forEach((chart, k) => (!one || k === this.turn % this.charts.length) && chart.show(curves));
  }

  recolour() {
    for (const chart of this.charts) chart.plot.redraw(false);
  }

  close() {
    for (const chart of this.charts) chart.close();
  }
}

// A canvas that the processor draws, which uPlot cannot be asked for. Without a graphics card the other kind takes
// most of a core.
function plot(options, data, place) {
  const { getContext } = HTMLCanvasElement.prototype;
  HTMLCanvasElement.prototype.getContext = function (kind) {
    return getContext.call(this, kind, { willReadFrequently: true });
  };
  try {
    return new uPlot(options, data, place);
  } finally {
    HTMLCanvasElement.prototype.getContext = getContext;
  }
}

class StripChart {
  constructor(place, chart) {
    [this.chart, this.high] = [chart, chart.ends[0]];
    const heading = make("p", { className: "hm-title", textContent: `${chart.title} [${chart.unit}]` });
    const line = ({ dashed, colour }) => make("i", { style: `border-top: 2px ${dashed ? "dashed" : "solid"} ${colour}` });
    const key = make("div", { className: "hm-key" }, heading, ...chart.curves.map((curve) => make("span", {}, line(curve), curve.text)));
    this.host = make("div", { className: "hm-plot", role: "img", ariaLabel: `${chart.title} over the last ${WINDOW} s` });
    place.append(make("figure", { className: "hm-chart" }, key, this.host));
    this.plot = plot(this.options(), [[], ...chart.curves.map(() => [])], this.host);
    this.observer = new ResizeObserver(() => this.fit());
    this.observer.observe(this.host);
  }

  close() {
    this.observer.disconnect();
    this.plot.destroy();
  }

  fit() {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (width && (width !== this.plot.width || height !== this.plot.height)) this.plot.setSize({ width, height });
  }

  options() {
    const { both, curves } = this.chart;
    const ink = () => getComputedStyle(this.host).color;
    const grid = { stroke: () => getComputedStyle(this.host).borderTopColor, width: 1 };
    const axis = { stroke: ink, font: FONT, grid, ticks: { show: false } };
    const low = () => (both ? -this.high : 0);
    const minus = (value) => String(value).replace("-", "−");
    return {
      width: this.host.clientWidth || 300, height: this.host.clientHeight || 132, padding: [6, 14, 0, 0], legend: { show: false }, cursor: { show: false },
      scales: { x: { time: false, range: [-WINDOW, 0] }, y: { range: () => [low(), this.high] } },
      series: [{}, ...curves.map((curve) => ({
        stroke: curve.colour, width: 1.5, dash: curve.dashed ? [4, 3] : undefined, points: { show: false },
      }))],
      axes: [
        { ...axis, size: 24, gap: 6, splits: () => [-WINDOW, -WINDOW / 2, 0], values: (_, at) => at.map((t) => (t ? `${minus(t)} s` : "0 s")) },
        { ...axis, size: 44, gap: 4, splits: () => (both ? [low(), 0, this.high] : [0, this.high / 2, this.high]), values: (_, at) => at.map(minus) },
      ],
    };
  }

  show({ time, columns }) {
    const { curves, factor } = this.chart;
    const shown = curves.map(({ name }) => (columns[name] ?? []).map((value) => (Number.isFinite(value) ? value * factor : null)));
    this.high = end(this.chart, shown.flat());
    this.plot.setData([time, ...shown]);
  }
}

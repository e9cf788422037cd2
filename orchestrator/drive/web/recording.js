// Source: a recorded run at the times of its pictures, and the angles of the reference beside it.
import { WINDOW } from "drive/charts.js";
import { Attempts } from "drive/task.js";

// number of the times up to t
const until = (time, t) => time.filter((one) => one <= t + 1e-9).length;

// values of columns over time at t, linear between the samples
export function sample({ time, columns }, t) {
  const count = until(time, t);
  const [a, b] = [Math.max(0, count - 1), Math.min(count, time.length - 1)];
  const share = a === b ? 0 : (t - time[a]) / (time[b] - time[a]);
  const at = (v, k) => v[k] ?? NaN; // a gap
  return Object.fromEntries(Object.entries(columns).map(([name, v]) => [name, at(v, a) + share * (at(v, b) - at(v, a))]));
}

export class Recording {
  shared = false;
  drives = false;

  // rules: of the training task, if it is scored
  constructor({ time, columns, ghost }, rules) {
    this.task = rules && new Attempts(rules);
    [this.run, this.ghost] = [{ time, columns }, Object.keys(ghost).length ? { time, columns: ghost } : null];
    [this.first, this.last] = this.span = [time[0], time[time.length - 1]];
    this.names = new Set(Object.keys(columns));
    [this.jumps, this.sliders] = [0, []];
    this.seek(this.first);
  }

  begin() {
    this.seek(this.first);
  }

  seek(t) {
    this.jumps += 1;
    this.task?.again();
    this.show(t);
  }

  advance(seconds) {
    if (this.time + seconds > this.last) this.seek(this.first);
    else this.show(this.time + seconds);
  }

  show(t) {
    this.time = Math.max(this.first, Math.min(this.last, t));
    this.values = sample(this.run, this.time);
    this.reference = this.ghost && sample(this.ghost, this.time);
    this.task?.add(this.time, this.values);
  }

  carry() {} // a recording has its load

  // the last seconds, and now
  curves() {
    const { time, columns } = this.run;
    const [from, to] = [this.time - WINDOW, this.time].map((t) => until(time, t));
    const part = (values, now) => [...values.slice(from, to), now];
    const parts = Object.entries(columns).map(([name, values]) => [name, part(values, this.values[name])]);
    return { time: part(time, this.time).map((t) => t - this.time), columns: Object.fromEntries(parts) };
  }
}

// Source: a recorded run at the times of its pictures, and the angles of the reference beside it.
import { WINDOW } from "drive/charts.js";

export class Recording {
  shared = false;
  drives = false;

  constructor({ time, columns, ghost }) {
    [this.all, this.columns, this.ghost] = [time, columns, Object.keys(ghost).length ? ghost : null];
    [this.first, this.last] = [time[0], time[time.length - 1]];
    this.names = new Set(Object.keys(columns));
    [this.jumps, this.sliders] = [0, []];
    this.seek(this.first);
  }

  get span() {
    return [this.first, this.last];
  }

  begin() {
    this.seek(this.first);
  }

  seek(t) {
    this.jumps += 1;
    this.show(t);
  }

  advance(seconds) {
    if (this.time + seconds > this.last) this.seek(this.first);
    else this.show(this.time + seconds);
  }

  show(t) {
    this.time = Math.max(this.first, Math.min(this.last, t));
    this.values = this.at(this.columns);
    this.reference = this.ghost && this.at(this.ghost);
  }

  // place of the time among the pictures, with its fraction
  get place() {
    return ((this.time - this.first) / (this.last - this.first)) * (this.all.length - 1);
  }

  // linear between the pictures
  at(columns) {
    const k = Math.max(0, Math.min(this.all.length - 2, Math.floor(this.place)));
    const mixed = ([name, v]) => [name, v[k] + (this.place - k) * (v[k + 1] - v[k])];
    return Object.fromEntries(Object.entries(columns).map(mixed));
  }

  // the last seconds, and now
  curves() {
    const from = this.all.findIndex((t) => t > this.time - WINDOW);
    const to = Math.floor(this.place) + 1;
    const until = (values, now) => [...values.slice(from, to), now];
    const columns = Object.entries(this.columns).map(([name, values]) => [name, until(values, this.values[name])]);
    return { time: until(this.all, this.time).map((t) => t - this.time), columns: Object.fromEntries(columns) };
  }
}

// The training task: progress and score of an attempt, from the samples that this page sees, and the panel that shows them.
//
// Progress: ready -> moving -> holding -> moving -> ... -> done. The clock starts when the tip has moved by `start` from
// its first position. A target is done when the tip has been within `radius` of it and slower than `slow` for `hold`
// without interruption. From then to the next one the machine carries the load of the target.
//
// Score, from the start of the clock to the end of the attempt; integrals by the trapezoidal rule:
//
//   cycle_time     s   to the last target done                     reach_time   s   to the first target entered
//   path_length    m   path of the tip, sum of the distances between samples, as the tip distance of Polowy and
//                      Rutkowski, Forests 15:1277, 2024
//   simultaneous   1   share of time with two or more functions moving (faster than MOVING)
//   functions      1   mean number of moving functions while any moves
//   energy         J   supply pressure times supply flow           peak_pressure   Pa   of the lines
//   smoothness     1   spectral arc length of the speed of the tip
//
// The speed of the tip is the norm of its velocities and of the turning speed times the distance from the axis.
import { make, write } from "drive/panels.js";

const MOVING = 0.02; // rad/s; a tenth of an ordinary speed, far above the leakage of a closed valve
const LONGEST = 600; // s; a longer attempt is given up, to limit memory
const RATE = 50; // Hz; sampling rate for the spectrum
const HIGHEST = 10; // Hz; upper limit of the frequency
const SMALLEST = 0.05; // smallest amplitude relative to that at zero frequency
const PADDING = 4; // zero padding by this power of two, for a smooth arc
const [NEXT, LATER] = ["#d55e00", "#0072b2"]; // Okabe and Ito: distinct with any colour blindness
const MINUTE = 1e-9; // s, for rounding: the time of a frame is a multiple of the step
const COLUMNS = [ // key of a score, heading with unit, factor from SI, digits
  ["cycle_time", "cycle s", 1, 1],
  ["path_length", "path m", 1, 1],
  ["simultaneous", "two or more %", 100, 0],
  ["functions", "functions", 1, 2],
  ["energy", "energy kJ", 1e-3, 0],
  ["peak_pressure", "peak bar", 1e-5, 0],
  ["smoothness", "smoothness", 1, 2],
];

const distance = (a, b) => Math.hypot(...a.map((value, k) => value - b[k]));

// from the tip to a position in cylindrical coordinates: outwards [m], up [m], to the left [rad]
export function way(tip, at) {
  const turn = Math.atan2(at[1], at[0]) - Math.atan2(tip[1], tip[0]);
  return [Math.hypot(at[0], at[1]) - Math.hypot(tip[0], tip[1]), at[2] - tip[2], turn - 2 * Math.PI * Math.round(turn / (2 * Math.PI))];
}

export class Attempts {
  // table: of earlier attempts
  constructor(rules, table = []) {
    [this.rules, this.exercise, this.table, this.open] = [rules, rules.exercises[0], table, false];
    this.clear();
  }

  clear() {
    [this.origin, this.started, this.inside, this.reached, this.done, this.now] = [null, null, null, [], [], 0];
    [this.samples, this.kept, this.tip] = [[], false, null];
  }

  show(open) {
    if (open && !this.open) this.clear();
    this.open = open;
  }

  choose(name) {
    this.again();
    this.exercise = this.rules.exercises.find((one) => one.name === name) ?? this.exercise;
  }

  // a new attempt; a started one is kept as unfinished
  again() {
    this.keep();
    this.clear();
  }

  get target() {
    return this.exercise.targets[this.done.length];
  }

  get phase() {
    if (!this.target) return "done";
    if (this.inside !== null) return "holding";
    return this.started === null ? "ready" : "moving";
  }

  // a sample of the machine
  add(t, values) {
    if (!this.open || this.kept) return;
    const pick = (names) => names.map((name) => values[name] ?? NaN);
    const [tip, functions] = [pick(this.rules.tip), pick(this.rules.speeds)];
    const [turning] = pick([this.rules.turning]);
    const speed = Math.hypot(...pick(this.rules.velocities), turning * Math.hypot(tip[0], tip[1]));
    const [pressure, flow] = pick(this.rules.supply);
    const lines = this.rules.pressures.map((name) => values[name]).filter(Number.isFinite);
    this.tip = tip;
    const sample = { t, tip, speed, functions, power: pressure * flow, peak: lines.length ? Math.max(...lines) : NaN };
    if (this.started === null) this.samples = [];
    this.samples.push(sample);
    this.advance(sample);
    if (this.phase === "done") this.keep();
    else if (this.started !== null && t - this.started > LONGEST) this.again();
  }

  advance({ t, tip, speed }) {
    const { radius, slow, hold, start } = this.exercise;
    if (!tip.every(Number.isFinite)) return (this.inside = null);
    [this.origin, this.now] = [this.origin ?? tip, t];
    if (this.started === null) {
      if (distance(tip, this.origin) <= start) return;
      this.started = t;
    }
    const within = distance(tip, this.target.at) <= radius;
    if (within && this.reached.length === this.done.length) this.reached.push(t);
    if (!within || !(speed <= slow)) this.inside = null;
    else if (this.inside === null) this.inside = t;
    if (this.inside === null || t - this.inside < hold - MINUTE) return;
    this.done.push(t);
    this.inside = null;
  }

  keep() {
    if (this.started !== null && !this.kept) {
      this.table.push({ attempt: this.table.length + 1, exercise: this.exercise.name, ...this.score() });
    }
    this.kept = true;
  }

  score() {
    const finished = this.phase === "done";
    const end = finished ? this.done[this.done.length - 1] : this.now;
    const part = this.samples.filter(({ t }) => t >= this.started && t <= end);
    const moving = part.map(({ functions }) => functions.filter((v) => Math.abs(v) > MOVING).length);
    const time = part.map(({ t }) => t);
    const mean = (values) => (time.length < 2 ? 0 : integral(time, values) / (time[time.length - 1] - time[0]));
    const known = (value) => (Number.isFinite(value) ? value : null);
    return {
      finished,
      cycle_time: end - this.started,
      reach_time: this.reached.length ? this.reached[0] - this.started : null,
      path_length: part.slice(1).reduce((sum, { tip }, k) => sum + distance(tip, part[k].tip), 0),
      simultaneous: mean(moving.map((n) => Number(n >= 2))),
      functions: mean(moving) / (mean(moving.map((n) => Number(n >= 1))) || 1),
      energy: known(integral(time, part.map(({ power }) => power))),
      peak_pressure: known(part.reduce((peak, sample) => Math.max(peak, sample.peak), -Infinity)),
      smoothness: smoothness(time, part.map(({ speed }) => speed)),
    };
  }

  // mass that the head holds after the targets that are done [kg]
  get load() {
    return this.open && this.done.length ? this.exercise.targets[this.done.length - 1].load : 0;
  }

  status() {
    const [target, { hold, radius }] = [this.target ?? null, this.exercise];
    return {
      exercise: this.exercise.name, phase: this.phase, target, radius, done: this.done.length,
      way: this.tip && target ? way(this.tip, target.at) : null,
      held: this.inside === null ? 0 : (this.now - this.inside) / hold,
      time: this.started === null ? null : this.now - this.started,
      load: this.load, table: this.table,
    };
  }

  csv() {
    const rows = this.table.map((row) => Object.values(row).map((value) => value ?? "").join());
    return [Object.keys(this.table[0]).join(), ...rows].join("\n") + "\n";
  }
}

const integral = (time, values) =>
  time.slice(1).reduce((sum, t, k) => sum + ((t - time[k]) * (values[k] + values[k + 1])) / 2, 0);

// Spectral arc length of a speed over time; null without motion or with too few samples.
//
//   S = - int_0^w sqrt((1 / w)^2 + (dV / dw)^2) dw,   V(f) = |FFT v(f)| / |FFT v(0)|
//
// w is the largest frequency up to HIGHEST at which V is at least SMALLEST. A single bell-shaped movement has -1.4 to
// -1.6; each further start and stop makes the value more negative. It does not depend on the amplitude of the movement,
// and hardly on its duration. Balasubramanian, Melendez-Calderon, Roby-Brami, Burdet, J. NeuroEng. Rehabil. 12:112, 2015.
export function smoothness(time, speed) {
  const span = time[time.length - 1] - time[0];
  if (!(span >= 5 / RATE)) return null;
  const count = Math.ceil(span * RATE - MINUTE);
  const size = 2 ** (Math.ceil(Math.log2(count)) + PADDING);
  const real = new Float64Array(size);
  for (let k = 0, at = 0; k < count; k++) {
    const t = time[0] + k / RATE;
    while (at < time.length - 2 && time[at + 1] <= t) at++;
    real[k] = speed[at] + ((t - time[at]) / (time[at + 1] - time[at])) * (speed[at + 1] - speed[at]);
  }
  const spectrum = magnitudes(real);
  if (!(spectrum[0] > 0)) return null;
  const heights = [...spectrum.slice(0, Math.floor((HIGHEST * size) / RATE) + 1)].map((value) => value / spectrum[0]);
  const last = heights.findLastIndex((height) => height >= SMALLEST);
  if (last === 0) return null;
  return -heights.slice(1, last + 1).reduce((arc, height, k) => arc + Math.hypot(1 / last, height - heights[k]), 0);
}

// magnitudes of the discrete Fourier transform of a power of two of real values (Cooley and Tukey 1965)
function magnitudes(real) {
  const size = real.length;
  const imaginary = new Float64Array(size);
  for (let k = 1, j = 0; k < size; k++) {
    let bit = size >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (k < j) [real[k], real[j]] = [real[j], real[k]];
  }
  for (let length = 2; length <= size; length *= 2) {
    for (let k = 0; k < length / 2; k++) {
      const [cos, sin] = [Math.cos((-2 * Math.PI * k) / length), Math.sin((-2 * Math.PI * k) / length)];
      for (let a = k; a < size; a += length) {
        const b = a + length / 2;
        const [x, y] = [real[b] * cos - imaginary[b] * sin, real[b] * sin + imaginary[b] * cos];
        [real[b], imaginary[b]] = [real[a] - x, imaginary[a] - y];
        [real[a], imaginary[a]] = [real[a] + x, imaginary[a] + y];
      }
    }
  }
  return real.map((value, k) => Math.hypot(value, imaginary[k]));
}

// ---- what is shown

// rings of the remaining targets
export function rings(rules, { exercise, done, radius }) {
  const { targets } = rules.exercises.find(({ name }) => name === exercise);
  return targets.slice(done).map(({ at }, k) => ({ at, radius, colour: k ? LATER : NEXT, strong: k === 0 }));
}

// a vector to a target in the directions of the sticks
export function directions([out, up, left]) {
  const ends = [["out", "in", out, 2, " m"], ["up", "down", up, 2, " m"], ["left", "right", (left * 180) / Math.PI, 0, "°"]];
  return ends.map(([a, b, value, digits, unit]) => `${value >= 0 ? a : b} ${Math.abs(value).toFixed(digits)}${unit}`).join(", ");
}

// the state of an attempt in one line
export function summary(status) {
  if (status.phase === "done") return `done in ${status.time.toFixed(1)} s`;
  const far = status.way ? `: ${directions(status.way)}` : "";
  const time = status.time === null ? ": the clock starts as you move" : `, ${status.time.toFixed(1)} s`;
  const load = status.load ? ` with ${status.load.toFixed(0)} kg` : "";
  return `${status.target.name}${far}; ${status.phase}${load}${time}`;
}

// an attempt in the units of the table; a dash for a missing figure
export const row = (entry) => [
  `${entry.attempt}${entry.finished ? "" : ", given up"}`,
  ...COLUMNS.map(([key, , factor, digits]) => (entry[key] === null ? "-" : (entry[key] * factor).toFixed(digits))),
];

export class TaskPanel {
  // asked: called with what the operator wants: ("show", bool), ("choose", name), ("again"), ("write")
  constructor(place, rules, asked) {
    [this.place, this.rules, this.asked, this.rows] = [place, rules, asked, ""];
    place.innerHTML = `<div class="hm-line"><select aria-label="Exercise"></select><button type="button">New attempt</button>
      <button type="button" hidden>Write table</button><span role="status"></span></div>
      <progress max="1" aria-label="Held" hidden></progress><div class="hm-table" tabindex="0" hidden><table><thead><tr></tr></thead><tbody></tbody></table></div>`;
    [this.choice, this.head, this.body] = ["select", "thead tr", "tbody"].map((name) => place.querySelector(name));
    [this.line, this.held] = ["[role=status]", "progress"].map((name) => place.querySelector(name));
    [this.again, this.write] = place.querySelectorAll("button");
    this.choice.append(...rules.exercises.map(({ name }) => new Option(name)));
    this.head.append(...["attempt", ...COLUMNS.map(([, text]) => text)].map((textContent) => make("th", { scope: "col", textContent })));
    this.choice.onchange = () => asked("choose", this.choice.value);
    this.again.onclick = () => asked("again");
    this.write.onclick = () => asked("write");
  }

  get open() {
    return !this.place.hidden;
  }

  toggle() {
    this.place.hidden = !this.place.hidden;
    this.asked("show", this.open);
  }

  show(status) {
    if (!status || !this.open) return;
    write(this.line, summary(status));
    if (document.activeElement !== this.choice) this.choice.value = status.exercise;
    this.held.hidden = status.phase !== "holding";
    this.held.value = Math.min(1, status.held);
    const rows = status.table.map(row);
    const key = rows.join(";");
    if (key === this.rows) return;
    this.rows = key;
    this.write.hidden = this.place.querySelector(".hm-table").hidden = !rows.length;
    this.body.replaceChildren(...rows.map((cells) => make("tr", {}, ...cells.map((text) => make("td", {}, text)))));
  }
}

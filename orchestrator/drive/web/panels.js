// Numbers beside the picture: gauges, sliders, and the line of the state. Written to the page directly, a few times a
// second, and only what has changed.

const SPAN = 2000; // ms over which the real-time factor is measured
const MISSED = 0.005; // fraction of missed frames that is still good
const FULL = 0.9; // fraction of the commanded speed that counts as full speed
const LEAST = { low: 0, high: 1e-3, digits: 1 }; // of a bar that grows, in the displayed unit
const DRIVEN = 0.5; // value, 0 to 1, above which a controller drives
export const PRESSURES = { bar: 1e5, MPa: 1e6, psi: 6894.757293168 }; // Pa
const GAUGE_DIGITS = 2; // of an axis in another unit of pressure
export const UNHEARD = "no connection: trying again"; // state of a machine whose server is silent
const TONES = { running: "good", failed: "bad", [UNHEARD]: "bad" };

export const make = (tag, properties = {}, ...children) => {
  const { role, ariaLabel, ...others } = properties; // as attributes, since older browsers lack these properties
  const element = Object.assign(document.createElement(tag), others);
  if (role) element.setAttribute("role", role);
  if (ariaLabel) element.setAttribute("aria-label", ariaLabel);
  element.append(...children);
  return element;
};

export const write = (element, text) => {
  if (element.textContent !== text) element.textContent = text;
};

// colour of a pressure [Pa] on the scale from zero to `full`; grey if it is not finite
export function colour({ scale, unknown, full }, pressure) {
  if (!Number.isFinite(pressure)) return unknown;
  return scale[Math.round(Math.min(1, Math.max(0, pressure / full)) * (scale.length - 1))];
}

// the description of a page with its pressures in another unit: gauges, charts and sliders
export function inPressure(data, unit) {
  const turn = (part) => {
    if (!part.pressure || part.unit === unit) return part;
    const ratio = part.pressure / PRESSURES[unit];
    const to = (value) => value && value * ratio;
    const round = (value) => Number((value * ratio).toPrecision(GAUGE_DIGITS));
    const turned = { ...part, unit, pressure: PRESSURES[unit], factor: to(part.factor), low: to(part.low), high: to(part.high), step: to(part.step) };
    if (part.ends) turned.ends = part.ends.map(round);
    if ("digits" in part) turned.digits = Math.max(0, part.digits - Math.round(Math.log10(ratio)));
    return turned;
  };
  const gauges = data.gauges.map((group) => ({ ...group, lines: group.lines.map(turn) }));
  return { ...data, gauges, charts: data.charts.map(turn), sliders: data.sliders.map(turn) };
}

// a value in the unit of its gauge, begin and end of the bar as fractions of its length, and a warning or empty
export function figure(gauge, value, cavitation, values = {}) {
  const share = (shown) => Math.min(1, Math.max(0, (shown - gauge.low) / (gauge.high - gauge.low)));
  const shown = value * gauge.factor;
  if (!Number.isFinite(shown)) return { text: "–", begin: share(0), end: share(0), warning: "" };
  const [begin, end] = [share(0), share(shown)].sort((a, b) => a - b);
  const text = shown.toFixed(gauge.digits).replace(/^-(?=0(\.0*)?$)/, "").replace("-", "−");
  const [told = ""] = notices(gauge.told ?? [], values);
  return { text, begin, end, warning: gauge.pressure && value * (gauge.si ?? 1) < cavitation ? "cavitates" : told };
}

// Ends of a bar that grows: all values so far are between them. From zero, until one is negative, to 1, 2 or 5 times a
// power of ten; so many digits that three count.
export function grown(ends, shown) {
  if (!Number.isFinite(shown) || (shown <= ends.high && shown >= ends.low)) return ends;
  const peak = Math.max(ends.high, Math.abs(shown));
  const power = 10 ** Math.floor(Math.log10(peak));
  const high = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= peak * (1 - 1e-9));
  return { low: ends.low < 0 || shown < 0 ? -high : 0, high, digits: Math.max(0, 2 - Math.floor(Math.log10(high))) };
}

export class Gauges {
  // onunit: called with another unit of pressure
  constructor(place, data, names, unit, onunit) {
    [this.data, this.lines] = [data, []];
    place.replaceChildren();
    for (const { title, lines } of data.gauges) {
      const present = lines.filter((line) => names.has(line.name));
      if (!present.length) continue;
      const heading = make("p", { className: "hm-title", textContent: title });
      place.append(make("div", { className: "hm-group" }, heading, ...present.map((line) => this.line(line))));
    }
    if (!this.lines.some(({ gauge }) => gauge.pressure)) return;
    const bar = make("div", { style: `background: linear-gradient(to right, ${data.scale.join()})` });
    const choice = make("select", { ariaLabel: "Unit of pressure" }, ...Object.keys(PRESSURES).map((textContent) => make("option", { textContent })));
    choice.value = unit;
    choice.addEventListener("change", () => onunit(choice.value));
    const full = make("span", {}, `${Math.round(data.full / PRESSURES[unit])} `, choice);
    if (data.scene) place.append(make("div", { className: "hm-legend" }, bar, make("span", { textContent: "0" }), make("span", { textContent: "chamber pressure" }), full));
    else place.append(make("label", { className: "hm-legend" }, make("span", { textContent: "pressure in" }), choice));
  }

  line(gauge) {
    const [bar, output] = [make("i"), make("output", { textContent: "–" })];
    const unit = make("small", { textContent: gauge.unit });
    const zero = make("b");
    const track = make("div", { className: "hm-track" }, bar, zero);
    const row = make("div", { className: "hm-gauge" }, make("span", { textContent: gauge.text, title: gauge.text }), track, output, unit);
    const line = { gauge, bar, output, unit, row, zero };
    this.fit(line, gauge.high === null ? LEAST : gauge);
    this.lines.push(line);
    return row;
  }

  fit(line, ends) {
    if (ends === line.ends) return;
    const { low, high } = (line.ends = ends);
    line.zero.hidden = low >= 0;
    line.zero.style.left = `${(-100 * low) / (high - low)}%`;
  }

  show(values) {
    for (const line of this.lines) {
      const { gauge, bar, output, unit, row } = line;
      const value = values[gauge.name] ?? NaN;
      if (gauge.high === null) this.fit(line, grown(line.ends, value * gauge.factor));
      const { text, begin, end, warning } = figure({ ...gauge, ...line.ends }, value, this.data.cavitation, values);
      write(output, text);
      bar.style.transform = `translateX(${(100 * begin).toFixed(1)}%) scaleX(${(end - begin).toFixed(3)})`;
      row.classList.toggle("hm-warned", Boolean(warning));
      write(unit, warning || gauge.unit);
      if (gauge.pressure) bar.style.background = colour(this.data, value * gauge.si);
    }
  }
}

// inputs and parameters that are set; they follow the machine unless they are held
export class Sliders {
  // set: called with name and value [SI]; input: value of an input by name, or undefined
  constructor(place, sliders, set, input) {
    this.input = input;
    this.lines = sliders.map((slider) => this.line(slider, set));
    place.replaceChildren(...this.lines.map(({ row }) => row));
    place.hidden = !sliders.length;
  }

  line({ name, text, unit, low, high, step, start, factor }, set) {
    const field = make("input", { type: "range", min: low, max: high, step });
    const output = make("output");
    const digits = Math.max(0, Math.ceil(-Math.log10(step)));
    const row = make("label", { className: "hm-slider" }, make("span", { textContent: text, title: text }), field, output);
    const line = { name, field, row, touched: -Infinity };
    line.show = (value) => {
      field.value = value;
      write(output, `${value.toFixed(digits)} ${unit === "1" ? "" : unit}`);
    };
    line.follow = (value) => line.show(value * factor);
    line.show(start * factor);
    field.addEventListener("input", () => {
      line.touched = performance.now();
      line.show(Number(field.value));
      set(name, Number(field.value) / factor);
    });
    return line;
  }

  // the input goes to the value with its own rate, and through a network
  show() {
    for (const { name, field, follow, touched } of this.lines) {
      const value = this.input(name);
      if (Number.isFinite(value) && performance.now() - touched > 1000 && !field.matches(":active")) follow(value);
    }
  }

  get disabled() {
    return this.lines.some(({ field }) => field.disabled);
  }

  set disabled(on) {
    for (const { field } of this.lines) field.disabled = on;
  }
}

// simulated over real time, over the last two seconds in which the machine ran
export class Pace {
  constructor(now = () => performance.now()) {
    [this.now, this.seen, this.motion] = [now, [], ""];
  }

  // motion: another one, as after a jump or at another speed, is measured anew
  // at: when t was heard, in ms
  look(t, running, motion = "", at = this.now()) {
    if (!running || motion !== this.motion || (this.seen.length && t < this.seen[this.seen.length - 1][1])) this.seen = [];
    this.motion = motion;
    if (running) this.seen.push([at, t]);
    while (this.seen.length && at - this.seen[0][0] > SPAN) this.seen.shift();
  }

  get factor() {
    const [[begin, from], [end, to]] = [this.seen[0] ?? [0, 0], this.seen[this.seen.length - 1] ?? [0, 0]];
    return end - begin < SPAN / 4 ? null : (1e3 * (to - from)) / (end - begin);
  }
}

// why the machine is slower than commanded, as `Slowed` of view_description.py; empty if it is not, or is off
export function limit({ share, driven, uses, otherwise }, values) {
  if (!(values[share] < FULL && values[driven] > DRIVEN)) return "";
  const used = Object.entries(uses).map(([name, text]) => [values[name], text]);
  const [use, text] = used.reduce((a, b) => (a[0] > b[0] ? a : b));
  return use <= 1 ? otherwise : text;
}

// texts of the notices whose signal is above its value
export const notices = (described, values) =>
  described.filter(({ name, above }) => Math.abs(values[name]) > above).map(({ text }) => text);

// cells of the line: name, text, tone
export function cells({ state, time, factor, values, slowed, drives, timing, able, message }) {
  const shown = drives || state !== "running" ? state : "replaying";
  const line = [["", shown, TONES[state] ?? "watch"], ["t", `${time.toFixed(1)} s`, ""]];
  line.push(["real time", factor === null ? "–" : `× ${factor.toFixed(2)}`, ""]);
  const held = slowed && limit(slowed, values);
  if (held) line.push([slowed.title, held, "watch"]);
  if (able) line.push(["", able, ""]);
  if (drives && timing?.frames) {
    const fraction = timing.missed / timing.frames;
    const [median, most, worst] = timing.latency.map((seconds) => (1e3 * seconds).toFixed(1));
    line.push(["missed", `${timing.missed} of ${timing.frames} (${(100 * fraction).toFixed(2)} %)`, fraction < MISSED ? "good" : "bad"]);
    line.push(["latency", `${median} ms, 99 % ${most}, worst ${worst}`, ""], ["load", `${(100 * timing.load).toFixed(0)} %`, ""]);
  }
  return message ? [...line, ["", message, "bad"]] : line;
}

export class StatusLine {
  constructor(place) {
    this.place = place;
  }

  show(state) {
    const found = cells(state);
    while (this.place.children.length > found.length) this.place.lastChild.remove();
    found.forEach(([name, text, tone], k) => {
      if (!this.place.children[k]) this.place.append(make("span", {}, make("small"), make("b")));
      const cell = this.place.children[k];
      write(cell.firstChild, name);
      write(cell.lastChild, text);
      if (cell.className !== tone) cell.className = tone;
    });
  }
}

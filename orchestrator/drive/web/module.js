// Source: the whole machine in this browser, its FMU as a WebAssembly module. Frames of 10 ms, in which the inputs
// are linear, as a scenario of `harvester run` has them. It is driven, or plays the program of its reference experiment.
import { History } from "drive/charts.js";
import { Fmu } from "drive/fmu.js";
import { functions } from "drive/levers.js";
import { sample } from "drive/recording.js";
import { Attempts } from "drive/task.js";

const BUDGET = 24; // ms of simulation for one picture; beyond it the machine is slower than real time
const BIN = 0.1; // s, of the charts; two points each, of about a pixel
const LONGEST = 60000; // frames of saved commands, 10 min

// a word of a command for a shell
const quoted = (word) => (/^[\w./=+-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

export class Simulation {
  constructor(fmu, data) {
    [this.fmu, this.data, this.axes] = [fmu, data, data.axes];
    this.names = this.axes.map((axis) => axis.name);
    this.sloped = this.axes.map((axis, k) => k).filter((k) => this.axes[k].slope);
    this.inputs = fmu.group([...this.names, ...this.sloped.map((k) => this.axes[k].slope)]);
    this.outputs = fmu.group(data.outputs);
    this.buffer = new Float64Array(this.inputs.count);
    this.goal = this.axes.map((axis) => axis.start); // of the sliders
    this.parameters = {};
    this.begin();
  }

  // from rest, at these initial angles by name
  begin(angles = {}) {
    this.fmu.reset();
    this.now = this.axes.map((axis, k) => (axis.limit === null ? this.goal[k] : axis.start));
    const inputs = Object.fromEntries(this.names.map((name, k) => [name, this.now[k]]));
    this.begun = { ...this.parameters, ...angles };
    this.fmu.start({ ...this.begun, ...inputs });
    [this.frames, this.lost, this.cost] = [0, "", 0]; // lost: why a scenario does not repeat the drive
    this.rows = [[0, ...this.now]];
  }

  get time() {
    return this.frames * this.data.frame;
  }

  // commanded: axis -> value; the others follow their slider. exactly: without the limit of the rate
  frame(commanded, exactly = false) {
    const began = performance.now();
    const [from, steps, h] = [this.now, Math.round(this.data.frame / this.data.step), this.data.step];
    const to = this.axes.map((axis, k) => this.toward(axis, from[k], commanded[axis.name] ?? this.goal[k], exactly));
    const [begin, end] = [this.time, (this.frames + 1) * this.data.frame];
    const slopes = to.map((value, k) => (value - from[k]) / (end - begin));
    const at = (k, t) => from[k] + (t - begin) * slopes[k];
    for (let n = 0; n < steps; n++) {
      const [t, next] = [(this.frames * steps + n) * h, (this.frames * steps + n + 1) * h];
      // an input without one for its slope has its mean over the step
      this.axes.forEach((axis, k) => (this.buffer[k] = axis.slope ? at(k, t) : 0.5 * (at(k, t) + at(k, next))));
      this.sloped.forEach((k, j) => (this.buffer[from.length + j] = (at(k, next) - at(k, t)) / (next - t)));
      this.fmu.time = t;
      this.fmu.set(this.inputs, this.buffer);
      this.fmu.step(next - t);
    }
    this.now = to;
    // sliders go on from what the program has set
    if (exactly) this.axes.forEach((axis, k) => (axis.limit === null) && (this.goal[k] = to[k]));
    this.frames += 1;
    if (this.rows.length < LONGEST) this.rows.push([this.time, ...to]);
    else this.lost = "a drive of more than 10 minutes is not kept";
    this.cost += performance.now() - began;
  }

  toward(axis, now, goal, exactly) {
    const limited = axis.limit === null ? goal : Math.max(-axis.limit, Math.min(axis.limit, goal));
    const reach = exactly ? Infinity : axis.rate * this.data.frame;
    return now + Math.max(-reach, Math.min(reach, limited - now));
  }

  // a slider: an input, or a tunable parameter
  slide(name, value) {
    const k = this.names.indexOf(name);
    if (k >= 0) this.goal[k] = value;
    else {
      this.parameters[name] = value;
      this.fmu.set(this.fmu.group([name]), [value]);
      if (this.frames) this.lost = `${name} was changed during the drive, and a scenario has no parameters: start again`;
      else this.begun[name] = value;
    }
  }

  values() {
    const numbers = this.fmu.get(this.outputs);
    return Object.fromEntries(this.data.outputs.map((name, k) => [name, numbers[k]]));
  }

  // a scenario for `harvester run`
  csv() {
    return [["time", ...this.names].join(), ...this.rows.map((row) => row.join())].join("\n") + "\n";
  }

  // the command that repeats the drive with this scenario
  command(scenario) {
    const sets = Object.entries(this.begun).flatMap(([name, value]) => ["--set", `${this.data.component}.${name}=${value}`]);
    return ["harvester", "run", this.data.file, "--scenario", scenario, ...sets].map(quoted).join(" ");
  }
}

export class ModuleSource {
  shared = false;

  static async load(bytes, data, log) {
    return new ModuleSource(new Simulation(await Fmu.load(bytes, data.fmu, log), data.fmu), data);
  }

  constructor(simulation, data) {
    [this.simulation, this.data, this.fmu] = [simulation, data, data.fmu];
    this.names = new Set(this.fmu.outputs);
    this.history = new History(data.charts, BIN);
    this.task = new Attempts(data.task);
    [this.program, this.jumps, this.due, this.carried] = [Boolean(this.fmu.program), 0, 0, 0];
    [this.pattern, this.mode, this.drives] = [Object.keys(data.patterns)[0] ?? "", this.fmu.mode, true];
    this.read();
  }

  get time() {
    return this.simulation.time;
  }

  read() {
    this.values = this.simulation.values();
  }

  begin(angles = {}) {
    this.task.again();
    this.carry();
    this.simulation.begin(angles);
    this.history.clear();
    [this.jumps, this.due] = [this.jumps + 1, 0];
    this.read();
  }

  // `seconds` of simulated time; read: deflections of the sticks after a time [s]
  advance(seconds, read) {
    const end = performance.now() + BUDGET;
    this.due += seconds;
    while (this.due >= this.fmu.frame && performance.now() < end) {
      this.frame(read);
      this.due -= this.fmu.frame;
    }
    if (this.due > 2 * this.fmu.frame) this.due = 0; // slower than real time
    this.read();
  }

  frame(read) {
    const program = this.program && this.fmu.program;
    if (program && this.time >= program.time[program.time.length - 1]) this.begin();
    const next = (this.simulation.frames + 1) * this.fmu.frame;
    this.simulation.frame(program ? sample(program, next) : this.commanded(read(this.fmu.frame)), Boolean(program));
    const values = this.simulation.values();
    this.history.add(this.time, values);
    if (program) return;
    this.task.add(this.time, values);
    this.carry();
  }

  // what the task holds in the head, when that changes: the slider moves it, too
  carry() {
    const { load } = this.task;
    if (load === this.carried) return;
    this.carried = load;
    this.set(this.data.task.load, load);
  }

  commanded(sticks) {
    const pattern = this.data.patterns[this.pattern];
    const wanted = pattern ? functions(sticks, pattern, this.data.curve) : {};
    const driven = Object.entries(this.fmu.full).flatMap(([name, inputs]) =>
      Object.entries(inputs).map(([input, full]) => [input, full * (wanted[name] ?? 0)]));
    return Object.fromEntries(driven);
  }

  set(name, value) {
    if (name in this.fmu.variables) this.simulation.slide(name, value);
  }

  // sliders with their start values
  get sliders() {
    return this.data.sliders.filter(({ name }) => name in this.fmu.sliders).map((one) => ({ ...one, start: this.fmu.sliders[one.name] }));
  }

  // the value of an input that a slider follows, or undefined
  input(name) {
    const k = this.simulation.names.indexOf(name);
    return k < 0 ? undefined : this.simulation.now[k];
  }

  curves() {
    return this.history.curves(this.time);
  }

  get able() {
    const { cost, time } = this.simulation;
    return time > 1 ? `the FMU could do × ${Number(((1e3 * time) / cost).toPrecision(2))}` : "";
  }
}

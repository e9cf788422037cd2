// The page on which one drives: one section, whatever its source. A source has
//
//   names, values, time      its signals, their values in SI units now, the simulated time
//   jumps                    counts up where the motion does not go on from before
//   curves()                 the last seconds for the charts: { time: relative to now, columns }
//   span, seek(t)            of a recording: its first and last time
//   drives                   whether it can be driven; then pattern, mode, sliders, input(name), set(name, value)
//   shared                   a machine that others see, too: the controls have to be taken, a dead-man held
//
// and a source of this browser `advance(seconds, read)` and `begin(angles)`, which the page calls.
import { Charts } from "drive/charts.js";
import { Findings } from "drive/findings.js";
import { Levers, WHEEL_BUTTONS, WHEEL_KEYS, elsewhere, readGamepad } from "drive/levers.js";
import { Gauges, Pace, Sliders, StatusLine, UNHEARD, colour, inPressure, make, notices, write } from "drive/panels.js";
import { Scene } from "drive/scene.js";
import { TaskPanel, rings } from "drive/task.js";

const PANELS = 100; // ms between two updates of numbers and charts
const BEAT = 30; // ms between two looks at the hands
const TOLD = 2500; // ms that a word about a key without controls stays
const SAID = 8000; // ms that an answer of the server stays
const KEPT = 60000; // ms that the name of a file stays
const REST = [0, 0, 0, 0];
const TITLES = { program: "demonstration", drive: "you drive", replay: "replay of the run" };
const STANDING = { // banner for each state in which a shared machine does not move
  starting: "starting", paused: "paused: press P to continue",
  failed: "press Home to start again",
};
const TOUCH = [ // words about keys, and those for fingers
  [/hold Space.*arrows/, "drag a stick"], [/release Space, then hold it again/, "let go, then drag a stick"],
  [/press P/, 'press "Go on"'], [/press Home/, 'press "Start again"'],
];
const TAKE = { driving: "Release controls", watching: "Request controls", free: "Take controls" };
const KEYS = [
  ["Space or Shift, held", "dead-man: the machine rests without it", "shared", "sticks"],
  ["W A S D", "left stick", "sticks"], ["Arrows or I J K L", "right stick", "sticks"],
  [(wheels) => WHEEL_KEYS.slice(0, wheels).map((pair) => pair.join(" ")).join(", "), "thumb wheels, in their order on the page", "wheels"],
  ["P", "pause or go on"], ["Home", "start again"],
  ["Esc", "from a button or field back to the sticks", "shared", "sticks"],
  ["Esc", "from a button or field to the picture, and from the picture to the page", "own"],
  ["Gamepad", "both sticks; a bumper is the dead-man", "sticks"],
  [(wheels) => `Gamepad: ${WHEEL_BUTTONS.slice(0, wheels).join(", ")}`, "thumb wheels, in the same order", "wheels"],
  ["Touch or mouse", "drag the sticks; holding one is the dead-man", "sticks"],
  ["Drag in the picture", "rotate the view", "picture"], ["Wheel", "zoom", "shared", "picture"],
  ["Right button, drag", "shift the view", "picture"],
]; // and what there must be
const HOW = "Take the controls, hold the dead-man, then move a stick. Release the dead-man and the machine rests.";

export class Page {
  // sources of this browser by mode, "replay" or "drive"; or the one of a server
  constructor(root, data, sources) {
    [this.root, this.data, this.sources] = [root, data, sources];
    this.at = (name) => root.querySelector(`.hm-${name}`);
    this.shared = Boolean(sources.live);
    [this.running, this.pace, this.line] = [false, new Pace(), new StatusLine(this.at("cells"))];
    this.unit = "bar"; // of pressures
    this.onlost = () => {}; // of a dialog that waits for an answer
    [this.refused, this.said, this.jumped, this.slowed] = [-Infinity, 0, -1, false];
    for (const one of root.querySelectorAll(this.shared ? ".hm-own" : ".hm-shared")) one.hidden = true;
    root.classList.toggle("hm-full", this.shared || Boolean(data.alone));
    this.levers = new Levers(root.querySelectorAll(".hm-stick"), this.at("wheels"), this.shared, () => this.drives, () => this.pressed(), () => this.focus());
    this.controls();
    if (this.shared) this.connect(sources.live);
    else this.embed();
    this.watch();
  }

  // ---- the machine that is shown

  // names: signals of its sources
  fit(data, names) {
    // after an interruption of the connection it is the same machine: the view stays
    const drawing = JSON.stringify(data.scene);
    if (drawing !== this.drawing) [this.drawing] = [drawing, this.draw(data.scene)];
    this.data = data;
    this.numbers(names);
    this.findings = new Findings(this.at("findings"), data.findings ?? [], data.forget, (name, value) => this.source.set(name, value));
    const driven = this.sources.drive ?? this.sources.live;
    const scored = (driven ?? this.sources.replay).task && data.scene && data.task.needed.length && data.task.needed.every((name) => names.has(name));
    this.at("training").hidden = !scored;
    if (scored && JSON.stringify(data.task) !== JSON.stringify(this.task?.rules)) this.task = new TaskPanel(this.at("task"), data.task, (what, value) => this.asked(what, value));
    this.jumped = -1;
  }

  // gauges, charts and sliders, with pressures in the unit that is chosen
  numbers(names) {
    const [driven, data] = [this.sources.drive ?? this.sources.live, inPressure(this.data, this.unit)];
    const choose = (unit) => {
      this.unit = unit;
      this.numbers(names);
      this.panels();
      this.at("panel").querySelector("select").focus();
    };
    this.gauges = new Gauges(this.at("panel"), data, names, this.unit, choose);
    this.charts?.close();
    this.charts = new Charts(this.at("charts"), data.charts, names);
    const { sliders } = driven ? inPressure({ ...data, sliders: driven.sliders }, this.unit) : {};
    this.sliders = driven && new Sliders(this.at("sliders"), sliders, (name, value) => this.slide(name, value), (name) => driven.input(name));
  }

  // the picture of a machine, with its views; without WebGL the page is that of a machine that has none
  draw(scene) {
    this.scene?.close();
    [this.scene, this.blind] = [null, ""];
    try {
      this.scene = scene && new Scene(this.at("stage"), { ...scene }, Boolean(this.sources.replay?.ghost));
    } catch (problem) {
      this.blind = `no picture: ${problem.message}`;
      console.warn(problem.message);
    }
    this.root.classList.toggle("hm-flat", !this.scene);
    this.at("looks").replaceChildren(...(this.scene?.views ?? []).map((name) =>
      make("button", { type: "button", textContent: name, onclick: () => this.scene.look(name) })));
  }

  embed() {
    const { replay, drive } = this.sources;
    this.fit(this.data, (drive ?? replay).names);
    this.scene?.embed();
    const keys = drive ? "Drive it with W A S D and the arrow keys; P pauses, Home starts again, Escape leaves." : "P pauses, Home starts again.";
    this.at("stage").setAttribute("aria-label", `The machine in space. ${keys}`);
    this.choose(replay ? "replay" : drive.program ? "program" : "drive");
    this.at("modes").hidden = false;
    for (const button of this.root.querySelectorAll("[data-mode]")) {
      const mode = button.dataset.mode;
      if (!(mode === "program" ? drive?.program : this.sources[mode])) button.remove();
      button.addEventListener("click", () => (this.choose(mode), this.run(true), this.focus()));
    }
    for (const name of ["hands", "save"]) this.at(name).hidden = !drive;
    [this.at("begin").disabled, this.at("begin").hidden] = [false, false];
    if (!drive) return this.ready();
    const poses = ["", ...Object.keys(this.data.fmu.poses)];
    this.at("pose").append(...poses.map((name) => make("option", { value: name, textContent: name || "as shipped" })));
    this.at("about").textContent = `${this.data.fmu.file}, with the parameter values of that file: its C code runs in this page, as WebAssembly.`;
    this.ready();
  }

  connect(source) {
    [this.source, this.mode] = [source, "live"];
    for (const name of ["hands", "save", "more"]) this.at(name).hidden = false;
    source.onhello = () => {
      this.fit(source.data, source.names);
      document.title = source.data.title;
      this.ready();
    };
    source.onframe = () => this.present();
    source.oninfo = () => this.panels();
    source.onstatus = () => this.told();
    source.onlate = () => this.slow();
    source.onanswer = (answer) => this.answer(answer);
    this.beaten = performance.now();
    setInterval(() => this.beat(), BEAT);
  }

  ready() {
    this.present(true);
    this.root.dataset.ready = "true";
  }

  // ---- controls

  controls() {
    this.at("begin").addEventListener("click", () => (this.failed ? this.again() : this.run(true), this.focus()));
    this.at("pause").addEventListener("click", () => this.toggle());
    this.at("again").addEventListener("click", () => this.again());
    this.at("speed").addEventListener("change", () => this.shared && this.source.do("speed", { factor: Number(this.at("speed").value) }));
    this.at("seek").addEventListener("input", () => this.seek(Number(this.at("seek").value)));
    this.at("pose").addEventListener("change", () => (this.choose("drive"), this.again()));
    this.at("save").addEventListener("click", () => (this.shared ? this.source.do("save") : this.keep()));
    this.at("training").addEventListener("click", () => {
      this.task.toggle();
      this.at("training").setAttribute("aria-expanded", String(this.task.open));
      this.panels();
    });
    this.at("take").addEventListener("click", () => this.source.do(this.source.driving ? "release" : "take"));
    this.at("help").addEventListener("click", () => this.help());
    this.at("stage").addEventListener("pointerdown", () => this.focus());
    (this.shared ? document : this.root).addEventListener("keydown", (event) => this.key(event));
    // after a click with the mouse the keys belong to the sticks again; after one by keyboard they stay there
    const opened = () => document.querySelector("dialog[open]");
    const clicked = ({ target, detail }) => {
      const field = document.activeElement?.matches("input,textarea,select,[contenteditable]");
      if (detail > 0 && this.steered(target) && !field && !opened()) this.focus();
    };
    document.addEventListener("click", (event) => (opened() ? setTimeout(clicked, 0, event) : clicked(event))); // it may close
    for (const name of ["pointerdown", "keydown"]) this.at("pose").addEventListener(name, () => (this.pointed = name === "pointerdown"));
    this.at("pose").addEventListener("change", () => this.pointed && this.focus());
    this.levers.onrelease = () => this.shared && this.source.driving && this.source.steer({ sticks: REST, deadMan: false });
  }

  // whether a click there is one of the driver: of a machine of one's own, on a button of its section
  steered(target) {
    if (this.shared) return this.source.driving;
    return Boolean(this.sources.drive) && this.root.contains(target) && target.closest("button") !== null;
  }

  // the window with the keys of what there is
  help() {
    const sticks = Object.keys(this.data?.legends ?? {}).length > 0;
    const is = { shared: this.shared, own: !this.shared, sticks, wheels: this.levers.screen.length - 2, picture: Boolean(this.scene) };
    const meant = KEYS.filter(([, , ...needs]) => needs.every((one) => is[one]));
    this.at("list").replaceChildren(...meant.flatMap(([key, meaning]) => [make("dt", { textContent: key.call ? key(is.wheels) : key }), make("dd", { textContent: meaning })]));
    this.at("how").textContent = this.shared && sticks ? HOW : "";
    this.at("window").showModal();
  }

  // whether keys move the sticks now
  get drives() {
    if (this.shared) return this.source?.driving ?? false;
    return Boolean(this.sources.drive) && document.activeElement === this.at("stage");
  }

  // a key or a stick on the screen
  pressed() {
    if (this.shared) {
      if (!this.source.driving) this.refuse();
    } else if (this.drives) this.take();
  }

  // the page does not drive: the button that is missing shows itself
  refuse() {
    if (!this.source.alive) return;
    this.refused = performance.now();
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
    this.at("take").animate([{ opacity: 1 }, { opacity: 0.15 }, { opacity: 1 }], { duration: 300, iterations: 3 });
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
    if (event.target.closest?.("dialog")) return;
    if (event.code === "Escape") return this.escape(event.target);
    if (event.target.closest?.("input:not([type=range]), textarea, select")) return;
    const inside = this.shared || event.target === this.at("stage");
    const does = { KeyP: () => this.toggle(), Home: () => this.again(), Space: this.shared ? null : () => this.run(true) }[event.code];
    if (!does || !inside || (event.code === "Home" && event.target.matches("input"))) return;
    event.preventDefault(); // no scrolling
    does();
  }

  escape(target) {
    if (!this.shared && target === this.at("stage")) target.blur();
    else if (!this.shared || this.source.driving) this.focus();
  }

  focus() {
    this.at("stage").focus({ preventScroll: true });
  }

  slide(name, value) {
    (this.sources.drive ?? this.source).set(name, value);
    if (this.mode === "replay") this.choose("drive");
  }

  pattern(name) {
    if (this.shared) return this.source.do("choose", { pattern: name });
    this.sources.drive.pattern = name;
    this.panels();
  }

  // of the training task
  asked(what, value) {
    const source = this.sources.drive ?? this.source;
    const { task } = source;
    if (what === "show") [task.show(value), this.sources.drive && this.mode !== "drive" && this.choose("drive")];
    if (what === "choose") task.choose(value);
    if (what === "again") task.again();
    if (what === "write") download("training.csv", task.csv());
    source.carry();
  }

  // ---- sources of this browser

  // the visitor drives from now on, from where the machine is
  take() {
    if (this.mode === "replay") {
      const angles = this.angles(this.source.values, this.data.initial);
      this.choose("drive", Object.fromEntries(Object.entries(this.data.fmu.initial).map(([name, k]) => [name, angles[k]])));
    } else if (this.mode === "program") this.choose("drive", null);
    this.run(true);
  }

  // angles: of the start; null: go on from here
  choose(mode, angles = {}) {
    const before = this.mode;
    [this.mode, this.source] = [mode, this.sources[mode === "replay" ? "replay" : "drive"]];
    if (mode === "replay" && this.failed) [this.failed, this.at("said").textContent] = [false, ""];
    if (mode !== "replay") this.source.program = mode === "program";
    for (const button of this.root.querySelectorAll("[data-mode]")) button.setAttribute("aria-pressed", String(button.dataset.mode === mode));
    this.root.classList.toggle("hm-driving", mode === "drive"); // a page may give it more room
    if (mode === "drive" && before && before !== mode) this.root.scrollIntoView({ block: "nearest" });
    this.at("time").hidden = this.at("ghost").hidden = mode !== "replay";
    this.at("ghost").hidden ||= !this.source.ghost;
    this.at("pose-choice").hidden = mode === "replay" || Object.keys(this.data.fmu.poses).length === 0;
    const goes = mode === "replay" || angles === null || before === mode || (before === "program" && mode === "drive");
    if (!goes) this.source.begin(angles);
    this.present(!goes || mode === "replay");
  }

  again() {
    if (this.shared) return this.source.do("again");
    [this.failed, this.at("said").textContent] = [false, ""];
    this.source.begin(this.mode === "drive" ? (this.data.fmu.poses[this.at("pose").value] ?? {}) : {});
    this.run(true);
    this.present(true);
  }

  toggle() {
    if (this.shared) this.source.do("toggle");
    else this.run(!this.running);
  }

  seek(share) {
    const [first, last] = this.source.span;
    this.source.seek(first + share * (last - first));
    this.present(true);
  }

  run(on) {
    if (on && this.failed) return;
    if (on && !this.running) {
      this.last = performance.now();
      requestAnimationFrame((now) => this.tick(now));
    }
    this.running = on;
    this.at("begin").hidden = on;
    this.at("begin").textContent = this.began ? "Continue" : "Start";
    this.began ||= on;
    if (!on) this.levers.letGo();
    this.panels();
  }

  tick(now) {
    if (!this.running) return;
    const seconds = (Math.min(Math.max(now - this.last, 0), 100) / 1000) * Number(this.at("speed").value);
    this.last = now;
    try {
      this.source.advance(seconds, (time) => this.levers.read(time).sticks);
      if (this.mode !== "drive") this.gamepad(seconds);
      this.present();
    } catch (problem) {
      return this.fail(problem);
    }
    requestAnimationFrame((next) => this.tick(next));
  }

  // a gamepad whose dead-man is pressed starts a page that waits; seen: whether the machine is in sight
  watchPad(seen) {
    const { deadMan, note } = readGamepad();
    write(this.at("note"), note);
    if (seen && deadMan && this.padFree && !this.running) this.run(true);
    this.padFree = !deadMan && document.hasFocus();
  }

  // a gamepad takes over, as a key does
  gamepad(seconds) {
    const { sticks, deadMan } = this.levers.read(seconds);
    if (this.sources.drive && deadMan && sticks.some(Boolean)) this.take();
  }

  fail(problem) {
    [this.running, this.failed] = [false, true];
    this.answer({ text: problem.message, bad: true });
    [this.at("begin").hidden, this.at("begin").textContent] = [false, "Start again"];
    this.panels();
    console.error(problem);
  }

  // ---- a source that is shared

  // the hands, and what the page says of them
  beat() {
    const now = performance.now();
    const hands = this.levers.read(Math.min(0.1, (now - this.beaten) / 1000));
    this.beaten = now;
    const { driving, live, alive } = this.source;
    this.source.steer(hands);
    if (alive !== this.alive) this.connection(alive);
    this.levers.show(driving ? hands.sticks : REST, live);
    const lamp = this.at("lamp").classList;
    lamp.toggle("hm-held", driving && hands.deadMan);
    lamp.toggle("hm-live", live);
    write(this.at("state"), worded(this.describe()));
    write(this.at("note"), this.levers.note);
    this.forget();
  }

  // what was said, after its time
  forget() {
    if (this.said && performance.now() > this.said && !this.failed) [this.said, this.at("said").textContent] = [0, ""];
  }

  // the server is heard again, or no more: without it the toolbar does nothing
  connection(alive) {
    this.alive = alive;
    if (!alive && document.activeElement?.closest(".hm-bar, .hm-hands")) this.focus();
    for (const one of this.at("bar").querySelectorAll("button:not(.hm-help), input, select")) one.disabled = !alive;
    this.told();
    this.panels();
    if (!alive) this.onlost();
  }

  describe() {
    const { status, alive, late, lost } = this.source;
    if (!alive) return "no connection";
    const refused = performance.now() - this.refused < TOLD;
    if (status.role === "watching") return `another page drives${refused ? ': press "Request controls"' : ""}`;
    if (status.role === "free" && refused) return 'press "Take controls" first';
    if (status.role === "free") return lost ? "the connection was lost: take the controls again" : status.why;
    if (status.mode && !touched() && elsewhere(document.activeElement)) return "Esc: back to the sticks";
    if (late) return "too slow: release Space, then hold it again";
    return status.live ? "driving" : status.why;
  }

  told() {
    const { status, alive, driving } = this.source;
    if (status.role === "driving" && this.role !== "driving") [this.levers.letGo(), this.focus()];
    this.role = status.role;
    write(this.at("take"), TAKE[status.role]);
    this.at("take").disabled = !alive || !(status.modes.length || this.source.data?.inputs.length);
    write(this.at("asked"), status.asked && status.role === "driving" ? "another page requests the controls" : "");
    if (this.sliders) this.sliders.disabled = !driving;
    if (this.source.data) this.choices();
  }

  // the drive as a file, and how to repeat it
  keep() {
    const { simulation } = this.source;
    if (simulation.lost) return this.answer({ text: simulation.lost, bad: true });
    download("drive.csv", simulation.csv());
    this.answer({ text: `the same drive: ${simulation.command("drive.csv")}`, stays: KEPT });
  }

  // to an action: a line, for how many ms, and a file of the server to keep
  answer({ text, bad, href, stays = href ? KEPT : SAID }) {
    this.at("said").textContent = text;
    this.at("said").classList.toggle("hm-bad", Boolean(bad));
    this.said = performance.now() + stays;
    if (href) make("a", { href, download: "" }).click();
  }

  // a driver needs the sticks more than trees and charts
  slow() {
    this.slowed = true;
    this.scene?.brush.plain();
  }

  // ---- what is seen

  angles(values, otherwise) {
    return this.data.joints.map((name, k) => (Number.isFinite(values[name]) ? values[name] : otherwise[k]));
  }

  present(again = false) {
    const { source } = this;
    again ||= source.jumps !== this.jumped;
    this.jumped = source.jumps;
    if (this.scene) {
      const angles = this.angles(source.values, this.data.initial);
      const colours = Object.entries(this.data.pressures).map(([part, name]) => [part, colour(this.data, source.values[name])]);
      this.scene.show(angles, Object.fromEntries(colours), again, source.reference && this.angles(source.reference, angles));
    }
    if (again || (!this.shared && performance.now() - (this.shown ?? 0) > PANELS)) this.panels();
  }

  get state() {
    if (this.shared) return this.source.alive ? this.source.state : UNHEARD;
    return this.failed ? "failed" : this.running ? "running" : "paused";
  }

  panels() {
    const { source, state } = this;
    if (!this.gauges) return;
    this.shown = performance.now();
    this.forget();
    this.gauges.show(source.values);
    this.findings.show(source.info?.findings, this.shared && source.driving);
    this.charts.show(source.curves(), this.slowed);
    this.sliders?.show();
    this.choices();
    if (!this.shared) this.levers.show(this.mode === "drive" ? this.levers.last.sticks : REST, false);
    const status = (this.sources.drive ?? source).task?.status();
    this.task?.show(status);
    this.scene?.mark(this.task?.open && status ? rings(this.data.task, status) : []);
    this.times();
    this.pace.look(source.time, state === "running", [this.mode, source.jumps, this.at("speed").value].join(), source.framed);
    const { timing, message, able } = { able: source.able, ...source.info };
    const { values, time, drives } = source;
    this.line.show({ state, time, values, slowed: this.data.slowed, drives, timing, message, able, factor: this.pace.factor });
    const standing = !this.shared ? [] : state === UNHEARD ? [UNHEARD] : [message, STANDING[state] ?? ""];
    write(this.at("banner"), [...standing, this.blind, ...notices(this.data.notices, values)].filter(Boolean).map(worded).join("; "));
    this.at("banner").classList.toggle("hm-bad", state === "failed" || state === UNHEARD || Boolean(this.shared && message));
  }

  // name, state and time of what is shown
  times() {
    const { source, state } = this;
    write(this.at("mode"), this.shared ? source.data.title : `${TITLES[this.mode]}${this.running ? "" : ", paused"}`);
    write(this.at("clock"), `${source.time.toFixed(1)} s`);
    const goes = ["running", "starting"].includes(this.shared ? source.state : state);
    write(this.at("pause"), goes ? "Pause" : "Go on");
    this.at("pause").hidden = !this.began && !this.shared; // the picture has a button to start
    if (!this.shared) this.at("save").disabled = this.mode === "replay" || !source.simulation.frames;
    if (this.shared && document.activeElement !== this.at("speed")) this.at("speed").value = String(source.info.factor ?? 1);
    if (source.span && !this.at("seek").matches(":active")) this.at("seek").value = (source.time - source.span[0]) / (source.span[1] - source.span[0]);
  }

  // pattern and mode of the sticks, and their words
  choices() {
    const source = this.sources.drive ?? this.source;
    const { pattern, mode } = source;
    const [modes, driver] = [this.shared ? source.status.modes : [], !this.shared || (source.alive && source.status.role !== "watching")];
    const key = JSON.stringify([pattern, mode, modes, driver, this.data.legends]);
    if (key === this.chosen) return;
    this.chosen = key;
    const group = (place, names, chosen, act) => {
      const buttons = [...this.at(place).children];
      const same = buttons.map((one) => one.textContent).join() === names.join(); // then one of them may have the focus
      if (!same) this.at(place).replaceChildren(...names.map((name) => make("button", { type: "button", textContent: name, onclick: () => act(name) })));
      for (const button of this.at(place).children) {
        button.disabled = !driver;
        button.setAttribute("aria-pressed", String(button.textContent === chosen));
      }
    };
    const legend = this.data.legends[mode]?.[pattern];
    group("patterns", legend ? Object.keys(this.data.patterns) : [], pattern, (name) => this.pattern(name));
    group("drive-modes", modes.length > 1 ? modes : [], mode, (name) => source.do("choose", { mode: name }));
    this.levers.label(legend ?? {});
    for (const svg of this.root.querySelectorAll(".hm-stick")) svg.style.display = legend ? "" : "none";
    this.at("keys").hidden = !legend;
    const down = legend && [["left", "W"], ["right", "↑"]].find(([hand]) => /down/.test(legend[`${hand}_up`]));
    this.at("away").textContent = down ? `${down[1]} pushes the ${down[0]} stick away: ${legend[`${down[0]}_up`]}.` : "";
  }

  // draw what has changed; a machine of one's own pauses while nobody sees the page, and starts when it comes into
  // sight, unless less motion is preferred
  watch() {
    const recolour = () => [this.scene?.recolour(), this.charts?.recolour()];
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
    for (const element of [document.documentElement, document.body])
      new MutationObserver(recolour).observe(element, { attributes: true });
    const draw = () => (this.scene?.brush.draw(), requestAnimationFrame(draw));
    draw();
    if (this.shared) return;
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    let [visible, asked] = [false, this.data.autostart && !still];
    const update = () => {
      const seen = visible && document.visibilityState === "visible";
      if (!seen && this.running) [asked] = [true, this.run(false)];
      else if (seen && asked && !this.running) [asked] = [false, this.run(true)];
    };
    new IntersectionObserver(([entry]) => ((visible = entry.isIntersecting), update())).observe(this.at("stage"));
    document.addEventListener("visibilitychange", update);
    if (this.sources.drive) setInterval(() => this.watchPad(visible), PANELS);
  }
}

const touched = () => matchMedia("(hover: none) and (pointer: coarse)").matches;
const worded = (text) => (touched() ? TOUCH.reduce((now, [keys, fingers]) => now.replace(keys, fingers), text) : text);

function download(name, text) {
  const href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  make("a", { href, download: name }).click();
  URL.revokeObjectURL(href);
}

// The machine on a page: simulation, levers, scene, panels. `sceneOf` has the scene of `harvester view`, `Fmu` calls the
// module. Nothing is requested: all data are in the section.

const WINDOW = 20; // s of the charts
const SAMPLE = 2; // frames between two points of a chart
const BUDGET = 24; // ms of simulation for one picture; beyond it the machine is slower than real time
const LONGEST = 60000; // frames of saved commands, 10 min
const REACH = 44; // of the knob of a stick, in its picture
const PANELS = 100; // ms between two updates of numbers and charts
const SPAN = 2000; // ms over which the real-time factor is measured

// ---- levers, as in `view` (orchestrator/view/driving): keys as two sticks, response curve, pattern of ISO 10968

const AXES = {
  KeyA: [0, -1], KeyD: [0, 1], KeyW: [1, 1], KeyS: [1, -1],
  KeyJ: [2, -1], KeyL: [2, 1], KeyI: [3, 1], KeyK: [3, -1],
  ArrowLeft: [2, -1], ArrowRight: [2, 1], ArrowUp: [3, 1], ArrowDown: [3, -1],
};
const OUT = 2.5; // per second: a tap is a small movement, full deflection takes 0.4 s
const BACK = 10; // per second
const [DEAD_ZONE, PROGRESSION] = [0.08, 0.6];

function response(deflection) {
  const beyond = (Math.min(Math.abs(deflection), 1) - DEAD_ZONE) / (1 - DEAD_ZONE);
  if (!(beyond > 0)) return 0;
  return Math.sign(deflection) * ((1 - PROGRESSION) * beyond + PROGRESSION * beyond ** 3);
}

class Levers {
  constructor() {
    this.held = new Set();
    this.hands = { left: null, right: null }; // held with pointers: deflections, or null
    this.keys = [0, 0, 0, 0];
  }

  clear() {
    this.held.clear();
    this.hands = { left: null, right: null };
  }

  get deflected() {
    return this.held.size > 0 || Boolean(this.hands.left || this.hands.right);
  }

  // deflections after `seconds` more: left x, y, right x, y
  read(seconds) {
    const wanted = [0, 0, 0, 0];
    for (const code of this.held) wanted[AXES[code][0]] += AXES[code][1];
    this.keys = this.keys.map((value, axis) => {
      const goal = Math.max(-1, Math.min(1, wanted[axis]));
      const pace = (goal === 0 ? BACK : OUT) * seconds;
      const from = goal * value < 0 ? 0 : value;
      return from + Math.max(-pace, Math.min(pace, goal - from));
    });
    const pick = (hand, first) => this.hands[hand] ?? this.keys.slice(first, first + 2);
    this.shown = [...pick("left", 0), ...pick("right", 2)];
    return this.shown;
  }

  functions(seconds) {
    const [lx, ly, rx, ry] = this.read(seconds).map(response);
    return { swing: -lx, stick: -ly, boom: -ry, curl: -rx };
  }
}

// ---- simulation: frames of 10 ms, in which the inputs are linear, as a scenario of `harvester run` has them

class Simulation {
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
    [this.frames, this.exact, this.cost] = [0, true, 0];
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
    this.frames += 1;
    if (this.rows.length < LONGEST) this.rows.push([this.time, ...to]);
    else this.exact = false;
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
      if (this.frames) this.exact = false; // a scenario has no parameters
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
}

// the commands of a program at a time
function commandsAt({ time, columns }, t) {
  let k = time.findIndex((sample) => sample > t + 1e-9);
  if (k < 0) k = time.length;
  const pick = (values) => {
    if (k === 0 || k === time.length) return values[Math.max(0, k - 1)];
    return values[k - 1] + ((t - time[k - 1]) / (time[k] - time[k - 1])) * (values[k] - values[k - 1]);
  };
  return Object.fromEntries(Object.entries(columns).map(([name, values]) => [name, pick(values)]));
}

// ---- scene

class Scene {
  constructor(THREE, data, place, ghost) {
    [this.THREE, this.data, this.place, this.number, this.colours] = [THREE, data, place, 0, {}];
    const software = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(graphics());
    const renderer = new THREE.WebGLRenderer({ antialias: !software });
    const camera = new THREE.PerspectiveCamera(31, 1, 0.3, 200);
    camera.up.set(0, 0, 1);
    place.append(renderer.domElement);
    const controls = new THREE.OrbitControls(camera, renderer.domElement);
    renderer.domElement.style.touchAction = "pan-y"; // fingers scroll the page
    controls.enableZoom = false; // the wheel scrolls the page; two fingers and Ctrl + wheel are the browser's
    this.stage = { renderer, camera, controls, $el: place, $emit() {}, scene: new THREE.Scene() };
    const { Rig, Ground, Brush } = sceneOf(THREE, () => this.stage);
    [this.Ground, this.scheme] = [Ground, dark(place) ? "dark" : "light"];
    this.brush = new Brush();
    this.brush.create_mesh(0);
    const shape = data.machine[this.scheme];
    if (ghost) this.ghost = this.add(new Rig(), { ...shape, parts: shape.parts.filter((part) => part.node !== "site") });
    this.rig = this.add(new Rig(), shape);
    if (ghost) this.fade();
    this.ground();
    this.look("quarter");
    new ResizeObserver(() => this.fit()).observe(place);
    this.fit();
  }

  add(rig, data) {
    this.stage.scene.add(rig.create_mesh(0, data));
    return rig;
  }

  // the reference: transparent and of one colour, without shadow and trail; behind the machine where they agree
  fade() {
    const colour = new this.THREE.Color("#e69f00");
    const behind = { polygonOffset: true, polygonOffsetFactor: 4, polygonOffsetUnits: 40, depthWrite: false };
    for (const material of this.ghost.materials.values())
      Object.assign(material, { vertexColors: false, color: colour, transparent: true, opacity: 0.45, ...behind });
    this.ghost.shadow.visible = false;
    this.ghost.root.children[1].visible = false;
    this.ghost.materials = new Map(); // pressures do not colour it
  }

  ground() {
    if (this.floor) this.stage.scene.remove(this.floor);
    const colours = this.data.ground[this.scheme];
    this.floor = new this.Ground().create_mesh(0, colours);
    this.stage.scene.background = new this.THREE.Color(colours.sky);
    this.stage.scene.add(this.floor);
    this.rig.ink.color.set(this.data.machine[this.scheme].shade);
  }

  // after a change of the colour scheme
  recolour() {
    const scheme = dark(this.place) ? "dark" : "light";
    if (scheme === this.scheme) return;
    this.scheme = scheme;
    this.ground();
    this.place.redraw();
  }

  look(name) {
    const [x, y, z, ...target] = this.data.views[name];
    this.stage.camera.position.set(x, y, z);
    this.stage.controls.target.set(...target);
    this.stage.controls.update();
  }

  fit() {
    const { clientWidth: width, clientHeight: height } = this.place;
    if (!width || !height) return;
    this.stage.renderer.setSize(width, height);
    this.stage.camera.aspect = width / height;
    this.stage.camera.updateProjectionMatrix();
    this.place.redraw();
  }

  colour(pressure, full) {
    const { scale, unknown } = this.data;
    if (!Number.isFinite(pressure)) return unknown;
    return scale[Math.round(Math.min(1, Math.max(0, pressure / full)) * (scale.length - 1))];
  }

  show(angles, colours, again = false) {
    const changed = Object.entries(colours).filter(([name, colour]) => this.colours[name] !== colour);
    this.colours = { ...colours };
    this.rig.show(++this.number, angles, Object.fromEntries(changed), again);
  }

  draw() {
    this.stage.renderer.render();
  }
}

// whether the page is dark where this element is: by the setting of the browser, or by a switch of the site
function dark(element) {
  const [red] = getComputedStyle(element).color.match(/[\d.]+/g); // of the ink: grey
  return Number(red) > 128;
}

function graphics() {
  const probe = document.createElement("canvas").getContext("webgl2");
  const names = probe?.getExtension("WEBGL_debug_renderer_info");
  const name = names ? probe.getParameter(names.UNMASKED_RENDERER_WEBGL) : probe?.getParameter(probe.RENDERER);
  probe?.getExtension("WEBGL_lose_context")?.loseContext();
  return name ?? "";
}

// ---- panels

const make = (tag, properties = {}, ...children) => {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
};

class Gauges {
  constructor(place, groups, names) {
    this.lines = [];
    for (const { title, lines } of groups) {
      const present = lines.filter((line) => names.has(line.name));
      if (!present.length) continue;
      const heading = make("p", { className: "hm-title", textContent: title });
      place.append(make("div", { className: "hm-group" }, heading, ...present.map((line) => this.line(line))));
    }
  }

  line(gauge) {
    const [bar, output] = [make("i"), make("output", { textContent: "–" })];
    const unit = make("small", { textContent: gauge.unit });
    const row = make("div", { className: "hm-gauge" }, make("span", { textContent: gauge.text }));
    const track = make("div", { className: "hm-track" }, bar);
    if (gauge.low < 0) track.append(make("b", { style: `left: ${100 * this.share(gauge, 0)}%` }));
    row.append(track, output, unit);
    this.lines.push({ gauge, bar, output, unit, row });
    return row;
  }

  share({ low, high }, value) {
    return Math.min(1, Math.max(0, (value - low) / (high - low)));
  }

  show(values, colour) {
    for (const { gauge, bar, output, unit, row } of this.lines) {
      const value = values[gauge.name] ?? NaN;
      const shown = value * gauge.factor;
      const ends = [this.share(gauge, 0), this.share(gauge, shown)].sort((a, b) => a - b);
      const text = Number.isFinite(shown) ? shown.toFixed(gauge.digits).replace(/^-(?=0(\.0*)?$)/, "").replace("-", "−") : "–";
      if (output.textContent !== text) output.textContent = text;
      bar.style.transform = `translateX(${100 * ends[0]}%) scaleX(${ends[1] - ends[0]})`;
      const cavitates = gauge.coloured && value < gauge.cavitation;
      row.classList.toggle("hm-cavitates", cavitates);
      const label = cavitates ? "cavitates" : gauge.unit;
      if (unit.textContent !== label) unit.textContent = label;
      if (gauge.coloured) bar.style.background = colour(value);
    }
  }
}

// the last seconds of some signals, as curves over time
class Chart {
  constructor(place, chart, names) {
    this.chart = chart;
    this.curves = chart.curves.filter((curve) => names.has(curve.name));
    if (!this.curves.length) return;
    this.canvas = make("canvas", { role: "img", ariaLabel: `${chart.title} over the last ${WINDOW} seconds` });
    this.canvas.setAttribute("role", "img");
    const keys = this.curves.map((curve) => {
      const key = make("span", {}, make("i"), curve.text);
      key.firstChild.style.borderTop = `2px ${curve.dashed ? "dashed" : "solid"} ${curve.colour}`;
      return key;
    });
    const heading = make("p", { className: "hm-title", textContent: `${chart.title} [${chart.unit}]` });
    place.append(make("figure", { className: "hm-chart" }, heading, make("div", { className: "hm-key" }, ...keys), this.canvas));
  }

  // points: { t, values } in order
  draw(points) {
    if (!this.curves.length) return;
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width) return;
    if (this.canvas.width !== Math.round(width * ratio)) this.canvas.width = Math.round(width * ratio);
    if (this.canvas.height !== Math.round(height * ratio)) this.canvas.height = Math.round(height * ratio);
    const pen = this.canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const { factor, ends, both } = this.chart;
    const of = (point, curve) => (point.values[curve.name] ?? NaN) * factor;
    const peak = Math.max(0, ...points.flatMap((p) => this.curves.map((c) => Math.abs(of(p, c)) || 0)));
    const high = ends.find((end) => end >= peak) ?? ends[ends.length - 1];
    const low = both ? -high : 0;
    const [left, right, top, bottom] = [34, width - 4, 6, height - 16];
    const now = points.length ? points[points.length - 1].t : 0;
    const x = (t) => right + ((t - now) / WINDOW) * (right - left);
    const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
    this.axes(pen, { left, right, top, bottom, low, high, x: (ago) => x(now - ago), y });
    pen.save();
    pen.beginPath();
    pen.rect(left, top - 2, right - left, bottom - top + 4);
    pen.clip();
    for (const curve of this.curves) {
      pen.strokeStyle = curve.colour;
      pen.lineWidth = 1.5;
      pen.setLineDash(curve.dashed ? [4, 3] : []);
      pen.beginPath();
      points.forEach((point, k) => pen[k ? "lineTo" : "moveTo"](x(point.t), y(of(point, curve))));
      pen.stroke();
    }
    pen.restore();
  }

  axes(pen, { left, right, low, high, bottom, x, y }) {
    const style = getComputedStyle(this.canvas);
    [pen.fillStyle, pen.strokeStyle, pen.lineWidth] = [style.color, style.borderTopColor, 1];
    pen.setLineDash([]);
    pen.font = `11px ${style.fontFamily}`;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const value of low < 0 ? [low, 0, high] : [0, high / 2, high]) {
      pen.beginPath();
      pen.moveTo(left, y(value));
      pen.lineTo(right, y(value));
      pen.stroke();
      pen.fillText(String(value).replace("-", "−"), left - 5, y(value));
    }
    pen.textBaseline = "top";
    for (const ago of [20, 10, 0]) {
      pen.textAlign = ago === 0 ? "right" : ago === 20 ? "left" : "center";
      pen.fillText(ago ? `−${ago} s` : "now", x(ago), bottom + 4);
    }
  }
}

// two sticks for mouse and fingers
class Stick {
  constructor(svg, levers, words, grabbed) {
    const [first, hand] = [svg.dataset.hand === "left" ? 0 : 2, svg.dataset.hand];
    [this.svg, this.levers, this.first] = [svg, levers, first];
    const [up, down, left, right] = words;
    svg.innerHTML = `<rect x="22" y="22" width="106" height="106" rx="14"/><path d="M75 22V128M22 75H128"/>
      <text x="75" y="14">${up}</text><text x="75" y="144">${down}</text>
      <text x="10" y="75" transform="rotate(-90 10 75)">${left}</text><text x="140" y="75" transform="rotate(90 140 75)">${right}</text>
      <circle cx="75" cy="75" r="18"/>`;
    this.knob = svg.querySelector("circle");
    const place = (event) => {
      const box = svg.getBoundingClientRect();
      const share = (offset) => Math.max(-1, Math.min(1, ((offset / box.width) * 150) / REACH));
      levers.hands[hand] = [
        share(event.clientX - box.left - box.width / 2),
        -share(event.clientY - box.top - box.height / 2),
      ];
    };
    svg.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      svg.setPointerCapture(event.pointerId);
      place(event);
      grabbed();
    });
    svg.addEventListener("pointermove", (event) => levers.hands[hand] && place(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"])
      svg.addEventListener(end, () => (levers.hands[hand] = null));
  }

  show() {
    const [x, y] = (this.levers.shown ?? [0, 0, 0, 0]).slice(this.first, this.first + 2);
    this.knob.setAttribute("cx", 75 + REACH * x);
    this.knob.setAttribute("cy", 75 - REACH * y);
  }
}

// ---- the section

const TITLES = { program: "demonstration", drive: "you drive", replay: "replay of the run" };

class Section {
  constructor(root) {
    this.root = root;
    this.at = (name) => root.querySelector(`.hm-${name}`);
    [this.running, this.due, this.points, this.paces, this.levers] = [false, 0, [], [], new Levers()];
    this.load().catch((problem) => this.fail(problem));
  }

  async load() {
    const part = (name) => unpacked(this.root.querySelector(`[data-part=${name}]`));
    const [three, data, module] = await Promise.all(["three", "data", "module"].map(part));
    this.data = JSON.parse(text(data));
    if (module) {
      const fmu = await Fmu.load(module, this.data.fmu, (status, _, message) => this.log(status, message));
      this.simulation = new Simulation(fmu, this.data.fmu);
    }
    const THREE = new Function(`${text(three)}\nreturn THREE;`)();
    this.scene = new Scene(THREE, this.data.scene, this.at("stage"), Object.keys(this.data.replay?.ghost ?? {}).length > 0);
    const names = new Set(module ? this.data.fmu.outputs : Object.keys(this.data.replay.columns));
    this.gauges = new Gauges(this.at("gauges"), this.data.gauges, names);
    this.charts = this.data.charts.map((chart) => new Chart(this.at("charts"), chart, names));
    this.controls();
    this.choose(this.data.replay ? "replay" : this.data.fmu.program ? "program" : "drive");
    this.present(true);
    this.watch();
    this.root.dataset.ready = "true";
  }

  // ---- controls

  controls() {
    this.at("looks").append(
      ...Object.keys(this.data.scene.views).map((name) =>
        make("button", { type: "button", textContent: name, onclick: () => (this.scene.look(name), this.scene.place.redraw()) })),
    );
    for (const button of this.root.querySelectorAll("[data-mode]"))
      button.addEventListener("click", () => (this.choose(button.dataset.mode), this.run(true), this.focus()));
    if (this.data.fmu && !this.data.fmu.program) this.root.querySelector("[data-mode=program]").remove();
    this.at("begin").disabled = false;
    this.at("begin").addEventListener("click", () => (this.run(true), this.focus()));
    this.at("pause").addEventListener("click", () => this.run(!this.running));
    this.at("again").addEventListener("click", () => (this.again(), this.run(true)));
    this.at("stage").addEventListener("keydown", (event) => this.key(event));
    this.at("stage").addEventListener("keyup", (event) => this.levers.held.delete(event.code));
    this.at("stage").addEventListener("blur", () => this.levers.clear());
    this.at("stage").addEventListener("pointerdown", () => this.focus());
    if (this.simulation) this.drivers();
    if (!this.data.replay) return;
    this.at("seek").max = this.data.replay.time.length - 1;
    this.at("seek").addEventListener("input", () => this.seek(this.data.replay.time[this.at("seek").value]));
  }

  drivers() {
    const words = { left: ["stick out", "stick in"], right: ["boom down", "boom up"] };
    const sides = { left: ["swing left", "swing right"], right: ["", ""] };
    this.sticks = [...this.root.querySelectorAll(".hm-stick")].map(
      (svg) => new Stick(svg, this.levers, [...words[svg.dataset.hand], ...sides[svg.dataset.hand]], () => this.take()),
    );
    const poses = ["", ...Object.keys(this.data.fmu.poses)];
    this.at("pose").append(...poses.map((name) => make("option", { value: name, textContent: name || "as shipped" })));
    this.at("pose").addEventListener("change", () => (this.choose("drive"), this.again(), this.run(true)));
    if (poses.length < 2) this.at("pose").parentElement.remove();
    this.sliders = this.data.fmu.sliders.map((slider) => this.slider(slider));
    this.at("save").addEventListener("click", () => this.save());
  }

  slider(slider) {
    const { text: label, unit, low, high, step, start, factor, name } = slider;
    const input = make("input", { type: "range", min: low, max: high, step });
    input.value = start * factor;
    const output = make("output");
    const row = make("label", { className: "hm-slider" }, make("span", { textContent: label }), input, output);
    const show = (value) => (output.textContent = `${Number(value.toFixed(1))} ${unit}`);
    show(start * factor);
    input.addEventListener("input", () => {
      this.simulation.slide(name, Number(input.value) / factor);
      show(Number(input.value));
      if (this.mode === "replay") this.choose("drive");
    });
    this.at("sliders").append(row);
    const axis = this.simulation.names.indexOf(name);
    return { follow: () => {
      if (axis < 0 || this.mode !== "program") return;
      this.simulation.goal[axis] = this.simulation.now[axis];
      input.value = this.simulation.now[axis] * factor;
      show(this.simulation.now[axis] * factor);
    } };
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return this.levers.clear();
    const does = {
      KeyP: () => this.run(!this.running),
      Home: () => (this.again(), this.run(true)),
      Space: () => this.run(true),
      Escape: () => this.at("stage").blur(),
    }[event.code];
    const lever = this.simulation && event.code in AXES;
    if (!does && !lever) return;
    event.preventDefault(); // no scrolling
    if (event.repeat) return;
    if (does) return does();
    this.levers.held.add(event.code);
    this.take();
  }

  focus() {
    this.at("stage").focus({ preventScroll: true });
  }

  // the visitor drives from now on, from where the machine is
  take() {
    if (this.mode === "replay") {
      const angles = this.angles(this.replayed(), this.data.initial);
      this.choose("drive", Object.fromEntries(this.data.fmu.initial.map((name, k) => [name, angles[k]])));
    } else if (this.mode === "program") this.choose("drive", null);
    this.run(true);
  }

  // angles: of the start; null: go on from here
  choose(mode, angles = {}) {
    const before = this.mode;
    this.mode = mode;
    for (const button of this.root.querySelectorAll("[data-mode]"))
      button.setAttribute("aria-pressed", String(button.dataset.mode === mode));
    this.root.dataset.mode = mode;
    if (mode === "replay" || angles === null || (before === mode && mode === "drive")) return this.present(mode === "replay");
    this.begin(before === "program" && mode === "drive" ? null : angles);
  }

  begin(angles) {
    if (angles !== null) this.simulation.begin(angles);
    this.points = [];
    this.present(true);
  }

  again() {
    if (this.mode === "replay") return this.seek(this.data.replay.time[0]);
    const pose = this.data.fmu.poses[this.at("pose")?.value] ?? {};
    this.at("cover").classList.remove("hm-failed");
    this.begin(this.mode === "drive" ? pose : {});
  }

  save() {
    const link = make("a", { download: "drive.csv" });
    link.href = URL.createObjectURL(new Blob([this.simulation.csv()], { type: "text/csv" }));
    link.click();
    URL.revokeObjectURL(link.href);
  }

  // ---- time

  run(on) {
    if (on && this.failed) return;
    if (on && !this.running) {
      [this.last, this.due] = [performance.now(), 0];
      requestAnimationFrame((now) => this.tick(now));
    }
    this.running = on;
    this.paces = [];
    this.at("pause").textContent = on ? "Pause" : "Start";
    this.at("cover").hidden = on;
    this.at("begin").textContent = this.began ? "Continue" : "Start";
    this.began ||= on;
    if (!on) this.levers.clear();
    this.panels();
  }

  tick(now) {
    if (!this.running) return;
    this.due += (Math.min(now - this.last, 100) / 1000) * Number(this.at("speed").value);
    this.last = now;
    try {
      if (this.mode === "replay") this.play();
      else this.simulate();
      this.present();
    } catch (problem) {
      return this.fail(problem);
    }
    requestAnimationFrame((next) => this.tick(next));
  }

  simulate() {
    const end = performance.now() + BUDGET;
    while (this.due >= this.data.fmu.frame && performance.now() < end) {
      this.frame();
      this.due -= this.data.fmu.frame;
    }
    if (this.due > 2 * this.data.fmu.frame) this.due = 0; // slower than real time
  }

  frame() {
    const { fmu } = this.data;
    const program = this.mode === "program" && fmu.program;
    if (program && this.simulation.time >= program.time[program.time.length - 1]) this.begin({});
    const next = (this.simulation.frames + 1) * fmu.frame;
    this.simulation.frame(program ? commandsAt(program, next) : this.commanded(), Boolean(program));
    if (this.simulation.frames % SAMPLE === 0) this.sample(this.simulation.time, this.simulation.values());
  }

  commanded() {
    const functions = this.levers.functions(this.data.fmu.frame);
    const driven = Object.entries(this.data.fmu.full).flatMap(([name, inputs]) =>
      Object.entries(inputs).map(([input, full]) => [input, full * functions[name]]));
    return Object.fromEntries(driven);
  }

  sample(t, values) {
    if (this.points.length && t < this.points[this.points.length - 1].t) this.points = [];
    this.points.push({ t, values });
    while (this.points[0].t < t - WINDOW) this.points.shift();
  }

  // ---- replay

  seek(t) {
    this.moment = t;
    if (this.mode !== "replay") this.choose("replay");
    this.present(true);
  }

  play() {
    const { time } = this.data.replay;
    this.moment = (this.moment ?? time[0]) + this.due;
    this.due = 0;
    if (this.moment > time[time.length - 1]) this.moment = time[0];
  }

  // the last seconds of the replay, for the charts
  recent() {
    const { time, columns } = this.data.replay;
    const names = Object.keys(columns);
    this.history ??= time.map((t, k) => ({ t, values: Object.fromEntries(names.map((name) => [name, columns[name][k]])) }));
    const past = this.history.filter(({ t }) => t > this.time - WINDOW && t < this.time);
    return [...past, { t: this.time, values: this.values }];
  }

  // values at the moment of the replay, linear between the pictures
  replayed(columns = this.data.replay.columns) {
    const { time } = this.data.replay;
    const share = (((this.moment ?? time[0]) - time[0]) / (time[time.length - 1] - time[0])) * (time.length - 1);
    const k = Math.max(0, Math.min(time.length - 2, Math.floor(share)));
    const mixed = ([name, v]) => [name, v[k] + (share - k) * (v[k + 1] - v[k])];
    return Object.fromEntries(Object.entries(columns).map(mixed));
  }

  // ---- what is seen

  angles(values, otherwise) {
    return this.data.joints.map((name, k) => (Number.isFinite(values[name]) ? values[name] : otherwise[k]));
  }

  present(again = false) {
    this.values = this.mode === "replay" ? this.replayed() : this.simulation.values();
    const colour = (value) => this.scene.colour(value, this.data.full);
    const colours = Object.entries(this.data.pressures).map(([part, name]) => [part, colour(this.values[name])]);
    const angles = this.angles(this.values, this.data.initial);
    if (this.scene.ghost) {
      this.scene.ghost.root.visible = this.mode === "replay";
      if (this.mode === "replay") this.scene.ghost.show(0, this.angles(this.replayed(this.data.replay.ghost), angles), {}, true);
    }
    this.scene.show(angles, Object.fromEntries(colours), again);
    if (again || performance.now() - (this.shown ?? 0) > PANELS) this.panels();
  }

  get time() {
    return this.mode === "replay" ? (this.moment ?? this.data.replay.time[0]) : this.simulation.time;
  }

  panels() {
    if (!this.values) return;
    this.shown = performance.now();
    this.gauges.show(this.values, (value) => this.scene.colour(value, this.data.full));
    const points = this.mode === "replay" ? this.recent() : this.points;
    for (const chart of this.charts) chart.draw(points);
    for (const part of [...(this.sliders ?? [])]) part.follow();
    for (const stick of this.sticks ?? []) stick.show();
    this.at("mode").textContent = this.running ? TITLES[this.mode] : `${TITLES[this.mode]}, paused`;
    this.at("clock").textContent = `${this.time.toFixed(1)} s`;
    if (this.mode === "replay") this.at("seek").value = this.replayIndex();
    if (this.simulation) this.at("save").disabled = this.mode === "replay" || !this.simulation.exact || !this.simulation.frames;
    this.at("pace").textContent = this.pace();
  }

  replayIndex() {
    const { time } = this.data.replay;
    return Math.round(((this.time - time[0]) / (time[1] - time[0])));
  }

  // simulated over real time, and over the time that the FMU took
  pace() {
    this.paces.push([performance.now(), this.time]);
    while (this.shown - this.paces[0][0] > SPAN) this.paces.shift();
    const [[begin, from], [end, to]] = [this.paces[0], this.paces[this.paces.length - 1]];
    const factor = this.running && to > from && end - begin > SPAN / 4 ? `real time × ${((1e3 * (to - from)) / (end - begin)).toFixed(2)}` : "";
    const { cost, time } = this.simulation ?? {};
    const able = this.mode !== "replay" && time > 1 ? `the FMU could do × ${Number((1e3 * time / cost).toPrecision(2))}` : "";
    return [factor, able].filter(Boolean).join("; ");
  }

  log(status, message) {
    this.message = message;
    if (status !== "OK" && status !== "warning") console.warn(message);
  }

  fail(problem) {
    this.running = false;
    this.at("said").textContent = problem.message;
    this.at("cover").hidden = false;
    this.at("cover").classList.add("hm-failed");
    this.at("begin").textContent = "Start again";
    this.at("begin").onclick = () => this.simulation && this.again();
    console.error(problem);
  }

  // pause while nobody sees the page; start when it comes into sight, unless less motion is preferred
  watch() {
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    let [visible, asked] = [false, this.data.autostart && !still];
    const update = () => {
      const seen = visible && document.visibilityState === "visible";
      if (!seen && this.running) [asked] = [true, this.run(false)];
      else if (seen && asked && !this.running) [asked] = [false, this.run(true)];
    };
    new IntersectionObserver(([entry]) => ((visible = entry.isIntersecting), update())).observe(this.at("stage"));
    document.addEventListener("visibilitychange", update);
    const recolour = () => this.scene.recolour();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
    for (const element of [document.documentElement, document.body])
      new MutationObserver(recolour).observe(element, { attributes: true });
    const draw = () => (this.scene.draw(), requestAnimationFrame(draw));
    draw();
  }
}

const text = (bytes) => new TextDecoder().decode(bytes);

// bytes of a part of the section: compressed, as base64
async function unpacked(element) {
  if (!element) return null;
  const packed = Uint8Array.from(atob(element.textContent), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

for (const root of document.querySelectorAll(".harvester-machine:not([data-mode])")) {
  root.dataset.mode = "";
  root.machine = new Section(root);
}

// What the hands do, as two sticks and thumb wheels: keys, gamepad, and those on the screen. Each counts only while its own
// dead-man is held, so that a drifting gamepad does not move what the keyboard holds; of several, the largest
// deflection wins. With a source of one's own (`shared` false) keys need no dead-man.

// codes name the place of a key, whatever letter the layout puts there; axes: left x, y, right x, y, then wheels
const AXES = {
  KeyA: [0, -1], KeyD: [0, 1], KeyW: [1, 1], KeyS: [1, -1],
  KeyJ: [2, -1], KeyL: [2, 1], KeyI: [3, 1], KeyK: [3, -1],
  ArrowLeft: [2, -1], ArrowRight: [2, 1], ArrowUp: [3, 1], ArrowDown: [3, -1],
};
const PAIRS = ["KeyQ KeyE", "KeyU KeyO", "Digit1 Digit2", "Digit3 Digit4", "Digit5 Digit6", "Digit7 Digit8", "Digit9 Digit0"]
  .map((pair) => pair.split(" ")); // of the wheels; further ones have no keys
PAIRS.forEach(([left, right], k) => Object.assign(AXES, { [left]: [4 + k, -1], [right]: [4 + k, 1] }));
export const WHEEL_KEYS = PAIRS.map((pair) => pair.map((code) => code.slice(-1)));
const DEAD_MAN = ["Space", "ShiftLeft", "ShiftRight"];
const BUMPERS = [4, 5]; // of a gamepad with the standard mapping, one held as dead-man; its sticks are axes 0 to 3
const BUTTONS = [[6, 7], [14, 15], [2, 1], [13, 12], [0, 3]]; // of the wheels
export const WHEEL_BUTTONS = ["triggers", "D-pad ← →", "X B", "D-pad ↓ ↑", "A Y"];
const OUT = 2.5; // per second: a tap is a small movement, full deflection takes 0.4 s
const BACK = 10; // per second
const REACH = 44; // of the knob of a stick, in its picture
const REST = [0, 0, 0, 0];
// where keys mean something else: whoever types or presses a button there does not drive
const OTHERS =
  "input,textarea,select,button,a[href],summary,[contenteditable]:not([contenteditable=false]),[role=dialog],dialog";

export const elsewhere = (target) => target instanceof Element && target.closest(OTHERS) !== null;

// fraction of full speed at a deflection, as `response` in sticks.py
export function response(deflection, { dead_zone: zone, progression: part }) {
  const beyond = (Math.min(Math.abs(deflection), 1) - zone) / (1 - zone);
  if (!(beyond > 0)) return 0;
  return Math.sign(deflection) * ((1 - part) * beyond + part * beyond ** 3);
}

// functions at these deflections, as `functions` in sticks.py
export function functions(sticks, { left, right, wheels }, curve) {
  return Object.fromEntries([...left, ...right, ...wheels].map((name, k) => [name, 0 - response(sticks[k] ?? 0, curve)]));
}

// count: of the axes that the machine has
export function merge(sources, count) {
  const held = sources.filter((source) => source.deadMan);
  const largest = (axis) =>
    held.map((source) => source.sticks[axis] ?? 0).reduce((a, b) => (Math.abs(b) > Math.abs(a) ? b : a), 0);
  return { sticks: Array.from({ length: count }, (_, axis) => largest(axis)), deadMan: held.length > 0 };
}

export class Keyboard {
  // drives: whether keys move the sticks now; pressed: called for each key of the sticks, whether they do or not
  constructor(shared, drives, pressed = () => {}) {
    [this.shared, this.drives, this.pressed] = [shared, drives, pressed];
    [this.held, this.rest, this.values] = [new Set(), REST, REST];
    window.addEventListener("keydown", (event) => this.down(event), true);
    window.addEventListener("keyup", (event) => this.up(event), true);
    // the hands are at a field or a button now
    window.addEventListener("focusin", (event) => elsewhere(event.target) && this.clear(), true);
  }

  down(event) {
    if (elsewhere(event.target)) return;
    const lever = AXES[event.code]?.[0] < this.rest.length || (this.shared && DEAD_MAN.includes(event.code));
    if (!this.drives()) {
      const plain = !(event.ctrlKey || event.altKey || event.metaKey || event.shiftKey || event.repeat);
      if (lever && plain) this.pressed();
      return;
    }
    // with these held, a browser or desktop may swallow the release of another key
    if (event.ctrlKey || event.altKey || event.metaKey) return this.clear();
    if (!lever) return;
    event.preventDefault(); // no scrolling
    if (event.repeat) return;
    // pressed twice without a release between: one was lost, and perhaps not the only one
    if (this.held.has(event.code)) return this.clear();
    this.held.add(event.code);
    this.pressed();
  }

  up(event) {
    this.held.delete(event.code);
    if (!event.shiftKey) ["ShiftLeft", "ShiftRight"].forEach((code) => this.held.delete(code));
  }

  clear() {
    this.held.clear();
    this.values = this.rest;
  }

  read(seconds) {
    const wanted = [...this.rest];
    for (const code of this.held) if (code in AXES) wanted[AXES[code][0]] += AXES[code][1];
    this.values = this.values.map((value, axis) => {
      const goal = Math.max(-1, Math.min(1, wanted[axis]));
      const pace = (goal === 0 ? BACK : OUT) * seconds;
      const from = goal * value < 0 ? 0 : value; // the other way: at once through the middle
      return from + Math.max(-pace, Math.min(pace, goal - from));
    });
    return { sticks: this.values, deadMan: !this.shared || DEAD_MAN.some((code) => this.held.has(code)) };
  }
}

// other mappings are named, not used: their axes may be anything
export function readGamepad() {
  const pads = [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad && pad.connected);
  const good = pads.filter((pad) => pad.mapping === "standard");
  const pressed = (pad) => BUMPERS.some((index) => pad.buttons[index]?.pressed);
  const pad = good.find(pressed) ?? good[0];
  if (!pad) return { sticks: REST, deadMan: false, note: pads.length ? `${pads[0].id}: no standard mapping, not used` : "" };
  const bounded = (value) => (Number.isFinite(value) ? Math.max(-1, Math.min(1, value)) : 0);
  const [leftX, leftY, rightX, rightY] = pad.axes.slice(0, 4).map(bounded); // down is positive
  const pushed = (index) => bounded(pad.buttons[index]?.value);
  const wheels = BUTTONS.map(([left, right]) => pushed(right) - pushed(left));
  return { sticks: [leftX, -leftY, rightX, -rightY, ...wheels], deadMan: pressed(pad), note: pad.id };
}

const END = { up: 'x="75" y="14"', down: 'x="75" y="144"', left: 'x="10" y="75" transform="rotate(-90 10 75)"',
  right: 'x="140" y="75" transform="rotate(90 140 75)"' };

// a stick on the screen for mouse and fingers, which is its own dead-man while it is held
class Stick {
  constructor(svg, grabbed, picture = stick()) {
    [this.svg, this.hand, this.pointer, this.at] = [svg, svg.dataset.hand, null, [0, 0]];
    svg.innerHTML = picture;
    this.knob = svg.querySelector("circle");
    svg.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      svg.setPointerCapture(event.pointerId);
      this.pointer = event.pointerId;
      this.drag(event);
      grabbed();
    });
    svg.addEventListener("pointermove", (event) => event.pointerId === this.pointer && this.drag(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) svg.addEventListener(end, () => this.drop());
  }

  drag(event) {
    const box = this.svg.getBoundingClientRect();
    const share = (offset) => Math.max(-1, Math.min(1, ((offset / box.width) * this.svg.viewBox.baseVal.width) / REACH));
    this.at = [share(event.clientX - box.left - box.width / 2), -share(event.clientY - box.top - box.height / 2)];
  }

  drop() {
    [this.pointer, this.at] = [null, [0, 0]];
  }

  label(legend) {
    for (const text of this.svg.querySelectorAll("text")) text.textContent = legend[`${this.hand}_${text.dataset.end}`] ?? "";
  }

  // an attribute that is set is drawn again, even to what it was
  show([x, y], live) {
    const key = [x, y, live].join();
    if (key === this.shown) return;
    this.shown = key;
    this.knob.setAttribute("cx", 75 + REACH * x);
    this.knob.setAttribute("cy", 75 - REACH * y);
    this.knob.classList.toggle("hm-live", live);
  }
}

const stick = () => `<rect x="22" y="22" width="106" height="106" rx="14"/><path d="M75 22V128M22 75H128"/>
  ${Object.entries(END).map(([end, place]) => `<text data-end="${end}" ${place}></text>`).join("")}<circle cx="75" cy="75" r="18"/>`;
const WHEEL = '<rect x="13" y="57" width="124" height="36" rx="18"/><path d="M75 57V93"/><circle cx="75" cy="75" r="15"/>';

// a thumb wheel, between the words at its ends
class Wheel extends Stick {
  constructor(place, number, grabbed) {
    const [left, right] = WHEEL_KEYS[number - 1]?.map((key) => `<kbd>${key}</kbd>`) ?? ["", ""];
    place.insertAdjacentHTML("beforeend", `<div class="hm-wheel"><span>${left}<b data-end="left"></b></span>
      <svg viewBox="9 53 132 44" role="img" data-hand="wheel${number}"></svg><span><b data-end="right"></b>${right}</span></div>`);
    super(place.lastChild.querySelector("svg"), grabbed, WHEEL);
  }

  drag(event) {
    super.drag(event);
    this.at = [this.at[0], 0];
  }

  label(legend) {
    const words = [...this.svg.parentNode.querySelectorAll("b")].map((one) => (one.textContent = legend[`${this.hand}_${one.dataset.end}`] ?? ""));
    this.svg.setAttribute("aria-label", `thumb wheel: ${words.join(", ")}`);
  }
}

// all of it. wheels: the element for them; drives, pressed: as for `Keyboard`; focus: called before a stick on the
// screen is moved
export class Levers {
  constructor(svgs, wheels, shared, drives, pressed, focus) {
    this.drives = drives;
    this.keyboard = new Keyboard(shared, drives, pressed);
    this.grabbed = () => (focus(), pressed());
    this.screen = [...svgs].map((svg) => new Stick(svg, this.grabbed));
    [this.sticks, this.wheels] = [this.screen, wheels];
    [this.note, this.last] = ["", { sticks: REST, deadMan: false }];
    // whatever may swallow the release of a key or a finger
    const ends = [[window, "blur"], [window, "pagehide"], [document, "visibilitychange"], [document, "freeze"], [document, "contextmenu"]];
    for (const [target, name] of ends) target.addEventListener(name, () => this.letGo());
  }

  // whatever is held counts as released
  letGo() {
    this.keyboard.clear();
    for (const stick of this.screen) stick.drop();
    this.onrelease?.();
  }

  // after `seconds` more
  read(seconds) {
    const away = document.hidden || !document.hasFocus();
    if (away || !this.drives()) this.keyboard.clear();
    const pad = away ? { sticks: REST, deadMan: false, note: "" } : readGamepad();
    const touched = { sticks: this.deflections, deadMan: this.screen.some((stick) => stick.pointer !== null) };
    this.note = pad.note;
    this.last = merge([this.keyboard.read(seconds), pad, touched], this.keyboard.rest.length);
    return this.last;
  }

  // of the sticks and wheels on the screen
  get deflections() {
    return this.screen.flatMap(({ at }, k) => (k < 2 ? at : at[0]));
  }

  // after a choice of functions: whatever is held counts as released
  label(legend) {
    const count = Object.keys(legend).filter((name) => /^wheel\d+_left$/.test(name)).length;
    if (count !== this.screen.length - 2) {
      this.letGo();
      this.wheels.replaceChildren();
      this.screen = [...this.sticks, ...Array.from({ length: count }, (_, k) => new Wheel(this.wheels, k + 1, this.grabbed))];
      this.keyboard.rest = this.keyboard.values = Array(4 + count).fill(0);
    }
    for (const one of this.screen) one.label(legend);
  }

  show(sticks, live) {
    this.screen.forEach((one, k) => one.show(k < 2 ? sticks.slice(2 * k, 2 * k + 2) : [sticks[k + 2] ?? 0, 0], live));
  }
}

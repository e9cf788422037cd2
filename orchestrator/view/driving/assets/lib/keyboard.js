// Keys as two sticks. Codes name the place of a key, whatever letter the layout puts there.

const AXES = {
  KeyA: [0, -1], KeyD: [0, 1], KeyW: [1, 1], KeyS: [1, -1],
  KeyJ: [2, -1], KeyL: [2, 1], KeyI: [3, 1], KeyK: [3, -1],
  ArrowLeft: [2, -1], ArrowRight: [2, 1], ArrowUp: [3, 1], ArrowDown: [3, -1],
};
const DEAD_MAN = ["Space", "ShiftLeft", "ShiftRight"];
const OUT = 2.5; // per second: a tap is a small movement, full deflection takes 0.4 s
const BACK = 10; // per second
// where keys mean something else: whoever types or presses a button there does not drive
const OTHERS =
  "input,textarea,select,button,a[href],summary,[contenteditable]:not([contenteditable=false])," +
  "[role=button],[role=slider],[role=tab],[role=combobox],[role=listbox],[role=option],[role=menuitem]," +
  "[role=checkbox],[role=switch],[role=radio],[role=dialog]";

export const elsewhere = (target) => target instanceof Element && target.closest(OTHERS) !== null;

export class Keyboard {
  // idle: called for a key of the sticks while they are not driven
  constructor(driving, idle) {
    [this.driving, this.idle] = [driving, idle];
    this.held = new Set();
    this.values = [0, 0, 0, 0];
    this.down = this.down.bind(this);
    this.up = this.up.bind(this);
    this.moved = this.moved.bind(this);
    window.addEventListener("keydown", this.down, true);
    window.addEventListener("keyup", this.up, true);
    window.addEventListener("focusin", this.moved, true);
  }

  close() {
    window.removeEventListener("keydown", this.down, true);
    window.removeEventListener("keyup", this.up, true);
    window.removeEventListener("focusin", this.moved, true);
  }

  down(event) {
    if (elsewhere(event.target)) return;
    if (!this.driving()) {
      const ours = event.code in AXES || event.code === "Space";
      if (ours && !(event.ctrlKey || event.altKey || event.metaKey || event.repeat)) this.idle();
      return;
    }
    // with these held, a browser or desktop may swallow the release of another key
    if (event.ctrlKey || event.altKey || event.metaKey) return this.clear();
    if (!(event.code in AXES) && !DEAD_MAN.includes(event.code)) return;
    event.preventDefault(); // no scrolling
    if (event.repeat) return;
    // pressed twice without a release between: one was lost, and perhaps not the only one
    if (this.held.has(event.code)) this.clear();
    else this.held.add(event.code);
  }

  up(event) {
    this.held.delete(event.code);
    if (!event.shiftKey) ["ShiftLeft", "ShiftRight"].forEach((code) => this.held.delete(code));
  }

  // the hands are at a field or a button now
  moved(event) {
    if (elsewhere(event.target)) this.clear();
  }

  clear() {
    this.held.clear();
    this.values = [0, 0, 0, 0];
  }

  read(seconds) {
    const wanted = [0, 0, 0, 0];
    for (const code of this.held) if (code in AXES) wanted[AXES[code][0]] += AXES[code][1];
    this.values = this.values.map((value, axis) => {
      const goal = Math.max(-1, Math.min(1, wanted[axis]));
      const pace = (goal === 0 ? BACK : OUT) * seconds;
      const from = goal * value < 0 ? 0 : value; // the other way: at once through the middle
      return from + Math.max(-pace, Math.min(pace, goal - from));
    });
    return { sticks: this.values, deadMan: DEAD_MAN.some((code) => this.held.has(code)) };
  }
}

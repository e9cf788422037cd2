// Source: the machine in real time of `harvester view`, by one websocket. It belongs to a worker
// (worker.js), so that messages go in time; a message goes now or never, nothing is kept for later.
import { History } from "drive/charts.js";
import { Attempts } from "drive/task.js";

const SILENT = 1000; // ms after which a server that says nothing counts as gone
const HEARD = 4; // pictures between two words to the server that they were drawn
const FREE = { role: "free", live: false, why: "", asked: "", pattern: "", mode: "", modes: [] };

export class SocketSource {
  shared = true;
  drives = true;

  constructor(address) {
    // onhello: another machine; onframe; oninfo; onstatus: of the controls; onanswer; onlate
    for (const name of ["onhello", "onframe", "oninfo", "onstatus", "onanswer", "onlate"]) this[name] = () => {};
    [this.opened, this.late, this.spoke, this.lost, this.heard] = [false, false, false, false, performance.now()];
    [this.carried, this.jumped] = [0, -1]; // load of the task in the head, number of the last jump
    [this.info, this.jumps, this.values, this.time, this.state] = [{}, 0, {}, 0, "starting"];
    this.tell(FREE);
    this.worker = new Worker(new URL("worker.js", import.meta.url), { type: "module" });
    this.worker.onmessage = ({ data }) => this.hear(data);
    this.worker.postMessage({ address });
  }

  hear(data) {
    this.heard = performance.now();
    if ("open" in data) this.connected(data.open);
    if ("late" in data) this.late = data.late;
    if (data.late) this.onlate();
    if (data.hello) this.begin(data.hello);
    if ("jump" in data) this.jump(data.jump);
    for (const [number, first, second] of data.bins ?? []) this.history.put(number, first, second);
    if (data.frame) [this.framed] = [data.heard, this.show(data.frame)];
    if (data.info) {
      this.info = data.info;
      this.oninfo();
    }
    if (data.status) {
      this.lost &&= data.status.role === "free";
      this.tell(data.status);
    }
    if (data.answer) this.onanswer(data.answer);
  }

  connected(open) {
    this.opened = open;
    if (open) return;
    this.lost ||= this.status.role === "driving";
    const { pattern, mode, modes } = this.status; // the same machine, until it says otherwise
    this.tell({ ...FREE, pattern, mode, modes });
  }

  // the state of the controls
  tell(status) {
    if (status.live !== this.status?.live || status.role !== "driving") this.carried = 0; // a rest may have dropped it
    Object.assign(this, { status, pattern: status.pattern, mode: status.mode });
    this.onstatus();
  }

  begin(hello) {
    [this.data, this.names, this.history] = [hello, new Set(hello.names), new History(hello.charts)];
    // after an interruption of the connection the attempt goes on
    if (JSON.stringify(hello.task) !== JSON.stringify(this.task?.rules)) this.task = new Attempts(hello.task, this.task?.table);
    this.onhello();
  }

  // another part of the time of the same machine
  jump(number) {
    if (number !== this.jumped) this.task.again();
    this.jumped = number;
    this.history.clear();
    this.jumps += 1;
  }

  show([number, t, state, values]) {
    [this.time, this.state] = [t, state];
    this.values = Object.fromEntries(this.data.names.map((name, k) => [name, values[k] ?? NaN]));
    this.task.add(t, this.values);
    this.carry();
    this.onframe();
    if (number % HEARD === 0) this.do("shown", { number });
  }

  get alive() {
    return this.opened && performance.now() - this.heard < SILENT;
  }

  get driving() {
    return this.status.role === "driving" && this.alive;
  }

  // whether the machine follows the sticks
  get live() {
    return this.status.live && this.alive;
  }

  // ---- for the operator

  do(what, more = {}) {
    this.worker.postMessage({ do: what, ...more });
  }

  // the sticks, every 30 ms; nothing is said by a page that does not drive or is not seen
  steer({ sticks, deadMan }) {
    const speaks = this.driving && !document.hidden;
    if (speaks) this.worker.postMessage({ sticks, held: deadMan });
    else if (this.spoke) this.worker.postMessage({ quiet: true });
    this.spoke = speaks;
  }

  get sliders() {
    return this.data.sliders.filter(({ name }) => this.data.inputs.includes(name)).map((one) => ({ ...one, start: one.start ?? 0 }));
  }

  input(name) {
    return this.values[name];
  }

  set(name, value) {
    this.do("set", { name, value });
  }

  // what the task holds in the head, when that changes and this page drives
  carry() {
    const { load, rules } = this.task;
    if (load === this.carried || !this.driving || !this.data.inputs.includes(rules.load)) return;
    this.carried = load;
    this.set(rules.load, load);
  }

  curves() {
    return this.history.curves(this.time);
  }
}

// An FMU of FMI 3.0 for co-simulation in a browser: its C code, compiled to a WebAssembly module that exports the C
// functions, `malloc` and `free`, and imports nothing (fmus/export/compile.py).
//
// description: { identifier, token, variables: { name: value reference } }; only Float64 variables.
// log: called with (status, category, message), status as in fmi3Status. A call that fails throws with the last message.

const STATUS = ["OK", "warning", "discarded", "error", "fatal"];
const FAILED = 2; // the first status that is a failure

// A module that imports f(i32, i32, i32, i32) and exports it again: the only way to put a function of JavaScript into
// a table of WebAssembly in all browsers.
const CALLBACK = [
  0, 0x61, 0x73, 0x6d, 1, 0, 0, 0, // magic, version
  1, 8, 1, 0x60, 4, 0x7f, 0x7f, 0x7f, 0x7f, 0, // type: four i32, no result
  2, 7, 1, 1, 0x65, 1, 0x66, 0, 0, // import e.f
  7, 5, 1, 1, 0x66, 0, 0, // export f
];

export class Fmu {
  static async load(bytes, description, log = () => {}) {
    const { instance } = await WebAssembly.instantiate(bytes, {});
    return new Fmu(instance.exports, description, log);
  }

  constructor(c, description, log) {
    [this.c, this.description, this.log, this.message] = [c, description, log, ""];
    this.groups = new Map();
    c._initialize();
    const module = new WebAssembly.Module(new Uint8Array(CALLBACK));
    const report = (_, status, category, message) => this.report(status, category, message);
    const logger = c.__indirect_function_table.grow(1);
    c.__indirect_function_table.set(logger, new WebAssembly.Instance(module, { e: { f: report } }).exports.f);
    this.results = this.room(16); // of a step: three Booleans, then a time
    const texts = [description.identifier, description.token].map((text) => this.text(text));
    this.instance = c.fmi3InstantiateCoSimulation(...texts, 0, 0, 0, 0, 0, 0, 0, 0, logger, 0);
    if (!this.instance) throw new Error(this.message || `${description.identifier}: no instance`);
    this.time = 0;
  }

  // ---- simulation

  // initialize with these values, of parameters and inputs, by name; again after `reset`
  start(values = {}) {
    this.check("SetFloat64", this.set(this.group(Object.keys(values)), Object.values(values)));
    this.check("EnterInitializationMode", this.c.fmi3EnterInitializationMode(this.instance, 0, 0, 0, 0, 0));
    this.check("ExitInitializationMode", this.c.fmi3ExitInitializationMode(this.instance));
    this.time = 0;
  }

  reset() {
    this.check("Reset", this.c.fmi3Reset(this.instance));
  }

  // one communication step of `length` [s]
  step(length) {
    const flags = this.results;
    const status = this.c.fmi3DoStep(this.instance, this.time, length, 1, flags, flags + 1, flags + 2, flags + 8);
    this.check("DoStep", status);
    this.time += length;
  }

  // ---- values of several variables: the group has their references and room for their values in the memory

  group(names) {
    const key = names.join();
    if (!this.groups.has(key)) this.groups.set(key, this.made(names));
    return this.groups.get(key);
  }

  made(names) {
    const references = names.map((name) => this.description.variables[name]);
    const unknown = names.filter((_, k) => references[k] === undefined);
    if (unknown.length) throw new Error(`${this.description.identifier}: no variable ${unknown.join(", ")}`);
    const [at, values] = [this.room(4 * names.length), this.room(8 * names.length)];
    new Uint32Array(this.c.memory.buffer, at, names.length).set(references);
    return { names, at, values, count: names.length };
  }

  // Float64Array of the current values; valid until the next call
  get({ at, values, count }) {
    this.check("GetFloat64", this.c.fmi3GetFloat64(this.instance, at, count, values, count));
    return new Float64Array(this.c.memory.buffer, values, count);
  }

  set({ at, values, count }, numbers) {
    new Float64Array(this.c.memory.buffer, values, count).set(numbers);
    return this.check("SetFloat64", this.c.fmi3SetFloat64(this.instance, at, count, values, count));
  }

  // ---- memory, messages

  room(bytes) {
    const at = this.c.malloc(Math.max(bytes, 1));
    if (!at) throw new Error(`${this.description.identifier}: out of memory`);
    return at;
  }

  text(string) {
    const bytes = new TextEncoder().encode(`${string}\0`);
    const at = this.room(bytes.length);
    new Uint8Array(this.c.memory.buffer, at, bytes.length).set(bytes);
    return at;
  }

  read(at) {
    const bytes = new Uint8Array(this.c.memory.buffer, at);
    return new TextDecoder().decode(bytes.subarray(0, bytes.indexOf(0)));
  }

  report(status, category, message) {
    this.message = this.read(message);
    this.log(STATUS[status], this.read(category), this.message);
  }

  check(call, status) {
    if (status >= FAILED) throw new Error(this.message || `fmi3${call}: ${STATUS[status]}`);
    return status;
  }
}

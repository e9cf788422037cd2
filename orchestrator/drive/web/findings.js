// What a diagnosis in the machine finds, as a mechanic reads it: faults, estimates such as the payload, and what cannot
// be told now. Values are rows of `FindingTable` (findings.py): size, deviation, state, since when.
import { make, write } from "drive/panels.js";

const CERTAIN = 1.96; // deviations on both sides of a size: 95 %
const FORGETS = 500; // ms for which faults are forgotten

// a number, so that two digits count of something of this size
function rounded(value, size) {
  const digits = Math.min(8, Math.max(0, 1 - Math.floor(Math.log10(size))));
  return value.toFixed(digits).replace(/^-(?=0(\.0*)?$)/, "").replace("-", "−");
}

const measured = (text, unit) => (unit ? `${text} ${unit}` : text);

// a size with its 95 % interval, or without a deviation; empty for what is there or not
export function size(value, deviation, unit) {
  if (!(deviation > 0)) return unit && Number.isFinite(value) ? measured(rounded(value, Math.abs(value) / 10 || 1), unit) : "";
  const reach = CERTAIN * deviation;
  const [low, now, high] = [value - reach, value, value + reach].map((one) => rounded(one, reach));
  return `${measured(now, unit)} (95 %: ${low} to ${high})`;
}

// an estimate with its deviation
export function estimate(value, deviation, unit) {
  if (!Number.isFinite(value)) return "not known";
  return `${measured(rounded(value, deviation || 1), unit)} ± ${measured(rounded(deviation, deviation || 1), unit)}`;
}

// numbers of the faults, the most certain first; of equal ones the older first
export function faults(rows) {
  const certain = ([value, deviation]) => (deviation > 0 ? Math.abs(value) / deviation : Infinity);
  const order = (a, b) => (certain(rows[a]) === certain(rows[b]) ? rows[a][3] - rows[b][3] : certain(rows[b]) - certain(rows[a]));
  return [...rows.keys()].filter((k) => rows[k][2] > 0.5).sort(order);
}

// texts of what cannot be told, by repair
export function untold(findings, rows) {
  const groups = new Map();
  findings.forEach(({ text, repair }, k) => {
    if (rows[k][2] < -0.5) groups.set(repair, [...(groups.get(repair) ?? []), text]);
  });
  return [...groups];
}

export class Findings {
  // set: called with the name of an input and its value
  constructor(place, findings, forget, set) {
    Object.assign(this, { place, findings, found: [], listed: "" });
    place.hidden = !findings.length;
    this.lines = findings.map(({ repair }) => make(repair ? "li" : "p", {}, make("b"), make("span"), make("small")));
    [this.list, this.nothing] = [make("ul"), make("p", { textContent: "Nothing found." })];
    this.said = make("p", { className: "hm-hidden", role: "status", ariaLive: "polite" });
    [this.summary, this.untold] = [make("summary"), make("dl")];
    this.rest = make("details", {}, this.summary, this.untold);
    this.button = make("button", { type: "button", textContent: "Forget", title: "Forget what was found and is kept, such as a burst; with the controls" });
    this.button.addEventListener("click", () => [set(forget, 1), setTimeout(set, FORGETS, forget, 0)]);
    this.button.hidden = !forget;
    const heading = make("p", { className: "hm-line" }, make("b", { className: "hm-title", textContent: "Diagnosis" }), this.button);
    place.replaceChildren(heading, this.said, this.nothing, this.list, ...this.lines.filter((_, k) => !findings[k].repair), this.rest);
  }

  // driving: whether this page may set inputs
  show(rows, driving) {
    this.button.disabled = !driving;
    if (!rows?.length || !this.findings.length) return;
    const found = faults(rows);
    this.nothing.hidden = found.length > 0;
    if (found.join() !== this.found.join()) this.list.replaceChildren(...found.map((k) => this.lines[k]));
    const fresh = found.filter((k) => !this.found.includes(k)).map((k) => this.findings[k]);
    if (fresh.length) write(this.said, fresh.map(({ text, repair }) => `Found: ${text}. Repair: ${repair}.`).join(" "));
    this.found = found;
    this.findings.forEach(({ repair }, k) => (found.includes(k) || !repair) && this.line(k, rows[k]));
    this.list.hidden = !found.length;
    this.fold(untold(this.findings, rows));
  }

  line(k, [value, deviation, , since]) {
    const { text, repair, unit } = this.findings[k];
    const [title, number, more] = this.lines[k].children;
    write(title, repair ? text : `${text}:`);
    write(number, repair ? size(value, deviation, unit) : estimate(value ?? NaN, deviation, unit));
    write(more, repair && `since ${since.toFixed(1)} s. Repair: ${repair}`);
  }

  fold(groups) {
    const listed = JSON.stringify(groups);
    if (listed === this.listed) return;
    this.listed = listed;
    this.rest.hidden = !groups.length;
    write(this.summary, `Cannot be told now: ${groups.flatMap(([, texts]) => texts).length}`);
    this.untold.replaceChildren(...groups.flatMap(([repair, texts]) => [make("dt", { textContent: repair }), ...texts.map((textContent) => make("dd", { textContent }))]));
  }
}

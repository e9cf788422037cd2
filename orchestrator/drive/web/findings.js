// What a diagnosis in the machine finds, for a mechanic: faults, estimates, and what cannot be told now. Rows are those
// of `FindingTable` (findings.py): size, deviation, state, since when.
import { make, write } from "drive/panels.js";

const CERTAIN = 1.96; // deviations on both sides of a size: 95 %
const FORGETS = 500; // ms for which faults are forgotten

// numbers, so that two digits count of something of this size
const rounded = (size, ...values) => values.map((value) =>
  value.toFixed(Math.min(8, Math.max(0, 1 - Math.floor(Math.log10(size))))).replace(/^-(?=0(\.0*)?$)/, "").replace("-", "−"));

// a size with its 95 % interval, an estimate with its deviation; empty for what is there or not
export function size([value, deviation], { repair, unit }) {
  if (!Number.isFinite(value)) return repair ? "" : "not known";
  const [reach, end] = [CERTAIN * deviation, unit && ` ${unit}`];
  if (!reach) return unit && rounded(Math.abs(value) / 10 || 1, value) + end;
  if (!repair) return rounded(deviation, value, deviation).join(" ± ") + end;
  const [now, low, high] = rounded(reach, value, value - reach, value + reach);
  return `${now}${end} (95 %: ${low} to ${high})`;
}

// numbers of the faults, the most certain first, of those without a deviation the older
export function faults(rows) {
  const certain = ([value, deviation]) => (deviation ? Math.abs(value) / deviation : Number.MAX_VALUE);
  return [...rows.keys()].filter((k) => rows[k][2] > 0.5).sort((a, b) => certain(rows[b]) - certain(rows[a]) || rows[a][3] - rows[b][3]);
}

// texts of what cannot be told, by repair
export function untold(findings, rows) {
  const groups = Object.create(null);
  findings.forEach(({ text, repair }, k) => rows[k][2] < -0.5 && (groups[repair] ??= []).push(text));
  return Object.entries(groups);
}

export class Findings {
  // set: called with the name of an input and its value
  constructor(place, findings, forget, set) {
    Object.assign(this, { findings, found: [], listed: "" });
    [this.button, this.said, this.nothing, this.list, this.estimates, this.rest] = place.querySelectorAll(":scope > :not(b)");
    this.lines = findings.map(({ text, repair }) => make(repair ? "li" : "p", {}, make("b", { textContent: repair ? text : `${text}:` }), make("span"), make("small")));
    this.estimates.replaceChildren(...this.lines.filter((line) => line.matches("p")));
    this.button.onclick = () => [set(forget, 1), setTimeout(set, FORGETS, forget, 0)];
    [place.hidden, this.button.hidden] = [!findings.length, !forget];
  }

  // driving: whether this page may set inputs
  show(rows, driving) {
    this.button.disabled = !driving;
    if (!rows?.length || !this.findings.length) return;
    const [found, before] = [faults(rows), this.found];
    const fresh = found.filter((k) => !before.includes(k)).map((k) => this.findings[k]);
    if (fresh.length) write(this.said, fresh.map(({ text, repair }) => `Found: ${text}. Repair: ${repair}.`).join(" "));
    if (found.join() !== before.join()) this.list.replaceChildren(...found.map((k) => this.lines[k]));
    [this.found, this.nothing.hidden] = [found, found.length > 0];
    this.findings.forEach((one, k) => {
      write(this.lines[k].children[1], size(rows[k], one));
      write(this.lines[k].children[2], found.includes(k) ? `since ${rows[k][3].toFixed(1)} s. Repair: ${one.repair}` : "");
    });
    const [groups, [summary, list]] = [untold(this.findings, rows), this.rest.children];
    if (JSON.stringify(groups) === this.listed) return;
    [this.listed, this.rest.hidden] = [JSON.stringify(groups), !groups.length];
    write(summary, `Cannot be told now: ${groups.flatMap(([, texts]) => texts).length}`);
    list.replaceChildren(...groups.flatMap(([repair, texts]) => [make("dt", { textContent: repair }), ...texts.map((textContent) => make("dd", { textContent }))]));
  }
}

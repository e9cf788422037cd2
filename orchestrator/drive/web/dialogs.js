// Dialogs of `harvester view`: another machine, a result file. What there is to choose comes from the server; a dialog
// stays until what was chosen is done, and says why it is not.
import { make } from "drive/panels.js";

export class Dialogs {
  constructor(page, place) {
    [this.page, this.source] = [page, page.source];
    const button = (textContent, title, act) => make("button", { type: "button", textContent, title, onclick: act });
    place.append(
      button("Machine", "System, pose and fidelity", () => this.source.do("machines")),
      button("Replay", "Replay a result file", () => this.source.do("files")),
    );
    this.source.onanswer = (answer) => this.answer(answer);
    page.onlost = () => this.window?.open && this.refuse("no connection");
  }

  answer(answer) {
    if (answer.machines) this.machine(answer.machines);
    else if (answer.files) this.files(answer);
    else if (answer.done) this.window?.close();
    else if (answer.bad && this.window?.open) this.refuse(answer.text);
    else this.page.answer(answer);
  }

  refuse(text) {
    [this.said.textContent, this.go.disabled] = [text, false];
  }

  // fields: label -> [names by value, the chosen value]; act: called with the values
  open(title, text, fields, act) {
    const window = make("dialog", { className: "hm-window", ariaLabel: title }, make("p", { className: "hm-heading", textContent: title }));
    const selects = Object.entries(fields).map(([label, [options, value]]) => {
      const select = make("select", {}, ...Object.entries(options).map(([key, name]) => new Option(name, key)));
      select.value = value;
      window.append(make("label", { className: "hm-field" }, make("span", { textContent: label }), select));
      return [label, select];
    });
    const go = make("button", { type: "button", textContent: text, onclick: () => {
      [this.said.textContent, go.disabled] = ["", true];
      act(Object.fromEntries(selects.map(([label, select]) => [label, select.value])));
    } });
    const close = make("button", { type: "button", textContent: "Close", onclick: () => window.close() });
    const said = make("p", { className: "hm-refused", role: "alert" });
    window.append(said, make("p", { className: "hm-line" }, close, ...(text ? [go] : [])));
    Object.assign(this, { window, go, said });
    window.addEventListener("close", () => window.remove());
    this.page.root.append(window);
    window.showModal();
    return window;
  }

  machine({ systems, poses, variants, chosen }) {
    const same = (names) => Object.fromEntries(names.map((name) => [name, name]));
    const fields = { System: [same(systems), chosen.system] };
    if (poses.length) fields.Pose = [{ "": "as in the system", ...same(poses) }, chosen.pose];
    const parts = Object.entries(variants).map(([part, names]) => [part, names, `${part[0].toUpperCase()}${part.slice(1).replace("_", " and ")}`]);
    for (const [part, names, label] of parts) fields[label] = [{ ...same(names), usual: "as in the system" }, chosen.swap[part] ?? "usual"];
    this.open("Machine", "Start", fields, (values) => {
      const swap = Object.fromEntries(parts.map(([part, , label]) => [part, values[label]]));
      this.source.do("start", { system: values.System, pose: values.Pose ?? "", swap });
    });
  }

  files({ files, folders }) {
    if (files.length) {
      const fields = { File: [Object.fromEntries(files.map((name) => [name, name])), files[0]] };
      return this.open("Replay a result file", "Replay", fields, ({ File }) => location.assign(`/?replay=${encodeURIComponent(File)}`));
    }
    const text = `No .csv or .parquet file with signals of this machine in ${folders.join(", ") || "none"}`;
    this.open("Replay a result file", "", {}).querySelector(".hm-heading").after(make("p", { textContent: text }));
  }
}

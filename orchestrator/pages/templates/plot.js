// Plots that can be zoomed, drawn by uPlot from the data that figures.py has packed, on the screen and in print.
// Everything works by keys: the toolbar has buttons for zoom and for each curve, and a slider that reads the
// values at a time.
(() => {
  "use strict";
  const DIGITS = 20; // bits of a value, as in figures.py
  const NONE = 2 ** DIGITS - 1; // the place of a missing value
  const MARGIN = 0.08; // of the range of the values, above and below
  const LAST = 18; // px below the plot for ticks
  const AXIS = 62; // px beside the plot for the labels of its ticks; words take more, up to a share of the width
  const SHARE = 0.45;
  const [LETTER, GAP] = [6.2, 16]; // px of a letter of a label, and beside it
  const SUPERSCRIPT = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  const FONT = '11px system-ui, "Segoe UI", sans-serif';
  // outlines of marks in units of their size
  const ring = Array.from({ length: 13 }, (_, k) => [Math.cos((k * Math.PI) / 6), Math.sin((k * Math.PI) / 6)]);
  const SHAPES = {
    o: [ring], s: [[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9], [-0.9, -0.9]]], D: [[[0, -1.2], [1.2, 0], [0, 1.2], [-1.2, 0], [0, -1.2]]],
    "^": [[[0, -1.1], [1.1, 0.9], [-1.1, 0.9], [0, -1.1]]], v: [[[0, 1.1], [1.1, -0.9], [-1.1, -0.9], [0, 1.1]]],
    x: [[[-1, -1], [1, 1]], [[-1, 1], [1, -1]]], P: [[[-1.2, 0], [1.2, 0]], [[0, -1.2], [0, 1.2]]],
  };
  const root = document.documentElement;
  const [dark, print] = ["(prefers-color-scheme: dark)", "print"].map((query) => matchMedia(query));
  const colour = (name) => (name.startsWith("#") ? name : getComputedStyle(root).getPropertyValue(`--fig-${name}`));

  async function unpack({ columns, data }) {
    const packed = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    let at = 0;
    return columns.map(([count, low, step]) => {
      const values = new Array(count);
      for (let k = 0, place = 0; k < count; k++) {
        const one = at + k;
        place = (place + bytes[one] + (bytes[one + count] << 8) + (bytes[one + 2 * count] << 16)) & 0xffffff;
        values[k] = place === NONE ? null : low + place * step;
      }
      at += 3 * count;
      return values;
    });
  }

  function element(tag, parent, attributes = {}, text = "") {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.textContent = text;
    return parent.appendChild(made);
  }

  // 2.5e-7 as 2.5·10⁻⁷
  function typeset(value, digits) {
    const size = Math.abs(value);
    const short = size === 0 || (size >= 1e-3 && size < 1e6);
    const [mantissa, power] = (short ? String(Number(value.toPrecision(digits))) : value.toExponential(digits - 1)).split("e");
    const raised = (power ?? "").replace("+", "").replace("-", "⁻").replace(/\d/g, (d) => SUPERSCRIPT[d]);
    return (power ? `${Number(mantissa)}·10${raised}` : mantissa).replace("-", "−");
  }

  // two to `count` round values from low to high
  function splits(low, high, count) {
    const size = 10 ** Math.floor(Math.log10((high - low) / count));
    const within = [1, 2, 2.5, 5, 10].map((m) => [m * size, Math.ceil(low / (m * size) - 1e-9), Math.floor(high / (m * size) + 1e-9)]);
    const [step, first, last] = within.find(([, a, b]) => b - a >= 1 && b - a <= count) ?? within[0];
    return Array.from({ length: last - first + 1 }, (_, k) => step * (first + k));
  }

  function tick(values) {
    const step = values.length > 1 ? values[1] - values[0] : 1;
    const places = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9)) + 1;
    const largest = Math.max(...values.map(Math.abs));
    const exact = (value) => Number(value.toFixed(Math.min(places, 20)));
    const plain = places <= 5 && largest < 1e5;
    return values.map((value) => (plain ? String(exact(value)).replace("-", "−") : typeset(exact(value), 4)));
  }

  // ticks with words, whose lines have at most `letters()` letters
  function worded(words, letters) {
    const cut = (line) => (line.length > letters() ? `${line.slice(0, letters() - 1)}…` : line);
    const shown = (value) => words.get(value).split("\n").map(cut).join("\n");
    return { splits: () => [...words.keys()].sort((a, b) => a - b), values: (_, at) => at.map(shown) };
  }

  // a sample of the line, so that it is known by more than its colour
  function swatch(button, line) {
    const svg = '<svg viewBox="0 0 26 8" width="26" height="8" aria-hidden="true"><path d="M0 4h26" fill="none"/></svg>';
    button.insertAdjacentHTML("afterbegin", svg);
    const path = button.querySelector("path");
    const mark = (outline) => `M${outline.map(([x, y]) => `${13 + 3 * x} ${4 + 3 * y}`).join("L")}`;
    if (line.mark) path.setAttribute("d", SHAPES[line.mark].map(mark).join(""));
    path.style.stroke = line.colour.startsWith("#") ? line.colour : `var(--fig-${line.colour})`;
    path.setAttribute("stroke-width", line.mark ? 1.5 : Math.min(line.area || line.fill ? 8 : line.width, 6));
    if (line.dash && !line.mark) path.setAttribute("stroke-dasharray", line.dash.join(" "));
  }

  class Plot {
    constructor(host, spec, columns) {
      [this.spec, this.columns, this.charts, this.off, this.whole] = [spec, columns, [], new Set(), spec.window];
      this.range = [...this.whole];
      this.name = host.getAttribute("aria-label");
      const words = spec.charts.flatMap((chart) => (chart.words ?? []).flatMap(([, word]) => word.split("\n")));
      this.longest = Math.max(AXIS, ...words.map((word) => GAP + LETTER * word.length)); // px
      this.live = element("div", host, { class: "live" });
      host.insertBefore(this.live, host.firstChild);
      this.toolbar(this.name);
      spec.charts.forEach((chart, k) => this.chart(chart, columns, k === spec.charts.length - 1));
      element("p", this.live, { class: "axis" }, spec.axis || "time [s]");
      if (spec.below) element("p", this.live, { class: "soft below" }, spec.below);
      host.classList.add("drawn");
      new ResizeObserver(() => this.fit()).observe(this.live);
      for (const media of [dark, print]) media.addEventListener("change", () => this.charts.forEach(({ plot }) => plot.redraw(false)));
      this.read(null);
    }

    toolbar(name) {
      const bar = element("div", this.live, { class: "tools", role: "toolbar", "aria-label": `${name}: zoom and curves` });
      bar.hidden = this.spec.charts.some(({ lines }) => lines.some((line) => line.fill)); // bars need no zoom
      const button = (sign, text, act) => {
        const made = element("button", bar, { type: "button", "aria-label": text, title: text }, sign);
        made.addEventListener("click", act);
        return made;
      };
      button("+", "Zoom in", () => this.scale(0.5));
      this.wider = [
        button("−", "Zoom out", () => this.scale(2)),
        button("←", "Earlier", () => this.shift(-0.25)),
        button("→", "Later", () => this.shift(0.25)),
        button("Reset", "Reset the zoom", () => this.zoom(...this.whole)),
      ];
      this.slider = element("input", bar, { type: "range", min: 0, max: 1000, value: 0, "aria-label": "Time at which the values are read" });
      this.slider.hidden = Boolean(this.spec.axis); // curves over another quantity have places of their own
      this.slider.addEventListener("input", () => this.point(this.range[0] + (this.slider.value / 1000) * this.length));
      this.clock = element("output", bar, { class: "clock" });
      for (const entry of this.spec.key) this.toggle(bar, entry.label, entry, entry.label);
    }

    toggle(parent, text, line, id) {
      const made = element("button", parent, { type: "button", "aria-pressed": "true", class: "curve" }, text);
      swatch(made, line);
      made.addEventListener("click", () => {
        const shown = this.off.delete(id) || !this.off.add(id);
        made.setAttribute("aria-pressed", shown);
        for (const { plot, lines } of this.charts)
          if (this.spec.axis) plot.redraw(false);
          else lines.forEach((one, k) => plot.setSeries(k + 1, { show: this.shows(one) }));
      });
      return made;
    }

    // a curve is hidden by its key, or by its name in its panel
    shows(line) {
      return !this.off.has(line.key) && !this.off.has(`${line.panel} ${line.name}`);
    }

    // px beside all charts, for the longest line as far as there is room
    get beside() {
      return Math.max(AXIS, Math.min(this.longest, SHARE * (this.live.clientWidth || 600)));
    }

    get length() {
      return this.range[1] - this.range[0];
    }

    chart(chart, columns, last) {
      const head = element("div", this.live, { class: chart.strip ? "head strip" : "head" });
      if (!chart.strip) this.panel = this.charts.length;
      element("b", head, {}, chart.label);
      if (!chart.words && (chart.unit || !this.spec.axis)) element("span", head, { class: "soft" }, `[${chart.unit || "1"}]`);
      const lines = chart.lines.map((line) => ({ ...line, panel: this.panel }));
      const named = chart.strip ? [] : lines.filter((one, k) => one.name && lines.findIndex((l) => l.name === one.name) === k);
      for (const line of named) this.toggle(head, line.name, line, `${line.panel} ${line.name}`);
      const values = element("output", head, { class: "values", "aria-live": "off" });
      for (const [text, name] of chart.remarks ?? [])
        element("span", head, { class: "remark", style: `color:var(--fig-${name})` }, text);
      const place = element("div", this.live, { "aria-hidden": "true" });
      const entry = { chart, lines, values, last };
      this.charts.push(entry);
      const data = this.spec.axis ? [this.whole, [null, null]] : [columns[chart.time], ...lines.map((line) => columns[line.column])];
      entry.plot = new uPlot(this.options(entry), data, place);
      const whole = (chart.words ?? []).map(([, word]) => word.replace("\n", " ")).join("\n");
      if (whole) [...place.querySelectorAll(".u-axis")].at(-1).title = whole; // a chart without ticks below has this axis alone
    }

    options(entry) {
      const { chart, lines, last } = entry;
      const line = (one) => ({
        stroke: one.area ? "transparent" : () => colour(one.colour),
        width: one.width, dash: one.dash, alpha: one.alpha ?? 1, points: { show: false }, spanGaps: false,
      });
      const edges = lines.flatMap((one, k) => (one.area ? [k] : [])); // lower, upper, lower, upper ...
      const areas = edges.filter((_, n) => n % 2 === 0);
      const axis = { stroke: () => colour("ink"), font: FONT, grid: { stroke: () => colour("grid"), width: 1 }, ticks: { show: false } };
      return {
        width: this.live.clientWidth || 600,
        height: Math.max(chart.strip ? 64 : 96, 46 * chart.height) + (last ? LAST : 0),
        padding: [6, 8, last ? 0 : 6, 0],
        legend: { show: false },
        cursor: {
          sync: { key: this.name, setSeries: false, scales: ["x", null] },
          drag: { x: true, y: false, setScale: false },
          y: false,
          bind: { dblclick: () => () => this.zoom(...this.whole) },
          points: { size: 5 },
        },
        scales: { x: { time: false, range: () => this.range }, y: { range: (_, low, high) => this.limits(chart, chart.low ?? low, chart.high ?? high) } },
        series: [{}, ...(this.spec.axis ? [{}] : lines.map(line))],
        bands: areas.map((k) => ({ series: [k + 2, k + 1], fill: () => `color-mix(in srgb, ${colour(lines[k].colour)} 40%, transparent)` })),
        axes: [
          { ...axis, size: last ? LAST : 0, ...this.places(last) },
          { ...axis, size: () => this.beside, ...(chart.words ? worded(new Map(chart.words), () => Math.floor((this.beside - GAP) / LETTER)) : { splits: (_, __, low, high) => splits(low, high, chart.strip ? 3 : 5), values: (_, at) => (chart.log ? at.map((power) => typeset(10 ** power, 2)) : tick(at)) }) },
        ],
        hooks: {
          drawAxes: [(plot) => this.bounds(plot, chart)],
          draw: [(plot) => this.spec.axis && this.curves(plot, lines)],
          setSelect: [(plot) => this.selected(plot)],
          setCursor: [(plot) => plot.cursor.event && this.read(plot.cursor.idx === null ? null : plot.posToVal(plot.cursor.left, "x"))],
        },
      };
    }

    // ticks of the common axis, whose labels are below the last chart; a short logarithmic one has round values
    places(last) {
      const ticks = new Map(this.spec.ticks ?? []);
      const values = (at) => (at.every((one) => ticks.has(one)) ? at.map((one) => ticks.get(one)) : tick(at.map((one) => this.value(one))));
      return {
        splits: (plot, _, low, high) => {
          const inside = [...ticks.keys()].filter((at) => at >= low && at <= high);
          if (inside.length > 1) return inside;
          const round = splits(this.value(low), this.value(high), Math.max(2, Math.floor(plot.width / 90)));
          return ticks.size ? round.map(Math.log10) : round;
        },
        values: (_, at) => (last ? values(at) : at.map(() => "")),
      };
    }

    // the value at a place on the common axis
    value(place) {
      return this.spec.ticks ? 10 ** place : place;
    }

    limits(chart, low, high) {
      if (low === null || !Number.isFinite(low)) return [-1, 1];
      const margin = MARGIN * (high - low) || 0.1 * Math.abs(high) || 1;
      const largest = chart.whole ? 1.2 * Math.max(0, ...chart.bounds) : 0;
      const end = Math.max(Math.abs(low) + margin, Math.abs(high) + margin, largest);
      return chart.strip ? [-end, end] : [low - margin, high + margin];
    }

    bounds(plot, chart) {
      const { left, top, width, height } = plot.bbox;
      for (const bound of chart.bounds ?? []) {
        if (bound >= plot.scales.y.max) continue;
        const high = plot.valToPos(bound, "y", true);
        plot.ctx.fillStyle = `color-mix(in srgb, ${colour("good")} 14%, transparent)`;
        plot.ctx.fillRect(left, Math.max(top, high), width, Math.min(plot.valToPos(-bound, "y", true) - high, height));
      }
    }

    // curves and marks that have places of their own, with error bars
    curves(plot, lines) {
      const { left, top, width, height } = plot.bbox;
      const [ctx, pixel] = [plot.ctx, devicePixelRatio];
      const at = (column, axis) => this.columns[column].map((value) => (value === null ? null : plot.valToPos(value, axis, true)));
      ctx.save();
      ctx.beginPath();
      ctx.rect(left, top, width, height);
      ctx.clip();
      for (const line of lines.filter((one) => this.shows(one))) {
        const [xs, ys] = [at(line.x, "x"), at(line.column, "y")];
        ctx.strokeStyle = ctx.fillStyle = colour(line.colour);
        ctx.globalAlpha = line.alpha ?? 1;
        ctx.lineWidth = Math.min(line.width, line.mark ? 1.4 : 6) * pixel;
        ctx.setLineDash((line.dash ?? []).map((length) => (line.mark ? 0 : length * pixel)).filter(Boolean));
        ctx.beginPath();
        const path = (points) => points.forEach(([x, y], k) => y !== null && ctx[k && points[k - 1][1] !== null ? "lineTo" : "moveTo"](x, y));
        const points = xs.map((x, k) => [x, ys[k]]);
        const drawn = points.filter(([, y]) => y !== null);
        if (line.mark) for (const [x, y] of drawn) SHAPES[line.mark].forEach((outline) => path(outline.map(([a, b]) => [x + 3 * a * pixel, y + 3 * b * pixel])));
        else path(points);
        if (line.fill || (line.mark && !line.hollow)) ctx.fill();
        const [lows, highs] = line.low === undefined ? [[], []] : [at(line.low, "y"), at(line.high, "y")];
        lows.forEach((low, k) => ys[k] !== null && path([[xs[k], low ?? top + height], [xs[k], highs[k] ?? ys[k]]]));
        ctx.stroke();
      }
      ctx.restore();
    }

    selected(plot) {
      const { left, width } = plot.select;
      if (width > 4) this.zoom(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
      plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    }

    scale(factor) {
      const middle = (this.range[0] + this.range[1]) / 2;
      this.zoom(middle - (factor * this.length) / 2, middle + (factor * this.length) / 2);
    }

    shift(share) {
      const [low, high] = this.whole;
      const by = Math.max(low - this.range[0], Math.min(high - this.range[1], share * this.length));
      this.zoom(this.range[0] + by, this.range[1] + by);
    }

    zoom(low, high) {
      this.range = [Math.max(low, this.whole[0]), Math.min(high, this.whole[1])];
      this.charts.forEach(({ plot }) => plot.setScale("x", { min: this.range[0], max: this.range[1] }));
      this.read(null);
    }

    // the values at a time, as by the mouse
    point(time) {
      const { plot } = this.charts[0];
      this.charts.forEach((one) => one.plot.setCursor({ left: plot.valToPos(time, "x"), top: 0 }, false));
      this.read(time);
    }

    read(time) {
      const [low, high] = this.range;
      const text = (place) => typeset(this.value(place), 4);
      const at = time !== null && (this.spec.axis ? text(time) : `t = ${time.toFixed(3)} s`);
      this.clock.textContent = at || `${text(low)} to ${text(high)}${this.spec.axis ? "" : " s"}`;
      if (time !== null) this.slider.value = (1000 * (time - low)) / this.length;
      this.slider.setAttribute("aria-valuetext", this.clock.textContent);
      for (const { plot, lines, values } of this.spec.axis ? [] : this.charts) {
        const at = time === null ? null : plot.valToIdx(time);
        const shown = lines.map((line, k) => [line, at === null ? null : plot.data[k + 1][at]]).filter(([line, value]) => value !== null && !line.area && this.shows(line));
        values.textContent = shown.map(([line, value]) => [[line.name, line.key].filter(Boolean).join(" "), typeset(value, 4)].filter(Boolean).join(" ")).join("; ");
      }
    }

    fit() {
      const width = this.live.clientWidth;
      if (width > 0) this.charts.forEach(({ plot }) => plot.width !== width && plot.setSize({ width, height: plot.height }));
    }
  }

  async function draw(target) {
    if (target.begun) return;
    target.begun = true;
    const spec = JSON.parse(target.querySelector("script").textContent);
    target.plot = new Plot(target, spec, await unpack(spec));
  }

  // those near the window first, because a page may have many; the others, for print, as soon as there is time
  const near = new IntersectionObserver((entries) => entries.forEach((entry) => entry.isIntersecting && draw(entry.target)), { rootMargin: "800px" });
  const later = window.requestIdleCallback ?? ((act) => setTimeout(act, 200));
  if (typeof DecompressionStream === "function") {
    const hosts = [...document.querySelectorAll(".plot")];
    hosts.forEach((host) => near.observe(host));
    const next = async () => {
      const host = hosts.shift();
      if (!host) return;
      if (host.checkVisibility?.() !== false) await draw(host); // a folded one has no width
      later(next);
    };
    later(next);
  }
})();

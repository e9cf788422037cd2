// Animation of the machine: draws the polylines of each view at the frames in `data`, metres scaled to the view.
const data = JSON.parse(document.getElementById("motion-data").textContent);
const SVG = document.createElementNS.bind(document, document.documentElement.querySelector("svg").namespaceURI);
const count = data.views.side[0].length;
const slider = document.getElementById("moment"), button = document.getElementById("play");
const speed = document.getElementById("speed"), clock = document.getElementById("clock");
const distance = document.getElementById("distance");
let moment = 0, running = false, before = 0;

function line(parent, style) {
  const polyline = SVG("polyline");
  polyline.setAttribute("class", style);
  return parent.appendChild(polyline);
}

function dot(parent, style) {
  const circle = SVG("circle");
  circle.setAttribute("class", style);
  circle.setAttribute("r", 4.5);
  return parent.appendChild(circle);
}

function view(name) {
  const svg = document.getElementById(name), [left, right, low, high] = data.bounds[name];
  const scale = Math.min(520 / (right - left), 320 / (high - low));
  const x = v => ((v - (left + right) / 2) * scale + 270).toFixed(1);
  const y = v => (170 - (v - (low + high) / 2) * scale).toFixed(1);
  const at = (frame, k) => x(frame[2 * k]) + "," + y(frame[2 * k + 1]);
  line(svg, "ground").setAttribute("points", name === "side" ? `0,${y(data.ground)} 540,${y(data.ground)}`
    : `${x(0) - 8},${y(0)} ${+x(0) + 8},${y(0)} ${x(0)},${y(0)} ${x(0)},${y(0) - 8} ${x(0)},${+y(0) + 8}`);
  const trail = line(svg, "trail");
  const styles = ["machine", "ghost"].slice(0, data.views[name].length);
  const bodies = styles.map((style, m) => [m, data.lines.map(labels => [labels, line(svg, style)])]).reverse();
  bodies[bodies.length - 1][1].forEach(([, polyline]) => svg.appendChild(polyline));
  const joints = data.labels.map(() => dot(svg, "joint"));
  return now => {
    const path = [];
    for (let n = Math.max(0, now - 250); n <= now; n++) path.push(at(data.views[name][0][n], data.tip));
    trail.setAttribute("points", path.join(" "));
    for (const [m, parts] of bodies)
      for (const [labels, polyline] of parts)
        polyline.setAttribute("points", labels.map(k => at(data.views[name][m][now], k)).join(" "));
    joints.forEach((joint, k) => {
      [joint.cx.baseVal.value, joint.cy.baseVal.value] = at(data.views[name][0][now], k).split(",");
    });
  };
}

const views = Object.keys(data.views).map(view);

function show() {
  const now = Math.max(0, Math.min(count - 1, Math.floor(moment)));
  views.forEach(draw => draw(now));
  slider.value = now;
  clock.textContent = (data.start + now * data.step).toFixed(2) + " s";
  if (data.deviation) distance.textContent = data.deviation[now].toFixed(1) + " mm";
}

function tick(stamp) {
  if (!running) return;
  moment += (stamp - before) / 1000 / data.step * Number(speed.value);
  before = stamp;
  if (moment >= count - 1) moment = 0;
  show();
  requestAnimationFrame(tick);
}

function play(on) {
  running = on;
  button.textContent = on ? "Pause" : "Play";
  before = performance.now();
  if (on) requestAnimationFrame(tick);
}

slider.max = count - 1;
slider.addEventListener("input", () => { moment = Number(slider.value); show(); });
button.addEventListener("click", () => play(!running));
show();

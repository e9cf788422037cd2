// The machine as meshes: built once from the parts, then moved and coloured by a few numbers per frame.
import * as THREE from "three";

const TRAIL = 240; // points of the tip's path
const NEAR = 7; // m; from which the tip is looked at

function body(part) {
  const [a, b, c] = part.size;
  if (part.kind === "box") return new THREE.BoxGeometry(a, b, c).translate(...part.at);
  if (part.kind === "tube") {
    const curve = new THREE.CatmullRomCurve3(part.path.map((p) => new THREE.Vector3(...p)));
    return new THREE.TubeGeometry(curve, 3 * part.path.length, a, 6);
  }
  if (part.kind === "plate") {
    const shape = new THREE.Shape(part.path.map(([x, z]) => new THREE.Vector2(x, z)));
    const edge = Math.min(0.012, a / 4);
    const bevel = { bevelThickness: edge, bevelSize: edge, bevelSegments: 1 };
    const solid = new THREE.ExtrudeGeometry(shape, { depth: a - 2 * edge, ...bevel });
    return solid.rotateX(Math.PI / 2).translate(part.at[0], part.at[1] + a / 2 - edge, part.at[2]);
  }
  const round = new THREE.CylinderGeometry(b, a, c, a < 0.1 ? 12 : 24).translate(0, c / 2, 0);
  if (part.axis === "x") round.rotateZ(-Math.PI / 2);
  if (part.axis === "z") round.rotateX(Math.PI / 2);
  return round.translate(...part.at);
}

// One geometry of many bodies, their colours in the corners: fewer calls to draw.
function merged(parts) {
  const whole = new THREE.BufferGeometry();
  const bodies = parts.map(body);
  const put = (name, numbers) => whole.setAttribute(name, new THREE.BufferAttribute(new Float32Array(numbers), 3));
  for (const name of ["position", "normal"]) put(name, bodies.flatMap((g) => Array.from(g.attributes[name].array)));
  const count = (g) => g.attributes.position.count;
  const paint = (part, k) => Array(count(bodies[k])).fill(new THREE.Color(part.channel ? "#fff" : part.colour).toArray());
  put("color", parts.flatMap(paint).flat());
  let first = 0;
  const index = bodies.flatMap((g) => {
    const own = g.index ? Array.from(g.index.array) : Array.from({ length: count(g) }, (_, k) => k);
    first += count(g);
    return own.map((k) => k + first - count(g));
  });
  whole.setIndex(index);
  return whole;
}

// Everything flattened along the sun's rays onto the ground.
function flattening(ground, sun) {
  const [x, y, z] = sun;
  const [u, v, low] = [x / z, y / z, ground + 0.012];
  return new THREE.Matrix4().set(1, 0, -u, ground * u, 0, 1, -v, ground * v, 0, 0, 0, low, 0, 0, 0, 1);
}

// Position x, z [m], pitch and roll [rad] of each node in the frame of the column, and the end of the stick in space.
// angles: swing, boom, stick, head in the plane of the arm and out of it [rad]; g: `geometry.Geometry` [m]
export function pose([swing, boom, stick, head, side], g) {
  const to = ([x, z, pitch], along, across = 0) => {
    const [cos, sin] = [Math.cos(pitch), Math.sin(pitch)];
    return [x + along * cos - across * sin, z + along * sin + across * cos];
  };
  const cylinder = (base, pin) => {
    const along = Math.atan2(pin[1] - base[1], pin[0] - base[0]);
    return [[...base, along, 0], [...pin, along, 0]];
  };
  const first = [g.boom_pivot_x, g.boom_pivot_z, boom, 0];
  const elbow = to(first, g.stick_pivot_x, g.stick_pivot_z);
  const second = [...elbow, boom + stick, 0];
  const tip = to(second, g.stick_length);
  const foot = to([g.boom_pivot_x, g.boom_pivot_z, 0], g.boom_base_x, g.boom_base_z);
  const [boom_barrel, boom_rod] = cylinder(foot, to(first, g.boom_pin_x, g.boom_pin_z));
  const base = to([...elbow, boom], g.stick_base_x, g.stick_base_z);
  const [stick_barrel, stick_rod] = cylinder(base, to(second, g.stick_pin_x, g.stick_pin_z));
  const links = { boom: first, stick: second, yoke: [...tip, head, 0], head: [...tip, head, side] };
  const point = [tip[0] * Math.cos(swing), tip[0] * Math.sin(swing), tip[1]];
  return { swing, tip: point, nodes: { ...links, boom_barrel, boom_rod, stick_barrel, stick_rod } };
}

export class Rig {
  // stage: camera, controls, and the element of the picture with `redraw`; shade: colour of the shadow
  constructor(stage, data, shade) {
    [this.stage, this.data] = [stage, data];
    this.materials = new Map();
    this.nodes = new Map();
    this.root = new THREE.Group();
    this.shadow = new THREE.Group();
    this.shadow.matrix.copy(flattening(data.ground, data.sun));
    this.shadow.matrixAutoUpdate = false;
    this.shadow.userData.extra = true;
    this.ink = new THREE.MeshBasicMaterial({ color: shade, side: THREE.DoubleSide, fog: false });
    this.line = this.trail();
    this.root.add(this.shadow, this.line);
    for (const name of ["site", "column", ...data.nodes]) this.node(name);
  }

  // of a pressure; of everything else, whose colours never change, the one of the name ""
  material(channel) {
    if (!this.materials.has(channel)) {
      this.materials.set(channel, new THREE.MeshLambertMaterial({ vertexColors: true, fog: false }));
    }
    return this.materials.get(channel);
  }

  node(name) {
    const [group, dark] = [new THREE.Group(), new THREE.Group()];
    const own = this.data.parts.filter((p) => p.node === name);
    for (const channel of new Set(own.map((p) => p.channel))) {
      const parts = own.filter((p) => p.channel === channel);
      group.add(new THREE.Mesh(merged(parts), this.material(channel)));
    }
    const large = own.filter((p) => p.kind !== "tube" && !(p.kind === "round" && p.size[0] < 0.07));
    if (large.length) dark.add(new THREE.Mesh(merged(large), this.ink));
    for (const one of [group, dark]) one.rotation.order = "YXZ";
    const inside = this.nodes.get("column") ?? [this.root, this.shadow];
    const parents = name === "site" || name === "column" ? [this.root, this.shadow] : inside;
    parents[0].add(group);
    parents[1].add(dark);
    this.nodes.set(name, [group, dark]);
  }

  trail() {
    const geometry = new THREE.BufferGeometry();
    const colours = new Float32Array(4 * TRAIL).map((_, k) => (k % 4 === 3 ? (k / (4 * TRAIL)) ** 0.7 : [0.84, 0.29, 0.08][k % 4]));
    this.path = new THREE.BufferAttribute(new Float32Array(3 * TRAIL), 3);
    geometry.setAttribute("position", this.path);
    geometry.setAttribute("color", new THREE.BufferAttribute(colours, 4));
    const line = new THREE.Line(geometry, new THREE.LineBasicMaterial({ vertexColors: true, transparent: true }));
    line.frustumCulled = false;
    return line;
  }

  follow(tip, again) {
    const points = this.path.array;
    const far = Math.hypot(...tip.map((v, k) => v - points[points.length - 3 + k]));
    if (again || !this.begun || far > 2) {
      for (let k = 0; k < points.length; k += 3) points.set(tip, k);
      this.begun = true;
    } else if (far > 0.03) {
      points.copyWithin(0, 3);
      points.set(tip, points.length - 3);
    }
    this.path.needsUpdate = true;
  }

  // the view goes with the tip from now on, or stays where it is
  track(on) {
    this.tracked = on;
    if (!on) return;
    const { stage } = this;
    const away = stage.camera.position.clone().sub(stage.controls.target).setLength(NEAR);
    this.shift(stage);
    stage.camera.position.copy(stage.controls.target).add(away);
    stage.controls.update();
  }

  shift({ camera, controls }) {
    const points = this.path.array;
    const way = new THREE.Vector3(...(this.tip ?? points.slice(-3))).sub(controls.target);
    camera.position.add(way);
    controls.target.add(way);
    controls.update();
  }

  // angles: as for `pose`; colours: channel -> colour, of those that changed; again: begin a new trail
  show(angles, colours, again) {
    const { swing, tip, nodes } = pose(angles, this.data.sizes);
    for (const one of this.nodes.get("column")) one.rotation.z = swing;
    for (const name of this.data.nodes) {
      const [x, z, pitch, roll] = nodes[name];
      for (const one of this.nodes.get(name)) {
        one.position.set(x, 0, z);
        one.rotation.set(roll, -pitch, 0);
      }
    }
    for (const [name, colour] of Object.entries(colours)) this.materials.get(name)?.color.set(colour);
    this.tip = tip;
    this.follow(this.tip, again);
    if (this.tracked) this.shift(this.stage);
  }
}

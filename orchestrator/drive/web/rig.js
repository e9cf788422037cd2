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
  if (part.kind === "mesh") {
    const solid = new THREE.BufferGeometry();
    const numbers = (text, Kind) => new Kind(Uint8Array.from(atob(text), (one) => one.charCodeAt(0)).buffer);
    solid.setAttribute("position", new THREE.BufferAttribute(numbers(part.points, Float32Array), 3));
    solid.setIndex(new THREE.BufferAttribute(numbers(part.corners, Uint32Array), 1));
    solid.computeVertexNormals();
    return solid.translate(...part.at);
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

// Place of each body in space as a matrix, and the tip. values: of the joints, in their order [rad, m]; machine: as
// `data` of scene.py has it
export function pose(values, { joints, cylinders, tip }) {
  const bodies = new Map([["ground", new THREE.Matrix4()]]);
  const point = ({ body, at }) => new THREE.Vector3(...at).applyMatrix4(bodies.get(body));
  joints.forEach(({ body, parent, frame, at, axis, slides }, k) => {
    const along = new THREE.Vector3(...axis);
    const moved = slides
      ? new THREE.Matrix4().makeTranslation(along.multiplyScalar(values[k]))
      : new THREE.Matrix4().makeRotationAxis(along, values[k]);
    bodies.set(body, bodies.get(frame).clone().setPosition(point({ body: parent, at })).multiply(moved));
  });
  for (const { name, base, pin } of cylinders) {
    const [begin, end] = [point(base), point(pin)];
    const x = end.clone().sub(begin).normalize();
    const z = x.clone().cross(new THREE.Vector3().setFromMatrixColumn(bodies.get(base.body), 1)).normalize();
    const turned = new THREE.Matrix4().makeBasis(x, z.clone().cross(x), z);
    bodies.set(`${name}_barrel`, turned.clone().setPosition(begin)).set(`${name}_rod`, turned.setPosition(end));
  }
  return { tip: point(tip).toArray(), bodies };
}

export class Rig {
  // stage: camera, controls, and the element of the picture with `redraw`; shade: colour of the shadow
  constructor(stage, data, shade) {
    [this.stage, this.data] = [stage, data];
    this.materials = new Map();
    this.bodies = new Map();
    this.root = new THREE.Group();
    this.shadow = new THREE.Group();
    this.shadow.matrix.copy(flattening(data.ground, data.sun));
    this.shadow.matrixAutoUpdate = false;
    this.shadow.userData.extra = true;
    this.ink = new THREE.MeshBasicMaterial({ color: shade, side: THREE.DoubleSide, fog: false });
    this.line = this.trail();
    this.root.add(this.shadow, this.line);
    for (const name of pose(data.joints.map(() => 0), data).bodies.keys()) this.body(name);
  }

  // of a pressure; of everything else, whose colours never change, the one of the name ""
  material(channel) {
    if (!this.materials.has(channel)) {
      this.materials.set(channel, new THREE.MeshLambertMaterial({ vertexColors: true, fog: false }));
    }
    return this.materials.get(channel);
  }

  body(name) {
    const [group, dark] = [new THREE.Group(), new THREE.Group()];
    const own = this.data.shapes.filter((p) => p.body === name);
    for (const channel of new Set(own.map((p) => p.channel))) {
      const parts = own.filter((p) => p.channel === channel);
      group.add(new THREE.Mesh(merged(parts), this.material(channel)));
    }
    const large = own.filter((p) => p.kind !== "tube" && !(p.kind === "round" && p.size[0] < 0.07));
    if (large.length) dark.add(new THREE.Mesh(merged(large), this.ink));
    this.root.add(group);
    this.shadow.add(dark);
    this.bodies.set(name, [group, dark]);
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

  // values: as for `pose`; colours: channel -> colour, of those that changed; again: begin a new trail
  show(values, colours, again) {
    const { tip, bodies } = pose(values, this.data);
    for (const [name, place] of bodies)
      for (const one of this.bodies.get(name)) place.decompose(one.position, one.quaternion, one.scale);
    for (const [name, colour] of Object.entries(colours)) this.materials.get(name)?.color.set(colour);
    this.tip = tip;
    this.points = [...this.data.joints.map(({ body }) => new THREE.Vector3().setFromMatrixPosition(bodies.get(body))), new THREE.Vector3(...tip)];
    this.follow(this.tip, again);
    if (this.tracked) this.shift(this.stage);
  }
}

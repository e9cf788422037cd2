// The machine in space: the picture of a pose, with the reference as a ghost and the rings of a task.
import * as THREE from "three";
import { Brush } from "drive/brush.js";
import { Rig } from "drive/rig.js";

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
const LAYERS = [0, 1, 2]; // of the branches of a tree
const TREES = 46;
const GOLDEN = Math.PI * (3 - Math.sqrt(5)); // rad; the golden angle spreads points evenly
const FIELD = 34; // degrees
const TIP = "tip"; // the view that follows the tip
const EDGE = 0.9; // share of the half picture that the machine may fill before the camera moves away
const AWAY = 0.04; // share of the distance by which it moves in a picture, at most
const FARTHEST = 3; // of the distance that the view begins with

export class Scene {
  constructor(place, data, ghost = false) {
    [this.data, this.place, this.colours, this.marked] = [data, place, {}, ""];
    const renderer = rendererOf();
    const camera = new THREE.PerspectiveCamera(FIELD, 1, 0.3, 200);
    camera.up.set(0, 0, 1);
    place.replaceChildren(renderer.domElement);
    const controls = new THREE.OrbitControls(camera, renderer.domElement);
    this.stage = { renderer, camera, controls, element: place, scene: new THREE.Scene() };
    controls.addEventListener("start", () => (this.kept = false)); // the visitor has the camera
    this.brush = new Brush(this.stage);
    this.scheme = dark(place) ? "dark" : "light";
    const { machine, shade } = data;
    const moving = { ...machine, shapes: machine.shapes.filter(({ body }) => body !== "ground") };
    if (ghost) this.ghost = this.add(new Rig(this.stage, moving, shade[this.scheme]));
    this.rig = this.add(new Rig(this.stage, machine, shade[this.scheme]));
    if (ghost) this.fade();
    this.marks = new THREE.Group();
    this.stage.scene.add(this.marks);
    this.ground();
    this.look(this.views[0]);
    this.observer = new ResizeObserver(() => this.fit());
    this.observer.observe(place);
    this.fit();
  }

  // in a page that others scroll, the wheel and fingers scroll it
  embed() {
    this.stage.controls.enableZoom = false; // two fingers and Ctrl + wheel are the browser's
    this.stage.renderer.domElement.style.touchAction = "pan-y";
  }

  close() {
    this.observer.disconnect();
    this.stage.controls.dispose();
    this.stage.renderer.dispose();
    this.stage.renderer.forceContextLoss();
    this.place.replaceChildren();
  }

  add(rig) {
    this.stage.scene.add(rig.root);
    return rig;
  }

  // the reference: transparent and of one colour, without shadow and trail; behind the machine where they agree
  fade() {
    const colour = new THREE.Color("#e69f00");
    const behind = { polygonOffset: true, polygonOffsetFactor: 4, polygonOffsetUnits: 40, depthWrite: false };
    for (const material of this.ghost.materials.values())
      Object.assign(material, { vertexColors: false, color: colour, transparent: true, opacity: 0.45, ...behind });
    this.ghost.shadow.visible = this.ghost.line.visible = false;
    this.ghost.materials = new Map(); // pressures do not colour it
  }

  ground() {
    if (this.floor) this.stage.scene.remove(this.floor);
    const colours = this.data.ground[this.scheme];
    this.floor = surroundings(colours);
    this.stage.scene.fog = new THREE.Fog(colours.sky, 22, 62);
    this.stage.scene.background = new THREE.Color(colours.sky);
    this.stage.scene.add(this.floor);
    this.rig.ink.color.set(this.data.shade[this.scheme]);
  }

  // after a change of the colour scheme
  recolour() {
    const scheme = dark(this.place) ? "dark" : "light";
    if (scheme === this.scheme) return;
    this.scheme = scheme;
    this.ground();
    this.brush.redraw();
  }

  get views() {
    return [...Object.keys(this.data.views), TIP];
  }

  look(name) {
    this.rig.track(name === TIP);
    if (name !== TIP) {
      const [x, y, z, ...target] = this.data.views[name];
      this.stage.camera.position.set(x, y, z);
      this.stage.controls.target.set(...target);
      this.stage.controls.update();
    }
    [this.kept, this.distance] = [name !== TIP, this.stage.controls.getDistance()];
    this.brush.redraw();
  }

  // the camera moves away while a joint or the tip is near the edge of a picture in which the first joint is; in the
  // views from the cab and of the tip it is not
  keep() {
    const { camera, controls } = this.stage;
    if (!this.kept || controls.getDistance() > FARTHEST * this.distance) return;
    camera.updateMatrixWorld();
    const [first, ...others] = this.rig.points.map((point) => {
      const seen = point.clone().project(camera);
      return Math.max(Math.abs(seen.x), Math.abs(seen.y));
    });
    const share = Math.max(...others);
    if (first > EDGE || share <= EDGE) return;
    const factor = Math.min(share / EDGE, 1 + AWAY);
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
  }

  fit() {
    const { clientWidth: width, clientHeight: height } = this.place;
    if (!width || !height) return;
    this.stage.renderer.setSize(width, height);
    this.stage.camera.aspect = width / height;
    this.stage.camera.updateProjectionMatrix();
    this.brush.redraw();
  }

  // angles: values of the joints; colours: channel -> colour; again: the trail begins anew; reference: angles of the ghost
  show(angles, colours, again, reference = null) {
    const changed = Object.entries(colours).filter(([name, colour]) => this.colours[name] !== colour);
    this.colours = { ...colours };
    this.rig.show(angles, Object.fromEntries(changed), again);
    this.keep();
    if (this.ghost) this.ghost.root.visible = Boolean(reference);
    if (reference) this.ghost?.show(reference, {}, true);
    this.brush.redraw();
  }

  // targets of a task: a ring in space, on a staff from the ground
  mark(rings) {
    const key = JSON.stringify(rings);
    if (key === this.marked) return;
    this.marked = key;
    this.marks.clear();
    for (const ring of rings) this.marks.add(...mark(ring, this.data.level));
    this.brush.redraw();
  }
}

function mark({ at: [x, y, z], radius, colour, strong }, ground) {
  const paint = new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: strong ? 0.95 : 0.6 });
  const ring = new THREE.Mesh(new THREE.TorusGeometry(radius, 0.03, 6, 28), paint);
  const staff = new THREE.Mesh(new THREE.CylinderGeometry(0.014, 0.014, z - ground, 6), paint);
  const foot = new THREE.Mesh(new THREE.RingGeometry(0.8 * radius, radius, 28), paint);
  const dot = new THREE.Mesh(new THREE.SphereGeometry(0.05, 10, 8), paint);
  for (const one of [ring, dot]) one.position.set(x, y, z);
  staff.rotation.x = Math.PI / 2;
  staff.position.set(x, y, (z + ground) / 2);
  foot.position.set(x, y, ground + 0.02);
  return [ring, dot, staff, foot];
}

// ground, grid, trees and light; nothing of it moves
function surroundings(data) {
  const sun = new THREE.DirectionalLight(0xfff6e8, 2.0);
  sun.position.set(...data.sun);
  const [root, low] = [new THREE.Group(), new THREE.Group()];
  low.position.z = data.ground;
  const grid = new THREE.GridHelper(48, 48, data.axis, data.grid).rotateX(Math.PI / 2);
  grid.position.z = 0.006;
  const floor = new THREE.Mesh(new THREE.CircleGeometry(90, 48), new THREE.MeshBasicMaterial({ color: data.floor }));
  low.add(forest(), floor, grid);
  root.add(new THREE.HemisphereLight(0xffffff, 0xaab0a4, 2.1), sun, low);
  return root;
}

// trees around the machine, 13 to 32 m away
function forest() {
  const trees = Array.from({ length: TREES }, (_, k) => {
    const [angle, away, size] = [k * GOLDEN, 13 + 19 * Math.sqrt((k + 0.5) / TREES), 0.75 + (0.5 * ((k * 7) % 11)) / 10];
    return [away * Math.cos(angle), away * Math.sin(angle), 7.5 * size, 1.5 * size];
  });
  const crowns = new THREE.ConeGeometry(1, 1, 6, 1, true).rotateX(Math.PI / 2).translate(0, 0, 0.5);
  const many = new THREE.InstancedMesh(crowns, new THREE.MeshLambertMaterial({ flatShading: true }), LAYERS.length * trees.length);
  trees.forEach(([x, y, height, radius], k) => {
    for (const layer of LAYERS) {
      const wide = radius * (1 - 0.27 * layer);
      const place = new THREE.Matrix4().makeScale(wide, wide, 0.5 * height);
      place.setPosition(x, y, height * (0.06 + 0.22 * layer));
      many.setMatrixAt(LAYERS.length * k + layer, place);
      many.setColorAt(LAYERS.length * k + layer, new THREE.Color().setHSL(0.38, 0.22, 0.27 + 0.05 * layer + 0.02 * (k % 4)));
    }
  });
  many.userData.extra = true;
  return many;
}

// whether the page is dark where this element is: by the setting of the browser, or by a switch of the site
export function dark(element) {
  const [red] = getComputedStyle(element).color.match(/[\d.]+/g); // of the ink: grey
  return Number(red) > 128;
}

function rendererOf() {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("webgl2", { alpha: true, antialias: false });
  if (!context) throw new Error("this browser offers no WebGL");
  const names = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : context.RENDERER);
  if (SOFTWARE.test(name ?? "")) return new THREE.WebGLRenderer({ canvas, context });
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return new THREE.WebGLRenderer({ antialias: true });
}

// Draws only when something has moved, one picture at a time, and rests as long as it took: where the processor
// itself draws, it is shared with the machine. Where that is slow, fewer pixels do.
import { THREE } from "nicegui-scene";

const LEVELS = [2, 1, 0.75, 0.55]; // pixels drawn per pixel of the page; the first up to those of the screen
const SLOW = 40; // ms for a picture; above it fewer pixels
const FAST = 14; // ms; below it more: the next level takes less than twice as long
const LONGEST = 250; // ms of rest
const FIRST = 4; // pictures that are slow in any case: programs of the graphics are made
const MEAN = 3; // level, without trees and shadow, that a driver is given whose page let a message go late
const WIDE = 1.35; // width over height from which on the height counts; below it the whole arm must still be in sight

export default class Brush {
  create_mesh(view) {
    const { renderer, scene, camera, $el } = getElement(view);
    [this.renderer, this.page, this.drawn, this.angle] = [renderer, $el, 0, camera.fov];
    [this.fresh, this.busy, this.seen, this.rest, this.cost, this.level] = [true, false, "", 0, 10, 1];
    const draw = renderer.render.bind(renderer);
    renderer.render = () => {
      if (this.wanted(camera)) this.paint(() => draw(scene, camera));
    };
    window.addEventListener("harvester-slow", () => this.plain(scene));
    $el.redraw = () => {
      this.fresh = true;
      renderer.render();
    };
    return new THREE.Group();
  }

  wanted(camera) {
    const { width, height } = this.renderer.domElement;
    const now = [...camera.position, ...camera.quaternion, width, height].join();
    if (this.busy || performance.now() < this.rest || (!this.fresh && now === this.seen)) return false;
    this.seen = now;
    this.widen(camera);
    return true;
  }

  widen(camera) {
    const half = Math.tan((this.angle * Math.PI) / 360) * Math.max(1, WIDE / camera.aspect);
    camera.fov = (Math.atan(half) * 360) / Math.PI;
    camera.updateProjectionMatrix();
  }

  // for good: a driver needs the controls more than the trees
  plain(scene) {
    if (this.page.dataset.detail === "low") return;
    this.page.dataset.detail = "low";
    scene.traverse((one) => {
      if (one.userData.extra) one.visible = false;
    });
    this.least = MEAN;
    if (this.level < MEAN) this.turn(MEAN);
  }

  paint(draw) {
    [this.fresh, this.busy] = [false, true];
    const begin = performance.now();
    const gl = this.renderer.getContext();
    draw();
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const look = () => {
      if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED && !gl.isContextLost()) return setTimeout(look, 4);
      gl.deleteSync(fence);
      this.done(performance.now() - begin);
    };
    setTimeout(look, 1);
  }

  done(took) {
    if (this.drawn >= FIRST) this.cost += 0.2 * (took - this.cost);
    this.rest = performance.now() + Math.min(this.cost, LONGEST);
    this.busy = false;
    this.page.dataset.drawn = ++this.drawn;
    const slower = this.cost > SLOW && this.level < LEVELS.length - 1;
    const faster = this.cost < FAST && this.level > (this.least ?? 0);
    if (!slower && !faster) return;
    this.turn(this.level + (slower ? 1 : -1));
  }

  turn(level) {
    this.level = level;
    this.cost = (SLOW + FAST) / 2;
    this.renderer.setPixelRatio(this.level ? LEVELS[this.level] : Math.min(LEVELS[0], window.devicePixelRatio));
    this.rest = 0; // the canvas is empty now
    this.page.redraw();
  }
}

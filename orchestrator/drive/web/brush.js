// Draws only when something has moved, one picture at a time, and rests as long as it took: where the processor
// itself draws, it is shared with the machine. Where that is slow, fewer pixels do.

const LEVELS = [2, 1, 0.75, 0.55]; // pixels drawn per pixel of the page; the first up to those of the screen
const SLOW = 40; // ms for a picture; above it fewer pixels
const SPARE = 0.8; // share of SLOW that the next finer level may take, by its number of pixels
const CALM = 30000; // ms after which a page that let a message go late may draw everything again
const LONGEST = 250; // ms of rest
const FIRST = 4; // pictures that are slow in any case: programs of the graphics are made
const MEAN = 3; // level, without trees and shadow, that a driver is given whose page let a message go late
const WIDE = 1.35; // width over height from which on the height counts; below it the whole arm must still be in sight

export class Brush {
  constructor({ renderer, scene, camera, element }) {
    [this.renderer, this.scene, this.camera, this.page] = [renderer, scene, camera, element];
    [this.drawn, this.angle] = [0, camera.fov];
    [this.fresh, this.busy, this.seen, this.rest, this.cost, this.level] = [true, false, "", 0, 10, 1];
  }

  // something has changed
  redraw() {
    this.fresh = true;
    this.draw();
  }

  draw() {
    if (this.wanted(this.camera)) this.paint(() => this.renderer.render(this.scene, this.camera));
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

  // a driver needs the controls more than the trees; they come back when the load has gone
  plain() {
    clearTimeout(this.calm);
    this.calm = setTimeout(() => this.detail(true), CALM);
    if (this.page.dataset.detail !== "low") this.detail(false);
  }

  detail(full) {
    this.page.dataset.detail = full ? "full" : "low";
    this.scene.traverse((one) => {
      if (one.userData.extra) one.visible = full;
    });
    this.least = full ? 0 : MEAN;
    if (full) this.redraw();
    else if (this.level < MEAN) this.turn(MEAN);
  }

  // ms that the next finer level will take
  get finer() {
    return this.level > 0 ? this.cost * (LEVELS[this.level - 1] / LEVELS[this.level]) ** 2 : Infinity;
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
    const faster = this.finer < SPARE * SLOW && this.level > (this.least ?? 0);
    if (!slower && !faster) return;
    this.turn(this.level + (slower ? 1 : -1));
  }

  turn(level) {
    this.cost *= (LEVELS[level] / LEVELS[this.level]) ** 2;
    this.level = level;
    this.renderer.setPixelRatio(this.level ? LEVELS[this.level] : Math.min(LEVELS[0], window.devicePixelRatio));
    this.rest = 0; // the canvas is empty now
    this.redraw();
  }
}

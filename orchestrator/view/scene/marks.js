// Targets: a ring in space, on a staff from the ground.
import { THREE } from "nicegui-scene";

export default class Marks {
  create_mesh(view, ground) {
    this.view = view;
    this.ground = ground;
    this.root = new THREE.Group();
    return this.root;
  }

  show(marks) {
    this.root.clear();
    for (const { at, radius, colour, strong } of marks) {
      const [x, y, z] = at;
      const paint = new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: strong ? 0.95 : 0.35 });
      const ring = new THREE.Mesh(new THREE.TorusGeometry(radius, 0.03, 6, 28), paint);
      const staff = new THREE.Mesh(new THREE.CylinderGeometry(0.014, 0.014, z - this.ground, 6), paint);
      const foot = new THREE.Mesh(new THREE.RingGeometry(0.8 * radius, radius, 28), paint);
      const dot = new THREE.Mesh(new THREE.SphereGeometry(0.05, 10, 8), paint);
      ring.position.set(x, y, z);
      dot.position.set(x, y, z);
      staff.rotation.x = Math.PI / 2;
      staff.position.set(x, y, (z + this.ground) / 2);
      foot.position.set(x, y, this.ground + 0.02);
      this.root.add(ring, dot, staff, foot);
    }
    getElement(this.view).$el.redraw?.();
  }
}

// Ground, grid, trees and light; nothing of it moves.
import { THREE } from "nicegui-scene";

const LAYERS = [0, 1, 2]; // of the branches of a tree

export default class Ground {
  create_mesh(view, data) {
    this.data = data;
    const { scene } = getElement(view);
    scene.fog = new THREE.Fog(data.sky, 22, 62);
    scene.children.filter((c) => c.isLight).forEach((c) => scene.remove(c));
    const sun = new THREE.DirectionalLight(0xfff6e8, 2.0);
    sun.position.set(...data.sun);
    const [root, low] = [new THREE.Group(), new THREE.Group()]; // the server places the outer one, at zero
    low.position.z = data.ground;
    low.add(this.forest(), ...this.floor());
    root.add(new THREE.HemisphereLight(0xffffff, 0xaab0a4, 2.1), sun, low);
    return root;
  }

  forest() {
    const { trees } = this.data;
    const crowns = new THREE.ConeGeometry(1, 1, 6, 1, true).rotateX(Math.PI / 2).translate(0, 0, 0.5);
    const bark = new THREE.MeshLambertMaterial({ flatShading: true });
    const many = new THREE.InstancedMesh(crowns, bark, LAYERS.length * trees.length);
    trees.forEach(([x, y, height, radius], k) => {
      for (const layer of LAYERS) {
        const wide = radius * (1 - 0.27 * layer);
        const place = new THREE.Matrix4().makeScale(wide, wide, 0.5 * height);
        place.setPosition(x, y, height * (0.06 + 0.22 * layer));
        many.setMatrixAt(LAYERS.length * k + layer, place);
        const colour = new THREE.Color().setHSL(0.38, 0.22, 0.27 + 0.05 * layer + 0.02 * (k % 4));
        many.setColorAt(LAYERS.length * k + layer, colour);
      }
    });
    many.userData.extra = true;
    return many;
  }

  floor() {
    const paint = new THREE.MeshBasicMaterial({ color: this.data.floor });
    const grid = new THREE.GridHelper(48, 48, this.data.axis, this.data.grid).rotateX(Math.PI / 2);
    grid.position.z = 0.006;
    return [new THREE.Mesh(new THREE.CircleGeometry(90, 48), paint), grid];
  }
}

// The parts of three.js that the scene uses. `npm ci --ignore-scripts && npm run build` in this folder makes the
// module three.min.js from the unmodified package three 0.180.0, with esbuild 0.28.2.
// SHA-256 of three.min.js: 50b759c65eb8c1ec90a95457c4779b757dc79775c80216449656fa1a36676ce7
export { BoxGeometry, BufferAttribute, BufferGeometry, CatmullRomCurve3, CircleGeometry, Color, ConeGeometry, CylinderGeometry,
  DirectionalLight, DoubleSide, ExtrudeGeometry, Fog, GridHelper, Group, HemisphereLight, InstancedMesh, Line, LineBasicMaterial,
  Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, PerspectiveCamera, RingGeometry, Scene, Shape, SphereGeometry,
  TorusGeometry, TubeGeometry, Vector2, Vector3, WebGLRenderer } from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";

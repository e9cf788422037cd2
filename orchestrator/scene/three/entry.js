// The parts of three.js that the scene uses. `npm ci --ignore-scripts && npm run build` in this folder makes
// three.min.js from the unmodified package three 0.180.0, the version inside nicegui, with esbuild 0.28.2.
// SHA-256 of three.min.js: 9eba5d47ca0af0d75cc753f729e11de0768149016f92cd69b8531aa7c083737a
export { BoxGeometry, BufferAttribute, BufferGeometry, CatmullRomCurve3, CircleGeometry, Color, ConeGeometry, CylinderGeometry,
  DirectionalLight, DoubleSide, ExtrudeGeometry, Fog, GridHelper, Group, HemisphereLight, InstancedMesh, Line, LineBasicMaterial,
  Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, PerspectiveCamera, Scene, Shape, TubeGeometry, Vector2, Vector3,
  WebGLRenderer } from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";

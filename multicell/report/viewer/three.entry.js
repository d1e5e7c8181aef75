// What viewer.js needs of three.js; the head of three.min.js says how that file is made of this one.
export { WebGLRenderer, Scene, OrthographicCamera, BufferGeometry, BufferAttribute, RawShaderMaterial, Mesh, Vector3, GLSL3, StreamDrawUsage } from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

// The view of one robot: its ground and obstacles, what acts on it, its path, and the camera that follows it.

import * as THREE from "./three.module.min.js";
import { Arrow, mesh, up, vector } from "./shapes.js";

/** Colours of record/src/style.rs. */
const COLOURS = { ground: 0x5ae1a5, hand: 0xd55e00, rope: 0xf0e442, felt: 0xcc79a7, doubted: 0xa0a0a0 };
const [METRES_PER_NEWTON, METRES_PER_PUSH, PUSH_SHOWN_S] = [1 / 150, 0.5, 0.4];
/** Length of a rope, and distances of arrows from the trunk [m]. */
const [ROPE_M, ABOVE_M, BESIDE_M] = [0.45, 0.2, 0.13];
const [TRAIL_S, TRAIL_DOTS, CAMERA_LAG_S, GROUND_M] = [0.1, 150, 0.3, 24];
const SUN = new THREE.Vector3(0.9, -1.1, 3);
/** Moves points along the light onto the ground: shadows for the price of a second mesh. */
const ONTO_GROUND = new THREE.Matrix4().set(1, 0, -SUN.x / SUN.z, 0, 0, 1, -SUN.y / SUN.z, 0, 0, 0, 0, 0.003, 0, 0, 0, 1);

export class View {
  constructor(parts, tint) {
    this.scene = new THREE.Scene();
    this.scene.fog = new THREE.Fog(0, 4, 10);
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.05, 40);
    this.camera.up.copy(up);
    const sun = new THREE.DirectionalLight(0xffffff, 2.4);
    sun.position.copy(SUN);
    this.floor = new THREE.Mesh(new THREE.PlaneGeometry(GROUND_M, GROUND_M), new THREE.MeshBasicMaterial());
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x777788, 1.5), sun, this.floor);
    this.addBodies(parts, tint);
    this.trail = new THREE.InstancedMesh(new THREE.CircleGeometry(0.014, 12), new THREE.MeshBasicMaterial({ color: tint }), TRAIL_DOTS);
    this.trail.frustumCulled = false;
    const { ground, hand, rope, felt } = COLOURS;
    this.marks = {
      hand: new Arrow(hand, 0.011), rope: new Arrow(rope, 0.004, 0), push: new Arrow(hand, 0.016), felt: new Arrow(felt, 0.011),
      feet: [0, 1, 2, 3].map(() => new Arrow(ground, 0.006)),
    };
    this.scene.add(this.trail, ...Object.values(this.marks).flat());
  }

  /** Frees what the graphics processor keeps of it. */
  delete() {
    this.scene.traverse((part) => [part.geometry, part.material, part].forEach((owner) => owner?.dispose?.()));
  }

  addBodies(parts, tint) {
    const material = new THREE.MeshPhongMaterial({ vertexColors: true, shininess: 40, specular: 0x444444 });
    // Each point of the ground is darkened once.
    const dark = new THREE.MeshBasicMaterial({ color: 0, transparent: true, opacity: 0.3 });
    Object.assign(dark, { stencilWrite: true, stencilFunc: THREE.EqualStencilFunc, stencilZPass: THREE.IncrementStencilOp });
    const bodies = new Set(parts.map(({ body }) => body));
    this.bodies = [...bodies].map((body) => {
      const drawn = mesh(parts.filter((part) => part.body === body), tint, material);
      const shadow = Object.assign(new THREE.Mesh(drawn.geometry, dark), { matrixAutoUpdate: false, frustumCulled: false });
      this.scene.add(drawn, shadow);
      return { body, drawn, shadow };
    });
  }

  /** Takes the colour of the sky, and the pattern of the ground. */
  paint(sky, ground) {
    this.scene.background = this.scene.fog.color = new THREE.Color(sky);
    ground.repeat.set(GROUND_M, GROUND_M);
    Object.assign(this.floor.material, { map: ground, needsUpdate: true });
  }

  /** Updates the robot from the worker's message. */
  show({ places, turns, position, yaw, feet, felt, force, last, time_s, starts }) {
    for (const { body, drawn, shadow } of this.bodies) {
      drawn.position.fromArray(places, 3 * body);
      const [w, x, y, z] = turns.subarray(4 * body, 4 * body + 4);
      drawn.quaternion.set(x, y, z, w);
      drawn.updateMatrix();
      shadow.matrix.multiplyMatrices(ONTO_GROUND, drawn.matrix);
    }
    const trunk = vector(position);
    Object.assign(this, { trunk, yaw });
    if (starts !== this.starts) Object.assign(this, { starts, dots: 0, dotted_s: -1 });
    const inWorld = (array, scale) => vector(array).applyAxisAngle(up, yaw).multiplyScalar(scale);
    const from = (direction, distance) => trunk.clone().addScaledVector(direction.clone().normalize(), distance);
    const { marks } = this;
    const [forward, left] = felt.force;
    const { color, emissive } = marks.felt.material;
    emissive.copy(color.setHex(felt.doubted ? COLOURS.doubted : COLOURS.felt));
    marks.felt.show(from(up, ABOVE_M), inWorld([forward, left, 0], METRES_PER_NEWTON));
    const scale = felt.doubted ? 0 : METRES_PER_NEWTON / 2;
    marks.feet.forEach((arrow, leg) => arrow.show(vector(feet[leg]), inWorld(felt.feet[leg], scale)));
    const pull = vector(force).multiplyScalar(METRES_PER_NEWTON);
    marks.hand.show(from(pull, ROPE_M), pull);
    marks.rope.show(trunk, marks.hand.visible ? pull.setLength(ROPE_M) : pull);
    const along = vector(last && time_s < last.at_s + PUSH_SHOWN_S ? last.along : [0, 0, 0]).multiplyScalar(METRES_PER_PUSH);
    marks.push.show(from(along, -along.length() - BESIDE_M), along);
    this.leaveDot(time_s);
  }

  leaveDot(time_s) {
    if (time_s < this.dotted_s + TRAIL_S) return;
    this.trail.setMatrixAt(this.dots % TRAIL_DOTS, new THREE.Matrix4().makeTranslation(this.trunk.x, this.trunk.y, 0.004));
    Object.assign(this, { dots: this.dots + 1, dotted_s: time_s });
    this.trail.count = Math.min(this.dots, TRAIL_DOTS);
    this.trail.instanceMatrix.needsUpdate = true;
  }

  /** Moves camera and ground along. */
  follow({ around, above, away }, passed_s) {
    const focus = new THREE.Vector3(this.trunk.x, this.trunk.y, 0.22);
    this.focus ??= focus.clone();
    this.focus.lerp(focus, this.focus.distanceTo(focus) < 2 ? 1 - Math.exp(-passed_s / CAMERA_LAG_S) : 1);
    const level = away * Math.cos(above);
    this.camera.position.set(level * Math.cos(around), level * Math.sin(around), away * Math.sin(above)).add(this.focus);
    this.camera.lookAt(this.focus);
    this.floor.position.set(Math.round(this.focus.x), Math.round(this.focus.y), 0);
  }
}

// The picture: each robot in a view of its own, what acts on it, and the hand that grabs it.

import * as THREE from "./three.module.min.js";

/** Colours and scales of record/src/style.rs. */
const COLOURS = { robots: [0x0072b2, 0xe69f00], ground: 0x5ae1a5, hand: 0xd55e00, felt: 0xcc79a7, doubted: 0xa0a0a0 };
const [METRES_PER_NEWTON, METRES_PER_PUSH, PUSH_SHOWN_S, ROPE_M, FELT_HEIGHT_M, SIDE_M] = [1 / 150, 0.5, 0.4, 0.45, 0.2, 0.13];
const [TRAIL_S, TRAIL_DOTS, CAMERA_LAG_S, LIGHT, TINT_SHARE] = [0.1, 150, 0.3, 0.6, 0.7];
/** Distance of a hand from the robot that pulls or pushes with all its force [m]; a shorter drag than this pushes [ms, px]. */
const [REACH_M, FLICK_MS, FLICK_PX] = [0.8, 280, 12];
/** Frame rate below which the picture becomes coarser, the rates of pixels that are tried, and the fewest pixels. */
const [SLOW_HZ, FINENESS, FEWEST] = [50, [1, 0.75, 0.5, 0.35], 1.5e5];

/** True where no graphics processor draws. */
const IS_SOFTWARE = (() => {
  const context = document.createElement("canvas").getContext("webgl");
  const about = context?.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|software/i.test(about ? context.getParameter(about.UNMASKED_RENDERER_WEBGL) : "");
})();

const up = new THREE.Vector3(0, 0, 1);
const SUN = new THREE.Vector3(0.9, -1.1, 3);
/** Moves points along the light onto the ground: shadows for the price of a second mesh. */
const ONTO_GROUND = new THREE.Matrix4().set(1, 0, -SUN.x / SUN.z, 0, 0, 1, -SUN.y / SUN.z, 0, 0, 0, 0, 0.003, 0, 0, 0, 1);
const vector = (array) => new THREE.Vector3(...array);

/** The solid of a geometry, in the frame of its body; types are MuJoCo's. */
function solid({ type, size: [a, b, c], position, quaternion: [w, x, y, z] }) {
  const upright = (geometry) => geometry.rotateX(Math.PI / 2);
  // Small parts need few corners.
  const around = 8 + 2 * Math.min(5, Math.floor(100 * a));
  const geometry = {
    2: () => new THREE.SphereGeometry(a, around, around / 2),
    3: () => upright(new THREE.CapsuleGeometry(a, 2 * b, 3, around)),
    4: () => new THREE.SphereGeometry(1, 16, 10).scale(a, b, c),
    5: () => upright(new THREE.CylinderGeometry(a, a, 2 * b, around)),
    6: () => new THREE.BoxGeometry(2 * a, 2 * b, 2 * c),
  }[type]();
  return geometry.applyMatrix4(new THREE.Matrix4().compose(vector(position), new THREE.Quaternion(x, y, z, w), new THREE.Vector3(1, 1, 1)));
}

/** One mesh of all solids of a body. */
function mesh(parts, tint, material) {
  const [positions, normals, colours, indices] = [[], [], [], []];
  for (const part of parts) {
    const geometry = solid(part);
    const [red, green, blue] = part.rgba;
    const colour = new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace);
    if (tint !== null && Math.max(red, green, blue) > LIGHT) colour.lerp(new THREE.Color(tint).multiplyScalar(1.15), TINT_SHARE);
    const first = positions.length / 3;
    for (const index of geometry.index.array) indices.push(first + index);
    for (const value of geometry.attributes.position.array) positions.push(value);
    for (const value of geometry.attributes.normal.array) normals.push(value);
    for (let k = 0; k < geometry.attributes.position.count; k += 1) colours.push(colour.r, colour.g, colour.b);
  }
  const geometry = new THREE.BufferGeometry().setIndex(indices);
  const all = { position: positions, normal: normals, color: colours };
  for (const [name, values] of Object.entries(all)) geometry.setAttribute(name, new THREE.Float32BufferAttribute(values, 3));
  return new THREE.Mesh(geometry, material);
}

/** An arrow that is drawn between two points. */
class Arrow extends THREE.Group {
  constructor(colour, radius) {
    super();
    this.material = new THREE.MeshLambertMaterial({ color: colour, emissive: colour, emissiveIntensity: 0.35 });
    this.head = 6 * radius;
    this.shaft = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 1, 10).translate(0, 0.5, 0).rotateX(Math.PI / 2), this.material);
    this.tip = new THREE.Mesh(new THREE.ConeGeometry(2.4 * radius, this.head, 14).translate(0, -this.head / 2, 0).rotateX(Math.PI / 2), this.material);
    this.add(this.shaft, this.tip);
  }

  show(from, along) {
    const length = along.length();
    this.visible = length > 0.02;
    if (!this.visible) return;
    this.position.copy(from);
    this.quaternion.setFromUnitVectors(up, along.clone().normalize());
    this.shaft.scale.z = Math.max(0.001, length - this.head);
    this.tip.position.z = length;
    this.tip.scale.setScalar(Math.min(1, length / this.head));
  }
}

/** One robot with its ground and obstacles. */
class View {
  constructor(parts, tint) {
    this.scene = new THREE.Scene();
    this.scene.fog = new THREE.Fog(0, 4, 10);
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.05, 40);
    this.camera.up.copy(up);
    this.focus = null;
    const material = new THREE.MeshPhongMaterial({ vertexColors: true, shininess: 40, specular: 0x444444 });
    this.bodies = [...new Set(parts.map(({ body }) => body))].map((body) => {
      const own = parts.filter((part) => part.body === body);
      return [body, mesh(own, own[0].isRobot ? tint : null, material)];
    });
    // Each point of the ground is darkened once.
    const dark = new THREE.MeshBasicMaterial({
      color: 0, transparent: true, opacity: 0.3, stencilWrite: true, stencilFunc: THREE.EqualStencilFunc, stencilZPass: THREE.IncrementStencilOp,
    });
    this.shadows = this.bodies.map(([, { geometry }]) => Object.assign(new THREE.Mesh(geometry, dark), { matrixAutoUpdate: false, frustumCulled: false }));
    this.floor = new THREE.Mesh(new THREE.PlaneGeometry(24, 24), new THREE.MeshBasicMaterial());
    const sun = new THREE.DirectionalLight(0xffffff, 2.4);
    sun.position.copy(SUN);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x777788, 1.5), sun, this.floor, ...this.shadows, ...this.bodies.map(([, found]) => found));
    this.trail = new THREE.InstancedMesh(new THREE.CircleGeometry(0.014, 12), new THREE.MeshBasicMaterial({ color: tint }), TRAIL_DOTS);
    this.trail.frustumCulled = false;
    const [hand, push, felt] = [new Arrow(COLOURS.hand, 0.011), new Arrow(COLOURS.hand, 0.016), new Arrow(COLOURS.felt, 0.011)];
    const feet = [0, 1, 2, 3].map(() => new Arrow(COLOURS.ground, 0.006));
    this.rope = new THREE.Mesh(new THREE.CylinderGeometry(0.004, 0.004, 1, 6).translate(0, 0.5, 0).rotateX(Math.PI / 2), new THREE.MeshBasicMaterial({ color: 0xf0e442 }));
    Object.assign(this, { hand, push, felt, feet, pushed: null });
    for (const mark of [hand, push, felt, ...feet, this.rope]) mark.visible = false;
    this.scene.add(this.trail, hand, push, felt, ...feet, this.rope);
    this.forget();
  }

  forget() {
    Object.assign(this, { dots: 0, dotted_s: -1 });
    this.trail.count = 0;
  }

  paint({ sky, floor }) {
    this.scene.background = this.scene.fog.color = new THREE.Color(sky);
    this.floor.material.map?.dispose();
    Object.assign(this.floor.material, { map: floor, needsUpdate: true });
  }

  /** Shows what the worker tells of the robot. */
  show(robot) {
    const { places, turns, position, yaw, felt, force, pushed, time_s } = robot;
    this.bodies.forEach(([body, found], index) => {
      found.position.fromArray(places, 3 * body);
      const [w, x, y, z] = turns.subarray(4 * body, 4 * body + 4);
      found.quaternion.set(x, y, z, w);
      found.updateMatrix();
      this.shadows[index].matrix.multiplyMatrices(ONTO_GROUND, found.matrix);
    });
    const trunk = vector(position);
    this.trunk = trunk;
    this.yaw = yaw;
    const inWorld = (array) => vector(array).applyAxisAngle(up, yaw);
    this.felt.material.color.setHex(felt.doubted ? COLOURS.doubted : COLOURS.felt);
    this.felt.show(trunk.clone().addScaledVector(up, FELT_HEIGHT_M), inWorld([felt.force[0], felt.force[1], 0]).multiplyScalar(METRES_PER_NEWTON));
    this.feet.forEach((arrow, leg) => arrow.show(vector(robot.feet[leg]), inWorld(felt.feet[leg]).multiplyScalar(felt.doubted ? 0 : METRES_PER_NEWTON / 2)));
    const pull = vector(force);
    const direction = pull.clone().normalize();
    this.hand.show(trunk.clone().addScaledVector(direction, ROPE_M), pull.clone().multiplyScalar(METRES_PER_NEWTON));
    this.rope.visible = this.hand.visible;
    this.rope.position.copy(trunk);
    if (this.rope.visible) this.rope.quaternion.setFromUnitVectors(up, direction);
    this.rope.scale.z = ROPE_M;
    if (pushed) this.pushed = { until_s: time_s + PUSH_SHOWN_S, velocity: inWorld([...pushed, 0]) };
    if (this.pushed?.until_s < time_s) this.pushed = null;
    const velocity = this.pushed?.velocity ?? new THREE.Vector3();
    const reach = METRES_PER_PUSH * velocity.length() + SIDE_M;
    this.push.show(trunk.clone().addScaledVector(velocity.clone().normalize(), -reach), velocity.clone().multiplyScalar(METRES_PER_PUSH));
    if (robot.isBeginning) this.forget();
    if (time_s < this.dotted_s + TRAIL_S) return;
    this.trail.setMatrixAt(this.dots % TRAIL_DOTS, new THREE.Matrix4().makeTranslation(trunk.x, trunk.y, 0.004));
    Object.assign(this, { dots: this.dots + 1, dotted_s: time_s });
    this.trail.count = Math.min(this.dots, TRAIL_DOTS);
    this.trail.instanceMatrix.needsUpdate = true;
  }

  /** Moves camera and ground along. */
  follow({ around, above, away }, passed_s) {
    if (!this.trunk) return;
    const focus = new THREE.Vector3(this.trunk.x, this.trunk.y, 0.22);
    const part = this.focus && this.focus.distanceTo(focus) < 2 ? 1 - Math.exp(-passed_s / CAMERA_LAG_S) : 1;
    this.focus = (this.focus ?? focus).clone().lerp(focus, part);
    const level = away * Math.cos(above);
    this.camera.position.set(level * Math.cos(around), level * Math.sin(around), away * Math.sin(above)).add(this.focus);
    this.camera.lookAt(this.focus);
    // The pattern repeats every metre.
    this.floor.position.set(Math.round(this.focus.x), Math.round(this.focus.y), 0);
  }
}

/** The pattern of the ground: squares of half a metre, with lines. */
function pattern(light, dark, line) {
  const canvas = Object.assign(document.createElement("canvas"), { width: 256, height: 256 });
  const brush = canvas.getContext("2d");
  [[0, 0, light], [128, 128, light], [128, 0, dark], [0, 128, dark]].forEach(([x, y, colour]) => {
    brush.fillStyle = colour;
    brush.fillRect(x, y, 128, 128);
  });
  brush.strokeStyle = line;
  brush.lineWidth = 2;
  brush.strokeRect(0, 0, 256, 256);
  const texture = new THREE.CanvasTexture(canvas);
  Object.assign(texture, { wrapS: THREE.RepeatWrapping, wrapT: THREE.RepeatWrapping, colorSpace: THREE.SRGBColorSpace, anisotropy: IS_SOFTWARE ? 1 : 8 });
  texture.repeat.set(24, 24);
  return texture;
}

/** Draws robots into an element. `on.pull(force or null)` and `on.push(size)` are parts of the whole, forward and left. */
export class Picture {
  constructor(place, on) {
    Object.assign(this, { place, on, views: [], fineness: IS_SOFTWARE ? 1 : 0, frames: 0, since: performance.now(), last: 0, rate: null });
    this.orbit = { around: -2.25, above: 0.5, away: 2.2 };
    this.renderer = new THREE.WebGLRenderer({ antialias: !IS_SOFTWARE, stencil: true, powerPreference: "high-performance" });
    this.renderer.setScissorTest(true);
    place.append(this.renderer.domElement);
    new ResizeObserver(() => this.resize()).observe(place);
    this.listen(this.renderer.domElement);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint());
    requestAnimationFrame((time) => this.draw(time));
  }

  /** Begins with other robots: their drawn parts. */
  begin(parts) {
    this.views.forEach(({ scene }) => scene.traverse(({ geometry }) => geometry?.dispose()));
    this.views = parts.map((own, index) => new View(own, COLOURS.robots[index]));
    this.paint();
    this.resize();
  }

  paint() {
    // A colour of the style sheet, as it is in the present scheme.
    const colour = (name) => {
      this.place.style.color = `var(${name})`;
      return getComputedStyle(this.place).color;
    };
    const floor = pattern(colour("--square"), colour("--other-square"), colour("--grid"));
    this.views.forEach((view) => view.paint({ sky: colour("--sky"), floor }));
  }

  resize() {
    const { clientWidth, clientHeight } = this.place;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2) * FINENESS[this.fineness]);
    this.renderer.setSize(clientWidth, clientHeight);
    // Side by side; a robot is longer than high, so on a narrow page the camera steps back.
    const width = clientWidth / Math.max(1, this.views.length);
    this.areas = this.views.map((_, index) => [index * width, 0, width, clientHeight]);
    for (const { camera } of this.views) {
      camera.aspect = width / clientHeight;
      camera.fov = camera.aspect < 1 ? Math.min(60, (2 * 180 * Math.atan(Math.tan(0.28) / camera.aspect)) / Math.PI) : 35;
      camera.updateProjectionMatrix();
    }
  }

  show(robots) {
    robots.forEach((robot, index) => this.views[index]?.show(robot));
  }

  draw(time) {
    requestAnimationFrame((next) => this.draw(next));
    const passed_s = Math.min(0.1, (time - this.last) / 1e3);
    this.last = time;
    this.views.forEach((view, index) => {
      view.follow(this.orbit, passed_s);
      this.renderer.setViewport(...this.areas[index]);
      this.renderer.setScissor(...this.areas[index]);
      this.renderer.render(view.scene, view.camera);
    });
    this.count(time);
  }

  /** Counts pictures; where there are too few, they become coarser. */
  count(time) {
    this.frames += 1;
    if (time - this.since < 2e3) return;
    this.rate = (this.frames * 1e3) / (time - this.since);
    [this.frames, this.since] = [0, time];
    const { width, height } = this.renderer.domElement;
    if (this.rate > SLOW_HZ || document.hidden || !this.views.length || width * height < FEWEST) return;
    this.fineness = Math.min(FINENESS.length - 1, this.fineness + 1);
    this.resize();
  }

  /** The part of the whole force by which a pointer pulls the robot of a view, forward and left; null where it misses. */
  grab(index, { offsetX, offsetY }, misses) {
    const [left, , width, height] = this.areas[index];
    const { camera, trunk, yaw } = this.views[index];
    const pointer = new THREE.Vector2((2 * (offsetX - left)) / width - 1, 1 - (2 * offsetY) / height);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(pointer, camera);
    if (misses && ray.ray.distanceToPoint(trunk) > 0.35) return null;
    const at = ray.ray.intersectPlane(new THREE.Plane(up, -trunk.z), new THREE.Vector3()) ?? trunk;
    const drag = at.clone().sub(trunk).applyAxisAngle(up, -yaw);
    const length = Math.max(REACH_M, Math.hypot(drag.x, drag.y));
    return [drag.x / length, drag.y / length];
  }

  /** A pointer on a robot grabs it: a drag pulls, a quick one pushes. Elsewhere it turns the picture. Two fingers and the wheel zoom. */
  listen(canvas) {
    const pointers = new Map();
    let held = null;
    const zoom = (factor) => (this.orbit.away = Math.min(8, Math.max(1, this.orbit.away * factor)));
    canvas.addEventListener("pointerdown", (event) => {
      pointers.set(event.pointerId, event);
      canvas.setPointerCapture(event.pointerId);
      const index = this.areas.findIndex(([left, , width]) => event.offsetX >= left && event.offsetX < left + width);
      const from = pointers.size === 1 && this.views[index]?.trunk ? this.grab(index, event, true) : null;
      if (!from) return;
      held = { index, from, event, part: null };
      const { pointerId } = event;
      // A hand that rests pulls, too.
      setTimeout(() => held?.event.pointerId === pointerId && held.part && this.on.pull(held.part), FLICK_MS + 1);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      if (held?.event.pointerId === event.pointerId) {
        const now = this.grab(held.index, event, false);
        const drag = [now[0] - held.from[0], now[1] - held.from[1]];
        held.part = drag.map((it) => it / Math.max(1, Math.hypot(...drag)));
        if (event.timeStamp - held.event.timeStamp > FLICK_MS) this.on.pull(held.part);
      } else if (pointers.size === 2) {
        const other = [...pointers.values()].find(({ pointerId }) => pointerId !== event.pointerId);
        const far = (one) => Math.hypot(one.offsetX - other.offsetX, one.offsetY - other.offsetY);
        zoom(far(before) / Math.max(1, far(event)));
      } else {
        this.orbit.around -= (event.offsetX - before.offsetX) / 150;
        this.orbit.above = Math.min(1.5, Math.max(0.05, this.orbit.above + (event.offsetY - before.offsetY) / 150));
      }
      pointers.set(event.pointerId, event);
    });
    const end = (event) => {
      pointers.delete(event.pointerId);
      if (held?.event.pointerId !== event.pointerId) return;
      const { event: start, part } = held;
      held = null;
      this.on.pull(null);
      const moved = Math.hypot(event.offsetX - start.offsetX, event.offsetY - start.offsetY);
      const isFlick = event.timeStamp - start.timeStamp <= FLICK_MS && moved > FLICK_PX;
      if (part && isFlick && event.type === "pointerup") this.on.push(part);
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(event.deltaY / 800));
    }, { passive: false });
  }
}

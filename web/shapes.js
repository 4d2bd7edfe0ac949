// What is drawn: bodies of MuJoCo's geometries, arrows and the pattern of the ground.

import * as THREE from "./three.module.min.js";

/** Lightness above which a robot's part takes on its colour, and how much of it. */
const [LIGHT, TINT_SHARE] = [0.6, 0.7];

export const up = new THREE.Vector3(0, 0, 1);
export const vector = (array) => new THREE.Vector3(...array);
const upright = (geometry) => geometry.rotateX(Math.PI / 2);

/** The solid of a geometry, in the frame of its body; types are MuJoCo's. */
function solid({ type, size: [a, b, c], position, quaternion: [w, x, y, z] }) {
  // Small parts need few corners.
  const around = 8 + 2 * Math.min(5, Math.floor(100 * a));
  const geometry = {
    2: () => new THREE.SphereGeometry(a, around, around / 2),
    3: () => upright(new THREE.CapsuleGeometry(a, 2 * b, 3, around)),
    4: () => new THREE.SphereGeometry(1, 16, 10).scale(a, b, c),
    5: () => upright(new THREE.CylinderGeometry(a, a, 2 * b, around)),
    6: () => new THREE.BoxGeometry(2 * a, 2 * b, 2 * c),
  }[type]();
  return geometry.applyQuaternion(new THREE.Quaternion(x, y, z, w)).translate(...position);
}

/** One mesh of all parts of a body; light parts of robots are tinted. */
export function mesh(parts, tint, material) {
  const [all, indices] = [{ position: [], normal: [], color: [] }, []];
  for (const part of parts) {
    const geometry = solid(part);
    const [red, green, blue] = part.rgba;
    const colour = new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace);
    if (part.isRobot && Math.max(red, green, blue) > LIGHT) colour.lerp(new THREE.Color(tint).multiplyScalar(1.15), TINT_SHARE);
    const first = all.position.length / 3;
    for (const index of geometry.index.array) indices.push(first + index);
    const { position, normal } = geometry.attributes;
    for (const value of position.array) all.position.push(value);
    for (const value of normal.array) all.normal.push(value);
    for (let k = 0; k < position.count; k += 1) all.color.push(...colour);
  }
  const geometry = new THREE.BufferGeometry().setIndex(indices);
  for (const [name, values] of Object.entries(all)) geometry.setAttribute(name, new THREE.Float32BufferAttribute(values, 3));
  return new THREE.Mesh(geometry, material);
}

/** An arrow from a point along a vector; without a head, a rope. */
export class Arrow extends THREE.Group {
  constructor(colour, radius, head = 6 * radius) {
    super();
    this.material = new THREE.MeshLambertMaterial({ color: colour, emissive: colour, emissiveIntensity: 0.35 });
    this.head = head;
    const shaft = new THREE.CylinderGeometry(radius, radius, 1, 8).translate(0, 0.5, 0);
    const tip = new THREE.ConeGeometry(2.4 * radius, head, 12).translate(0, -head / 2, 0);
    [this.shaft, this.tip] = [shaft, tip].map((geometry) => new THREE.Mesh(upright(geometry), this.material));
    this.add(this.shaft, this.tip);
    this.visible = false;
  }

  show(from, along) {
    const length = along.length();
    this.visible = length > 0.02;
    if (!this.visible) return;
    this.position.copy(from);
    this.quaternion.setFromUnitVectors(up, along.clone().normalize());
    this.shaft.scale.z = Math.max(0.001, length - this.head);
    this.tip.position.z = length;
    this.tip.visible = this.head > 0;
  }
}

/** The pattern of the ground, which repeats every metre: squares of half a metre, and lines. */
export function pattern(square, other, line) {
  const brush = Object.assign(document.createElement("canvas"), { width: 256, height: 256 }).getContext("2d");
  for (const [colour, ...area] of [[square, 0, 0, 256, 256], [other, 128, 0, 128, 128], [other, 0, 128, 128, 128]]) {
    brush.fillStyle = colour;
    brush.fillRect(...area);
  }
  Object.assign(brush, { strokeStyle: line, lineWidth: 2 }).strokeRect(0, 0, 256, 256);
  const texture = new THREE.CanvasTexture(brush.canvas);
  return Object.assign(texture, { wrapS: THREE.RepeatWrapping, wrapT: THREE.RepeatWrapping, colorSpace: THREE.SRGBColorSpace });
}

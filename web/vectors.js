// Vectors of three numbers, and rotations as three rows of them.

export const add = (a, b) => a.map((value, k) => value + b[k]);
export const less = (a, b) => a.map((value, k) => value - b[k]);
export const times = (factor, a) => a.map((value) => factor * value);
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const transposed = (rows) => [0, 1, 2].map((column) => rows.map((row) => row[column]));
/** Rows times a vector. */
export const turned = (rows, a) => rows.map((row) => dot(row, a));

/** The inverse of rows times their determinant, transposed: the cofactors. */
export const cofactors = ([a, b, c]) => [cross(b, c), cross(c, a), cross(a, b)];

/** The rotation of a quaternion w, x, y, z of any length. */
export function rotation(quaternion) {
  const length = Math.hypot(...quaternion);
  const [w, x, y, z] = quaternion.map((part) => part / length);
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** The rotation about a vector by its length. */
export function rotationAbout(axis) {
  const angle = Math.hypot(...axis);
  const sine = angle > 1e-12 ? Math.sin(angle / 2) / angle : 0.5;
  return rotation([Math.cos(angle / 2), ...times(sine, axis)]);
}

/** The yaw of a rotation from the base to the world [rad], and the rotation about the vertical by a yaw. */
export const yawOf = (rows) => Math.atan2(rows[1][0], rows[0][0]);
export const heading = (yaw) => [[Math.cos(yaw), -Math.sin(yaw), 0], [Math.sin(yaw), Math.cos(yaw), 0], [0, 0, 1]];

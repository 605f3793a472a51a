// Cameras and projections. Cameras have x right, y down and z forward, as the renderer's.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a) => Math.hypot(a[0], a[1], a[2]);
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/** Rotates `v` by the quaternion x, y, z, w. */
export function rotate([x, y, z, w], v) {
  const u = [x, y, z];
  const t = scale(cross(u, v), 2);
  return add(add(v, scale(t, w)), cross(u, t));
}

/** Quaternion of the rotation by `b`, then by `a`. */
export function multiply([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

const inverse = ([x, y, z, w]) => [-x, -y, -z, w];

/** Point of the world from a point relative to `pose`. */
export const fromLocal = (pose, v) => add(rotate(pose.rotation, v), pose.position_m);

/** Point relative to `pose` from a point of the world. */
export const toLocal = (pose, v) => rotate(inverse(pose.rotation), subtract(v, pose.position_m));

/** Quaternion x, y, z, w of the rotation that has these columns. */
function quaternion(cx, cy, cz) {
  const [m00, m10, m20] = cx;
  const [m01, m11, m21] = cy;
  const [m02, m12, m22] = cz;
  const trace = m00 + m11 + m22;
  if (trace > 0) {
    const s = 2 * Math.sqrt(1 + trace);
    return [(m21 - m12) / s, (m02 - m20) / s, (m10 - m01) / s, s / 4];
  }
  if (m00 > m11 && m00 > m22) {
    const s = 2 * Math.sqrt(1 + m00 - m11 - m22);
    return [s / 4, (m01 + m10) / s, (m02 + m20) / s, (m21 - m12) / s];
  }
  if (m11 > m22) {
    const s = 2 * Math.sqrt(1 + m11 - m00 - m22);
    return [(m01 + m10) / s, s / 4, (m12 + m21) / s, (m02 - m20) / s];
  }
  const s = 2 * Math.sqrt(1 + m22 - m00 - m11);
  return [(m02 + m20) / s, (m12 + m21) / s, s / 4, (m10 - m01) / s];
}

/** Axes [ahead, left, up] of a world whose up is an axis. */
export function axesOf(up) {
  const ahead = Math.abs(up[0]) > 0.5 ? [0, 1, 0] : [1, 0, 0];
  return [ahead, cross(up, ahead), up];
}

/** The axis of the world that is nearest to up in an image of the camera at `pose`. */
export function upOf(pose) {
  const up = rotate(pose.rotation, [0, -1, 0]);
  const sizes = up.map(Math.abs);
  const axis = sizes.indexOf(Math.max(...sizes));
  return [0, 1, 2].map((i) => (i === axis ? Math.sign(up[axis]) : 0));
}

/** Direction of a yaw and a pitch, radians. */
export function direction([ahead, left, up], yaw, pitch) {
  const flat = add(scale(ahead, Math.cos(yaw)), scale(left, Math.sin(yaw)));
  return add(scale(flat, Math.cos(pitch)), scale(up, Math.sin(pitch)));
}

/** Rotation of a camera that looks along a yaw and a pitch without roll. */
export function looking([ahead, left, up], yaw, pitch) {
  const forward = direction([ahead, left, up], yaw, pitch);
  const right = add(scale(ahead, Math.sin(yaw)), scale(left, -Math.cos(yaw)));
  return quaternion(right, cross(forward, right), forward);
}

/** Yaw and pitch of a unit vector, radians. */
export function anglesOfDirection([ahead, left, up], towards) {
  const pitch = Math.asin(Math.max(-1, Math.min(1, dot(towards, up))));
  return { yaw: Math.atan2(dot(towards, left), dot(towards, ahead)), pitch };
}

/** Yaw and pitch of a camera, radians. */
export const anglesOf = (axes, rotation) => anglesOfDirection(axes, rotate(rotation, [0, 0, 1]));

/** Pixels [x, y] of a ray of the camera, or null where it has none. `camera` as in the state. */
export function projectRay(camera, [x, y, z]) {
  const { lens, focal_px: f, center_px: c } = camera;
  const across = Math.hypot(x, y);
  if (!lens) return z > 1e-6 ? [(f[0] * x) / z + c[0], (f[1] * y) / z + c[1]] : null;
  const angle = Math.atan2(across, z);
  if (angle > lens.limit_rad || z <= 0) return null;
  if (lens.kind === "opencv") {
    const [k1, k2, k3, k4, k5, k6] = lens.radial;
    const [p1, p2] = lens.tangential;
    const [s1, s2, s3, s4] = lens.thin_prism;
    const u = x / z;
    const v = y / z;
    const r2 = u * u + v * v;
    const radial =
      (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
    const du = 2 * p1 * u * v + p2 * (r2 + 2 * u * u) + r2 * (s1 + r2 * s2);
    const dv = p1 * (r2 + 2 * v * v) + 2 * p2 * u * v + r2 * (s3 + r2 * s4);
    return [f[0] * (u * radial + du) + c[0], f[1] * (v * radial + dv) + c[1]];
  }
  const ray = across > 1e-12 ? [x / across, y / across] : [0, 0];
  if (lens.kind === "fisheye") {
    const [k1, k2, k3, k4] = lens.radial;
    const a2 = angle * angle;
    const radius = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
    return [f[0] * radius * ray[0] + c[0], f[1] * radius * ray[1] + c[1]];
  }
  const powers = (coefficients, at) => coefficients.reduceRight((sum, k) => sum * at + k, 0);
  let radius = powers(lens.angle_to_pixel_distance, angle);
  if (lens.follows_pixel_distance) {
    // Newton's method from the approximate inverse.
    const slopes = lens.pixel_distance_to_angle.slice(1).map((k, i) => k * (i + 1));
    for (let round = 0; round < 8; round += 1) {
      radius -= (powers(lens.pixel_distance_to_angle, radius) - angle) / powers(slopes, radius);
    }
  }
  const [k, d, e] = lens.linear_cde;
  return [
    radius * (k * ray[0] + d * ray[1]) + c[0],
    radius * (e * ray[0] + ray[1]) + c[1],
  ];
}

/** Pixels of a point of the world, or null. */
export const project = (camera, point) => projectRay(camera, toLocal(camera.pose, point));

// Bits 0, 1 and 2 of a corner choose its side along x, y and z.
const EDGES = [0, 1, 2, 3, 4, 5, 6, 7].flatMap((corner) =>
  [1, 2, 4].filter((bit) => !(corner & bit)).map((bit) => [corner, corner | bit]),
);

/** Corners of an agent's box, world coordinates. */
export function corners(agent) {
  const half = agent.size_m.map((side) => side / 2);
  return [0, 1, 2, 3, 4, 5, 6, 7].map((corner) =>
    fromLocal(
      agent.pose,
      half.map((h, axis) => (corner & (1 << axis) ? h : -h)),
    ),
  );
}

/** Pieces of lines [[x, y], [x, y]] of an agent's box, pixels. Lenses bend lines: each has pieces. */
export function boxLines(camera, agent) {
  const places = corners(agent);
  return EDGES.flatMap(([from, to]) => polyline(camera, [places[from], places[to]], 12));
}

/** Pieces of a line through `points` of the world, pixels, `pieces` for each part. */
export function polyline(camera, points, pieces) {
  const lines = [];
  for (let i = 1; i < points.length; i += 1) {
    const [from, to] = [points[i - 1], points[i]];
    let before = project(camera, from);
    for (let piece = 1; piece <= pieces; piece += 1) {
      const share = piece / pieces;
      const after = project(camera, add(scale(from, 1 - share), scale(to, share)));
      if (before && after) lines.push([before, after]);
      before = after;
    }
  }
  return lines;
}

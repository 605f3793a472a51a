// Cameras of the user: which there are, where they stand, how they move.
import * as geometry from "./geometry.js";
import { state } from "./state.js";

const BIRDS_EYE_FOV_DEG = 8;
const FOV_DEG = 60;
/** Distance that a camera goes by: of what is before it, where the size of the scene is not known. */
const STRIDE_M = 10;
/** Largest of it, in a scene of kilometers. */
const STRIDE_MAX_M = 40;

/** Distance that a camera in `source` goes by, meters. */
const strideOf = ({ extent }) => (extent ? Math.min(STRIDE_MAX_M, Math.max(1e-6, extent.radius_m)) : STRIDE_M);

/** Cameras that a source offers: [value, text]. */
export function cameraChoices({ cameras, has_ego: hasEgo }) {
  const choices = [];
  if (cameras.length > 1 && hasEgo) choices.push(["rig", "All cameras"]);
  if (hasEgo) choices.push(["follow", "Behind the car"], ["driver", "Driver"]);
  choices.push(["birds-eye", "From above"], ["orbit", "Around a point"], ["fly", "Free flight"]);
  cameras.forEach(({ name }) => choices.push([`named:${name}`, `Camera ${name}`]));
  return choices;
}

/** Start of a camera of the user. `rig` is a vehicle's name, "" for the ego, null for the world. */
export function newCamera(kind, rig, source) {
  return { ...started(kind, rig, source), stride: rig === null ? strideOf(source) : STRIDE_M };
}

function started(kind, rig, { first_camera: first, extent }) {
  const attached = rig !== null;
  const axes = attached ? geometry.axesOf([0, 0, 1]) : state.axes;
  if (kind === "driver") return { rig, axes, at: [0.9, 0.35, 1.3], yaw: 0, pitch: 0, fov: FOV_DEG };
  if (kind === "follow") {
    return { rig, axes, focus: [0, 0, 1], far: 11, yaw: 0, pitch: -0.3, fov: FOV_DEG };
  }
  const { yaw, pitch } = geometry.anglesOf(axes, first.rotation);
  const ahead = geometry.direction(axes, yaw, pitch);
  // A file of splats is shown from a distance at which all of it is seen; a street from within.
  const whole = (fov) => (1.1 * extent.radius_m) / Math.sin((fov * Math.PI) / 360);
  const focus = extent ? extent.center_m : geometry.add(first.position_m, geometry.scale(ahead, STRIDE_M));
  if (kind === "birds-eye") {
    const far = extent && !attached ? whole(BIRDS_EYE_FOV_DEG) : 400;
    const below = attached ? [0, 0, 0] : focus;
    return { rig, axes, focus: below, far, yaw: attached ? 0 : yaw, pitch: -Math.PI / 2, fov: BIRDS_EYE_FOV_DEG };
  }
  if (kind === "orbit") {
    return { rig, axes, focus, far: extent ? whole(FOV_DEG) : STRIDE_M, yaw, pitch, fov: FOV_DEG };
  }
  return { rig, axes, at: first.position_m, yaw, pitch, fov: FOV_DEG };
}

/** Position of a camera of the user, relative to its vehicle or the world. */
function placeOf(camera) {
  if (!camera.focus) return camera.at;
  const ahead = geometry.direction(camera.axes, camera.yaw, camera.pitch);
  return geometry.subtract(camera.focus, geometry.scale(ahead, camera.far));
}

/** Camera as the protocol asks for it. */
export function cameraRequest(camera, name) {
  if (name) return { kind: "named", name };
  const pinhole = {
    position_m: placeOf(camera),
    rotation: geometry.looking(camera.axes, camera.yaw, camera.pitch),
    fov_deg: camera.fov,
  };
  if (camera.rig === null) return { kind: "free", ...pinhole };
  return { kind: "attached", agent: camera.rig || null, ...pinhole };
}

/**
 * Camera of the user as pixels are projected by it, for an image of `size_px`; null where its vehicle
 * is gone. `agents` and `ego`: state of its source.
 */
export function placedCamera(camera, { agents, ego }, [width, height]) {
  const { position_m, rotation, fov_deg, kind, agent } = cameraRequest(camera, null);
  const world = { position_m: [0, 0, 0], rotation: [0, 0, 0, 1] };
  const vehicle = agent ? agents.find(({ name }) => name === agent)?.pose : ego;
  const base = kind === "free" ? world : vehicle;
  if (!base) return null;
  const focal = height / 2 / Math.tan((fov_deg * Math.PI) / 360);
  return {
    size_px: [width, height], focal_px: [focal, focal], center_px: [width / 2, height / 2], lens: null,
    pose: { position_m: geometry.fromLocal(base, position_m), rotation: geometry.multiply(base.rotation, rotation) },
  };
}

/** Choice of the camera that shows a source first. */
export function firstChoice({ cameras, has_ego: hasEgo, is_captured: isCaptured }) {
  // Where a scene was captured by few cameras, nothing else may be seen.
  if (isCaptured) return `named:${cameras[0].name}`;
  return hasEgo ? "follow" : "orbit";
}

/** Axes [ahead, left, up] of the world of a source. */
export const axesOfSource = ({ has_ego: hasEgo, first_camera: first }) => geometry.axesOf(hasEgo ? [0, 0, 1] : geometry.upOf(first));

export function turn(camera, dx, dy) {
  // A camera that flies turns itself; one around a point is dragged with the scene.
  const sign = camera.focus ? -1 : 1;
  camera.yaw += sign * dx;
  const pitch = camera.pitch + sign * dy;
  camera.pitch = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, pitch));
}

/** Moves across the image, meters. */
export function shift(camera, right, up) {
  const forward = geometry.direction(camera.axes, camera.yaw, camera.pitch);
  const [ahead, left] = camera.axes;
  const across = geometry.add(
    geometry.scale(ahead, Math.sin(camera.yaw)),
    geometry.scale(left, -Math.cos(camera.yaw)),
  );
  const above = geometry.cross(across, forward);
  const by = geometry.add(geometry.scale(across, right), geometry.scale(above, up));
  const key = camera.focus ? "focus" : "at";
  camera[key] = geometry.add(camera[key], by);
}

/** Nearest that a camera comes to the point that it circles around, a share of its stride. */
const FAR_MIN = 1e-4;

/** Changes the distance to the focus by a factor; without a focus, flies as far from its stride. */
export function zoom(camera, factor) {
  if (camera.focus) camera.far = Math.max(FAR_MIN * camera.stride, camera.far * factor);
  else approach(camera, -camera.stride * Math.log(factor));
}

/** Moves toward the focus, meters. */
export function approach(camera, by_m) {
  if (camera.focus) {
    camera.far = Math.max(FAR_MIN * camera.stride, camera.far - by_m);
    return;
  }
  const forward = geometry.direction(camera.axes, camera.yaw, camera.pitch);
  camera.at = geometry.add(camera.at, geometry.scale(forward, by_m));
}

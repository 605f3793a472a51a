// Lines and labels over the images: lanes, plans, boxes, trails, names, points of a LiDAR.
import * as geometry from "./geometry.js";
import { state } from "./state.js";

/** Further drawings over the images: each is called with the context and the camera. */
const further = [];
export const alsoDraw = (draw) => further.push(draw);

const TRAIL_S = 5;
const LANES_WITHIN_M = 120;
const LANE_COLOR = "#ffffffb0";
const PLAN_COLOR = "#00e5a0";
// Plans that the planner considered beside its own.
const ALTERNATIVE_COLOR = "#00e5a070";
const SELECTED_COLOR = "#ffffff";
// Okabe and Ito, "Color Universal Design", 2008: told apart by color-blind people.
const COLORS = ["#e69f00", "#56b4e9", "#009e73", "#f0e442", "#cc79a7", "#d55e00", "#8fa3ff"];
// Ranges of points, near to far, meters.
const RANGES = [[5, "#e6331a"], [10, "#f2bf33"], [20, "#80f24d"], [40, "#1accbf"], [80, "#4073f2"], [Infinity, "#9a7bd0"]];

export function noteTrails({ time_s: now, sources }) {
  sources[0].agents.forEach(({ name, pose }) => {
    const trail = (state.trails.get(name) ?? []).filter(
      ({ time }) => time < now && time > now - TRAIL_S,
    );
    state.trails.set(name, [...trail, { time: now, place: pose.position_m }]);
  });
}

/** Draws what lies over the image of `view`, which shows `camera`, in the state of its source. */
export function drawOverlay(view, camera, source) {
  const { layers } = state;
  const { overlay } = view;
  view.axes?.turn(camera.pose.rotation);
  if (view.axes) view.axes.element.hidden = !layers.axes;
  const { agents, plan, alternatives } = source;
  const ratio = window.devicePixelRatio || 1;
  const box = view.element.getBoundingClientRect();
  Object.assign(overlay, { width: box.width * ratio, height: box.height * ratio });
  // The image is fitted into the view: overlays follow it.
  const scale = Math.min(overlay.width / camera.size_px[0], overlay.height / camera.size_px[1]);
  const context = overlay.getContext("2d");
  context.setTransform(
    scale, 0, 0, scale,
    (overlay.width - scale * camera.size_px[0]) / 2,
    (overlay.height - scale * camera.size_px[1]) / 2,
  );
  context.beginPath();
  context.rect(0, 0, ...camera.size_px);
  context.clip();
  context.lineWidth = (2 * ratio) / scale;
  context.font = `${(13 * ratio) / scale}px system-ui, sans-serif`;
  if (state.points && camera.source === 0) drawPoints(context, camera, source.ego);
  if (layers.lanes) {
    context.strokeStyle = LANE_COLOR;
    // Thin, since far lanes lie on each other.
    context.lineWidth /= 2;
    nearLanes(camera).forEach((line) => stroke(context, geometry.polyline(camera, line, 2)));
    context.lineWidth *= 2;
  }
  if (layers.plan) {
    context.strokeStyle = ALTERNATIVE_COLOR;
    alternatives.forEach((line) => stroke(context, geometry.polyline(camera, line, 6)));
  }
  if (layers.plan && plan.length > 1) {
    context.strokeStyle = PLAN_COLOR;
    context.lineWidth *= 2;
    stroke(context, geometry.polyline(camera, plan, 6));
    context.lineWidth /= 2;
  }
  const selected = camera.source === 0 && agents.find(({ name }) => name === state.selected);
  if (selected) {
    context.strokeStyle = SELECTED_COLOR;
    context.lineWidth *= 1.5;
    stroke(context, geometry.boxLines(camera, selected));
    context.lineWidth /= 1.5;
  }
  further.forEach((draw) => draw(context, camera));
  if (!layers.agents) return;
  agents.forEach((agent) => drawAgent(context, camera, agent));
  if (layers.names) drawNames(context, camera, agents);
}

function stroke(context, lines) {
  context.beginPath();
  lines.forEach(([from, to]) => {
    context.moveTo(...from);
    context.lineTo(...to);
  });
  context.stroke();
}

/** Lanes that come near to what a camera can see, straight above included. */
function nearLanes(camera) {
  const { position_m: at } = camera.pose;
  return state.sources[camera.source].lanes.filter((line) =>
    line.some((point) => Math.hypot(point[0] - at[0], point[1] - at[1]) < LANES_WITHIN_M),
  );
}

function drawPoints(context, camera, ego) {
  const side = 1.5 * context.lineWidth;
  for (let i = 0; i + 3 < state.points.length; i += 4) {
    const [x, y, z, range] = state.points.subarray(i, i + 4);
    const at = geometry.project(camera, geometry.add(ego.position_m, [x, y, z]));
    if (!at) continue;
    [, context.fillStyle] = RANGES.find(([until]) => range < until);
    context.fillRect(at[0] - side / 2, at[1] - side / 2, side, side);
  }
}

function drawAgent(context, camera, agent) {
  context.strokeStyle = COLORS[agent.id % COLORS.length];
  if (state.layers.boxes) stroke(context, geometry.boxLines(camera, agent));
  if (state.layers.trails) {
    const places = (state.trails.get(agent.name) ?? []).map(({ place }) => place);
    stroke(context, geometry.polyline(camera, places, 4));
  }
}

/** Names of `agents`: the selected one, then the nearest first. One that would cover another is left out. */
function drawNames(context, camera, agents) {
  const far = ({ name, pose }) =>
    name === state.selected ? 0 : geometry.length(geometry.subtract(pose.position_m, camera.pose.position_m));
  const sorted = agents.map((agent) => [far(agent), agent]).sort((a, b) => a[0] - b[0]);
  const size = parseFloat(context.font);
  const high = 1.3 * size;
  const drawn = [];
  for (const [, agent] of sorted) {
    const at = geometry.project(camera, geometry.fromLocal(agent.pose, [0, 0, agent.size_m[2] / 2 + 0.3]));
    if (!at) continue;
    const wide = context.measureText(agent.name).width + size / 2;
    const [left, top] = [at[0] - wide / 2, at[1] - size];
    if (drawn.some((other) => Math.abs(other.top - top) < high && left < other.left + other.wide && other.left < left + wide)) continue;
    drawn.push({ left, top, wide });
    context.fillStyle = "#000b";
    context.fillRect(left, top, wide, high);
    context.fillStyle = "#fff";
    context.fillText(agent.name, left + size / 4, at[1]);
  }
}

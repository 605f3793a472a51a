// Views that the browser draws by itself while their camera moves, from splats of the viewer.
import { cameraRequest } from "./cameras.js";
import * as geometry from "./geometry.js";
import { drawOverlay } from "./overlays.js";
import { SLOTS, SplatCanvas } from "./splat_canvas.js";
import { $, state } from "./state.js";

/** What the badge says of such an image. */
export const BADGE = "drawn by the browser, reduced";
/** Shares of the image's size, and splats of the background: from the best to the fastest. */
const LEVELS = [[1, Infinity], [0.5, Infinity], [0.5, 100000], [0.5, 50000], [0.35, 25000], [0.25, 12500]];
const FIRST_LEVEL = 2;
/** Images that take longer are followed by smaller ones, those that take less by larger ones. */
const SLOW_MS = 40;
const FAST_MS = 22;
/** Images that are timed before the level changes. */
const TIMED = 6;
/** Images that are farther apart than this did not wait for each other. */
const PAUSE_MS = 1000;

/** Splats of one source, and the canvas that draws them. */
class Cloud {
  constructor(source) {
    this.source = source;
    this.version = versionOf(source);
    this.origins = [];
    this.canvas = SplatCanvas.create();
    this.works = this.canvas !== null;
    this.isSorting = false;
    /** Camera, agents and chunks that were sorted last: what did not change is not sorted again. */
    this.order = "";
    this.chunks = 0;
    this.loadedMs = null;
    if (!this.works) return;
    const { element } = this.canvas;
    element.setAttribute("aria-hidden", "true");
    element.className = "drawn";
    element.hidden = true;
    element.addEventListener("webglcontextlost", () => this.close());
    this.worker = new Worker("/page/splat_sorter.js", { type: "module" });
    this.worker.onmessage = ({ data }) => this.take(data);
    this.worker.onerror = () => this.close();
    this.worker.postMessage({ kind: "load", url: `/splats/${source}` });
  }

  /** True if there is something to draw. */
  get isReady() {
    return this.works && this.origins.length > 0;
  }

  take(message) {
    if (message.kind === "chunk") {
      if (message.first === 0) this.works = this.canvas.reserve(message.all);
      if (!this.works) return;
      this.canvas.add(message.first, message.words);
      this.origins[message.part] = message.origin;
      this.chunks += 1;
    } else if (message.kind === "sorted") {
      this.isSorting = false;
      this.canvas.order(message.sorted);
    } else if (message.kind === "failed") this.close();
    else this.loadedMs = performance.now();
    if (shown?.cloud === this) paintSoon();
  }

  close() {
    this.works = false;
    this.worker?.terminate();
    if (shown?.cloud === this) hide();
    this.canvas?.element.remove();
  }

  /** The background and the agents as `camera` sees them. */
  placed(camera, hasAgents) {
    const still = { position_m: this.origins[0] ?? [0, 0, 0], rotation: [0, 0, 0, 1] };
    const agents = hasAgents ? state.frame.sources[this.source].agents : [];
    const moving = agents.filter(({ asset }) => asset !== null && this.origins[asset + 1]);
    const all = [{ part: 0, pose: still }, ...moving.map(({ asset, pose }) => ({ part: asset + 1, pose }))];
    return all.slice(0, SLOTS).map(({ part, pose }, slot) => ({ part, slot, rows: rowsOf(camera.pose, pose) }));
  }

  /** Draws what `camera` sees, and lets it be sorted. */
  draw(camera, most, hasAgents) {
    const placed = this.placed(camera, hasAgents);
    const rules = state.sources[this.source].browser;
    const tangents = [0, 1].map((axis) => camera.size_px[axis] / 2 / camera.focal_px[axis]);
    const order = JSON.stringify([placed, tangents, most, this.chunks]);
    if (!this.isSorting && order !== this.order) {
      Object.assign(this, { isSorting: true, order });
      this.worker.postMessage({ kind: "sort", placed, tangents, near: rules.near_m, most });
    }
    this.canvas.draw(new Float32Array(placed.flatMap(({ rows }) => rows)), camera, rules);
  }
}

const versionOf = (source) => state.change?.sources[source]?.splats;

/** Rows of the matrix to the frame of the camera at `from` from the frame at `pose`. */
function rowsOf(from, pose) {
  const to = geometry.toLocal(from, pose.position_m);
  const columns = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) =>
    geometry.subtract(geometry.toLocal(from, geometry.fromLocal(pose, axis)), to),
  );
  return [0, 1, 2].flatMap((row) => [...columns.map((column) => column[row]), to[row]]);
}

const clouds = new Map();
/** View that the browser draws: pane, view, cloud and size in pixels. */
let shown = null;
/** Number of the command whose image replaces it; none while the camera moves. */
let awaited = null;
let painting = 0;
let level = FIRST_LEVEL;
/** Best level that was not too slow. */
let best = 0;
let isKept = false;
let timed = [];
let paintedMs = 0;

export const isShown = () => shown !== null;
/** True if all splats of a source are there. */
export const isReady = (source) => Boolean(clouds.get(source)?.loadedMs);
export const isOn = () => $("browser").checked && !$("browser").disabled;

/** The splats of a source, which are asked for now if they were not. */
function cloudOf(source) {
  const old = clouds.get(source);
  if (old && old.version === versionOf(source)) return old;
  old?.close();
  const cloud = new Cloud(source);
  clouds.set(source, cloud);
  return cloud;
}

/** Names of devices that are none: the processor draws. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|basic render|software/i;

/** Name of the device that the browser draws by; null without WebGL 2. */
function deviceName() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return null;
  const named = gl.getExtension("WEBGL_debug_renderer_info");
  const name = gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return name;
}

const device = deviceName();
/** True if the browser draws where nobody says that it should or should not. */
const isUsual = device !== null && !SOFTWARE.test(device);

/** Ticks the box where a GPU draws. Without WebGL 2 it cannot be ticked. */
export function setUp() {
  const can = device !== null;
  Object.assign($("browser"), { checked: isUsual, disabled: !can });
  if (!can) $("browser-label").title = "This browser has no WebGL 2";
  else if (!isUsual) $("browser-label").title = "This browser draws without a GPU, which is slow";
}

/** The box as a link holds it: "on" or "off"; null where it is as usual. */
export function choice() {
  const { checked, disabled } = $("browser");
  if (disabled || checked === isUsual) return null;
  return checked ? "on" : "off";
}

/** Ticks the box as a link says. */
export function choose(choice) {
  if (choice !== null && !$("browser").disabled) $("browser").checked = choice === "on";
}

/** Asks for the splats that are shown first. */
export function prepare() {
  if (isOn()) cloudOf(0);
}

/**
 * Draws the view of `pane`, whose camera moves, in `size_px`. False where the browser cannot: then
 * the image is asked for.
 */
export function draw(pane, size_px) {
  const isLinked = state.panes.length > 1 && state.sources.length > 1 && $("linked").checked;
  const fits = pane.camera && pane.views.length === 1 && pane.channel === "color" && pane.source !== "both";
  if (!isOn() || !fits || isLinked || !state.frame) return hide();
  const cloud = cloudOf(pane.source === 1 ? 1 : 0);
  if (!cloud.isReady) return hide();
  if (shown && shown.cloud !== cloud) hide();
  shown = { pane, view: pane.views[0], cloud, size_px };
  awaited = null;
  paintSoon();
  return true;
}

/** Tells that the image at rest was asked for, by the command `look`. */
export const asked = (look) => (awaited = look);

/** Lets the image of `frame` replace what the browser drew, if it is the one that was asked for. */
export function arrived(frame) {
  if (!shown) return;
  if (awaited !== null && frame.look >= awaited) hide();
  else paintSoon();
}

function hide() {
  if (shown) shown.cloud.canvas.element.hidden = true;
  shown = null;
  return false;
}

function paintSoon() {
  if (!painting) painting = requestAnimationFrame(paint);
}

/** Camera of a pane as the state has it, in a share of its size; null where its vehicle is gone. */
function cameraOf({ pane, view, cloud, size_px }, share) {
  const { agents, ego } = state.frame.sources[cloud.source];
  const { position_m, rotation, fov_deg, kind, agent } = cameraRequest(pane.camera, null);
  const world = { position_m: [0, 0, 0], rotation: [0, 0, 0, 1] };
  const vehicle = agent ? agents.find(({ name }) => name === agent)?.pose : ego;
  const base = kind === "free" ? world : vehicle;
  if (!base) return null;
  const [width, height] = size_px.map((side) => Math.max(1, Math.round(side * share)));
  const focal = height / 2 / Math.tan((fov_deg * Math.PI) / 360);
  return {
    stream: view.stream, source: cloud.source, size_px: [width, height], focal_px: [focal, focal],
    center_px: [width / 2, height / 2], lens: null,
    pose: { position_m: geometry.fromLocal(base, position_m), rotation: geometry.multiply(base.rotation, rotation) },
  };
}

function paint(now) {
  painting = 0;
  if (!shown) return;
  const { view, cloud } = shown;
  const [share, most] = LEVELS[level];
  const camera = cameraOf(shown, share);
  if (!camera || !view.element.isConnected || !cloud.works) {
    hide();
    return;
  }
  time(now);
  cloud.draw(camera, most, state.layers.agents);
  const { element } = cloud.canvas;
  if (element.parentNode !== view.element) view.overlay.before(element);
  element.hidden = false;
  $("badge").textContent = BADGE;
  $("badge").classList.remove("exact");
  drawOverlay(view, camera, state.frame.sources[cloud.source]);
  window.drawn = { camera, count: cloud.canvas.count, level, images: (window.drawn?.images ?? 0) + 1 };
}

/** Draws by one level from now on, however long it takes. */
export function keepLevel(index) {
  level = index;
  isKept = true;
}

/** Chooses the level by the time between images. */
function time(now) {
  if (isKept) return;
  const took = now - paintedMs;
  paintedMs = now;
  if (took > PAUSE_MS || awaited !== null) timed = [];
  else timed.push(took);
  if (timed.length < TIMED) return;
  // One image that waited for something else does not count.
  const usual = timed.sort((a, b) => a - b)[TIMED >> 1];
  timed = [];
  if (usual > SLOW_MS && level + 1 < LEVELS.length) {
    level += 1;
    best = level;
  } else if (usual < FAST_MS && level > best) level -= 1;
}

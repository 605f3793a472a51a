// Views that the browser draws by itself while their camera moves, from splats of the viewer.
import { placedCamera } from "./cameras.js";
import { DrawingLevels } from "./drawing_levels.js";
import { drawOverlay } from "./overlays.js";
import { SplatCloud } from "./splat_cloud.js";
import { $, state } from "./state.js";

/** What the badge says of such an image. */
export const BADGE = "drawn by the browser, reduced";
const versionOf = (source) => state.change?.sources[source]?.splats;

const clouds = new Map();
/** View that the browser draws: pane, view, cloud and size in pixels. */
let shown = null;
/** Number of the command whose image replaces it; none while the camera moves. */
let awaited = null;
let painting = 0;
const levels = new DrawingLevels();

export const isShown = () => shown !== null;
/** True if all splats of a source are there. */
export const isReady = (source) => Boolean(clouds.get(source)?.loadedMs);
export const isOn = () => $("browser").checked && !$("browser").disabled;

/** The splats of a source, which are asked for now if they were not. */
function cloudOf(source) {
  const old = clouds.get(source);
  if (old && old.version === versionOf(source)) return old;
  old?.close();
  const cloud = new SplatCloud(() => new Worker("/page/splat_sorter.js", { type: "module" }), {
    changed: () => shown?.cloud === cloud && paintSoon(),
    closed: () => shown?.cloud === cloud && hide(),
  });
  Object.assign(cloud, { source, version: versionOf(source) });
  cloud.load(`/splats/${source}`);
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
  const size = size_px.map((side) => Math.max(1, Math.round(side * share)));
  const camera = placedCamera(pane.camera, state.frame.sources[cloud.source], size);
  return camera && { stream: view.stream, source: cloud.source, ...camera };
}

function paint(now) {
  painting = 0;
  if (!shown) return;
  const { view, cloud } = shown;
  const [share, most, faintest] = levels.now;
  const camera = cameraOf(shown, share);
  if (!camera || !view.element.isConnected || !cloud.works) {
    hide();
    return;
  }
  levels.time(now, awaited !== null);
  const agents = state.layers.agents ? state.frame.sources[cloud.source].agents : [];
  cloud.draw(camera, most, agents, { ...state.sources[cloud.source].browser, faintest });
  const { element } = cloud.canvas;
  if (element.parentNode !== view.element) view.overlay.before(element);
  element.hidden = false;
  $("badge").textContent = BADGE;
  $("badge").classList.remove("exact");
  drawOverlay(view, camera, state.frame.sources[cloud.source]);
  window.drawn = { camera, count: cloud.canvas.count, level: levels.level, images: (window.drawn?.images ?? 0) + 1 };
}

/** Time that the last image of a moving camera took, milliseconds. */
export const imageMs = () => (shown ? levels.tookMs : 0);

/** Draws by one level from now on, however long it takes. */
export const keepLevel = (level) => levels.keep(level);

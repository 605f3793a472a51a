// Camera paths: keyframes, their preview, files, and what "Record" is told of them.
import * as geometry from "./geometry.js";
import { download, fileSafe } from "./files.js";
import { $, make, nameOf, notice, state } from "./state.js";
import { goTo } from "./timeline.js";
import * as views from "./views.js";

const COLOR = "#ff7ab8";
const VERSION = 1;
const FILE_BYTES_MAX = 1 << 20;
/** Seconds between keys where the scene has no time. */
const BETWEEN_S = 2;
/** Pieces of the line between two keys. */
const PIECES = 16;

/** Keys as the file has them, in the order of their times. */
let keys = [];
let previewing = 0;

export const count = () => keys.length;

/** Keys that a recording follows; none where it is not to follow the path. */
export const recorded = () => ($("record-path").checked ? keys : []);

/** First and last time of the path, seconds. */
export const span = () => [keys[0].time_s, keys.at(-1).time_s];

const hasTime = () => state.change.span_s[1] > state.change.span_s[0];

/** Adds what the chosen view shows as a key: at the time of the clock, or after the last key. */
export function addKey() {
  const pane = views.activePane();
  const shown = views.shownCamera(pane);
  const fov_deg = pane.camera?.fov ?? views.shownFov(pane);
  if (!shown || fov_deg === null || pane.views.length !== 1) {
    notice("A key is a view by one camera without a lens: choose another camera.", true);
    return;
  }
  const last = keys.at(-1)?.time_s;
  const time_s = hasTime() ? state.clock.time_s : last === undefined ? 0 : last + BETWEEN_S;
  const { position_m, rotation } = shown.pose;
  const others = keys.filter((key) => Math.abs(key.time_s - time_s) > 1e-6);
  setKeys([...others, { time_s, position_m, rotation, fov_deg }]);
}

function setKeys(next) {
  keys = next.sort((a, b) => a.time_s - b.time_s);
  showKeys();
  views.drawOverlays();
}

function showKeys() {
  const entries = keys.map((key, index) => {
    const go = make("button", { textContent: `${key.time_s.toFixed(2)} s`, onclick: () => goToKey(key) });
    go.setAttribute("aria-label", `Go to key ${index + 1}, ${key.time_s.toFixed(2)} s`);
    const remove = make("button", { textContent: "Remove", onclick: () => setKeys(keys.filter((one) => one !== key)) });
    remove.setAttribute("aria-label", `Remove key ${index + 1}`);
    return make("li", {}, go, " ", remove);
  });
  $("keyframes").replaceChildren(...entries);
  ["path-preview", "path-save", "path-clear"].forEach((id) => ($(id).disabled = keys.length === 0));
  $("record-path").disabled = keys.length === 0;
  if (keys.length === 0) $("record-path").checked = false;
}

/** Looks by the camera of a key, without its roll: cameras of the user have none. */
function lookBy({ position_m, rotation, fov_deg }, moving) {
  const pane = views.activePane();
  if (pane.choice !== "fly") views.choose(pane, "fly");
  Object.assign(pane.camera, { at: position_m, fov: fov_deg, ...geometry.anglesOf(pane.camera.axes, rotation) });
  views.share(pane);
  views.look(moving);
}

function goToKey(key) {
  if (hasTime()) goTo(key.time_s);
  lookBy(key, false);
}

const numbersOf = ({ position_m, fov_deg }) => [...position_m, fov_deg];

/** Change per second at key `index`: that between its neighbors. */
function slope(index) {
  const [from, to] = [keys[Math.max(0, index - 1)], keys[Math.min(keys.length - 1, index + 1)]];
  const seconds = Math.max(to.time_s - from.time_s, Number.MIN_VALUE);
  return numbersOf(to).map((value, axis) => (value - numbersOf(from)[axis]) / seconds);
}

/** Rotation at `share` of the way between two, along the shorter great circle. */
export function slerp(a, b, share) {
  let cos = a.reduce((sum, value, i) => sum + value * b[i], 0);
  const to = cos < 0 ? b.map((value) => -value) : b;
  cos = Math.min(1, Math.abs(cos));
  const angle = Math.acos(cos);
  const weights = angle < 1e-4 ? [1 - share, share] : [Math.sin((1 - share) * angle), Math.sin(share * angle)].map((w) => w / Math.sin(angle));
  const mixed = a.map((value, i) => weights[0] * value + weights[1] * to[i]);
  const size = Math.hypot(...mixed);
  return mixed.map((value) => value / size);
}

/** The camera at a time, as the recording and `render` compute it. */
export function at(time_s) {
  const after = keys.findIndex((key) => key.time_s > time_s);
  if (after <= 0) return keys.at(after === 0 ? 0 : -1);
  const [from, to] = [keys[after - 1], keys[after]];
  const seconds = to.time_s - from.time_s;
  const s = (time_s - from.time_s) / seconds;
  const rest = 1 - s;
  const [begins, ends] = [slope(after - 1), slope(after)];
  const [x, y, z, fov_deg] = numbersOf(from).map((value, axis) => {
    const next = numbersOf(to)[axis];
    const between = value * rest * rest * (1 + 2 * s) + next * s * s * (3 - 2 * s);
    return between + seconds * s * rest * (begins[axis] * rest - ends[axis] * s);
  });
  return { time_s, position_m: [x, y, z], rotation: slerp(from.rotation, to.rotation, s), fov_deg };
}

function stopPreview() {
  cancelAnimationFrame(previewing);
  previewing = 0;
  $("path-preview").textContent = "Preview";
}

/** Flies along the path once, in its own time. */
export function preview() {
  if (previewing) {
    stopPreview();
    return;
  }
  const [begin, end] = span();
  const started = performance.now();
  $("path-preview").textContent = "Stop";
  const step = (now) => {
    const time_s = Math.min(end, begin + Math.max(0, now - started) / 1000);
    if (hasTime()) goTo(time_s);
    lookBy(at(time_s), time_s < end);
    if (time_s < end) previewing = requestAnimationFrame(step);
    else stopPreview();
  };
  previewing = requestAnimationFrame(step);
}

// Files -------------------------------------------------------------------------------------------

function save() {
  const title = fileSafe(nameOf(state.sources[0]).replace(/\.[^.]*$/, ""));
  download(`${title}_path.json`, `${JSON.stringify({ camera_path: VERSION, keys }, null, 1)}\n`, "application/json");
}

const isNumber = (value) => typeof value === "number" && Math.abs(value) < 1e9;
const areNumbers = (list, length) => Array.isArray(list) && list.length === length && list.every(isNumber);

/** Keys of a file; null where it is no camera path. */
export function keysIn(text) {
  try {
    const file = JSON.parse(text);
    const fit = file.camera_path === VERSION && file.keys.length > 0 && file.keys.length <= 1000 && file.keys.every((key, index) =>
      isNumber(key.time_s) && (index === 0 || key.time_s > file.keys[index - 1].time_s)
      && areNumbers(key.position_m, 3) && areNumbers(key.rotation, 4) && Math.hypot(...key.rotation) > 1e-6
      && key.fov_deg >= 0.1 && key.fov_deg <= 160);
    return fit ? file.keys.map(({ time_s, position_m, rotation, fov_deg }) => ({ time_s, position_m, rotation, fov_deg })) : null;
  } catch {
    return null;
  }
}

/** Takes the keys of a file that was chosen or dropped. */
export async function open(file) {
  const read = file.size <= FILE_BYTES_MAX ? keysIn(await file.text()) : null;
  if (!read) {
    notice(`${file.name} is no camera path.`, true);
    return;
  }
  setKeys(read);
  $("path-panel").open = true;
  notice(`${file.name}: a camera path of ${read.length} keys.`);
}

/** Draws the path and its keys over the image of `camera`. */
export function draw(context, camera) {
  if (keys.length === 0 || !$("path-panel").open) return;
  const times = keys.slice(1).flatMap((key, index) => {
    const from = keys[index].time_s;
    return Array.from({ length: PIECES }, (_, piece) => from + ((key.time_s - from) * piece) / PIECES);
  });
  const points = [...times.map((time_s) => at(time_s)), keys.at(-1)].map(({ position_m }) => position_m);
  context.strokeStyle = context.fillStyle = COLOR;
  context.beginPath();
  geometry.polyline(camera, points, 2).forEach(([from, to]) => {
    context.moveTo(...from);
    context.lineTo(...to);
  });
  context.stroke();
  const side = 4 * context.lineWidth;
  keys.forEach(({ position_m }) => {
    const place = geometry.project(camera, position_m);
    if (place) context.fillRect(place[0] - side / 2, place[1] - side / 2, side, side);
  });
}

export function prepare() {
  $("path-add").onclick = addKey;
  $("path-clear").onclick = () => setKeys([]);
  $("path-preview").onclick = preview;
  $("path-save").onclick = save;
  $("path-open").onclick = () => $("path-file").click();
  $("path-file").onchange = async ({ target }) => {
    if (target.files[0]) await open(target.files[0]);
    target.value = "";
  };
  $("path-panel").ontoggle = () => views.drawOverlays();
  showKeys();
}

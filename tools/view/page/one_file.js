// The page in one file: a scene that the browser draws by itself, without a viewer.
import { makeAxes } from "./axes.js";
import { axesOfSource, cameraChoices, firstChoice, newCamera, placedCamera } from "./cameras.js";
import { DrawingLevels, FULL } from "./drawing_levels.js";
import * as geometry from "./geometry.js";
import { drawOverlay } from "./overlays.js";
import { SplatCloud } from "./splat_cloud.js";
import { $, make, notice, state } from "./state.js";
import * as steering from "./steering.js";
import { Tracks, bytesOf } from "./tracks.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];
const FLY_SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4, 10, 20];
/** Time after the last movement until all splats are drawn in full size. */
const REST_MS = 150;
const SIDE_MAX_PX = 4096;
/** Widest image of a camera whose lens is not drawn: half of its angle, as a tangent. */
const TANGENT_MAX = Math.tan((55 * Math.PI) / 180);
const LAYERS = { boxes: "Boxes", names: "Names", lanes: "Lanes", axes: "Axes" };
const LAYER_KEYS = { b: "boxes", n: "names", l: "lanes" };
const KEYS = [
  ["drag", "turn; with the right button or Shift move"], ["wheel", "nearer or farther"],
  ["two fingers", "nearer, farther and move"], ["w a s d q e", "fly; with Shift faster"],
  ["arrows", "turn the camera"], ["+ -", "fly faster or slower"], ["c", "next camera"],
  ["f", "circle around all of a splat file, or the place ahead on a street; with Shift the first view again"],
];
const TIME_KEYS = [
  ["Space", "play or pause"], [", .", "one step back or forward"], ["[ ]", "slower or faster"],
  ["Home End", "first or last moment"],
];
const AGENT_KEYS = [["b n l", "boxes, names, lanes on or off"]];

const scene = JSON.parse($("scene").textContent);
$("scene").remove();
const tracks = new Tracks(scene.tracks);
const [beginS, endS] = tracks.span_s;
const moves = endS > beginS;
const levels = new DrawingLevels();
const clock = { time_s: scene.first_s ?? beginS, playing: false, speed: 1, advancedMs: 0 };
const pane = { camera: null, choice: "" };
const view = { element: $("views"), overlay: make("canvas"), axes: null };

Object.assign(state, { sources: [scene], axes: axesOfSource(scene) });
Object.assign(state.layers, { plan: false });

// Images ------------------------------------------------------------------------------------------

let painting = 0;
let isResting = true;
let restTimer = 0;

const cloud = new SplatCloud(makeWorker, { changed: paintSoon, closed: () => notice(CANNOT, true) });
const CANNOT = "The browser has stopped drawing: reload the page.";

function makeWorker() {
  const text = $("sorter").textContent;
  const address = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  return new Worker(address);
}

function paintSoon() {
  if (!painting) painting = requestAnimationFrame(paint);
}

/** Lets the image follow the camera, and draws all of it when nothing has moved for a while. */
function moved() {
  isResting = false;
  if (window.drawn) window.drawn.isWhole = false;
  clearTimeout(restTimer);
  restTimer = setTimeout(() => {
    isResting = true;
    paintSoon();
  }, REST_MS);
  paintSoon();
}

/** Width and height of the view, pixels of the screen. */
function sizeOf() {
  const { width, height } = view.element.getBoundingClientRect();
  const ratio = window.devicePixelRatio || 1;
  return [width, height].map((side) => Math.min(SIDE_MAX_PX, Math.max(16, Math.round(side * ratio))));
}

/** Index of the camera of the rig that is looked through; -1 for a camera of the user. */
const named = () => scene.cameras.findIndex(({ name }) => pane.choice === `named:${name}`);

/** The camera of the view, in an image that fits into `size_px`. */
function cameraIn(size_px, present) {
  if (pane.camera) return placedCamera(pane.camera, present, size_px);
  const index = named();
  const { size_px: own, focal_px: focal, center_px: center, lens } = scene.cameras[index];
  const share = Math.min(size_px[0] / own[0], size_px[1] / own[1]);
  const size = own.map((side) => Math.max(1, Math.round(side * share)));
  const scaled = (values) => values.map((value, axis) => (value * size[axis]) / own[axis]);
  const pose = tracks.cameraAt(index, clock.time_s);
  if (!lens) return { size_px: size, focal_px: scaled(focal), center_px: scaled(center), lens: null, pose };
  const least = Math.max(...size) / 2 / TANGENT_MAX;
  const straight = Math.max(least, ...scaled(focal));
  return { size_px: size, focal_px: [straight, straight], center_px: size.map((side) => side / 2), lens: null, pose };
}

function paint(now) {
  painting = 0;
  advance(now);
  if (!cloud.isReady) return;
  const isMoving = clock.playing || !isResting || cloud.loadedMs === null;
  if (isMoving) levels.time(now, false);
  const [share, most, faintest] = isMoving ? levels.now : FULL;
  const present = tracks.at(clock.time_s);
  const size = sizeOf().map((side) => Math.max(1, Math.round(side * share)));
  const camera = cameraIn(size, present);
  cloud.draw(camera, most, present.agents, { ...scene.browser, faintest });
  cloud.canvas.element.hidden = false;
  drawOverlay(view, { ...camera, source: 0 }, present);
  showBadge();
  const images = (window.drawn?.images ?? 0) + 1;
  const isWhole = !isMoving && !cloud.isSorting;
  window.drawn = { camera, count: cloud.canvas.count, time_s: clock.time_s, agents: present.agents, images, isWhole };
  if (clock.playing) paintSoon();
}

const count = (number) => number.toLocaleString("en-US");

function showBadge() {
  const { kept, all } = scene.splats;
  if (cloud.loadedMs === null) $("badge").textContent = `loading ${Math.floor((100 * cloud.splats) / kept)} %`;
  else if (kept < all) $("badge").textContent = `drawn by the browser, reduced: ${count(kept)} of ${count(all)} splats`;
  else $("badge").textContent = `drawn by the browser: all ${count(all)} splats`;
}

/** Gives the splats to the worker piece by piece, so that they are never there twice. */
async function load() {
  for (const piece of document.querySelectorAll("script.splats")) {
    cloud.give(bytesOf(piece.textContent));
    piece.remove();
    await new Promise((resolve) => setTimeout(resolve));
  }
  cloud.give(null);
}

// The camera --------------------------------------------------------------------------------------

function choose(choice) {
  const isNamed = choice.startsWith("named:");
  const follows = ["follow", "driver", "birds-eye"].includes(choice) && scene.has_ego;
  pane.choice = choice;
  pane.camera = isNamed ? null : newCamera(choice, follows ? "" : null, scene);
  $("camera").value = choice;
  showCamera();
  moved();
}

/** A camera of the rig becomes one that can be moved, from where it is. */
function movable() {
  if (pane.camera) return pane.camera;
  const { pose, size_px: size, focal_px: focal } = cameraIn(sizeOf(), tracks.at(clock.time_s));
  choose("fly");
  const fov = (360 / Math.PI) * Math.atan(size[1] / 2 / focal[1]);
  return Object.assign(pane.camera, { at: pose.position_m, ...geometry.anglesOf(state.axes, pose.rotation), fov });
}

function showCamera() {
  const { camera } = pane;
  $("fov").disabled = !camera;
  $("reset").disabled = !camera;
  if (camera) $("fov").value = camera.fov;
  $("fov-said").textContent = camera ? `${camera.fov.toFixed(camera.fov < 10 ? 1 : 0)}°` : "–";
}

/** Angles from the horizon that are straight up or down, radians: there a camera keeps its yaw. */
const VERTICAL_RAD = 1.57;

/** Looks at what the camera circles around from the side `from`, a unit vector of the world. */
function lookFrom(from) {
  if (!pane.camera?.focus || pane.camera.rig !== null) choose("orbit");
  const { camera } = pane;
  const { yaw, pitch } = geometry.anglesOfDirection(camera.axes, geometry.scale(from, -1));
  Object.assign(camera, { pitch, yaw: Math.abs(pitch) > VERTICAL_RAD ? camera.yaw : yaw });
  moved();
}

function changeFlySpeed(by) {
  const at = FLY_SPEEDS.indexOf(state.flySpeed) + by;
  state.flySpeed = FLY_SPEEDS[Math.max(0, Math.min(FLY_SPEEDS.length - 1, at))];
}

const reset = () => pane.camera && choose(pane.choice);

// Time --------------------------------------------------------------------------------------------

function showClock() {
  const { time_s: time, playing } = clock;
  if (document.activeElement !== $("time") || playing) $("time").value = time;
  $("time").setAttribute("aria-valuetext", `${time.toFixed(1)} seconds`);
  $("clock").textContent = `${time.toFixed(2)} s`;
  $("play").textContent = playing ? "Pause" : "Play";
}

/** Lets a clock that plays go on to `now`. */
function advance(now) {
  if (!clock.playing) return;
  const time = clock.time_s + (clock.speed * Math.max(0, now - clock.advancedMs)) / 1000;
  clock.advancedMs = now;
  const isOver = time >= endS;
  clock.time_s = isOver && $("loop").checked ? beginS : Math.min(endS, time);
  if (isOver && !$("loop").checked) play(false);
  showClock();
}

function play(playing) {
  if (playing && clock.time_s >= endS) clock.time_s = beginS;
  Object.assign(clock, { playing, advancedMs: performance.now() });
  showClock();
  moved();
}

function goTo(time_s) {
  clock.time_s = Math.max(beginS, Math.min(endS, time_s));
  showClock();
  moved();
}

function setSpeed(speed) {
  clock.speed = speed;
  $("speed").value = speed;
}

// Keys and buttons --------------------------------------------------------------------------------

function setLayer(name, shown) {
  state.layers[name] = shown;
  $(`layer-${name}`).checked = shown;
  moved();
}

function timePress(key) {
  const at = SPEEDS.indexOf(clock.speed);
  const presses = {
    " ": () => play(!clock.playing),
    ",": () => goTo(clock.time_s - tracks.step_s),
    ".": () => goTo(clock.time_s + tracks.step_s),
    "[": () => setSpeed(SPEEDS[Math.max(0, at - 1)]),
    "]": () => setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, at + 1)]),
    home: () => goTo(beginS),
    end: () => goTo(endS),
  };
  return moves ? presses[key] : undefined;
}

function onePress(key, event) {
  const presses = {
    f: () => (event.shiftKey ? reset() : choose("orbit")),
    c: () => choose($("camera").options[($("camera").selectedIndex + 1) % $("camera").options.length].value),
    "+": () => changeFlySpeed(1),
    "-": () => changeFlySpeed(-1),
    "?": () => $("keys").showModal(),
  };
  return presses[key] ?? timePress(key);
}

function pressed(event) {
  const { target } = event;
  const key = event.key.toLowerCase();
  if (document.querySelector("dialog[open]") || target.tagName === "SELECT") return;
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  const isPressedByKey = [" ", "enter"].includes(key) && (target.tagName === "BUTTON" || target.type === "checkbox");
  const movesSlider = target.type === "range" && (key.startsWith("arrow") || ["home", "end"].includes(key));
  if (isPressedByKey || movesSlider) return;
  const layer = LAYER_KEYS[key];
  if (steering.isHeld(key)) steering.hold(key, event.shiftKey);
  else if (layer && $(`layer-${layer}`)) setLayer(layer, !state.layers[layer]);
  else if (onePress(key, event)) onePress(key, event)();
  else return;
  event.preventDefault();
}

function setTheme(light) {
  document.documentElement.dataset.theme = light ? "light" : "dark";
  $("theme").textContent = light ? "Dark" : "Light";
}

/** Layers that have something to show. */
function layersOf() {
  const has = { boxes: tracks.agents.length > 0, names: tracks.agents.length > 0, lanes: scene.lanes.length > 0, axes: true };
  return Object.entries(LAYERS).filter(([name]) => has[name]);
}

function showAbout() {
  const { kept, all } = scene.splats;
  const rest = kept < all ? `, those that cover most of its ${count(all)}` : ", which are all that it has";
  const rate = moves ? ` What moves has ${(1 / tracks.step_s).toFixed(1)} poses per second; between them it goes straight.` : "";
  $("about-splats").textContent = `This page holds ${count(kept)} splats of ${scene.title}${rest}.${rate}`;
  $("about-missing").append(...scene.missing.map((text) => make("li", { textContent: text })));
  $("about-missing-said").hidden = scene.missing.length === 0;
  $("about-version").textContent = `Made by DecoupleGS ${scene.version}.`;
}

function prepare() {
  $("name").textContent = scene.title;
  const choices = cameraChoices(scene).filter(([value]) => value !== "rig");
  choices.forEach(([value, text]) => $("camera").add(new Option(text, value)));
  $("camera").onchange = () => choose($("camera").value);
  $("frame-all").onclick = () => choose("orbit");
  $("reset").onclick = reset;
  $("fov").oninput = () => {
    pane.camera.fov = Number($("fov").value);
    showCamera();
    moved();
  };
  layersOf().forEach(([name, text]) => {
    const box = make("input", { type: "checkbox", id: `layer-${name}`, checked: state.layers[name] });
    box.onchange = () => setLayer(name, box.checked);
    $("layers").append(make("label", {}, box, ` ${text}`));
  });
  SPEEDS.forEach((speed) => $("speed").add(new Option(`${speed}×`, speed)));
  $("speed").value = 1;
  $("speed").onchange = () => setSpeed(Number($("speed").value));
  $("timeline").hidden = !moves;
  Object.assign($("time"), { min: beginS, max: endS });
  $("time").oninput = () => goTo(Number($("time").value));
  $("play").onclick = () => play(!clock.playing);
  $("about").onclick = () => $("about-dialog").showModal();
  $("help").onclick = () => $("keys").showModal();
  $("theme").onclick = () => setTheme(document.documentElement.dataset.theme !== "light");
  setTheme(window.matchMedia("(prefers-color-scheme: light)").matches);
  const keys = [...KEYS, ...(moves ? TIME_KEYS : []), ...(tracks.agents.length > 0 ? AGENT_KEYS : [])];
  keys.forEach(([key, meaning]) => {
    $("key-list").append(make("dt", {}, make("kbd", { textContent: key })), make("dd", { textContent: meaning }));
  });
  showAbout();
  showClock();
}

function showView() {
  const { element, overlay } = view;
  overlay.setAttribute("aria-hidden", "true");
  view.axes = makeAxes(lookFrom);
  const box = make("div", { className: "view" }, cloud.canvas.element, overlay, view.axes.element);
  box.setAttribute("role", "group");
  box.setAttribute("aria-label", `Image: ${scene.title}`);
  element.replaceChildren(box);
  view.element = box;
  const control = { camera: movable, moved };
  steering.steer(box, control);
  steering.flyBy({ ...control, speed: () => state.flySpeed });
  window.addEventListener("keydown", pressed);
  window.addEventListener("keyup", ({ key }) => steering.release(key.toLowerCase()));
  window.addEventListener("blur", steering.releaseAll);
  new ResizeObserver(moved).observe(box);
}

prepare();
if (cloud.works) {
  showView();
  choose(firstChoice(scene));
  load();
} else {
  $("badge").textContent = "not drawn";
  $("empty").textContent = "This browser has no WebGL 2, by which the page draws: open it in another browser, or switch on hardware acceleration.";
}

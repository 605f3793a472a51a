// Views: panes and their images, what they ask for, and the mouse over them.
import { makeAxes } from "./axes.js";
import * as browser from "./browser_drawing.js";
import { cameraChoices, cameraRequest, newCamera } from "./cameras.js";
import { describe, showBoth } from "./compare.js";
import * as geometry from "./geometry.js";
import { drawOverlay } from "./overlays.js";
import { flyBy, steer } from "./steering.js";
import { $, ask, make, nameOf, send, state } from "./state.js";

const REST_MS = 150;
/** It rests later where the browser draws slowly: events come as slowly as images then. */
const REST_IMAGES = 3;
const LOOK_MS = 33;
const PANES_MAX = 16;
/** Streams of the second source are this much above those of the first. */
const OTHER = 32;
const CHANNELS = {
  color: "Color", depth: "Depth", range: "Distance", instance: "Agents by color",
  normal: "Surface direction", flow: "Motion", alpha: "Opacity",
};
const MODES = { wipe: "Wipe", blink: "Blink", difference: "Difference" };

let measuring = { isOn: () => false, place: () => {} };
/** Lets clicks go to `measure` while it is on. */
export const onMeasured = (measure) => (measuring = measure);

let chosen = () => {};
/** Calls `then` when an agent is chosen with the mouse. */
export const onChosen = (then) => (chosen = then);

// Panes ---------------------------------------------------------------------------------------

const sourceOf = (pane) => state.sources[pane.source === 1 ? 1 : 0];

function menu(pane, label, entries, changed) {
  const select = make("select", { onchange: () => changed(select.value) });
  select.setAttribute("aria-label", `${label} of view ${pane.number + 1}`);
  entries.forEach(([value, text]) => select.add(new Option(text, value)));
  pane.bar.append(select);
  return select;
}

/** Adds a pane that shows source `source`: 0, 1 or "both". */
export function addPane(source = 0) {
  const number = state.panes.length;
  const [bar, box] = [make("div", { className: "bar" }), make("div", { className: "views" })];
  const element = make("section", { className: "pane" }, bar, box);
  element.setAttribute("aria-label", `View ${number + 1}`);
  const pane = {
    element, bar, box, number, source, views: [], channel: "color", choice: "", camera: null,
    mode: "wipe", wipe: 50, factor: 16, blink: false,
  };
  if (state.sources.length > 1) {
    const names = [["0", `A: ${nameOf(state.sources[0])}`], ["1", `B: ${nameOf(state.sources[1])}`], ["both", "A and B"]];
    pane.sources = menu(pane, "Content", names, (value) => {
      pane.source = value === "both" ? value : Number(value);
      choose(pane, pane.choice, pane.camera?.rig);
    });
    pane.sources.value = String(source);
    pane.sources.title = state.sources.map(({ title }, index) => `${"AB"[index]}: ${title}`).join("\n");
  }
  pane.select = menu(pane, "Camera", cameraChoices(sourceOf(pane)), (value) => choose(pane, value));
  pane.channels = menu(pane, "Image kind", Object.entries(CHANNELS), (value) => {
    pane.channel = value;
    look();
  });
  addComparison(pane);
  element.addEventListener("pointerdown", () => activate(number));
  element.addEventListener("focusin", () => activate(number));
  $("panes").append(element);
  state.panes.push(pane);
  steerBy(pane);
  new ResizeObserver(() => look()).observe(box);
  return pane;
}

function addComparison(pane) {
  const bar = make("div", { className: "comparison", hidden: true });
  const inner = { ...pane, bar };
  const changed = () => compare(pane);
  pane.modes = menu(inner, "Comparison", Object.entries(MODES), (value) => {
    pane.mode = value;
    changed();
  });
  const wipe = make("input", { type: "range", min: 0, max: 100, value: pane.wipe });
  wipe.setAttribute("aria-label", "Border between A and B");
  wipe.oninput = () => {
    pane.wipe = wipe.value;
    changed();
  };
  const blink = make("button", { textContent: "Show B", title: "Hold to see B (x)" });
  const hold = (shown) => () => setBlink(pane, shown);
  Object.assign(blink, { onpointerdown: hold(true), onpointerup: hold(false), onpointerleave: hold(false) });
  blink.onkeydown = ({ key }) => [" ", "Enter"].includes(key) && setBlink(pane, true);
  blink.onkeyup = hold(false);
  const factors = menu(inner, "Factor of the difference", [1, 4, 16, 64].map((k) => [k, `${k}×`]), (value) => {
    pane.factor = Number(value);
    changed();
  });
  factors.value = pane.factor;
  const said = make("output", { className: "said" });
  bar.append(wipe, blink, said);
  Object.assign(pane, { comparison: bar, parts: { wipe, blink, difference: factors }, said });
  pane.bar.append(bar);
}

export function setBlink(pane, shown) {
  pane.blink = shown;
  compare(pane);
}

/** Shows the views of a pane of two sources. */
function compare(pane) {
  pane.comparison.hidden = pane.source !== "both";
  if (pane.source !== "both") return;
  Object.entries(pane.parts).forEach(([mode, part]) => (part.hidden = mode !== pane.mode));
  const measured = pane.views.map((view) => showBoth(view, pane)).filter((one) => one);
  const exact = state.frame?.badge.startsWith("exact");
  pane.said.textContent = exact ? describe(measured) : "";
}

export function activate(number) {
  state.active = number;
  state.panes.forEach((pane) => pane.element.classList.toggle("active", pane.number === number));
}

export const activePane = () => state.panes[state.active];

/** Lets a pane look by a camera; `rig` is the vehicle that it is fixed to. */
export function choose(pane, choice, rig) {
  pane.choice = choice;
  const source = sourceOf(pane);
  const own = choice === "rig" || choice.startsWith("named:");
  const follows = ["follow", "driver", "birds-eye"].includes(choice) && source.has_ego;
  pane.camera = own ? null : newCamera(choice, rig ?? (follows ? "" : null), source);
  pane.select.value = [...pane.select.options].some((o) => o.value === choice) ? choice : "";
  layOut(pane);
  share(pane);
  look();
}

/** Gives the camera of `pane` to the other pane, where both are to look alike. */
export function share(pane) {
  if (!$("linked").checked || state.sources.length < 2) return;
  const other = state.panes.find((one) => one !== pane);
  if (!other) return;
  const again = other.choice !== pane.choice;
  Object.assign(other, { choice: pane.choice, camera: structuredClone(pane.camera) });
  other.select.value = pane.select.value;
  if (again) layOut(other);
}

/** Makes the canvases of a pane: one, or one for each camera of the rig. */
function layOut(pane) {
  const most = pane.source === "both" ? PANES_MAX / 2 - 1 : PANES_MAX - 2;
  const all = sourceOf(pane).cameras.map((camera) => camera.name).slice(0, most);
  const named = pane.choice.startsWith("named:") ? [pane.choice.slice(6)] : [null];
  const cameras = pane.choice === "rig" ? all : named;
  pane.box.style.gridTemplateColumns = `repeat(${Math.ceil(Math.sqrt(cameras.length))}, 1fr)`;
  pane.box.replaceChildren();
  pane.views = cameras.map((camera, index) => {
    const [image, other, difference, overlay] = [0, 1, 2, 3].map(() => make("canvas"));
    const title = camera ?? pane.select.selectedOptions[0]?.text ?? "View";
    image.setAttribute("role", "img");
    image.setAttribute("aria-label", `Image: ${title}`);
    [other, difference, overlay].forEach((canvas) => canvas.setAttribute("aria-hidden", "true"));
    other.hidden = difference.hidden = true;
    const element = make("div", { className: "view" }, image, other, difference, overlay);
    if (cameras.length > 1) element.append(make("span", { className: "name", textContent: camera }));
    const axes = cameras.length === 1 ? makeAxes((from) => lookFrom(pane, from)) : null;
    if (axes) element.append(axes.element);
    pane.box.append(element);
    const stream = pane.number * 64 + index;
    return { camera, element, image, other, difference, overlay, axes, stream, pane };
  });
  compare(pane);
}

// What is asked for ------------------------------------------------------------------------------

let lastLook = 0;
let pendingLook = 0;
let restTimer = 0;

/**
 * Asks for what the views show now. While the camera of `pane` moves and the browser draws it, the
 * renderer is asked once it is at rest.
 */
export function look(moving = false, pane = null) {
  state.moving = moving;
  if (moving) {
    clearTimeout(restTimer);
    restTimer = setTimeout(() => look(false), Math.max(REST_MS, REST_IMAGES * browser.imageMs()));
    if (pane && browser.draw(pane, sizeOf(pane.views[0])) && !state.clock.playing) return;
  }
  const wait = moving ? lastLook + LOOK_MS - performance.now() : 0;
  if (pendingLook) return;
  pendingLook = setTimeout(() => {
    pendingLook = 0;
    lastLook = performance.now();
    sendLook();
  }, Math.max(0, wait));
}

/** Width and height of the image of a view, pixels. */
function sizeOf(view) {
  const { width, height } = view.element.getBoundingClientRect();
  const ratio = Math.min(window.devicePixelRatio || 1, Number($("width").value) / Math.max(1, width));
  return [width, height].map((css) => Math.round(Math.min(4096, Math.max(16, css * ratio))));
}

function sendLook() {
  const panes = state.panes.flatMap((pane) =>
    pane.views.flatMap((view) => {
      const [width, height] = sizeOf(view);
      const asked = {
        stream: view.stream, source: pane.source === 1 ? 1 : 0,
        width_px: width, height_px: height,
        camera: cameraRequest(pane.camera, view.camera), channel: pane.channel,
        agents: state.layers.agents,
      };
      if (pane.source !== "both") return [asked];
      return [asked, { ...asked, stream: view.stream + OTHER, source: 1 }];
    }),
  );
  if (panes.length === 0) return;
  const lidar = $("lidar").value || null;
  send("look", { panes, moving: state.moving, reduce: $("reduce").checked, lidar });
  if (!state.moving) browser.asked(state.connection.newestLook);
}

const views = () => state.panes.flatMap((pane) => pane.views);

export function showImages(images, points) {
  state.points = points ?? null;
  images.forEach(({ stream, bitmap, kind, data, size_px: [width, height] }) => {
    const isOther = stream % 64 >= OTHER;
    const view = views().find((one) => one.stream === stream - (isOther ? OTHER : 0));
    if (!view) return;
    const canvas = isOther ? view.other : view.image;
    // As it came, for a file: exact images alone are PNG.
    view[isOther ? "otherPng" : "png"] = kind === "image/png" ? data : null;
    Object.assign(canvas, { width, height });
    canvas.getContext("2d", { willReadFrequently: view.pane.source === "both" }).drawImage(bitmap, 0, 0);
  });
  state.panes.forEach(compare);
}

export function drawOverlays() {
  state.frame?.panes.forEach((camera) => {
    const view = views().find((one) => one.stream === camera.stream);
    if (view) drawOverlay(view, camera, state.frame.sources[camera.source]);
  });
}

// The mouse -----------------------------------------------------------------------------------

/** A camera of the file becomes one that can be moved, from where it is. */
export function movable(pane) {
  if (pane.camera) return pane.camera;
  const shown = cameraOf(pane.views[0]);
  if (!shown || pane.views.length !== 1) return null;
  const angles = geometry.anglesOf(state.axes, shown.pose.rotation);
  const fov = shownFov(pane) ?? pane.camera?.fov;
  choose(pane, "fly");
  Object.assign(pane.camera, { at: shown.pose.position_m, ...angles, ...(fov ? { fov } : {}) });
  return pane.camera;
}

/** Camera of the newest image of a pane. */
export const shownCamera = (pane) => cameraOf(pane.views[0]);

/** Vertical field of view of the image of a pane, degrees; null where a lens bends it. */
export function shownFov(pane) {
  const shown = shownCamera(pane);
  if (!shown || shown.lens) return null;
  return (360 / Math.PI) * Math.atan(shown.size_px[1] / 2 / shown.focal_px[1]);
}

/** View and pixel in the middle of a pane's first view. */
export function underMiddle(pane) {
  const camera = state.frame && shownCamera(pane);
  return camera ? { view: pane.views[0], camera, at: [0.5, 0.5] } : null;
}

const cameraOf = (view) => state.frame?.panes.find((camera) => camera.stream === view?.stream);

/** View and pixel under the mouse: shares of its image, and where on the overlay. */
function under(pane, { clientX, clientY }) {
  for (const view of pane.views) {
    const box = view.element.getBoundingClientRect();
    const [x, y] = [clientX - box.left, clientY - box.top];
    const camera = cameraOf(view);
    if (!camera || x < 0 || y < 0 || x > box.width || y > box.height) continue;
    const [width, height] = camera.size_px;
    const scale = Math.min(box.width / width, box.height / height);
    const pixel = [(x - (box.width - scale * width) / 2) / scale, (y - (box.height - scale * height) / 2) / scale];
    return { view, camera, pixel, at: [pixel[0] / width, pixel[1] / height] };
  }
  return null;
}

/** True if the box of the selected agent is under the mouse. */
function onSelected({ camera, pixel }) {
  const { sources } = state.frame;
  const agent = sources[0].agents.find(({ name }) => name === state.selected);
  if (!agent || camera.source !== 0) return false;
  const corners = geometry.corners(agent).map((corner) => geometry.project(camera, corner));
  if (corners.some((corner) => !corner)) return false;
  return [0, 1].every((axis) => {
    const sides = corners.map((corner) => corner[axis]);
    return pixel[axis] >= Math.min(...sides) && pixel[axis] <= Math.max(...sides);
  });
}

async function pick(place) {
  const picked = await ask("pick", { stream: place.view.stream, at: place.at });
  if (picked) chosen(picked);
  return picked;
}

/** Lets the camera of a pane circle around `focus`, from where the camera `shown` is. */
function circleAround(pane, { pose: { position_m: from, rotation } }, focus) {
  choose(pane, "orbit", null);
  const far = geometry.length(geometry.subtract(focus, from));
  Object.assign(pane.camera, { focus, far, ...geometry.anglesOf(pane.camera.axes, rotation) });
}

/** Lets the camera of a pane circle around the place under the mouse. */
async function circle(pane, place) {
  const picked = await pick(place);
  if (!picked?.position_m) return;
  circleAround(pane, place.camera, picked.position_m);
  share(pane);
  look();
}

/** Angles from the horizon that are straight up or down, radians: there a camera keeps its yaw. */
const VERTICAL_RAD = 1.57;

/** Lets the camera of a pane look at what is in its middle from the side `from`, a unit vector of the world. */
async function lookFrom(pane, from) {
  if (!pane.camera?.focus || pane.camera.rig !== null) {
    const place = underMiddle(pane);
    const picked = place && (await ask("pick", { stream: place.view.stream, at: place.at }));
    if (picked?.position_m) circleAround(pane, place.camera, picked.position_m);
    else choose(pane, "orbit", null);
  }
  const { camera } = pane;
  const { yaw, pitch } = geometry.anglesOfDirection(camera.axes, geometry.scale(from, -1));
  Object.assign(camera, { pitch, yaw: Math.abs(pitch) > VERTICAL_RAD ? camera.yaw : yaw });
  share(pane);
  look();
}

let lastDrag = 0;

/** Drags the selected agent, from `place` to the pixel `at`; `done` when the mouse is released. */
function drag(place, at, free, done) {
  const now = performance.now();
  if (!done && now - lastDrag < LOOK_MS) return;
  lastDrag = now;
  const fields = { stream: place.view.stream, agent: state.selected, from: place.at, to: at, free, done };
  ask("drag", fields);
}

/** What a press on a pane may do beside moving its camera. */
function pressOn(pane, event) {
  const place = state.frame && under(pane, event);
  if (!place) return null;
  const clicked = () => (measuring.isOn() ? measuring.place : pick)(place);
  const drags = event.button === 0 && !event.shiftKey && !measuring.isOn() && onSelected(place);
  if (!drags) return { clicked };
  const over = (moved) => {
    const to = under(pane, moved);
    return to?.view === place.view ? to : null;
  };
  return {
    clicked,
    dragged(moved) {
      const to = over(moved);
      if (to) drag(place, to.at, moved.altKey, false);
    },
    dropped: (moved) => drag(place, (over(moved) ?? place).at, moved.altKey, true),
  };
}

/** Shows a pane whose camera moves. */
function showMoving(pane) {
  share(pane);
  look(true, pane);
}

function steerBy(pane) {
  steer(pane.box, {
    camera: () => movable(pane),
    moved: () => showMoving(pane),
    pressed: (event) => pressOn(pane, event),
  });
  pane.box.addEventListener("dblclick", (event) => {
    const place = state.frame && under(pane, event);
    if (place && !measuring.isOn()) circle(pane, place);
  });
}

flyBy({
  camera: () => movable(activePane()),
  moved: () => showMoving(activePane()),
  speed: () => state.flySpeed,
});

// Panes beside each other ---------------------------------------------------------------------------

/** One view or two. */
export function setTwo(two) {
  $("two").setAttribute("aria-pressed", two);
  if (two && state.panes.length === 1) {
    const source = state.sources.length > 1 && state.panes[0].source !== 1 ? 1 : 0;
    const pane = addPane(source);
    const [first] = state.panes;
    choose(pane, state.sources.length > 1 ? first.choice : "birds-eye", first.camera?.rig);
  } else if (!two && state.panes.length === 2) {
    state.panes.pop().element.remove();
    activate(0);
  }
  look();
}

/** The next entry of a menu. */
export function next(select) {
  select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
  select.onchange();
}

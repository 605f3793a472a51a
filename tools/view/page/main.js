// The page: what comes from the viewer, buttons and keys.
import { bookmark } from "./bookmarks.js";
import * as browser from "./browser_drawing.js";
import * as cameraPanel from "./camera_panel.js";
import { axesOfSource, firstChoice } from "./cameras.js";
import { Connection } from "./connection.js";
import * as dropping from "./dropping.js";
import * as link from "./link.js";
import * as measure from "./measure.js";
import { alsoDraw, noteTrails } from "./overlays.js";
import * as panels from "./panels.js";
import * as path from "./path.js";
import { $, make, notice, send, state } from "./state.js";
import * as steering from "./steering.js";
import * as timeline from "./timeline.js";
import * as views from "./views.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];
const LAYERS = { agents: "Agents", lanes: "Lanes", plan: "Plan", boxes: "Boxes", names: "Names", trails: "Trails", axes: "Axes" };
const LAYER_KEYS = { g: "agents", l: "lanes", k: "plan", b: "boxes", n: "names", t: "trails" };
const KEYS = [
  ["Space", "play or pause"], [", .", "one step back or forward"], ["[ ]", "slower or faster"],
  ["Home End", "first or last moment"], ["m", "next mark of the timeline; with Shift the one before"],
  ["c", "next camera of the chosen view"], ["v", "next image kind: color, depth …"], ["p", "one or two views"],
  ["w a s d q e", "fly; with Shift faster"], ["arrows", "turn the camera"],
  ["f", "circle around all of a splat file, or the place ahead on a street; with Shift the first view again"],
  ["+ -", "fly faster or slower"], ["o", "save the exact image as a file"],
  ["u", "measure: click places, or Enter for the middle of the view; Backspace takes one back"],
  ["i", "add what is shown as a key of the camera path"],
  ["drag", "turn; with the right button or Shift move"], ["wheel", "nearer or farther"],
  ["two fingers", "nearer, farther and move"],
  ["click", "choose an agent; drag the chosen one over the road, with Alt off its lane"],
  ["double click", "circle around the place"],
  ["r", "turn the chosen agent to the left; with Shift to the right"], ["Delete", "remove the chosen agent"],
  ["Ctrl z", "undo; with Shift redo"], ["Escape", "choose no agent, measure no more"],
  ["1 to 9", "return to a saved view; with Shift save it"],
  ["g l k", "agents, lanes, plan on or off"], ["b n t", "boxes, names, trails on or off"],
  ["x", "hold to see B, where A and B blink"], ["?", "this list"],
];

// What comes from the viewer ----------------------------------------------------------------------

function showScene({ sources, device, clock, shown, file_bytes_max: fileBytesMax }) {
  const [first] = sources;
  if (state.shown !== null && state.shown !== shown) {
    dropping.showAnew(first.title);
    return;
  }
  Object.assign(state, { sources, device, clock, shown, fileBytesMax });
  dropping.sayAnew();
  document.title = `${first.title} – DecoupleGS`;
  state.axes = axesOfSource(first);
  $("linked-label").hidden = sources.length < 2;
  const lidars = first.has_ego ? first.lidars : [];
  $("lidar-label").hidden = lidars.length === 0;
  $("lidar").replaceChildren(new Option("none", ""), ...lidars.map((name) => new Option(name, name)));
}

function showChange(change) {
  if (state.leaves) return;
  state.change = change;
  timeline.showCourse();
  panels.showScore();
  panels.showEdits();
  panels.showFacts();
  panels.fit();
  timeline.showClock();
  if (state.panes.length > 0) return;
  const [first] = state.sources;
  $("empty").hidden = true;
  views.choose(views.addPane(0), firstChoice(first));
  views.activate(0);
  if (state.sources.length > 1) views.setTwo(true);
  link.restore();
}

function showClock(clock) {
  state.clock = clock;
  timeline.showClock();
}

function showUpdate(frame, images, points) {
  if (state.refused) notice("");
  state.refused = false;
  state.frame = frame;
  browser.arrived(frame);
  showBadge();
  if (frame.error) notice(frame.error, true);
  noteTrails(frame);
  views.showImages(images, points);
  views.drawOverlays();
  panels.showAgents(frame.sources[0]);
  panels.showTimes(frame.times_ms);
  window.viewer = { frame, state, newest: isNewest };
  cameraPanel.show();
  if (frame.badge.startsWith("exact")) browser.prepare();
}

/** True if the image on the screen is the one that was asked for last, at the time of the clock. */
function isNewest() {
  const { frame, clock, connection } = state;
  const isNow = clock.playing || frame?.revision === clock.revision;
  return frame !== null && isNow && frame.look === connection.newestLook && !browser.isShown();
}

/** Tells how the image was made, or that it is not yet the one that was asked for. */
function showBadge() {
  if (browser.isShown()) return;
  const newest = isNewest() && !state.connection.isLost;
  const waits = state.connection.isLost ? "no connection" : "rendering …";
  $("badge").textContent = newest ? state.frame.badge : waits;
  $("badge").classList.toggle("exact", newest && state.frame.badge.startsWith("exact"));
}

function refused(text) {
  state.refused = true;
  notice(text, true);
}

// Keys ----------------------------------------------------------------------------------------

function setLayer(name, shown) {
  state.layers[name] = shown;
  $(`layer-${name}`).checked = shown;
  if (name === "agents") views.look();
  views.drawOverlays();
}

function onePress(key, event) {
  const at = SPEEDS.indexOf(state.speed);
  const [begin, end] = state.change.span_s;
  const pane = views.activePane();
  const presses = {
    " ": () => timeline.play(!state.clock.playing),
    ",": () => send("step", { by: -1 }),
    ".": () => send("step", { by: 1 }),
    "[": () => timeline.setSpeed(SPEEDS[Math.max(0, at - 1)]),
    "]": () => timeline.setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, at + 1)]),
    home: () => timeline.goTo(begin),
    end: () => timeline.goTo(end),
    m: () => timeline.nextMark(event.shiftKey),
    f: () => (event.shiftKey ? cameraPanel.reset() : views.choose(pane, "orbit", null)),
    "+": () => cameraPanel.changeSpeed(1),
    "-": () => cameraPanel.changeSpeed(-1),
    o: cameraPanel.saveImage,
    u: () => measure.setOn(!measure.isOn()),
    i: path.addKey,
    c: () => views.next(pane.select),
    v: () => views.next(pane.channels),
    p: () => views.setTwo(state.panes.length === 1),
    x: () => views.setBlink(pane, true),
    r: () => panels.turnSelected(event.shiftKey ? -1 : 1),
    delete: () => panels.editSelected("remove"),
    escape: () => {
      panels.select(null);
      measure.setOn(false);
    },
    "?": () => $("keys").showModal(),
  };
  if (measure.isOn()) Object.assign(presses, { enter: measure.placeMiddle, backspace: measure.takeBack });
  return presses[key];
}

function pressed(event) {
  const { target } = event;
  const key = event.key.toLowerCase();
  const inField = ["SELECT", "TEXTAREA"].includes(target.tagName) || ["text", "number"].includes(target.type);
  if (!state.change || state.panes.length === 0 || $("keys").open || inField || event.altKey) return;
  if (event.ctrlKey || event.metaKey) {
    if (key !== "z" || !state.change.sources[0].edits) return;
    panels.edit(event.shiftKey ? "redo" : "undo");
    event.preventDefault();
    return;
  }
  const digit = /^Digit([1-9])$/.exec(event.code)?.[1];
  const isPressedByKey = [" ", "enter"].includes(key) && (["BUTTON", "SUMMARY"].includes(target.tagName) || target.type === "checkbox");
  const movesSlider = target.type === "range" && (key.startsWith("arrow") || ["home", "end"].includes(key));
  if (isPressedByKey || movesSlider) return;
  if (digit) bookmark(digit, event.shiftKey);
  else if (steering.isHeld(key)) steering.hold(key, event.shiftKey);
  else if (LAYER_KEYS[key]) setLayer(LAYER_KEYS[key], !state.layers[LAYER_KEYS[key]]);
  else if (onePress(key, event)) onePress(key, event)();
  else return;
  event.preventDefault();
}

function lifted({ key }) {
  steering.release(key.toLowerCase());
  if (key.toLowerCase() === "x" && state.panes.length > 0) views.setBlink(views.activePane(), false);
}

// Buttons -------------------------------------------------------------------------------------

function setTheme(light) {
  document.documentElement.dataset.theme = light ? "light" : "dark";
  $("theme").textContent = light ? "Dark" : "Light";
}

Object.entries(LAYERS).forEach(([name, text]) => {
  const box = make("input", { type: "checkbox", id: `layer-${name}`, checked: state.layers[name] });
  box.onchange = () => setLayer(name, box.checked);
  $("layers").append(make("label", {}, box, ` ${text}`));
});
SPEEDS.forEach((speed) => $("speed").add(new Option(`${speed}×`, speed)));
$("speed").value = 1;
$("speed").onchange = () => timeline.setSpeed(Number($("speed").value));
$("loop").onchange = () => state.clock.playing && timeline.play(true);
$("play").onclick = () => timeline.play(!state.clock.playing);
$("back").onclick = () => send("step", { by: -1 });
$("forward").onclick = () => send("step", { by: 1 });
$("time").oninput = () => timeline.goTo(Number($("time").value));
$("chart").onclick = timeline.chartPressed;
$("two").onclick = () => views.setTwo(state.panes.length === 1);
$("help").onclick = () => $("keys").showModal();
["width", "reduce", "browser", "lidar"].forEach((id) => ($(id).onchange = () => views.look()));
$("theme").onclick = () => setTheme(document.documentElement.dataset.theme !== "light");
setTheme(window.matchMedia("(prefers-color-scheme: light)").matches);
// On a narrow page the panels are below each other: figures are opened by who wants them.
$("times-panel").open = !window.matchMedia("(max-width: 800px)").matches;
KEYS.forEach(([keys, meaning]) => {
  $("key-list").append(make("dt", {}, make("kbd", { textContent: keys })), make("dd", { textContent: meaning }));
});
browser.setUp();
panels.prepareEdits();
[cameraPanel, measure, path, dropping].forEach((part) => part.prepare());
[measure, path].forEach((part) => alsoDraw(part.draw));
views.onMeasured(measure);
views.onChosen(({ agent }) => panels.select(agent));
window.addEventListener("keydown", pressed);
window.addEventListener("keyup", lifted);
window.addEventListener("blur", steering.releaseAll);
// The token is in a cookie now: it need not stay in the address.
history.replaceState(null, "", location.pathname + location.hash);
window.addEventListener("hashchange", link.restore);

state.connection = new Connection({
  scene: showScene,
  change: showChange,
  clock: showClock,
  update: showUpdate,
  recording: panels.showRecording,
  refused,
  failed: (text) => refused(`The image could not be rendered: ${text}`),
  status: (text) => notice(text, true),
});
// Late enough that quick images change nothing.
setInterval(() => {
  showBadge();
  if (isNewest()) link.keep();
}, 300);

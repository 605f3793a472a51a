// The panel "Camera": field of view, speed of flight, images as files, links and commands.
import { copy, download, fileSafe } from "./files.js";
import * as link from "./link.js";
import { $, ask, nameOf, state } from "./state.js";
import * as timeline from "./timeline.js";
import * as views from "./views.js";

const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4, 10, 20];

/** Shows the camera of the chosen view in the panel. */
export function show() {
  const pane = views.activePane();
  if (!pane) return;
  const fov = pane.camera?.fov ?? views.shownFov(pane);
  const isFree = pane.views.length === 1 && fov !== null;
  $("fov").disabled = !isFree;
  if (isFree && document.activeElement !== $("fov")) $("fov").value = Math.round(fov);
  $("fov-said").textContent = isFree ? `${fov.toFixed(fov < 10 ? 1 : 0)}°` : "–";
  $("reset").disabled = !pane.camera;
  saveIfWanted();
}

function setFov() {
  const pane = views.activePane();
  const camera = views.movable(pane);
  if (!camera) return;
  camera.fov = Number($("fov").value);
  views.share(pane);
  views.look();
  show();
}

/** The view as it is chosen first. */
export function reset() {
  const pane = views.activePane();
  if (pane.camera) views.choose(pane, pane.choice, pane.camera.rig);
}

/** Flies faster or slower from now on, by one of the speeds. */
export function changeSpeed(by) {
  const at = SPEEDS.indexOf(state.flySpeed) + by;
  state.flySpeed = SPEEDS[Math.max(0, Math.min(SPEEDS.length - 1, at))];
  $("fly-speed").value = state.flySpeed;
}

// Images ------------------------------------------------------------------------------------------

let isWanted = false;

/** Saves the exact images of the chosen view, as soon as they are there. */
export function saveImage() {
  isWanted = true;
  if (state.clock.playing) timeline.play(false);
  else saveIfWanted();
}

function saveIfWanted() {
  if (!isWanted || !window.viewer?.newest() || !state.frame.badge.startsWith("exact")) return;
  const pane = views.activePane();
  if (pane.views.some((view) => !view.png)) return;
  isWanted = false;
  const title = fileSafe(nameOf(state.sources[0]).replace(/\.[^.]*$/, ""));
  pane.views.forEach((view) => {
    const camera = fileSafe(view.camera ?? pane.choice);
    const name = `${title}_${camera}_${state.clock.time_s.toFixed(2)}s`;
    download(`${name}.png`, view.png, "image/png");
    if (view.otherPng) download(`${name}_B.png`, view.otherPng, "image/png");
  });
}

// Links and commands ------------------------------------------------------------------------------

export function copyLink() {
  copy(link.address(), "The link is copied. It opens where the address that the viewer printed was opened before.");
}

export async function copyCommand() {
  const [view] = views.activePane().views;
  const command = await ask("render_command", { stream: view.stream });
  if (command?.text) copy(command.text, `The command is copied. It writes the same image to ${command.image}.`);
}

export function prepare() {
  SPEEDS.forEach((speed) => $("fly-speed").add(new Option(`${speed}×`, speed)));
  $("fly-speed").value = state.flySpeed;
  $("fly-speed").onchange = () => (state.flySpeed = Number($("fly-speed").value));
  $("fov").oninput = setFov;
  $("frame-all").onclick = () => views.choose(views.activePane(), "orbit", null);
  $("reset").onclick = reset;
  $("save-image").onclick = saveImage;
  $("copy-link").onclick = copyLink;
  $("copy-command").onclick = copyCommand;
}

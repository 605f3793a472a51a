// The part of the address behind "#": time, and what each view shows. It survives a reload.
import * as browser from "./browser_drawing.js";
import { newCamera } from "./cameras.js";
import { notice, state } from "./state.js";
import { goTo } from "./timeline.js";
import * as views from "./views.js";

/** Numbers of a camera that are in a link, and how many each has. */
const NUMBERS = { at: 3, focus: 3, far: 1, yaw: 1, pitch: 1, fov: 1 };
const PANE_NAMES = ["a", "b"];
const FOVS_DEG = [0.1, 160];

/** The fragment for what is shown now, with "#". */
export function fragment() {
  const link = new URLSearchParams();
  link.set("time", state.clock.time_s);
  state.panes.forEach(({ choice, channel, camera, source }, index) => {
    const name = PANE_NAMES[index];
    link.set(name, choice);
    if (channel !== "color") link.set(`${name}.kind`, channel);
    if (source !== 0) link.set(`${name}.of`, source);
    if (!camera) return;
    if (camera.rig !== null) link.set(`${name}.on`, camera.rig);
    Object.keys(NUMBERS).forEach((key) => {
      if (camera[key] !== undefined) link.set(`${name}.${key}`, camera[key]);
    });
  });
  const choice = browser.choice();
  if (choice) link.set("browser", choice);
  return `#${link}`;
}

/** Writes the fragment into the address, once what is shown is at rest. */
export function keep() {
  if (state.leaves || state.panes.length === 0 || state.moving || state.clock.playing) return;
  const now = fragment();
  if (now !== location.hash) history.replaceState(null, "", location.pathname + now);
}

/** Numbers of a link; null where they are none, or no place. */
function numbersOf(text, count) {
  const numbers = text.split(",").map(Number);
  const fit = numbers.length === count && text.trim() !== "" && numbers.every((x) => Math.abs(x) < 1e9);
  if (!fit) return null;
  return count === 1 ? numbers[0] : numbers;
}

/** Camera that a link has for a pane; null where its numbers are at fault. */
function cameraIn(link, name, choice, source) {
  const rig = link.get(`${name}.on`);
  const camera = newCamera(choice, rig, source);
  for (const [key, count] of Object.entries(NUMBERS)) {
    const text = link.get(`${name}.${key}`);
    if (text === null) continue;
    const value = numbersOf(text, count);
    if (value === null || camera[key] === undefined) return null;
    camera[key] = value;
  }
  const [least, most] = FOVS_DEG;
  const fits = camera.fov >= least && camera.fov <= most && (camera.far ?? 1) > 0;
  return fits ? camera : null;
}

/** Lets a pane show what a link says. False where it cannot. */
function restorePane(link, name, pane) {
  const choice = link.get(name);
  const has = (select, value) => [...select.options].some((option) => option.value === value);
  const kind = link.get(`${name}.kind`) ?? "color";
  if (!has(pane.select, choice) || !has(pane.channels, kind)) return false;
  const of = link.get(`${name}.of`);
  if (of !== null && pane.sources && has(pane.sources, of)) {
    pane.source = of === "both" ? of : Number(of);
    pane.sources.value = of;
  }
  const isOwn = choice === "rig" || choice.startsWith("named:");
  const camera = isOwn ? null : cameraIn(link, name, choice, state.sources[0]);
  if (!isOwn && !camera) return false;
  views.choose(pane, choice, camera?.rig);
  Object.assign(pane, { channel: kind, camera });
  pane.channels.value = kind;
  return true;
}

/**
 * Shows what the address says. The time is left where the clock plays: other pages share it. `change`: the event of
 * another address, if there was one; `keep` may have replaced it before it is told of.
 */
export function restore(change) {
  const { hash } = change ? new URL(change.newURL) : location;
  const link = new URLSearchParams(hash.slice(1));
  if (![...link.keys()].length) return;
  browser.choose(link.get("browser"));
  const shown = PANE_NAMES.map((name) => link.has(name));
  if (shown[1] !== state.panes.length > 1) views.setTwo(shown[1]);
  const restored = state.panes.map((pane, index) => !shown[index] || restorePane(link, PANE_NAMES[index], pane));
  const time = numbersOf(link.get("time") ?? "", 1);
  if (time !== null && !state.clock.playing && time !== state.clock.time_s) goTo(time);
  if (restored.includes(false)) notice("The link does not fit what is shown here: some of it was left out.", true);
  views.look();
}

/** Address of what is shown now. It has no token: who opens it needs the printed address once. */
export const address = () => location.origin + location.pathname + fragment();

// The mouse, fingers and held keys that move a camera.
import { approach, shift, turn, zoom } from "./cameras.js";

/** A press that moves less than this is a click, pixels. */
const CLICK_PX = 4;
const HELD = ["w", "a", "s", "d", "q", "e", "arrowleft", "arrowright", "arrowup", "arrowdown"];

/** Middle of two fingers and the distance between them, pixels of the page. */
function pinchOf([a, b]) {
  return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.max(1, Math.hypot(a.x - b.x, a.y - b.y)) };
}

/** Moves by a drag: one across the height of the view moves by that height, at the camera's focus. */
function move(box, camera, dx, dy) {
  const height = box.getBoundingClientRect().height;
  const extent = 2 * (camera.far ?? camera.stride) * Math.tan((camera.fov * Math.PI) / 360);
  shift(camera, (-dx * extent) / height, (dy * extent) / height);
}

/**
 * Lets the mouse, fingers and the wheel over `box` move a camera. `camera` gives it, or null where
 * none can be moved; `moved` is called when it has moved. `pressed` is told of each press and gives
 * what else it may do, or null: `clicked`, and `dragged` and `dropped` where it moves no camera.
 */
export function steer(box, { camera: find, moved, pressed = () => null }) {
  let press = null;
  const fingers = new Map();
  const lift = (event) => fingers.delete(event.pointerId);
  const change = (act) => {
    const camera = find();
    if (!camera) return;
    act(camera);
    moved();
  };
  box.addEventListener("contextmenu", (event) => event.preventDefault());
  box.addEventListener("pointerdown", (event) => {
    box.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size > 1) {
      press = null;
      return;
    }
    const moves = event.button === 2 || event.shiftKey;
    press = { x: event.clientX, y: event.clientY, moves, other: pressed(event), far: 0, button: event.button };
  });
  box.addEventListener("pointermove", (event) => {
    if (fingers.size === 2 && fingers.has(event.pointerId)) {
      // Two fingers zoom by their distance, and move the camera by their middle.
      const before = pinchOf([...fingers.values()]);
      fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      const now = pinchOf([...fingers.values()]);
      change((camera) => {
        zoom(camera, before.apart / now.apart);
        move(box, camera, now.x - before.x, now.y - before.y);
      });
      return;
    }
    if (!press) return;
    const [dx, dy] = [event.clientX - press.x, event.clientY - press.y];
    press.far += Math.hypot(dx, dy);
    Object.assign(press, { x: event.clientX, y: event.clientY });
    if (press.far < CLICK_PX) return;
    if (press.other?.dragged) {
      press.other.dragged(event);
      return;
    }
    const { moves } = press;
    change((camera) => {
      const height = box.getBoundingClientRect().height;
      const above = camera.focus && camera.pitch < -1.5;
      if (moves || above) move(box, camera, dx, dy);
      else turn(camera, (dx * 2) / height, (dy * 2) / height);
    });
  });
  box.addEventListener("pointerup", (event) => {
    lift(event);
    const ended = press;
    press = null;
    if (!ended) return;
    if (ended.far >= CLICK_PX) ended.other?.dropped?.(event);
    else if (ended.button === 0) ended.other?.clicked?.();
  });
  box.addEventListener("pointercancel", (event) => {
    lift(event);
    press = null;
  });
  box.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      change((camera) => zoom(camera, Math.exp(event.deltaY * 0.001)));
    },
    { passive: false },
  );
}

// Keys that are held ------------------------------------------------------------------------------

const held = new Set();
let flownAt = 0;
let flown = null;

/** Lets held keys move a camera: `camera` and `moved` as in `steer`, `speed` is a factor. */
export const flyBy = (control) => (flown = control);

export const isHeld = (key) => HELD.includes(key);

export function hold(key, fast) {
  if (held.size === 0) {
    flownAt = performance.now();
    requestAnimationFrame(fly);
  }
  held.add(key);
  if (fast) held.add("shift");
}

export function release(key) {
  held.delete(key);
  // Shift alone does not fly.
  if (held.size === 1) held.delete("shift");
}

export const releaseAll = () => held.clear();

function fly(now) {
  const seconds = Math.min(0.1, (now - flownAt) / 1000);
  flownAt = now;
  if (held.size === 0) return;
  const camera = flown.camera();
  if (camera) {
    const step = (held.has("shift") ? 3 : 0.8) * flown.speed() * camera.stride * seconds;
    const sign = (plus, minus) => Number(held.has(plus)) - Number(held.has(minus));
    approach(camera, step * sign("w", "s"));
    shift(camera, step * sign("d", "a"), step * sign("e", "q"));
    turn(camera, -seconds * sign("arrowright", "arrowleft"), seconds * sign("arrowup", "arrowdown"));
    flown.moved();
  }
  requestAnimationFrame(fly);
}

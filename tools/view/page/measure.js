// Distances and angles between places that are clicked, with lines over the images.
import * as geometry from "./geometry.js";
import { $, ask, notice, state } from "./state.js";
import { activePane, drawOverlays, underMiddle } from "./views.js";

const COLOR = "#ffd24d";
const POINTS_MAX = 3;

const measured = { on: false, points: [] };

export const isOn = () => measured.on;

/** Meters with three digits that count. */
export function meters(value) {
  const digits = value > 0 ? Math.max(0, Math.min(6, 2 - Math.floor(Math.log10(value)))) : 2;
  return `${value.toFixed(digits)} m`;
}

const apart = (a, b) => geometry.length(geometry.subtract(a, b));

/** Angle at `b` between `a` and `c`, degrees. */
export function angleAt(a, b, c) {
  const [u, v] = [geometry.subtract(a, b), geometry.subtract(c, b)];
  // So it is exact for small angles too.
  return (180 / Math.PI) * Math.atan2(geometry.length(geometry.cross(u, v)), geometry.dot(u, v));
}

function sentence() {
  const [a, b, c] = measured.points;
  if (!measured.on && !a) return "";
  if (!a) return "Click a place, or press Enter for the place in the middle of the view.";
  if (!b) return "Click a second place.";
  const up = state.axes[2];
  const rise = geometry.dot(geometry.subtract(b, a), up);
  const first = `${meters(apart(a, b))} (height ${rise < 0 ? "−" : ""}${meters(Math.abs(rise))})`;
  if (!c) return `${first}. A third place gives the angle.`;
  return `${first}, ${meters(apart(b, c))}, angle ${angleAt(a, b, c).toFixed(1)}°`;
}

function shown() {
  $("measure").setAttribute("aria-pressed", measured.on);
  $("measure-clear").disabled = measured.points.length === 0;
  $("measure-said").textContent = sentence();
  document.body.classList.toggle("measuring", measured.on);
  drawOverlays();
}

export function setOn(on) {
  measured.on = on;
  shown();
}

export function clear() {
  measured.points = [];
  shown();
}

/** Takes the last place back. */
export function takeBack() {
  measured.points.pop();
  shown();
}

/** Measures to the place at a pixel of a view. */
export async function place({ view, at }) {
  const picked = await ask("pick", { stream: view.stream, at });
  if (!picked) return;
  if (!picked.position_m) {
    notice("There is nothing at this pixel: choose another.");
    return;
  }
  if (measured.points.length >= POINTS_MAX) measured.points = [];
  measured.points.push(picked.position_m);
  shown();
}

/** Measures to the place in the middle of the chosen view. */
export function placeMiddle() {
  const middle = underMiddle(activePane());
  if (middle) place(middle);
}

function dot(context, [x, y], radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
}

function label(context, text, [x, y]) {
  const size = parseFloat(context.font);
  const { width } = context.measureText(text);
  context.fillStyle = "#000c";
  context.fillRect(x - width / 2 - size / 4, y - 1.6 * size, width + size / 2, 1.3 * size);
  context.fillStyle = "#fff";
  context.fillText(text, x - width / 2, y - 0.65 * size);
}

/** Draws lines and numbers over the image of `camera`; while measuring, a cross in its middle. */
export function draw(context, camera) {
  const { points, on } = measured;
  const width = context.lineWidth;
  if (on) {
    const [x, y] = camera.size_px.map((side) => side / 2);
    context.strokeStyle = COLOR;
    context.beginPath();
    [[1, 0], [0, 1]].forEach(([dx, dy]) => {
      context.moveTo(x - 6 * width * dx, y - 6 * width * dy);
      context.lineTo(x + 6 * width * dx, y + 6 * width * dy);
    });
    context.stroke();
  }
  context.strokeStyle = COLOR;
  context.beginPath();
  geometry.polyline(camera, points, 24).forEach(([from, to]) => {
    context.moveTo(...from);
    context.lineTo(...to);
  });
  context.stroke();
  points.forEach((point) => {
    const at = geometry.project(camera, point);
    context.fillStyle = COLOR;
    if (at) dot(context, at, 2 * width);
  });
  points.slice(1).forEach((point, index) => {
    const middle = geometry.scale(geometry.add(point, points[index]), 0.5);
    const at = geometry.project(camera, middle);
    if (at) label(context, meters(apart(point, points[index])), at);
  });
  const corner = points.length === POINTS_MAX && geometry.project(camera, points[1]);
  // Below the corner, where no distance stands.
  if (corner) label(context, `${angleAt(...points).toFixed(1)}°`, [corner[0], corner[1] + 2.4 * parseFloat(context.font)]);
}

export function prepare() {
  $("measure").onclick = () => setOn(!measured.on);
  $("measure-clear").onclick = clear;
}

// The clock, the curves of an episode and its marks.
import { $, make, send, state } from "./state.js";

const TTC_SHOWN_S = 5;

export function goTo(time_s) {
  send("time", { time_s });
}

export function play(playing) {
  send("play", { playing, speed: state.speed, looping: $("loop").checked });
}

export function setSpeed(speed) {
  state.speed = speed;
  $("speed").value = speed;
  if (state.clock.playing) play(true);
}

const share = (time) => {
  const [begin, end] = state.change.span_s;
  return Math.max(0, Math.min(1, (time - begin) / Math.max(end - begin, 1e-9)));
};

const logs = () => state.change.sources.map(({ log }) => log);

/** Index of the quantity of the third curve in `series`; "" for none. */
const quantity = () => $("quantity").value;

/** Offers the quantities that the episodes have. */
function showQuantities() {
  const names = logs()[0].series.map(({ name, unit }) => (unit ? `${name}, ${unit}` : name));
  const options = [["", "Another curve …"], ...names.map((name, index) => [index, name])];
  if ($("quantity").options.length === options.length) return;
  $("quantity").replaceChildren(...options.map(([value, text]) => new Option(text, value)));
  $("quantity").onchange = () => {
    showCourse();
    showClock();
  };
}

/** Curves of the chosen quantity, from its smallest value at the bottom to its largest. */
function quantityCurves() {
  if (quantity() === "") return [];
  const shown = logs().flatMap((log) => (log ? [log] : []));
  const name = shown[0].series[quantity()].name;
  const series = shown.map((log) => log.series.find((one) => one.name === name)?.values ?? []);
  const known = series.flat().filter((value) => value !== null);
  const [least, most] = [Math.min(...known), Math.max(...known)];
  return series.map((values, index) => {
    const times = shown[index].time_to_collision_s.map(([time]) => time);
    const shares = values.map((value) => (value === null ? null : (value - least) / Math.max(most - least, 1e-9)));
    return curve(`quantity${index === 0 ? "" : " other"}`, times, shares);
  });
}

/** Value of the chosen quantity at a moment of the first episode, and its range. */
function showQuantity(log, index) {
  const series = log.series[quantity()];
  const value = series?.values[index];
  $("quantity-now").textContent = value === null || value === undefined ? "" : `${value.toFixed(2)} ${series.unit}`;
}

/** Shows the clock, also before the image of its time is there. */
export function showClock() {
  const { time_s: time, playing } = state.clock;
  const slider = $("time");
  if (document.activeElement !== slider || playing) slider.value = time;
  slider.setAttribute("aria-valuetext", `${time.toFixed(1)} seconds`);
  $("clock").textContent = `${time.toFixed(2)} s`;
  $("play").textContent = playing ? "Pause" : "Play";
  const [log] = logs();
  if (!log) return;
  $("cursor").style.left = `${100 * share(time)}%`;
  const index = log.time_to_collision_s.findLastIndex(([at]) => at <= time + 1e-6);
  const ttc = log.time_to_collision_s[index]?.[1];
  $("speed-now").textContent = `${(3.6 * (log.speed_mps[index] ?? 0)).toFixed(0)} km/h`;
  showQuantity(log, index);
  $("ttc-now").textContent = ttc === null || ttc === undefined ? "none" : `${ttc.toFixed(1)} s`;
}

/** Marks of the timeline: events of each episode, and where two episodes part. */
function marks() {
  const several = logs().length > 1;
  const events = logs().flatMap((log, index) =>
    (log?.events ?? []).map((event) => ({
      time_s: event.time_s,
      text: `${several ? "AB"[index] + ": " : ""}${event.text}`,
      factor: event.factor,
      kind: index === 0 ? "mark" : "mark other",
    })),
  );
  const { parts_s: parts } = state.change;
  if (parts !== null) events.push({ time_s: parts, text: "A and B part", kind: "mark parts" });
  return events.sort((a, b) => a.time_s - b.time_s);
}

function curve(name, times, values) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", "path");
  let pen = "M";
  const d = values.map((value, i) => {
    if (value === null) {
      pen = "M";
      return "";
    }
    const piece = `${pen}${(1000 * share(times[i])).toFixed(1)} ${(96 - 92 * value).toFixed(1)}`;
    pen = "L";
    return piece;
  });
  element.setAttribute("d", d.join(""));
  element.setAttribute("class", name);
  return element;
}

/** Curves and marks of the episodes. */
export function showCourse() {
  const { span_s: [begin, end] } = state.change;
  const live = logs().some((log) => log?.goes_on);
  const still = end <= begin && !live;
  Object.assign($("time"), { min: begin, max: end });
  ["time", "play", "back", "forward", "speed", "loop"].forEach((id) => ($(id).disabled = still));
  // What does not move needs no clock.
  document.querySelector("footer").hidden = still && !logs()[0];
  $("course").hidden = !logs()[0];
  $("thin").hidden = logs().length < 2;
  if (!logs()[0]) return;
  const fastest = Math.max(1, ...logs().flatMap((log) => log?.speed_mps ?? []));
  const curves = logs().flatMap((log, index) => {
    if (!log) return [];
    const times = log.time_to_collision_s.map(([time]) => time);
    const ttcs = log.time_to_collision_s.map(([, ttc]) => (ttc === null ? null : Math.min(1, ttc / TTC_SHOWN_S)));
    const other = index === 0 ? "" : " other";
    return [
      curve(`speed${other}`, times, log.speed_mps.map((speed) => speed / fastest)),
      curve(`ttc${other}`, times, ttcs),
    ];
  });
  showQuantities();
  $("chart").firstElementChild.replaceChildren(...curves, ...quantityCurves());
  const title = (event) => `${event.time_s.toFixed(1)} s: ${event.text}`;
  $("marks").replaceChildren(
    ...marks().map((event) => {
      const mark = make("button", { className: event.kind, title: title(event), onclick: () => goTo(event.time_s) });
      mark.style.left = `${100 * share(event.time_s)}%`;
      mark.setAttribute("aria-label", title(event));
      return mark;
    }),
  );
  $("events").replaceChildren(
    ...marks().map((event) => {
      const button = make("button", { textContent: title(event), onclick: () => goTo(event.time_s) });
      const factor = event.factor === undefined ? "" : ` score times ${event.factor.toFixed(2)}`;
      return make("li", {}, button, factor);
    }),
  );
}

export function nextMark(back) {
  const now = state.clock.time_s;
  const times = marks().map((event) => event.time_s);
  const found = back ? times.findLast((time) => time < now - 1e-3) : times.find((time) => time > now + 1e-3);
  if (found !== undefined) goTo(found);
}

/** A press on the chart goes to that time. */
export function chartPressed({ target, clientX }) {
  if (target.classList.contains("mark")) return;
  const { left, width } = $("chart").getBoundingClientRect();
  const [begin, end] = state.change.span_s;
  goTo(begin + ((clientX - left) / width) * (end - begin));
}

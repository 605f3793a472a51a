// The page: views, timeline, panels, keys.
import { Connection } from "./connection.js";
import * as geometry from "./geometry.js";

const $ = (id) => document.getElementById(id);
const REST_MS = 150;
const LOOK_MS = 33;
const TRAIL_S = 5;
const BIRDS_EYE_FOV_DEG = 8;
const FOV_DEG = 60;
const LANES_WITHIN_M = 120;
const LANE_COLOR = "#ffffffa0";
const PLAN_COLOR = "#00e5a0";
const TTC_SHOWN_S = 5;
const PANES_MAX = 16;
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];
const CHANNELS = {
  color: "Color", depth: "Depth", range: "Distance", instance: "Agents by color",
  normal: "Surface direction", flow: "Motion", alpha: "Opacity",
};
// Okabe and Ito, "Color Universal Design", 2008: told apart by color-blind people.
const COLORS = ["#e69f00", "#56b4e9", "#009e73", "#f0e442", "#cc79a7", "#d55e00", "#8fa3ff"];
const KEYS = [
  ["Space", "play or pause"], [", .", "one step back or forward"], ["[ ]", "slower or faster"],
  ["Home End", "first or last moment"], ["c", "next camera of the chosen view"],
  ["v", "next image kind: color, depth …"], ["p", "one or two views"],
  ["w a s d q e", "fly; with Shift faster"], ["arrows", "turn the camera"],
  ["drag", "turn; with the right button or Shift move"], ["wheel", "nearer or farther"],
  ["1 to 9", "return to a saved view; with Shift save it"],
  ["g l k", "agents, lanes, plan on or off"], ["b n t", "boxes, names, trails on or off"],
  ["m", "next mark of the timeline; with Shift the one before"], ["?", "this list"],
];

const state = {
  facts: null, frame: null, panes: [], active: 0, moving: false, trails: new Map(),
  layers: { agents: true, lanes: false, plan: true, boxes: false, names: false, trails: false },
  held: new Set(), bookmarks: new Map(), speed: 1, axes: geometry.axesOf([0, 0, 1]),
};

// Cameras ------------------------------------------------------------------------------------

function cameraChoices() {
  const { cameras, has_ego: hasEgo } = state.facts;
  const choices = [];
  if (cameras.length > 1 && hasEgo) choices.push(["rig", "All cameras"]);
  if (hasEgo) choices.push(["follow", "Behind the car"], ["driver", "Driver"]);
  choices.push(["birds-eye", "From above"], ["orbit", "Around a point"], ["fly", "Free flight"]);
  cameras.forEach(({ name }) => choices.push([`named:${name}`, `Camera ${name}`]));
  return choices;
}

/** Start of a camera of the user. `rig` is a vehicle's name, "" for the ego, null for the world. */
function newCamera(kind, rig) {
  const attached = rig !== null;
  const axes = attached ? geometry.axesOf([0, 0, 1]) : state.axes;
  const first = state.facts.first_camera;
  if (kind === "driver") return { rig, axes, at: [0.9, 0.35, 1.3], yaw: 0, pitch: 0, fov: FOV_DEG };
  if (kind === "follow") {
    return { rig, axes, focus: [0, 0, 1], far: 11, yaw: 0, pitch: -0.3, fov: FOV_DEG };
  }
  const { yaw, pitch } = geometry.anglesOf(axes, first.rotation);
  const ahead = geometry.direction(axes, yaw, pitch);
  if (kind === "birds-eye") {
    const focus = attached ? [0, 0, 0] : geometry.add(first.position_m, geometry.scale(ahead, 10));
    return { rig, axes, focus, far: 400, yaw: attached ? 0 : yaw, pitch: -Math.PI / 2, fov: BIRDS_EYE_FOV_DEG };
  }
  if (kind === "orbit") {
    return { rig, axes, focus: geometry.add(first.position_m, geometry.scale(ahead, 10)), far: 10, yaw, pitch, fov: FOV_DEG };
  }
  return { rig, axes, at: first.position_m, yaw, pitch, fov: FOV_DEG };
}

function choose(pane, choice, rig) {
  pane.choice = choice;
  const own = ["rig"].includes(choice) || choice.startsWith("named:");
  const follows = ["follow", "driver", "birds-eye"].includes(choice) && state.facts.has_ego;
  pane.camera = own ? null : newCamera(choice, rig ?? (follows ? "" : null));
  pane.select.value = [...pane.select.options].some((o) => o.value === choice) ? choice : "";
  layOut(pane);
  look();
}

/** Position of a camera of the user, relative to its vehicle or the world. */
function placeOf(camera) {
  if (!camera.focus) return camera.at;
  const ahead = geometry.direction(camera.axes, camera.yaw, camera.pitch);
  return geometry.subtract(camera.focus, geometry.scale(ahead, camera.far));
}

function request(pane, view) {
  if (view.camera) return { kind: "named", name: view.camera };
  const { camera } = pane;
  const pinhole = {
    position_m: placeOf(camera),
    rotation: geometry.looking(camera.axes, camera.yaw, camera.pitch),
    fov_deg: camera.fov,
  };
  if (camera.rig === null) return { kind: "free", ...pinhole };
  return { kind: "attached", agent: camera.rig || null, ...pinhole };
}

// Views --------------------------------------------------------------------------------------

function addPane() {
  const element = document.createElement("section");
  element.className = "pane";
  element.innerHTML = '<div class="bar"></div><div class="views"></div>';
  const number = state.panes.length;
  element.setAttribute("aria-label", `View ${number + 1}`);
  const pane = { element, number, views: [], channel: "color", choice: "", camera: null };
  const menu = (label, entries, changed) => {
    const select = document.createElement("select");
    select.setAttribute("aria-label", `${label} of view ${number + 1}`);
    entries.forEach(([value, text]) => select.add(new Option(text, value)));
    select.onchange = () => changed(select.value);
    element.firstChild.append(select);
    return select;
  };
  pane.select = menu("Camera", cameraChoices(), (value) => choose(pane, value));
  pane.channels = menu("Image kind", Object.entries(CHANNELS), (value) => {
    pane.channel = value;
    look();
  });
  element.addEventListener("pointerdown", () => activate(number));
  element.addEventListener("focusin", () => activate(number));
  $("panes").append(element);
  state.panes.push(pane);
  steer(pane);
  new ResizeObserver(() => look()).observe(element.lastChild);
  return pane;
}

function activate(number) {
  state.active = number;
  state.panes.forEach((pane) => pane.element.classList.toggle("active", pane.number === number));
}

/** Makes the canvases of a pane: one, or one for each camera of the rig. */
function layOut(pane) {
  const all = state.facts.cameras.map((camera) => camera.name).slice(0, PANES_MAX - 2);
  const named = pane.choice.startsWith("named:") ? [pane.choice.slice(6)] : [null];
  const cameras = pane.choice === "rig" ? all : named;
  const box = pane.element.lastChild;
  const columns = Math.ceil(Math.sqrt(cameras.length));
  box.style.gridTemplateColumns = `repeat(${columns}, 1fr)`;
  box.replaceChildren();
  pane.views = cameras.map((camera, index) => {
    const element = document.createElement("div");
    element.className = "view";
    const [image, overlay] = [0, 1].map(() => document.createElement("canvas"));
    const title = camera ?? pane.select.selectedOptions[0]?.text ?? "View";
    image.setAttribute("role", "img");
    image.setAttribute("aria-label", `Image: ${title}`);
    overlay.setAttribute("aria-hidden", "true");
    element.append(image, overlay);
    if (cameras.length > 1) {
      const name = document.createElement("span");
      name.className = "name";
      name.textContent = camera;
      element.append(name);
    }
    box.append(element);
    return { camera, element, image, overlay, stream: pane.number * 64 + index };
  });
}

let lastLook = 0;
let pendingLook = 0;
let restTimer = 0;

/** Asks for what the views show now. */
function look(moving = false) {
  state.moving = moving;
  if (moving) {
    clearTimeout(restTimer);
    restTimer = setTimeout(() => look(false), REST_MS);
  }
  const wait = moving ? lastLook + LOOK_MS - performance.now() : 0;
  if (pendingLook) return;
  pendingLook = setTimeout(() => {
    pendingLook = 0;
    lastLook = performance.now();
    sendLook();
  }, Math.max(0, wait));
}

function sendLook() {
  const widest = Number($("width").value);
  const panes = state.panes.flatMap((pane) =>
    pane.views.map((view) => {
      const { width, height } = view.element.getBoundingClientRect();
      const ratio = Math.min(window.devicePixelRatio || 1, widest / Math.max(1, width));
      const side = (css) => Math.round(Math.min(4096, Math.max(16, css * ratio)));
      return {
        stream: view.stream, width_px: side(width), height_px: side(height),
        camera: request(pane, view), channel: pane.channel, agents: state.layers.agents,
      };
    }),
  );
  if (panes.length > 0) {
    connection.send("look", { panes, moving: state.moving, reduce: $("reduce").checked });
  }
}

const viewOf = (stream) => state.panes.flatMap((pane) => pane.views).find((v) => v.stream === stream);

function showUpdate(frame, images) {
  state.frame = frame;
  images.forEach(({ stream, bitmap, size_px: [width, height] }) => {
    const view = viewOf(stream);
    if (!view) return;
    Object.assign(view.image, { width, height });
    view.image.getContext("2d").drawImage(bitmap, 0, 0);
  });
  $("badge").textContent = frame.badge;
  $("badge").classList.toggle("exact", frame.badge === "exact");
  noteTrails(frame);
  drawOverlays();
  showClock(frame);
  showAgents(frame);
  showList("times", [
    ["Device", `${frame.times_ms.gpu.toFixed(1)} ms`],
    ["Rendering in all", `${frame.times_ms.render.toFixed(1)} ms`],
    ["Encoding", `${frame.times_ms.encode.toFixed(1)} ms`],
  ]);
  window.viewer = { frame, updates: (window.viewer?.updates ?? 0) + 1 };
}

// Overlays -----------------------------------------------------------------------------------

function noteTrails({ time_s: now, agents }) {
  agents.forEach(({ name, pose }) => {
    const trail = (state.trails.get(name) ?? []).filter(
      ({ time }) => time < now && time > now - TRAIL_S,
    );
    state.trails.set(name, [...trail, { time: now, place: pose.position_m }]);
  });
}

function drawOverlays() {
  const { frame, layers } = state;
  if (!frame) return;
  frame.panes.forEach((camera) => {
    const view = viewOf(camera.stream);
    if (!view) return;
    const { overlay } = view;
    const ratio = window.devicePixelRatio || 1;
    const box = view.element.getBoundingClientRect();
    Object.assign(overlay, { width: box.width * ratio, height: box.height * ratio });
    // The image is fitted into the view: overlays follow it.
    const scale = Math.min(overlay.width / camera.size_px[0], overlay.height / camera.size_px[1]);
    const context = overlay.getContext("2d");
    context.setTransform(
      scale, 0, 0, scale,
      (overlay.width - scale * camera.size_px[0]) / 2,
      (overlay.height - scale * camera.size_px[1]) / 2,
    );
    context.beginPath();
    context.rect(0, 0, ...camera.size_px);
    context.clip();
    context.lineWidth = (2 * ratio) / scale;
    context.font = `${(13 * ratio) / scale}px system-ui, sans-serif`;
    if (layers.lanes) {
      context.strokeStyle = LANE_COLOR;
      nearLanes(camera).forEach((line) => stroke(context, geometry.polyline(camera, line, 2)));
    }
    if (layers.plan && frame.plan.length > 1) {
      context.strokeStyle = PLAN_COLOR;
      context.lineWidth *= 2;
      stroke(context, geometry.polyline(camera, frame.plan, 6));
      context.lineWidth /= 2;
    }
    if (!layers.agents) return;
    const far = ({ pose }) => geometry.length(geometry.subtract(pose.position_m, camera.pose.position_m));
    // The nearest last: their names cover others.
    const sorted = frame.agents.map((agent) => [far(agent), agent]).sort((a, b) => b[0] - a[0]);
    sorted.forEach(([, agent]) => drawAgent(context, camera, agent));
  });
}

function stroke(context, lines) {
  context.beginPath();
  lines.forEach(([from, to]) => {
    context.moveTo(...from);
    context.lineTo(...to);
  });
  context.stroke();
}

/** Lanes that come near to what a camera can see, straight above included. */
function nearLanes(camera) {
  const { position_m: at } = camera.pose;
  return (state.facts.log?.lanes ?? []).filter((line) =>
    line.some((point) => Math.hypot(point[0] - at[0], point[1] - at[1]) < LANES_WITHIN_M),
  );
}

function drawAgent(context, camera, agent) {
  context.strokeStyle = COLORS[agent.id % COLORS.length];
  if (state.layers.boxes) stroke(context, geometry.boxLines(camera, agent));
  if (state.layers.trails) {
    const places = (state.trails.get(agent.name) ?? []).map(({ place }) => place);
    stroke(context, geometry.polyline(camera, places, 4));
  }
  if (state.layers.names) {
    const top = geometry.fromLocal(agent.pose, [0, 0, agent.size_m[2] / 2 + 0.3]);
    const at = geometry.project(camera, top);
    if (!at) return;
    const { width } = context.measureText(agent.name);
    const size = parseFloat(context.font);
    context.fillStyle = "#000b";
    context.fillRect(at[0] - width / 2 - size / 4, at[1] - size, width + size / 2, 1.3 * size);
    context.fillStyle = "#fff";
    context.fillText(agent.name, at[0] - width / 2, at[1]);
  }
}

// Panels -------------------------------------------------------------------------------------

function showList(id, rows) {
  $(id).replaceChildren(
    ...rows.flatMap(([name, value]) => {
      const [dt, dd] = ["dt", "dd"].map((tag) => document.createElement(tag));
      dt.textContent = name;
      dd.textContent = value;
      return [dt, dd];
    }),
  );
}

function showAgents({ agents, ego }) {
  const body = $("agents").tBodies[0];
  const rows = new Map([...body.rows].map((row) => [row.dataset.name, row]));
  const sorted = agents
    // Lamps and signs stand where they are.
    .filter(({ name }) => !name.startsWith("signal/") && !name.startsWith("sign/"))
    .map((agent) => {
      const away = geometry.subtract(agent.pose.position_m, ego.position_m);
      return { ...agent, distance: geometry.length(away) };
    })
    .sort((a, b) => (a.name < b.name ? -1 : 1));
  const kept = sorted.map((agent) => {
    const row = rows.get(agent.name) ?? document.createElement("tr");
    if (!row.dataset.name) {
      row.dataset.name = agent.name;
      for (let i = 0; i < 4; i += 1) row.insertCell();
      row.cells[0].textContent = agent.class ? `${agent.name}, ${agent.class}` : agent.name;
      const button = document.createElement("button");
      button.textContent = "Follow";
      button.setAttribute("aria-label", `Follow ${agent.name}`);
      button.onclick = () => choose(state.panes[state.active], "follow", agent.name);
      row.cells[3].append(button);
    }
    row.cells[1].textContent = `${(3.6 * agent.speed_mps).toFixed(0)} km/h`;
    row.cells[2].textContent = state.facts.has_ego ? `${agent.distance.toFixed(0)} m` : "–";
    return row;
  });
  // Rows are moved only when they change, so that the focus stays.
  if (kept.length !== body.rows.length || kept.some((row, i) => row !== body.rows[i])) {
    body.replaceChildren(...kept);
  }
}

function showClock({ time_s: time, playing }) {
  if (document.activeElement !== $("time") || playing) $("time").value = time;
  $("clock").textContent = `${time.toFixed(2)} s`;
  $("play").textContent = playing ? "Pause" : "Play";
  const { log, span_s: [begin, end] } = state.facts;
  if (!log) return;
  $("cursor").style.left = `${(100 * (time - begin)) / Math.max(end - begin, 1e-9)}%`;
  const index = log.time_to_collision_s.findLastIndex(([at]) => at <= time + 1e-6);
  const ttc = log.time_to_collision_s[index]?.[1];
  $("speed-now").textContent = `${(3.6 * (log.speed_mps[index] ?? 0)).toFixed(0)} km/h`;
  $("ttc-now").textContent = ttc === null || ttc === undefined ? "none" : `${ttc.toFixed(1)} s`;
}

/** Curves and marks of an episode, and its score. */
function showLog(log, [begin, end]) {
  $("course").hidden = $("score").hidden = !log;
  if (!log) return;
  const share = (time) => (time - begin) / Math.max(end - begin, 1e-9);
  const times = log.time_to_collision_s.map(([time]) => time);
  const fastest = Math.max(1, ...log.speed_mps);
  const path = (name, values) => {
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
  };
  const ttcs = log.time_to_collision_s.map(([, ttc]) => ttc);
  $("chart").firstElementChild.replaceChildren(
    path("speed", log.speed_mps.map((speed) => speed / fastest)),
    path("ttc", ttcs.map((ttc) => (ttc === null ? null : Math.min(1, ttc / TTC_SHOWN_S)))),
  );
  const button = (event, text) => {
    const element = document.createElement("button");
    element.textContent = text;
    element.onclick = () => goTo(event.time_s);
    return element;
  };
  const title = (event) => `${event.time_s.toFixed(1)} s: ${event.text}`;
  $("marks").replaceChildren(
    ...log.events.map((event) => {
      const mark = button(event, "");
      mark.className = "mark";
      mark.style.left = `${100 * share(event.time_s)}%`;
      mark.title = title(event);
      mark.setAttribute("aria-label", title(event));
      return mark;
    }),
  );
  $("events").replaceChildren(
    ...log.events.map((event) => {
      const item = document.createElement("li");
      item.append(button(event, title(event)), ` times ${event.factor.toFixed(2)}`);
      return item;
    }),
  );
  const percent = (value) => `${(100 * value).toFixed(1)} %`;
  const { score } = log;
  showList("score-list", [
    ["Driving score", percent(score.driving_score)],
    ["Route completed", percent(score.route_completion)],
    ["Success", score.success ? "yes" : "no"],
    ["Shortest time to collision", score.min_ttc_s === null ? "none" : `${score.min_ttc_s.toFixed(1)} s`],
    ["Scenario", log.scenario],
    ["Planner", log.planner],
  ]);
  if (log.departs_s !== null) {
    notice(`From ${log.departs_s.toFixed(1)} s on vehicles move differently than in the log: its place or the program has changed.`);
  }
}

function goTo(time_s) {
  connection.send("time", { time_s });
}

function nextMark(back) {
  const now = state.frame?.time_s ?? 0;
  const times = (state.facts.log?.events ?? []).map((event) => event.time_s);
  const found = back ? times.findLast((time) => time < now - 1e-3) : times.find((time) => time > now + 1e-3);
  if (found !== undefined) goTo(found);
}

function showScene(facts) {
  state.facts = facts;
  const up = facts.has_ego ? [0, 0, 1] : geometry.upOf(facts.first_camera);
  state.axes = geometry.axesOf(up);
  const [begin, end] = facts.span_s;
  Object.assign($("time"), { min: begin, max: end, value: begin });
  const still = end <= begin;
  ["time", "play", "back", "forward", "speed", "loop"].forEach((id) => ($(id).disabled = still));
  showLog(facts.log, facts.span_s);
  showList("facts", [
    ["Background", `${facts.background_splats.toLocaleString("en")} splats`],
    ["Moving agents", facts.agents],
    ["Fixed agents", facts.plain_agents],
    ["Assets", facts.assets],
    ["Cameras", facts.cameras.length],
    ["Duration", `${(end - begin).toFixed(1)} s`],
  ]);
  if (state.panes.length > 0) return;
  $("empty").hidden = true;
  const pane = addPane();
  activate(0);
  choose(pane, facts.has_ego ? "follow" : "orbit");
}

// Controls -----------------------------------------------------------------------------------

function clamp(camera) {
  camera.pitch = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, camera.pitch));
}

/** A camera of the file becomes one that can be moved, from where it is. */
function movable(pane) {
  if (pane.camera) return pane.camera;
  const stream = pane.views[0]?.stream;
  const shown = state.frame?.panes.find((camera) => camera.stream === stream);
  if (!shown || pane.views.length !== 1) return null;
  const angles = geometry.anglesOf(state.axes, shown.pose.rotation);
  choose(pane, "fly");
  Object.assign(pane.camera, { at: shown.pose.position_m, ...angles });
  return pane.camera;
}

function turn(camera, dx, dy) {
  // A camera that flies turns itself; one around a point is dragged with the scene.
  const sign = camera.focus ? -1 : 1;
  camera.yaw += sign * dx;
  camera.pitch += sign * dy;
  clamp(camera);
}

function shift(camera, right, up) {
  const forward = geometry.direction(camera.axes, camera.yaw, camera.pitch);
  const [ahead, left] = camera.axes;
  const across = geometry.add(
    geometry.scale(ahead, Math.sin(camera.yaw)),
    geometry.scale(left, -Math.cos(camera.yaw)),
  );
  const above = geometry.cross(across, forward);
  const by = geometry.add(geometry.scale(across, right), geometry.scale(above, up));
  const key = camera.focus ? "focus" : "at";
  camera[key] = geometry.add(camera[key], by);
}

/** Moves toward what is looked at, meters. */
function approach(camera, by_m) {
  if (camera.focus) {
    camera.far = Math.max(0.3, camera.far - by_m);
    return;
  }
  const forward = geometry.direction(camera.axes, camera.yaw, camera.pitch);
  camera.at = geometry.add(camera.at, geometry.scale(forward, by_m));
}

function steer(pane) {
  const views = pane.element.lastChild;
  let from = null;
  views.addEventListener("contextmenu", (event) => event.preventDefault());
  views.addEventListener("pointerdown", (event) => {
    from = { x: event.clientX, y: event.clientY, moves: event.button === 2 || event.shiftKey };
    views.setPointerCapture(event.pointerId);
  });
  views.addEventListener("pointermove", (event) => {
    if (!from) return;
    const camera = movable(pane);
    if (!camera) return;
    const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
    Object.assign(from, { x: event.clientX, y: event.clientY });
    // A drag across the height of the view moves by that height, at the point looked at.
    const height = views.getBoundingClientRect().height;
    const extent = 2 * (camera.far ?? 10) * Math.tan((camera.fov * Math.PI) / 360);
    const above = camera.focus && camera.pitch < -1.5;
    if (from.moves || above) shift(camera, (-dx * extent) / height, (dy * extent) / height);
    else turn(camera, (dx * 2) / height, (dy * 2) / height);
    look(true);
  });
  ["pointerup", "pointercancel"].forEach((name) => views.addEventListener(name, () => (from = null)));
  views.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const camera = movable(pane);
      if (!camera) return;
      if (camera.focus) camera.far = Math.max(0.3, camera.far * Math.exp(event.deltaY * 0.001));
      else approach(camera, -event.deltaY * 0.01);
      look(true);
    },
    { passive: false },
  );
}

let flownAt = 0;

function fly(now) {
  const { held } = state;
  const seconds = Math.min(0.1, (now - flownAt) / 1000);
  flownAt = now;
  if (held.size === 0) return;
  const camera = movable(state.panes[state.active]);
  if (camera) {
    const step = (held.has("shift") ? 30 : 8) * seconds;
    const sign = (plus, minus) => Number(held.has(plus)) - Number(held.has(minus));
    approach(camera, step * sign("w", "s"));
    shift(camera, step * sign("d", "a"), step * sign("e", "q"));
    turn(camera, -seconds * sign("arrowright", "arrowleft"), seconds * sign("arrowup", "arrowdown"));
    look(true);
  }
  requestAnimationFrame(fly);
}

const HELD = ["w", "a", "s", "d", "q", "e", "arrowleft", "arrowright", "arrowup", "arrowdown"];

function play(playing) {
  const fields = { playing, speed: state.speed, looping: $("loop").checked };
  connection.send("play", fields);
}

function setSpeed(speed) {
  state.speed = speed;
  $("speed").value = speed;
  if (state.frame?.playing) play(true);
}

function next(select) {
  select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
  select.onchange();
}

function bookmark(digit, save) {
  const pane = state.panes[state.active];
  if (save) {
    const { choice, channel, camera } = pane;
    state.bookmarks.set(digit, structuredClone({ choice, channel, camera }));
    const entries = [...state.bookmarks.keys()].sort().map((key) => {
      const item = document.createElement("li");
      const button = document.createElement("button");
      button.textContent = `View ${key}`;
      button.onclick = () => bookmark(key, false);
      item.append(button);
      return item;
    });
    $("bookmarks").replaceChildren(...entries);
    return;
  }
  const saved = state.bookmarks.get(digit);
  if (!saved) return;
  choose(pane, saved.choice, saved.camera?.rig);
  Object.assign(pane, structuredClone(saved));
  pane.channels.value = pane.channel;
  look();
}

function setLayer(name, shown) {
  state.layers[name] = shown;
  $(`layer-${name}`).checked = shown;
  if (name === "agents") look();
  drawOverlays();
}

function setTwo(two) {
  $("two").setAttribute("aria-pressed", two);
  if (two && state.panes.length === 1) {
    choose(addPane(), "birds-eye");
  } else if (!two && state.panes.length === 2) {
    state.panes.pop().element.remove();
    activate(0);
  }
  look();
}

function pressed(event) {
  const { key } = event;
  const inField = ["SELECT", "TEXTAREA"].includes(event.target.tagName);
  if (!state.facts || $("keys").open || inField || event.ctrlKey || event.metaKey || event.altKey) return;
  const digit = /^Digit([1-9])$/.exec(event.code)?.[1];
  const low = key.toLowerCase();
  const onTime = event.target === $("time");
  const layers = { l: "lanes", k: "plan", b: "boxes", n: "names", t: "trails", g: "agents" };
  const at = SPEEDS.indexOf(state.speed);
  if (key === " " && !["BUTTON", "SUMMARY"].includes(event.target.tagName) && event.target.type !== "checkbox") {
    play(!state.frame?.playing);
  } else if (key === ",") connection.send("step", { by: -1 });
  else if (key === ".") connection.send("step", { by: 1 });
  else if (key === "[") setSpeed(SPEEDS[Math.max(0, at - 1)]);
  else if (key === "]") setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, at + 1)]);
  else if (key === "Home") connection.send("time", { time_s: state.facts.span_s[0] });
  else if (key === "End") connection.send("time", { time_s: state.facts.span_s[1] });
  else if (digit) bookmark(digit, event.shiftKey);
  else if (HELD.includes(low) && !(onTime && low.startsWith("arrow"))) {
    if (state.held.size === 0) {
      flownAt = performance.now();
      requestAnimationFrame(fly);
    }
    state.held.add(low);
    if (event.shiftKey) state.held.add("shift");
  } else if (layers[low]) setLayer(layers[low], !state.layers[layers[low]]);
  else if (low === "c") next(state.panes[state.active].select);
  else if (low === "v") next(state.panes[state.active].channels);
  else if (low === "p") setTwo(state.panes.length === 1);
  else if (low === "m") nextMark(event.shiftKey);
  else if (key === "?") $("keys").showModal();
  else return;
  event.preventDefault();
}

function notice(text) {
  $("notice").textContent = text;
  $("notice").hidden = !text;
}

function setTheme(light) {
  document.documentElement.dataset.theme = light ? "light" : "dark";
  $("theme").textContent = light ? "Dark" : "Light";
}

const LAYER_NAMES = { agents: "Agents", lanes: "Lanes", plan: "Plan", boxes: "Boxes", names: "Names", trails: "Trails" };
Object.entries(LAYER_NAMES).forEach(([name, text]) => {
  const label = document.createElement("label");
  const box = Object.assign(document.createElement("input"), {
    type: "checkbox", id: `layer-${name}`, checked: state.layers[name],
    onchange: () => setLayer(name, box.checked),
  });
  label.append(box, ` ${text}`);
  $("layers").append(label);
});
SPEEDS.forEach((speed) => $("speed").add(new Option(`${speed}×`, speed)));
$("speed").value = 1;
$("speed").onchange = () => setSpeed(Number($("speed").value));
$("loop").onchange = () => state.frame?.playing && play(true);
$("play").onclick = () => play(!state.frame?.playing);
$("back").onclick = () => connection.send("step", { by: -1 });
$("forward").onclick = () => connection.send("step", { by: 1 });
$("time").oninput = () => connection.send("time", { time_s: Number($("time").value) });
$("chart").onclick = ({ target, clientX }) => {
  if (target.className === "mark") return;
  const { left, width } = $("chart").getBoundingClientRect();
  const [begin, end] = state.facts.span_s;
  goTo(begin + ((clientX - left) / width) * (end - begin));
};
$("two").onclick = () => setTwo(state.panes.length === 1);
$("help").onclick = () => $("keys").showModal();
$("width").onchange = () => look();
$("reduce").onchange = () => look();
$("theme").onclick = () => setTheme(document.documentElement.dataset.theme !== "light");
setTheme(window.matchMedia("(prefers-color-scheme: light)").matches);
KEYS.forEach(([keys, meaning]) => {
  const [dt, dd] = ["dt", "dd"].map((tag) => document.createElement(tag));
  const kbd = document.createElement("kbd");
  kbd.textContent = keys;
  dt.append(kbd);
  dd.textContent = meaning;
  $("key-list").append(dt, dd);
});
window.addEventListener("keydown", pressed);
window.addEventListener("keyup", ({ key }) => {
  state.held.delete(key.toLowerCase());
  // Shift alone does not fly.
  if (state.held.size === 1) state.held.delete("shift");
});
window.addEventListener("blur", () => state.held.clear());
// The token is in a cookie now: it need not stay in the address.
history.replaceState(null, "", location.pathname);

const connection = new Connection({
  scene: showScene,
  update: (frame, images) => {
    if (state.refused) notice("");
    state.refused = false;
    showUpdate(frame, images);
  },
  refused: (text) => {
    state.refused = true;
    notice(text);
  },
  failed: (text) => {
    state.refused = true;
    notice(`The image could not be rendered: ${text}`);
  },
  status: notice,
});

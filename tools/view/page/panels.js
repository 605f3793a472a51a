// Panels beside the views: score, agents, edits, times, facts, recordings.
import * as geometry from "./geometry.js";
import { $, ask, make, notice, state } from "./state.js";
import * as path from "./path.js";
import { activePane, choose, drawOverlays } from "./views.js";

export function showList(id, rows) {
  const cells = rows.flatMap(([name, ...values]) => [
    make("dt", { textContent: name }),
    ...values.map((value) => make("dd", { textContent: value })),
  ]);
  $(id).replaceChildren(...cells);
}

export function showTimes({ gpu, render, encode, stages, splats, pairs }) {
  const ms = (value) => `${value.toFixed(value < 10 ? 2 : 0)} ms`;
  showList("times", [
    ["Device", ms(gpu)],
    ["Device and copy", ms(render)],
    ["Encoding", ms(encode)],
    ["Visible splats", splats.toLocaleString("en")],
    ["Splats times tiles", pairs.toLocaleString("en")],
  ]);
  showList("stages", stages.map(([name, value]) => [name, ms(value)]));
}

export function showFacts() {
  const [source] = state.sources;
  const [facts] = state.change.sources;
  const [begin, end] = state.change.span_s;
  const rows = [
    ["Content", source.title],
    ["Background", `${source.background_splats.toLocaleString("en")} splats`],
    ["Moving agents", facts.agents],
    ["Agents of plain splats", facts.plain_agents],
    ["Assets", source.assets],
    ["Cameras", source.cameras.length],
    ["Duration", `${(end - begin).toFixed(1)} s`],
    ["Device", state.device],
  ];
  if (facts.plain_agents > 0) rows.push(["Note", "Agents of plain splats stand still. Compressed ones move."]);
  showList("facts", rows);
}

/** Hides what says nothing about what is shown: agents of a splat file, plans of a scene. */
export function fit() {
  const has = (value) => state.sources.some((source, index) => value(source, state.change.sources[index]));
  const hasAgents = has(({ assets }, { agents, plain_agents: plain }) => assets + agents + plain > 0);
  const shown = {
    agents: hasAgents, boxes: hasAgents, names: hasAgents, trails: hasAgents,
    lanes: has(({ lanes }) => lanes.length > 0), plan: has((_, { log }) => log !== null),
  };
  Object.entries(shown).forEach(([layer, is]) => ($(`layer-${layer}`).closest("label").hidden = !is));
  $("agents-panel").hidden = !hasAgents;
}

// Score ---------------------------------------------------------------------------------------

export function showScore() {
  const logs = state.change.sources.map(({ log }) => log).filter((log) => log);
  $("score").hidden = logs.length === 0;
  if (logs.length === 0) return;
  const percent = (value) => `${(100 * value).toFixed(0)} %`;
  const row = (name, value) => [name, ...logs.map(value)];
  const shortest = ({ score }) => (score.min_ttc_s === null ? "none" : `${score.min_ttc_s.toFixed(1)} s`);
  $("score-list").classList.toggle("two", logs.length > 1);
  const rows = [
    row("Driving score", ({ score }) => percent(score.driving_score)),
    row("Route completed", ({ score }) => percent(score.route_completion)),
    row("Success", ({ score }) => (score.success ? "yes" : "no")),
    row("Shortest time to collision", shortest),
    row("State", ({ is_live: live, goes_on: on }) => (!live ? "recorded" : on ? "driving" : "ended")),
  ];
  if (logs.length > 1) rows.unshift(["", "A", "B"]);
  showList("score-list", rows);
  const { parts_s: parts } = state.change;
  const of = (index) => (logs.length > 1 ? ` ${"AB"[index]}` : "");
  const words = logs.map(({ planner, scenario }, index) => [`Planner${of(index)}`, `${planner}, in ${scenario}`]);
  if (logs.length > 1) {
    words.push(["First difference", parts === null ? "none: A and B are the same" : `at ${parts.toFixed(1)} s`]);
  }
  showList("score-words", words);
  $("log-save").hidden = !logs[0].is_live;
  const departs = logs.map(({ departs_s: time }) => time).find((time) => time !== null);
  if (departs !== undefined && !state.warned) {
    state.warned = true;
    notice(`From ${departs.toFixed(1)} s on vehicles move differently than in the log: its place or the program has changed.`, true);
  }
}

// Agents --------------------------------------------------------------------------------------

export function showAgents({ agents, ego }) {
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
    const row = rows.get(agent.name) ?? newRow(agent);
    row.cells[1].textContent = agent.fixed ? "stands" : `${(3.6 * agent.speed_mps).toFixed(0)} km/h`;
    row.cells[2].textContent = state.sources[0].has_ego ? `${agent.distance.toFixed(0)} m` : "–";
    const name = row.cells[0].firstChild;
    name.setAttribute("aria-pressed", agent.name === state.selected);
    return row;
  });
  // Rows are moved only when they change, so that the focus stays.
  if (kept.length !== body.rows.length || kept.some((row, i) => row !== body.rows[i])) {
    body.replaceChildren(...kept);
  }
}

function newRow(agent) {
  const row = make("tr");
  row.dataset.name = agent.name;
  for (let i = 0; i < 4; i += 1) row.insertCell();
  const says = !agent.class || agent.name.startsWith(agent.class);
  const text = says ? agent.name : `${agent.name}, ${agent.class}`;
  row.cells[0].append(make("button", { className: "plain", textContent: text, onclick: () => select(agent.name) }));
  const button = make("button", { textContent: "Follow" });
  button.setAttribute("aria-label", `Follow ${agent.name}`);
  button.onclick = () => choose(activePane(), "follow", agent.name);
  row.cells[3].append(button);
  return row;
}

// Edits ---------------------------------------------------------------------------------------

/** Selects an agent, or none. */
export function select(name) {
  state.selected = name;
  showEdits();
  if (state.frame) showAgents(state.frame.sources[0]);
  drawOverlays();
}

export function showEdits() {
  const edits = state.change?.sources[0].edits;
  $("edit").hidden = !edits;
  if (!edits) return;
  const there = state.selected !== null;
  $("selected").textContent = there ? state.selected : "Click an agent, in an image or in the table.";
  $("edit-agent").hidden = !there;
  const describe = (id, word, change) => {
    $(id).disabled = change === null;
    $(id).textContent = change === null ? word : `${word}: ${change}`;
  };
  describe("undo", "Undo", edits.undo);
  describe("redo", "Redo", edits.redo);
  ["turning", "delaying", "asset-row", "left-m", "right-m"].forEach((id) => ($(id).hidden = edits.on_lanes === true));
  if (!$("save-name").value) $("save-name").value = edits.file;
  const shown = $("asset").value;
  $("asset").replaceChildren(new Option("Show as …", ""), ...edits.assets.map((asset) => new Option(asset, asset)));
  $("asset").value = edits.assets.includes(shown) ? shown : "";
}

export const edit = (kind, fields = {}) => ask("edit", { edit: kind, ...fields });

/** Edits the selected agent. */
export async function editSelected(kind, fields = {}) {
  if (state.selected === null || !state.change?.sources[0].edits) return;
  const done = await edit(kind, { agent: state.selected, ...fields });
  if (done && kind === "remove") select(null);
}

export function turnSelected(sign) {
  return editSelected("turn", { by_rad: (sign * Math.PI) / 12 });
}

const shiftSelected = (fields) => editSelected("shift", { later_s: 0, forward_m: 0, left_m: 0, ...fields });

export function prepareEdits() {
  const step = () => Number($("shift-m").value);
  $("turn-left").onclick = () => turnSelected(1);
  $("turn-right").onclick = () => turnSelected(-1);
  $("forward-m").onclick = () => shiftSelected({ forward_m: step() });
  $("back-m").onclick = () => shiftSelected({ forward_m: -step() });
  $("left-m").onclick = () => shiftSelected({ left_m: step() });
  $("right-m").onclick = () => shiftSelected({ left_m: -step() });
  $("earlier").onclick = () => shiftSelected({ later_s: -0.5 });
  $("later").onclick = () => shiftSelected({ later_s: 0.5 });
  $("remove").onclick = () => editSelected("remove");
  $("duplicate").onclick = () => editSelected("duplicate");
  $("asset").onchange = ({ target }) => target.value && editSelected("swap", { asset: target.value });
  $("undo").onclick = () => edit("undo");
  $("redo").onclick = () => edit("redo");
  $("save").onclick = () => edit("save", { file: $("save-name").value });
  $("save-log").onclick = () => ask("save_log", { file: $("log-name").value });
  $("record").onclick = record;
}

// Recordings ----------------------------------------------------------------------------------

function record() {
  const number = (id) => Number($(id).value);
  const keys = path.recorded();
  const [begin, end] = keys.length ? path.span() : state.change.span_s;
  const span_s = [$("record-from").value === "" ? begin : number("record-from"), $("record-to").value === "" ? end : number("record-to")];
  $("record-said").textContent = "Recording …";
  ask("record", { folder: $("record-folder").value, span_s, rate_hz: number("record-rate"), path: keys }).then((begun) => {
    if (!begun) $("record-said").textContent = "";
  });
}

export function showRecording({ progress, said, error }) {
  $("record-said").textContent = error ?? said ?? `${progress[0]} of ${progress[1]} times`;
}

// State of the page that its modules share.
import * as geometry from "./geometry.js";

export const $ = (id) => document.getElementById(id);

/** Name of what a source shows: that of its file, without folders. */
export const nameOf = ({ title }) => title.split("/").at(-1);

export const state = {
  /** Facts of each source that do not change. */
  sources: [],
  /** Number of files that pages have sent; null until the viewer has said it. */
  shown: null,
  /** Bytes of a file that the viewer takes. */
  fileBytesMax: null,
  /** True while the page is loaded again, since something else is shown. */
  leaves: false,
  /** Facts that change: span_s, parts_s, and edits and log of each source. */
  change: null,
  /** The clock, which is ahead of the images while they are drawn. */
  clock: { time_s: 0, playing: false, revision: 0 },
  /** State of the newest update. */
  frame: null,
  panes: [],
  active: 0,
  moving: false,
  /** Name of the agent that is edited, and how far it is dragged. */
  selected: null,
  points: null,
  trails: new Map(),
  layers: { agents: true, lanes: false, plan: true, boxes: false, names: false, trails: false, axes: true },
  speed: 1,
  /** Factor of the speed of flight. */
  flySpeed: 1,
  axes: geometry.axesOf([0, 0, 1]),
  connection: null,
};

export const send = (command, fields) => state.connection.send(command, fields);

/** Sends a command; what it answers or refuses is shown. Returns its result, or null. */
export async function ask(command, fields) {
  try {
    const result = await state.connection.request(command, fields);
    if (result?.said) notice(result.said);
    else if (isRefusal) notice("");
    return result ?? {};
  } catch (error) {
    notice(error.message, true);
    isRefusal = true;
    return null;
  }
}

let noticeTimer = 0;
/** True while the notice is the reason why a command was refused. */
let isRefusal = false;

/** Shows a sentence: faults until the next image or accepted command, others for a while. */
export function notice(text, fault = false) {
  clearTimeout(noticeTimer);
  isRefusal = false;
  const close = make("button", { className: "close", onclick: () => notice("") });
  close.setAttribute("aria-label", "Close");
  $("notice").replaceChildren(text, ...(text ? [close] : []));
  $("notice").hidden = !text;
  $("notice").classList.toggle("fault", fault);
  if (text && !fault) noticeTimer = setTimeout(() => notice(""), 8000);
}

/** Elements `tag` with `fields`, and `children` in it. */
export function make(tag, fields = {}, ...children) {
  const element = Object.assign(document.createElement(tag), fields);
  element.append(...children);
  return element;
}

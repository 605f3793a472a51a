// Files that are dropped on the page or chosen: splats go to the viewer, camera paths are opened here.
import * as path from "./path.js";
import { $, make, notice, state } from "./state.js";

const PATHS = "json";
/** Key of the name of the page that is loaded again, because something else is shown. */
const ANEW = "decouplegs-anew";

/** Request that sends a file; null where none is sent. */
let sending = null;

const endingOf = (name) => (name.includes(".") ? name.split(".").at(-1).toLowerCase() : "");

function megabytes(bytes) {
  return `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB`;
}

/** Reason why a file is not sent; null where it is. */
function refusal({ name, size }) {
  const most = state.fileBytesMax;
  if (most === null) return "The viewer is not connected: wait until it is.";
  if (sending) return "Another file is being opened: wait until it is shown.";
  if (size === 0) return `${name} is empty.`;
  if (size > most) {
    return `${name} has ${megabytes(size)}, and a page sends ${most / 2 ** 30} GiB at most: open it by 'decouplegs view ${name}'.`;
  }
  return null;
}

/** Opens a file: splats take the place of what is shown, for all pages. */
export function open(file) {
  if (endingOf(file.name) === PATHS) {
    path.open(file);
    return;
  }
  const reason = refusal(file);
  if (reason) {
    notice(reason, true);
    return;
  }
  const isEdited = state.change?.sources[0].edits?.undo;
  if (isEdited && !window.confirm(`What was edited is lost, unless you have saved it. Open ${file.name}?`)) return;
  send(file);
}

function send(file) {
  const { name, size } = file;
  notice("");
  say(`Sending ${name}, ${megabytes(size)}`, 0);
  sending = new XMLHttpRequest();
  sending.open("PUT", `/files/${encodeURIComponent(name)}`);
  sending.upload.onprogress = ({ loaded, total }) => total && ($("sending-done").value = loaded / total);
  sending.upload.onload = () => say(`Reading ${name}`, null);
  const end = (reason) => {
    sending = null;
    $("sending").hidden = true;
    if (reason) notice(reason, true);
  };
  // Where it is shown, the viewer says so to all pages, which are loaded again.
  sending.onload = ({ target }) => end(target.status < 300 ? "" : target.responseText);
  sending.onerror = () => end(`${name} could not be sent: there is no connection to the viewer.`);
  sending.onabort = () => end(`${name} was not opened.`);
  sending.send(file);
}

/** Says what is done with a file; `share` of it is done, null where that is not known. */
function say(text, share) {
  $("sending").hidden = false;
  $("sending-said").textContent = text;
  const done = make("progress", { id: "sending-done", max: 1 });
  if (share !== null) done.value = share;
  done.setAttribute("aria-label", text);
  // What is read by the viewer is not broken off.
  $("sending-stop").hidden = share === null;
  $("sending-done").replaceWith(done);
}

/** Loads the page again: the viewer shows something else, for which the address says nothing. */
export function showAnew(title) {
  state.leaves = true;
  sessionStorage.setItem(ANEW, title);
  history.replaceState(null, "", location.pathname);
  location.reload();
}

/** Says why the page was loaded again. */
export function sayAnew() {
  const title = sessionStorage.getItem(ANEW);
  sessionStorage.removeItem(ANEW);
  if (title) notice(`${title} is shown now. To see again what was shown before, start the viewer again.`);
}

function dropped(event) {
  event.preventDefault();
  document.body.classList.remove("dropping");
  const { files, items } = event.dataTransfer;
  if (files.length === 0) return;
  const [{ name }] = files;
  if (files.length > 1) notice("Drop one file at a time.", true);
  else if (items?.[0]?.webkitGetAsEntry?.()?.isDirectory) notice(`${name} is a folder: drop one file, or open it by 'decouplegs view ${name}'.`, true);
  else open(files[0]);
}

export function prepare() {
  $("open").onclick = () => $("file").click();
  $("file").onchange = ({ target }) => {
    if (target.files[0]) open(target.files[0]);
    target.value = "";
  };
  $("sending-stop").onclick = () => sending?.abort();
  window.addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.toggle("dropping", event.dataTransfer.types.includes("Files"));
  });
  window.addEventListener("dragleave", (event) => !event.relatedTarget && document.body.classList.remove("dropping"));
  window.addEventListener("drop", dropped);
}

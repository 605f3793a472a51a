// Saved views: a digit returns to each.
import { $, make } from "./state.js";
import * as views from "./views.js";

const bookmarks = new Map();

/** The first digit that no view is saved under. */
const free = () => [..."123456789"].find((digit) => !bookmarks.has(digit));

export function bookmark(digit, save) {
  const pane = views.activePane();
  if (save) {
    const { choice, channel, camera } = pane;
    bookmarks.set(digit, structuredClone({ choice, channel, camera }));
    const entries = [...bookmarks.keys()].sort().map((key) =>
      make("li", {}, make("button", { textContent: `View ${key}`, onclick: () => bookmark(key, false) })),
    );
    $("bookmarks").replaceChildren(...entries);
    $("bookmark").disabled = !free();
    return;
  }
  const saved = bookmarks.get(digit);
  if (!saved) return;
  views.choose(pane, saved.choice, saved.camera?.rig);
  Object.assign(pane, structuredClone(saved));
  pane.channels.value = pane.channel;
  views.share(pane);
  views.look();
}

$("bookmark").onclick = () => bookmark(free(), true);

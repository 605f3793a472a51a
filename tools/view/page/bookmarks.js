// Saved views: a digit returns to each.
import { $, make } from "./state.js";
import * as views from "./views.js";

const bookmarks = new Map();

export function bookmark(digit, save) {
  const pane = views.activePane();
  if (save) {
    const { choice, channel, camera } = pane;
    bookmarks.set(digit, structuredClone({ choice, channel, camera }));
    const entries = [...bookmarks.keys()].sort().map((key) =>
      make("li", {}, make("button", { textContent: `View ${key}`, onclick: () => bookmark(key, false) })),
    );
    $("bookmarks").replaceChildren(...entries);
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

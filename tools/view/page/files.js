// What leaves the page: files that are downloaded, texts that are copied.
import { $, make, notice } from "./state.js";

/** Lets the browser save `content`, a text or bytes, as a file. */
export function download(name, content, type) {
  const url = URL.createObjectURL(new Blob([content], { type }));
  const link = make("a", { href: url, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** `text` as a part of a file's name. */
export const fileSafe = (text) => text.replace(/[^\p{L}\p{N}._-]+/gu, "-").replace(/^[-.]+|-+$/g, "") || "view";

/** Copies `text` and says `said`; where the browser does not let it, shows the text to copy. */
export async function copy(text, said) {
  try {
    await navigator.clipboard.writeText(text);
    notice(said);
  } catch {
    // Browsers have a clipboard for pages of localhost and of HTTPS alone.
    $("copy-said").textContent = said.replace("is copied", "is below");
    $("copy-text").value = text;
    $("copy-dialog").showModal();
    $("copy-text").select();
  }
}

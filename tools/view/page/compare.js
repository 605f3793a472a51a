// Two images of one view compared: a wipe, a blink, their difference.

/** Largest difference of a channel, 0 to 255, and PSNR in dB; Infinity where all are equal. */
export function measure(a, b) {
  let largest = 0;
  let squares = 0;
  for (let i = 0; i < a.length; i += 1) {
    if (i % 4 === 3) continue;
    const by = Math.abs(a[i] - b[i]);
    largest = Math.max(largest, by);
    squares += by * by;
  }
  const mean = squares / (0.75 * a.length);
  return { largest, psnr: mean === 0 ? Infinity : 10 * Math.log10((255 * 255) / mean) };
}

/** Absolute difference of two images of equal size, times `factor`, drawn on `canvas`. */
function drawDifference(canvas, a, b, factor) {
  Object.assign(canvas, { width: a.width, height: a.height });
  const shown = new ImageData(a.width, a.height);
  for (let i = 0; i < a.data.length; i += 1) {
    shown.data[i] = i % 4 === 3 ? 255 : Math.min(255, factor * Math.abs(a.data[i] - b.data[i]));
  }
  canvas.getContext("2d").putImageData(shown, 0, 0);
}

/**
 * Shows both images of `view` as `mode` says. Returns how much they differ; null where their sizes
 * do.
 */
export function showBoth(view, { mode, wipe, blink, factor }) {
  const { image, other, difference } = view;
  const equalSizes = image.width === other.width && image.height === other.height;
  other.style.clipPath = mode === "wipe" ? `inset(0 0 0 ${wipe}%)` : "";
  other.hidden = mode === "blink" ? !blink : mode !== "wipe";
  difference.hidden = mode !== "difference";
  if (!equalSizes || image.width === 0) return null;
  const read = (canvas) => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const [a, b] = [read(image), read(other)];
  if (mode === "difference") drawDifference(difference, a, b, factor);
  return measure(a.data, b.data);
}

/** Sentence on the views that were compared: on the one that differs most. */
export function describe(measured) {
  if (measured.length === 0) return "";
  const worst = measured.reduce((one, two) => (one.psnr <= two.psnr ? one : two));
  if (worst.largest === 0) return "same bits";
  return `${worst.psnr.toFixed(1)} dB, largest difference ${worst.largest} of 255`;
}

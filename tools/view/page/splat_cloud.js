// Splats of one scene, the canvas that draws them, and the worker that sorts them.
import * as geometry from "./geometry.js";
import { SLOTS, SplatCanvas } from "./splat_canvas.js";

/** Rows of the matrix to the frame of the camera at `from` from the frame at `pose`. */
function rowsOf(from, pose) {
  const to = geometry.toLocal(from, pose.position_m);
  const columns = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) =>
    geometry.subtract(geometry.toLocal(from, geometry.fromLocal(pose, axis)), to),
  );
  return [0, 1, 2].flatMap((row) => [...columns.map((column) => column[row]), to[row]]);
}

export class SplatCloud {
  /**
   * `makeWorker` gives a worker of splat_sorter.js. `changed` is called when there is something new
   * to draw, `closed` when nothing can be drawn any more.
   */
  constructor(makeWorker, { changed, closed }) {
    this.changed = changed;
    this.closed = closed;
    this.origins = [];
    this.canvas = SplatCanvas.create();
    this.works = this.canvas !== null;
    this.isSorting = false;
    /** Camera, agents and chunks that were sorted last: what did not change is not sorted again. */
    this.order = "";
    this.chunks = 0;
    this.splats = 0;
    this.loadedMs = null;
    if (!this.works) return;
    const { element } = this.canvas;
    element.setAttribute("aria-hidden", "true");
    element.className = "drawn";
    element.hidden = true;
    element.addEventListener("webglcontextlost", () => this.close());
    this.worker = makeWorker();
    this.worker.onmessage = ({ data }) => this.take(data);
    this.worker.onerror = () => this.close();
  }

  /** Reads the splats at an address. */
  load(url) {
    this.worker?.postMessage({ kind: "load", url });
  }

  /** Takes bytes of the splats as they come; null at their end. */
  give(bytes) {
    if (bytes) this.worker?.postMessage({ kind: "bytes", bytes }, [bytes.buffer]);
    else this.worker?.postMessage({ kind: "end" });
  }

  /** True if there is something to draw. */
  get isReady() {
    return this.works && this.origins.length > 0;
  }

  take(message) {
    if (message.kind === "chunk") {
      if (message.first === 0) this.works = this.canvas.reserve(message.all);
      if (!this.works) return;
      this.canvas.add(message.first, message.words);
      this.origins[message.part] = message.origin;
      this.chunks += 1;
      this.splats = message.first + message.words.length / 8;
    } else if (message.kind === "sorted") {
      this.isSorting = false;
      this.canvas.order(message.sorted);
    } else if (message.kind === "failed") this.close();
    else this.loadedMs = performance.now();
    this.changed();
  }

  close() {
    this.works = false;
    this.worker?.terminate();
    this.closed();
    this.canvas?.element.remove();
  }

  /** The background and `agents` as `camera` sees them. */
  placed(camera, agents) {
    const still = { position_m: this.origins[0] ?? [0, 0, 0], rotation: [0, 0, 0, 1] };
    const moving = agents.filter(({ asset }) => asset !== null && this.origins[asset + 1]);
    const all = [{ part: 0, pose: still }, ...moving.map(({ asset, pose }) => ({ part: asset + 1, pose }))];
    return all.slice(0, SLOTS).map(({ part, pose }, slot) => ({ part, slot, rows: rowsOf(camera.pose, pose) }));
  }

  /** Draws what `camera` sees by `rules`, and lets it be sorted; `most`: splats of the background. */
  draw(camera, most, agents, rules) {
    const placed = this.placed(camera, agents);
    const tangents = [0, 1].map((axis) => {
      const [center, size] = [camera.center_px[axis], camera.size_px[axis]];
      return Math.max(center, size - center) / camera.focal_px[axis];
    });
    const order = JSON.stringify([placed, tangents, most, this.chunks]);
    if (!this.isSorting && order !== this.order) {
      Object.assign(this, { isSorting: true, order });
      this.worker.postMessage({ kind: "sort", placed, tangents, near: rules.near_m, most });
    }
    this.canvas.draw(new Float32Array(placed.flatMap(({ rows }) => rows)), camera, rules);
  }
}

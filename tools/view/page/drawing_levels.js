// How finely the browser draws while something moves: as finely as its time allows.

/** Shares of the image's size, and splats of the background: from the best to the fastest. */
const LEVELS = [[1, Infinity], [0.5, Infinity], [0.5, 100000], [0.5, 50000], [0.35, 25000], [0.25, 12500]];
const FIRST_LEVEL = 2;
/** Images that take longer are followed by smaller ones, those that take less by larger ones. */
const SLOW_MS = 40;
const FAST_MS = 22;
/** Images that are timed before the level changes. */
const TIMED = 6;
/** Images that are farther apart than this did not wait for each other. */
const PAUSE_MS = 1000;

export class DrawingLevels {
  constructor() {
    this.level = FIRST_LEVEL;
    /** Best level that was not too slow. */
    this.best = 0;
    this.isKept = false;
    this.timed = [];
    this.paintedMs = 0;
  }

  /** Share of the image's size, and number of splats of the background. */
  get now() {
    return LEVELS[this.level];
  }

  /** Draws by one level from now on, however long it takes. */
  keep(level) {
    Object.assign(this, { level, isKept: true });
  }

  /** Chooses the level by the time between images; `isLast`: the camera rests, and no image follows. */
  time(now, isLast) {
    if (this.isKept) return;
    const took = now - this.paintedMs;
    this.paintedMs = now;
    if (took > PAUSE_MS || isLast) this.timed = [];
    else this.timed.push(took);
    if (this.timed.length < TIMED) return;
    // One image that waited for something else does not count.
    const usual = this.timed.sort((a, b) => a - b)[TIMED >> 1];
    this.timed = [];
    if (usual > SLOW_MS && this.level + 1 < LEVELS.length) {
      this.level += 1;
      this.best = this.level;
    } else if (usual < FAST_MS && this.level > this.best) this.level -= 1;
  }
}

/** Level of an image at rest: all splats, in full size. */
export const FULL = LEVELS[0];

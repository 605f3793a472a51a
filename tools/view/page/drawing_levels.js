// How finely the browser draws while something moves: as finely as its time allows.

/**
 * Shares of the image's size, splats of the background, and 255 times the least alpha that is drawn: from the best to
 * the fastest. A processor that draws alone takes most of its time for the many pixels that a splat hardly changes.
 */
const LEVELS = [[1, Infinity, 1], [0.5, Infinity, 1], [0.5, 100000, 1], [0.5, 50000, 2], [0.35, 25000, 4], [0.25, 12500, 4], [0.25, 6000, 8]];
const FIRST_LEVEL = 2;
/** Images that take longer are followed by smaller ones, those that take less by larger ones. */
const SLOW_MS = 34;
const FAST_MS = 20;
/** Images that are timed before the level changes; fewer where they take this long together. */
const TIMED = 6;
const TIMED_LEAST = 4;
const TIMED_MS = 500;
/** Share of the time of an image that is still waited for after the next one. */
const REMEMBERED = 0.7;
/** Images that are so many times too slow are followed by those of the level after the next. */
const MUCH_SLOWER = 4;
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
    /** Time that an image takes at most, by the last ones; 0 after a pause. */
    this.tookMs = 0;
  }

  /** Share of the image's size, number of splats of the background, and 255 times the least alpha. */
  get now() {
    return LEVELS[this.level];
  }

  /** Draws by one level from now on, however long it takes. */
  keep(level) {
    Object.assign(this, { level, isKept: true });
  }

  /** Chooses the level by the time between images; `isLast`: the camera rests, and no image follows. */
  time(now, isLast) {
    const took = now - this.paintedMs;
    this.paintedMs = now;
    this.tookMs = took > PAUSE_MS ? 0 : Math.max(took, REMEMBERED * this.tookMs);
    if (this.isKept) return;
    if (took > PAUSE_MS || isLast) this.timed = [];
    else this.timed.push(took);
    const together = this.timed.reduce((sum, each) => sum + each, 0);
    const count = this.timed.length;
    if (count < (together > TIMED_MS ? TIMED_LEAST : TIMED)) return;
    // One image that waited for something else does not count. The others count together: a browser may hand over two
    // at once, and then wait for both.
    const usual = (together - Math.max(...this.timed)) / (count - 1);
    this.timed = [];
    if (usual > SLOW_MS && this.level + 1 < LEVELS.length) {
      const levels = usual > MUCH_SLOWER * SLOW_MS ? 2 : 1;
      this.level = Math.min(this.level + levels, LEVELS.length - 1);
      this.best = this.level;
    } else if (usual < FAST_MS && count >= TIMED && this.level > this.best) this.level -= 1;
  }
}

/** Level of an image at rest: all splats, in full size. */
export const FULL = LEVELS[0];

// Poses over time, as a page in one file holds them.

const NUMBERS = 7;

/** Bytes of base64, without a copy of more than one piece. */
export function bytesOf(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i += 1) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** Poses of one thing from the sample `first` to the sample `last`. */
class Track {
  constructor({ first, last, poses, ...facts }, origin) {
    Object.assign(this, { first, last, facts, origin, numbers: new Float32Array(bytesOf(poses).buffer) });
  }

  /** Position and rotation of a sample. */
  sample(index) {
    const count = this.numbers.length / NUMBERS;
    const at = NUMBERS * Math.max(0, Math.min(count - 1, index - this.first));
    return [...this.numbers.subarray(at, at + NUMBERS)];
  }

  /** The pose at `place` in samples; null where there is none. The last sample holds until the next. */
  at(place) {
    if (place < this.first || place >= this.last + 1) return null;
    const before = Math.floor(place);
    const share = place - before;
    const [from, to] = [this.sample(before), this.sample(before + 1)];
    // Quaternions of both signs are one rotation: the shorter way.
    const dot = [3, 4, 5, 6].reduce((sum, i) => sum + from[i] * to[i], 0);
    const mixed = from.map((value, i) => value + share * ((i > 2 && dot < 0 ? -to[i] : to[i]) - value));
    const length = Math.hypot(...mixed.slice(3));
    return {
      position_m: [0, 1, 2].map((axis) => this.origin[axis] + mixed[axis]),
      rotation: mixed.slice(3).map((value) => value / length),
    };
  }
}

/** Ego, agents and cameras of a scene over time. */
export class Tracks {
  constructor({ start_s, step_s, count, origin_m: origin, ego, agents, cameras }) {
    Object.assign(this, { start_s, step_s, count });
    const read = (track) => new Track(track, origin);
    Object.assign(this, { ego: read(ego), agents: agents.map(read), cameras: cameras.map(read) });
  }

  /** First and last time, seconds. */
  get span_s() {
    return [this.start_s, this.start_s + this.step_s * (this.count - 1)];
  }

  /** Place of a time among the samples. */
  place(time_s) {
    if (this.step_s === 0) return 0;
    return Math.max(0, Math.min(this.count - 1, (time_s - this.start_s) / this.step_s));
  }

  /** Ego, and the agents that are there, at a time: as the viewer tells them of a source. */
  at(time_s) {
    const place = this.place(time_s);
    const agents = this.agents.map((track) => ({ ...track.facts, pose: track.at(place) }));
    return { ego: this.ego.at(place), agents: agents.filter(({ pose }) => pose), plan: [], alternatives: [] };
  }

  /** Pose of a camera of the rig. */
  cameraAt(index, time_s) {
    return this.cameras[index].at(this.place(time_s));
  }
}

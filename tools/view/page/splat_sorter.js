// Worker: reads the splats that the viewer sends, and puts those that a camera sees into the order
// of their depths. What the bytes mean is written in the module `splat_stream` of the viewer.

const MAGIC = 0x53504744;
const HEADER_BYTES = 48;
const SPLAT_BYTES = 32;
/** Standard deviations up to which a splat is seen. */
const REACH = 3.33;
/** Last bits of an f32 that depths are not sorted by: depths are told apart from 1/4096 on. */
const DROPPED_BITS = 11;
const SLOT_SHIFT = 24;

/** Positions and radii of the splats of each part: [x, y, z, radius]. */
const parts = [];
/** Number of splats of all parts, which is the place of the next one. */
let splats = 0;

/** Bytes that came and are no whole chunk yet. */
let left = new Uint8Array(0);

/** Reads the stream at `url`, and hands over each chunk as it comes. */
async function load(url) {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`${answer.status} ${await answer.text()}`);
  const reader = answer.body.getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    takeBytes(value);
  }
  end();
}

/** Takes bytes of the stream, and hands over the chunks that are whole now. */
function takeBytes(value) {
  const bytes = new Uint8Array(left.length + value.length);
  bytes.set(left);
  bytes.set(value, left.length);
  left = bytes.subarray(takeChunks(bytes));
}

function end() {
  if (left.length > 0) throw new Error("the splats end too early");
  postMessage({ kind: "loaded" });
}

/** Takes the whole chunks at the begin of `bytes`. Returns how many bytes they are. */
function takeChunks(bytes) {
  let at = 0;
  while (bytes.length - at >= HEADER_BYTES) {
    const header = new DataView(bytes.buffer, bytes.byteOffset + at, HEADER_BYTES);
    if (header.getUint32(0, true) !== MAGIC) throw new Error("not the splats of this viewer");
    const [part, count, of, all] = [4, 8, 12, 16].map((offset) => header.getUint32(offset, true));
    const end = at + HEADER_BYTES + count * SPLAT_BYTES;
    if (bytes.length < end) break;
    const origin = [24, 32, 40].map((offset) => header.getFloat64(offset, true));
    takeChunk({ part, count, of, all, origin, words: new Uint32Array(bytes.slice(at + HEADER_BYTES, end).buffer) });
    at = end;
  }
  return at;
}

function takeChunk({ part, count, of, all, origin, words }) {
  parts[part] ??= { first: splats, count: 0, places: new Float32Array(4 * of) };
  const own = parts[part];
  const floats = new Float32Array(words.buffer);
  const halves = new Int16Array(words.buffer);
  for (let i = 0; i < count; i += 1) {
    const to = 4 * (own.count + i);
    own.places.set(floats.subarray(8 * i, 8 * i + 3), to);
    const log = Math.max(halves[16 * i + 8], halves[16 * i + 9], halves[16 * i + 10]);
    own.places[to + 3] = REACH * Math.exp((log / 32767) * 32);
  }
  const first = splats;
  own.count += count;
  splats += count;
  postMessage({ kind: "chunk", part, first, all, origin, words }, [words.buffer]);
}

let keys = new Uint32Array(0);
let items = new Uint32Array(0);
const depth = new Float32Array(1);
const depthBits = new Uint32Array(depth.buffer);

/**
 * Sorts what a camera sees, the farthest first. `placed`: parts, their slots and rows of the
 * matrices from their frames to the camera's; `most`: splats of the background that count.
 */
function sort({ placed, tangents: [tx, ty], near, most }) {
  const room = placed.reduce((sum, { part }) => sum + (parts[part]?.count ?? 0), 0);
  if (keys.length < room) [keys, items] = [new Uint32Array(room), new Uint32Array(room)];
  const [wideX, wideY] = [Math.hypot(1, tx), Math.hypot(1, ty)];
  let seen = 0;
  let least = 0xffffffff;
  let greatest = 0;
  for (const { part, slot, rows } of placed) {
    const own = parts[part];
    if (!own) continue;
    const [a, b, c, d, e, f, g, h, i, j, k, l] = rows;
    const { places, first } = own;
    const count = part === 0 ? Math.min(most, own.count) : own.count;
    for (let splat = 0; splat < count; splat += 1) {
      const at = 4 * splat;
      const [x, y, z] = [places[at], places[at + 1], places[at + 2]];
      const ahead = i * x + j * y + k * z + l;
      if (!(ahead > near)) continue;
      const radius = places[at + 3];
      if (Math.abs(a * x + b * y + c * z + d) > tx * ahead + wideX * radius) continue;
      if (Math.abs(e * x + f * y + g * z + h) > ty * ahead + wideY * radius) continue;
      depth[0] = ahead;
      const key = depthBits[0] >>> DROPPED_BITS;
      if (key < least) least = key;
      if (key > greatest) greatest = key;
      keys[seen] = key;
      items[seen] = ((slot << SLOT_SHIFT) | (first + splat)) >>> 0;
      seen += 1;
    }
  }
  const sorted = new Uint32Array(seen);
  if (seen === 0) return sorted;
  const ends = new Uint32Array(greatest - least + 2);
  for (let n = 0; n < seen; n += 1) ends[greatest - keys[n] + 1] += 1;
  for (let n = 1; n < ends.length; n += 1) ends[n] += ends[n - 1];
  for (let n = 0; n < seen; n += 1) {
    const bucket = greatest - keys[n];
    sorted[ends[bucket]] = items[n];
    ends[bucket] += 1;
  }
  return sorted;
}

const failed = (error) => postMessage({ kind: "failed", text: error.message });

/** Works on what a page gives piece by piece. */
function take(work) {
  try {
    work();
  } catch (error) {
    failed(error);
  }
}

onmessage = ({ data }) => {
  if (data.kind === "load") load(data.url).catch(failed);
  else if (data.kind === "bytes") take(() => takeBytes(data.bytes));
  else if (data.kind === "end") take(end);
  else {
    const sorted = sort(data);
    postMessage({ kind: "sorted", sorted }, [sorted.buffer]);
  }
};

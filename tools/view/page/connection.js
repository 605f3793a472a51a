// The WebSocket: commands out, complete updates in.

const HEADER_BYTES = 32;
const MAGIC = 0x56534744;
const KINDS = { 2: "image/jpeg", 3: "image/png", 4: "points" };
const LAST = 2;
const RETRY_MS = [500, 1000, 2000, 4000, 8000];

/** Fields of the header of an image. */
export function header(buffer) {
  const view = new DataView(buffer);
  if (view.getUint32(0, true) !== MAGIC) throw new Error("not an image of this viewer");
  return {
    stream: view.getUint16(4, true),
    kind: KINDS[view.getUint8(6)],
    flags: view.getUint8(7),
    update: view.getUint32(8, true),
    size_px: [view.getUint16(20, true), view.getUint16(22, true)],
  };
}

/**
 * Connects, and connects again when the connection is lost.
 * `handlers`: scene(facts), change(facts), clock(message), update(state, images, points), recording(message),
 * refused(reason), failed(text), status(text).
 */
export class Connection {
  constructor(handlers) {
    this.handlers = handlers;
    this.sequence = 0;
    this.tries = 0;
    this.last = new Map();
    this.waiting = new Map();
    /** Number of the newest command that asked for a view. */
    this.newestLook = 0;
    this.open();
  }

  /** True from the loss of the connection until there is another. */
  get isLost() {
    return this.tries > 0;
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(`${scheme}//${location.host}/socket`);
    this.socket.binaryType = "arraybuffer";
    this.state = null;
    this.images = [];
    this.socket.onopen = () => {
      this.tries = 0;
      this.handlers.status("");
      // What was asked for last holds for the new connection too.
      const again = this.last.get("look");
      if (again) this.send("look", again);
    };
    this.socket.onmessage = (event) => this.receive(event.data);
    this.socket.onclose = (event) => {
      const wait = RETRY_MS[Math.min(this.tries, RETRY_MS.length - 1)];
      this.tries += 1;
      const reason = event.reason ? `: ${event.reason}` : "";
      this.handlers.status(`No connection to the viewer${reason}. Trying again …`);
      this.waiting.forEach(({ reject }) => reject(new Error("the connection was lost")));
      this.waiting.clear();
      setTimeout(() => this.open(), wait);
    };
  }

  /** Sends a command. The page always sends its newest view, also after a new connection. */
  send(command, fields = {}) {
    if (command === "look") this.last.set(command, fields);
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.sequence += 1;
    if (command === "look") this.newestLook = this.sequence;
    this.socket.send(JSON.stringify({ sequence: this.sequence, command, ...fields }));
  }

  /** Sends a command, and promises the result of its acknowledgement. */
  request(command, fields = {}) {
    return new Promise((resolve, reject) => {
      if (this.socket.readyState !== WebSocket.OPEN) return reject(new Error("no connection"));
      this.send(command, fields);
      return this.waiting.set(this.sequence, { resolve, reject });
    });
  }

  receive(data) {
    if (typeof data !== "string") {
      this.images.push({ ...header(data), data: data.slice(HEADER_BYTES) });
      if (this.images.at(-1).flags & LAST) this.complete();
      return;
    }
    const message = JSON.parse(data);
    const { type } = message;
    if (type === "frame") {
      this.state = message;
      this.images = [];
      if (message.images === 0) this.complete();
    } else if (type === "ack") this.acknowledged(message);
    else if (type === "error") this.handlers.failed(message.text);
    else if (["scene", "change", "clock", "recording"].includes(type)) this.handlers[type](message);
  }

  acknowledged({ sequence, error, result }) {
    const waiting = this.waiting.get(sequence);
    this.waiting.delete(sequence);
    if (waiting && error) waiting.reject(new Error(error));
    else if (waiting) waiting.resolve(result);
    else if (error) this.handlers.refused(error);
  }

  async complete() {
    const { state, images, socket } = this;
    this.images = [];
    const points = images.find((image) => image.kind === "points");
    const flat = images.filter((image) => image.kind !== "points");
    const decoded = await Promise.all(
      flat.map(async (image) => ({
        ...image,
        // Pixels are shown as they are: no color management, no premultiplied alpha.
        bitmap: await createImageBitmap(new Blob([image.data], { type: image.kind }), {
          colorSpaceConversion: "none",
          premultiplyAlpha: "none",
        }),
      })),
    );
    requestAnimationFrame(() => {
      this.handlers.update(state, decoded, points && new Float32Array(points.data));
      decoded.forEach((image) => image.bitmap.close());
      if (socket === this.socket) this.send("shown", { update: state.update });
    });
  }
}

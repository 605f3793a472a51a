// The WebSocket: commands out, complete updates in.

const HEADER_BYTES = 32;
const MAGIC = 0x56534744;
const KINDS = { 2: "image/jpeg", 3: "image/png" };
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
 * `handlers`: scene(facts), update(state, images), refused(reason), failed(text), status(text).
 */
export class Connection {
  constructor(handlers) {
    this.handlers = handlers;
    this.sequence = 0;
    this.tries = 0;
    this.last = new Map();
    this.open();
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
      setTimeout(() => this.open(), wait);
    };
  }

  /** Sends a command. The page always sends its newest view, also after a new connection. */
  send(command, fields = {}) {
    if (command === "look") this.last.set(command, fields);
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.sequence += 1;
    this.socket.send(JSON.stringify({ sequence: this.sequence, command, ...fields }));
  }

  receive(data) {
    if (typeof data !== "string") {
      this.images.push({ ...header(data), data: data.slice(HEADER_BYTES) });
      if (this.images.at(-1).flags & LAST) this.complete();
      return;
    }
    const message = JSON.parse(data);
    if (message.type === "scene") this.handlers.scene(message);
    else if (message.type === "error") this.handlers.failed(message.text);
    else if (message.type === "ack" && message.error) this.handlers.refused(message.error);
    else if (message.type === "frame") {
      this.state = message;
      this.images = [];
      if (message.panes.length === 0) this.complete();
    }
  }

  async complete() {
    const { state, images, socket } = this;
    this.images = [];
    const decoded = await Promise.all(
      images.map(async (image) => ({
        ...image,
        // Pixels are shown as they are: no color management, no premultiplied alpha.
        bitmap: await createImageBitmap(new Blob([image.data], { type: image.kind }), {
          colorSpaceConversion: "none",
          premultiplyAlpha: "none",
        }),
      })),
    );
    requestAnimationFrame(() => {
      this.handlers.update(state, decoded);
      decoded.forEach((image) => image.bitmap.close());
      if (socket === this.socket) this.send("shown", { update: state.update });
    });
  }
}

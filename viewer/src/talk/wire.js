// One stream on the server: a hello, sound out, poses in. The protocol is published as protocol.json.

/** Poses are kept by their number until they were shown. */
export class Stream {
  constructor(rate, options, onEvent) {
    this.rate = rate;
    this.onEvent = onEvent;
    this.frames = new Map();
    this.end = 0; // number of the frame after the last
    this.total = 0;
    this.welcome = null;
    this.opened = performance.now();
    this.socket = new WebSocket(location.origin.replace("http", "ws") + "/stream", "gesticulator.v1");
    this.socket.binaryType = "arraybuffer";
    const token = new URLSearchParams(location.hash.slice(1)).get("token");
    this.ready = new Promise((resolve) => { this.resolve = resolve; });
    this.socket.onopen = () => this.say({ type: "hello", protocol: 1, sample_rate: rate, format: "float32", options, ...(token ? { token } : {}) });
    this.socket.onmessage = ({ data }) => (typeof data === "string" ? this.hear(JSON.parse(data)) : this.take(data));
    this.socket.onclose = ({ code, reason }) => { if (![1000, 1005].includes(code)) this.onEvent({ type: "closed", code, reason }); };
  }

  say(message) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message)); }

  send(samples) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(samples); }

  close() { this.socket.onclose = null; this.socket.close(); }

  hear(message) {
    if (message.type === "hello") {
      this.welcome = message;
      this.resolve(this);
    }
    this.onEvent(message);
  }

  take(packet) {
    const size = new DataView(packet).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(packet, 4, size)));
    const numbers = new Float32Array(packet, 4 + size);
    const roots = head.count * head.joints * 4;
    for (let k = head.first; k < this.end; k++) this.frames.delete(k); // taken back by an interruption
    for (let k = 0; k < head.count; k++) {
      this.frames.set(head.first + k, {
        turns: numbers.subarray(k * head.joints * 4, (k + 1) * head.joints * 4),
        root: numbers.subarray(roots + k * 3, roots + k * 3 + 3),
      });
    }
    this.end = head.first + head.count;
    this.total += head.count;
    this.onEvent({ type: "poses", end: this.end / head.fps, state: head.state });
  }

  /** The frame of a media time; the nearest there is. Earlier ones are let go of. */
  at(time) {
    const wanted = Math.max(0, Math.min(Math.floor(time * this.welcome.fps), this.end - 1));
    for (const k of this.frames.keys()) {
      if (k >= wanted) break;
      this.frames.delete(k);
    }
    return this.frames.get(wanted);
  }
}

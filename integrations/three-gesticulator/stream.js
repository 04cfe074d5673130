// A live stream of `gesticulator serve`: sound in, poses out, shown on a VRM.

import { Quaternion } from "three";

import { showFace } from "./face.js";
import { BONES } from "./humanoid.js";

/** A connection to the server. Poses are kept by their number until they were shown. */
export class GestureStream {
  /**
   * @param url of the server, such as "ws://127.0.0.1:8765/stream"
   * @param options sampleRate: of the sound in hertz; token; fps; options: those of the performance; onEvent(message)
   */
  constructor(url, { sampleRate = 16000, token = null, fps = 60, options = {}, onEvent = () => {} } = {}) {
    this.frames = new Map();
    this.end = 0; // number of the frame after the last
    this.welcome = null;
    this.onEvent = onEvent;
    this.socket = new WebSocket(url, "gesticulator.v1");
    this.socket.binaryType = "arraybuffer";
    this.ready = new Promise((resolve, reject) => {
      this.socket.onopen = () => this.say({ type: "hello", protocol: 1, sample_rate: sampleRate, format: "float32", fps, options, ...(token ? { token } : {}) });
      this.socket.onmessage = ({ data }) => {
        if (typeof data !== "string") return this.take(data);
        const message = JSON.parse(data);
        if (message.type === "hello") {
          this.welcome = message;
          this.rows = new Map(message.joints.map(({ name }, row) => [name, row]));
          resolve(this);
        }
        this.onEvent(message);
      };
      this.socket.onclose = ({ code, reason }) => {
        reject(new Error(reason || `the server closed the connection (${code})`));
        this.onEvent({ type: "closed", code, reason });
      };
    });
  }

  /** A message of the protocol, such as { type: "finish" } or { type: "interrupt", at: 2.5 }. */
  say(message) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message)); }

  /** Sound: a Float32Array of samples from -1 to 1. */
  send(samples) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(samples); }

  close() { this.socket.close(1000); }

  /** A packet of poses; later frames that are held are replaced by it. */
  take(packet) {
    const size = new DataView(packet).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(packet, 4, size)));
    const numbers = new Float32Array(packet, 4 + size), joints = head.joints * 4, roots = head.count * joints;
    const faces = roots + head.count * 3, wide = head.face ?? 0;
    for (let k = head.first; k < this.end; k++) this.frames.delete(k);
    for (let k = 0; k < head.count; k++) {
      this.frames.set(head.first + k, { turns: numbers.subarray(k * joints, (k + 1) * joints), root: numbers.subarray(roots + 3 * k, roots + 3 * k + 3), ...(wide ? { face: numbers.subarray(faces + k * wide, faces + (k + 1) * wide) } : {}) });
    }
    this.end = head.first + head.count;
    this.onEvent({ type: "poses", end: this.end / head.fps, state: head.state });
  }

  /** The frame of a media time in seconds, the nearest there is; earlier ones are let go of. Undefined before any. */
  at(time) {
    if (!this.welcome || !this.end) return undefined;
    const wanted = Math.max(0, Math.min(Math.floor(time * this.welcome.fps), this.end - 1));
    for (const k of this.frames.keys()) {
      if (k >= wanted) break;
      this.frames.delete(k);
    }
    return this.frames.get(wanted);
  }

  /** Show a media time on a VRM; whether there was a frame. Call `vrm.update(delta)` after it. */
  show(vrm, time) {
    const frame = this.at(time);
    if (!frame) return false;
    const world = this.worlds(frame.turns), faces = vrm.meta?.metaVersion === "0" ? -1 : 1;
    const turned = new Map(), local = new Quaternion();
    for (const [bone, [parent, joints]] of Object.entries(BONES)) {
      const node = vrm.humanoid.getNormalizedBoneNode(bone), rows = joints.map((name) => this.rows.get(name));
      if (!node || rows.some((row) => row === undefined)) continue;
      let above = parent;
      while (above && !turned.has(above)) [above] = BONES[above];
      // A VRM without a chest bends at the spine as the chest would.
      const chest = bone === "spine" && !vrm.humanoid.getNormalizedBoneNode("chest") && this.rows.get("Spine3");
      const turn = world[chest || rows[0]].clone();
      if (!chest && rows.length > 1) turn.slerp(world[rows[1]], 0.5);
      turned.set(bone, turn);
      local.copy(above ? turned.get(above) : turn);
      if (above) local.invert().multiply(turn);
      node.quaternion.set(faces * local.x, local.y, faces * local.z, local.w);
    }
    if (frame.face) showFace(vrm, frame.face);
    return true;
  }

  /** World rotations of all joints from local ones, w first. */
  worlds(turns) {
    const out = [];
    this.welcome.joints.forEach(({ parent }, row) => {
      const turn = new Quaternion(turns[4 * row + 1], turns[4 * row + 2], turns[4 * row + 3], turns[4 * row]);
      out.push(parent < 0 ? turn : turn.premultiply(out[parent]));
    });
    return out;
  }
}

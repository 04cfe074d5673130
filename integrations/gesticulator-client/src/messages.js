// Poses that come through the data channel of a call, such as Pipecat's: the messages that messages.py of pipecat-gesticulator describes.

import { GestureStream } from "./stream.js";

const WHOLE = 32767;
const CLOCKS = 50; // messages from whose times the media time is estimated

/**
 * Give it every message of the channel, with or without its RTVI envelope; a SteadyPlayer shows its poses. The voice and the messages
 * take about the same way, so the media time that is heard is the one that the latest, least delayed messages said.
 */
export class MessageStream {
  constructor({ onEvent = () => {}, clock = () => performance.now() / 1000 } = {}) {
    Object.assign(this, { onEvent, clock });
    this.frames = new Map();
    this.fps = 60;
    this.end = 0; // number of the frame after the last
    this.welcome = null;
    this.joints = [];
    this.offsets = []; // media time less the clock, seconds
  }

  /** Media time that is heard now, seconds. */
  get time() { return this.offsets.length ? this.clock() + Math.max(...this.offsets) : 0; }

  /** Take a message, an object or its text; whether it was one of ours. */
  take(message) {
    const parsed = typeof message === "string" ? JSON.parse(message) : message, data = parsed?.data ?? parsed;
    if (data?.type === "gestures-hello") this.greet(data);
    else if (data?.type === "gestures") this.add(data);
    else return false;
    return true;
  }

  greet({ fps, look_ahead, joints, at, part }) {
    part.forEach(([name, parent, ...offset], k) => { this.joints[at + k] = { name, parent, offset }; });
    if (this.welcome || this.joints.filter(Boolean).length < joints) return;
    this.fps = fps;
    this.welcome = { type: "hello", fps, look_ahead, joints: this.joints };
    this.onEvent(this.welcome);
  }

  add({ first, count, state, source, now, turns, roots, face }) {
    this.offsets = [...this.offsets.slice(1 - CLOCKS), now - this.clock()];
    const whole = new Int16Array(bytes(turns)), root = new Float32Array(bytes(roots)), faces = face && new Float32Array(bytes(face));
    const wide = whole.length / count, broad = faces ? faces.length / count : 0;
    for (let k = first; k < this.end; k++) this.frames.delete(k); // taken back by an interruption
    for (let k = 0; k < count; k++) {
      this.frames.set(first + k, {
        turns: Float32Array.from(whole.subarray(k * wide, (k + 1) * wide), (value) => value / WHOLE), root: root.subarray(3 * k, 3 * k + 3), source,
        ...(faces ? { face: faces.subarray(k * broad, (k + 1) * broad) } : {}),
      });
    }
    this.end = first + count;
    this.onEvent({ type: "poses", end: this.end / this.fps, state });
  }
}

const { at, frameAt, forget } = GestureStream.prototype;
Object.assign(MessageStream.prototype, { at, frameAt, forget });

function bytes(text) { return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer; }

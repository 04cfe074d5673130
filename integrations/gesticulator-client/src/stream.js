// One stream on the server, on as many connections as it takes: a hello, sound out, poses in.
// The protocol is published as protocol.json of pipecat-gesticulator.

const FIRST_WAIT = 250, LONGEST_WAIT = 10_000; // milliseconds before a try to come back
const LASTED = 5000; // milliseconds that a connection must hold before the next loss is a new one, with a short wait
const JOURNAL_SECONDS = 60; // of sent messages that are kept to be sent once more
const FINAL = new Set([4400, 4401, 4408, 4413]); // close codes after which it is no use to come back

/** Poses are kept by their number until they were shown. */
export class GestureStream {
  /**
   * url: of the server, such as "wss://gestures.example.org/stream". sampleRate: hertz of the sound that will be sent, mono, Float32Array.
   * onEvent: is given the server's events, { type: "poses", end, state } for each packet, and "lost", "back" and "closed".
   * patience: seconds for which a lost server is waited for.
   */
  constructor(url, { sampleRate, options = {}, fps = 60, seed = 0, token, onEvent = () => {}, patience = 300, random = Math.random, Socket = globalThis.WebSocket }) {
    Object.assign(this, { url, sampleRate, options, fps, seed, token, onEvent, patience, random, Socket });
    this.frames = new Map();
    this.end = 0; // number of the frame after the last
    this.cut = Infinity; // the first frame that an interruption took back, until the server has answered it
    this.interrupting = 0; // interruptions that it has not answered yet
    this.total = 0;
    this.time = 0; // media time of what was sent, seconds
    this.welcome = null;
    this.source = 0; // connections before this one
    this.offset = 0; // frames before this connection's first one
    this.replayAgain = false; // whether an interruption reached back before the first frame of this connection
    this.journal = []; // what was sent, for a replay
    this.otherVoice = false;
    this.ended = false;
    this.ready = new Promise((resolve, reject) => { this.settle = { resolve, reject }; });
    this.ready.catch(() => {}); // it is also told as "closed"
    this.lostSince = 0;
    this.open();
  }

  get connected() { return this.live === true; }

  /** Send a command of the protocol. */
  say(message) {
    const seconds = (message.type === "idle" || message.type === "think") && message.seconds ? message.seconds : 0;
    if (message.type === "listen" || message.type === "speak") this.otherVoice = message.type === "listen";
    this.record(message, seconds);
  }

  /** Send sound: Float32Array, mono, at the sample rate. */
  send(samples) { this.record(samples.slice(), samples.length / this.sampleRate); }

  idle(seconds) { this.say(seconds === undefined ? { type: "idle" } : { type: "idle", seconds }); }
  think(seconds) { this.say(seconds === undefined ? { type: "think" } : { type: "think", seconds }); }
  listen() { this.say({ type: "listen" }); }
  speak() { this.say({ type: "speak" }); }
  addWords(words) { this.say({ type: "words", words }); }
  finish() { this.say({ type: "finish" }); }

  /** The voice was cut off at a media time, seconds; left out: at the last pose that came. */
  interrupt(time = this.end / this.fps) {
    const at = Math.min(time, this.time);
    this.end = Math.min(this.end, Math.ceil(at * this.fps - 1e-6));
    for (const k of this.frames.keys()) if (k >= this.end) this.frames.delete(k);
    this.journal = this.journal.map((sent) => cutEnd(sent, at, this.sampleRate));
    this.time = at;
    if (this.end < this.offset) this.leaveConnection(); // it knows nothing of what was before it
    this.record({ type: "interrupt", time: at }, 0);
  }

  /** Go on with another connection, at the first frame that did not come or was taken back. */
  leaveConnection() {
    this.replayAgain = true;
    if (this.live) this.drop();
  }

  drop() {
    this.socket.onclose = this.socket.onmessage = null;
    this.socket.close(1000);
    this.lost(1001, "an interruption reached back before the connection");
  }

  /** Let go of the server. */
  close() {
    this.ended = true;
    clearTimeout(this.retry);
    this.live = false;
    this.socket.onclose = this.socket.onmessage = this.socket.onopen = null;
    this.socket.close();
  }

  /** The frame of a media time; the nearest there is. Earlier ones are let go of. */
  at(time) {
    const wanted = Math.max(0, Math.min(Math.floor(time * this.fps + 1e-6), this.end - 1));
    this.forget(wanted);
    return this.frames.get(wanted);
  }

  /** The frame of a media time, or undefined where it has not come. */
  frameAt(time) {
    const wanted = Math.floor(time * this.fps + 1e-6);
    this.forget(Math.min(wanted, this.end - 1));
    return this.frames.get(wanted);
  }

  forget(before) {
    for (const k of this.frames.keys()) {
      if (k >= before) break;
      this.frames.delete(k);
    }
  }

  record(message, seconds) {
    const whole = { message, start: this.time, seconds, otherVoice: this.otherVoice };
    this.time += seconds;
    // A connection begins at a frame, which may lie after an interruption.
    const sent = seconds && !this.replayAgain ? cutStart(whole, this.offset / this.fps, this.sampleRate, this.fps) : whole;
    if (!sent) return;
    this.journal.push(sent);
    while (this.journal.length && this.journal[0].start + this.journal[0].seconds < this.time - JOURNAL_SECONDS) this.journal.shift();
    if (this.live) this.transmit(sent.message);
  }

  transmit(message) {
    if (this.socket.readyState !== this.Socket.OPEN) return; // lost: what is in the journal is sent later
    if (message.type === "interrupt") {
      this.interrupting++;
      this.cut = Math.min(this.cut, Math.ceil(message.time * this.fps - 1e-6));
    }
    this.socket.send(ArrayBuffer.isView(message) ? message : JSON.stringify(this.shifted(message)));
  }

  /** A command with its times in this connection's media time. */
  shifted(message) {
    const back = this.offset / this.fps, moved = { ...message };
    if (moved.time !== undefined) moved.time = Math.max(0, moved.time - back);
    if (moved.words) {
      moved.words = moved.words.filter((word) => word.end >= back)
        .map((word) => ({ ...word, start: Math.max(0, word.start - back), end: Math.max(0, word.end - back) }));
    }
    return moved;
  }

  open() {
    this.refused = null;
    this.wait ??= FIRST_WAIT;
    const socket = this.socket = new this.Socket(this.url, "gesticulator.v1");
    socket.binaryType = "arraybuffer";
    socket.onopen = () => socket.send(JSON.stringify({
      type: "hello", protocol: 1, sample_rate: this.sampleRate, format: "float32", fps: this.fps, seed: this.seed, options: this.options,
      ...(this.token ? { token: this.token } : {}),
    }));
    socket.onmessage = ({ data }) => {
      if (socket !== this.socket) return;
      if (typeof data !== "string") this.take(data); else this.receive(JSON.parse(data));
    };
    socket.onclose = ({ code, reason }) => { if (socket === this.socket) this.lost(code, reason); };
  }

  receive(message) {
    if (message.type === "hello") { this.begin(message); return; }
    if (message.type === "error") this.refused = message;
    if (message.type === "interrupted" && --this.interrupting <= 0) this.cut = Infinity;
    const back = this.offset / this.fps;
    for (const name of ["time", "start", "end"]) if (name in message) message[name] += back;
    if (message.type === "done") this.ended = true;
    this.onEvent(message);
  }

  begin(welcome) {
    const again = this.welcome !== null;
    this.welcome = welcome;
    this.replayAgain = false;
    if (again) this.replay();
    for (const { message } of this.journal) this.transmit(message);
    this.live = true;
    this.opened = Date.now();
    this.settle.resolve(this);
    this.onEvent(again ? { type: "back" } : welcome);
  }

  /** Go on from the first frame that did not come; the journal is what is to be sent for it. */
  replay() {
    this.offset = this.end = Math.min(this.end, this.cut);
    this.cut = Infinity;
    this.interrupting = 0;
    this.source++;
    const begin = this.offset / this.fps;
    this.journal = this.journal.map((sent) => cutStart(sent, begin, this.sampleRate, this.fps)).filter(Boolean);
    if (this.journal[0]?.otherVoice) this.journal.unshift({ message: { type: "listen" }, start: begin, seconds: 0, otherVoice: true });
  }

  lost(code, reason) {
    const was = this.live;
    this.live = false;
    if (this.ended || (code === 1000 && !this.refused)) { if (!this.ended) this.end_(code, reason); return; }
    if (FINAL.has(code) || FINAL.has(this.refused?.code)) { this.end_(this.refused?.code ?? code, this.refused?.message ?? reason); return; }
    if (was) this.onEvent({ type: "lost", code, reason });
    if (was && Date.now() - this.opened >= LASTED) {
      this.wait = FIRST_WAIT;
      this.lostSince = 0;
    }
    this.lostSince ||= Date.now();
    const asked = 1000 * (this.refused?.retry_after ?? 0);
    if (Date.now() - this.lostSince + asked + this.wait > 1000 * this.patience) { this.end_(code, this.refused?.message ?? (reason || "the server did not come back")); return; }
    this.retry = setTimeout(() => this.open(), asked + this.wait * (0.5 + 0.5 * this.random()));
    this.wait = Math.min(2 * this.wait, LONGEST_WAIT);
  }

  end_(code, reason) {
    this.ended = true;
    this.settle.reject(new Error(reason || String(code)));
    this.onEvent({ type: "closed", code, reason });
  }

  take(packet) {
    const size = new DataView(packet).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(packet, 4, size)));
    const numbers = new Float32Array(packet, 4 + size);
    const roots = head.count * head.joints * 4, faces = roots + head.count * 3, wide = head.face ?? 0, first = head.first + this.offset;
    if (first >= this.cut) return; // taken back while it was on its way
    for (let k = first; k < this.end; k++) this.frames.delete(k); // taken back by an interruption
    for (let k = 0; k < head.count; k++) {
      this.frames.set(first + k, {
        turns: numbers.subarray(k * head.joints * 4, (k + 1) * head.joints * 4),
        root: numbers.subarray(roots + k * 3, roots + k * 3 + 3), source: this.source,
        ...(wide ? { face: numbers.subarray(faces + k * wide, faces + (k + 1) * wide) } : {}),
      });
    }
    this.end = first + head.count;
    this.total += head.count;
    this.onEvent({ type: "poses", end: this.end / this.fps, state: head.state });
  }
}

/** What of a sent message lies after a media time; null for nothing. */
function cutStart(sent, begin, rate, fps) {
  const { message, start, seconds } = sent, end = start + seconds, lost = Math.max(0, begin - start);
  if (ArrayBuffer.isView(message)) {
    return end <= begin + 1e-9 ? null : { ...sent, message: message.slice(Math.ceil(lost * rate - 1e-6)), start: Math.max(start, begin), seconds: seconds - lost };
  }
  if (seconds > 0) {
    const left = Math.min(seconds, end - begin);
    return left <= 0 ? null : { ...sent, message: { ...message, seconds: left }, start: Math.max(start, begin), seconds: left };
  }
  // What was said after an interruption may lie in the frame before the one at which the connection begins.
  return start > begin - 1 / fps || message.type === "words" || (message.type === "idle" && !("seconds" in message)) ? sent : null;
}

/** What of a sent message lies before a media time; it is still one message. */
function cutEnd(sent, end, rate) {
  const left = Math.max(0, Math.min(sent.seconds, end - sent.start));
  if (ArrayBuffer.isView(sent.message)) return { ...sent, message: sent.message.slice(0, Math.round(left * rate)), seconds: left };
  if (sent.message.type === "interrupt") return { ...sent, message: { ...sent.message, time: Math.min(sent.message.time, end) } }; // taken back, too
  return left < sent.seconds ? { ...sent, message: { ...sent.message, seconds: left }, seconds: left } : sent;
}

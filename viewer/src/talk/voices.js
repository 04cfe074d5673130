// Voices: each opens a stream as it needs it, sends its sound, and says which media time is to be shown.

const AHEAD = 20; // seconds of a recording that are sent before they are played
const SPAN = 3; // seconds over which the lateness of poses is watched
const LATER = 0.08; // seconds in which the pose that is shown becomes later, where poses come later
const SOONER = 1.6; // and sooner
const SKIPS = 1; // seconds too late from which it skips ahead

/** Nobody speaks: the server's idle motion, shown a little late. */
export class Idle {
  kind = "idle";
  constructor() { this.options = {}; }
  async begin(stream) { stream.say({ type: "idle" }); this.since = null; }
  heard(end) { this.since ??= performance.now() - 1000 * end; }
  time() { return this.since === null || this.since === undefined ? 0 : (performance.now() - this.since) / 1000 - 0.15; }
  latency() { return "-"; }
  end() {}
}

/** The microphone: poses are shown as late as they come, steadily. */
export class Microphone {
  kind = "microphone";
  constructor(context, level) { this.context = context; this.level = level; this.options = { latency: "low" }; this.sent = 0; this.late = []; this.delay = 0; this.skipped = false; }

  async begin(stream) {
    this.media = await navigator.mediaDevices.getUserMedia({ audio: { channelCount: 1, echoCancellation: false } });
    await this.context.audioWorklet.addModule("capture.js");
    this.source = this.context.createMediaStreamSource(this.media);
    this.node = new AudioWorkletNode(this.context, "capture", { numberOfOutputs: 0 });
    this.node.port.onmessage = ({ data }) => {
      stream.send(data.piece);
      this.sent += data.piece.length / this.context.sampleRate;
      // The sound's own clock: what a busy page was slow to send is late, too.
      this.origin = data.end - this.sent;
      this.level(data.piece);
    };
    this.source.connect(this.node);
  }

  now() { return this.origin === undefined ? 0 : Math.max(0, this.context.currentTime - this.origin); }

  heard(end) { this.late.push([performance.now(), this.now() - end]); }

  /** The pose that is shown is as late as the latest that came lately was when the next one came. */
  time() {
    const now = performance.now();
    while (this.late.length && now - this.late[0][0] > SPAN * 1000) this.late.shift();
    let wanted = 0;
    for (let k = 1; k < this.late.length; k++) wanted = Math.max(wanted, this.late[k - 1][1] + (this.late[k][0] - this.late[k - 1][0]) / 1000);
    const seconds = (now - (this.eased ?? now)) / 1000;
    this.eased = now;
    if (this.delay - wanted > SKIPS) {
      this.delay = wanted;
      this.skipped = true;
    } else this.delay += (wanted - this.delay) * (1 - Math.exp(-seconds / (wanted > this.delay ? LATER : SOONER)));
    return this.now() - this.delay;
  }

  latency() { return `${Math.round(this.delay * 1000)} ms`; }

  end() { this.source?.disconnect(); this.media?.getTracks().forEach((track) => track.stop()); this.level(new Float32Array(1)); }
}

/** A recording, sent faster than it plays: poses lie ready when their sound is heard. */
export class Recording {
  kind = "recording";
  constructor(context, buffer, ended) { this.context = context; this.buffer = buffer; this.ended = ended; this.options = { latency: "full", keep_up: true }; this.start = null; this.sent = 0; this.behind = 0; this.got = 0; }

  async begin(stream) {
    const rate = this.context.sampleRate;
    const channels = Array.from({ length: this.buffer.numberOfChannels }, (_, k) => this.buffer.getChannelData(k));
    const mono = channels[0].map((_, k) => channels.reduce((sum, one) => sum + one[k], 0) / channels.length);
    this.node = this.context.createBufferSource();
    this.node.buffer = this.buffer;
    this.node.connect(this.context.destination);
    this.stream = stream;
    this.feed = setInterval(() => {
      while (this.sent < mono.length && this.sent / rate < this.time() + AHEAD) {
        stream.send(mono.slice(this.sent, this.sent + rate / 5));
        this.sent += rate / 5;
      }
      if (this.sent >= mono.length) {
        clearInterval(this.feed);
        stream.say({ type: "idle", seconds: 2 });
      }
    }, 50);
  }

  heard(end) {
    this.got = end;
    if (this.start === null) {
      this.start = this.context.currentTime + 0.05;
      this.node.start(this.start);
      this.node.onended = this.ended;
    }
  }

  time() {
    if (this.start === null) return 0;
    const time = this.context.currentTime - this.start - (this.context.outputLatency || 0);
    this.behind = Math.max(this.behind, time - this.got);
    return time;
  }

  latency() { return `${Math.round(Math.max(0, this.behind) * 1000)} ms`; }

  end() { clearInterval(this.feed); if (this.node) { this.node.onended = null; if (this.start !== null) this.node.stop(); } }
}

// The page of `gesticulator live`: sound goes to the server, poses come back and are shown by the sound's own clock.
import * as THREE from "./three.module.min.js";

const $ = (id) => document.getElementById(id);
const AHEAD = 20; // seconds of a recording that are sent before they are played
const BLEND = 0.35; // seconds from the pose that was shown to those of a new stream
const SPAN = 3; // seconds over which the lateness of poses is watched

// ---------------------------------------------------------------- the wire

/** One stream: a hello, sound out, poses in. Poses are kept by their number. */
class Stream {
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

// ---------------------------------------------------------------- the figure

/** A figure of capsules on the skeleton that the server told. */
class Figure {
  constructor(joints) {
    this.bones = joints.map(({ name, offset }) => {
      const bone = new THREE.Object3D();
      bone.name = name;
      bone.position.fromArray(offset);
      return bone;
    });
    this.group = new THREE.Group();
    const shirt = new THREE.MeshStandardMaterial({ color: 0x3d7a85, roughness: 0.8 });
    const skin = new THREE.MeshStandardMaterial({ color: 0xdcb999, roughness: 0.7 });
    joints.forEach(({ name, parent, offset, tip }, number) => {
      (parent < 0 ? this.group : this.bones[parent]).add(this.bones[number]);
      if (parent >= 0) this.limb(this.bones[parent], offset, this.radius(joints[parent].name, name), this.bare(joints[parent].name) ? skin : shirt);
      if (tip && name !== "Head") this.limb(this.bones[number], tip, this.radius(name, name), skin);
    });
    this.head(skin);
    this.lowest = joints.some(({ name }) => name.endsWith("ToeBase")) ? 0 : 0.55;
  }

  bare(name) { return name.includes("Hand") || name.startsWith("Neck") || name.endsWith("ForeArm"); }

  radius(above, name) {
    if (above.includes("Hand")) return name.includes("Hand") && above === name.slice(0, above.length) && !/\d/.test(above) ? 0.016 : 0.009;
    if (/^(Hips|Spine)/.test(above)) return /Shoulder|UpLeg/.test(name) ? 0.06 : 0.1;
    if (above.endsWith("UpLeg")) return 0.075;
    if (/Leg|Foot/.test(above)) return 0.05;
    return above.startsWith("Neck") ? 0.05 : above.endsWith("ForeArm") ? 0.034 : 0.045;
  }

  limb(parent, offset, radius, material) {
    const way = new THREE.Vector3().fromArray(offset);
    const length = way.length();
    if (length < 0.005) return;
    const mesh = new THREE.Mesh(new THREE.CapsuleGeometry(radius, length, 6, 14), material);
    mesh.position.copy(way).multiplyScalar(0.5);
    mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), way.normalize());
    parent.add(mesh);
  }

  head(material) {
    const head = this.bones.find(({ name }) => name === "Head");
    if (!head) return;
    const skull = new THREE.Mesh(new THREE.SphereGeometry(0.1, 32, 24), material);
    skull.scale.set(0.82, 1.15, 1);
    skull.position.set(0, 0.1, 0.02);
    const nose = new THREE.Mesh(new THREE.SphereGeometry(0.018, 12, 8), material);
    nose.position.set(0, 0.09, 0.12);
    head.add(skull, nose);
  }

  /** Show a frame; a share below 1 stays nearer to what is shown. */
  set({ turns, root }, share) {
    const turn = new THREE.Quaternion();
    this.bones.forEach((bone, j) => {
      turn.set(turns[4 * j + 1], turns[4 * j + 2], turns[4 * j + 3], turns[4 * j]);
      bone.quaternion.slerp(turn, share);
    });
    this.bones[0].position.lerp(new THREE.Vector3(...root), share);
  }
}

class Stage {
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.camera = new THREE.PerspectiveCamera(30, 1, 0.1, 20);
    this.scene = new THREE.Scene();
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8d8578, 1.6));
    const sun = new THREE.DirectionalLight(0xffffff, 2.2);
    sun.position.set(1.5, 3, 2.5);
    this.scene.add(sun);
    this.figure = null;
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  stand(joints) {
    const names = joints.map(({ name }) => name).join();
    if (this.names === names) return;
    this.names = names;
    if (this.figure) this.scene.remove(this.figure.group);
    this.figure = new Figure(joints);
    this.scene.add(this.figure.group);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    const low = this.figure ? this.figure.lowest : 0.55;
    this.camera.aspect = width / height;
    const tall = 1.9 - low;
    this.camera.position.set(0, low + tall / 2, (tall / 2) / Math.tan(Math.PI / 12) / Math.min(1, this.camera.aspect * 0.9));
    this.camera.lookAt(0, low + tall / 2, 0);
    this.camera.updateProjectionMatrix();
  }

  draw() { this.renderer.render(this.scene, this.camera); }
}

// ---------------------------------------------------------------- voices: each says what media time it is

/** Nobody speaks: the server's idle motion, shown a little late. */
class Idle {
  constructor() { this.options = {}; }
  async begin(stream) { stream.say({ type: "idle" }); this.since = null; }
  heard(end) { this.since ??= performance.now() - 1000 * end; }
  time() { return this.since === null || this.since === undefined ? 0 : (performance.now() - this.since) / 1000 - 0.15; }
  latency() { return "-"; }
  end() {}
}

/** The microphone: poses are shown as late as they come, steadily. */
class Microphone {
  constructor(context) { this.context = context; this.options = { latency: "low" }; this.sent = 0; this.late = []; this.delay = 0; }

  async begin(stream) {
    this.media = await navigator.mediaDevices.getUserMedia({ audio: { channelCount: 1, echoCancellation: false } });
    await this.context.audioWorklet.addModule("capture.js");
    this.source = this.context.createMediaStreamSource(this.media);
    this.node = new AudioWorkletNode(this.context, "capture", { numberOfOutputs: 0 });
    this.node.port.onmessage = ({ data }) => {
      stream.send(data);
      this.sent += data.length / this.context.sampleRate;
      this.at = performance.now();
      level(data);
    };
    this.source.connect(this.node);
  }

  now() { return this.at === undefined ? 0 : this.sent + Math.min((performance.now() - this.at) / 1000, 0.1); }

  heard(end) { this.late.push([performance.now(), this.now() - end]); }

  /** The pose that is shown is as late as the latest that came lately was when the next one came. */
  time() {
    const now = performance.now();
    while (this.late.length && now - this.late[0][0] > SPAN * 1000) this.late.shift();
    let wanted = 0;
    for (let k = 1; k < this.late.length; k++) wanted = Math.max(wanted, this.late[k - 1][1] + (this.late[k][0] - this.late[k - 1][0]) / 1000);
    this.delay += (wanted - this.delay) * (wanted > this.delay ? 0.2 : 0.01);
    return this.now() - this.delay;
  }

  latency() { return `${Math.round(this.delay * 1000)} ms`; }

  end() { this.source?.disconnect(); this.media?.getTracks().forEach((track) => track.stop()); level(new Float32Array(1)); }
}

/** A recording, sent faster than it plays: poses lie ready when their sound is heard. */
class Recording {
  constructor(context, buffer) { this.context = context; this.buffer = buffer; this.options = { latency: "full" }; this.start = null; this.sent = 0; this.behind = 0; this.got = 0; }

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
      this.node.onended = () => change(new Idle());
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

// ---------------------------------------------------------------- the page

const context = new AudioContext();
let stage = null;
let voice = null;
let stream = null;
let blend = 0;
let last = performance.now();

function say(text) {
  $("message").textContent = text;
  $("message").hidden = !text;
}

function level(samples) {
  let sum = 0;
  for (const one of samples) sum += one * one;
  $("level").value = Math.min(1, 4 * Math.sqrt(sum / samples.length));
}

function heard(of, message) {
  if (of !== stream) return;
  if (message.type === "poses") {
    if (of.total && $("first").dataset.of !== String(of.opened)) {
      $("first").dataset.of = String(of.opened);
      $("first").textContent = `${Math.round(performance.now() - of.opened)} ms`;
    }
    voice.heard(message.end);
    $("state").textContent = message.state;
  } else if (message.type === "state") $("state").textContent = message.state;
  else if (message.type === "closed") say(`The server closed the stream: ${message.reason || message.code}`);
}

/** Another voice: its own stream, and a blend from the pose that is shown. */
async function change(next) {
  voice?.end();
  stream?.close();
  say("");
  const own = new Stream(context.sampleRate, next.options, (message) => heard(own, message));
  voice = next;
  stream = own;
  $("level").value = 0;
  $("microphone").setAttribute("aria-pressed", String(next instanceof Microphone));
  $("stop").disabled = next instanceof Idle;
  await own.ready;
  if (own !== stream) return;
  stage.stand(own.welcome.joints);
  blend = 0;
  try {
    await next.begin(own);
  } catch (error) {
    say(error.name === "NotAllowedError" ? "The browser does not let this page hear the microphone." : String(error.message || error));
    await change(new Idle());
  }
}

async function play(file) {
  await context.resume();
  try {
    await change(new Recording(context, await context.decodeAudioData(await file.arrayBuffer())));
  } catch (error) {
    say(`${file.name} cannot be played: ${error.message}`);
  }
}

function tick(now) {
  requestAnimationFrame(tick);
  if (stream?.welcome && stream.end && stage.figure) {
    blend = Math.min(1, blend + (now - last) / 1000 / BLEND);
    const frame = stream.at(voice.time());
    if (frame) stage.figure.set(frame, blend < 1 ? 0.2 : 1);
    $("latency").textContent = voice.latency();
    $("frames").textContent = stream.total;
  }
  last = now;
  stage.draw();
}

$("microphone").addEventListener("click", async () => {
  await context.resume();
  change(voice instanceof Microphone ? new Idle() : new Microphone(context));
});
$("stop").addEventListener("click", () => change(new Idle()));
$("file").addEventListener("change", ({ target }) => { if (target.files[0]) play(target.files[0]); });
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  const file = event.dataTransfer.files[0];
  if (file) play(file);
});

try {
  stage = new Stage($("figure"));
  await change(new Idle());
  requestAnimationFrame(tick);
} catch (error) {
  say(`The figure needs WebGL, which this browser does not offer here (${error.message}).`);
}
// For the console, and for tests.
window.live = { get stage() { return stage; }, get stream() { return stream; }, get voice() { return voice; } };
document.body.dataset.ready = "true";

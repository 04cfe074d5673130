// A pose for every moment: of the stream where it has come, of idling where it has not, and no jump between.

const TO_REST = 3, TO_STREAM = 6; // 1/s at which a difference from idling, or from the stream, goes away
const BREATH_SECONDS = 4, BREATH = 0.012; // of a breath while idling: its time, and radians that it turns the spine
const LIPS = 12; // 1/s at which a difference between two faces goes away
const SPEEDS = 0.1; // longest step, seconds, over which the speed of what was shown is measured

/**
 * Where there is no pose for a moment, the character comes to rest and breathes. Where the source changes, the difference in pose and in
 * speed is carried over and decays as a critically damped spring.
 */
export class SteadyPlayer {
  constructor(stream) {
    this.stream = stream;
    this.rest = null;
    this.shown = []; // the last two poses, with their times
    this.source = null;
    this.idleSince = 0;
    this.face = null; // what was shown last, and how far it was from the source's own
    this.away = null;
  }

  get idling() { return this.source === "idle"; }

  /** { turns, root } to show at a media time, seconds: 4 numbers a joint (w, x, y, z), 3 metres; with face where the stream has one; null
   *  before the first pose. */
  poseAt(time) {
    const { stream } = this;
    this.rest ??= stream.frames.values().next().value ?? null;
    if (!this.rest) return null;
    let [source, target, speed] = this.target(time);
    const fresh = source !== this.source, step = this.shown.length ? Math.max(0, time - this.shown.at(-1)[0]) : 0;
    if (fresh) {
      if (source === "idle") { this.idleSince = time; [source, target, speed] = this.target(time); }
      this.carryOver(time, target, speed);
      this.source = source;
    }
    this.decay(time, source === "idle" ? TO_REST : TO_STREAM);
    const joints = target.turns.length / 4, turns = new Float32Array(4 * joints), root = [0, 1, 2].map((c) => target.root[c] + this.x[3 * joints + c]);
    for (let j = 0; j < joints; j++) turns.set(multiply(exp(this.x.subarray(3 * j, 3 * j + 3)), target.turns.subarray(4 * j, 4 * j + 4)), 4 * j);
    const pose = { turns, root }, face = this.faceOf(target.face, fresh, step);
    if (face) pose.face = face;
    this.shown = [...this.shown.slice(-1), [time, pose]];
    return pose;
  }

  /** The face to show; the difference from the last one of another source goes away. Idling, the mouth is shut. */
  faceOf(face, fresh, step) {
    if (!face && !this.face) return null;
    face ??= Float32Array.from(this.face, (_, k) => (k ? 0 : 1));
    if (fresh && this.face) this.away = this.face.map((value, k) => value - face[k]);
    const left = Math.exp(-LIPS * step);
    this.away = this.away?.map((value) => value * left) ?? null;
    this.face = face.map((value, k) => value + (this.away?.[k] ?? 0));
    return this.face;
  }

  target(time) {
    const frame = time >= 0 ? this.stream.frameAt(time) : undefined;
    if (!frame) {
      const pose = this.atRest(time);
      return ["idle", pose, difference(pose, this.atRest(time - 0.02), 0.02)];
    }
    const after = this.stream.frames.get(Math.floor(time * this.stream.fps + 1e-6) + 1);
    const joined = after && after.source === frame.source ? after : frame;
    return [frame.source, frame, difference(joined, frame, 1 / this.stream.fps)];
  }

  atRest(time) {
    const turns = Float32Array.from(this.rest.turns), spine = this.stream.welcome.joints.findIndex(({ name }) => name === "Spine1" || name === "Spine");
    if (spine >= 0) {
      const phase = 2 * Math.PI * Math.max(0, time - this.idleSince) / BREATH_SECONDS, half = -0.25 * BREATH * (1 - Math.cos(phase));
      turns.set(multiply(turns.subarray(4 * spine, 4 * spine + 4), [Math.cos(half), Math.sin(half), 0, 0]), 4 * spine);
    }
    return { turns, root: this.rest.root };
  }

  carryOver(time, target, speed) {
    const size = 3 * (target.turns.length / 4) + 3;
    this.x = new Float64Array(size);
    this.v = new Float64Array(size);
    if (!this.shown.length) return;
    const [when, last] = this.shown.at(-1), step = time - when <= SPEEDS ? time - when : 0;
    const before = this.shown.length > 1 ? when - this.shown[0][0] : 0;
    const moved = before > 0 && before <= SPEEDS ? difference(last, this.shown[0][1], before) : new Float64Array(size);
    const away = difference(last, target, 1);
    for (let k = 0; k < size; k++) {
      this.x[k] = away[k] + step * speed[k];
      this.v[k] = moved[k] - speed[k];
    }
  }

  decay(time, rate) {
    if (!this.shown.length) return;
    const step = Math.max(0, time - this.shown.at(-1)[0]), left = Math.exp(-rate * step);
    for (let k = 0; k < this.x.length; k++) {
      const pull = this.v[k] + rate * this.x[k];
      this.x[k] = (this.x[k] + pull * step) * left;
      this.v[k] = (this.v[k] - rate * pull * step) * left;
    }
  }
}

/** From one pose to another in some seconds: 3 numbers a joint (axis times angle) and 3 of the root, per second. */
function difference(to, from, seconds) {
  const joints = to.turns.length / 4, out = new Float64Array(3 * joints + 3);
  for (let j = 0; j < joints; j++) {
    const [w, x, y, z] = from.turns.subarray(4 * j, 4 * j + 4);
    out.set(log(multiply(to.turns.subarray(4 * j, 4 * j + 4), [w, -x, -y, -z])).map((one) => one / seconds), 3 * j);
  }
  for (let c = 0; c < 3; c++) out[3 * joints + c] = (to.root[c] - from.root[c]) / seconds;
  return out;
}

function multiply([w, x, y, z], [a, b, c, d]) {
  return [w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c, w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a];
}

function exp([x, y, z]) {
  const angle = Math.hypot(x, y, z), scale = angle > 1e-9 ? Math.sin(angle / 2) / angle : 0.5;
  return [Math.cos(angle / 2), x * scale, y * scale, z * scale];
}

function log([w, x, y, z]) {
  const sine = Math.hypot(x, y, z), sign = w < 0 ? -1 : 1, scale = sine > 1e-9 ? 2 * Math.atan2(sine, Math.abs(w)) / sine : 2;
  return [sign * scale * x, sign * scale * y, sign * scale * z];
}

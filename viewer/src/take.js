// A take: the motion of one performance, frame by frame. Metres, seconds; quaternions are w first.

import { NUMBERS } from "./mouth.js";
import { bytesOf, clamp } from "./numbers.js";

/** Steps of a unit in which quaternions are told. */
const STEPS = 32767;

export class Take {
  /** told: what `gesticulator.export.html.describe` wrote. */
  constructor(told) {
    const steps = new Int16Array(bytesOf(told.rotations).buffer), rotations = new Float32Array(steps.length);
    for (let i = 0; i < steps.length; i++) rotations[i] = steps[i] / told.steps;
    const face = told.face && Float32Array.from(new Int16Array(bytesOf(told.face).buffer), (step) => step / told.steps);
    this.fill({ ...told, rotations, roots: new Float32Array(bytesOf(told.root).buffer), face });
  }

  /** A take of numbers that are there already. */
  static of(parts) { return Object.create(Take.prototype).fill(parts); }

  /** rotations: [T * J * 4]; roots: [T * 3], or [3] for a still root; face: [T * 20] of `mouth.js`, or null. */
  fill({ name, fps, frames, duration, skeleton, rotations, roots, face = null }) {
    Object.assign(this, { name, fps, frames, duration, skeleton, rotations, roots, face });
    this.joints = skeleton.names.length;
    this.rows = new Map(skeleton.names.map((joint, row) => [joint, row]));
    return this;
  }

  /** The take with other frames. header: { range: [first, last + 1], shape, root }; data: their rotations as int16
   *  [T, J, 4], then `root` bytes of float32, the path of the root where it is another one. shape: fps, frames and so on,
   *  where they are others; then the frames are all. */
  patched({ range: [first, last], shape, root = 0 }, data) {
    const joints = (shape ?? this).skeleton.names.length;
    const rotations = shape ? new Float32Array(shape.frames * joints * 4) : this.rotations.slice();
    const steps = new Int16Array(data.buffer, data.byteOffset, (data.length - root) / 2), to = first * joints * 4;
    for (let i = 0; i < (last - first) * joints * 4; i++) rotations[to + i] = steps[i] / STEPS;
    const roots = root ? new Float32Array(data.slice(data.length - root).buffer) : this.roots;
    return Take.of({ ...this, ...(shape ?? {}), name: this.name, rotations, roots });
  }

  has(joint) { return this.rows.has(joint); }
  row(joint) { return this.rows.get(joint) ?? -1; }

  /** The two frames around a time and how far it lies from the first to the second. */
  around(time, frames = this.frames) {
    const x = clamp(time * this.fps, 0, frames - 1), first = Math.floor(x);
    return [first, Math.min(first + 1, frames - 1), x - first];
  }

  /** Local rotations [J * 4] at a time, along the chord between the two nearest frames. */
  poseAt(time, out) {
    const [a, b, share] = this.around(time);
    for (let j = 0; j < this.joints; j++) this.blend(a, b, share, j, out);
    return out;
  }

  blend(a, b, share, j, out) {
    const { rotations, joints } = this, p = (a * joints + j) * 4, q = (b * joints + j) * 4;
    let dot = 0, length = 0;
    for (let c = 0; c < 4; c++) dot += rotations[p + c] * rotations[q + c];
    const sign = dot < 0 ? -1 : 1;
    for (let c = 0; c < 4; c++) {
      const value = rotations[p + c] * (1 - share) + sign * rotations[q + c] * share;
      out[j * 4 + c] = value;
      length += value * value;
    }
    length = Math.sqrt(length) || 1;
    for (let c = 0; c < 4; c++) out[j * 4 + c] /= length;
  }

  rootAt(time, out) {
    const { roots } = this, [a, b, share] = this.around(time, roots.length / 3);
    for (let c = 0; c < 3; c++) out[c] = roots[a * 3 + c] * (1 - share) + roots[b * 3 + c] * share;
    return out;
  }

  /** The numbers of the face at a time; null for a take without one. */
  faceAt(time, out) {
    const { face } = this;
    if (!face) return null;
    const [a, b, share] = this.around(time, face.length / NUMBERS);
    for (let k = 0; k < NUMBERS; k++) out[k] = face[a * NUMBERS + k] * (1 - share) + face[b * NUMBERS + k] * share;
    return out;
  }

  /** Where she stands on the whole: the median of x and z. */
  middle() {
    return [0, 2].map((c) => {
      const values = [];
      for (let i = c; i < this.roots.length; i += 3) values.push(this.roots[i]);
      return values.sort((a, b) => a - b)[values.length >> 1];
    });
  }
}

/** World rotations [J * 4] of local ones: each is its parent's times its own. */
export function worldRotations(parents, local, out) {
  for (let j = 0; j < parents.length; j++) {
    const [w, x, y, z] = [0, 1, 2, 3].map((c) => local[j * 4 + c]);
    if (parents[j] < 0) { out.set([w, x, y, z], j * 4); continue; }
    const [a, b, c, d] = [0, 1, 2, 3].map((k) => out[parents[j] * 4 + k]);
    out[j * 4] = a * w - b * x - c * y - d * z;
    out[j * 4 + 1] = a * x + b * w + c * z - d * y;
    out[j * 4 + 2] = a * y - b * z + c * w + d * x;
    out[j * 4 + 3] = a * z + b * y - c * x + d * w;
  }
  return out;
}

/** A take whose pose at a time is its world rotations too, kept in two buffers. */
export class Poser {
  constructor(take) {
    this.take = take;
    this.local = new Float32Array(take.joints * 4);
    this.world = new Float32Array(take.joints * 4);
    this.root = new Float32Array(3);
    this.numbers = new Float32Array(NUMBERS);
    this.face = null;
  }

  set(time) {
    this.time = time;
    this.take.poseAt(time, this.local);
    worldRotations(this.take.skeleton.parents, this.local, this.world);
    this.take.rootAt(time, this.root);
    this.face = this.take.faceAt(time, this.numbers);
    return this;
  }

  /** Write a joint's world rotation into a three.js quaternion. */
  turn(joint, out) {
    const p = this.take.row(joint) * 4;
    return out.set(this.world[p + 1], this.world[p + 2], this.world[p + 3], this.world[p]);
  }
}

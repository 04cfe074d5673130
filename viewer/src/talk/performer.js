// Who is on the stage of `gesticulator live`: our own figure or a character of the user's, moved by frames as they come.

import { Group } from "three";

import { Figure } from "../figure.js";
import { NUMBERS } from "../mouth.js";
import { Poser, Take, worldRotations } from "../take.js";

const BLEND = 0.35; // seconds from the pose that was shown to those of a new stream
const HIPS = 0.95; // metres that they stand high on the skeleton at rest

/** A take of one pose, of a stream's joints. */
const takeOf = (joints) => Take.of({
  name: "live", fps: 60, frames: 1, duration: 0, rotations: new Float32Array(joints.length * 4), roots: new Float32Array([0, HIPS, 0]),
  skeleton: {
    names: joints.map(({ name }) => name), parents: joints.map(({ parent }) => parent), offsets: joints.map(({ offset }) => offset),
    tips: Object.fromEntries(joints.filter(({ tip }) => tip).map(({ name, tip }) => [name, tip])), height: HIPS,
  },
});

/** Holds the one pose that is shown, as the parts of the viewer read it. */
class LivePoser extends Poser {
  constructor(take) {
    super(take);
    this.root[1] = HIPS;
    for (let j = 0; j < take.joints; j++) this.local[j * 4] = 1;
    this.coming = null;
  }

  /** Go a share of the way to a frame. */
  towards({ turns, root, face }, share) {
    const { local } = this;
    if (!face) this.face = null;
    else {
      this.face ??= Float32Array.from({ length: NUMBERS }, (_, k) => (k ? 0 : 1)); // a shut mouth
      for (let k = 0; k < NUMBERS; k++) this.face[k] += share * (face[k] - this.face[k]);
    }
    for (let p = 0; p < turns.length; p += 4) {
      let dot = 0, length = 0;
      for (let c = 0; c < 4; c++) dot += local[p + c] * turns[p + c];
      for (let c = 0; c < 4; c++) {
        local[p + c] = local[p + c] * (1 - share) + (dot < 0 ? -1 : 1) * share * turns[p + c];
        length += local[p + c] ** 2;
      }
      for (let c = 0; c < 4; c++) local[p + c] /= Math.sqrt(length) || 1;
    }
    for (let c = 0; c < 3; c++) this.root[c] += share * (root[c] - this.root[c]);
    worldRotations(this.take.skeleton.parents, local, this.world);
  }
}

export class LivePerformer {
  constructor(joints) {
    this.group = new Group();
    this.poser = new LivePoser(takeOf(joints));
    this.probe = new LivePoser(this.poser.take);
    this.figure = new Figure(this.poser.take);
    this.group.add(this.figure.group);
    this.character = null;
    this.blend = 1;
  }

  get take() { return this.poser.take; }

  /** Dress as a character; `null` as our own figure. */
  wear(character) {
    if (this.character) this.group.remove(this.character.group);
    this.character = character;
    if (character) this.group.add(character.group);
    this.figure.group.visible = !character;
  }

  /** A frame after `seconds`; the first after `blend = 0` are approached. */
  move(frame, seconds) {
    this.blend = Math.min(1, this.blend + seconds / BLEND);
    this.poser.towards(frame, this.blend < 1 ? 0.2 : 1);
  }

  /** Where the pose that is shown is that of a time of a stream, hands set out early for the frames that have come. */
  expect(stream, time) {
    const frame = (when) => (when < 0 ? undefined : stream.frames.get(Math.floor(when * stream.fps + 1e-6)));
    this.poser.coming = this.blend < 1 ? null : { source: stream, time: Math.min(time, (stream.end - 1) / stream.fps), frame, probe: this.probe };
  }

  paint() { this.figure.paint(); }

  show() { (this.character ?? this.figure).show(this.poser); }
}

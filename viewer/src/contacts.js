// Hands kept out of the trunk of a character, as gesticulator/characters/trunk.py does it: our hand says on which side of
// the trunk the character's belongs, and the arm is bent until it is as far outside (and no farther than MARGIN).

import { Quaternion, Vector3 } from "three";

import { clamp } from "./numbers.js";

/** Metres: within this a hand counts as near, of an arm as long as ours (upper arm and forearm). */
const MARGIN = 0.03, ARM = 0.53;
/** Of our own trunk: half the width, half the depth, from shoulder to shoulder, from hips to head. Metres. */
const OURS = { width: 0.145, depth: 0.115, shoulders: 0.36, height: 0.62 };
/** Directions and slices in which a trunk is measured; slices below 0 are pelvis and thighs. */
const ANGLES = 36, LOWEST = -6, SLICES = 12, OUTER = 0.98, FEWEST = 8, MOST_POINTS = 20000;
/** Metres: of slowing, and how the surface recedes beyond the ends. */
const SOFT = 0.05, CAP = 0.2, RECEDES = 0.5;
const ROUNDS = 12, REACH = 0.999, LEAST = 1e-5, STANDS = 0.85;
/** Share of an arm's length beyond which it is not stretched. */
const STRETCHED = 0.9995;

const directions = [...Array(ANGLES).keys()].map((k) => [Math.cos((k * 2 * Math.PI) / ANGLES), Math.sin((k * 2 * Math.PI) / ANGLES)]);

/** The outline of a column of constant half width and half depth: per height, metres from the line of the bones to the
 *  tangents with normals from left by ahead. */
export function ellipse(width, depth) {
  const row = directions.map(([x, z]) => Math.hypot(width * x, depth * z));
  return { steps: [0, 1], reach: [row, row] };
}

/** The value of rows `values` at rising `steps`, on the straight line; constant beyond the ends. */
function between(x, steps, values) {
  let k = 0;
  while (k < steps.length - 1 && steps[k + 1] < x) k++;
  if (k === steps.length - 1 || x <= steps[0]) return values[x <= steps[0] ? 0 : k];
  return values[k] + ((x - steps[k]) / (steps[k + 1] - steps[k])) * (values[k + 1] - values[k]);
}

/** Metres from the line of the bones to the tangent with a normal [left, ahead], at a height. */
export function support({ steps, reach }, share, [x, z]) {
  const turn = Math.atan2(z, x) / (2 * Math.PI), column = (turn - Math.floor(turn)) * ANGLES;
  const first = Math.floor(column) % ANGLES, on = column - Math.floor(column);
  return between(share, steps, reach.map((row) => (1 - on) * row[first] + on * row[(first + 1) % ANGLES]));
}

/** Along the spine, to the left and ahead, of length 1; and how long the spine is. */
function frame(hips, neck, left) {
  const up = neck.clone().sub(hips), long = Math.max(up.length(), 1e-9);
  up.divideScalar(long);
  const side = left.clone().addScaledVector(up, -left.dot(up)).normalize();
  return { up, long, side, ahead: new Vector3().crossVectors(side, up) };
}

const local = (point, hips, { side, up, ahead }) => {
  const own = point.clone().sub(hips);
  return [own.dot(side), own.dot(up), own.dot(ahead)];
};

/** The normal [left, ahead] of the tangent beyond which a point of the hand belongs, and the metres that it lacks,
 *  softened. our, their: places of our point and of the character's, left, up and ahead of the hips. */
export function limit(our, their, outline, long, size) {
  const { width, depth } = OURS, n = [our[0] / width ** 2, our[2] / depth ** 2], norm = Math.max(Math.hypot(...n), 1e-9);
  const [x, z] = n.map((value) => value / norm), slim = Math.hypot(width * x, depth * z);
  const gap = clamp(x * our[0] + z * our[2] - slim, 0, 2 * MARGIN), reach = support(outline, their[1] / long, [x, z]);
  const beyond = Math.max(outline.steps[0] * long - their[1], their[1] - long, 0) / (CAP * size);
  const near = gap - gap ** 2 / (4 * MARGIN), soft = clamp(reach - size * slim, 1e-6, SOFT * size);
  const lack = reach - size * RECEDES * beyond ** 2 + size * near - (x * their[0] + z * their[2]);
  return { x, z, lack: lack > soft ? lack : clamp(lack + soft, 0, 2 * soft) ** 2 / (4 * soft) };
}

/** The outline of the points of a skin, or null where there are too few. */
function measured(points, hips, neck) {
  const axes = frame(hips, neck, new Vector3(1, 0, 0)), rows = points.map((point) => local(point, hips, axes));
  const rank = (values, share) => {
    const sorted = values.sort((a, b) => a - b), at = share * (sorted.length - 1), low = Math.floor(at);
    return sorted[low] + (at - low) * (sorted[Math.min(low + 1, sorted.length - 1)] - sorted[low]);
  };
  const outline = { steps: [], reach: [] };
  for (let k = LOWEST; k < SLICES; k++) {
    const step = (k + 0.5) / SLICES, near = rows.filter(([, y]) => Math.abs(y / axes.long - step) < 1 / SLICES);
    if (near.length < FEWEST) continue;
    outline.steps.push(step);
    outline.reach.push(directions.map(([a, b]) => rank(near.map(([x, , z]) => a * x + b * z), OUTER)));
  }
  return outline.steps.length ? outline : null;
}

/** Places of a skin's points that move most with one of the nodes `own`, in the pose that it has now. */
function skin(scene, own) {
  const points = [];
  scene.traverse((mesh) => {
    if (!mesh.isSkinnedMesh) return;
    const { position, skinIndex, skinWeight } = mesh.geometry.attributes, every = Math.ceil(position.count / MOST_POINTS);
    for (let i = 0; i < position.count; i += every) {
      let most = 0;
      for (let c = 1; c < 4; c++) if (skinWeight.getComponent(i, c) > skinWeight.getComponent(i, most)) most = c;
      if (!own.has(mesh.skeleton.bones[skinIndex.getComponent(i, most)])) continue;
      points.push(mesh.getVertexPosition(i, new Vector3()).applyMatrix4(mesh.matrixWorld));
    }
  });
  return points;
}

/** Where our joints are from the hips, in a poser's pose. */
function ourPlaces({ take, world }, names) {
  const { parents, offsets } = take.skeleton, turn = new Quaternion();
  const place = (j) => {
    const above = parents[j];
    if (above < 0) return new Vector3();
    turn.set(world[above * 4 + 1], world[above * 4 + 2], world[above * 4 + 3], world[above * 4]);
    const own = new Vector3().fromArray(offsets[j]).applyQuaternion(turn);
    return own.add(place(above));
  };
  return names.filter((name) => take.has(name)).map((name) => place(take.row(name)));
}

export class Contacts {
  /** bones: our joint -> the node that is posed, at rest and facing +Z; trunk: the nodes of hips and spine that the skin
   *  hangs on, thighs: those of the thighs; limbs: those of all other joints. */
  constructor(scene, bones, trunk, limbs, thighs) {
    this.bones = bones;
    const own = new Set(this.stands() ? [...trunk, ...thighs] : trunk), other = new Set(limbs);
    // What hangs on the trunk and is no limb moves with it.
    scene.traverse((node) => { if (!other.has(node) && own.has(node.parent)) own.add(node); });
    const hips = this.place("Hips"), neck = this.place(this.top), points = skin(scene, own);
    this.arm = this.length("Left");
    const size = Math.sqrt((this.place("LeftArm").distanceTo(this.place("RightArm")) / OURS.shoulders) * (hips.distanceTo(this.place("Head")) / OURS.height));
    this.outline = (points.length >= 30 && measured(points, hips, neck)) || ellipse(OURS.width * size, OURS.depth * size);
  }

  /** Whether the thighs hang down, and so continue the column of the trunk. */
  stands() {
    return ["Left", "Right"].every((side) => {
      if (!this.bones.has(`${side}UpLeg`) || !this.bones.has(`${side}Leg`)) return false;
      const thigh = this.place(`${side}Leg`).sub(this.place(`${side}UpLeg`));
      return -thigh.y > STANDS * thigh.length();
    });
  }

  get top() { return this.bones.has("Neck") ? "Neck" : "Head"; }

  place(joint) { return this.bones.get(joint).getWorldPosition(new Vector3()); }

  length(side) {
    const [arm, fore, hand] = ["Arm", "ForeArm", "Hand"].map((part) => this.place(side + part));
    return arm.distanceTo(fore) + fore.distanceTo(hand);
  }

  /** Bend the arms where a hand is nearer than ours, in the pose that the character has now. */
  repair(poser) {
    const { take } = poser;
    if (!["Neck", "Spine3", "LeftHand", "RightHand"].every((joint) => take.has(joint))) return;
    const origin = new Vector3(), [ourNeck] = ourPlaces(poser, ["Neck"]);
    const left = new Vector3(1, 0, 0).applyQuaternion(poser.turn("Spine3", new Quaternion()));
    const hips = this.place("Hips"), ours = frame(origin, ourNeck, left), theirs = frame(hips, this.place(this.top), left);
    for (const side of ["Left", "Right"]) {
      const limits = [`${side}Hand`, `${side}HandMiddle1`].filter((joint) => this.bones.has(joint) && take.has(joint)).map((joint) => {
        const [our] = ourPlaces(poser, [joint]);
        const { x, z, lack } = limit(local(our, origin, ours), local(this.place(joint), hips, theirs), this.outline, theirs.long, this.arm / ARM);
        return { normal: theirs.side.clone().multiplyScalar(x).addScaledVector(theirs.ahead, z), lack };
      });
      const wrist = this.place(`${side}Hand`), push = this.displacement(limits, wrist.clone().sub(this.place(`${side}Arm`)));
      if (push.length() > LEAST) this.bend(side, push.add(wrist));
    }
  }

  /** What brings a hand, `reached` from the shoulder, within all limits and the reach of the arm. */
  displacement(limits, reached) {
    const push = new Vector3(), longest = Math.max(reached.length(), REACH * this.arm);
    for (let round = 0; round < ROUNDS; round++) {
      for (const { normal, lack } of limits) push.addScaledVector(normal, Math.max(lack - push.dot(normal), 0));
      push.add(reached).clampLength(0, longest).sub(reached);
    }
    return push;
  }

  /** Two bones: the hand comes to a place, the elbow stays in its plane, the hand keeps its turn of the world. */
  bend(side, goal) {
    const nodes = ["Arm", "ForeArm", "Hand"].map((part) => this.bones.get(side + part));
    const [socket, hinge, tip] = nodes.map((node) => node.getWorldPosition(new Vector3()));
    const turns = nodes.map((node) => node.getWorldQuaternion(new Quaternion()));
    const upper = hinge.clone().sub(socket), lower = tip.clone().sub(hinge), a = upper.length(), b = lower.length();
    const along = goal.clone().sub(socket), far = clamp(along.length(), Math.abs(a - b) / STRETCHED + 1e-9, STRETCHED * (a + b));
    along.normalize();
    // The law of cosines: how far along the way the elbow lies, and how far beside it.
    const share = (a * a + far * far - b * b) / (2 * far), beside = Math.sqrt(Math.max(a * a - share * share, 0));
    const out = upper.clone().addScaledVector(along, -upper.dot(along));
    if (out.length() < 1e-4 * a) out.set(0, -1, -0.5).addScaledVector(along, along.y + 0.5 * along.z);
    const newUpper = along.clone().multiplyScalar(share).addScaledVector(out.normalize(), beside);
    const newLower = along.multiplyScalar(far).sub(newUpper);
    [[upper, newUpper], [lower, newLower]].forEach(([before, after], k) => {
      turns[k].premultiply(new Quaternion().setFromUnitVectors(before.normalize(), after.normalize()));
    });
    nodes.forEach((node, k) => {
      const above = node.parent.getWorldQuaternion(new Quaternion());
      node.quaternion.copy(above.invert().multiply(turns[k]));
    });
  }
}

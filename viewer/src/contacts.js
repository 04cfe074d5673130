// Hands kept out of a trunk that is wider than ours, as gesticulator/characters/contacts.py does it: where a hand of the
// character would be nearer to the trunk than ours is to ours, the arm is bent until it is as far outside (and no farther
// than MARGIN).

import { Quaternion, Vector3 } from "three";

import { clamp } from "./numbers.js";

/** Metres: within this a hand counts as near, of an arm as long as ours (upper arm and forearm). */
const MARGIN = 0.03, ARM = 0.53;
/** Of our own trunk: half the width, half the depth, from shoulder to shoulder, from hips to head. Metres. */
const OURS = { width: 0.145, depth: 0.115, shoulders: 0.36, height: 0.62 };
const SLICES = 12, OUTER = 0.98, FEWEST = 8, STEPS = 5, MOST_POINTS = 20000;
/** Share of an arm's length beyond which it is not stretched. */
const STRETCHED = 0.9995;

const plain = (width, depth) => ({ steps: [0, 1], width: [width, width], depth: [depth, depth], ahead: [0, 0] });

/** The value of rows `values` at rising `steps`, on the straight line; constant beyond the ends. */
function between(x, steps, values) {
  let k = 0;
  while (k < steps.length - 1 && steps[k + 1] < x) k++;
  if (k === steps.length - 1 || x <= steps[0]) return values[x <= steps[0] ? 0 : k];
  return values[k] + ((x - steps[k]) / (steps[k + 1] - steps[k])) * (values[k + 1] - values[k]);
}

/** Along the spine, to her left and ahead, of length 1; and how long the spine is. */
function frame(hips, neck, left) {
  const up = neck.clone().sub(hips), long = Math.max(up.length(), 1e-9);
  up.divideScalar(long);
  const side = left.clone().addScaledVector(up, -left.dot(up)).normalize();
  return { up, long, side, ahead: new Vector3().crossVectors(side, up) };
}

/** Metres of a point from an elliptic column (negative inside) and the way out. */
export function outside(trunk, point, hips, neck, left) {
  const { up, long, side, ahead } = frame(hips, neck, left), own = point.clone().sub(hips);
  const along = own.dot(up), nearest = clamp(along, 0, long), share = nearest / long;
  const [wide, deep, before] = [trunk.width, trunk.depth, trunk.ahead].map((row) => between(share, trunk.steps, row));
  // Exactly 0 between the ends: a remainder of rounding would take a point deep inside for one on the end's surface.
  const x = own.dot(side), z = own.dot(ahead) - before, beyond = Math.abs(along - nearest);
  const radius = Math.hypot(x, z), angle = Math.atan2(z, x);
  const surface = (wide * deep) / Math.hypot(deep * Math.cos(angle), wide * Math.sin(angle));
  return {
    gap: beyond > 0 ? Math.hypot(Math.max(radius - surface, 0), beyond) : radius - surface,
    way: side.multiplyScalar(Math.cos(angle)).addScaledVector(ahead, Math.sin(angle)),
  };
}

/** The column around the points of a skin, or null where there are too few. */
function measured(points, hips, neck) {
  const { up, long, side, ahead } = frame(hips, neck, new Vector3(1, 0, 0));
  const rows = points.map((point) => point.sub(hips)).map((own) => [own.dot(up) / long, own.dot(side), own.dot(ahead)]);
  const rank = (values, share) => {
    const sorted = values.sort((a, b) => a - b);
    return between(share * (sorted.length - 1), [...sorted.keys()], sorted);
  };
  const trunk = { steps: [], width: [], depth: [], ahead: [] };
  for (let k = 0; k < SLICES; k++) {
    const step = (k + 0.5) / SLICES, near = rows.filter(([share]) => Math.abs(share - step) < 1 / SLICES);
    if (near.length < FEWEST) continue;
    const depths = near.map(([, , z]) => z), back = rank(depths, 1 - OUTER), front = rank(depths, OUTER);
    trunk.steps.push(step);
    trunk.width.push(Math.max(rank(near.map(([, x]) => Math.abs(x)), OUTER), 0.02));
    trunk.depth.push(Math.max((front - back) / 2, 0.02));
    trunk.ahead.push((front + back) / 2);
  }
  return trunk.steps.length ? trunk : null;
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
  /** bones: our joint -> the node that is posed, at rest and facing +Z; trunk: the nodes of hips and spine that her skin
   *  hangs on; limbs: those of all other joints. */
  constructor(scene, bones, trunk, limbs) {
    this.bones = bones;
    const own = new Set(trunk), other = new Set(limbs);
    // What hangs on the trunk and is no limb moves with it.
    scene.traverse((node) => { if (!other.has(node) && own.has(node.parent)) own.add(node); });
    const hips = this.place("Hips"), neck = this.place(this.top), points = skin(scene, own);
    this.arm = this.length("Left");
    const size = Math.sqrt((this.place("LeftArm").distanceTo(this.place("RightArm")) / OURS.shoulders) * (hips.distanceTo(this.place("Head")) / OURS.height));
    this.trunk = (points.length >= 30 && measured(points, hips, neck)) || plain(OURS.width * size, OURS.depth * size);
  }

  get top() { return this.bones.has("Neck") ? "Neck" : "Head"; }

  place(joint) { return this.bones.get(joint).getWorldPosition(new Vector3()); }

  length(side) {
    const [arm, fore, hand] = ["Arm", "ForeArm", "Hand"].map((part) => this.place(side + part));
    return arm.distanceTo(fore) + fore.distanceTo(hand);
  }

  /** Bend the arms where a hand is nearer than ours, in the pose that she has now. */
  repair(poser) {
    const { take } = poser;
    if (!["Neck", "Spine3", "LeftHand", "RightHand"].every((joint) => take.has(joint))) return;
    const ours = plain(OURS.width, OURS.depth), [ourNeck] = ourPlaces(poser, ["Neck"]);
    const left = new Vector3(1, 0, 0).applyQuaternion(poser.turn("Spine3", new Quaternion()));
    const hips = this.place("Hips"), neck = this.place(this.top), size = this.arm / ARM;
    for (const side of ["Left", "Right"]) {
      const tips = [`${side}Hand`, `${side}HandMiddle1`], origin = new Vector3();
      const near = Math.min(...ourPlaces(poser, tips).map((point) => outside(ours, point, origin, ourNeck, left).gap));
      const wanted = Math.min(near, MARGIN) * size;
      for (let step = 0; step < STEPS; step++) {
        let most = 1e-5, push = null;
        for (const tip of tips.filter((joint) => this.bones.has(joint))) {
          const { gap, way } = outside(this.trunk, this.place(tip), hips, neck, left);
          if (wanted - gap > most) {
            most = wanted - gap;
            push = way.multiplyScalar(most);
          }
        }
        if (!push) break;
        this.bend(side, push.add(this.place(`${side}Hand`)));
      }
    }
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

// Hands kept out of the trunk of a character, as gesticulator/characters/trunk.py does it: our hand says on which side of
// the trunk the character's belongs, and the arm is bent until it is as far outside (and no farther than MARGIN). Where
// the frames to come are known, a hand sets out early, as in gesticulator/characters/detours.py: of a few tenths of a
// second around the moment that is shown. The hands of a character that sits are kept above its thighs too (thighs.js).

import { Quaternion, Vector3 } from "three";

import { clamp } from "./numbers.js";
import { ANGLES, directions, ellipse, rowAt, support } from "./outline.js";
import { Poser } from "./take.js";
import { FINGERTIPS, OUR_RADII, THIGH_SLICES, depthIn, isLevel, marginAbove, tapering, thighAxes, thighOf } from "./thighs.js";

/** Metres: within this a hand counts as near, of an arm as long as ours (upper arm and forearm). */
const MARGIN = 0.03, ARM = 0.53;
/** Of our own trunk: half the width, half the depth, from shoulder to shoulder, from hips to head. Metres. */
const OURS = { width: 0.145, depth: 0.115, shoulders: 0.36, height: 0.62 };
/** Radians by which thighs that stand may be ahead of where they hang at rest: knees give, and weight shifts. */
const FLEXED = 0.25;
/** Slices in which a trunk is measured; those below 0 are pelvis and thighs. */
const LOWEST = -6, SLICES = 12, OUTER = 0.98, FEWEST = 8, LEAST_POINTS = 30, MOST_POINTS = 20000;
/** Points of a trunk below which its triangles are measured too, at points that divide their edges by so many. */
const SPARSE = 1000, FINE = 8;
/** Metres: of slowing, and how the surface recedes beyond the ends. */
const SOFT = 0.05, CAP = 0.2, RECEDES = 0.5;
const SIDES = ["Left", "Right"];
const ROUNDS = 12, REACH = 0.999, LEAST = 1e-5, STANDS = 0.85;
/** Share of an arm's length beyond which it is not stretched. */
const STRETCHED = 0.9995;

/** Moments per second that are looked at, and how many before and after the one shown: three of the deviations below. */
const HZ = 30, AROUND = 18;
/** Seconds over which a displacement is spread (standard deviation), in so many turns; seconds around a moment whose
 *  fastest is the pace of the hand; metres per second below which none is hasty; projections in a turn. */
const AHEAD = 0.2, TURNS = 16, NEAR = 0.1, SLOW = 0.3, PROJECTIONS = 3;
/** Moments that are kept of a take. */
const MOST_KEPT = 4000;

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
  const margin = size * (gap - gap ** 2 / (4 * MARGIN)), soft = clamp(reach - size * slim, 1e-6, SOFT * size);
  const lack = reach - receding(their[1], long, outline, size) + margin - (x * their[0] + z * their[2]);
  return { x, z, margin, lack: lack > soft ? lack : clamp(lack + soft, 0, 2 * soft) ** 2 / (4 * soft) };
}

/** Weights of a Gaussian over neighbours, its middle first. */
function gaussian(width) {
  const weights = [...Array(Math.ceil(4 * width) + 1).keys()].map((k) => Math.exp(-0.5 * (k / width) ** 2));
  const sum = 2 * weights.reduce((a, b) => a + b) - weights[0];
  return weights.map((weight) => weight / sum);
}

/** Rows of numbers, each the mean of its neighbours; the ends go on. */
function smoothed(rows, weights) {
  const last = rows.length - 1;
  return rows.map((row, t) => row.map((value, c) => {
    let sum = weights[0] * value;
    for (let k = 1; k < weights.length; k++) sum += weights[k] * (rows[Math.max(t - k, 0)][c] + rows[Math.min(t + k, last)][c]);
    return sum;
  }));
}

/** The largest of each number and its `reach` neighbours on both sides. */
const largest = (values, reach) => values.map((_, t) => Math.max(...values.slice(Math.max(t - reach, 0), t + reach + 1)));

/** Metres that rows [x, y, z] move from one to the next, by central differences. */
const speeds = (rows) => rows.map((_, t) => {
  const a = Math.max(t - 1, 0), b = Math.min(t + 1, rows.length - 1);
  return b > a ? Math.hypot(...rows[b].map((value, c) => value - rows[a][c])) / (b - a) : 0;
});

const plus = (a, b, share = 1) => a.map((value, c) => value + share * b[c]);

/** Metres by which the surface recedes at a height, above or below a trunk of a length. */
function receding(height, long, outline, size) {
  const beyond = Math.max(outline.steps[0] * long - height, height - long, 0) / (CAP * size);
  return size * RECEDES * beyond ** 2;
}

/** A displacement [x, y, z] of a hand, and what it lacks so that all points of the hand are outside of the trunk. */
function outside(push, moment, { outline, size }) {
  const { points, side, up, ahead, long, thighs } = moment;
  let out = push;
  for (const { place, margin, margins } of points) {
    const [x, y, z] = place;
    const across = x + dot(out, side), high = y + dot(out, up), along = z + dot(out, ahead);
    const row = rowAt(outline, high / long);
    let gap = -Infinity, nearest = 0;
    for (let k = 0; k < ANGLES; k++) {
      const value = directions[k][0] * across + directions[k][1] * along - row[k];
      if (value > gap) [gap, nearest] = [value, k];
    }
    const lack = margin - gap - receding(high, long, outline, size), [a, b] = directions[nearest];
    if (lack > 0) out = out.map((value, c) => value + lack * (a * side[c] + b * ahead[c]));
    if (thighs) out = above(out, place, thighs, margins, moment);
  }
  return out;
}

/** A displacement, and what it lacks so that a point, at a place left, up and ahead of the hips, is above the thighs. */
function above(push, place, thighs, margins, { side, up, ahead }) {
  const world = side.map((value, c) => place[0] * value + place[1] * up[c] + place[2] * ahead[c]);
  let out = push;
  thighs.forEach((thigh, k) => {
    const found = depthIn(thigh, plus(world, out), margins[k]), lack = found.depth + margins[k];
    if (lack > 0) out = plus(out, found.up, lack);
  });
  return out;
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** Displacements [[x, y, z]] of a hand spread over time. moments: { reached: the wrist from its shoulder, points: [{ place:
 *  [left, up, ahead] of the hips, margin: metres that it belongs outside, margins: above each thigh }], side, up, ahead,
 *  long: axes and length of the trunk, thighs: where it sits }; trunk: { outline, size: of an arm, of ours }. */
export function spread(pushes, moments, trunk, fps) {
  const weights = gaussian((AHEAD * fps) / Math.sqrt(TURNS)), reached = moments.map((moment) => moment.reached);
  const calm = smoothed(reached, weights), pace = largest(speeds(reached), Math.round(NEAR * fps));
  const longest = reached.map((row) => Math.max(Math.hypot(...row), REACH * ARM * trunk.size));
  let out = pushes;
  for (let turn = 0; turn < TURNS; turn++) {
    const fast = speeds(out.map((push, t) => plus(reached[t], push)));
    const hasty = smoothed(largest(fast.map((speed, t) => clamp(speed / Math.max(pace[t], SLOW / fps) - 1, 0, 1)),
      Math.round(AHEAD * fps)).map((value) => [value]), weights);
    out = smoothed(out, weights).map((push, t) => {
      let next = plus(push, plus(calm[t], reached[t], -1), hasty[t][0]);
      for (let k = 0; k < PROJECTIONS; k++) {
        const far = plus(reached[t], next), length = Math.max(Math.hypot(...far), 1e-9);
        next = plus(far.map((value) => value * Math.min(longest[t] / length, 1)), reached[t], -1);
        next = outside(next, moments[t], trunk);
      }
      return next;
    });
  }
  return out;
}

/** The outline of the points of a skin, rows [across, along, out] from where a column of a length begins, or null where
 *  there are too few. slices: the first, the one after the last, and how many from end to end; ahead: radians by which
 *  those below 0 may be farther ahead. */
function measured(rows, length, [first, end, count], ahead = 0) {
  const rank = (values, share) => {
    const sorted = values.sort((a, b) => a - b), at = share * (sorted.length - 1), low = Math.floor(at);
    return sorted[low] + (at - low) * (sorted[Math.min(low + 1, sorted.length - 1)] - sorted[low]);
  };
  const outline = { steps: [], reach: [] };
  for (let k = first; k < end; k++) {
    const step = (k + 0.5) / count, near = rows.filter(([, y]) => Math.abs(y / length - step) < 1 / count);
    if (near.length < FEWEST) continue;
    outline.steps.push(step);
    const more = ahead * length * Math.max(-step, 0);
    outline.reach.push(directions.map(([a, b]) => rank(near.map(([x, , z]) => a * x + b * z), OUTER) + more * Math.max(b, 0)));
  }
  return outline.steps.length ? outline : null;
}

/** Places of a skin's points that move most with one of the nodes `own`, in the pose that it has now; of few, points over
 *  the triangles too, where such nodes have half of the weight. */
function skin(scene, own) {
  const points = [], meshes = [], triangles = [];
  scene.traverse((mesh) => { if (mesh.isSkinnedMesh) meshes.push(mesh); });
  for (const mesh of meshes) {
    const { position, skinIndex, skinWeight } = mesh.geometry.attributes, every = Math.ceil(position.count / MOST_POINTS);
    for (let i = 0; i < position.count; i += every) {
      let most = 0;
      for (let c = 1; c < 4; c++) if (skinWeight.getComponent(i, c) > skinWeight.getComponent(i, most)) most = c;
      if (own.has(mesh.skeleton.bones[skinIndex.getComponent(i, most)])) points.push(placeOf(mesh, i));
    }
  }
  if (points.length >= SPARSE) return points;
  for (const mesh of meshes) triangles.push(...surface(mesh, own));
  return [...points, ...triangles];
}

const placeOf = (mesh, vertex) => mesh.getVertexPosition(vertex, new Vector3()).applyMatrix4(mesh.matrixWorld);

/** Points evenly over the triangles of a mesh, where the nodes `own` have half of the weight. */
function surface(mesh, own) {
  const { attributes: { position, skinIndex, skinWeight }, index } = mesh.geometry, out = [];
  const share = [...Array(position.count).keys()].map((i) => [0, 1, 2, 3].reduce((sum, c) => (
    sum + (own.has(mesh.skeleton.bones[skinIndex.getComponent(i, c)]) ? skinWeight.getComponent(i, c) : 0)), 0));
  for (let f = 0; f + 2 < (index ?? position).count; f += 3) {
    const corners = [f, f + 1, f + 2].map((k) => (index ? index.getX(k) : k)), shares = corners.map((corner) => share[corner]);
    if (Math.max(...shares) < 0.5) continue;
    const places = corners.map((corner) => placeOf(mesh, corner));
    for (let a = 0; a <= FINE; a++) {
      for (let b = 0; a + b <= FINE; b++) {
        const parts = [a, b, FINE - a - b].map((part) => part / FINE);
        if (dot(parts, shares) < 0.5 - 1e-9) continue;
        out.push(places.reduce((sum, place, k) => sum.addScaledVector(place, parts[k]), new Vector3()));
      }
    }
  }
  return out;
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

/** Our own thighs where the body of the take sits, or null. */
function ourSeat(poser) {
  const ends = ["UpLeg", "Leg"].map((part) => ourPlaces(poser, SIDES.map((side) => side + part)).map((place) => place.toArray()));
  if (ends.some((places) => places.length < SIDES.length)) return null;
  const [hips, knees] = ends;
  return hips.every((hip, k) => isLevel(hip, knees[k])) ? hips.map((hip, k) => thighOf(hip, knees[k], tapering(...OUR_RADII))) : null;
}

/** The last moment of a take. */
const lastOf = (take) => Math.max(Math.floor(((take.frames - 1) / take.fps) * HZ), 0);

/** Whether two takes have the same pose at a time, wherever it stands. */
function isSame(a, b, time) {
  if (a.fps !== b.fps || a.joints !== b.joints || a.frames !== b.frames) return false;
  const [first, second] = a.around(time), begin = first * a.joints * 4, end = (second + 1) * a.joints * 4;
  for (let k = begin; k < end; k++) if (a.rotations[k] !== b.rotations[k]) return false;
  return true;
}

/** Whether a take has the joints that say where a hand belongs. */
const knows = (take) => ["Neck", "Spine3", "LeftHand", "RightHand"].every((joint) => take.has(joint));

export class Contacts {
  /** bones: our joint -> the node that is posed, at rest and facing +Z; trunk: the nodes of hips and spine that the skin
   *  hangs on, thighs: those of the thighs; limbs: those of all other joints. */
  constructor(scene, bones, trunk, limbs, thighs) {
    this.bones = bones;
    const stands = this.stands(), own = new Set(stands ? [...trunk, ...thighs] : trunk), other = new Set(limbs);
    // What hangs on the trunk and is no limb moves with it.
    scene.traverse((node) => { if (!other.has(node) && own.has(node.parent)) own.add(node); });
    const hips = this.place("Hips"), neck = this.place(this.top), points = skin(scene, own);
    this.arm = this.length("Left");
    Object.assign(this, { scene, thighs, limbs: other });
    const size = this.size = Math.sqrt((this.place("LeftArm").distanceTo(this.place("RightArm")) / OURS.shoulders) * (hips.distanceTo(this.place("Head")) / OURS.height));
    const axes = frame(hips, neck, new Vector3(1, 0, 0)), rows = points.map((point) => local(point, hips, axes));
    this.outline = (points.length >= LEAST_POINTS && measured(rows, axes.long, [LOWEST, SLICES, SLICES], stands ? FLEXED : 0)) || ellipse(OURS.width * size, OURS.depth * size);
  }

  /** The thighs of a character that sits in the pose that it has now, from its hips; null where it does not. */
  seatedThighs() {
    if (!SIDES.every((side) => this.bones.has(`${side}UpLeg`) && this.bones.has(`${side}Leg`))) return null;
    const hips = this.place("Hips"), ends = SIDES.map((side) => [this.place(`${side}UpLeg`), this.place(`${side}Leg`)]);
    if (!ends.every(([hip, knee]) => isLevel(hip.toArray(), knee.toArray()))) return null;
    this.thighOutlines ??= ends.map(([hip, knee]) => this.thighOutline(hip, knee) ?? tapering(...OUR_RADII.map((radius) => radius * this.size)));
    return ends.map(([hip, knee], k) => thighOf(hip.sub(hips).toArray(), knee.sub(hips).toArray(), this.thighOutlines[k]));
  }

  /** The outline of the skin of the thigh between two joints, in the pose that it has now. */
  thighOutline(hip, knee) {
    const far = (node) => node.getWorldPosition(new Vector3()).distanceTo(hip);
    const own = new Set([...this.thighs].sort((a, b) => far(a) - far(b)).slice(0, 1));
    this.scene.traverse((node) => { if (!this.limbs.has(node) && own.has(node.parent)) own.add(node); }); // twist bones
    const points = own.size ? skin(this.scene, own) : [];
    if (points.length < LEAST_POINTS) return null;
    const { left, up, along, length } = thighAxes(hip.toArray(), knee.toArray()), from = hip.toArray();
    const rows = points.map((point) => plus(point.toArray(), from, -1)).map((way) => [dot(way, left), dot(way, along), dot(way, up)]);
    return measured(rows, length, THIGH_SLICES);
  }

  /** Whether the thighs hang down, and so continue the column of the trunk. */
  stands() {
    return SIDES.every((side) => {
      if (!this.bones.has(`${side}UpLeg`) || !this.bones.has(`${side}Leg`)) return false;
      const thigh = this.place(`${side}Leg`).sub(this.place(`${side}UpLeg`));
      return -thigh.y > STANDS * thigh.length();
    });
  }

  get trunk() { return { outline: this.outline, size: this.arm / ARM }; }

  get top() { return this.bones.has("Neck") ? "Neck" : "Head"; }

  place(joint) { return this.bones.get(joint).getWorldPosition(new Vector3()); }

  length(side) {
    const [arm, fore, hand] = ["Arm", "ForeArm", "Hand"].map((part) => this.place(side + part));
    return arm.distanceTo(fore) + fore.distanceTo(hand);
  }

  /** Look at the moments around the one that is to be shown, for which `pose` poses the character; of frames that come one
   *  by one, at those that have come (`coming`). Without a time, none are known. */
  foresee({ take, time, coming }, pose) {
    if (coming && knows(take)) this.follow(coming, take, pose);
    if (time === undefined || !knows(take)) return;
    if (this.seen?.take !== take || this.seen.outline !== this.outline || this.seen.moments.size > MOST_KEPT) {
      const kept = this.seen?.outline === this.outline ? [...this.seen.moments].filter(([k]) => isSame(this.seen.take, take, k / HZ)) : [];
      this.seen = { take, outline: this.outline, poser: null, moments: new Map(kept.length > MOST_KEPT ? [] : kept), pushes: new Map() };
    }
    const { moments } = this.seen, last = lastOf(take), at = clamp(Math.floor(time * HZ), 0, last);
    for (let k = at - AROUND; k <= at + 1 + AROUND; k++) {
      const moment = clamp(k, 0, last);
      if (moments.has(moment)) continue;
      this.seen.poser ??= new Poser(take);
      pose(this.seen.poser.set(moment / HZ));
      moments.set(moment, this.moment(this.seen.poser));
    }
  }

  /** Look at the frames of a stream (`source`) around the one that is to be shown. time: of that, seconds; frame: of a time,
   *  where it has come and was not let go of; probe: a poser for them. */
  follow({ source, time, frame, probe }, take, pose) {
    if (this.live?.source !== source || this.live.take !== take || this.live.outline !== this.outline) this.live = { source, take, outline: this.outline, moments: new Map() };
    const { moments } = this.live, at = Math.floor(time * HZ);
    for (const k of moments.keys()) if (k < at - AROUND || k > at + 1 + AROUND) moments.delete(k);
    for (let k = at - AROUND; k <= at + 1 + AROUND; k++) {
      const known = frame(k / HZ);
      if (!known || moments.get(k)?.frame === known) continue; // an interruption takes frames back
      probe.towards(known, 1);
      pose(probe);
      moments.set(k, { frame: known, ...this.moment(probe) });
    }
  }

  /** Side -> the displacement of its hand at a time of a stream, spread over the moments around it that are known. The last
   *  known one stands for those to come. */
  followed({ time }) {
    const known = [...this.live.moments].sort(([a], [b]) => a - b);
    if (!known.length) return null;
    const momentAt = (k) => (known.findLast(([number]) => number <= k) ?? known[0])[1];
    return this.between(time, (k) => this.solved([...Array(2 * AROUND + 1).keys()].map((j) => momentAt(k + j - AROUND))));
  }

  /** Side -> the displacement of its hand at a time, spread over the moments around it. */
  foreseen({ take, time }) {
    const { moments, pushes } = this.seen, last = lastOf(take);
    return this.between(time, (number) => {
      const k = clamp(number, 0, last);
      if (!pushes.has(k)) pushes.set(k, this.solved([...Array(2 * AROUND + 1).keys()].map((j) => moments.get(clamp(k + j - AROUND, 0, last)))));
      return pushes.get(k);
    });
  }

  /** Side -> the displacement of its hand in the middle one of moments. */
  solved(around) {
    return Object.fromEntries(SIDES.map((side) => {
      const hand = around.map((moment) => moment[side]), bare = hand.map((moment) => moment.push);
      return [side, bare.some((push) => Math.hypot(...push) > LEAST) ? spread(bare, hand, this.trunk, HZ)[AROUND] : bare[AROUND]];
    }));
  }

  /** Side -> the displacement at a time, of those at the moments before and after it. */
  between(time, solved) {
    const at = Math.floor(time * HZ), share = time * HZ - at, [one, other] = [solved(at), solved(at + 1)];
    return Object.fromEntries(SIDES.map((side) => [side, plus(one[side].map((value) => value * (1 - share)), other[side], share)]));
  }

  /** Side -> { push: what its hand lacks in the pose that the character has now, and what `spread` needs }. */
  moment(poser) {
    const { take } = poser, origin = new Vector3(), [ourNeck] = ourPlaces(poser, ["Neck"]);
    const left = new Vector3(1, 0, 0).applyQuaternion(poser.turn("Spine3", new Quaternion()));
    const hips = this.place("Hips"), ours = frame(origin, ourNeck, left), theirs = frame(hips, this.place(this.top), left);
    const thighs = this.seatedThighs(), ourThighs = thighs && ourSeat(poser);
    const [across, up, ahead] = [theirs.side, theirs.up, theirs.ahead].map((axis) => axis.toArray());
    return Object.fromEntries(SIDES.map((side) => {
      const points = [], limits = [], parts = ["Hand", "HandMiddle1", ...(thighs ? FINGERTIPS : [])].map((part) => side + part);
      for (const joint of parts.filter((name) => this.bones.has(name) && take.has(name))) {
        const [our] = ourPlaces(poser, [joint]), place = this.place(joint), their = local(place, hips, theirs);
        const point = { place: their, margin: -Infinity };
        if (/Hand(Middle1)?$/.test(joint)) {
          const { x, z, lack, margin } = limit(local(our, origin, ours), their, this.outline, theirs.long, this.trunk.size);
          point.margin = margin;
          limits.push({ normal: theirs.side.clone().multiplyScalar(x).addScaledVector(theirs.ahead, z), lack });
        }
        if (thighs) point.margins = thighs.map((_, k) => this.trunk.size * marginAbove(ourThighs?.[k], our.toArray()));
        thighs?.forEach((thigh, k) => {
          const found = depthIn(thigh, place.clone().sub(hips).toArray());
          limits.push({ normal: new Vector3(...found.up), lack: found.depth + point.margins[k] });
        });
        points.push(point);
      }
      const reached = this.place(`${side}Hand`).sub(this.place(`${side}Arm`)), push = this.displacement(limits, reached);
      return [side, { push: push.toArray(), reached: reached.toArray(), points, side: across, up, ahead, long: theirs.long, thighs }];
    }));
  }

  /** Bend the arms where a hand is nearer than ours, in the pose that the character has now; as foreseen, where the take
   *  was looked at. */
  repair(poser) {
    const { take, time, coming } = poser;
    if (!knows(take)) return;
    const known = time !== undefined && this.seen?.take === take ? this.foreseen(poser) : null;
    const foreseen = coming && this.live?.take === take ? this.followed(coming) : known, now = foreseen ? null : this.moment(poser);
    for (const side of SIDES) {
      const push = new Vector3(...(foreseen?.[side] ?? now[side].push));
      if (push.length() > LEAST) this.bend(side, push.add(this.place(`${side}Hand`)));
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

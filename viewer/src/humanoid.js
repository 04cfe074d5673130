// The bones of the VRM humanoid and our joints whose world rotations they take; both rest in a T-pose, facing +Z.
// Our four joints of the spine become `spine` and `chest`; `upperChest` is left alone, since a character may lack it.

import { Quaternion } from "three";

/** Bone -> the bone above it, our joints that it takes (of two: halfway between them), the joint where it begins. */
export const BONES = {
  hips: [null, ["Hips"], "Hips"],
  spine: ["hips", ["Spine", "Spine1"], "Spine"],
  chest: ["spine", ["Spine3"], "Spine2"],
  neck: ["chest", ["Neck"], "Neck"],
  head: ["neck", ["Head"], "Head"],
};
const LIMBS = [["Shoulder", "Shoulder", "chest"], ["UpperArm", "Arm", "Shoulder"], ["LowerArm", "ForeArm", "UpperArm"],
  ["Hand", "Hand", "LowerArm"], ["UpperLeg", "UpLeg", "hips"], ["LowerLeg", "Leg", "UpperLeg"], ["Foot", "Foot", "LowerLeg"],
  ["Toes", "ToeBase", "Foot"]];
const FINGERS = { Thumb: ["Thumb", "Metacarpal", "Proximal", "Distal"] };
for (const [theirs, ours] of [["Index", "Index"], ["Middle", "Middle"], ["Ring", "Ring"], ["Little", "Pinky"]]) {
  FINGERS[ours] = [theirs, "Proximal", "Intermediate", "Distal"];
}
for (const side of ["left", "right"]) {
  const ours = side === "left" ? "Left" : "Right";
  for (const [bone, joint, above] of LIMBS) {
    BONES[side + bone] = [BONES[above] ? above : side + above, [ours + joint], ours + joint];
  }
  for (const [finger, [theirs, ...parts]] of Object.entries(FINGERS)) {
    let above = `${side}Hand`;
    for (const [place, part] of parts.entries()) {
      const bone = side + theirs + part, joint = `${ours}Hand${finger}${place + 1}`;
      BONES[bone] = [above, [joint], joint];
      above = bone;
    }
  }
}

/** The bones that a take moves, those above first: [{ bone, above, joints, joint }]; `has` tells which there are. */
export function bonesOf(take, has = () => true) {
  const rows = [], there = new Set();
  for (const [bone, [parent, joints, joint]] of Object.entries(BONES)) {
    if (!joints.every((name) => take.has(name)) || !has(bone)) continue;
    let above = parent;
    while (above && !there.has(above)) [above] = BONES[above];
    there.add(bone);
    rows.push({ bone, above, joints, joint });
  }
  // A character without a chest bends at the spine as the chest would.
  const spine = rows.find((row) => row.bone === "spine");
  if (spine && !there.has("chest")) spine.joints = ["Spine3"];
  return rows;
}

/** Give each bone's local rotation, `use(bone, quaternion)`, of a poser at its time. */
export function humanoidPose(rows, poser, use) {
  const world = new Map(), other = new Quaternion();
  for (const { bone, above, joints } of rows) {
    const turn = poser.turn(joints[0], new Quaternion());
    if (joints.length > 1) turn.slerp(poser.turn(joints[1], other), 0.5);
    world.set(bone, turn);
    use(bone, above ? other.copy(world.get(above)).invert().multiply(turn) : turn);
  }
}

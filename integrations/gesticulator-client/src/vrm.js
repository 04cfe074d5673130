// Poses on a VRM character of @pixiv/three-vrm. Both rest in a T-pose; the stream and a VRM 1.0 face +Z, a VRM 0.x faces -Z.

import { showFace } from "./face.js";

/** Bone of the humanoid -> the bone above it, and our joint whose world rotation it takes. */
export const BONES = { hips: [null, "Hips"], spine: ["hips", "Spine1"], chest: ["spine", "Spine3"], neck: ["chest", "Neck"], head: ["neck", "Head"] };
const PARTS = [["Shoulder", "Shoulder", "chest"], ["UpperArm", "Arm", "Shoulder"], ["LowerArm", "ForeArm", "UpperArm"], ["Hand", "Hand", "LowerArm"],
  ["UpperLeg", "UpLeg", "hips"], ["LowerLeg", "Leg", "UpperLeg"], ["Foot", "Foot", "LowerLeg"], ["Toes", "ToeBase", "Foot"]];
const FINGERS = [["Thumb", "Thumb"], ["Index", "Index"], ["Middle", "Middle"], ["Ring", "Ring"], ["Little", "Pinky"]];
for (const [side, ours] of [["left", "Left"], ["right", "Right"]]) {
  for (const [bone, joint, above] of PARTS) BONES[side + bone] = [BONES[above] ? above : side + above, ours + joint];
  for (const [finger, joint] of FINGERS) {
    let above = `${side}Hand`;
    const places = finger === "Thumb" ? ["Metacarpal", "Proximal", "Distal"] : ["Proximal", "Intermediate", "Distal"];
    for (const [number, place] of places.entries()) {
      BONES[side + finger + place] = [above, `${ours}Hand${joint}${number + 1}`];
      above = side + finger + place;
    }
  }
}

export class VrmDriver {
  /** joints: of the stream's welcome. vrm: as three-vrm loads it. lipsOnly: of a face, show the lips alone. */
  constructor(joints, vrm, { lipsOnly = false } = {}) {
    this.vrm = vrm;
    this.lipsOnly = lipsOnly;
    this.faces = vrm.meta?.metaVersion === "0" ? -1 : 1;
    this.parents = joints.map(({ parent }) => parent);
    this.world = joints.map(() => [1, 0, 0, 0]);
    const names = new Map(joints.map(({ name }, number) => [name, number])), found = new Map();
    this.rows = [];
    for (const [bone, [parent, usual]] of Object.entries(BONES)) {
      // A VRM without a chest bends at the spine as the chest would.
      const joint = bone === "spine" && !vrm.humanoid.getNormalizedBoneNode("chest") ? "Spine3" : usual;
      const node = vrm.humanoid.getNormalizedBoneNode(bone);
      if (!node || !names.has(joint)) continue;
      let above = parent;
      while (above && !found.has(above)) [above] = BONES[above];
      found.set(bone, names.get(joint));
      this.rows.push({ node, joint: names.get(joint), above: above ? found.get(above) : -1 });
    }
    this.hips = vrm.humanoid.getNormalizedBoneNode("hips");
    this.height = this.hips?.position.y ?? 0;
    this.stands = null; // metres that the stream's hips stand high
  }

  /** Take a pose, { turns, root, face }; call vrm.update() afterwards. */
  show({ turns, root, face }) {
    if (face) showFace(this.vrm, face, this.lipsOnly);
    for (const [j, parent] of this.parents.entries()) {
      const own = turns.subarray(4 * j, 4 * j + 4);
      this.world[j] = parent < 0 ? own : multiply(this.world[parent], own);
    }
    for (const { node, joint, above } of this.rows) {
      const [w, x, y, z] = above < 0 ? this.world[joint] : multiply(inverse(this.world[above]), this.world[joint]);
      node.quaternion.set(this.faces * x, y, this.faces * z, w);
    }
    this.stands ??= root[1];
    if (this.hips && this.stands > 0) {
      const scale = this.height / this.stands;
      this.hips.position.set(this.faces * root[0] * scale, root[1] * scale, this.faces * root[2] * scale);
    }
  }
}

function multiply([w, x, y, z], [a, b, c, d]) {
  return [w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c, w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a];
}

function inverse([w, x, y, z]) { return [w, -x, -y, -z]; }

// A character of the user's: a VRM by its humanoid, any other GLB by the names of its bones.

import { Group, LoadingManager, Quaternion, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { VRMLoaderPlugin, VRMUtils } from "@pixiv/three-vrm";

import { showFace } from "../../integrations/gesticulator-client/src/face.js";
import { boundTurns } from "./bind_pose.js";
import { chains, jointsByName } from "./bone_names.js";
import { CharacterFace } from "./character_face.js";
import { bonesOf, humanoidPose } from "./humanoid.js";

/** Bytes of a file at most. */
export const LARGEST = 200 * 2 ** 20;

/** A character in the bytes of a GLB or VRM file. told: { name, joints: our joint -> node of the file,
 *  face: of gesticulator/face/page.py } or less. Throws an Error with words for the user. */
export async function readCharacter(bytes, told) {
  if (bytes.length > LARGEST) throw new Error("it is larger than 200 MB");
  if (new TextDecoder().decode(bytes.subarray(0, 4)) !== "glTF") throw new Error("it is no GLB or VRM file");
  const manager = new LoadingManager();
  // Nothing outside of the file is asked for.
  manager.setURLModifier((url) => (/^(blob|data):/.test(url) ? url : "data:,"));
  const loader = new GLTFLoader(manager);
  loader.register((parser) => new VRMLoaderPlugin(parser));
  const gltf = await loader.parseAsync(bytes.slice().buffer, "");
  gltf.scene.traverse((node) => {
    if (!node.isMesh) return;
    node.castShadow = node.receiveShadow = true;
    node.frustumCulled = false;
  });
  const { vrm } = gltf.userData;
  return vrm ? new VrmCharacter(gltf, vrm, bytes, told.name) : NamedCharacter.read(gltf, bytes, told);
}

class Character {
  constructor(gltf, bytes, name) {
    this.gltf = gltf;
    this.bytes = bytes;
    this.name = name;
    this.group = new Group();
  }

  /** The nodes that move, by their number in the file: [[number, node]]. */
  movedNodes() {
    const { associations } = this.gltf.parser;
    return this.moving().map((node) => [associations.get(node)?.nodes, node]).filter(([number]) => number !== undefined);
  }
}

/** A VRM, of version 0 or 1, moved by its normalised bones. */
class VrmCharacter extends Character {
  constructor(gltf, vrm, bytes, name) {
    super(gltf, bytes, name);
    this.kind = `VRM ${vrm.meta?.metaVersion === "0" ? "0.x" : "1.0"}`;
    this.vrm = vrm;
    VRMUtils.rotateVRM0(vrm);
    vrm.scene.updateMatrixWorld(true);
    this.old = vrm.meta?.metaVersion === "0";
    this.hips = vrm.humanoid.getNormalizedBoneNode("hips");
    this.rest = this.hips.position.clone();
    this.hipsHeight = vrm.humanoid.getRawBoneNode("hips").getWorldPosition(new Vector3()).y;
    this.group.add(vrm.scene);
    this.before = null;
  }

  get root() { return this.vrm.humanoid.getRawBoneNode("hips"); }

  /** The node of one of our joints. */
  node(joint) {
    const bone = { LeftArm: "leftUpperArm", LeftForeArm: "leftLowerArm", LeftHand: "leftHand", RightHand: "rightHand", Head: "head" }[joint];
    return bone && this.vrm.humanoid.getRawBoneNode(bone);
  }

  moving() {
    return Object.keys(this.vrm.humanoid.humanBones).map((bone) => this.vrm.humanoid.getRawBoneNode(bone)).filter(Boolean);
  }

  pose(poser) {
    const { humanoid } = this.vrm, { take, root } = poser;
    if (this.take !== take) {
      this.take = take;
      this.bones = bonesOf(take, (bone) => humanoid.getNormalizedBoneNode(bone) !== null);
      humanoid.resetNormalizedPose();
    }
    humanoidPose(this.bones, poser, (bone, turn) => {
      const node = humanoid.getNormalizedBoneNode(bone);
      node.quaternion.copy(turn);
      // Characters of version 0 face -Z.
      if (this.old) node.quaternion.set(-turn.x, turn.y, -turn.z, turn.w);
    });
    const size = this.hipsHeight / take.skeleton.height, way = this.old ? -1 : 1;
    this.hips.position.set(this.rest.x + way * root[0] * size, this.rest.y + (root[1] - take.skeleton.height) * size, this.rest.z + way * root[2] * size);
    if (!take.has("LeftUpLeg")) this.keepLegs(poser);
  }

  show(poser) {
    this.pose(poser);
    if (poser.face) showFace(this.vrm, poser.face);
    const now = performance.now();
    // Hair and cloth swing on after what they hang on.
    this.vrm.update(this.before === null ? 0 : Math.min((now - this.before) / 1000, 0.1));
    this.before = now;
  }

  /** Legs that the motion lacks stand still, whatever the hips do, but turn with their yaw. */
  keepLegs(poser) {
    const [w, , y] = poser.world, yaw = new Quaternion(0, y, 0, w).normalize();
    const turn = poser.turn("Hips", new Quaternion()).invert().multiply(yaw);
    if (this.old) turn.set(-turn.x, turn.y, -turn.z, turn.w);
    for (const side of ["left", "right"]) this.vrm.humanoid.getNormalizedBoneNode(`${side}UpperLeg`)?.quaternion.copy(turn);
  }
}

/** Part of a limb -> the part at its end, which is straight out (or down) in a T-pose. */
const TOWARDS = { Arm: "ForeArm", ForeArm: "Hand", Hand: "HandMiddle1", UpLeg: "Leg", Leg: "Foot" };
const NEEDED = ["Hips", "Head", "LeftArm", "LeftForeArm", "LeftHand", "RightArm", "RightForeArm", "RightHand"];

/** A character whose bones are known by name: world rotations are copied, from a rest pose brought into our T-pose. */
class NamedCharacter extends Character {
  static async read(gltf, bytes, told) {
    const made = new NamedCharacter(gltf, bytes, told.name);
    const nodes = [];
    gltf.scene.traverse((node) => nodes.push(node));
    // Three.js takes colons and dots out of names; the file's own are kept beside.
    made.joints = jointsByName(nodes, (node) => node.userData.name ?? node.name);
    if (told.joints) {
      const rows = await Promise.all(Object.entries(told.joints).map(async ([joint, number]) => (
        [await gltf.parser.getDependency("node", number), joint])));
      made.joints = named(rows);
    }
    const there = new Set(made.joints.values()), missing = NEEDED.filter((joint) => !there.has(joint));
    if (missing.length) {
      throw new Error(`no bone is named like ${missing.slice(0, 3).join(", ")}; names of Mixamo, VRM, Unreal, Unity, Biped and Blender are known`);
    }
    made.prepare(nodes);
    if (told.face) made.face = await CharacterFace.read(gltf, told.face, made.rest, new Vector3(1, 0, 0).applyQuaternion(made.back));
    return made;
  }

  get kind() { return "GLB"; }

  node(joint) { return this.byJoint.get(joint); }

  prepare(nodes) {
    const { scene } = this.gltf;
    scene.updateMatrixWorld(true);
    this.nodes = nodes.slice(1);
    // A rest pose may be a frame of a stride: our joints stand as the skin was bound to them.
    const bound = boundTurns(scene);
    for (const node of this.nodes.filter((one) => bound.has(one) && this.joints.has(one))) {
      node.quaternion.copy(node.parent.getWorldQuaternion(new Quaternion()).invert().multiply(bound.get(node)));
      node.updateMatrixWorld(true);
    }
    this.rest = new Map(nodes.map((node) => [node, { local: node.quaternion.clone(), world: node.getWorldQuaternion(new Quaternion()) }]));
    this.byJoint = new Map([...this.joints].map(([node, joint]) => [joint, node]));
    const place = (joint) => this.byJoint.get(joint).getWorldPosition(new Vector3());
    const left = place("LeftArm").sub(place("RightArm")).setY(0);
    // She may face another way than +Z: that is told by where her left is.
    const turn = new Quaternion().setFromUnitVectors(left.normalize(), new Vector3(1, 0, 0));
    this.back = turn.clone().invert();
    this.pivot = new Group();
    this.pivot.quaternion.copy(turn);
    this.pivot.add(scene);
    this.group.add(this.pivot);
    this.hips = this.byJoint.get("Hips");
    this.restHips = place("Hips");
    this.above = this.hips.parent.matrixWorld.clone();
    const low = Math.min(...["LeftFoot", "RightFoot", "LeftToeBase"].filter((joint) => this.byJoint.has(joint)).map((joint) => place(joint).y), this.restHips.y);
    // Hips without feet beneath them are taken to stand as high as ours.
    this.size = this.restHips.y - low > 0.05 ? this.restHips.y : null;
    this.group.updateWorldMatrix(true, true);
  }

  get root() { return this.hips; }

  moving() { return [...this.joints.keys()]; }

  /** The turn that brings a limb into our T-pose, in the axes of the file; null for what is no limb. */
  swing(joint, take) {
    const [, side, part] = joint.match(/^(Left|Right)(.*)$/) ?? [], end = side + TOWARDS[part];
    if (!TOWARDS[part] || !this.byJoint.has(end)) return null;
    const place = (name) => this.byJoint.get(name).getWorldPosition(new Vector3());
    const row = take.row(end), own = place(end).sub(place(joint));
    const way = row >= 0 ? new Vector3().fromArray(take.skeleton.offsets[row]) : restWay(part, side);
    return new Quaternion().setFromUnitVectors(own.applyQuaternion(this.back).normalize(), way.applyQuaternion(this.back).normalize());
  }

  /** Each joint's world rotation in our T-pose, in the axes of the file: limbs are swung onto ours. */
  tPose(take) {
    const out = new Map();
    for (const [node, joint] of this.joints) {
      const [, side, finger] = joint.match(/^(Left|Right)Hand(.*)$/) ?? [];
      // Fingers go with the hand, and a hand whose fingers are unknown with the forearm.
      const turn = this.swing(joint, take) ?? (finger ? this.swing(`${side}Hand`, take) : null)
        ?? (side ? this.swing(`${side}ForeArm`, take) : null) ?? new Quaternion();
      out.set(node, turn.multiply(this.rest.get(node).world));
    }
    return out;
  }

  pose(poser) {
    const { take, root } = poser;
    if (this.take !== take) {
      for (const [node, { local }] of this.rest) node.quaternion.copy(local);
      this.hips.position.copy(this.restHips.clone().applyMatrix4(this.above.clone().invert()));
      this.gltf.scene.updateMatrixWorld(true);
      this.group.updateWorldMatrix(true, true);
      this.take = take;
      this.straight = this.tPose(take);
    }
    const forward = this.back.clone().invert(), target = new Quaternion(), worlds = new Map([[this.gltf.scene, new Quaternion()]]);
    const legless = !take.has("LeftUpLeg"), [w, , y] = poser.world, yaw = new Quaternion(0, y, 0, w).normalize();
    for (const node of this.nodes) {
      const above = worlds.get(node.parent) ?? new Quaternion(), joint = this.joints.get(node);
      const stands = legless && /UpLeg$/.test(joint ?? "");
      if (joint && (stands || take.has(joint))) {
        // Our turn of the world, told in the axes of the file.
        if (stands) target.copy(yaw); else poser.turn(joint, target);
        target.premultiply(this.back).multiply(forward).multiply(this.straight.get(node));
        node.quaternion.copy(above.clone().invert().multiply(target));
        worlds.set(node, target.clone());
      } else worlds.set(node, above.clone().multiply(this.rest.get(node).local));
    }
    const high = take.skeleton.height, size = (this.size ?? high) / high;
    const at = new Vector3(root[0], root[1] - high, root[2]).multiplyScalar(size).applyQuaternion(this.back).add(this.restHips);
    this.hips.position.copy(at.applyMatrix4(this.above.clone().invert()));
  }

  show(poser) {
    this.pose(poser);
    this.face?.show(poser.face);
  }
}

/** Node -> our joint, of rows [node, joint]: however many nodes make her spine and neck, they share ours. */
function named(rows) {
  const part = (name) => [...new Set(rows.filter(([, joint]) => joint.replace(/\d/, "") === name).sort((a, b) => (a[1] < b[1] ? -1 : 1)).map(([node]) => node))];
  const single = rows.filter(([, joint]) => !/^(Spine|Neck)\d?$/.test(joint));
  return new Map([...single, ...chains(part("Spine"), part("Neck"))]);
}

/** Where a limb points in a T-pose, for joints that a motion lacks. */
function restWay(part, side) {
  if (part.includes("Leg")) return new Vector3(0, -1, 0);
  return new Vector3(side === "Left" ? 1 : -1, 0, 0);
}

// Files made of what is on the stage: GLB of our own figure or of the user's character, and VRMA for any VRM.

import { AnimationClip, Matrix4, Quaternion, QuaternionKeyframeTrack, Vector3, VectorKeyframeTrack } from "three";
import { GLTFExporter } from "three/addons/exporters/GLTFExporter.js";

import { Figure } from "./figure.js";
import { Glb } from "./glb.js";
import { bonesOf, humanoidPose } from "./humanoid.js";
import { Poser } from "./take.js";

const NAME = "gesture";
const EXTENSION = "VRMC_vrm_animation";

const timesOf = (take) => Float32Array.from({ length: take.frames }, (_, t) => t / take.fps);

/** Frame after frame of a take: visit(frame, poser). */
function everyFrame(take, visit) {
  const poser = new Poser(take);
  for (let t = 0; t < take.frames; t++) visit(t, poser.set(t / take.fps));
}

/** The take as a VRM animation (VRMC_vrm_animation 1.0): the bytes of a .vrma file. */
export function vrmaOf(take) {
  const rows = bonesOf(take), node = new Map(rows.map(({ bone }, k) => [bone, k]));
  const rest = restPlaces(take.skeleton);
  const nodes = rows.map(({ bone, above, joint }) => {
    const place = rest.get(joint), from = above ? rest.get(rows[node.get(above)].joint) : [0, 0, 0];
    return { name: bone, translation: place.map((v, c) => v - from[c]) };
  });
  rows.forEach(({ bone, above }) => { if (above) (nodes[node.get(above)].children ??= []).push(node.get(bone)); });
  const values = rows.map(() => new Float32Array(take.frames * 4)), hips = new Float32Array(take.frames * 3);
  everyFrame(take, (t, poser) => {
    hips.set(poser.root, t * 3);
    humanoidPose(rows, poser, (bone, turn) => write(turn, values[node.get(bone)], t));
  });
  const humanBones = Object.fromEntries(rows.map(({ bone }, k) => [bone, { node: k }]));
  const glb = new Glb({
    asset: { version: "2.0", generator: "gesticulator viewer" },
    extensionsUsed: [EXTENSION],
    extensions: { [EXTENSION]: { specVersion: "1.0", humanoid: { humanBones } } },
    scene: 0, scenes: [{ nodes: [0] }], nodes,
  });
  glb.animate(NAME, timesOf(take), [{ node: 0, path: "translation", values: hips },
    ...values.map((turns, k) => ({ node: k, path: "rotation", values: turns }))]);
  return glb.bytes();
}

/** Joint -> its place in a T-pose on the floor, metres. */
function restPlaces({ names, parents, offsets, height }) {
  const places = [];
  names.forEach((_, j) => places.push(parents[j] < 0 ? [0, height, 0] : offsets[j].map((v, c) => v + places[parents[j]][c])));
  return new Map(names.map((name, j) => [name, places[j]]));
}

/** Write a quaternion, on the side of the sphere of the frame before. */
function write(turn, values, t) {
  const p = t * 4, own = [turn.x, turn.y, turn.z, turn.w];
  const dot = t ? own.reduce((sum, v, c) => sum + v * values[p - 4 + c], 0) : 1;
  values.set(dot < 0 ? own.map((v) => -v) : own, p);
}

/** The user's own file with one animation more: nothing else in it changes. */
export function characterGlb(character, take) {
  const moved = character.movedNodes(), values = moved.map(() => new Float32Array(take.frames * 4));
  const hips = moved.findIndex(([, node]) => node === character.root), places = new Float32Array(take.frames * 3);
  everyFrame(take, (t, poser) => {
    character.show(poser);
    moved.forEach(([, node], k) => write(node.quaternion, values[k], t));
    character.root.position.toArray(places, t * 3);
  });
  const glb = Glb.read(character.bytes);
  for (const [number] of moved) untangle(glb.document.nodes[number]);
  const tracks = moved.map(([number], k) => ({ node: number, path: "rotation", values: values[k] }));
  if (hips >= 0) tracks.push({ node: moved[hips][0], path: "translation", values: places });
  glb.animate(NAME, timesOf(take), tracks);
  return glb.bytes();
}

/** A node that is animated has no matrix, but what it is made of. */
function untangle(told) {
  if (!told.matrix) return;
  const translation = new Vector3(), rotation = new Quaternion(), scale = new Vector3();
  new Matrix4().fromArray(told.matrix).decompose(translation, rotation, scale);
  delete told.matrix;
  for (const [name, part] of Object.entries({ translation, rotation, scale })) told[name] = part.toArray();
}

/** Our own figure with its motion: the bytes of a GLB file. */
export async function figureGlb(take) {
  const figure = new Figure(take, false, true), times = timesOf(take), turns = take.skeleton.names.map(() => new Float32Array(take.frames * 4));
  const places = new Float32Array(take.frames * 3);
  everyFrame(take, (t, poser) => {
    figure.show(poser);
    figure.bones.forEach((bone, j) => write(bone.quaternion, turns[j], t));
    figure.bones[0].position.toArray(places, t * 3);
  });
  // At rest she stands in a T-pose, as other tools expect.
  for (const bone of figure.bones) bone.quaternion.identity();
  figure.bones[0].position.set(0, take.skeleton.height, 0);
  for (const [what, value] of [["position", 0], ["rotation", 0], ["scale", 1]]) figure.legs[what].set(value, value, value);
  const tracks = figure.bones.map((bone, j) => new QuaternionKeyframeTrack(`${bone.name}.quaternion`, times, turns[j]));
  tracks.push(new VectorKeyframeTrack(`${figure.bones[0].name}.position`, times, places));
  figure.group.name = "figure";
  const clip = new AnimationClip(NAME, take.duration, tracks);
  const buffer = await new GLTFExporter().parseAsync(figure.group, { binary: true, animations: [clip], onlyVisible: false });
  figure.dispose();
  return new Uint8Array(buffer);
}

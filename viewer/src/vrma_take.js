// A VRM animation as a take: any motion in a .vrma file can stand beside ours.

import { Quaternion } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { VRMAnimationLoaderPlugin } from "@pixiv/three-vrm-animation";

import { BONES } from "./humanoid.js";
import { Take } from "./take.js";

/** Frames a second that it is sampled at. */
const FPS = 30;
/** Bones that bend at the same joint of ours, from below. */
const SAME = { chest: ["chest", "upperChest"] };

/** The take of a file's bytes, on the skeleton of another take and as long as it. Throws an Error in words. */
export async function readVrma(bytes, name, like) {
  const loader = new GLTFLoader();
  loader.register((parser) => new VRMAnimationLoaderPlugin(parser));
  const gltf = await loader.parseAsync(bytes.slice().buffer, "");
  const animation = gltf.userData.vrmAnimations?.[0];
  if (!animation) throw new Error("it holds no VRM animation");
  const frames = Math.max(1, Math.round(like.duration * FPS)), { skeleton } = like, joints = skeleton.names.length;
  const rotations = new Float32Array(frames * joints * 4), roots = new Float32Array(frames * 3);
  for (let p = 0; p < rotations.length; p += 4) rotations[p] = 1;
  const turns = Object.entries(BONES).filter(([, [, , joint]]) => like.has(joint)).map(([bone, [, at]]) => ({
    row: like.row(at.at(-1)), tracks: (SAME[bone] ?? [bone]).map((one) => sampler(animation.humanoidTracks.rotation.get(one))).filter(Boolean),
  }));
  const path = sampler(animation.humanoidTracks.translation.get("hips")), size = skeleton.height / (animation.restHipsPosition.y || skeleton.height);
  const turn = new Quaternion(), step = new Quaternion();
  for (let t = 0; t < frames; t++) {
    const time = t / FPS;
    for (const { row, tracks } of turns) {
      turn.identity();
      for (const track of tracks) turn.multiply(step.fromArray(track(time)));
      rotations.set([turn.w, turn.x, turn.y, turn.z], (t * joints + row) * 4);
    }
    roots.set(path ? [...path(time)].map((v) => v * size) : [0, skeleton.height, 0], t * 3);
  }
  return Take.of({ name, fps: FPS, frames, duration: like.duration, skeleton, rotations, roots });
}

/** The values of a track at a time, its last ones after its end; null where there is none. */
function sampler(track) {
  if (!track) return null;
  const interpolant = track.createInterpolant(), end = track.times.at(-1);
  return (time) => interpolant.evaluate(Math.min(time, end));
}

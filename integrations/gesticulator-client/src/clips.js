// Clips: played in step with their sound, taken from a VRM animation, or made a layer over another clip.

import { AdditiveAnimationBlendMode, AnimationClip, AnimationMixer, LoopOnce, LoopRepeat, NormalAnimationBlendMode, NumberKeyframeTrack,
  PropertyBinding, Quaternion, QuaternionKeyframeTrack, Vector3, VectorKeyframeTrack } from "three";

/** Plays a clip; where it has a sound, the sound is the clock, so that the two cannot drift apart. */
export class GesturePlayer {
  /**
   * @param root the object that holds the animated nodes, such as `gltf.scene` or `vrm.scene`
   * @param clip an AnimationClip
   * @param options sound: a URL or a media element; loop: repeat; additive: over other clips; mixer: one to share
   */
  constructor(root, clip, { sound = null, loop = false, additive = false, weight = 1, mixer = null } = {}) {
    this.root = root;
    this.clip = additive ? additiveClip(clip, root) : clip;
    this.sound = typeof sound === "string" ? new Audio(sound) : sound;
    if (this.sound) this.sound.loop = loop;
    this.mixer = mixer ?? new AnimationMixer(root);
    this.shared = mixer !== null;
    this.action = this.mixer.clipAction(this.clip);
    this.action.setLoop(loop ? LoopRepeat : LoopOnce);
    this.action.clampWhenFinished = true;
    this.action.weight = weight;
    this.last = null;
  }

  /** Begin at the start, and the sound with it; a promise that is rejected where the browser forbids sound. */
  async play() {
    this.action.reset().play();
    this.last = null;
    if (this.sound) {
      this.sound.currentTime = 0;
      await this.sound.play();
    }
  }

  stop() {
    this.sound?.pause();
    this.action.stop();
  }

  /** Show the pose of this moment: of the sound, else `delta` seconds after the last call (by default, measured). */
  update(delta = null) {
    const now = performance.now() / 1000;
    const step = delta ?? (this.last === null ? 0 : now - this.last);
    this.last = now;
    if (this.sound && !this.action.paused) this.action.time = Math.min(this.sound.currentTime, this.clip.duration);
    if (!this.shared) this.mixer.update(this.sound ? 0 : step);
  }
}

/**
 * A clip that gesticulator wrote with `--layer additive`, for an AnimationMixer: what it turns each node from its rest
 * in the file is added to what other clips do. `root` must be at rest: call this before anything moves it.
 */
export function additiveClip(clip, root) {
  if (clip.blendMode === AdditiveAnimationBlendMode) return clip;
  const tracks = [], turn = new Quaternion();
  for (const track of clip.tracks) {
    const { nodeName, propertyName } = PropertyBinding.parseTrackName(track.name);
    const node = PropertyBinding.findNode(root, nodeName);
    if (!node || propertyName !== "quaternion") continue;
    const back = node.quaternion.clone().invert(), values = new Float32Array(track.values.length);
    for (let p = 0; p < values.length; p += 4) turn.fromArray(track.values, p).premultiply(back).toArray(values, p);
    tracks.push(new QuaternionKeyframeTrack(track.name, track.times.slice(), values));
  }
  return new AnimationClip(clip.name, clip.duration, tracks, AdditiveAnimationBlendMode);
}

/**
 * The clip of a VRM animation (a .vrma file, loaded by a plain GLTFLoader) for one VRM, of version 0.x or 1.0. Bones and
 * expressions that the VRM lacks are left out.
 */
export async function vrmClip(gltf, vrm, index = 0) {
  const bones = gltf.parser.json.extensions?.VRMC_vrm_animation?.humanoid?.humanBones;
  if (!bones) throw new Error("this file holds no VRM animation");
  const source = gltf.animations[index];
  if (!source) throw new Error(`there is no animation ${index} in this file`);
  const faces = vrm.meta?.metaVersion === "0" ? -1 : 1; // a VRM 0.x faces -Z
  gltf.scene.updateWorldMatrix(true, true);
  const tracks = [], turn = new Quaternion();
  for (const [bone, { node: number }] of Object.entries(bones)) {
    const node = await gltf.parser.getDependency("node", number), target = vrm.humanoid.getNormalizedBoneNode(bone);
    if (!target) continue;
    const key = node.name || node.uuid;
    const rotation = source.tracks.find(({ name }) => name === `${key}.quaternion`);
    if (rotation) {
      // What the bone turns in the world of its rest, where normalized bones have no turn.
      const above = node.parent.getWorldQuaternion(new Quaternion());
      const back = node.getWorldQuaternion(new Quaternion()).invert();
      const values = new Float32Array(rotation.values.length);
      for (let p = 0; p < values.length; p += 4) {
        turn.fromArray(rotation.values, p).premultiply(above).multiply(back);
        values.set([faces * turn.x, turn.y, faces * turn.z, turn.w], p);
      }
      tracks.push(new QuaternionKeyframeTrack(`${target.name}.quaternion`, rotation.times.slice(), values));
    }
    const path = bone === "hips" && source.tracks.find(({ name }) => name === `${key}.position`);
    if (path) {
      const scale = vrm.humanoid.normalizedRestPose.hips.position[1] / node.getWorldPosition(new Vector3()).y;
      const values = path.values.map((value, k) => value * scale * (k % 3 === 1 ? 1 : faces));
      tracks.push(new VectorKeyframeTrack(`${target.name}.position`, path.times.slice(), values));
    }
  }
  for (const [name, { node: number }] of Object.entries(gltf.parser.json.extensions.VRMC_vrm_animation.expressions?.preset ?? {})) {
    const node = await gltf.parser.getDependency("node", number), target = vrm.expressionManager?.getExpressionTrackName(name);
    const weight = source.tracks.find((track) => track.name === `${node.name || node.uuid}.position`);
    // The weight of an expression is how far its node is shifted along X.
    if (target && weight) tracks.push(new NumberKeyframeTrack(target, weight.times.slice(), weight.values.filter((_, k) => k % 3 === 0)));
  }
  return new AnimationClip(source.name, source.duration, tracks, NormalAnimationBlendMode);
}

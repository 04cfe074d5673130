import type { AnimationAction, AnimationClip, AnimationMixer, Object3D } from "three";

/** What is used of a VRM, as `@pixiv/three-vrm` loads it. */
export interface VrmLike {
  scene: Object3D;
  meta?: { metaVersion?: string };
  humanoid: {
    getNormalizedBoneNode(bone: string): Object3D | null;
    normalizedRestPose: { hips?: { position?: number[] | [number, number, number] } };
  };
  expressionManager?: { setValue(name: string, weight: number): void; getExpressionTrackName(name: string): string | null };
  lookAt?: { yaw: number; pitch: number } | null;
}

/** What is used of a file that `GLTFLoader` loaded. */
export interface GltfLike {
  scene: Object3D;
  animations: AnimationClip[];
  parser: { json: any; getDependency(type: string, index: number): Promise<any> };
}

export interface PlayerOptions {
  /** A URL or a media element: it is the clock. */
  sound?: string | HTMLMediaElement | null;
  loop?: boolean;
  /** Add the clip to what other clips of the same mixer do. */
  additive?: boolean;
  weight?: number;
  /** A mixer to share; then its owner updates it. */
  mixer?: AnimationMixer | null;
}

export class GesturePlayer {
  constructor(root: Object3D, clip: AnimationClip, options?: PlayerOptions);
  readonly root: Object3D;
  readonly clip: AnimationClip;
  readonly sound: HTMLMediaElement | null;
  readonly mixer: AnimationMixer;
  readonly action: AnimationAction;
  play(): Promise<void>;
  stop(): void;
  /** delta: seconds since the last call; measured where it is left out. */
  update(delta?: number | null): void;
}

export function additiveClip(clip: AnimationClip, root: Object3D): AnimationClip;

export function vrmClip(gltf: GltfLike, vrm: VrmLike, index?: number): Promise<AnimationClip>;

export interface Joint { name: string; parent: number; offset: [number, number, number]; tip?: [number, number, number] }
export interface Welcome { type: "hello"; stream: string; fps: number; look_ahead: number; joints: Joint[]; limits: Record<string, number> }
/** turns: 4 numbers a joint (w, x, y, z), local to the parent; root: metres; face: 20 numbers, of a stream with the option `face`. */
export interface Pose { turns: Float32Array; root: ArrayLike<number>; face?: Float32Array }
export interface Frame extends Pose { source: number }
export type GestureEvent =
  | Welcome
  | { type: "poses"; end: number; state: string }
  | { type: "state"; state: "idle" | "speaking" | "listening" | "thinking"; time: number }
  | { type: "beat"; time: number }
  | { type: "lexeme"; start: number; end: number; lexeme: number; silent: boolean }
  | { type: "word"; text: string; start: number; end: number }
  | { type: "pace"; effort: "full" | "low" | "less" | "none"; passed: number }
  | { type: "interrupted"; time: number }
  | { type: "done"; frames: number }
  | { type: "error"; code: number; message: string; retry_after?: number }
  | { type: "lost"; code: number; reason: string }
  | { type: "back" }
  | { type: "closed"; code: number; reason: string };
export interface StreamSettings {
  /** Hertz of the sound that will be sent. */
  sampleRate: number;
  /** As in the schema, such as { latency: "low" } for a microphone. */
  options?: Record<string, unknown>;
  fps?: number;
  seed?: number;
  token?: string;
  onEvent?: (event: GestureEvent) => void;
  /** Seconds for which a lost server is waited for. */
  patience?: number;
  random?: () => number;
  Socket?: typeof WebSocket;
}
export class GestureStream {
  constructor(url: string, settings: StreamSettings);
  readonly ready: Promise<GestureStream>;
  readonly welcome: Welcome | null;
  readonly connected: boolean;
  readonly fps: number;
  readonly sampleRate: number;
  /** Media time of what was sent, seconds. */
  readonly time: number;
  /** Number of the frame after the last. */
  readonly end: number;
  send(samples: Float32Array): void;
  idle(seconds?: number): void;
  think(seconds?: number): void;
  listen(): void;
  speak(): void;
  interrupt(time?: number): void;
  addWords(words: { text: string; start: number; end: number }[]): void;
  finish(): void;
  close(): void;
  /** The nearest frame to a media time that has come. */
  at(time: number): Frame | undefined;
  /** The frame of a media time, if it has come. */
  frameAt(time: number): Frame | undefined;
}
/** Poses that come through the data channel of a call, such as Pipecat's with `GesticulatorProcessor(messages=True)`. */
export class MessageStream {
  constructor(settings?: { onEvent?: (event: GestureEvent) => void; clock?: () => number });
  readonly welcome: Welcome | null;
  readonly fps: number;
  /** Number of the frame after the last. */
  readonly end: number;
  /** Media time that is heard now, seconds. */
  readonly time: number;
  /** Take a message, an object or its text; whether it was one of ours. */
  take(message: unknown): boolean;
  at(time: number): Frame | undefined;
  frameAt(time: number): Frame | undefined;
}
/** A pose for every moment, without a jump where poses are late or lost. */
export class SteadyPlayer {
  constructor(stream: GestureStream | MessageStream);
  readonly idling: boolean;
  poseAt(time: number): Pose | null;
}
export function feedTrack(stream: GestureStream, track: MediaStreamTrack, context: AudioContext, capture: string | URL): Promise<() => void>;
export function feedMicrophone(stream: GestureStream, context: AudioContext, capture: string | URL): Promise<() => void>;
export const BONES: Record<string, [string | null, string]>;
/** What a face needs of a VRM of @pixiv/three-vrm. */
export interface VrmFace {
  meta?: { metaVersion?: string };
  expressionManager?: { setValue(name: string, weight: number): void };
  lookAt?: { yaw: number; pitch: number } | null;
}
export function expressionsOf(face: ArrayLike<number>): Record<string, number>;
/** Call vrm.update() afterwards. lipsOnly: leave lids, emotions and gaze to others. */
export function showFace(vrm: VrmFace, face: ArrayLike<number>, lipsOnly?: boolean): void;
/** vrm: of @pixiv/three-vrm. */
export class VrmDriver {
  constructor(joints: Joint[], vrm: VrmFace & { humanoid: { getNormalizedBoneNode(name: string): unknown } }, options?: { lipsOnly?: boolean });
  show(pose: Pose): void;
}

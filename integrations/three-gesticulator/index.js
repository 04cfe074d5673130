export { GesturePlayer, additiveClip, vrmClip } from "./clips.js";
export { GestureStream } from "./stream.js";

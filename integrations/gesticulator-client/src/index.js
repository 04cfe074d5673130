export { GestureStream } from "./stream.js";
export { MessageStream } from "./messages.js";
export { SteadyPlayer } from "./steady.js";
export { feedMicrophone, feedTrack } from "./microphone.js";
export { expressionsOf, showFace } from "./face.js";
export { BONES, VrmDriver } from "./vrm.js";

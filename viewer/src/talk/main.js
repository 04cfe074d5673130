// The page of `gesticulator live`: sound goes to the server, poses come back and are shown by the sound's own clock.

import { readCharacter } from "../character.js";
import { Stage } from "../stage.js";
import { bindStage } from "../stage_hands.js";
import { readTheme } from "../theme.js";
import { LivePerformer } from "./performer.js";
import { Idle, Microphone, Recording } from "./voices.js";
import { Stream } from "./wire.js";

const $ = (id) => document.getElementById(id);
/** Milliseconds in which nothing is late, before the page says so. */
const CALM = 3000;
const context = new AudioContext();
let stage = null;
let performer = null;
let character = null;
let voice = null;
let stream = null;
let last = performance.now();
let calm = 0;
let face = false;

function say(text) {
  $("message").textContent = text;
  $("message").hidden = !text;
}

function level(samples) {
  let sum = 0;
  for (const one of samples) sum += one * one;
  $("level").value = Math.min(1, 4 * Math.sqrt(sum / samples.length));
}

function heard(of, message) {
  if (of !== stream) return;
  if (message.type === "poses") {
    if ($("first").dataset.of !== String(of.begun)) {
      $("first").dataset.of = String(of.begun);
      $("first").textContent = `${Math.round(performance.now() - of.begun)} ms`;
    }
    voice.heard(message.end);
    $("state").textContent = message.state;
  } else if (message.type === "state") $("state").textContent = message.state;
  else if (message.type === "pace") pace(message);
  else if (message.type === "closed") say(`The server closed the stream: ${message.reason || message.code}`);
}

/** What this machine has no time for. */
function pace({ effort, passed }) {
  const lost = passed > 0 ? `${passed.toFixed(1)} s were passed over` : "";
  clearTimeout(calm);
  if (effort === "full" || effort === "low") { // with low look-ahead the poses are as late as was promised
    // One that is always too slow has time for a moment after each part that it passed over.
    calm = setTimeout(() => { $("pace").textContent = `This machine keeps up again${lost && `; ${lost}`}.`; }, CALM);
    return;
  }
  $("pace").hidden = false; // it stays, so that the desk does not jump
  $("pace").textContent = `This machine is slower than the sound: ${lost || "gestures are drawn at less cost"}.`;
}

/** Another voice: its own stream, and a blend from the pose that is shown. */
async function change(next) {
  voice?.end();
  stream?.close();
  const own = new Stream(context.sampleRate, { ...next.options, ...(face ? { face: "full" } : {}) }, (message) => heard(own, message));
  voice = next;
  stream = own;
  $("level").value = 0;
  clearTimeout(calm);
  $("pace").hidden = true;
  $("microphone").setAttribute("aria-pressed", String(next instanceof Microphone));
  $("stop").disabled = next instanceof Idle;
  await own.ready;
  if (own !== stream) return;
  stand(own.welcome.joints);
  try {
    await next.begin(own);
  } catch (error) {
    say(error.name === "NotAllowedError" ? "The browser does not let this page hear the microphone." : String(error.message || error));
    await change(new Idle());
  }
}

function stand(joints) {
  if (performer?.take.joints !== joints.length) {
    performer = new LivePerformer(joints);
    if (character) performer.wear(character);
    stage.cast([performer]);
  }
  performer.blend = 0;
}

async function open(file) {
  say("");
  if (/\.(glb|vrm)$/i.test(file.name)) {
    try {
      character = await readCharacter(new Uint8Array(await file.arrayBuffer()), { name: file.name });
      performer.wear(character);
      stage.fit();
      $("character").textContent = `${file.name} (${character.kind})`;
      $("undress").hidden = false;
    } catch (error) {
      say(`${file.name} cannot be moved: ${error.message}`);
    }
    return;
  }
  try {
    await context.resume();
    await change(new Recording(context, await context.decodeAudioData(await file.arrayBuffer()), () => change(new Idle())));
  } catch (error) {
    say(`${file.name} cannot be played: ${error.message}`);
  }
}

function tick(now) {
  requestAnimationFrame(tick);
  const seconds = (now - last) / 1000;
  last = now;
  if (stream?.welcome && stream.end && performer) {
    const time = voice.time(), frame = stream.at(time);
    if (voice.skipped) {
      performer.blend = 0; // from the pose that was shown, as to another stream's
      voice.skipped = false;
    }
    if (frame) performer.move(frame, seconds);
    performer.expect(stream, time);
    $("latency").textContent = voice.latency();
    $("frames").textContent = stream.total;
  }
  stage.ease(seconds);
  stage.draw(0);
}

function bind() {
  $("microphone").addEventListener("click", async () => {
    say("");
    await context.resume();
    change(voice instanceof Microphone ? new Idle() : new Microphone(context, level));
  });
  $("stop").addEventListener("click", () => change(new Idle()));
  $("face").addEventListener("click", () => {
    face = !face;
    $("face").setAttribute("aria-pressed", String(face));
    change(voice instanceof Microphone ? new Microphone(context, level) : new Idle());
  });
  $("undress").addEventListener("click", () => {
    character = null;
    performer.wear(null);
    stage.fit();
    $("character").textContent = "drop a .glb or .vrm";
    $("undress").hidden = true;
  });
  for (const input of [$("file"), $("model")]) {
    input.addEventListener("change", () => { if (input.files[0]) open(input.files[0]); input.value = ""; });
  }
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    if (event.dataTransfer.files[0]) open(event.dataTransfer.files[0]);
  });
  new ResizeObserver(() => stage.resize()).observe($("figure"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readTheme(); stage.paint(); });
}

readTheme();
try {
  stage = new Stage($("figure"));
  stage.look("close");
  bindStage(stage, () => {});
  bind();
  await change(new Idle());
  stage.resize();
  requestAnimationFrame(tick);
} catch (error) {
  say(`The figure needs WebGL, which this browser does not offer here (${error.message}).`);
}
// For the console, and for tests.
window.live = { get stage() { return stage; }, get performer() { return performer; }, get stream() { return stream; }, get voice() { return voice; } };
document.body.dataset.ready = "true";

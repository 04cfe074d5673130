// The viewer: what is open, the stage, the timeline, the panel, and what binds them to keys and fingers.

import { readCharacter } from "./character.js";
import { Clock } from "./clock.js";
import { bindCurves } from "./curve_knobs.js";
import { curveOf, valueAt, withCurve } from "./curves.js";
import { bindDirections } from "./directions.js";
import { $, element, notice } from "./dom.js";
import { characterGlb, figureGlb, vrmaOf } from "./exports.js";
import { bindFiles, fileName, save } from "./files.js";
import { Inspector } from "./inspector.js";
import { Kept } from "./kept.js";
import { bindKeys, fillSheet } from "./keys.js";
import { AWAY_TEXT, Live } from "./live.js";
import { bytesOf, clamp, minutes } from "./numbers.js";
import * as edits from "./plan.js";
import { readJson } from "./plan.js";
import { Palette } from "./palette.js";
import { Performer } from "./performer.js";
import { Pins } from "./pins.js";
import { Session } from "./session.js";
import { silencePicture, signPicture, TITLES } from "./signs.js";
import { Stage } from "./stage.js";
import { bindStage } from "./stage_hands.js";
import { readTheme } from "./theme.js";
import { Timeline } from "./timeline.js";
import { TimelineHands } from "./timeline_hands.js";
import { readVrma } from "./vrma_take.js";
import { Waveform } from "./waveform.js";

const data = readJson($("performance").textContent);
const session = new Session(data);
const peaks = new Int8Array(bytesOf(data.peaks).buffer);
let dirty = true;
const changed = () => { dirty = true; };
const clock = new Clock($("sound"), data.duration, changed);
const timeline = new Timeline($("timeline"), $("overview"), session, new Waveform(peaks, data.peaksPerSecond, data.duration), clock);
const inspector = new Inspector(session, clock);
let stage = null, together = false, over = false, trails = true, worn = null, spoken = null;

// ---------------------------------------------------------------- who stands on the stage

function performers() {
  if (!stage) return;
  const lanes = together ? session.lanes : [session.lane];
  const kept = stage.performers, next = lanes.map((lane, place) => {
    const second = lane === session.lanes[1], performer = kept.find((one) => one.lane === lane) ?? Object.assign(new Performer(lane.take, second, trails), { lane });
    if (performer.take !== lane.take) performer.play(lane.take);
    if (performer.place !== place || performer.worn !== worn) dress(performer, place);
    return performer;
  });
  stage.cast(next, over);
  for (const performer of next) performer.ghost(over && performer.second);
  writeLabels();
  changed();
}

/** Each performer wears a copy of the character, since one cannot stand in two places. */
async function dress(performer, place) {
  Object.assign(performer, { place, worn });
  const asked = worn;
  if (!asked) { performer.wear(null); stage.fit(); return; }
  const character = performer.lane === session.lanes[0] ? asked.first : asked.second ??= await readCharacter(asked.bytes, asked.told);
  if (worn === asked) { performer.wear(character); performer.ghost(over && performer.second); stage.cast(stage.performers, over); changed(); }
}

async function wear(bytes, told) {
  try {
    const first = await readCharacter(bytes, told);
    worn = { bytes, told, first, second: null };
    performers();
    $("own-figure").disabled = false;
    notice(`${told.name}: a character of kind ${first.kind}.`);
  } catch (error) {
    notice(`${told.name} cannot be shown: ${error.message}.`, true);
  }
}

function undress() {
  worn = null;
  $("own-figure").disabled = true;
  performers();
}

function writeLabels() {
  const labels = together && stage ? stage.performers.map((one) => one.take.name) : [];
  $("labels").replaceChildren(...labels.map((name) => Object.assign(document.createElement("span"), { textContent: name })));
  const takes = session.lanes.map((lane) => lane.take.name);
  $("takes").hidden = takes.length < 2;
  $("take").replaceChildren(...takes.map((name, k) => new Option(name, k, false, k === session.active)));
  $("together").setAttribute("aria-pressed", String(together && !over));
  $("ghost").setAttribute("aria-pressed", String(together && over));
  // With one take there is nothing beside it yet; with the renderer behind the page it can be kept for comparison.
  $("together").hidden = $("ghost").hidden = takes.length < 2 && !data.live;
}

function placeLabels() {
  [...$("labels").children].forEach((label, k) => {
    const [x, y] = stage.feetOf(stage.performers[k]);
    // Over each other, the names stand beside each other.
    label.style.left = `${over ? x + (k ? 90 : -90) : x}px`;
    label.style.top = `${Math.min(y + 14, stage.canvas.clientHeight - 30)}px`;
  });
}

/** Show one take alone, two beside each other, or two over each other, the second one as a ghost. */
function arrange(way) {
  if (way !== "alone" && session.lanes.length < 2) {
    if (!data.live) return;
    session.pin("before");
  }
  together = way !== "alone";
  over = way === "over";
  performers();
  // From aside, one of two is nearer and hides part of the other.
  if (way === "beside") look("front");
}

const toggleTogether = () => arrange(together && !over ? "alone" : "beside");
const toggleGhost = () => arrange(over ? "alone" : "over");

// ---------------------------------------------------------------- what is written on the page

function writeFacts() {
  const { plan, take } = session, distinct = new Set(plan.blocks.map((block) => block.lexeme)).size;
  $("facts").textContent = `${minutes(data.duration, 1)} · ${plan.blocks.length} blocks · ${distinct} lexemes · ${Math.round(take.fps * 100) / 100} frames/s`;
  const kinds = Object.keys(TITLES).filter((kind) => kind !== "edited" || plan.blocks.some((block) => block.flag === kind));
  const item = (sign, text) => { const li = document.createElement("li"); li.append(sign, text); return li; };
  $("legend").replaceChildren(...kinds.map((kind) => item(signPicture(kind), TITLES[kind])), item(silencePicture(), "silence"));
  const { past, future } = session.lane.history;
  $("undo").disabled = !past.length;
  $("redo").disabled = !future.length;
}

function writeClock(time) {
  const frame = Math.min(session.take.frames - 1, Math.floor(time * session.take.fps + 1e-6));
  const small = Object.assign(document.createElement("small"), { textContent: `/ ${minutes(data.duration, 1)} · frame ${frame}` });
  $("clock").replaceChildren(`${minutes(time, 2)} `, small);
  const slider = timeline.canvas, playing = inspector.playing(time);
  slider.setAttribute("aria-valuenow", time.toFixed(3));
  slider.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds, ${playing.text}`);
  // While it plays, a gesture is told when it begins; more could not be listened to.
  if (clock.playing && playing.begins !== spoken) { spoken = playing.begins; $("spoken").textContent = playing.gesture; }
  document.body.classList.toggle("playing", clock.playing);
  $("play").setAttribute("aria-label", clock.playing ? "Pause" : "Play");
  $("clear-range").disabled = !clock.range;
}

const status = (state, text) => {
  $("status").textContent = text;
  $("status").dataset.state = state;
  if (state === "bad") notice(text, true);
  else if (state === "same" && $("notice").textContent === AWAY_TEXT) notice(""); // other faults stay until they are read
};
const planName = () => fileName(data.title, ".plan.json");

// ---------------------------------------------------------------- files

let saved = null;

function savePlan() {
  save(planName(), edits.planText(session.plan), "application/json");
  saved = session.plan;
  const sound = session.plan.sound?.name ?? "SPEECH";
  const edited = !data.live && session.plan !== session.lane.rendered;
  notice(`${planName()} is saved.${edited ? ` To see the edits: gesticulator infer ${sound} --plan ${planName()} -o OUT.html` : ""}`);
}

async function takeFile(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  if (/\.vrma$/i.test(file.name)) { await besides(bytes, file.name); return; }
  if (!/\.json$/i.test(file.name)) { await wear(bytes, { name: file.name }); return; }
  try {
    const plan = readJson(new TextDecoder().decode(bytes)), wrong = edits.fault(plan, session.original);
    if (wrong) throw new Error(wrong);
    session.edit(plan);
    notice(`${file.name} is open.`);
  } catch (error) {
    notice(error instanceof SyntaxError ? `${file.name} is no JSON: ${error.message}` : `${file.name}: ${error.message}`, true);
  }
}

async function besides(bytes, name) {
  try {
    session.setBeside(await readVrma(bytes, name, session.lanes[0].take), true);
    if (!together) toggleTogether();
  } catch (error) {
    notice(`${name} cannot be played: ${error.message}.`, true);
  }
}

async function exportAs(kind) {
  const { take } = session, name = fileName(session.lanes.length > 1 ? `${data.title}_${take.name}` : data.title, `.${kind}`);
  try {
    const bytes = kind === "vrma" ? vrmaOf(take) : worn ? characterGlb(worn.first, take) : await figureGlb(take);
    save(name, bytes, "model/gltf-binary");
    notice(`${name} is written${session.plan === session.lane.rendered ? "" : ", without the edits that are not rendered yet"}.`);
  } catch (error) {
    notice(`${name} cannot be written: ${error.message}`, true);
  }
  changed();
}

// ---------------------------------------------------------------- time

function step(frames) {
  clock.pause();
  const { fps, frames: count } = session.take;
  // A little after a frame's time, so that rounding in the player cannot fall back to the frame before.
  const frame = clamp(Math.floor(clock.time * fps + 1e-3) + frames, 0, count - 1);
  clock.seek((frame + 0.02) / fps);
}

function stepBlock(way) {
  const { blocks } = session.plan, now = clock.time, k = edits.blockAt(session.plan, now + 1e-3);
  if (way > 0) clock.seek(blocks[k].end + 0.002);
  else clock.seek((now - blocks[k].start > 0.08 || k === 0 ? blocks[k] : blocks[k - 1]).start + 0.002);
  if (session.selection) session.select(edits.blockAt(session.plan, clock.time));
}

function setIn() { clock.setRange(clock.time, Math.max(clock.end, Math.min(clock.time + 0.5, data.duration))); }
function setOut() { clock.setRange(Math.min(clock.begin, clock.time - 0.5 > 0 ? clock.begin : 0), clock.time); }
function toggleLoop() {
  clock.loop = !clock.loop;
  $("loop").setAttribute("aria-pressed", String(clock.loop));
}

function setVolume(volume) {
  clock.sound.volume = volume;
  clock.sound.muted = volume === 0;
  $("volume").value = volume;
  $("mute").setAttribute("aria-pressed", String(clock.sound.muted));
}

function toggleMute() {
  clock.sound.muted = !clock.sound.muted;
  $("mute").setAttribute("aria-pressed", String(clock.sound.muted));
}

// ---------------------------------------------------------------- hands on it

const look = (name) => { stage?.look(name); changed(); };
const zoom = (factor) => { timeline.zoom(factor, clock.time); changed(); };

function toggleTrails() {
  trails = !trails;
  for (const performer of stage?.performers ?? []) performer.trails.group.visible = trails;
  $("trails").setAttribute("aria-pressed", String(trails));
  changed();
}

let clipboard = null;

function copy() {
  clipboard = edits.copied(session.plan, ...inspector.stretch);
  notice(`${clipboard.length === 1 ? "A gesture is" : `${clipboard.length} blocks are`} copied: go to another place and press Ctrl V.`);
}

function paste() {
  if (!clipboard) return;
  const [first] = inspector.stretch, gestures = clipboard.slice(0, session.plan.blocks.length - first);
  session.edit(edits.pasted(session.plan, first, gestures));
  session.select(first, first + gestures.length - 1);
}

/** Stretch the selected blocks by seconds; the block after them gives way. */
function stretch(by) {
  const [first, last] = inspector.stretch;
  session.edit(edits.stretched(session.plan, first, last, session.plan.blocks[last].end + by), "stretch");
}

function toggleCurve() {
  timeline.curved = !timeline.curved;
  $("curve").setAttribute("aria-pressed", String(timeline.curved));
  refresh();
}

/** Select the gesture at the playhead, or, where that is selected, the next one. spans: those that there are. */
function selectNext(spans) {
  const { plan, selection } = session, own = (span) => edits.blocksOfUnit(plan, span);
  const here = spans.findIndex(({ end }) => end > clock.time + 1e-3), there = here >= 0 && selection && own(spans[here]).join() === selection.join();
  const span = spans[there ? here + 1 : here];
  if (!span) { notice("No gesture follows."); return; }
  session.select(...own(span));
  clock.pause();
  clock.seek(Math.max(span.start, plan.blocks[session.selection[0]].start) + 0.002);
}

const units = () => session.plan.units ?? [], phrases = () => units().flatMap(edits.phrasesOf);

/** Select one block more, or one less, at the end. */
function extend(way) {
  const [first, last] = inspector.stretch;
  session.select(first, clamp(last + way, first, session.plan.blocks.length - 1));
}

/** Move what is selected by a beat. */
function shift(way) {
  const [first, last] = inspector.stretch, place = first + way;
  if (place < 0 || place + last - first >= session.plan.blocks.length) return;
  session.edit(edits.movedTo(session.plan, first, last, place));
  session.select(place, place + last - first);
  clock.seek(session.plan.blocks[place].start + 0.002);
}

/** Move a beat by a frame: the one that is selected, or that which opens the block at the playhead. */
function moveBeat(way) {
  const beat = inspector.beat();
  if (beat < 1) return;
  session.edit(edits.moveBeat(session.plan, beat, session.plan.blocks[beat].start + way / session.take.fps), `beat ${beat}`);
  session.beat = beat;
}

/** Raise or lower the curve that is shown by a point at the playhead; 0 removes that point. */
function nudgeCurve(way) {
  if (!timeline.curved) toggleCurve();
  const { knob } = timeline, { low, high, step, neutral } = timeline.knobs[knob], time = Math.round(clock.time * 100) / 100;
  const points = curveOf(session.plan, knob), others = points.filter(([at]) => Math.abs(at - time) > 0.02);
  if (!way && others.length === points.length) { notice("No point of the curve is here."); return; }
  const now = valueAt(points, time) ?? neutral ?? (low + high) / 2, value = Math.round(clamp(now + 2 * way * step, low, high) / step) * step;
  session.edit(withCurve(session.plan, way ? [...others, [time, Number(value.toFixed(3))]] : others, knob), way ? `curve ${knob} ${time}` : null);
  notice(way ? `${timeline.knobs[knob].name} ${value.toFixed(2)} at ${minutes(time, 2)}` : "The point is removed.");
}

function toggleOf(id) { $(id).click(); }

/** Close what lies over the page; where nothing does, select nothing. */
function leave() {
  const shown = $("file-menu").open || palette?.open;
  $("file-menu").open = false;
  if (palette?.open) palette.toggle(false);
  if (!shown) session.select(null);
  document.activeElement?.blur();
}

const actions = {
  " ": () => clock.toggle(), "ArrowLeft": () => step(-1), "ArrowRight": () => step(1), "shift+ArrowLeft": () => stepBlock(-1),
  "shift+ArrowRight": () => stepBlock(1), "Home": () => clock.seek(clock.begin), "End": () => clock.seek(clock.end), "i": setIn, "o": setOut,
  "x": () => clock.setRange(null), "l": toggleLoop, "v": toggleMute,
  "h": () => toggleOf("silence"), "m": () => toggleOf("mirror"), "k": () => toggleOf("lock"), "[": () => inspector.nudge(-edits.INTENSITY.step),
  "]": () => inspector.nudge(edits.INTENSITY.step), "n": () => toggleOf("draw-again"), "b": () => inspector.addBeat(), "Delete": () => inspector.deleteBeat(),
  "Backspace": () => inspector.deleteBeat(), "ctrl+z": () => session.undo(), "ctrl+shift+z": () => session.redo(), "ctrl+y": () => session.redo(),
  ",": () => stretch(-0.02), ".": () => stretch(0.02), "ctrl+,": () => moveBeat(-1), "ctrl+.": () => moveBeat(1),
  "u": () => selectNext(units()), "j": () => selectNext(phrases()), "ctrl+shift+ArrowRight": () => extend(1), "ctrl+shift+ArrowLeft": () => extend(-1), "ctrl+ArrowRight": () => shift(1),
  "ctrl+ArrowLeft": () => shift(-1), "shift+ArrowUp": () => nudgeCurve(1), "shift+ArrowDown": () => nudgeCurve(-1), "shift+Delete": () => nudgeCurve(0),
  "ctrl+c": copy, "ctrl+v": paste,
  "ctrl+a": () => session.select(0, session.plan.blocks.length - 1), "ctrl+s": savePlan, "Escape": leave,
  "f": () => look("front"), "s": () => look("side"), "c": () => look("close"), "r": () => look("reset"), "t": toggleTrails, "d": toggleTogether, "y": toggleGhost,
  "p": () => palette?.toggle(), "g": () => { if (data.live) pins.toggle(); },
  "a": () => session.activate(1 - session.active), "+": () => zoom(1.3), "=": () => zoom(1.3), "-": () => zoom(1 / 1.3), "?": () => $("sheet").showModal(),
  ...Object.fromEntries([1, 2, 3, 4, 5].map((rank) => [String(rank), () => inspector.chooseRank(rank)])),
};

function bindDesk() {
  const click = (id, act) => $(id).addEventListener("click", () => { act(); $("file-menu").open = false; });
  click("play", () => clock.toggle());
  click("back", () => step(-1));
  click("forward", () => step(1));
  click("loop", toggleLoop);
  click("set-in", setIn);
  click("set-out", setOut);
  click("clear-range", () => clock.setRange(null));
  click("mute", toggleMute);
  click("zoom-in", () => zoom(1.3));
  click("zoom-out", () => zoom(1 / 1.3));
  click("undo", () => session.undo());
  click("redo", () => session.redo());
  click("save-plan", savePlan);
  click("open-plan", () => $("pick-plan").click());
  click("open-character", () => $("pick-character").click());
  click("open-motion", () => $("pick-motion").click());
  click("own-figure", undress);
  click("export-glb", () => exportAs("glb"));
  click("export-vrma", () => exportAs("vrma"));
  click("trails", toggleTrails);
  click("curve", toggleCurve);
  click("pose", () => pins.toggle());
  click("together", toggleTogether);
  click("ghost", toggleGhost);
  click("help", () => $("sheet").showModal());
  click("notice", () => notice(""));
  click("stale-reload", () => live.reload());
  click("stale-both", () => live.keepBoth());
  $("volume").addEventListener("input", (event) => setVolume(Number(event.target.value)));
  $("take").addEventListener("change", (event) => session.activate(Number(event.target.value)));
  $("speed").addEventListener("change", (event) => clock.setSpeed(Number(event.target.value)));
  for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => look(button.dataset.view));
  timeline.canvas.setAttribute("aria-valuemax", data.duration.toFixed(3));
  addEventListener("click", (event) => {
    if (!event.target.closest?.("#file-menu")) $("file-menu").open = false;
    // What was clicked with a pointer leaves the keys to the page: space plays, and does not press the button again.
    if (event.detail) event.target.closest?.("button, summary, input[type=range]")?.blur();
  });
  addEventListener("change", (event) => { if (event.target.matches("select")) event.target.blur(); });
  addEventListener("beforeunload", (event) => {
    const lost = data.live ? live.unsaved : !kept?.whole && session.plan !== session.original;
    if (lost && session.plan !== saved) event.preventDefault();
  });
}

// ---------------------------------------------------------------- one picture after the other

let last = 0, panelFor = -1;

function tick(now) {
  const easing = stage?.ease((now - last) / 1000) ?? false;
  last = now;
  clock.tick();
  if (dirty || easing || clock.playing) {
    dirty = false;
    const time = clamp(clock.time, 0, data.duration);
    timeline.follow(time, clock.playing);
    const block = edits.blockAt(session.plan, time);
    if (panelFor !== block) { panelFor = block; inspector.update(); palette?.mark(); }
    writeClock(time);
    timeline.draw(time);
    stage?.draw(time, () => pins.show());
    if (together) placeLabels();
  }
  requestAnimationFrame(tick);
}

function resized() {
  readTheme();
  timeline.layout();
  timeline.fit();
  stage?.resize();
  changed();
}

function refresh() {
  panelFor = -1;
  timeline.layout();
  writeFacts();
  changed();
}

function raise() {
  try {
    stage = new Stage($("figure"));
    bindStage(stage, changed);
    performers();
  } catch (error) {
    $("stage-message").textContent = `The figure needs WebGL, which this browser does not offer here (${error.message}).`;
    $("stage-message").hidden = false;
  }
}

readTheme();
fillSheet();
bindDesk();
bindKeys(actions);
bindFiles(takeFile);
new TimelineHands(timeline, session, clock, changed);
session.on("edited", refresh);
session.on("selected", refresh);
session.on("takes", performers);
session.on("refused", () => notice("A motion from a file has no plan to edit: choose the other take."));
const live = new Live(session, data.live, status, {
  unsaved: (why) => { $("unsaved").hidden = !why; $("unsaved").title = why; notice(why ? `${why}. They are in this page, and saving is tried again.` : "The edits are saved again.", Boolean(why)); },
  copied: (text) => notice(text),
  stale: (shown) => { $("stale").hidden = !shown; },
});
const kept = !data.live && session.lanes.length === 1 && session.plan.sound?.sha256
  ? new Kept(session, `file ${session.plan.sound.sha256.slice(0, 16)} ${session.plan.seed}`, notice) : null;
const palette = data.live ? new Palette(session, clock, live, async () => {
  const answer = await fetch("figures");
  if (!answer.ok) throw new Error(answer.statusText);
  return answer.json();
}, timeline) : null;
const pins = new Pins(session, clock, () => stage, changed);
$("pose").hidden = !data.live;
$("palette-open").hidden = !palette;
$("variations").hidden = !data.live;
$("variations").replaceChildren(...[1, 2, 3].map((number) => {
  const plan = () => edits.varied(session.plan, ...inspector.stretch, number), see = () => live.try(plan()), leave = () => live.forget();
  return element("button", { "type": "button", "title": `Variation ${number} of these blocks: hover to see it, click to take it`, "aria-label": `Variation ${number}`,
    "onpointerenter": see, "onpointerleave": leave, "onfocus": see, "onblur": leave, "onclick": () => { leave(); session.edit(plan()); } }, `V${number}`);
}));
bindCurves(session, timeline, refresh);
bindDirections(session, data.live?.speakers);
if (curveOf(session.plan).length) toggleCurve();
clock.load(data.sound, data.soundType, () => notice("This browser cannot play the sound (Ogg Vorbis).", true));
refresh();
resized();
raise();
writeLabels();
if (data.together && session.lanes.length > 1) {
  toggleTogether();
  if (stage) stage.view = { ...stage.goal };
}
resized();
new ResizeObserver(resized).observe($("stage"));
new ResizeObserver(resized).observe($("desk"));
const repaint = () => { readTheme(); stage?.paint(); refresh(); };
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
// The page is that of the beginning: what was edited since is a step that can be undone.
if (data.live) await live.follow();
if (data.notice) notice(data.notice);
if (data.character) await wear(bytesOf(data.character.data), data.character);
// For the console: what is open, and the pose as the figure has it.
window.preview = { clock, live, pins, timeline, session, inspector, takeFile, exports: { vrmaOf, characterGlb, figureGlb }, get stage() { return stage; }, get worn() { return worn; } };
requestAnimationFrame(tick);
document.body.dataset.ready = "true";

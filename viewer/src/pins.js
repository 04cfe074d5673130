// Pose pins: a hand or the head is put to a place at a moment, and the motion goes through it. Metres, seconds; the floor
// is at 0. A plan with other pins is a new plan.

import { Matrix4, Plane, Quaternion, Raycaster, Vector2, Vector3 } from "three";

import { $, element, notice } from "./dom.js";
import { clamp, minutes } from "./numbers.js";
import { Poser } from "./take.js";

/** Joints that can be put to a place, and what they are called. */
export const PLACED = { LeftHand: "left hand", RightHand: "right hand", Head: "head" };
/** Of an arm's length up to which a hand can be put, and metres from the shoulder from which on; as the renderer has it. */
const STRETCHED = 0.97, NEAREST = 0.2;
/** Metres of a step with an arrow key. */
const STEP = 0.02;

export const pinsOf = (plan) => plan.pins ?? [];

/** A plan with these pins, by their times; without any, without the list. */
export function withPins(plan, pins) {
  const { pins: _, ...rest } = plan;
  return pins.length ? { ...rest, pins: [...pins].sort((a, b) => a.time - b.time) } : rest;
}

/** The pin of a joint that is in force at a time; -1 without one. near: seconds around it. */
export const pinAt = (plan, joint, time, near) => pinsOf(plan).findIndex((pin) => (
  pin.joint === joint && time > pin.time - near && time < pin.time + (pin.hold ?? 0) + near));

/** A plan with a joint at a place at a time: of the pin that is there, or of a new one. */
export function pinTo(plan, joint, time, position, near) {
  const pins = pinsOf(plan), at = pinAt(plan, joint, time, near), place = position.map((value) => Math.round(value * 1e4) / 1e4);
  const made = at < 0 ? { time: Math.round(time * 1e4) / 1e4, joint, position: place } : { ...pins[at], position: place };
  return withPins(plan, at < 0 ? [...pins, made] : pins.map((pin, k) => (k === at ? made : pin)));
}

/** A pin at another time: [plan, the pin as it is there]. */
export function movePin(plan, pin, time) {
  const moved = { ...pin, time: Math.round(time * 1e4) / 1e4 };
  return pinsOf(plan).includes(pin) ? [withPins(plan, pinsOf(plan).map((one) => (one === pin ? moved : one))), moved] : [plan, pin];
}

/** Where joints are in a take at a time: name -> place. */
export function placesOf(take, time) {
  const poser = new Poser(take).set(time), { names, parents, offsets } = take.skeleton, places = [];
  names.forEach((name, j) => {
    const above = parents[j];
    places.push(above < 0 ? new Vector3().fromArray(poser.root)
      : new Vector3().fromArray(offsets[j]).applyQuaternion(poser.turn(names[above], new Quaternion())).add(places[above]));
  });
  return Object.fromEntries(names.map((name, j) => [name, places[j]]));
}

/** Turn a bone by a turn of the world. */
function turnBy(bone, turn) {
  const above = bone.parent.getWorldQuaternion(new Quaternion());
  bone.quaternion.premultiply(above).premultiply(turn).premultiply(above.invert());
  bone.updateWorldMatrix(false, true);
}

const placeOf = (bone) => new Vector3().setFromMatrixPosition(bone.matrixWorld);
const between = (a, b) => new Quaternion().setFromUnitVectors(a.clone().normalize(), b.clone().normalize());

/** Our figure with a hand or the head at a place of the world, about as the renderer will have it. */
export function reach(figure, joint, goal) {
  figure.group.updateWorldMatrix(true, true);
  if (joint === "Head") {
    const spine = figure.bone("Spine"), from = placeOf(spine);
    turnBy(spine, between(placeOf(figure.bone("Head")).sub(from), goal.clone().sub(from)));
    return;
  }
  const side = joint.replace("Hand", ""), arm = figure.bone(`${side}Arm`), fore = figure.bone(`${side}ForeArm`), hand = figure.bone(joint);
  const shoulder = placeOf(arm), way = () => placeOf(hand).sub(shoulder);
  turnBy(arm, between(way(), goal.clone().sub(shoulder)));
  const upper = placeOf(fore).sub(shoulder), lower = placeOf(hand).sub(placeOf(fore)), a = upper.length(), b = lower.length();
  const far = clamp(goal.distanceTo(shoulder), Math.abs(a - b) + 1e-3, (a + b) * 0.999);
  const wanted = Math.acos(clamp((far * far - a * a - b * b) / (2 * a * b), -1, 1)), axis = new Vector3().crossVectors(upper, lower);
  if (axis.length() > 1e-6) turnBy(fore, new Quaternion().setFromAxisAngle(axis.normalize(), wanted - upper.angleTo(lower)));
  turnBy(arm, between(way(), goal.clone().sub(shoulder)));
}

/** Handles at the hands and the head of the one that is edited, and the list of pins in the panel. */
export class Pins {
  constructor(session, clock, stageOf, changed) {
    Object.assign(this, { session, clock, stageOf, changed, on: false, drag: null });
    this.handles = Object.keys(PLACED).map((joint) => this.handle(joint));
    $("handles").replaceChildren(...this.handles);
    session.on("edited", () => this.list());
    session.on("takes", () => { this.drag = null; });
    // What the renderer refuses (a place inside the body) is taken back.
    session.on("unrendered", () => {
      if (this.last !== session.plan) return;
      this.last = null;
      session.undo();
    });
    this.list();
  }

  toggle() {
    this.on = !this.on;
    if (this.on) this.clock.pause();
    $("pose").setAttribute("aria-pressed", String(this.on));
    $("handles").hidden = !this.on;
    this.changed();
  }

  get near() { return 0.5 / this.session.take.fps; }
  get performer() { return this.stageOf()?.performers.find((one) => one.take === this.session.take) ?? this.stageOf()?.performers[0]; }

  /** The time of the frame under the playhead. */
  get moment() { return Math.min(Math.floor(this.clock.time * this.session.take.fps + 1e-3), this.session.take.frames - 1) / this.session.take.fps; }

  handle(joint) {
    const handle = element("button", {
      "type": "button", "className": "handle", "data-joint": joint, "aria-label": `Pin the ${PLACED[joint]}: arrow keys, page up and page down move it`,
      "title": `Drag the ${PLACED[joint]} to a place (wheel: nearer, farther)`,
    });
    handle.addEventListener("pointerdown", (event) => this.down(event, joint));
    handle.addEventListener("pointermove", (event) => this.move(event, joint));
    handle.addEventListener("pointerup", (event) => this.up(event, joint));
    handle.addEventListener("pointercancel", () => { this.drag = null; this.changed(); });
    handle.addEventListener("wheel", (event) => { event.preventDefault(); this.nudge(joint, [0, 0, event.deltaY > 0 ? -STEP : STEP]); }, { passive: false });
    handle.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: [-STEP, 0, 0], ArrowRight: [STEP, 0, 0], ArrowUp: [0, STEP, 0], ArrowDown: [0, -STEP, 0], PageUp: [0, 0, -STEP], PageDown: [0, 0, STEP] }[event.key];
      if (!way) return;
      event.preventDefault();
      event.stopPropagation();
      this.nudge(joint, way);
    });
    return handle;
  }

  /** Where a joint stands in the world: of the character that is shown, or of our figure. */
  shownAt(joint) {
    const { performer } = this, node = performer.character?.node(joint);
    if (node) return node.getWorldPosition(new Vector3());
    return placesOf(performer.take, this.moment)[joint].add(performer.group.position);
  }

  /** Metres of our figure for a metre of what is shown: a character's arms may be longer. */
  scale() {
    const { performer } = this, { character } = performer;
    const [arm, hand] = ["LeftArm", "LeftHand"].map((joint) => character?.node(joint)), fore = character?.node("LeftForeArm");
    if (!arm || !hand || !fore) return 1;
    const [a, b, c] = [arm, fore, hand].map((node) => node.getWorldPosition(new Vector3()));
    return this.arm("Left") / Math.max(a.distanceTo(b) + b.distanceTo(c), 1e-3);
  }

  /** The length of an arm. */
  arm(side) {
    const { offsets, names } = this.session.take.skeleton;
    return ["ForeArm", "Hand"].reduce((sum, part) => sum + Math.hypot(...offsets[names.indexOf(side + part)]), 0);
  }

  down(event, joint) {
    if (event.button > 0 || this.session.lane.fixed) return;
    event.currentTarget.setPointerCapture(event.pointerId);
    event.stopPropagation();
    const stage = this.stageOf(), from = this.shownAt(joint), plane = new Plane().setFromNormalAndCoplanarPoint(stage.camera.getWorldDirection(new Vector3()), from);
    this.drag = { joint, from, to: from.clone(), plane, time: this.moment, begin: this.pointed(event, plane) };
  }

  /** The place on a plane under the pointer. */
  pointed(event, plane) {
    const { canvas, camera } = this.stageOf(), box = canvas.getBoundingClientRect(), ray = new Raycaster();
    ray.setFromCamera(new Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2), camera);
    return ray.ray.intersectPlane(plane, new Vector3());
  }

  move(event, joint) {
    const { drag } = this;
    if (drag?.joint !== joint) return;
    const now = this.pointed(event, drag.plane);
    if (!now || !drag.begin) return;
    drag.to.copy(drag.from).add(now).sub(drag.begin);
    drag.moved = true;
    event.currentTarget.classList.toggle("far", Boolean(this.beyond(joint, this.goal(joint, drag))));
    this.changed();
  }

  /** The place in the plan for what was dragged. */
  goal(joint, { from, to, time }) {
    const places = placesOf(this.session.take, time), goal = to.clone().sub(from).multiplyScalar(this.scale()).add(places[joint]);
    if (joint !== "Head") return goal;
    // The head stays on the curve that the spine allows.
    const spine = places.Spine;
    return goal.sub(spine).setLength(places.Head.distanceTo(spine)).add(spine);
  }

  /** What keeps a hand from a place, in words; null where nothing does. */
  beyond(joint, goal) {
    if (joint === "Head") return null;
    const side = joint.replace("Hand", ""), far = placesOf(this.session.take, this.moment)[`${side}Arm`].distanceTo(goal), most = STRETCHED * this.arm(side);
    if (far <= most && far >= NEAREST) return null;
    return far > most ? `The ${side.toLowerCase()} arm reaches ${most.toFixed(2)} m: this place is ${far.toFixed(2)} m from its shoulder.`
      : `This place is ${far.toFixed(2)} m from the shoulder: a wrist gets no nearer than ${NEAREST.toFixed(2)} m.`;
  }

  up(event, joint) {
    const { drag } = this;
    if (drag?.joint !== joint) return;
    event.currentTarget.classList.remove("far");
    if (!drag.moved) { this.drag = null; return; }
    this.take(joint, drag);
  }

  /** Put a joint where it was dragged to, or say why not. */
  take(joint, drag, kind = null) {
    const goal = this.goal(joint, drag), why = this.beyond(joint, goal);
    // The drag is shown until the frames come.
    if (why) { this.drag = null; notice(why, true); this.changed(); return; }
    notice("");
    const plan = pinTo(this.session.plan, joint, drag.time, goal.toArray(), this.near);
    this.session.edit(plan, kind);
    this.last = this.session.plan;
  }

  /** Move a joint by a step: to the right, up and towards the viewer. */
  nudge(joint, way) {
    if (this.session.lane.fixed) return;
    const time = this.moment, at = pinAt(this.session.plan, joint, time, this.near), turn = this.stageOf().camera.quaternion;
    const places = placesOf(this.session.take, time), from = at < 0 ? places[joint] : new Vector3().fromArray(pinsOf(this.session.plan)[at].position ?? places[joint].toArray());
    const to = from.clone().add(new Vector3(...way).applyQuaternion(turn)), goal = joint === "Head" ? to.sub(places.Spine).setLength(places.Head.distanceTo(places.Spine)).add(places.Spine) : to;
    const why = this.beyond(joint, goal);
    if (why) { notice(why, true); return; }
    this.session.edit(pinTo(this.session.plan, joint, time, goal.toArray(), this.near), `pin ${joint}`);
    this.last = this.session.plan;
  }

  /** After the figure was posed: what is dragged, and where the handles are. */
  show() {
    if (!this.on) return;
    const stage = this.stageOf(), { performer } = this;
    if (!performer) return;
    if (this.drag?.moved && !performer.character) reach(performer.figure, this.drag.joint, this.drag.to);
    for (const handle of this.handles) {
      const { joint } = handle.dataset, place = this.drag?.joint === joint ? this.drag.to.clone() : this.shownAt(joint);
      place.applyMatrix4(new Matrix4().multiplyMatrices(stage.camera.projectionMatrix, stage.camera.matrixWorldInverse));
      handle.style.left = `${((place.x + 1) / 2) * stage.canvas.clientWidth}px`;
      handle.style.top = `${((1 - place.y) / 2) * stage.canvas.clientHeight}px`;
      handle.hidden = this.clock.playing || this.session.lane.fixed === true;
      handle.classList.toggle("pinned", pinAt(this.session.plan, joint, this.moment, this.near) >= 0);
    }
  }

  /** The pins in the panel: go there, how long they hold, away with them. */
  list() {
    const { plan } = this.session, pins = pinsOf(plan);
    $("poses").hidden = !pins.length;
    if ($("pins").contains(document.activeElement) && document.activeElement.matches("input")) return;
    $("pins").replaceChildren(...pins.map((pin, k) => {
      const name = PLACED[pin.joint] ?? pin.joint, told = `${name} at ${minutes(pin.time, 2)}`;
      const change = (made) => this.session.edit(withPins(this.session.plan, pinsOf(this.session.plan).map((one, other) => (other === k ? { ...one, ...made } : one))));
      const hold = element("input", { type: "number", min: 0, max: 10, step: 0.1, value: pin.hold ?? 0, title: "Seconds that it holds", "aria-label": `Seconds that the pin of the ${told} holds`,
        onchange: (event) => change({ hold: clamp(Number(event.target.value) || 0, 0, 10) }) });
      return element("li", {}, element("button", { "type": "button", "className": "go", "title": "Go there", "onclick": () => this.clock.seek(pin.time + 0.02 / this.session.take.fps) }, told),
        element("label", {}, "holds ", hold, " s"),
        element("button", { "type": "button", "aria-label": `Remove the pin of the ${told}`, "onclick": () => this.session.edit(withPins(this.session.plan, pinsOf(this.session.plan).filter((_, other) => other !== k))) }, "×"));
    }));
  }
}

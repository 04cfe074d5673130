// What a pointer does on the timeline: scrub, select blocks, move beats, drag the range, pinch and wheel to zoom.

import { cuesOf, cueTime, moveCue } from "./cues.js";
import { curveOf, withCurve } from "./curves.js";
import { notice } from "./dom.js";
import { clamp } from "./numbers.js";
import { movePin, pinsOf } from "./pins.js";
import { blockAt, blocksOfUnit, dragged, marksOf, moveBeat, phrasesOf, snapped, stretched } from "./plan.js";
import { sizes } from "./theme.js";

/** CSS pixels around a handle in which it is taken, for a mouse and for a finger. */
const NEAR = { mouse: 6, pen: 8, touch: 16 };
/** CSS pixels within which what is dragged snaps to words and beats. */
const SNAPS = 7;

/** A point of the curve at a place: [seconds, value]. */
const pointAt = (timeline, x, y) => [Math.round(clamp(timeline.timeAt(x), 0, timeline.duration) * 1000) / 1000, timeline.curveValue(y)];

export class TimelineHands {
  constructor(timeline, session, clock, changed) {
    Object.assign(this, { timeline, session, clock, changed });
    this.pointers = new Map();
    this.drag = null;
    const { canvas, overview } = timeline;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.up(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.bindOverview(overview);
  }

  place(event, canvas = this.timeline.canvas) {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** What lies under a place: { kind, ... }. */
  hit(x, y, pointer) {
    const { timeline, session, clock } = this, { rows } = timeline, near = (NEAR[pointer] ?? 8) * sizes.unit;
    const within = (row) => y >= row.top && y < row.top + row.tall;
    if (within(rows.ruler) && clock.range) {
      const handle = clock.range.findIndex((time) => Math.abs(timeline.x(time) - x) < near + 4);
      if (handle >= 0) return { kind: "range", handle };
    }
    if (within(rows.cues)) {
      const cues = cuesOf(session.plan), cue = cues.findIndex((one) => {
        const time = cueTime(session.plan, one);
        return time !== null && x >= timeline.x(time) - 4 && x < timeline.x(time) + 70 * sizes.unit;
      });
      if (cue >= 0) return { kind: "cue", cue };
    }
    if (within(rows.beats)) {
      const time = timeline.timeAt(x), { blocks } = session.plan, k = blockAt(session.plan, time);
      const beat = [k, k + 1].filter((b) => b > 0 && b < blocks.length)
        .sort((a, b) => Math.abs(blocks[a].start - time) - Math.abs(blocks[b].start - time))[0];
      if (beat && Math.abs(timeline.x(blocks[beat].start) - x) < near) return { kind: "beat", beat };
    }
    if (rows.curve.tall && within(rows.curve)) {
      const points = curveOf(session.plan, timeline.knob);
      return { kind: "point", point: points.findIndex(([time, value]) => Math.hypot(timeline.x(time) - x, timeline.curveY(value) - y) < near + 3) };
    }
    if (rows.pins.tall && within(rows.pins)) {
      // Signs before bars: a pin may lie within the time that another one holds.
      const pins = pinsOf(session.plan), sign = pins.findIndex(({ time }) => Math.abs(timeline.x(time) - x) < near);
      const pin = sign >= 0 ? sign : pins.findIndex(({ time, hold = 0 }) => x > timeline.x(time) && x < timeline.x(time + hold));
      if (pin >= 0) return { kind: "pin", pin };
    }
    if (within(rows.units)) {
      const time = timeline.timeAt(x), unit = session.plan.units.find(({ start, end }) => time >= start && time < end);
      if (unit) return { kind: "unit", unit };
    }
    if (session.selection && within(rows.blocks)) {
      const [first, last] = session.selection;
      if (last + 1 < session.plan.blocks.length && Math.abs(timeline.x(session.plan.blocks[last].end) - x) < near) return { kind: "stretch", first, last };
    }
    if (y >= rows.gap.top) return { kind: "block", block: blockAt(session.plan, timeline.timeAt(x)) };
    return { kind: "time" };
  }

  down(event) {
    if (event.button > 0) return;
    const { timeline, clock, session } = this, [x, y] = this.place(event);
    timeline.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, x);
    if (this.pointers.size > 1) { this.drag = { kind: "pinch", spread: this.spread(), resume: false }; return; }
    const hit = this.hit(x, y, event.pointerType);
    this.marks = marksOf(session.plan, session.original);
    this.drag = { ...hit, plan: session.plan, begun: x, resume: hit.kind === "time" && clock.playing };
    if (this.drag.resume) clock.pause();
    timeline.held = true;
    if (hit.kind === "block") this.pick(hit.block, event.shiftKey);
    else if (hit.kind === "beat") session.selectBeat(hit.beat);
    else if (hit.kind === "cue") clock.seek(cueTime(session.plan, cuesOf(session.plan)[hit.cue]));
    else if (hit.kind === "pin") this.takePin(hit.pin);
    else if (hit.kind === "point") this.takePoint(hit.point, x, y);
    else if (hit.kind === "unit") this.takeUnit(hit.unit, event.shiftKey, timeline.timeAt(x));
    else if (hit.kind === "time") this.scrub(x);
    this.changed();
  }

  /** Take a point of the curve, or set one; a second click on a point removes it. */
  takePoint(point, x, y) {
    const { session, timeline } = this, points = curveOf(session.plan, timeline.knob), now = performance.now();
    if (point >= 0) {
      if (now - (this.clicked ?? 0) < 350) {
        session.edit(withCurve(session.plan, points.filter((_, k) => k !== point), timeline.knob));
        this.drag.kind = "none";
      }
      this.clicked = now;
      return;
    }
    const made = pointAt(timeline, x, y);
    session.edit(withCurve(session.plan, [...points, made], timeline.knob), "curve");
    this.drag.point = curveOf(session.plan, timeline.knob).findIndex(([time]) => time === made[0]);
  }

  /** Go to a pin, and take it along. */
  takePin(pin) {
    this.drag.one = pinsOf(this.session.plan)[pin];
    this.clock.seek(this.drag.one.time + 0.02 / this.session.take.fps);
  }

  /** A time, or a word's or beat's near it; with Alt the time itself. */
  snap(time, event) {
    const at = event.altKey ? time : snapped(time, this.marks, (SNAPS * sizes.unit) / this.timeline.scale);
    this.timeline.guide = at === time ? null : at;
    return at;
  }

  /** Select a gesture (a phrase of a unit), unless the blocks under the pointer are selected: those may be dragged. */
  takeUnit(unit, extend, time) {
    const { selection, plan } = this.session, block = blockAt(plan, time);
    this.drag.time = time;
    this.drag.held = !extend && selection && block >= selection[0] && block <= selection[1];
    if (!this.drag.held) this.pickUnit(this.phraseAt(unit, time), extend);
  }

  /** The phrase of a unit at a time. A unit may last from the first word to the last: its strokes are what is moved. */
  phraseAt(unit, time) { return phrasesOf(unit).find(({ start, end }) => time >= start && time < end) ?? unit; }

  /** A click on a gesture that is selected selects its whole unit, and another one the gesture again. */
  clickUnit({ unit, time }) {
    const { selection, plan } = this.session, phrase = this.phraseAt(unit, time);
    this.pickUnit(blocksOfUnit(plan, phrase).join() === selection.join() ? unit : phrase, false);
  }

  /** Select the blocks of a gesture unit, or with shift all up to its end. */
  pickUnit(unit, extend) {
    const { session, clock } = this, [first, last] = blocksOfUnit(session.plan, unit);
    session.select(extend && session.selection ? Math.min(session.selection[0], first) : first, last);
    if (!extend && !clock.playing) clock.seek(session.plan.blocks[first].start + 0.002);
  }

  /** Select a block, or with shift all up to it; a stopped playhead goes there. */
  pick(block, extend) {
    const { session, clock } = this;
    if (extend && session.selection) session.select(session.selection[0], block);
    else {
      this.drag.from = block;
      session.select(block);
      if (!clock.playing) clock.seek(session.plan.blocks[block].start + 0.002);
    }
  }

  scrub(x) { this.clock.seek(this.timeline.timeAt(x)); }

  move(event) {
    const { timeline, session, clock } = this, [x, y] = this.place(event);
    if (!this.pointers.has(event.pointerId)) {
      const { kind, block } = this.hit(x, y, event.pointerType);
      timeline.canvas.title = kind === "unit" ? "a gesture: click to select its blocks, again for its whole unit; drag to move it, with Ctrl a copy of it" : kind === "stretch" ? "drag to stretch or squeeze the selected blocks" : kind === "pin" ? "a pinned pose: click to go there, drag to another moment" : kind === "cue" ? "drag to another word" : kind === "block" ? session.plan.blocks[block].name ?? "" : kind === "beat" ? "drag to move, Delete to take away" : "";
      timeline.canvas.style.cursor = { beat: "col-resize", range: "ew-resize", block: "pointer", unit: "pointer", cue: "grab", pin: "grab", stretch: "ew-resize", point: "crosshair" }[kind] ?? "text";
      return;
    }
    this.pointers.set(event.pointerId, x);
    const time = timeline.timeAt(x), { drag } = this;
    timeline.guide = null;
    if (drag.kind === "pinch") this.pinch();
    else if (drag.kind === "time") this.scrub(x);
    else if (drag.kind === "beat") {
      session.edit(moveBeat(session.plan, drag.beat, this.snap(time, event)), `beat ${drag.beat}`);
      session.beat = drag.beat;
    } else if (drag.kind === "point" && drag.point >= 0) {
      const points = curveOf(session.plan, timeline.knob), [low, high] = [points[drag.point - 1]?.[0] ?? -0.01, points[drag.point + 1]?.[0] ?? clock.duration + 0.01];
      const [at, value] = pointAt(timeline, x, y);
      points[drag.point] = [clamp(at, low + 0.01, high - 0.01), value];
      session.edit(withCurve(session.plan, points, timeline.knob), "curve");
    } else if (drag.kind === "stretch") {
      session.edit(stretched(drag.plan, drag.first, drag.last, this.snap(time, event)), "stretch");
    } else if (drag.kind === "unit") {
      if (Math.abs(x - drag.begun) > 4 || drag.moved) this.dragBlocks(x, event);
    } else if (drag.kind === "pin") {
      if (Math.abs(x - drag.begun) > 4 || drag.moved) {
        drag.moved = true;
        const [plan, one] = movePin(session.plan, drag.one, clamp(this.snap(time, event), 0, clock.duration));
        session.edit(plan, "pin moved");
        drag.one = one;
      }
    } else if (drag.kind === "cue") {
      if (Math.abs(x - drag.begun) > 4 || drag.moved) {
        drag.moved = true;
        session.edit(moveCue(session.plan, drag.cue, clamp(time, 0, clock.duration)), `cue ${drag.cue}`);
      }
    } else if (drag.kind === "block" && drag.from !== undefined) {
      const to = blockAt(session.plan, time);
      if (to !== (session.selection ?? [])[1] || to !== drag.from) session.select(drag.from, to);
    } else if (drag.kind === "range") {
      const range = [...clock.range];
      range[drag.handle] = clamp(this.snap(time, event), 0, clock.duration);
      if (range[1] - range[0] > 0.1) clock.setRange(...range);
    }
    this.changed();
  }

  /** Take the selected blocks along; with Ctrl a copy of them. */
  dragBlocks(x, event) {
    const { drag, session, timeline } = this, { blocks } = drag.plan;
    drag.moved ??= session.selection;
    const [first, last] = drag.moved, from = blocks[first].start, to = clamp(from + (x - drag.begun) / timeline.scale, 0, this.clock.duration);
    const [plan, place] = dragged(drag.plan, first, last, this.snap(to, event), event.ctrlKey || event.metaKey);
    drag.stuck = plan === drag.plan;
    session.edit(plan, "dragged");
    session.select(place, place + last - first);
  }

  /** Why blocks stay where they were dragged from. */
  whyStuck([first, last]) {
    const { blocks } = this.session.plan;
    if (last - first + 1 === blocks.length) return "The whole recording is selected, so there is nowhere to move it: click one gesture, and drag that.";
    return first && last + 1 < blocks.length ? "The blocks beside it cannot give way that far (a block lasts 0.1 to 1 s): drag it to another beat."
      : `It ${first ? "ends" : "begins"} with the recording, and moves by whole beats: drag it further.`;
  }

  up(event) {
    if (!this.pointers.delete(event.pointerId) || this.pointers.size) return;
    this.timeline.held = false;
    this.timeline.guide = null;
    if (this.drag.held && !this.drag.moved) this.clickUnit(this.drag);
    if (this.drag.stuck) notice(this.whyStuck(this.drag.moved));
    if (this.drag.kind === "unit" && this.drag.moved && !this.clock.playing) this.clock.seek(this.session.plan.blocks[this.session.selection[0]].start + 0.002);
    this.session.lane.history.settle();
    if (this.drag.kind === "beat") this.session.tell("settled");
    if (this.drag.resume) this.clock.play();
    this.drag = null;
    this.changed();
  }

  spread() {
    const [a, b] = [...this.pointers.values()];
    return Math.max(Math.abs(a - b), 10);
  }

  pinch() {
    const spread = this.spread(), [a, b] = [...this.pointers.values()];
    this.timeline.zoom(spread / this.drag.spread, this.timeline.timeAt((a + b) / 2));
    this.drag.spread = spread;
  }

  wheel(event) {
    event.preventDefault();
    const { timeline } = this;
    if (event.ctrlKey || event.metaKey) timeline.zoom(Math.exp(-clamp(event.deltaY, -120, 120) * 0.003), timeline.timeAt(event.offsetX));
    else {
      timeline.left += (event.deltaX + event.deltaY) / timeline.scale;
      timeline.fit();
    }
    this.changed();
  }

  bindOverview(overview) {
    let down = false;
    const go = (event) => this.clock.seek((this.place(event, overview)[0] / overview.clientWidth) * this.clock.duration);
    overview.addEventListener("pointerdown", (event) => { overview.setPointerCapture(event.pointerId); down = true; go(event); });
    overview.addEventListener("pointermove", (event) => { if (down) go(event); });
    for (const end of ["pointerup", "pointercancel"]) overview.addEventListener(end, () => { down = false; });
  }
}

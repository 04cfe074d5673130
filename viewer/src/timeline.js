// The timeline: ruler, words, gestures asked for, beats, waveform, blocks and an overview of the whole.

import { curveOf, knobsOf } from "./curves.js";
import { cuesOf, cueTime } from "./cues.js";
import { clamp, minutes } from "./numbers.js";
import { PLACED, pinsOf } from "./pins.js";
import { beatFlag, blockAt, differs } from "./plan.js";
import { drawSign, flagColour } from "./signs.js";
import { colours, lexemeColour, sizes } from "./theme.js";

const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 30, 60, 120, 300, 600];

/** How strongly each phase of a gesture unit is coloured. */
const PHASES = { "preparation": 0.3, "pre-stroke hold": 0.3, "stroke": 0.85, "post-stroke hold": 0.3, "retraction": 0.18 };

/** A canvas that knows its size in CSS pixels. */
function sharp(canvas) {
  const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  const w = Math.round(width * ratio), h = Math.round(height * ratio);
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

export class Timeline {
  constructor(canvas, overview, session, wave, clock) {
    Object.assign(this, { canvas, overview, session, wave, clock, scale: 0, left: 0, held: false });
    this.duration = clock.duration;
    this.knobs = knobsOf(session.data.live?.levels);
    /** The knob whose curve is shown in the row of curves. */
    this.knob = "intensity";
  }

  get width() { return this.canvas.clientWidth; }
  get span() { return this.width / this.scale; }
  get whole() { return this.span >= this.duration - 1e-6; }
  timeAt(x) { return this.left + x / this.scale; }
  x(time) { return (time - this.left) * this.scale; }

  /** Where each row begins, in CSS pixels. */
  layout() {
    const u = sizes.unit, { plan } = this.session, rows = {};
    let y = 0;
    const row = (name, tall) => { rows[name] = { top: y, tall: tall * u }; y += tall * u; };
    row("ruler", 18);
    row("cues", cuesOf(plan).length ? 20 : 0);
    // A phone held sideways has little height.
    const low = innerHeight <= 520;
    row("words", plan.words?.length ? (low ? 15 : 28) : 0);
    row("beats", 18);
    row("wave", low ? 26 : 52);
    row("gap", 4);
    row("curve", this.curved ? 44 : 0);
    row("pins", pinsOf(plan).length ? 17 : 0);
    row("units", plan.units?.length ? 15 : 0);
    row("blocks", 30);
    rows.height = y;
    this.rows = rows;
    this.canvas.style.height = `${y}px`;
  }

  fit() {
    const least = this.width / this.duration, { unit } = sizes;
    // What is shown as a whole stays so in a window of another size.
    if (this.scale && this.scale === this.least) this.scale = least;
    this.least = least;
    // 95 pixels a second leave room for a number in every block.
    this.scale = clamp(this.scale || 95 * unit, least, Math.max(600 * unit, least));
    this.left = clamp(this.left, 0, Math.max(0, this.duration - this.span));
    this.overview.hidden = this.whole;
  }

  zoom(factor, anchor) {
    const x = this.x(anchor);
    this.scale *= factor;
    this.fit();
    this.left = anchor - x / this.scale;
    this.fit();
  }

  /** Keep the playhead in sight, a third from the left while it runs. */
  follow(time, playing) {
    if (this.held) return;
    if (playing) this.left = time - this.span * 0.35;
    else if (time < this.left || time > this.left + this.span) this.left = time - this.span * 0.35;
    this.left = clamp(this.left, 0, Math.max(0, this.duration - this.span));
  }

  draw(time) {
    const { pen, width } = sharp(this.canvas), { rows } = this, { plan } = this.session, u = sizes.unit;
    this.first = blockAt(plan, this.left);
    this.last = blockAt(plan, Math.min(this.left + this.span, this.duration));
    pen.font = `${11 * u}px system-ui, sans-serif`;
    pen.textBaseline = "middle";
    pen.fillStyle = colours.track;
    pen.fillRect(0, rows.wave.top, width, rows.wave.tall);
    this.drawSilence(pen);
    this.drawRuler(pen, width);
    this.drawCues(pen);
    this.drawWords(pen, time);
    this.wave.draw(pen, this.left, this.scale, { width, ...rows.wave }, time);
    this.drawBeats(pen);
    this.drawCurve(pen, width);
    this.drawPins(pen);
    this.drawUnits(pen);
    this.drawBlocks(pen, blockAt(plan, time));
    this.drawRange(pen, width);
    this.drawPlayhead(pen, this.x(time));
    this.drawGuide(pen);
    if (!this.whole) this.drawOverview(time);
  }

  /** The word or beat to which something is dragged. */
  drawGuide(pen) {
    if (this.guide == null) return;
    pen.fillStyle = colours.select;
    pen.fillRect(Math.round(this.x(this.guide)) - 0.5, 0, sizes.unit, this.rows.height);
  }

  drawPlayhead(pen, x) {
    const u = sizes.unit;
    pen.fillStyle = colours.playhead;
    pen.fillRect(x - u, 14 * u, 2 * u, this.rows.height);
    pen.beginPath();
    for (const [dx, y] of [[-6, 1], [6, 1], [6, 8], [0, 15], [-6, 8]]) pen.lineTo(x + dx * u, y * u);
    pen.fill();
  }

  drawRuler(pen, width) {
    const u = sizes.unit, { tall } = this.rows.ruler;
    const step = STEPS.find((s) => s * this.scale >= 64 * u) ?? 900;
    pen.strokeStyle = colours.line;
    pen.lineWidth = u;
    for (let k = Math.ceil(this.left / step); this.x(k * step) <= width; k++) {
      const at = Math.round(this.x(k * step)) + 0.5;
      pen.beginPath(); pen.moveTo(at, 0); pen.lineTo(at, tall - 2); pen.stroke();
      pen.fillStyle = colours.soft;
      pen.fillText(minutes(k * step, step < 1 ? 1 : 0), at + 4 * u, tall / 2);
    }
  }

  drawCues(pen) {
    const { top, tall } = this.rows.cues, u = sizes.unit, { plan } = this.session;
    if (!tall) return;
    for (const cue of cuesOf(plan)) {
      const time = cueTime(plan, cue);
      if (time === null) continue;
      const x = this.x(time), wide = pen.measureText(cue.gesture).width + 10 * u;
      pen.fillStyle = colours.accent;
      pen.beginPath();
      pen.roundRect(x, top + 2 * u, wide, tall - 4 * u, 4 * u);
      pen.fill();
      pen.fillRect(x, top + 2 * u, 1.5 * u, tall + 4 * u);
      pen.fillStyle = colours.desk;
      pen.fillText(cue.gesture, x + 5 * u, top + tall / 2);
    }
  }

  drawWords(pen, time) {
    const { top, tall } = this.rows.words, u = sizes.unit;
    if (!tall) return;
    // Two lines, so that every word has room at the usual zoom; far out, what has none on either is left out.
    const two = tall > 20 * u, free = [-Infinity, two ? -Infinity : Infinity];
    for (const { text, start, end } of this.session.plan.words) {
      if (end < this.left - 2 || start > this.left + this.span) continue;
      const from = this.x(start), wide = pen.measureText(text).width;
      const line = free[0] <= from ? 0 : free[1] <= from ? 1 : free[0] <= free[1] ? 0 : 1;
      const at = Math.max(from, free[line]);
      if (at > from + 30 * u && at > this.x(end)) continue;
      pen.fillStyle = time >= start && time < end ? colours.ink : colours.soft;
      pen.fillText(text, at, top + tall * (line ? 0.75 : two ? 0.27 : 0.5));
      free[line] = at + wide + 5 * u;
    }
  }

  drawSilence(pen) {
    const { top, tall } = this.rows.wave, { blocks } = this.session.plan, u = sizes.unit;
    pen.save();
    pen.beginPath();
    for (let k = this.first; k <= this.last; k++) {
      const { start, end, silent } = blocks[k];
      if (silent) pen.rect(this.x(start), top, (end - start) * this.scale, tall);
    }
    pen.clip();
    pen.fillStyle = pen.strokeStyle = colours.silence;
    pen.fillRect(0, top, this.width, tall);
    pen.lineWidth = 2 * u;
    pen.beginPath();
    // Hatching that moves with the sound.
    const gap = 8 * u, shift = (((this.left * this.scale) % gap) + gap) % gap;
    for (let at = -tall - shift; at < this.width; at += gap) { pen.moveTo(at, top + tall); pen.lineTo(at + tall, top); }
    pen.stroke();
    pen.restore();
  }

  drawBeats(pen) {
    const { plan, beat } = this.session, { top, tall } = this.rows.beats, wave = this.rows.wave, u = sizes.unit;
    for (let k = this.first; k <= Math.min(this.last + 1, plan.blocks.length); k++) {
      const x = this.x(k < plan.blocks.length ? plan.blocks[k].start : plan.blocks[k - 1].end), kind = beatFlag(plan, k);
      if (x < -6 * u || x > this.width + 6 * u) continue;
      pen.globalAlpha = kind === "onset" || k === beat ? 0.85 : 0.55;
      pen.fillStyle = flagColour(kind);
      pen.fillRect(Math.round(x) - 0.5, wave.top - 3 * u, (k === beat ? 2.4 : 1.2) * u, wave.tall + 3 * u);
      pen.globalAlpha = 1;
      const at = clamp(x, 4 * u, this.width - 4 * u), middle = top + tall / 2;
      drawSign(pen, kind, at, middle, 4 * u);
      if (k !== beat) continue;
      pen.strokeStyle = colours.select;
      pen.lineWidth = 2 * u;
      pen.beginPath();
      pen.arc(at, middle, 7.5 * u, 0, Math.PI * 2);
      pen.stroke();
    }
  }

  /** Where a value of the knob stands in its row. */
  curveY(value) {
    const { top, tall } = this.rows.curve, { low, high } = this.knobs[this.knob];
    return top + 4 * sizes.unit + (1 - (value - low) / (high - low)) * (tall - 8 * sizes.unit);
  }

  curveValue(y) {
    const { top, tall } = this.rows.curve, { low, high, step } = this.knobs[this.knob];
    const value = low + (1 - (y - top - 4 * sizes.unit) / (tall - 8 * sizes.unit)) * (high - low);
    return clamp(Number((Math.round(value / step) * step).toFixed(3)), low, high);
  }

  /** A knob over time. */
  drawCurve(pen, width) {
    const { top, tall } = this.rows.curve, u = sizes.unit;
    if (!tall) return;
    const points = curveOf(this.session.plan, this.knob), { name, unit, neutral } = this.knobs[this.knob];
    const first = points[0] ?? [0, neutral], last = points.at(-1) ?? [0, neutral];
    pen.fillStyle = colours.track;
    pen.fillRect(0, top + 2 * u, width, tall - 4 * u);
    pen.strokeStyle = colours.line;
    pen.lineWidth = u;
    if (neutral !== null) { pen.beginPath(); pen.moveTo(0, this.curveY(neutral)); pen.lineTo(width, this.curveY(neutral)); pen.stroke(); }
    pen.strokeStyle = pen.fillStyle = colours.accent;
    pen.lineWidth = 2 * u;
    if (first[1] !== null) {
      pen.beginPath();
      pen.moveTo(0, this.curveY(first[1]));
      for (const [time, value] of points) pen.lineTo(this.x(time), this.curveY(value));
      pen.lineTo(width, this.curveY(last[1]));
      pen.stroke();
    }
    for (const [time, value] of points) { pen.beginPath(); pen.arc(this.x(time), this.curveY(value), 4.5 * u, 0, Math.PI * 2); pen.fill(); }
    pen.fillStyle = colours.soft;
    const { low, high, scale = unit && `${low} to ${high} ${unit}` } = this.knobs[this.knob], range = scale ? `, ${scale}` : "";
    pen.fillText(points.length ? `${name}${range}` : `${name}${range}: click to set points, click a point twice to remove it`, 6 * u, top + 11 * u);
  }

  /** Pinned poses: a diamond at the moment, a bar while it holds. */
  drawPins(pen) {
    const { top, tall } = this.rows.pins, u = sizes.unit, middle = top + tall / 2;
    if (!tall) return;
    for (const { time, joint, hold = 0 } of pinsOf(this.session.plan)) {
      const x = this.x(time);
      pen.fillStyle = colours[joint.startsWith("Left") ? "left" : joint.startsWith("Right") ? "right" : "accent"];
      pen.fillRect(x, middle - 1.5 * u, hold * this.scale, 3 * u);
      pen.beginPath();
      for (const [dx, dy] of [[-5, 0], [0, -5], [5, 0], [0, 5]]) pen.lineTo(x + dx * u, middle + dy * u);
      pen.fill();
      pen.fillStyle = colours.soft;
      pen.fillText(PLACED[joint] ?? joint, x + Math.max(hold * this.scale, 5 * u) + 4 * u, middle + 0.5);
    }
  }

  /** Gesture units and their phases: from the moment that the hands leave rest until they are back. */
  drawUnits(pen) {
    const { top, tall } = this.rows.units, u = sizes.unit;
    if (!tall) return;
    for (const unit of this.session.plan.units) {
      if (unit.end < this.left || unit.start > this.left + this.span) continue;
      const from = this.x(unit.start), wide = (unit.end - unit.start) * this.scale, high = tall - 4 * u;
      pen.save();
      pen.beginPath();
      pen.roundRect(from + 0.75 * u, top + u, Math.max(wide - 1.5 * u, 1), high, 3 * u);
      pen.clip();
      pen.fillStyle = colours.track;
      pen.fillRect(from, top, wide, tall);
      for (const { kind, start, end } of unit.phases ?? []) {
        const x = this.x(start), w = (end - start) * this.scale;
        pen.globalAlpha = PHASES[kind] ?? 0.3;
        pen.fillStyle = kind.endsWith("hold") ? colours.wave : colours.accent;
        pen.fillRect(x, top, w, tall);
        pen.globalAlpha = 1;
        pen.fillStyle = kind === "stroke" ? colours.desk : colours.ink;
        pen.font = `${9.5 * u}px system-ui, sans-serif`;
        const label = kind.replace(/^(pre|post)-stroke /, "");
        if (w > pen.measureText(label).width + 6 * u) pen.fillText(label, Math.max(x, 0) + 3 * u, top + u + high / 2 + 0.5);
      }
      pen.restore();
    }
    pen.font = `${11 * u}px system-ui, sans-serif`;
  }

  drawBlocks(pen, now) {
    const { plan, original, selection } = this.session, { top, tall } = this.rows.blocks, u = sizes.unit, high = tall - 6 * u;
    pen.textAlign = "center";
    for (let k = this.first; k <= this.last; k++) {
      const block = plan.blocks[k], from = this.x(block.start), wide = (block.end - block.start) * this.scale;
      const selected = selection && k >= selection[0] && k <= selection[1];
      pen.fillStyle = block.silent ? colours.track : lexemeColour(block.lexeme ?? 0);
      pen.beginPath();
      pen.roundRect(from + 0.75 * u, top + 2 * u, Math.max(wide - 1.5 * u, 0.5), high, Math.min(5 * u, wide / 3));
      pen.fill();
      if (block.silent) { pen.strokeStyle = colours.line; pen.lineWidth = u; pen.stroke(); }
      if (k === now || selected) {
        pen.strokeStyle = selected ? colours.select : colours.ink;
        pen.lineWidth = (selected ? 2.5 : 1.5) * u;
        pen.stroke();
      }
      const marks = `${block.locked ? "🔒" : ""}${block.mirror ? "⇄" : ""}`, label = `${block.lexeme ?? "?"}${marks}`;
      pen.fillStyle = block.silent ? colours.soft : "#16181d";
      if (wide > pen.measureText(label).width + 5 * u) pen.fillText(label, from + wide / 2, top + 2 * u + high / 2 + 0.5);
      if (!differs(block, original)) continue;
      // A bar beneath what was edited.
      pen.fillStyle = colours.select;
      pen.fillRect(from + 2 * u, top + tall - 2.5 * u, Math.max(wide - 4 * u, u), 2.5 * u);
    }
    pen.textAlign = "left";
    this.drawStill(pen, top, tall);
  }

  /** Where the hands are asked to hold still, whatever the blocks say. */
  drawStill(pen, top, tall) {
    const u = sizes.unit;
    for (const [from, to] of this.session.plan.knobs?.hold_still ?? []) {
      const [left, wide] = [this.x(from), (to - from) * this.scale];
      pen.globalAlpha = 0.72;
      pen.fillStyle = colours.desk;
      pen.fillRect(left, top, wide, tall);
      pen.globalAlpha = 1;
      pen.strokeStyle = pen.fillStyle = colours.accent;
      pen.lineWidth = 1.5 * u;
      pen.strokeRect(left + u, top + 2 * u, Math.max(wide - 2 * u, u), tall - 6 * u);
      if (wide > 30 * u) pen.fillText("still", left + 6 * u, top + tall / 2 - u);
    }
  }

  /** What is not played is greyed, between two handles on the ruler. */
  drawRange(pen, width) {
    const { range } = this.clock, u = sizes.unit;
    if (!range) return;
    const [from, to] = range.map((time) => this.x(time));
    pen.globalAlpha = 0.6;
    pen.fillStyle = colours.desk;
    pen.fillRect(0, 0, Math.max(from, 0), this.rows.height);
    pen.fillRect(to, 0, Math.max(width - to, 0), this.rows.height);
    pen.globalAlpha = 1;
    pen.fillStyle = colours.accent;
    for (const [x, way] of [[from, 1], [to, -1]]) {
      pen.fillRect(x - u, 0, 2 * u, this.rows.height);
      pen.beginPath();
      pen.moveTo(x, 0); pen.lineTo(x + way * 10 * u, 0); pen.lineTo(x, 12 * u);
      pen.fill();
    }
  }

  drawOverview(time) {
    const { pen, width, height } = sharp(this.overview), scale = width / this.duration, u = sizes.unit;
    pen.fillStyle = colours.track;
    pen.fillRect(0, 0, width, height);
    pen.fillStyle = colours.silence;
    for (const { start, end, silent } of this.session.plan.blocks) if (silent) pen.fillRect(start * scale, 0, (end - start) * scale, height);
    this.wave.draw(pen, 0, scale, { width, top: 0, tall: height }, time);
    pen.strokeStyle = colours.accent;
    pen.lineWidth = 2 * u;
    pen.beginPath();
    pen.roundRect(this.left * scale + 1, 1, Math.max(this.span * scale - 2, 4), height - 2, 5 * u);
    pen.stroke();
    pen.fillStyle = colours.playhead;
    pen.fillRect(time * scale - u, 0, 2 * u, height);
  }
}

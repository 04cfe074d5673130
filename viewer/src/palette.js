// The palette: every lexeme and every named gesture as a small moving figure, to search, to try in place and to take.

import { addCue } from "./cues.js";
import { $, element } from "./dom.js";
import { clamp } from "./numbers.js";
import * as edits from "./plan.js";
import { colours, lexemeColour } from "./theme.js";

const KEPT = "gesticulator favourites";
/** Milliseconds that a pointer rests on a figure before it is played in its place. */
const RESTS = 250;
/** Seconds between two rounds of a figure. */
const PAUSE = 0.7;

const int8 = (base64) => Int8Array.from(atob(base64), (letter) => letter.charCodeAt(0));

export class Palette {
  /** live: renders a plan that is tried; figures(): asks for the figures. */
  constructor(session, clock, live, figures, timeline) {
    Object.assign(this, { session, clock, live, figures, timeline, entries: null, shown: new Set(), resting: 0 });
    this.bindDrops(timeline);
    this.favourites = new Set(readFavourites());
    $("palette-open").addEventListener("click", () => this.toggle());
    $("palette-close").addEventListener("click", () => this.toggle(false));
    $("palette-search").addEventListener("input", () => this.filter());
    for (const name of ["kind", "hand", "size", "height", "phase"]) $(`palette-${name}`).addEventListener("change", () => this.filter());
    $("palette-favourites").addEventListener("click", (event) => {
      event.target.setAttribute("aria-pressed", String(event.target.getAttribute("aria-pressed") !== "true"));
      this.filter();
    });
    this.watch = new IntersectionObserver((rows) => {
      for (const { target, isIntersecting } of rows) this.shown[isIntersecting ? "add" : "delete"](target.entry);
    }, { root: $("palette-figures") });
    session.on("edited", () => this.mark());
    session.on("selected", () => this.mark());
  }

  get open() { return !$("palette").hidden; }

  async toggle(open = !this.open) {
    $("palette").hidden = !open;
    $("palette-open").setAttribute("aria-expanded", String(open));
    if (!open) { this.leave(); $("palette-open").focus(); return; }
    $("palette-search").focus();
    if (this.entries) { this.mark(); return; }
    $("palette-count").textContent = "making the figures …";
    try {
      this.fill(await this.figures());
    } catch (error) {
      $("palette-count").textContent = `The figures cannot be shown (${error.message}).`;
    }
  }

  fill({ joints, bones, fps, lexemes, gestures }) {
    Object.assign(this, { joints: joints.length, bones });
    const { plan } = this.session, names = new Map((plan.lexicon ?? []).map(({ lexeme, name }) => [lexeme, name]));
    const about = new Map((plan.gestures ?? []).map((one) => [one.name, one.about]));
    this.entries = [
      ...lexemes.map((one) => ({ ...one, kind: "lexeme", key: `lexeme ${one.lexeme}`, name: names.get(one.lexeme) ?? "", fps })),
      ...gestures.map((one) => ({ ...one, kind: "gesture", key: one.name, about: about.get(one.name) ?? "", fps: (int8(one.points).length / 2 / joints.length) / one.seconds })),
    ].map((one) => this.row({ ...one, points: int8(one.points) }));
    $("palette-figures").replaceChildren(...this.entries.map((one) => one.item));
    this.filter();
    this.mark();
    this.animate = this.animate.bind(this);
    requestAnimationFrame(this.animate);
  }

  row(entry) {
    const canvas = element("canvas", { "aria-hidden": "true" });
    const score = element("span", { className: "value" });
    const title = entry.kind === "lexeme" ? `${entry.lexeme} · ${entry.name}` : entry.name;
    const take = element("button", {
      "type": "button", "className": "figure", "draggable": true, "ondragstart": (event) => this.drag(event, entry), "title": entry.about || title,
      "onclick": () => this.take(entry), "onpointerenter": () => this.rest(entry), "onpointerleave": () => this.leave(),
      "onfocus": () => this.rest(entry), "onblur": () => this.leave(),
    }, canvas, element("span", { className: "called" }, title), score);
    const star = element("button", { "type": "button", "className": "star", "aria-label": `Favourite: ${title}`,
      "aria-pressed": String(this.favourites.has(entry.key)), "onclick": () => this.favour(entry, star) }, "★");
    const item = element("li", {}, take, star);
    const made = Object.assign(entry, { canvas, score, button: take, item, words: `${title} ${entry.about ?? ""} ${entry.hand ?? ""} ${entry.phase ?? ""} ${entry.words ?? ""}`.toLowerCase() });
    canvas.entry = made;
    this.watch.observe(canvas);
    return made;
  }

  favour(entry, star) {
    const on = !this.favourites.has(entry.key);
    this.favourites[on ? "add" : "delete"](entry.key);
    star.setAttribute("aria-pressed", String(on));
    try { localStorage.setItem(KEPT, JSON.stringify([...this.favourites])); } catch { /* a page without storage */ }
  }

  filter() {
    if (!this.entries) return;
    // "both hands open": every word, in any order; "hands" finds "hand".
    const words = $("palette-search").value.toLowerCase().split(/\s+/).filter(Boolean).map((word) => (word.length > 3 ? word.replace(/s$/, "") : word));
    const wanted = ["kind", "hand", "size", "height", "phase"].map((name) => [name, $(`palette-${name}`).value]).filter(([, value]) => value);
    const starred = $("palette-favourites").getAttribute("aria-pressed") === "true";
    let count = 0;
    for (const entry of this.entries) {
      const fits = words.every((word) => entry.words.includes(word)) && wanted.every(([name, value]) => entry[name] === value)
        && (!starred || this.favourites.has(entry.key));
      entry.item.hidden = !fits;
      count += fits;
    }
    $("palette-count").textContent = `${count} of ${this.entries.length}`;
  }

  /** Mark what plays in the block, and tell the scores that are known. */
  mark() {
    if (!this.entries || !this.open) return;
    const [first] = this.session.stretch(this.clock.time), block = this.session.plan.blocks[first];
    const scores = new Map((block.alternatives ?? []).map(({ lexeme, score }, rank) => [lexeme, `${rank + 1}. ${Number(score.toPrecision(3))}`]));
    if (block.score != null && !scores.has(block.lexeme)) scores.set(block.lexeme, `${block.rank}. ${Number(block.score.toPrecision(3))}`);
    for (const entry of this.entries) {
      if (entry.kind !== "lexeme") continue;
      entry.button.setAttribute("aria-pressed", String(entry.lexeme === block.lexeme && !block.silent));
      entry.score.textContent = scores.get(entry.lexeme) ?? "";
    }
  }

  /** The plan with an entry at the playhead or in the selected blocks. */
  planWith(entry) {
    const { session } = this;
    return entry.kind === "lexeme" ? edits.setLexeme(session.plan, ...session.stretch(this.clock.time), entry.lexeme, entry.name)
      : addCue(session.plan, entry.name, this.clock.time);
  }

  rest(entry) {
    clearTimeout(this.resting);
    this.resting = setTimeout(() => this.live?.try(this.planWith(entry)), RESTS);
  }

  drag(event, entry) {
    this.leave();
    this.dragged = entry;
    event.dataTransfer.setData("text/plain", entry.key);
    event.dataTransfer.effectAllowed = "copy";
  }

  /** A figure that is dropped on the timeline is taken there: at the word, or in the block. */
  bindDrops({ canvas }) {
    canvas.addEventListener("dragover", (event) => { if (this.dragged) { event.preventDefault(); event.dataTransfer.dropEffect = "copy"; } });
    canvas.addEventListener("drop", (event) => {
      if (!this.dragged) return;
      event.preventDefault();
      const entry = this.dragged;
      this.clock.seek(clamp(this.timeline.timeAt(event.offsetX), 0, this.clock.duration));
      this.session.select(null);
      this.take(entry);
    });
    addEventListener("dragend", () => { this.dragged = null; });
  }

  leave() {
    clearTimeout(this.resting);
    this.live?.forget();
  }

  take(entry) {
    this.leave();
    this.session.edit(this.planWith(entry));
  }

  animate(now) {
    requestAnimationFrame(this.animate);
    if (!this.open || now - (this.last ?? 0) < 60) return;
    this.last = now;
    for (const entry of this.shown) if (!entry.item.hidden) this.draw(entry, now / 1000);
  }

  draw({ canvas, points, fps, kind, lexeme }, time) {
    const ratio = devicePixelRatio || 1, w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (!w || !h) return;
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const pen = canvas.getContext("2d"), { joints } = this, frames = points.length / 2 / joints;
    const frame = Math.min(frames - 1, Math.floor((time % (frames / fps + PAUSE)) * fps)), from = frame * joints * 2;
    const size = h / 135, x = (j) => w / 2 + points[from + 2 * j] * size, y = (j) => h * 0.72 - points[from + 2 * j + 1] * size;
    pen.clearRect(0, 0, w, h);
    pen.lineCap = pen.lineJoin = "round";
    pen.lineWidth = 6 * size;
    pen.strokeStyle = colours.ink;
    for (const [a, b] of this.bones) {
      pen.strokeStyle = b >= 6 ? colours.right : b >= 3 ? colours.left : colours.soft;
      pen.beginPath(); pen.moveTo(x(a), y(a)); pen.lineTo(x(b), y(b)); pen.stroke();
    }
    pen.fillStyle = kind === "lexeme" ? lexemeColour(lexeme) : colours.accent;
    pen.beginPath(); pen.arc(x(0), y(0) - 6 * size, 11 * size, 0, 7); pen.fill();
  }
}

function readFavourites() {
  try { return JSON.parse(localStorage.getItem(KEPT) ?? "[]"); } catch { return []; }
}

// The panel beside the stage: what the selected blocks do, what they could do, and the knobs of the whole take.

import { addCue, cuesOf, cueTime, removeCue } from "./cues.js";
import { $, element, notice } from "./dom.js";
import { minutes } from "./numbers.js";
import * as edits from "./plan.js";
import { signPicture, TITLES } from "./signs.js";
import { colours, lexemeColour } from "./theme.js";

const tenth = (value) => Number(value).toFixed(1);

export class Inspector {
  constructor(session, clock) {
    Object.assign(this, { session, clock, shown: "" });
    this.bind();
  }

  get stretch() { return this.session.stretch(this.clock.time); }
  edit(how, ...rest) { this.session.edit(how(this.session.plan, ...this.stretch, ...rest)); }

  bind() {
    const flag = (id, how, key) => $(id).addEventListener("click", () => this.edit(how, !this.every(key)));
    flag("silence", edits.setSilent, "silent");
    flag("mirror", edits.setMirror, "mirror");
    flag("lock", edits.setLocked, "locked");
    $("lock-rest").addEventListener("click", () => this.edit(edits.lockTheRest));
    $("draw-again").addEventListener("click", () => this.edit(edits.drawAgain));
    $("restore").addEventListener("click", () => this.session.edit(edits.restored(this.session.plan, this.session.original, ...this.stretch)));
    this.slide("intensity", (value) => edits.setIntensity(this.session.plan, ...this.stretch, value));
    this.slide("knob-intensity", (value) => edits.setKnob(this.session.plan, "intensity", value));
    this.slide("knob-activity", (value) => edits.setKnob(this.session.plan, "activity", value));
    $("knob-energy").addEventListener("change", (event) => this.session.edit(edits.setKnob(this.session.plan, "energy", event.target.value)));
    $("knob-mirror").addEventListener("click", () => this.session.edit(edits.setKnob(this.session.plan, "mirror", !this.session.plan.knobs?.mirror)));
    $("hold-still").addEventListener("click", () => this.holdStill());
    $("lexeme").addEventListener("change", (event) => this.choose(Number(event.target.value)));
    $("add-cue").addEventListener("click", () => this.session.edit(addCue(this.session.plan, $("gesture").value, this.clock.time)));
    $("delete-beat").addEventListener("click", () => this.deleteBeat());
    $("add-beat").addEventListener("click", () => this.addBeat());
  }

  slide(id, how) {
    const slider = $(id);
    slider.addEventListener("input", () => this.session.edit(how(Number(slider.value)), id));
    slider.addEventListener("change", () => this.session.lane.history.settle());
  }

  every(key) {
    const [first, last] = this.stretch;
    return this.session.plan.blocks.slice(first, last + 1).every((block) => block[key]);
  }

  /** What plays at a time, in words: { text, gesture: of the gesture there, begins: what tells it from others }. */
  playing(time) {
    const { plan } = this.session, number = edits.blockAt(plan, time), block = plan.blocks[number];
    const word = (plan.words ?? []).find(({ start, end }) => time >= start && time < end)?.text;
    const cue = cuesOf(plan).find((one) => Math.abs((cueTime(plan, one) ?? -9) - time) < 0.5)?.gesture;
    const unit = (plan.units ?? []).find(({ start, end }) => time >= start && time < end), phase = unit?.phases?.find(({ start, end }) => time >= start && time < end)?.kind;
    const nameAt = (at) => {
      const one = plan.blocks[edits.blockAt(plan, at)];
      return one.silent ? "hands at rest" : one.name || this.nameOf(one.lexeme) || `lexeme ${one.lexeme}`;
    };
    const what = cue ?? (unit ? nameAt(time) : "hands at rest"), phrase = unit && edits.phrasesOf(unit).find(({ start, end }) => time >= start && time < end);
    const parts = [word && `“${word}”`, what, phase, `block ${number + 1}, lexeme ${block.lexeme}`, block.locked && "locked"];
    return { text: parts.filter(Boolean).join(", "), gesture: cue ?? (phrase ? nameAt(phrase.stroke ?? time) : what), begins: cue ?? phrase?.start ?? null };
  }

  nameOf(lexeme) { return this.names?.get(lexeme) ?? null; }

  choose(lexeme) { this.edit((plan, first, last) => edits.setLexeme(plan, first, last, lexeme, this.nameOf(lexeme))); }

  /** The alternative of a rank, from 1. */
  chooseRank(rank) {
    const other = this.session.plan.blocks[this.stretch[0]].alternatives?.[rank - 1];
    if (other) this.choose(other.lexeme);
  }

  nudge(by) {
    const { plan } = this.session, [first, last] = this.stretch, now = plan.blocks[first].intensity ?? 1;
    this.session.edit(edits.setIntensity(plan, first, last, now + by));
  }

  beat() {
    if (this.session.beat !== null) return this.session.beat;
    return this.session.selection ? this.session.selection[0] : edits.blockAt(this.session.plan, this.clock.time);
  }

  deleteBeat() {
    const { session } = this, [first, last] = this.stretch;
    if (session.beat === null && session.selection && last > first) {
      let { plan } = session;
      for (let k = last; k > first; k--) plan = edits.deleteBeat(plan, k);
      session.edit(plan);
    } else session.edit(edits.deleteBeat(session.plan, this.beat()));
  }

  addBeat() {
    const plan = edits.addBeat(this.session.plan, this.clock.time);
    if (plan) this.session.edit(plan);
    else notice(`This block is too short for another beat: a block lasts ${edits.SHORTEST} s at least.`);
  }

  holdStill() {
    const { plan } = this.session, [first, last] = this.stretch, still = plan.knobs?.hold_still ?? [];
    const range = this.clock.range ?? [plan.blocks[first].start, plan.blocks[last].end];
    this.session.edit(edits.setKnob(plan, "hold_still", [...still, range]));
  }

  /** Show the blocks that an edit would mean. */
  update() {
    const { session } = this, { plan } = session, [first, last] = this.stretch;
    if (this.names === undefined) this.fillLists(plan);
    const block = plan.blocks[first];
    this.head(plan, first, last);
    this.alternatives(block);
    for (const [id, key] of [["silence", "silent"], ["mirror", "mirror"], ["lock", "locked"]]) $(id).setAttribute("aria-pressed", String(Boolean(this.every(key))));
    this.setSlider("intensity", block.intensity ?? 1);
    $("delete-beat").disabled = !(last > first && session.beat === null) && !edits.canDelete(plan, this.beat());
    $("restore").disabled = !plan.blocks.slice(first, last + 1).some((one) => edits.differs(one, session.original));
    $("draw-again").disabled = !block.draw;
    this.knobs(plan.knobs);
    this.cues(plan);
  }

  setSlider(id, value) {
    if (document.activeElement !== $(id)) $(id).value = value;
    $(`${id}-is`).textContent = tenth(value);
  }

  head(plan, first, last) {
    const block = plan.blocks[first], chip = $("chip"), many = last > first;
    const seconds = (plan.blocks[last].end - block.start).toFixed(2);
    chip.textContent = many ? `${last - first + 1} blocks` : block.lexeme === null ? "chosen anew" : `lexeme ${block.lexeme}`;
    chip.style.background = block.silent || many ? colours.track : lexemeColour(block.lexeme ?? 0);
    chip.style.color = block.silent || many ? colours.ink : "#16181d";
    $("card-block").textContent = `${many ? `blocks ${first + 1} to ${last + 1}` : `block ${first + 1}`}, ${seconds} s from ${minutes(block.start, 2)}`;
    $("card-name").textContent = many ? "" : block.name ?? "";
    const flag = $("card-flag"), kind = plan.blocks[last].flag ?? "edited";
    flag.replaceChildren(signPicture(kind), `ends on: ${TITLES[kind] ?? kind}${block.silent ? " · silent" : ""}`);
    $("score-is").textContent = `score: ${plan.score_is ?? "log-probability"}`;
  }

  /** The lexemes that were considered, best first, as a list to choose from. */
  alternatives(block) {
    const { lexeme: plays, score: worth, rank: place } = block, best = (block.alternatives ?? []).map((row, rank) => ({ ...row, rank: rank + 1 }));
    // What plays is among them, wherever it stands.
    const rows = worth == null || !best.length || best.some(({ lexeme }) => lexeme === plays) ? best
      : [...best, { lexeme: plays, name: this.nameOf(plays), score: worth, rank: place }];
    const scores = rows.map((row) => row.score);
    const high = Math.max(...scores), low = Math.min(...scores), share = low >= 0 && high <= 1;
    // Scores may be probabilities or values of any size: the bar spans from the least to the best of them.
    const part = (score) => (share ? score / (high || 1) : (score - low) / (high - low || 1)) * 0.94 + 0.06;
    $("best").replaceChildren(...rows.map(({ lexeme, name, score, rank }) => {
      const gauge = element("i");
      gauge.style.width = `${(part(score) * 100).toFixed(1)}%`;
      const button = element("button", {
        "type": "button", "aria-pressed": String(lexeme === block.lexeme && !block.silent), "title": rank > best.length ? `Lexeme ${lexeme} plays here: number ${rank} by its score` : `Play lexeme ${lexeme} here (${rank})`,
        "onclick": () => this.choose(lexeme),
      }, element("span", { className: "id" }, String(lexeme)), element("span", { className: "called" }, name ?? this.nameOf(lexeme) ?? ""),
      element("span", { className: "gauge" }, gauge), element("span", { className: "value" }, String(Number(score.toPrecision(3)))));
      return element("li", {}, button);
    }));
    const select = $("lexeme");
    if (document.activeElement !== select) select.value = String(block.lexeme ?? "");
  }

  fillLists(plan) {
    const lexicon = plan.lexicon ?? [];
    this.names = new Map(lexicon.map(({ lexeme, name }) => [lexeme, name]));
    $("lexeme").replaceChildren(...lexicon.map(({ lexeme, name, silent }) => (
      element("option", { value: String(lexeme) }, `${lexeme} · ${name}${silent ? " (still)" : ""}`))));
    $("any-lexeme").hidden = !lexicon.length;
    const gestures = plan.gestures ?? [];
    $("gesture").replaceChildren(...gestures.map(({ name, about }) => element("option", { value: name, title: about ?? "" }, name)));
    $("ask").hidden = !gestures.length;
  }

  knobs(knobs = {}) {
    this.setSlider("knob-intensity", knobs.intensity ?? 1);
    this.setSlider("knob-activity", knobs.activity ?? 1);
    $("knob-energy").value = knobs.energy ?? "neutral";
    $("knob-mirror").setAttribute("aria-pressed", String(Boolean(knobs.mirror)));
    const { plan } = this.session, still = knobs.hold_still ?? [];
    $("still").replaceChildren(...still.map(([from, to], k) => removable(`still ${minutes(from, 1)} to ${minutes(to, 1)}`, () => (
      this.session.edit(edits.setKnob(plan, "hold_still", still.filter((_, other) => other !== k)))))));
  }

  cues(plan) {
    $("cues").replaceChildren(...cuesOf(plan).map((cue, k) => {
      const time = cueTime(plan, cue), where = cue.word ? `at “${cue.word}”` : `at ${minutes(cue.time ?? 0, 1)}`;
      return removable(`${cue.gesture} ${where}${time === null ? " (not said)" : ""}`, () => this.session.edit(removeCue(this.session.plan, k)));
    }));
  }
}

function removable(text, remove) {
  return element("li", {}, element("span", {}, text), element("button", { "type": "button", "aria-label": `Remove ${text}`, "onclick": remove }, "×"));
}

// With `gesticulator view` behind the page, which owns the plan: what was edited goes there, and the frames that changed
// come back; what other pages edited comes from there.

import { countChanges, readJson } from "./plan.js";

/** Milliseconds after an edit before it is sent, so that edits of one moment are one rendering. */
const PAUSE = 15;
/** Milliseconds before an edit is sent again that came while something else was rendered. */
const LATER = 1000;
/** Milliseconds before an edit is sent again after the renderer did not answer, and how often it may end an answer. */
const AWAY = 2000, BROKEN = 3;
const BUSY = 503, CONFLICT = 409, STALE = 412, STRANGE = [403, 404];
/** Milliseconds between two questions whether another page has edited the plan, and whether it is saved. */
const FOLLOWS = 700;

/** The renderer does not answer. */
class AwayError extends Error {}
/** What is said while the renderer does not answer. */
export const AWAY_TEXT = "gesticulator view does not answer: is it still running? What was edited since is in this page alone: Save plan writes it to a file.";

/** What a network gives; `AwayError` where it fails. */
async function reached(promise) {
  try { return await promise; } catch (error) {
    throw error.name === "AbortError" ? error : new AwayError(AWAY_TEXT);
  }
}

/** The messages of an answer, as they come: { header, data }. */
async function* messagesOf(answer) {
  const reader = answer.body.getReader();
  let held = new Uint8Array(0);
  const need = async (count) => {
    const parts = [held];
    let size = held.length;
    while (size < count) {
      const { done, value } = await reached(reader.read());
      if (done) return false;
      parts.push(value);
      size += value.length;
    }
    if (parts.length > 1) {
      held = new Uint8Array(size);
      parts.reduce((at, part) => { held.set(part, at); return at + part.length; }, 0);
    }
    return true;
  };
  const take = (count) => { const taken = held.slice(0, count); held = held.subarray(count); return taken; };
  while (await need(4)) {
    const length = new DataView(take(4).buffer).getUint32(0, true);
    if (!(await need(length))) return;
    const header = readJson(new TextDecoder().decode(take(length)));
    if (!(await need(header.bytes))) return;
    yield { header, data: take(header.bytes) };
  }
}

export class Live {
  /** told: { token } from the server, or null for a page without one. say(state, text): shows the state of rendering.
   *  tell: { unsaved(why), copied(text), stale(shown) } shows that of the file, and asks what to do where another page
   *  has edited the plan at the same time. */
  constructor(session, told, say, tell) {
    Object.assign(this, { session, told, say, tell, waiting: 0, number: 0, asking: null, away: false, broken: 0, theirs: null });
    Object.assign(this, { revision: 0, problem: "", copied: session.data.notice ?? "" });
    this.page = crypto.randomUUID?.() ?? Math.random().toString(36).slice(2);
    /** The last plan of this page that the program has. */
    this.given = session.lanes[0].history.present;
    session.lanes.forEach((lane, k) => { lane.known = { plan: lane.rendered, rendering: told?.renderings?.[k] ?? null, take: lane.take }; });
    session.on("edited", () => this.edited());
    this.edited();
    if (!told) return;
    setInterval(() => this.follow(), FOLLOWS);
    addEventListener("visibilitychange", () => this.follow());
  }

  /** Whether something was edited that the program does not have, or could not save. */
  get unsaved() { return Boolean(this.problem) || this.edits; }
  get edits() { return this.session.lanes[0].history.present !== this.given; }

  /** Ask for what other pages have edited since. */
  follow() {
    this.following ??= this.hearNews().finally(() => { this.following = null; });
    return this.following;
  }

  async hearNews() {
    try {
      const answer = await reached(fetch(`plan/${this.revision}`));
      if (!answer.ok) throw new AwayError(AWAY_TEXT);
      const state = readJson(await reached(answer.text()));
      if (this.away && !this.edits) this.say("same", "");
      this.away = false;
      this.hear(state);
      // What is edited here at the same time is sent, and refused: then the user decides.
      if (!state.plan || state.revision <= this.revision || this.edits || this.tried || this.session.active) return;
      if (state.author !== this.page) this.takeOver(state);
      else if (!this.asking) this.send(); // an edit that was undone before its answer came
    } catch (error) {
      if (!(error instanceof AwayError)) throw error;
      if (!this.away) this.say("bad", error.message);
      this.away = true;
    }
  }

  /** What every answer tells: whether the plan is saved, and what was copied before it was replaced. */
  hear({ problem, notice }) {
    if (problem !== this.problem) this.tell.unsaved(problem);
    if (notice && notice !== this.copied) this.tell.copied(notice);
    Object.assign(this, { problem, copied: notice });
  }

  /** Go on with the plan of another page: a step that can be undone. */
  takeOver({ revision, plan }) {
    Object.assign(this, { revision, given: plan, theirs: null });
    this.tell.stale(false);
    this.session.edit(plan, "elsewhere");
  }

  /** Another page edited the plan at the same time: go on with that one, or with this one, and the other as a file. */
  reload() { if (this.theirs) this.takeOver(this.theirs); }

  keepBoth() {
    if (!this.theirs) return;
    Object.assign(this, { revision: this.theirs.revision, theirs: null, both: true });
    this.tell.stale(false);
    this.send();
  }

  edited() {
    const { lane } = this.session;
    if (!this.told) {
      const count = countChanges(lane.history.present, lane.rendered);
      this.say(count ? "edited" : "same", count ? `${count} ${count === 1 ? "edit" : "edits"}, not rendered yet` : "");
      return;
    }
    clearTimeout(this.waiting);
    if (lane.history.present === lane.rendered) {
      this.asking?.abort();
      this.goBack(lane);
      this.say("same", this.news ?? "");
      this.news = null;
      return;
    }
    this.waiting = setTimeout(() => this.send(), PAUSE);
    this.say("busy", "rendering …");
  }

  /** Play a plan on the stage without taking it. */
  async try(plan) {
    const { lane } = this.session, known = lane.known;
    if (!this.told || !plan || known?.rendering == null || lane.history.present !== lane.rendered || lane.history.present !== known.plan) return;
    this.forget();
    const trying = this.trying = new AbortController(), before = lane.take;
    this.tried = { lane, before };
    this.asking?.abort();
    this.asking = trying;
    try {
      const answer = await this.ask(plan, known, trying.signal, true);
      if (!answer.ok) return;
      for await (const { header, data } of messagesOf(answer)) {
        if (!trying.signal.aborted && header.kind === "done") this.session.show(lane, lane.take.patched(header, data));
      }
      if (!trying.signal.aborted) this.say("busy", "a try: click to take it");
    } catch { /* a try that fails shows nothing */ } finally {
      if (this.asking === trying) this.asking = null;
    }
  }

  /** Back to what was there before a try. */
  forget() {
    this.trying?.abort();
    if (!this.tried) return;
    const { lane, before } = this.tried;
    this.tried = this.trying = null;
    if (lane.take === before) return;
    this.session.show(lane, before);
    this.say("same", "");
  }

  /** Back to the last motion that was drawn as a whole, where the one after it was abandoned. */
  goBack(lane) {
    if (lane.known?.take && lane.take !== lane.known.take) this.session.show(lane, lane.known.take);
  }

  /** Ask for the motion of the present plan. What was asked for before is not wanted any more. */
  async send() {
    this.forget();
    const { lane } = this.session, asked = lane.history.present, known = lane.known ?? { plan: null, rendering: null };
    this.asking?.abort();
    const asking = this.asking = new AbortController(), begin = performance.now();
    try {
      const answer = await this.ask(asked, known, asking.signal, lane !== this.session.lanes[0]);
      if (answer.status === CONFLICT) return;
      if (answer.status === STALE) {
        this.theirs = readJson(await answer.text());
        this.hear(this.theirs);
        this.say("edited", "not saved: another page has edited the plan");
        this.tell.stale(true);
        return;
      }
      if (answer.status === BUSY) {
        this.say("busy", "waiting for the models …");
        this.waiting = setTimeout(() => this.send(), LATER);
        return;
      }
      if (STRANGE.includes(answer.status)) throw new AwayError(AWAY_TEXT);
      if (!answer.ok) throw new Error(readJson(await answer.text()).error ?? answer.statusText);
      await this.receive(lane, asked, answer, asking, begin);
    } catch (error) {
      if (asking.signal.aborted) return;
      this.goBack(lane);
      if (error instanceof AwayError) {
        this.say(this.away ? "away" : "bad", error.message);
        this.away = true;
        this.waiting = setTimeout(() => this.send(), AWAY);
        return;
      }
      lane.rendered = asked; // not asked again before the next edit
      this.say("bad", error.message);
      if (lane.history.present === asked) this.session.tell("unrendered");
    } finally {
      if (this.asking === asking) this.asking = null;
    }
  }

  /** Send a plan, with the number of the rendering that the page has, and, unless it is a try, the revision that it was
   *  made from. */
  ask(plan, { rendering }, signal, trial = false) {
    return reached(fetch("render", {
      method: "POST", signal, headers: { "Content-Type": "application/json", "X-Gesticulator-Token": this.told.token },
      body: JSON.stringify({ page: this.page, number: ++this.number, revision: trial ? null : this.revision, both: Boolean(this.both), have: rendering, plan }),
    }));
  }

  async receive(lane, asked, answer, asking, begin) {
    let ended = false;
    for await (const { header, data } of messagesOf(answer)) {
      if (asking.signal.aborted) return;
      if (header.kind === "failed") throw new Error(header.error);
      if (header.kind !== "done") {
        this.say("busy", header.share ? `drawing … ${Math.round(header.share * 100)} %` : "drawing …");
        continue;
      }
      ended = true;
      this.away = false;
      this.broken = 0;
      const { plan } = header, take = (lane.known?.take ?? lane.take).patched(header, data);
      this.session.show(lane, take);
      lane.known = { plan, rendering: header.rendering, take };
      const saved = lane === this.session.lanes[0];
      if (saved) Object.assign(this, { revision: header.revision, given: lane.history.present === asked ? plan : asked, both: false });
      this.hear(header);
      this.news = `rendered in ${((performance.now() - begin) / 1000).toFixed(2)} s${saved ? "" : "; a take for comparison is not saved"}`;
      this.session.rendered(lane, plan, asked);
    }
    if (ended || asking.signal.aborted) return;
    this.broken += 1;
    throw this.broken < BROKEN ? new AwayError(AWAY_TEXT) : new Error("gesticulator view has ended its answer early.");
  }
}

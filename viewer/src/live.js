// With `gesticulator view` behind the page: an edited plan goes there and comes back as motion.

import { countChanges, planText, readJson } from "./plan.js";

/** Milliseconds after the last edit before the plan is sent, so that a drag is one rendering. */
const PAUSE = 120;
/** Milliseconds before a plan is sent again that came while another one was rendered. */
const LATER = 1000;
const BUSY = 503;

export class Live {
  /** told: { token } from the server, or null for a page without one. say(state, text): what the user is told. */
  constructor(session, told, say) {
    Object.assign(this, { session, told, say, waiting: 0, busy: false });
    session.on("edited", () => this.edited());
    this.edited();
  }

  edited() {
    const { lane } = this.session;
    if (!this.told) {
      const count = countChanges(lane.history.present, lane.rendered);
      this.say(count ? "edited" : "same", count ? `${count} ${count === 1 ? "edit" : "edits"}, not rendered yet` : "");
      return;
    }
    if (lane.history.present === lane.rendered) { if (!this.busy) this.say("same", ""); return; }
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.send(), PAUSE);
    this.say("busy", "rendering …");
  }

  async send() {
    // One at a time; what was edited meanwhile goes next.
    if (this.busy) { this.again = true; return; }
    const { lane } = this.session, asked = lane.history.present;
    this.busy = true;
    this.again = false;
    const begin = performance.now();
    try {
      const answer = await fetch("render", {
        method: "POST", headers: { "Content-Type": "application/json", "X-Gesticulator-Token": this.told.token },
        body: JSON.stringify({ take: lane.take.name, plan: "PLAN" }).replace('"PLAN"', () => planText(asked)),
      });
      const told = readJson(await answer.text());
      if (answer.status === BUSY) {
        this.say("busy", "waiting for the models …");
        this.waiting = setTimeout(() => this.send(), LATER);
        return;
      }
      if (!answer.ok) throw new Error(told.error ?? answer.statusText);
      lane.rendered = asked;
      this.session.replace(lane, told, asked);
      this.say("same", `rendered in ${((performance.now() - begin) / 1000).toFixed(1)} s`);
    } catch (error) {
      lane.rendered = asked; // not asked again before the next edit
      this.say("bad", error instanceof TypeError ? "gesticulator view does not answer: is it still running?" : error.message);
    } finally {
      this.busy = false;
    }
    if (this.again || (lane.history.present !== asked && lane.history.present !== lane.rendered)) this.edited();
  }
}

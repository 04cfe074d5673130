// Edits are kept in the browser's storage: a page that is loaded again goes on, and pages of one recording agree.

import { fault, planText, readJson } from "./plan.js";

/** Milliseconds after an edit that it is kept. */
const AFTER = 400;

export class Kept {
  /** place: of this recording and program in the storage; say(text): what the user is told. */
  constructor(session, place, say) {
    Object.assign(this, { session, place: `gesticulator edits ${place}`, say, waiting: 0, taking: false });
    this.lane = session.lanes[0];
    this.take(this.read(), true);
    session.on("edited", () => {
      // What the renderer adds is not kept: it may come after an edit in another page, and would undo that.
      if (this.taking || session.refining || session.lane !== this.lane) return;
      clearTimeout(this.waiting);
      this.waiting = setTimeout(() => this.keep(), AFTER);
    });
    addEventListener("storage", ({ key, newValue }) => {
      if (key !== this.place) return;
      if (newValue) this.take(newValue, false);
      else this.back();
    });
    addEventListener("pagehide", () => { if (this.waiting) this.keep(); });
  }

  read() {
    try { return localStorage.getItem(this.place); } catch { return null; }
  }

  keep() {
    clearTimeout(this.waiting);
    this.waiting = 0;
    const plan = this.lane.history.present;
    try {
      if (plan === this.lane.history.original) localStorage.removeItem(this.place);
      else localStorage.setItem(this.place, planText(plan));
    } catch { /* a page without storage, or a full one: the plan can still be saved as a file */ }
  }

  /** Another page is back at the beginning. */
  back() {
    const { original, present } = this.lane.history;
    if (this.session.lane !== this.lane || present === original) return;
    clearTimeout(this.waiting);
    this.waiting = 0;
    this.taking = true;
    this.session.edit(original, "elsewhere");
    this.taking = false;
  }

  /** Take over what another page, or this one before it was loaded again, has kept. */
  take(text, again) {
    if (!text || this.session.lane !== this.lane) return;
    try {
      const plan = readJson(text);
      if (fault(plan, this.lane.history.original)) return;
      this.taking = true;
      this.session.edit(plan, again ? null : "elsewhere");
      if (again) this.say("The edits of this page go on. Undo goes back to the beginning.");
    } catch { /* what cannot be read is not taken */ } finally {
      this.taking = false;
    }
  }
}

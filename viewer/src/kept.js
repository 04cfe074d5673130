// Edits of a page without a program behind it are kept in the browser's storage: a page that is loaded again goes on, and
// pages of one recording agree.

import { fault, planText, readJson } from "./plan.js";

/** Milliseconds after an edit that it is kept. */
const AFTER = 400;
const KEPT = "gesticulator edits ";

export class Kept {
  /** place: of this recording and program in the storage; say(text): what the user is told. */
  constructor(session, place, say) {
    Object.assign(this, { session, place: `${KEPT}${place}`, say, waiting: 0, taking: false, whole: true });
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

  clear() {
    try { localStorage.removeItem(this.place); } catch { /* no storage */ }
  }

  keep() {
    clearTimeout(this.waiting);
    this.waiting = 0;
    const plan = this.lane.history.present;
    if (plan === this.lane.history.original) { this.clear(); return; }
    try { localStorage.setItem(this.place, planText(plan)); this.whole = true; } catch {
      // What is kept of other recordings is not this page's to delete.
      if (this.whole) this.say("This browser has no room for the edits: save the plan as a file before you close the page.", true);
      this.whole = false;
    }
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

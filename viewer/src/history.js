// What was edited, and the way back.

/** How many steps can be undone. */
const MOST = 500;

export class History {
  constructor(present) {
    this.original = this.present = present;
    this.past = [];
    this.future = [];
    this.since = null;
  }

  /** A step forward. kind: steps of one kind that follow each other at once, such as a drag, are one. */
  push(next, kind = null) {
    if (next === this.present) return false;
    const goesOn = kind !== null && kind === this.since;
    if (!goesOn) this.past = [...this.past, this.present].slice(-MOST);
    this.present = next;
    this.future = [];
    this.since = kind;
    return true;
  }

  /** The next step is one of its own, even if it is of the same kind. */
  settle() { this.since = null; }

  undo() {
    if (!this.past.length) return false;
    this.future.push(this.present);
    this.present = this.past.pop();
    this.since = null;
    return true;
  }

  redo() {
    if (!this.future.length) return false;
    this.past.push(this.present);
    this.present = this.future.pop();
    this.since = null;
    return true;
  }

  /** The present told in more detail: no step. */
  refine(present) {
    if (!this.past.length && this.original === this.present) this.original = present;
    this.present = present;
  }
}

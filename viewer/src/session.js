// What is open: the takes, their plans with a way back, what is selected, and who wants to know of changes.

import { History } from "./history.js";
import { blockAt } from "./plan.js";
import { Take } from "./take.js";

export class Session {
  constructor(data) {
    this.data = data;
    this.lanes = data.takes.map((told) => ({ take: new Take(told), history: new History(told.plan), rendered: told.plan }));
    this.active = 0;
    this.selection = null;
    this.beat = null;
    this.listeners = new Map();
  }

  get lane() { return this.lanes[this.active]; }
  get take() { return this.lane.take; }
  get plan() { return this.lane.history.present; }
  get original() { return this.lane.history.original; }

  /** kinds: "edited" (a plan), "selected", "takes" (a motion, or which one is active),
   *  "refused" (an edit of a motion that has no plan), "unrendered" (the plan, which the renderer refused). */
  on(kind, listener) { this.listeners.set(kind, [...(this.listeners.get(kind) ?? []), listener]); }
  tell(kind) { for (const listener of this.listeners.get(kind) ?? []) listener(); }

  /** The blocks that an edit means: those selected, else the one under the playhead. */
  stretch(time) {
    if (this.selection) return this.selection;
    const block = blockAt(this.plan, time);
    return [block, block];
  }

  select(first, last = first) {
    this.selection = first === null ? null : [Math.min(first, last), Math.max(first, last)];
    this.beat = null;
    this.tell("selected");
  }

  selectBeat(beat) {
    this.selection = null;
    this.beat = beat;
    this.tell("selected");
  }

  /** Take over an edited plan. kind: see `History.push`. */
  edit(plan, kind = null) {
    if (this.lane.fixed) { this.tell("refused"); return; }
    if (!plan || !this.lane.history.push(plan, kind)) return;
    this.keepSelection();
    this.tell("edited");
  }

  undo() { this.step("undo"); }
  redo() { this.step("redo"); }

  step(way) {
    if (!this.lane.history[way]()) return;
    this.keepSelection();
    this.tell("edited");
  }

  keepSelection() {
    const last = this.plan.blocks.length - 1;
    if (this.selection) this.selection = this.selection.map((block) => Math.min(block, last));
    if (this.beat !== null && this.beat > last) this.beat = null;
  }

  activate(index) {
    if (index === this.active || !this.lanes[index]) return;
    this.active = index;
    this.selection = this.beat = null;
    this.tell("takes");
    this.tell("edited");
  }

  /** Show another motion in a lane. */
  show(lane, take) {
    lane.take = take;
    this.tell("takes");
  }

  /** A lane's motion is that of the plan `asked`, in more detail: `plan`, where it has not been edited meanwhile. */
  rendered(lane, plan, asked) {
    if (lane.history.present === asked) lane.history.refine(plan);
    lane.rendered = lane.history.present === plan ? plan : asked;
    this.keepSelection();
    this.refining = true;
    this.tell("edited");
    this.refining = false;
  }

  /** Keep the active motion beside the one that is edited on. */
  pin(name) {
    this.setBeside(Take.of({ ...this.take, name }), false);
  }

  /** Set a motion beside the one that is edited on, in the place of what stood there. fixed: it has no plan of its own. */
  setBeside(take, fixed) {
    const plan = this.plan;
    this.lanes = [this.lane, { take, history: new History(plan), rendered: plan, fixed }];
    this.active = 0;
    this.tell("takes");
  }
}

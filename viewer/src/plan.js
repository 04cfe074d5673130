// The gesture plan and the edits of it. A plan is never changed in place: an edit gives a new one, which shares the
// blocks that it left alone. Times are seconds.

import { clamp } from "./numbers.js";

/** Seconds that a block may last; the renderer refuses shorter and longer ones. */
export const SHORTEST = 0.1, LONGEST = 1.0;
export const INTENSITY = { low: 0, high: 2, step: 0.1 };

/** The block under a time: the last one that starts before it. */
export function blockAt(plan, time) {
  let low = 0, high = plan.blocks.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (plan.blocks[middle].start <= time) low = middle; else high = middle - 1;
  }
  return low;
}

/** How the beat that opens block k came to be; beat 0 opens the recording. */
export const beatFlag = (plan, k) => (k === 0 ? "boundary" : plan.blocks[k - 1].flag ?? "edited");

const withBlocks = (plan, blocks) => ({ ...plan, blocks });

function changed(plan, first, last, change) {
  return withBlocks(plan, plan.blocks.map((block, k) => (k < first || k > last ? block : change(block, k))));
}

/** Put another lexeme on blocks: they are drawn anew. name: what it is called, where it has a name. */
export function setLexeme(plan, first, last, lexeme, name = null) {
  return changed(plan, first, last, (block) => {
    const known = block.alternatives?.find((other) => other.lexeme === lexeme);
    return { ...block, lexeme, name: name || known?.name || null, silent: false, score: known?.score ?? null, rank: null };
  });
}

export const setSilent = (plan, first, last, silent) => changed(plan, first, last, (block) => ({ ...block, silent }));
export const setMirror = (plan, first, last, mirror) => changed(plan, first, last, (block) => ({ ...block, mirror }));
export const setLocked = (plan, first, last, locked) => changed(plan, first, last, (block) => ({ ...block, locked }));

export function setIntensity(plan, first, last, intensity) {
  const value = Math.round(clamp(intensity, INTENSITY.low, INTENSITY.high) * 100) / 100;
  return changed(plan, first, last, (block) => ({ ...block, intensity: value }));
}

/** Lock every block but those. */
export function lockTheRest(plan, first, last) {
  return withBlocks(plan, plan.blocks.map((block, k) => ({ ...block, locked: k < first || k > last })));
}

/** How far the beat that opens block k (not the first) may go: [low, high]; no way where low is above high. */
export function beatRange(plan, k) {
  const { start } = plan.blocks[k - 1], { end } = plan.blocks[k];
  return [Math.max(start + SHORTEST, end - LONGEST), Math.min(end - SHORTEST, start + LONGEST)];
}

const rounded = (time) => Math.round(time * 1000) / 1000;

export function moveBeat(plan, k, time) {
  const [low, high] = beatRange(plan, k), at = rounded(clamp(time, low, high));
  if (low > high || at === plan.blocks[k].start) return plan;
  return withBlocks(plan, plan.blocks.map((block, b) => (
    b === k - 1 ? { ...block, end: at, flag: "edited" } : b === k ? { ...block, start: at } : block)));
}

/** Whether the beat that opens block k may be taken away. */
export const canDelete = (plan, k) => k > 0 && k < plan.blocks.length && plan.blocks[k].end - plan.blocks[k - 1].start <= LONGEST + 1e-6;

/** Take the beat that opens block k away: the block before goes on to the end of block k, and keeps its gesture. */
export function deleteBeat(plan, k) {
  if (!canDelete(plan, k)) return plan;
  const before = plan.blocks[k - 1], gone = plan.blocks[k];
  const joined = { ...before, end: gone.end, flag: gone.flag };
  return withBlocks(plan, [...plan.blocks.slice(0, k - 1), joined, ...plan.blocks.slice(k + 1)]);
}

/** Put a beat at a time: the block there becomes two of one gesture; `null` where it is too short for that. */
export function addBeat(plan, time) {
  const k = blockAt(plan, time), block = plan.blocks[k];
  if (block.end - block.start < 2 * SHORTEST + 1e-9) return null;
  // Near an edge it goes as far from it as a block must last.
  const at = rounded(clamp(time, block.start + SHORTEST + 5e-4, block.end - SHORTEST - 5e-4));
  if (at - block.start < SHORTEST || block.end - at < SHORTEST) return null;
  const second = drawnAnew({ ...block, start: at });
  return withBlocks(plan, [...plan.blocks.slice(0, k), { ...block, end: at, flag: "edited" }, second, ...plan.blocks.slice(k + 1)]);
}

/** How far the end of blocks may go when they are stretched alike: [low, high]; no way where low is above high. */
export function stretchRange(plan, first, last) {
  const after = plan.blocks[last + 1], { start } = plan.blocks[first], span = plan.blocks[last].end - start;
  if (!after) return [0, -1];
  const lengths = plan.blocks.slice(first, last + 1).map((block) => block.end - block.start);
  return [Math.max(start + (span * SHORTEST) / Math.min(...lengths), after.end - LONGEST), Math.min(start + (span * LONGEST) / Math.max(...lengths), after.end - SHORTEST)];
}

/** Blocks stretched or squeezed alike, so that they end at a time, as far as blocks may; the block after them gives way. */
export function stretched(plan, first, last, end) {
  const [low, high] = stretchRange(plan, first, last), { start } = plan.blocks[first], before = plan.blocks[last].end;
  // A millisecond of room, since times are rounded to it.
  if (low + 1e-3 > high - 1e-3) return plan;
  const at = clamp(end, low + 1e-3, high - 1e-3), share = (at - start) / (before - start);
  if (rounded(at) === rounded(before)) return plan;
  const moved = (time) => rounded(start + (time - start) * share);
  return withBlocks(plan, plan.blocks.map((block, k) => {
    if (k < first || k > last + 1) return block;
    if (k > last) return { ...block, start: moved(before) };
    return { ...block, start: k === first ? start : moved(block.start), end: moved(block.end), flag: "edited" };
  }));
}

const drawnAnew = (block) => (block.draw ? { ...block, draw: { ...block.draw, variation: (block.draw.variation + 1) % 2 ** 32 } } : block);

/** The same lexemes in another manner. */
export const drawAgain = (plan, first, last) => changed(plan, first, last, drawnAnew);

/** Turn a knob of the whole take. */
export const setKnob = (plan, name, value) => ({ ...plan, knobs: { ...plan.knobs, [name]: value } });

/** The blocks of a gesture unit: [first, last]. */
export function blocksOfUnit(plan, unit) {
  const first = blockAt(plan, unit.start + 1e-3), last = blockAt(plan, unit.end - 1e-3);
  return [first, Math.max(first, last)];
}

/** The gesture phrases of a unit, each with one stroke and what belongs to it: [{ start, end, stroke: when that begins }]. */
export function phrasesOf(unit) {
  const phrases = [];
  let stroked = true;
  for (const { kind, start, end } of unit.phases ?? []) {
    if (!phrases.length || (stroked && ["preparation", "pre-stroke hold", "stroke"].includes(kind))) {
      phrases.push({ start, end, stroke: start });
      stroked = false;
    }
    if (kind === "stroke") {
      stroked = true;
      phrases.at(-1).stroke = start;
    }
    phrases.at(-1).end = end;
  }
  return phrases.length ? phrases : [unit];
}

/** What blocks can hand on to others: their gestures, sizes and sides. */
export const copied = (plan, first, last) => plan.blocks.slice(first, last + 1)
  .map(({ lexeme, name = null, silent, intensity = 1, mirror = false }) => ({ lexeme, name, silent, intensity, mirror, score: null, rank: null }));

/** Put the gestures of copied blocks on as many blocks from one on. */
export const pasted = (plan, at, gestures) => changed(plan, at, at + gestures.length - 1, (block, k) => ({ ...block, ...gestures[k - at] }));

/** Blocks drawn with another variation: the same lexemes in a manner of its own for each number from 1. */
export const varied = (plan, first, last, number) => changed(plan, first, last, (block) => (
  block.draw ? { ...block, draw: { ...block.draw, variation: (block.draw.variation + number) % 2 ** 32 } } : block));

/** The gestures of blocks where another block begins, and rest where they were; copy: and there, too. */
export function movedTo(plan, first, last, at, copy = false) {
  return at === first ? plan : pasted(copy ? plan : setSilent(plan, first, last, true), at, copied(plan, first, last));
}

/** Blocks moved by seconds, as far as the blocks before and after them can give way. */
export function slid(plan, first, last, by) {
  const before = plan.blocks[first - 1], after = plan.blocks[last + 1];
  if (!before || !after) return plan;
  const long = before.end - before.start, rest = after.end - after.start;
  const low = Math.max(SHORTEST - long, rest - LONGEST) + 1e-3, high = Math.min(LONGEST - long, rest - SHORTEST) - 1e-3;
  if (low > high) return plan;
  const way = clamp(by, low, high), moved = (time) => rounded(time + way);
  if (rounded(way) === 0) return plan;
  return withBlocks(plan, plan.blocks.map((block, k) => {
    if (k < first - 1 || k > last + 1) return block;
    return { ...block, start: k < first ? block.start : moved(block.start), end: k > last ? block.end : moved(block.end), flag: k > last ? block.flag : "edited" };
  }));
}

/** Blocks dragged so that the first one begins at a time: [plan, where the first one is]. By a beat or more they go to
 *  another beat, by less with their own edges. */
export function dragged(plan, first, last, time, copy = false) {
  const { start } = plan.blocks[first], k = blockAt(plan, time), next = plan.blocks[k + 1];
  const nearest = next && next.start - time < time - plan.blocks[k].start ? k + 1 : k;
  const place = clamp(nearest, 0, plan.blocks.length - 1 - (last - first));
  return [place === first ? slid(plan, first, last, time - start) : movedTo(plan, first, last, place, copy), place];
}

/** Times that others snap to: where words begin and end, and the beats as they were found. */
export function marksOf(plan, original) {
  return [...(plan.words ?? []).flatMap(({ start, end }) => [start, end]), ...original.blocks.map(({ start }) => start)];
}

/** The nearest of some times, where one is within `near` seconds; else the time itself. */
export function snapped(time, marks, near) {
  let best = time, least = near;
  for (const mark of marks) {
    const far = Math.abs(mark - time);
    if (far < least) { best = mark; least = far; }
  }
  return best;
}

/** Put blocks back as they were in another plan: those of it that start within the stretch and stand on its edges. */
export function restored(plan, original, first, last) {
  const from = plan.blocks[first].start, to = plan.blocks[last].end;
  const there = original.blocks.filter((block) => block.start >= from - 1e-6 && block.end <= to + 1e-6);
  const whole = there.length && Math.abs(there[0].start - from) < 1e-6 && Math.abs(there.at(-1).end - to) < 1e-6;
  return whole ? withBlocks(plan, [...plan.blocks.slice(0, first), ...there, ...plan.blocks.slice(last + 1)]) : null;
}

/** What can be edited of a block, as one text; what is left out of a file has its default. */
const told = ({ start, end, lexeme, silent, intensity = 1, mirror = false, locked = false, draw }) => (
  [start, end, lexeme, Boolean(silent), intensity, mirror, locked, draw?.variation].join());

/** Whether a block of a plan is unlike every block of another one. */
export function differs(block, original) {
  const same = original.blocks[blockAt(original, (block.start + block.end) / 2)];
  return block !== same && told(block) !== told(same);
}

/** How many edits lie between two plans: blocks that differ, knobs, and gestures asked for. */
export function countChanges(plan, original) {
  if (plan === original) return 0;
  const here = plan.blocks.filter((block) => differs(block, original)).length || Math.abs(plan.blocks.length - original.blocks.length);
  const plain = (part) => JSON.stringify(part && Object.keys(part).length ? part : null);
  const parts = ["knobs", "cues", "meanings", "pins", "curves", "speaker", "interpreter", "variation", "made_by"].filter((name) => plain(plan[name]) !== plain(original[name]));
  return here + parts.length;
}

/** What is wrong with a plan that somebody opens, in words; null where nothing is. */
export function fault(plan, original) {
  if (!plan || typeof plan !== "object" || !Array.isArray(plan.blocks) || !plan.blocks.length) {
    return "The file is no plan: it has no list of blocks.";
  }
  let at = 0;
  for (const [k, block] of plan.blocks.entries()) {
    if (!block || typeof block !== "object") return `Block ${k + 1} of the plan is no block.`;
    const { start, end, lexeme, intensity } = block;
    if (![start, end].every(Number.isFinite) || end <= start) return `Block ${k + 1} of the plan has no length.`;
    if (Math.abs(start - at) > 1e-3) return `Block ${k + 1} of the plan does not begin where block ${k} ends.`;
    if (lexeme !== null && !(Number.isInteger(lexeme) && lexeme >= 0)) return `Block ${k + 1} of the plan has no lexeme (a whole number).`;
    if (intensity != null && !(intensity >= INTENSITY.low && intensity <= INTENSITY.high)) {
      return `Block ${k + 1} of the plan has an intensity outside of 0 to 2.`;
    }
    at = end;
  }
  const whole = original.blocks.at(-1).end, [theirs, ours] = [plan.sound?.sha256, original.sound?.sha256];
  if (theirs && ours && theirs !== ours) return `The plan is of another recording${plan.sound.name ? `, ${plan.sound.name}` : ""}.`;
  if (Math.abs(at - whole) > 0.05) return `The plan is of another recording: ${at.toFixed(2)} s, not ${whole.toFixed(2)} s.`;
  return null;
}

/** A plan as text, and back: seeds may have more digits than a number of JavaScript holds. */
export const planText = (plan) => `${JSON.stringify(plan, null, 1)}\n`;
export const readJson = (text) => JSON.parse(text, (_, value, context) => (
  typeof value === "number" && Math.abs(value) > Number.MAX_SAFE_INTEGER && context?.source && JSON.rawJSON ? JSON.rawJSON(context.source) : value));

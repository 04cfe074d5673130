// Gestures asked for at a word or at a time, and those that words call for. A plan with other ones is a new plan.

const plain = (text) => text.replace(/^[\p{P}\s]+|[\p{P}\s]+$/gu, "").toLowerCase();

/** When a cue's stroke arrives, in seconds: a third into its word; null where that is not said. */
export function cueTime(plan, cue) {
  if (cue.time != null) return cue.time;
  const said = (plan.words ?? []).filter((word) => plain(word.text) === plain(cue.word ?? ""));
  const word = said[(cue.occurrence ?? 1) - 1];
  return word ? word.start + (word.end - word.start) / 3 : null;
}

const asked = (plan) => plan.cues ?? [];
const meant = (plan) => (plan.meanings ?? []).filter(({ gesture }) => gesture != null);

/** The gestures of a plan: those that were asked for, then those that words call for. */
export const cuesOf = (plan) => [...asked(plan), ...meant(plan)];

/** The word under a time as a cue names it: { word, occurrence }; null between words. */
function wordAt(plan, time) {
  const words = plan.words ?? [], here = words.findIndex((word) => time >= word.start && time < word.end);
  if (here < 0) return null;
  const { text } = words[here], same = words.slice(0, here + 1).filter((word) => plain(word.text) === plain(text));
  return { word: text, occurrence: same.length };
}

/** Ask for a gesture at a time: at the word there, where one is said. */
export function addCue(plan, gesture, time) {
  const at = wordAt(plan, time) ?? { time: Math.round(time * 1000) / 1000 };
  return { ...plan, cues: [...asked(plan), { gesture, ...at }] };
}

/** Move a gesture that was asked for to a time: to the word there, where one is said. */
export function moveCue(plan, index, time) {
  if (index >= asked(plan).length) return plan;
  const { word, occurrence, time: _, ...cue } = asked(plan)[index], at = wordAt(plan, time) ?? { time: Math.round(Math.max(time, 0) * 1000) / 1000 };
  if (at.word === word && (at.occurrence ?? 1) === (occurrence ?? 1) && at.time === _) return plan;
  return { ...plan, cues: asked(plan).map((one, k) => (k === index ? { ...cue, ...at } : one)) };
}

/** Remove the gesture at an index of `cuesOf`. */
export function removeCue(plan, index) {
  const gone = cuesOf(plan)[index];
  if (index < asked(plan).length) return { ...plan, cues: asked(plan).filter((cue) => cue !== gone) };
  return { ...plan, meanings: plan.meanings.filter((meaning) => meaning !== gone) };
}

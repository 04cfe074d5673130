// Gestures asked for at a word or at a time. A plan with other cues is a new plan.

const plain = (text) => text.replace(/^[\p{P}\s]+|[\p{P}\s]+$/gu, "").toLowerCase();

/** When a cue's stroke arrives, in seconds: a third into its word; null where that is not said. */
export function cueTime(plan, cue) {
  if (cue.time != null) return cue.time;
  const said = (plan.words ?? []).filter((word) => plain(word.text) === plain(cue.word ?? ""));
  const word = said[(cue.occurrence ?? 1) - 1];
  return word ? word.start + (word.end - word.start) / 3 : null;
}

export const cuesOf = (plan) => plan.cues ?? [];

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
  return { ...plan, cues: [...cuesOf(plan), { gesture, ...at }] };
}

export const removeCue = (plan, index) => ({ ...plan, cues: cuesOf(plan).filter((_, k) => k !== index) });

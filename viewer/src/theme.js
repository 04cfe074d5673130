// Colours and the size of text, as the style sheet has them, for what is drawn on canvases.

const NAMES = ["page", "desk", "line", "ink", "soft", "wave", "wave-played", "accent", "silence", "track", "onset", "loud", "even",
  "boundary", "playhead", "shirt", "shirt-b", "trousers", "skin", "shoe", "hair", "grid", "left", "right", "light", "select"];

export const colours = {};

/** CSS pixels of one unit of drawing: 1 at a text of 14 pixels, more on large screens. */
export const sizes = { unit: 1 };

export function readTheme() {
  const style = getComputedStyle(document.documentElement);
  for (const name of NAMES) colours[name] = style.getPropertyValue(`--${name}`).trim();
  sizes.unit = parseFloat(style.fontSize) / 14;
}

/** Neighbouring lexemes get far hues (the golden angle). */
export const lexemeColour = (id) => `hsl(${(id * 137.508) % 360} 48% 72%)`;

// The mouth of our own figure: from the 20 numbers of a face to the outlines of lips and teeth. Metres, for a head of the usual size.

/** Places of the numbers in a face: 15 visemes, blink, brows, smile, gaze to the left and up (radians). */
export const BLINK = 15, BROWS = 16, SMILE = 17, LEFT = 18, UP = 19, NUMBERS = 20;
const CLOSED = 1, BITES = 2; // p, b, m; f, v
/** Opening and width of the mouth in each viseme: sil PP FF TH DD kk CH SS nn RR aa E ih oh ou. */
const OPEN = [0, 0, 0.12, 0.3, 0.25, 0.3, 0.25, 0.15, 0.25, 0.25, 1, 0.65, 0.4, 0.75, 0.35];
const WIDE = [0, -0.05, 0.1, 0.05, 0.1, 0.1, -0.45, 0.25, 0.05, -0.4, 0.05, 0.3, 0.45, -0.55, -0.9];
/** Half the width of a mouth at rest, its widest gap, and the gap that is left of a shut one: the line between the lips. */
const HALF = 0.0225, GAP = 0.025, LINE = 0.0009;
const UPPER_LIP = 0.0046, LOWER_LIP = 0.0062, TEETH = 0.0055;
const CORNERS = 0.006; // that a smile lifts the corners

export function mouthOf(face) {
  let open = 0, wide = 0;
  for (let v = 0; v < OPEN.length; v++) { open += OPEN[v] * face[v]; wide += WIDE[v] * face[v]; }
  return { open: Math.min(1, open), wide, press: face[CLOSED], bite: face[BITES], smile: face[SMILE] };
}

/** From one corner to the other: rows of x and the heights of the upper lip's edges, the teeth's, and the lower lip's edges. */
export function lipCurves({ open, wide, press, bite, smile }, count) {
  const half = HALF * (1 + 0.32 * wide + 0.14 * Math.max(smile, 0)), full = 1 + 0.35 * Math.max(-wide, 0) - 0.5 * press;
  return Array.from({ length: count }, (_, k) => {
    const t = -1 + (2 * k) / (count - 1), bump = Math.max(1 - t * t, 0) ** 0.7, line = smile * CORNERS * (t * t - 0.4);
    const top = line + bump * (LINE / 2 + 0.3 * GAP * open + 0.002 * bite), bottom = line - bump * (LINE / 2 + 0.7 * GAP * open);
    // The upper lip dips in the middle.
    const upper = top + bump * full * UPPER_LIP * (1 - 0.25 * Math.exp(-((t / 0.2) ** 2)));
    const lower = bottom - bump * full * LOWER_LIP * (1 - 0.55 * bite);
    return [t * half, upper, top, Math.max(bottom, top - TEETH), bottom, lower];
  });
}

// The outline of a column: the tangents of its slices, as gesticulator/characters/trunk.py has it.

/** Directions in which a slice is measured. */
export const ANGLES = 36;

/** The normals of the tangents: [left, ahead]. */
export const directions = [...Array(ANGLES).keys()].map((k) => [Math.cos((k * 2 * Math.PI) / ANGLES), Math.sin((k * 2 * Math.PI) / ANGLES)]);

const EVERY = [...directions.keys()];

/** The outline of a column of constant half width and half depth: per height, metres from the line of the bones to the
 *  tangents with normals from left by ahead. */
export function ellipse(width, depth) {
  const row = directions.map(([x, z]) => Math.hypot(width * x, depth * z));
  return { steps: [0, 1], reach: [row, row] };
}

/** The value of rows `values` at rising `steps`, on the straight line; constant beyond the ends. */
function between(x, steps, values) {
  let k = 0;
  while (k < steps.length - 1 && steps[k + 1] < x) k++;
  if (k === steps.length - 1 || x <= steps[0]) return values[x <= steps[0] ? 0 : k];
  return values[k] + ((x - steps[k]) / (steps[k + 1] - steps[k])) * (values[k + 1] - values[k]);
}

/** Metres from the line of the bones to the tangent with a normal [left, ahead], at a height. */
export function support({ steps, reach }, share, [x, z]) {
  const turn = Math.atan2(z, x) / (2 * Math.PI), column = (turn - Math.floor(turn)) * ANGLES;
  const first = Math.floor(column) % ANGLES, on = column - Math.floor(column);
  return between(share, steps, reach.map((row) => (1 - on) * row[first] + on * row[(first + 1) % ANGLES]));
}

/** Metres to the tangents in some directions, by default all, at a height. */
export function rowAt({ steps, reach }, share, columns = EVERY) {
  let k = 0;
  while (k < steps.length - 1 && steps[k + 1] < share) k++;
  const whole = k === steps.length - 1 || share <= steps[0];
  const low = reach[whole && share <= steps[0] ? 0 : k], high = whole ? low : reach[k + 1];
  const on = whole ? 0 : (share - steps[k]) / (steps[k + 1] - steps[k]);
  return columns.map((column) => (1 - on) * low[column] + on * high[column]);
}

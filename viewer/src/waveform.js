// The waveform, from the lowest and highest samples of short stretches.

import { clamp } from "./numbers.js";
import { colours } from "./theme.js";

export class Waveform {
  /** peaks: int8 pairs, `rate` of them a second. */
  constructor(peaks, rate, duration) {
    Object.assign(this, { peaks, rate, duration });
  }

  /** left: seconds at the left edge; scale: pixels a second; box: { width, top, tall }; time: up to which it is played. */
  draw(pen, left, scale, { width, top, tall }, time) {
    const count = this.peaks.length / 2, middle = top + tall / 2, half = (tall / 2 - 2) / 127;
    const upTo = Math.min(width, (this.duration - left) * scale);
    for (let column = 0; column < upTo; column++) {
      const begin = left + column / scale, end = left + (column + 1) / scale;
      const from = clamp(Math.floor(begin * this.rate), 0, count - 1), to = clamp(Math.ceil(end * this.rate), from + 1, count);
      let low = 127, high = -127;
      for (let k = from; k < to; k++) {
        low = Math.min(low, this.peaks[2 * k]);
        high = Math.max(high, this.peaks[2 * k + 1]);
      }
      pen.fillStyle = begin <= time ? colours["wave-played"] : colours.wave;
      pen.fillRect(column, middle - high * half, 1, Math.max((high - low) * half, 1));
    }
  }
}

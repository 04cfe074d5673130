// Time follows the sound; where the browser cannot play it, a silent clock of the same manners takes over.

import { bytesOf, clamp } from "./numbers.js";

export class Clock {
  constructor(sound, duration, changed) {
    Object.assign(this, { sound, duration, changed, audible: false, playing: false, speed: 1, from: 0, since: 0 });
    this.range = null;
    this.loop = false;
  }

  get time() {
    if (this.audible) return this.sound.currentTime;
    const run = this.playing ? ((performance.now() - this.since) / 1000) * this.speed : 0;
    return clamp(this.from + run, 0, this.duration);
  }

  get begin() { return this.range?.[0] ?? 0; }
  get end() { return this.range?.[1] ?? this.duration; }

  load(base64, type, failed) {
    const { sound } = this;
    sound.addEventListener("loadedmetadata", () => { this.audible = true; if (this.from) sound.currentTime = this.from; });
    sound.addEventListener("ended", () => this.reachedEnd());
    sound.addEventListener("seeked", this.changed);
    sound.addEventListener("error", () => { this.audible = false; failed(); });
    sound.preservesPitch = true;
    sound.src = URL.createObjectURL(new Blob([bytesOf(base64)], { type }));
  }

  seek(time) {
    const to = clamp(time, 0, this.duration);
    if (this.audible) this.sound.currentTime = to;
    this.from = to;
    this.since = performance.now();
    this.changed();
  }

  async play() {
    const { time } = this;
    if (time >= this.end - 0.02 || (this.range && time < this.begin)) this.seek(this.begin);
    this.from = this.time;
    this.since = performance.now();
    this.playing = true;
    if (this.audible) await this.sound.play().catch(() => { this.playing = false; });
    this.changed();
  }

  pause() {
    this.from = this.time;
    this.playing = false;
    if (this.audible) this.sound.pause();
    this.changed();
  }

  toggle() { if (this.playing) this.pause(); else this.play(); }

  /** To be called at every picture: turns back or stops at the end of the range. */
  tick() {
    if (this.playing && this.time >= this.end && (this.range || !this.audible)) this.reachedEnd();
  }

  reachedEnd() {
    if (this.loop) {
      this.seek(this.begin);
      if (this.audible && this.sound.paused) this.sound.play().catch(() => this.pause());
      return;
    }
    const { end } = this;
    this.pause();
    this.seek(end);
  }

  setSpeed(speed) {
    this.from = this.time;
    this.since = performance.now();
    this.speed = speed;
    this.sound.playbackRate = speed;
  }

  /** Play only from one time to another; `null` for the whole. */
  setRange(from, to) {
    this.range = from === null || (from <= 0 && to >= this.duration) || to - from < 0.05 ? null : [from, to];
    this.changed();
  }
}

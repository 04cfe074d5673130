// Small sums that many modules need. Times are seconds.

export const clamp = (x, low, high) => Math.min(high, Math.max(low, x));

/** The bytes that a base64 text holds. */
export function bytesOf(base64) {
  const text = atob(base64);
  const out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out;
}

/** Seconds as minutes and seconds: 75.25 with two digits is "1:15.25". */
export function minutes(time, digits) {
  const unit = 10 ** digits;
  const whole = (digits ? Math.round(Math.max(0, time) * unit) : Math.floor(Math.max(0, time))) / unit;
  const m = Math.floor(whole / 60), s = whole - m * 60;
  return `${m}:${s.toFixed(digits).padStart(digits ? 3 + digits : 2, "0")}`;
}

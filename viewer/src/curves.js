// Knobs that vary over time: size of the gestures, and height, speed and radius of the hands. Each is a list of points,
// [seconds, value]; one point is a value for the whole take. A plan with another curve is a new plan.

/** The knobs: what they are called, their unit, the range of the row on the timeline, the step of values, and the value
 *  that changes nothing (null where none does). levels: feature -> [low, middle, high], where the hands can be controlled. */
export function knobsOf(levels) {
  const knobs = {
    intensity: { name: "size", unit: "", low: 0, high: 2, step: 0.05, neutral: 1 },
  };
  const named = { height: ["height of the hands", "m"], speed: ["speed of the hands", "m/s"], radius: ["radius of the hands", "m"] };
  for (const [knob, [low, , high]] of Object.entries(levels ?? {})) {
    const [name, unit] = named[knob], room = (high - low) / 2, round = (value) => Math.round(value * 100) / 100;
    knobs[knob] = { name, unit, low: round(Math.max(low - room, knob === "height" ? -1 : 0)), high: round(high + room), step: 0.01, neutral: null };
  }
  return knobs;
}

/** The points of the curve of a knob, in order. */
export function curveOf(plan, knob = "intensity") {
  const curve = (plan.curves ?? []).find((one) => one.knob === knob);
  return curve ? curve.times.map((time, k) => [time, curve.values[k]]) : [];
}

/** A plan with these points of a knob's curve; without points, without the curve. */
export function withCurve(plan, points, knob = "intensity") {
  const others = (plan.curves ?? []).filter((one) => one.knob !== knob);
  const sorted = [...points].sort((a, b) => a[0] - b[0]).filter(([time], k, all) => k === 0 || time > all[k - 1][0]);
  const curves = sorted.length ? [...others, { knob, times: sorted.map(([time]) => time), values: sorted.map(([, value]) => value) }] : others;
  const { curves: _, ...rest } = plan;
  return curves.length ? { ...rest, curves } : rest;
}

/** The value of a curve of these points at a time; null without points. */
export function valueAt(points, time) {
  if (!points.length) return null;
  const next = points.findIndex(([at]) => at >= time);
  if (next < 0) return points.at(-1)[1];
  if (next === 0) return points[0][1];
  const [[from, low], [to, high]] = [points[next - 1], points[next]];
  return low + ((high - low) * (time - from)) / (to - from);
}

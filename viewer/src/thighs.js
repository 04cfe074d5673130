// The thighs of a character that sits, above which its hands are kept, as gesticulator/characters/thighs.py does it.

import { clamp } from "./numbers.js";
import { ANGLES, directions, rowAt } from "./outline.js";

/** Metres around the bone of our own thigh, at hip and knee. */
export const OUR_RADII = [0.076, 0.056];
/** Joints of a hand that are kept above thighs with its wrist and knuckles. */
export const FINGERTIPS = ["HandThumb3", "HandIndex3", "HandMiddle3", "HandRing3", "HandPinky3"];
/** The first slice of a thigh that is measured, the one after the last, and how many are between hip and knee. */
export const THIGH_SLICES = [-1, 9, 8];
/** Cosine between thighs and straight down below which a body sits; metres: half a hand, and up to which one is near. */
const LEVEL = 0.7, THICK = 0.015, MARGIN = 0.03;
/** Slope beyond the ends of a thigh, and metres over which it begins. */
const STEEPEST = 1.2, ROUND = 0.05;
/** Of the tangents those from 40 to 140 degrees. */
const UPPER = [...Array(11).keys()].map((k) => k + 4);

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((value) => value / Math.max(Math.hypot(...a), 1e-9));

/** The outline of a round thigh with these radii at hip and knee. */
export const tapering = (...radii) => ({ steps: [0, 1], reach: radii.map((radius) => Array(ANGLES).fill(radius)) });

/** Whether a thigh is that of a body that sits. */
export const isLevel = (hip, knee) => hip[1] - knee[1] < LEVEL * Math.hypot(...knee.map((value, c) => value - hip[c]));

/** To the left of a thigh, which is level, up, and along it; and its length. */
export function thighAxes(hip, knee) {
  const way = knee.map((value, c) => value - hip[c]), along = unit(way), left = unit(cross([0, 1, 0], along));
  return { left, up: cross(along, left), along, length: Math.hypot(...way) };
}

/** A thigh between two joints, places from the hips. */
export function thighOf(hip, knee, outline) {
  return { hip, outline, ...thighAxes(hip, knee), most: Math.max(...outline.reach.flatMap((row) => UPPER.map((k) => row[k] / directions[k][1]))) };
}

/** Metres by which a point is under the surface of a thigh, negative above it, and the way up. One that is above the
 *  thigh by more than `far` is only known to be so. */
export function depthIn({ hip, left, up, along, length, outline, most }, point, far = Infinity) {
  const way = point.map((value, c) => value - hip[c]), height = dot(way, up);
  if (height - most > far) return { depth: most - height, up };
  const across = dot(way, left), on = dot(way, along), beyond = Math.max(-on, on - length, 0);
  const row = rowAt(outline, on / Math.max(length, 1e-9), UPPER);
  let top = Infinity;
  UPPER.forEach((k, at) => { top = Math.min(top, (row[at] - across * directions[k][0]) / directions[k][1]); });
  return { depth: top - STEEPEST * (Math.hypot(beyond, ROUND) - ROUND) - height, up };
}

/** Metres that a point of a hand belongs above a thigh, of an arm as long as ours: as far as our own point from our thigh,
 *  if that is near; half a hand where we do not sit. */
export function marginAbove(ours, point) {
  const gap = ours ? clamp(-depthIn(ours, point).depth, 0, 2 * MARGIN) : 0;
  return Math.max(gap - gap ** 2 / (4 * MARGIN), THICK);
}

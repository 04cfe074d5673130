// The hands of our own figure: with fingers where the motion has them, else one relaxed piece. Metres.

import { Group, Vector3 } from "three";

/** A hand whose fingers move: each bone drawn where the data has it. */
export function fingeredHand(figure, side) {
    const zero = new Vector3(), hand = figure.bone(side + "Hand"), long = figure.offset(side + "HandMiddle1");
  const s = long.length() / 0.086;
  figure.ball(hand, [0, 0, 0], [0.027, 0.024, 0.027], "skin");
  const thick = { Thumb: 0.0125, Index: 0.0100, Middle: 0.0104, Ring: 0.0099, Pinky: 0.0086 };
  for (const [finger, wide] of Object.entries(thick)) {
    const joint = (n) => `${side}Hand${finger}${n}`;
    // From the wrist through the palm; the thumb's ball is thicker than what follows.
    figure.limb(hand, figure.offset(joint(1)).clone().multiplyScalar(0.18), figure.offset(joint(1)), 0.0165 * s, wide * 1.25 * s, "skin");
    for (const n of [1, 2, 3]) {
      const tip = figure.tree.tips[joint(n)];
      const end = n < 3 ? figure.offset(joint(n + 1)) : tip ? new Vector3().fromArray(tip) : figure.offset(joint(n)).clone().multiplyScalar(0.8);
      figure.limb(figure.bone(joint(n)), zero, end, wide * (1.06 - 0.08 * n) * s, wide * (0.98 - 0.08 * n) * s, "skin");
    }
  }
  // The palm: a flat ball between the knuckles and the wrist.
  const palm = figure.ball(hand, long.clone().multiplyScalar(0.55).toArray(), [0.046 * s, 0.0145 * s, 0.037 * s], "skin");
  palm.quaternion.setFromUnitVectors(new Vector3(Math.sign(long.x) || 1, 0, 0), long.clone().normalize());
}

/** A relaxed hand: palm down in the rest pose, thumb forward, fingers slightly curled. */
export function relaxedHand(figure, hand, tip) {
    const frame = new Group();
  frame.quaternion.setFromUnitVectors(new Vector3(Math.sign(tip.x) || 1, 0, 0), tip.clone().normalize());
  hand.add(frame);
  const way = Math.sign(tip.x) || 1, s = tip.length() / 0.16;
  const point = (x, y, z) => new Vector3(way * x * s, y * s, z * s);
  figure.ball(frame, [0, 0, 0], [0.027, 0.024, 0.027], "skin");
  const palm = figure.ball(frame, [way * 0.048 * s, -0.002, 0.002], [0.050 * s, 0.0165 * s, 0.041 * s], "skin");
  palm.rotation.z = 0;
  const fingers = [[0.030, 0.032, 0.068], [0.0105, 0.0115, 0.076], [-0.0095, -0.010, 0.070], [-0.028, -0.031, 0.056]];
  for (const [z0, z1, long] of fingers) {
    const root = point(0.078, -0.001, z0), middle = point(0.078 + long * 0.5, -0.008, (z0 + z1) / 2);
    const end = point(0.078 + long * 0.93, -0.026, z1);
    figure.limb(frame, root, middle, 0.0095 * s, 0.0088 * s, "skin");
    figure.limb(frame, middle, end, 0.0088 * s, 0.0072 * s, "skin");
  }
  figure.limb(frame, point(0.018, -0.006, 0.026), point(0.058, -0.018, 0.056), 0.0135 * s, 0.0105 * s, "skin");
  figure.limb(frame, point(0.058, -0.018, 0.056), point(0.090, -0.026, 0.063), 0.0105 * s, 0.0085 * s, "skin");
}

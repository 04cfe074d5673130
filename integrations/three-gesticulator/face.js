// A face on a VRM of @pixiv/three-vrm: its expressions and its gaze. Of a stream with the option `face`.

/** Places of the numbers in a face: 15 visemes (sil PP FF TH DD kk CH SS nn RR aa E ih oh ou), then these; the gaze in radians. */
const BLINK = 15, SMILE = 17, LEFT = 18, UP = 19;
/** The vowel of the format -> what of each viseme it takes, by its place. */
const VOWELS = {
  aa: { 10: 1, 5: 0.1 }, ee: { 11: 1 }, ih: { 12: 1, 2: 0.1, 3: 0.3, 4: 0.3, 5: 0.15, 7: 0.3, 8: 0.25 }, oh: { 13: 1, 9: 0.3 }, ou: { 14: 1, 6: 0.45 },
};
const MOOD = 0.6; // of an emotion at a mood of 1: more changes the mouth too much to speak

/** The weight of each expression (aa, ih, ou, ee, oh, blink, happy, sad), 0 to 1. */
export function expressionsOf(face) {
  const clip = (weight) => Math.min(1, Math.max(0, weight));
  const vowels = Object.entries(VOWELS).map(([name, shares]) => [name, Object.entries(shares).reduce((sum, [at, share]) => sum + share * face[at], 0)]);
  return Object.fromEntries([...vowels, ["blink", face[BLINK]], ["happy", MOOD * face[SMILE]], ["sad", -MOOD * face[SMILE]]].map(([name, weight]) => [name, clip(weight)]));
}

/** Show a face, 20 numbers. Call vrm.update() afterwards. lipsOnly: leave lids, emotions and gaze to others. */
export function showFace(vrm, face, lipsOnly = false) {
  for (const [name, weight] of Object.entries(expressionsOf(face))) {
    if (!lipsOnly || name in VOWELS) vrm.expressionManager?.setValue(name, weight);
  }
  if (lipsOnly || !vrm.lookAt) return;
  vrm.lookAt.yaw = (face[LEFT] * 180) / Math.PI;
  vrm.lookAt.pitch = (-face[UP] * 180) / Math.PI;
}

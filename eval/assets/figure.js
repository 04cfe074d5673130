// ---------------------------------------------------------------- the figure

const colours = { shirt: "#3d7a85", trousers: "#4a4f5c", skin: "#dcb999", hair: "#5b493d", nose: "#c79d7a", shoe: "#262a31", floor: "#d9d0c2", paper: "#ece6db" };
// Everyone sees every clip from here: a little to the figure's left and above, for the depth of a gesture.
const camera = { yaw: 0.3, pitch: 0.09, distance: 4.6, middle: [0, 0.93, 0], zoom: 0.47 };
const at = Object.fromEntries((data.points ?? []).map((name, k) => [name, k]));
const mix = (a, b, share) => a.map((x, c) => x * (1 - share) + b[c] * share);
const plus = (a, b) => a.map((x, c) => x + b[c]);
const minus = (a, b) => a.map((x, c) => x - b[c]);

/** Every point at a time, [x, y, z] metres, between the two nearest frames. */
function pose(motion, time) {
  const wide = data.points.length * 3, frames = motion.length / wide;
  const x = clamp(time * data.fps, 0, frames - 1), a = Math.floor(x), b = Math.min(a + 1, frames - 1), share = x - a;
  const out = {};
  for (const name in at) {
    const k = at[name] * 3;
    out[name] = [0, 1, 2].map((c) => (motion[a * wide + k + c] * (1 - share) + motion[b * wide + k + c] * share) / data.stepsPerMetre);
  }
  return out;
}

/** A place on the canvas: x, y in pixels, size in pixels per metre, depth towards the viewer in metres. */
function project(point, view) {
  const [x, y, z] = minus(point, camera.middle);
  const across = x * Math.cos(camera.yaw) - z * Math.sin(camera.yaw), ahead = x * Math.sin(camera.yaw) + z * Math.cos(camera.yaw);
  const up = y * Math.cos(camera.pitch) - ahead * Math.sin(camera.pitch), depth = y * Math.sin(camera.pitch) + ahead * Math.cos(camera.pitch);
  const size = (view.unit * camera.zoom * camera.distance) / (camera.distance - depth);
  return { x: view.x + across * size, y: view.y - up * size, size, depth };
}

/** The hull of two discs, which is a limb. */
function capsule(pen, a, b, r0, r1) {
  const way = Math.hypot(b.x - a.x, b.y - a.y);
  pen.beginPath();
  if (way <= Math.abs(r0 - r1) + 1e-6) {
    const big = r0 >= r1 ? a : b;
    pen.arc(big.x, big.y, Math.max(r0, r1), 0, 2 * Math.PI);
  } else {
    const heading = Math.atan2(b.y - a.y, b.x - a.x), touch = Math.acos((r0 - r1) / way);
    pen.arc(a.x, a.y, r0, heading + touch, heading - touch + 2 * Math.PI);
    pen.arc(b.x, b.y, r1, heading - touch, heading + touch);
  }
  pen.closePath();
  pen.fill();
}

/** A part of the body: limbs of one outline, [start, end, widths in metres, colour]; discs are limbs of no length. */
function part(limbs, lift = 0) {
  return { limbs, lift };
}

function paint(pen, view, { limbs }) {
  const placed = limbs.map(([a, b, w0, w1, colour]) => {
    const p = project(a, view), q = project(b, view);
    return [p, q, (w0 / 2) * p.size, (w1 / 2) * q.size, colour];
  });
  pen.fillStyle = colours.paper;
  for (const [p, q, r0, r1] of placed) capsule(pen, p, q, r0 + 0.009 * p.size, r1 + 0.009 * q.size);
  for (const [p, q, r0, r1, colour] of placed) { pen.fillStyle = colour; capsule(pen, p, q, r0, r1); }
}

function body(now) {
  const collar = mix(now.Spine3, now.Neck, 0.65);
  const trunk = [plus(now.Hips, [0, 0.06, 0]), now.Spine, now.Spine1, now.Spine2, now.Spine3, collar], wide = [0.29, 0.28, 0.28, 0.31, 0.32, 0.15];
  const shirt = trunk.slice(1).map((to, k) => [trunk[k], to, wide[k], wide[k + 1], colours.shirt]);
  for (const side of ["Left", "Right"]) shirt.push([mix(now.Spine3, now[`${side}Arm`], 0.6), now[`${side}Arm`], 0.16, 0.125, colours.shirt]);
  const foot = (x) => [[[now.Hips[0] + x * 0.85, 0.9, 0], [now.Hips[0] + x * 1.25, 0.07, 0], 0.17, 0.095, colours.trousers],
    [[now.Hips[0] + x * 1.25, 0.035, 0], [now.Hips[0] + x * 1.5, 0.03, 0.15], 0.085, 0.07, colours.shoe]];
  return [part([...foot(0.095), ...foot(-0.095)], -2), part([[now.Neck, now.Head, 0.11, 0.105, colours.skin]], -0.05), part(shirt)];
}

function arm(now, side) {
  const [shoulder, elbow, wrist, tip] = ["Arm", "ForeArm", "Hand", "HandTip"].map((name) => now[side + name]);
  const palm = fingers(now, side) ?? [[wrist, tip, 0.07, 0.044, colours.skin]];
  return [part([[shoulder, elbow, 0.118, 0.09, colours.shirt]], 0.04), part([[elbow, wrist, 0.084, 0.054, colours.skin], ...palm], 0.06)];
}

/** A palm and its fingers, if the points have them; the last two bones of a finger are drawn as one. */
function fingers(now, side) {
  if (!now[`${side}HandIndex1`]) return null;
  const bone = (finger, place) => now[`${side}Hand${finger}${place}`];
  const palm = ["Index", "Middle", "Pinky"].map((finger) => [now[`${side}Hand`], bone(finger, "1"), 0.046, 0.034, colours.skin]);
  return [...palm, ...["Thumb", "Index", "Middle", "Ring", "Pinky"].flatMap((finger) => [
    [bone(finger, "1"), bone(finger, "2"), 0.02, 0.018, colours.skin], [bone(finger, "2"), bone(finger, "3Tip"), 0.018, 0.013, colours.skin]])];
}

/** Hair is a ball, the face a smaller one where the nose points, so that one sees where the figure looks. */
function head(now, view) {
  const up = minus(now.HeadTip, now.Head), centre = plus(now.Head, up.map((x) => 0.52 * x)), gaze = minus(now.Nose, centre);
  const ball = (place, wide, colour) => [place, place, wide, wide, colour];
  const discs = [ball(centre, 0.216, colours.hair)];
  if (project(now.Nose, view).depth - project(centre, view).depth > -0.04) {
    discs.push(ball(plus(centre, gaze.map((x, c) => 0.22 * x - 0.15 * up[c])), 0.2, colours.skin), ball(now.Nose, 0.034, colours.nose));
  }
  return part(discs, 0.05);
}

function draw(canvas, motion, time) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  const width = Math.max(1, Math.round(box.width * ratio)), height = Math.max(1, Math.round(box.height * ratio));
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const pen = canvas.getContext("2d"), view = { x: width / 2, y: height / 2, unit: Math.min(width, height) };
  pen.fillStyle = colours.paper;
  pen.fillRect(0, 0, width, height);
  const floor = project([0, 0, 0], view);
  pen.fillStyle = colours.floor;
  pen.beginPath();
  pen.ellipse(floor.x, floor.y, 0.5 * floor.size, 0.07 * floor.size, 0, 0, 2 * Math.PI);
  pen.fill();
  const now = pose(motion, time);
  // Far parts first. Each is as near as its limbs' middle.
  const near = ({ limbs, lift }) => limbs.reduce((sum, [a, b]) => sum + project(mix(a, b, 0.5), view).depth, 0) / limbs.length + lift;
  const parts = [...body(now), ...arm(now, "Left"), ...arm(now, "Right"), head(now, view)];
  for (const own of parts.map((one) => [near(one), one]).sort((a, b) => a[0] - b[0])) paint(pen, view, own[1]);
}


// The preview of a performance: a clock, a figure, a timeline, and what binds them to keys and fingers.
// Units are seconds, metres and radians; quaternions in the data are w first.

const data = JSON.parse(document.getElementById("performance").textContent);
const $ = (id) => document.getElementById(id);
const clamp = (x, low, high) => Math.min(high, Math.max(low, x));
const calm = matchMedia("(prefers-reduced-motion: reduce)");

// ---------------------------------------------------------------- the data

function bytes(base64) {
  const text = atob(base64);
  const out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out;
}

function decodeRotations() {
  const steps = new Int16Array(bytes(data.rotations).buffer);
  const out = new Float32Array(steps.length);
  for (let i = 0; i < out.length; i++) out[i] = steps[i] / data.steps;
  return out;
}

const joints = data.skeleton.names.length;
const rotations = decodeRotations();
const roots = new Float32Array(bytes(data.root).buffer);
const peaks = new Int8Array(bytes(data.peaks).buffer);
const { edges, flags, silent, lexemes, best, scores } = data.blocks;
const flagNames = Object.fromEntries(Object.entries(data.flagNames).map(([k, v]) => [k, v.replace("_", "-")]));
const flagTitles = { "onset": "onset", "loud-pseudo": "pseudo-beat, loud", "even-pseudo": "pseudo-beat, even", "boundary": "start or end" };
const flagColour = { "onset": "onset", "loud-pseudo": "loud", "even-pseudo": "even", "boundary": "boundary" };
// Beat k stands on edge k; edge 0 opens the recording.
const beatFlag = (k) => (k === 0 ? "boundary" : flagNames[flags[k - 1]]);

/** The block under a time: the last one whose start lies before it. */
function blockAt(time) {
  let low = 0, high = edges.length - 2;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (edges[middle] < time) low = middle; else high = middle - 1;
  }
  return low;
}

/** Local rotations at a time, [J * 4], between the two nearest frames along the chord. */
function poseAt(time, out) {
  const x = clamp(time * data.fps, 0, data.frames - 1);
  const a = Math.floor(x), b = Math.min(a + 1, data.frames - 1), share = x - a;
  for (let j = 0; j < joints; j++) {
    const p = (a * joints + j) * 4, q = (b * joints + j) * 4;
    let dot = 0, length = 0;
    for (let c = 0; c < 4; c++) dot += rotations[p + c] * rotations[q + c];
    const sign = dot < 0 ? -1 : 1;
    for (let c = 0; c < 4; c++) {
      const value = rotations[p + c] * (1 - share) + sign * rotations[q + c] * share;
      out[j * 4 + c] = value;
      length += value * value;
    }
    length = Math.sqrt(length) || 1;
    for (let c = 0; c < 4; c++) out[j * 4 + c] /= length;
  }
  return out;
}

function rootAt(time, out) {
  const frames = roots.length / 3;
  const x = clamp(time * data.fps, 0, frames - 1);
  const a = Math.floor(x), b = Math.min(a + 1, frames - 1), share = x - a;
  for (let c = 0; c < 3; c++) out[c] = roots[a * 3 + c] * (1 - share) + roots[b * 3 + c] * share;
  return out;
}

// ---------------------------------------------------------------- the clock

/** Time follows the sound; where the browser cannot play it, a silent clock of the same manners takes over. */
const clock = {
  sound: $("sound"), audible: false, playing: false, speed: 1, from: 0, since: 0,
  get time() {
    if (this.audible) return this.sound.currentTime;
    const run = this.playing ? ((performance.now() - this.since) / 1000) * this.speed : 0;
    return clamp(this.from + run, 0, data.duration);
  },
  seek(time) {
    const to = clamp(time, 0, data.duration);
    if (this.audible) this.sound.currentTime = to;
    this.from = to;
    this.since = performance.now();
    changed();
  },
  async play() {
    if (this.time >= data.duration - 0.02) this.seek(0);
    this.from = this.time;
    this.since = performance.now();
    this.playing = true;
    if (this.audible) await this.sound.play().catch(() => { this.playing = false; });
    changed();
  },
  pause() {
    this.from = this.time;
    this.playing = false;
    if (this.audible) this.sound.pause();
    changed();
  },
  setSpeed(speed) {
    this.from = this.time;
    this.since = performance.now();
    this.speed = speed;
    this.sound.playbackRate = speed;
  },
};

function loadSound() {
  const sound = clock.sound;
  sound.addEventListener("loadedmetadata", () => { clock.audible = true; if (clock.from) sound.currentTime = clock.from; });
  sound.addEventListener("ended", () => { clock.playing = false; clock.from = data.duration; changed(); });
  sound.addEventListener("seeked", changed);
  sound.addEventListener("error", () => {
    clock.audible = false;
    $("facts").textContent += " · this browser cannot play the sound (Ogg Vorbis)";
  });
  sound.preservesPitch = true;
  sound.src = URL.createObjectURL(new Blob([bytes(data.sound)], { type: data.soundType }));
}

// ---------------------------------------------------------------- colours

let colours = {};
function readColours() {
  const style = getComputedStyle(document.documentElement);
  const names = ["page", "desk", "line", "ink", "soft", "wave", "wave-played", "accent", "silence", "track", "onset", "loud",
    "even", "boundary", "playhead", "shirt", "trousers", "skin", "shoe", "hair", "grid", "left", "right", "light"];
  colours = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}
/** Neighbouring lexemes get far hues (the golden angle). */
const lexemeColour = (id) => `hsl(${(id * 137.508) % 360} 48% 72%)`;

// ---------------------------------------------------------------- the figure

/** A limb along +Y from 0 to `length`, round at both ends. */
function limbGeometry(THREE, r0, r1, length) {
  const points = [];
  const quarter = 7;
  for (let i = 0; i <= quarter; i++) {
    const a = (i / quarter) * Math.PI / 2;
    points.push(new THREE.Vector2(Math.sin(a) * r0, -Math.cos(a) * r0));
  }
  for (let i = 0; i <= quarter; i++) {
    const a = (i / quarter) * Math.PI / 2;
    points.push(new THREE.Vector2(Math.cos(a) * r1, length + Math.sin(a) * r1));
  }
  return new THREE.LatheGeometry(points, 24);
}

class Figure {
  constructor(THREE) {
    this.THREE = THREE;
    this.group = new THREE.Group();
    this.bones = data.skeleton.names.map((name, j) => {
      const bone = new THREE.Bone();
      bone.name = name;
      bone.position.fromArray(data.skeleton.offsets[j]);
      return bone;
    });
    data.skeleton.parents.forEach((parent, j) => (parent < 0 ? this.group : this.bones[parent]).add(this.bones[j]));
    this.materials = {};
    for (const name of ["shirt", "trousers", "skin", "shoe", "hair"]) {
      this.materials[name] = new THREE.MeshStandardMaterial({ roughness: 0.78, metalness: 0 });
    }
    this.pose = new Float32Array(joints * 4);
    this.root = new Float32Array(3);
    this.group.updateMatrixWorld(true);
    this.rest = this.bones.map((bone) => new THREE.Vector3().setFromMatrixPosition(bone.matrixWorld));
    this.buildTorso();
    this.buildHead();
    for (const side of ["Left", "Right"]) this.buildArm(side);
    this.buildLegs();
    this.paint();
  }

  bone(name) { return this.bones[data.skeleton.names.indexOf(name)]; }
  at(name) { return this.rest[data.skeleton.names.indexOf(name)]; }
  offset(name) { return new this.THREE.Vector3().fromArray(data.skeleton.offsets[data.skeleton.names.indexOf(name)]); }

  mesh(parent, geometry, material) {
    const mesh = new this.THREE.Mesh(geometry, this.materials[material]);
    mesh.castShadow = mesh.receiveShadow = true;
    parent.add(mesh);
    return mesh;
  }

  limb(parent, from, to, r0, r1, material) {
    const { Vector3 } = this.THREE;
    const way = new Vector3().subVectors(to, from);
    const mesh = this.mesh(parent, limbGeometry(this.THREE, r0, r1, way.length()), material);
    mesh.position.copy(from);
    mesh.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), way.normalize());
    return mesh;
  }

  ball(parent, centre, radii, material) {
    const mesh = this.mesh(parent, new this.THREE.SphereGeometry(1, 28, 20), material);
    mesh.position.set(...centre);
    mesh.scale.set(...radii);
    return mesh;
  }

  /** A tube of rounded rings around the spine, each ring bound to the two joints it lies between. */
  loft(rings, chain, material) {
    const THREE = this.THREE, around = 40;
    const places = [], skinIndex = [], skinWeight = [], faces = [];
    const heights = chain.map((name) => this.at(name).y);
    const indices = chain.map((name) => data.skeleton.names.indexOf(name));
    rings.forEach(([y, wide, deep, z]) => {
      let k = 0;
      while (k < chain.length - 2 && heights[k + 1] <= y) k++;
      const share = clamp((y - heights[k]) / Math.max(heights[k + 1] - heights[k], 1e-6), 0, 1);
      for (let i = 0; i < around; i++) {
        const a = (i / around) * Math.PI * 2, c = Math.cos(a), s = Math.sin(a);
        // A superellipse: rounder than a box, fuller than an ellipse.
        const bend = (v) => Math.sign(v) * Math.abs(v) ** 0.86;
        places.push(bend(c) * wide, y, z + bend(s) * deep);
        skinIndex.push(indices[k], indices[k + 1], 0, 0);
        skinWeight.push(1 - share, share, 0, 0);
      }
    });
    for (let r = 0; r + 1 < rings.length; r++) {
      for (let i = 0; i < around; i++) {
        const a = r * around + i, b = r * around + ((i + 1) % around);
        faces.push(a, a + around, b, b, a + around, b + around);
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(places, 3));
    geometry.setAttribute("skinIndex", new THREE.Uint16BufferAttribute(skinIndex, 4));
    geometry.setAttribute("skinWeight", new THREE.Float32BufferAttribute(skinWeight, 4));
    geometry.setIndex(faces);
    geometry.computeVertexNormals();
    const mesh = new THREE.SkinnedMesh(geometry, this.materials[material]);
    mesh.castShadow = mesh.receiveShadow = true;
    mesh.frustumCulled = false;
    this.group.add(mesh);
    mesh.bind(this.skeleton ??= new THREE.Skeleton(this.bones), new THREE.Matrix4());
  }

  buildTorso() {
    const hips = this.at("Hips").y, neck = this.at("Neck").y, chest = this.at("Spine3");
    const tall = neck - hips;
    const chain = ["Hips", "Spine", "Spine1", "Spine2", "Spine3", "Neck"];
    const row = (share, wide, deep, z) => [hips + share * tall, wide, deep, z];
    this.loft([
      row(-0.19, 0.002, 0.002, 0.0), row(-0.185, 0.070, 0.06, 0.0), row(-0.15, 0.130, 0.096, -0.003), row(-0.08, 0.148, 0.104, -0.006),
      row(-0.02, 0.140, 0.096, -0.006),
    ], chain, "trousers");
    this.loft([
      row(-0.155, 0.160, 0.112, -0.006), row(-0.15, 0.173, 0.126, -0.006), row(-0.13, 0.1755, 0.129, -0.006), row(0.0, 0.168, 0.121, -0.006),
      row(0.12, 0.156, 0.111, -0.004), row(0.26, 0.142, 0.101, 0.0),
      row(0.40, 0.145, 0.104, 0.002), row(0.54, 0.160, 0.114, 0.004), row(0.68, 0.175, 0.120, 0.002), row(0.80, 0.178, 0.114, -0.004),
      row(0.89, 0.160, 0.098, -0.010), row(0.95, 0.120, 0.080, -0.012), row(1.0, 0.078, 0.063, -0.008), row(1.03, 0.058, 0.054, -0.004),
      row(1.035, 0.050, 0.047, -0.004),
    ].map(([y, w, d, z]) => [y, w, d, z + chest.z * 0.4]), chain, "shirt");
  }

  buildHead() {
    const { Vector3 } = this.THREE;
    const zero = new Vector3();
    this.limb(this.bone("Neck"), new Vector3(0, -0.02, 0), this.offset("Neck1"), 0.053, 0.050, "skin");
    this.limb(this.bone("Neck1"), zero, this.offset("Head"), 0.050, 0.050, "skin");
    const head = this.bone("Head");
    const tall = new Vector3().fromArray(data.skeleton.tips.Head ?? [0, 0.17, 0.02]).length();
    const s = tall / 0.171, centre = [0, 0.092 * s, 0.016 * s], radii = [0.077 * s, 0.118 * s, 0.094 * s];
    const skull = this.ball(head, centre, radii, "skin");
    this.carve(skull.geometry);
    this.ball(head, [0, 0.078 * s, 0.108 * s], [0.0105 * s, 0.019 * s, 0.014 * s], "skin");
    for (const x of [-1, 1]) {
      this.ball(head, [x * 0.074 * s, 0.085 * s, 0.008], [0.010, 0.025, 0.017], "skin");
      this.ball(head, [x * 0.028 * s, 0.100 * s, 0.0985 * s], [0.0075, 0.0095, 0.006], "shoe");
    }
    // Hair: a cap a little larger than the skull, its edge higher in front than behind.
    const cap = new this.THREE.SphereGeometry(1, 40, 24, 0, Math.PI * 2, 0, Math.PI * 0.5).rotateX(-0.5);
    const hair = this.mesh(head, this.carve(cap), "hair");
    hair.position.set(...centre);
    hair.scale.set(...radii.map((r) => r * 1.055));
  }

  /** A unit sphere made into the shape of a head: narrow at the chin, the face flatter than the back. */
  carve(geometry) {
    const place = geometry.attributes.position;
    for (let i = 0; i < place.count; i++) {
      const y = place.getY(i), low = Math.max(-y, 0);
      place.setX(i, place.getX(i) * (1 - 0.19 * low ** 1.5));
      place.setZ(i, place.getZ(i) * (1 - 0.16 * low ** 1.4) + 0.10 * low ** 1.3);
    }
    geometry.computeVertexNormals();
    return geometry;
  }

  buildArm(side) {
    const { Vector3 } = this.THREE;
    const zero = new Vector3(), name = (part) => side + part;
    const collar = this.bone(name("Shoulder")), arm = this.bone(name("Arm"));
    const fore = this.bone(name("ForeArm")), hand = this.bone(name("Hand"));
    const toArm = this.offset(name("Arm")), toFore = this.offset(name("ForeArm")), toHand = this.offset(name("Hand"));
    this.limb(collar, toArm.clone().multiplyScalar(0.12).add(new Vector3(0, -0.012, -0.008)),
      toArm.clone().add(new Vector3(0, -0.004, 0)), 0.062, 0.060, "shirt");
    this.limb(arm, zero, toFore.clone().multiplyScalar(0.62), 0.059, 0.051, "shirt");
    this.limb(arm, toFore.clone().multiplyScalar(0.5), toFore, 0.043, 0.039, "skin");
    this.limb(fore, zero, toHand.clone().multiplyScalar(0.3), 0.039, 0.041, "skin");
    this.limb(fore, toHand.clone().multiplyScalar(0.3), toHand, 0.041, 0.026, "skin");
    if (this.bone(name("HandMiddle1"))) this.buildFingers(side);
    else this.buildHand(hand, new Vector3().fromArray(data.skeleton.tips[name("Hand")] ?? toHand.clone().multiplyScalar(0.6).toArray()));
  }

  /** A hand whose fingers move: each bone drawn where the data has it. */
  buildFingers(side) {
    const { Vector3 } = this.THREE;
    const zero = new Vector3(), hand = this.bone(side + "Hand"), long = this.offset(side + "HandMiddle1");
    const s = long.length() / 0.086;
    this.ball(hand, [0, 0, 0], [0.027, 0.024, 0.027], "skin");
    const thick = { Thumb: 0.0125, Index: 0.0100, Middle: 0.0104, Ring: 0.0099, Pinky: 0.0086 };
    for (const [finger, wide] of Object.entries(thick)) {
      const joint = (n) => `${side}Hand${finger}${n}`;
      // From the wrist through the palm; the thumb's ball is thicker than what follows.
      this.limb(hand, this.offset(joint(1)).clone().multiplyScalar(0.18), this.offset(joint(1)), 0.0165 * s, wide * 1.25 * s, "skin");
      for (const n of [1, 2, 3]) {
        const tip = data.skeleton.tips[joint(n)];
        const end = n < 3 ? this.offset(joint(n + 1)) : tip ? new Vector3().fromArray(tip) : this.offset(joint(n)).clone().multiplyScalar(0.8);
        this.limb(this.bone(joint(n)), zero, end, wide * (1.06 - 0.08 * n) * s, wide * (0.98 - 0.08 * n) * s, "skin");
      }
    }
    // The palm: a flat ball between the knuckles and the wrist.
    const palm = this.ball(hand, long.clone().multiplyScalar(0.55).toArray(), [0.046 * s, 0.0145 * s, 0.037 * s], "skin");
    palm.quaternion.setFromUnitVectors(new Vector3(Math.sign(long.x) || 1, 0, 0), long.clone().normalize());
  }

  /** A relaxed hand: palm down in the rest pose, thumb forward, fingers slightly curled. */
  buildHand(hand, tip) {
    const { Vector3, Group } = this.THREE;
    const frame = new Group();
    frame.quaternion.setFromUnitVectors(new Vector3(Math.sign(tip.x) || 1, 0, 0), tip.clone().normalize());
    hand.add(frame);
    const way = Math.sign(tip.x) || 1, s = tip.length() / 0.16;
    const point = (x, y, z) => new Vector3(way * x * s, y * s, z * s);
    this.ball(frame, [0, 0, 0], [0.027, 0.024, 0.027], "skin");
    const palm = this.ball(frame, [way * 0.048 * s, -0.002, 0.002], [0.050 * s, 0.0165 * s, 0.041 * s], "skin");
    palm.rotation.z = 0;
    const fingers = [[0.030, 0.032, 0.068], [0.0105, 0.0115, 0.076], [-0.0095, -0.010, 0.070], [-0.028, -0.031, 0.056]];
    for (const [z0, z1, long] of fingers) {
      const root = point(0.078, -0.001, z0), middle = point(0.078 + long * 0.5, -0.008, (z0 + z1) / 2);
      const end = point(0.078 + long * 0.93, -0.026, z1);
      this.limb(frame, root, middle, 0.0095 * s, 0.0088 * s, "skin");
      this.limb(frame, middle, end, 0.0088 * s, 0.0072 * s, "skin");
    }
    this.limb(frame, point(0.018, -0.006, 0.026), point(0.058, -0.018, 0.056), 0.0135 * s, 0.0105 * s, "skin");
    this.limb(frame, point(0.058, -0.018, 0.056), point(0.090, -0.026, 0.063), 0.0105 * s, 0.0085 * s, "skin");
  }

  /** Legs that stand still where the data knows nothing below the hips, and move where it does. */
  buildLegs() {
    const { Vector3, Group } = this.THREE;
    this.legs = new Group();
    this.group.add(this.legs);
    if (this.bone("LeftUpLeg")) {
      for (const side of ["Left", "Right"]) this.buildLeg(side);
      return;
    }
    for (const x of [-1, 1]) {
      const hip = new Vector3(x * 0.080, 0.89, 0), knee = new Vector3(x * 0.098, 0.50, 0.012), ankle = new Vector3(x * 0.106, 0.09, -0.02);
      this.limb(this.legs, hip, knee, 0.084, 0.056, "trousers");
      this.limb(this.legs, knee, ankle, 0.056, 0.044, "trousers");
      const shoe = this.limb(this.legs, new Vector3(x * 0.106, 0.043, -0.035), new Vector3(x * 0.128, 0.036, 0.115), 0.043, 0.036, "shoe");
      shoe.castShadow = true;
    }
  }

  buildLeg(side) {
    const { Vector3 } = this.THREE;
    const zero = new Vector3(), joint = (part) => this.bone(side + part);
    this.limb(joint("UpLeg"), zero, this.offset(side + "Leg"), 0.076, 0.056, "trousers");
    this.limb(joint("Leg"), zero, this.offset(side + "Foot"), 0.056, 0.044, "trousers");
    const ball = this.offset(side + "ToeBase");
    this.limb(joint("Foot"), new Vector3(0, ball.y * 0.62, -0.035), new Vector3(ball.x, ball.y * 0.75, ball.z * 0.95), 0.043, 0.037, "shoe");
    this.limb(joint("ToeBase"), new Vector3(0, 0.014, -0.02), new Vector3(0, 0.012, 0.045), 0.036, 0.030, "shoe");
  }

  paint() {
    for (const [name, material] of Object.entries(this.materials)) material.color.set(colours[name]);
  }

  set(time) {
    poseAt(time, this.pose);
    rootAt(time, this.root);
    this.bones.forEach((bone, j) => bone.quaternion.set(this.pose[j * 4 + 1], this.pose[j * 4 + 2], this.pose[j * 4 + 3], this.pose[j * 4]));
    this.bones[0].position.fromArray(this.root);
    // The legs turn with the hips' yaw and stand under them.
    const yaw = 2 * Math.atan2(this.pose[2], this.pose[0]);
    this.legs.rotation.y = yaw;
    this.legs.position.set(this.root[0], 0, this.root[2]);
    this.legs.scale.y = this.root[1] / 0.95;
  }
}

/** The paths of the hands over the last moments, as ribbons that fade and face the viewer. */
class Trails {
  constructor(THREE) {
    this.THREE = THREE;
    this.group = new THREE.Group();
    this.seconds = 0.7;
    this.count = 44;
    this.places = this.handPlaces();
    this.ribbons = ["Left", "Right"].map((side) => {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(this.count * 6), 3));
      geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(this.count * 8), 4));
      const faces = [];
      for (let i = 0; i + 1 < this.count; i++) faces.push(2 * i, 2 * i + 1, 2 * i + 2, 2 * i + 2, 2 * i + 1, 2 * i + 3);
      geometry.setIndex(faces);
      const material = new THREE.MeshBasicMaterial({ vertexColors: true, transparent: true, side: THREE.DoubleSide, depthWrite: false });
      const mesh = new THREE.Mesh(geometry, material);
      mesh.frustumCulled = false;
      this.group.add(mesh);
      return { side, mesh, colour: new THREE.Color() };
    });
    this.paint();
  }

  paint() { for (const ribbon of this.ribbons) ribbon.colour.set(colours[ribbon.side.toLowerCase()]); }

  /** Where each palm is in each frame, by forward kinematics: {Left, Right} -> [T * 3]. */
  handPlaces() {
    const THREE = this.THREE, { names, parents, offsets, tips } = data.skeleton;
    const out = { Left: new Float32Array(data.frames * 3), Right: new Float32Array(data.frames * 3) };
    const q = names.map(() => new THREE.Quaternion()), p = names.map(() => new THREE.Vector3());
    const local = new THREE.Quaternion(), root = new Float32Array(3), place = new THREE.Vector3();
    for (let t = 0; t < data.frames; t++) {
      rootAt(t / data.fps, root);
      for (let j = 0; j < joints; j++) {
        const k = (t * joints + j) * 4;
        local.set(rotations[k + 1], rotations[k + 2], rotations[k + 3], rotations[k]);
        if (parents[j] < 0) { q[j].copy(local); p[j].fromArray(root); continue; }
        q[j].copy(q[parents[j]]).multiply(local);
        p[j].fromArray(offsets[j]).applyQuaternion(q[parents[j]]).add(p[parents[j]]);
      }
      for (const side of ["Left", "Right"]) {
        const j = names.indexOf(`${side}Hand`);
        place.fromArray(tips[`${side}Hand`] ?? [0, 0, 0]).multiplyScalar(0.6).applyQuaternion(q[j]).add(p[j]);
        place.toArray(out[side], t * 3);
      }
    }
    return out;
  }

  placeAt(side, time, out) {
    const x = clamp(time * data.fps, 0, data.frames - 1);
    const a = Math.floor(x), b = Math.min(a + 1, data.frames - 1), share = x - a, all = this.places[side];
    return out.set(...[0, 1, 2].map((c) => all[a * 3 + c] * (1 - share) + all[b * 3 + c] * share));
  }

  set(time, camera) {
    const { Vector3 } = this.THREE;
    const here = new Vector3(), next = new Vector3(), along = new Vector3(), across = new Vector3(), view = new Vector3();
    for (const { side, mesh, colour } of this.ribbons) {
      const place = mesh.geometry.attributes.position, paint = mesh.geometry.attributes.color;
      for (let i = 0; i < this.count; i++) {
        const age = i / (this.count - 1), when = Math.max(0, time - age * this.seconds);
        this.placeAt(side, when, here);
        this.placeAt(side, when - this.seconds / this.count, next);
        along.subVectors(here, next);
        across.crossVectors(along, view.subVectors(camera.position, here)).normalize().multiplyScalar(0.014 * (1 - age) + 0.001);
        place.setXYZ(2 * i, here.x + across.x, here.y + across.y, here.z + across.z);
        place.setXYZ(2 * i + 1, here.x - across.x, here.y - across.y, here.z - across.z);
        // A hand at rest leaves no trail.
        const fade = (1 - age) ** 1.6 * 0.75 * clamp(along.length() * this.count / this.seconds / 0.6, 0, 1);
        for (const v of [2 * i, 2 * i + 1]) paint.setXYZW(v, colour.r, colour.g, colour.b, fade);
      }
      place.needsUpdate = paint.needsUpdate = true;
    }
  }
}

// ---------------------------------------------------------------- the stage

const views = {
  front: { yaw: 0, pitch: 0.02, distance: 4.7, x: 0, y: 1.0, z: 0 },
  side: { yaw: Math.PI / 2, pitch: 0.02, distance: 4.7, x: 0, y: 1.0, z: 0 },
  close: { yaw: 0.2, pitch: 0.04, distance: 2.75, x: 0, y: 1.27, z: 0 },
  reset: { yaw: 0.34, pitch: 0.09, distance: 4.7, x: 0, y: 1.0, z: 0 },
};

class Stage {
  constructor(THREE, canvas) {
    this.THREE = THREE;
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFSoftShadowMap;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(26, 1, 0.1, 40);
    this.view = { ...views.reset };
    this.goal = { ...views.reset };
    this.figure = new Figure(THREE);
    this.centre = this.middle();
    this.trails = new Trails(THREE);
    this.scene.add(this.figure.group, this.trails.group);
    this.addLights();
    this.addFloor();
    this.paint();
  }

  /** Where the character stands on the whole; the camera looks there. */
  middle() {
    const median = (c) => {
      const values = [];
      for (let i = c; i < roots.length; i += 3) values.push(roots[i]);
      return values.sort((a, b) => a - b)[values.length >> 1];
    };
    return new this.THREE.Vector3(median(0), 0, median(2));
  }

  addLights() {
    const THREE = this.THREE;
    this.sky = new THREE.HemisphereLight(0xffffff, 0xb9a88f, 1.7);
    this.sun = new THREE.DirectionalLight(0xfff4e2, 2.1);
    this.sun.position.set(1.6, 3.6, 2.6).add(this.centre);
    this.sun.target.position.copy(this.centre).setY(0.9);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    Object.assign(this.sun.shadow.camera, { left: -1.5, right: 1.5, top: 1.6, bottom: -1.6, near: 0.5, far: 9 });
    this.sun.shadow.bias = -0.0006;
    this.sun.shadow.normalBias = 0.018;
    this.sun.shadow.radius = 4;
    this.rim = new THREE.DirectionalLight(0xcfe4ff, 0.9);
    this.rim.position.set(-2.2, 2.4, -2.5).add(this.centre);
    this.scene.add(this.sky, this.sun, this.sun.target, this.rim);
  }

  addFloor() {
    const THREE = this.THREE;
    this.floorTexture = new THREE.CanvasTexture(document.createElement("canvas"));
    this.floorTexture.anisotropy = 8;
    this.floorTexture.colorSpace = THREE.SRGBColorSpace;
    const grid = new THREE.Mesh(new THREE.PlaneGeometry(8, 8),
      new THREE.MeshBasicMaterial({ map: this.floorTexture, transparent: true, depthWrite: false }));
    const shade = new THREE.Mesh(new THREE.PlaneGeometry(8, 8), new THREE.ShadowMaterial({ opacity: 0.26 }));
    for (const plane of [grid, shade]) {
      plane.rotation.x = -Math.PI / 2;
      plane.position.copy(this.centre);
      this.scene.add(plane);
    }
    shade.receiveShadow = true;
    shade.position.y = 0.002;
  }

  /** Half-metre squares that fade with distance. */
  paintFloor() {
    const canvas = this.floorTexture.image, size = 1024, pen = canvas.getContext("2d");
    canvas.width = canvas.height = size;
    pen.clearRect(0, 0, size, size);
    pen.strokeStyle = colours.grid;
    for (let i = 0; i <= 16; i++) {
      const x = Math.round((i / 16) * (size - 2)) + 1;
      pen.lineWidth = i % 2 ? 1.2 : 2.4;
      pen.globalAlpha = i % 2 ? 0.4 : 0.7;
      pen.beginPath();
      pen.moveTo(x, 0); pen.lineTo(x, size);
      pen.moveTo(0, x); pen.lineTo(size, x);
      pen.stroke();
    }
    pen.globalAlpha = 1;
    pen.globalCompositeOperation = "destination-in";
    const fade = pen.createRadialGradient(size / 2, size / 2, size * 0.05, size / 2, size / 2, size * 0.48);
    fade.addColorStop(0, "rgba(0,0,0,1)");
    fade.addColorStop(1, "rgba(0,0,0,0)");
    pen.fillStyle = fade;
    pen.fillRect(0, 0, size, size);
    pen.globalCompositeOperation = "source-over";
    this.floorTexture.needsUpdate = true;
  }

  paint() {
    this.figure.paint();
    this.trails.paint();
    this.paintFloor();
    this.sky.intensity = 1.7 * Number(colours.light);
    this.sun.intensity = 2.1 * Number(colours.light);
  }

  look(name) {
    // Go the short way round.
    const turn = Math.PI * 2, goal = { ...views[name] };
    goal.yaw += turn * Math.round((this.view.yaw - goal.yaw) / turn);
    this.goal = goal;
    if (calm.matches) this.view = { ...goal };
  }

  orbit(dx, dy) {
    this.goal.yaw -= dx * 0.008;
    this.goal.pitch = clamp(this.goal.pitch + dy * 0.006, -0.35, 1.45);
  }

  pan(dx, dy) {
    const scale = (this.goal.distance * 0.46) / this.canvas.clientHeight;
    this.goal.x -= dx * scale * Math.cos(this.goal.yaw);
    this.goal.z += dx * scale * Math.sin(this.goal.yaw);
    this.goal.y = clamp(this.goal.y + dy * scale, 0, 2.2);
  }

  zoom(factor) { this.goal.distance = clamp(this.goal.distance * factor, 1.1, 12); }

  /** Ease towards the goal over the seconds since the last picture; true while on the way. */
  ease(seconds) {
    let moving = false;
    const share = calm.matches ? 1 : 1 - Math.exp(-14 * Math.min(seconds, 0.25));
    for (const key of Object.keys(this.goal)) {
      const gap = this.goal[key] - this.view[key];
      if (Math.abs(gap) > 1e-4) { this.view[key] += gap * share; moving = true; }
      else this.view[key] = this.goal[key];
    }
    return moving;
  }

  resize() {
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / Math.max(height, 1);
    this.camera.updateProjectionMatrix();
  }

  draw(time) {
    const { yaw, pitch, distance, x, y, z } = this.view;
    // A narrow window needs more room for the arms.
    const far = distance * Math.max(1, 0.8 / this.camera.aspect);
    const target = new this.THREE.Vector3(x, y, z).add(this.centre);
    this.camera.position.set(
      target.x + far * Math.sin(yaw) * Math.cos(pitch), target.y + far * Math.sin(pitch), target.z + far * Math.cos(yaw) * Math.cos(pitch));
    this.camera.lookAt(target);
    this.figure.set(time);
    if (this.trails.group.visible) this.trails.set(time, this.camera);
    this.renderer.render(this.scene, this.camera);
  }
}

// ---------------------------------------------------------------- the timeline

/** A canvas that knows its size in CSS pixels. */
function sharp(canvas) {
  const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  const w = Math.round(width * ratio), h = Math.round(height * ratio);
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

/** The sign of a beat: its shape tells the kind as well as its colour. */
function sign(pen, kind, x, y, r) {
  pen.fillStyle = pen.strokeStyle = colours[flagColour[kind]];
  pen.lineWidth = 1.6;
  pen.beginPath();
  if (kind === "onset") pen.arc(x, y, r, 0, Math.PI * 2);
  else if (kind === "loud-pseudo") { pen.moveTo(x, y - r * 1.2); pen.lineTo(x + r * 1.2, y); pen.lineTo(x, y + r * 1.2); pen.lineTo(x - r * 1.2, y); pen.closePath(); }
  else if (kind === "even-pseudo") pen.arc(x, y, r - 0.5, 0, Math.PI * 2);
  else pen.rect(x - r * 0.8, y - r * 0.8, r * 1.6, r * 1.6);
  if (kind === "even-pseudo") pen.stroke(); else pen.fill();
}

function signSvg(kind) {
  const colour = `var(--${flagColour[kind]})`;
  const shapes = {
    "onset": `<circle cx="6" cy="6" r="4.5" fill="${colour}"/>`,
    "loud-pseudo": `<path d="M6 .8 11.2 6 6 11.2 .8 6z" fill="${colour}"/>`,
    "even-pseudo": `<circle cx="6" cy="6" r="4" fill="none" stroke="${colour}" stroke-width="1.8"/>`,
    "boundary": `<rect x="2" y="2" width="8" height="8" fill="${colour}"/>`,
  };
  return `<svg viewBox="0 0 12 12" aria-hidden="true">${shapes[kind]}</svg>`;
}

const rows = { ruler: 16, words: data.words.length ? 18 : 0, sign: 16, wave: 56, blocks: 28 };
rows.height = rows.ruler + rows.words + rows.sign + rows.wave + rows.blocks + 4;

const timeline = {
  canvas: $("timeline"), overview: $("overview"), scale: 0, left: 0, held: false,
  get width() { return this.canvas.clientWidth; },
  get span() { return this.width / this.scale; },
  get whole() { return this.span >= data.duration - 1e-6; },

  fit() {
    const least = this.width / data.duration;
    // 95 pixels a second leave room for a number in every block.
    this.scale = clamp(this.scale || 95, least, Math.max(600, least));
    this.left = clamp(this.left, 0, Math.max(0, data.duration - this.span));
    this.overview.hidden = this.whole;
  },

  zoom(factor, anchor) {
    const x = (anchor - this.left) * this.scale;
    this.scale *= factor;
    this.fit();
    this.left = anchor - x / this.scale;
    this.fit();
    changed();
  },

  /** Keep the playhead in sight, a third from the left while it runs. */
  follow(time, playing) {
    if (this.held) return;
    if (playing) this.left = time - this.span * 0.35;
    else if (time < this.left || time > this.left + this.span) this.left = time - this.span * 0.35;
    this.left = clamp(this.left, 0, Math.max(0, data.duration - this.span));
  },

  draw(time) {
    const { pen, width } = sharp(this.canvas);
    const x = (t) => (t - this.left) * this.scale;
    const first = blockAt(this.left), last = blockAt(Math.min(this.left + this.span, data.duration));
    const waveTop = rows.ruler + rows.words + rows.sign, blockTop = waveTop + rows.wave + 4;
    pen.font = "11px system-ui, sans-serif";
    pen.textBaseline = "middle";
    pen.fillStyle = colours.track;
    pen.fillRect(0, waveTop, width, rows.wave);
    this.drawSilence(pen, x, first, last, waveTop, rows.wave);
    this.drawRuler(pen, x, width);
    this.drawWords(pen, x, time);
    drawWave(pen, this.left, this.scale, width, waveTop, rows.wave, time);
    this.drawBeats(pen, x, first, last, waveTop);
    this.drawBlocks(pen, x, first, last, blockTop, blockAt(time));
    pen.fillStyle = colours.playhead;
    pen.fillRect(x(time) - 1, rows.ruler - 3, 2, rows.height);
    pen.beginPath();
    pen.moveTo(x(time) - 6, 1); pen.lineTo(x(time) + 6, 1); pen.lineTo(x(time) + 6, 8); pen.lineTo(x(time), 15); pen.lineTo(x(time) - 6, 8);
    pen.fill();
    if (!this.whole) this.drawOverview(time);
  },

  drawRuler(pen, x, width) {
    const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 30, 60, 120, 300, 600].find((s) => s * this.scale >= 64) ?? 900;
    pen.fillStyle = colours.soft;
    pen.strokeStyle = colours.line;
    pen.lineWidth = 1;
    for (let k = Math.ceil(this.left / step); x(k * step) <= width; k++) {
      const at = Math.round(x(k * step)) + 0.5;
      pen.beginPath(); pen.moveTo(at, 0); pen.lineTo(at, rows.ruler - 2); pen.stroke();
      pen.fillText(minutes(k * step, step < 1 ? 1 : 0), at + 4, rows.ruler / 2);
    }
  },

  drawWords(pen, x, time) {
    if (!rows.words) return;
    let free = -Infinity;
    for (const [text, start, end] of data.words) {
      if (end < this.left || start > this.left + this.span) continue;
      const at = Math.max(x(start), free);
      const wide = pen.measureText(text).width;
      if (at + wide > x(end) + 26 && wide > 8) { if (at > x(end)) continue; }
      pen.fillStyle = time >= start && time < end ? colours.ink : colours.soft;
      pen.fillText(text, at, rows.ruler + rows.words / 2);
      free = at + wide + 5;
    }
  },

  drawSilence(pen, x, first, last, top, tall) {
    pen.save();
    pen.beginPath();
    for (let k = first; k <= last; k++) if (silent[k]) pen.rect(x(edges[k]), top, x(edges[k + 1]) - x(edges[k]), tall);
    pen.clip();
    pen.fillStyle = colours.silence;
    pen.fillRect(0, top, this.width, tall);
    pen.strokeStyle = colours.silence;
    pen.lineWidth = 2;
    pen.beginPath();
    // Hatching that moves with the sound.
    const shift = ((this.left * this.scale) % 8 + 8) % 8;
    for (let at = -tall - shift; at < this.width; at += 8) { pen.moveTo(at, top + tall); pen.lineTo(at + tall, top); }
    pen.stroke();
    pen.restore();
  },

  drawBeats(pen, x, first, last, waveTop) {
    for (let k = first; k <= last + 1; k++) {
      const kind = beatFlag(k), at = clamp(x(edges[k]), 4, this.width - 4);
      if (x(edges[k]) < -6 || x(edges[k]) > this.width + 6) continue;
      pen.globalAlpha = kind === "onset" ? 0.85 : 0.55;
      pen.fillStyle = colours[flagColour[kind]];
      pen.fillRect(Math.round(x(edges[k])) - 0.5, waveTop - 3, 1.2, rows.wave + 3);
      pen.globalAlpha = 1;
      sign(pen, kind, at, waveTop - 8, 4);
    }
  },

  drawBlocks(pen, x, first, last, top, now) {
    pen.textAlign = "center";
    for (let k = first; k <= last; k++) {
      const from = x(edges[k]), wide = x(edges[k + 1]) - from;
      pen.fillStyle = silent[k] ? colours.track : lexemeColour(lexemes[k]);
      pen.beginPath();
      pen.roundRect(from + 0.75, top, Math.max(wide - 1.5, 0.5), rows.blocks - 4, Math.min(5, wide / 3));
      pen.fill();
      if (silent[k]) { pen.strokeStyle = colours.line; pen.lineWidth = 1; pen.stroke(); }
      if (k === now) { pen.strokeStyle = colours.ink; pen.lineWidth = 2; pen.stroke(); }
      const label = String(lexemes[k]);
      if (wide > pen.measureText(label).width + 5) {
        pen.fillStyle = silent[k] ? colours.soft : "#16181d";
        pen.fillText(label, from + wide / 2, top + rows.blocks / 2 - 1.5);
      }
    }
    pen.textAlign = "left";
  },

  drawOverview(time) {
    const { pen, width, height } = sharp(this.overview);
    const scale = width / data.duration;
    pen.fillStyle = colours.track;
    pen.fillRect(0, 0, width, height);
    pen.fillStyle = colours.silence;
    for (let k = 0; k < silent.length; k++) if (silent[k]) pen.fillRect(edges[k] * scale, 0, (edges[k + 1] - edges[k]) * scale, height);
    drawWave(pen, 0, scale, width, 0, height, time);
    pen.strokeStyle = colours.accent;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.roundRect(this.left * scale + 1, 1, Math.max(this.span * scale - 2, 4), height - 2, 5);
    pen.stroke();
    pen.fillStyle = colours.playhead;
    pen.fillRect(time * scale - 1, 0, 2, height);
  },
};

function drawWave(pen, left, scale, width, top, tall, time) {
  const rate = data.peaksPerSecond, count = peaks.length / 2, middle = top + tall / 2, half = (tall / 2 - 2) / 127;
  const upTo = Math.min(width, (data.duration - left) * scale);
  for (let column = 0; column < upTo; column++) {
    const t0 = left + column / scale, t1 = left + (column + 1) / scale;
    const from = clamp(Math.floor(t0 * rate), 0, count - 1), to = clamp(Math.ceil(t1 * rate), from + 1, count);
    let low = 127, high = -127;
    for (let k = from; k < to; k++) { low = Math.min(low, peaks[2 * k]); high = Math.max(high, peaks[2 * k + 1]); }
    pen.fillStyle = t0 <= time ? colours["wave-played"] : colours.wave;
    pen.fillRect(column, middle - high * half, 1, Math.max((high - low) * half, 1));
  }
}

function minutes(time, digits) {
  const whole = Math.max(0, time) + 0.5 * 10 ** -digits - (digits ? 0.5 * 10 ** -digits : 0);
  const m = Math.floor(whole / 60), s = whole - m * 60;
  return `${m}:${(digits ? s.toFixed(digits) : String(Math.floor(s))).padStart(digits ? 3 + digits : 2, "0")}`;
}

// ---------------------------------------------------------------- words on the page

function writeFacts() {
  const distinct = new Set(lexemes).size;
  $("facts").textContent = `${minutes(data.duration, 1)} · ${lexemes.length} blocks · ${distinct} lexemes · ${Math.round(data.fps * 100) / 100} frames/s`;
  $("score-is").textContent = `score: ${data.scoreIs}`;
  $("legend").innerHTML = Object.keys(flagTitles).map((kind) => `<li>${signSvg(kind)}${flagTitles[kind]}</li>`).join("")
    + `<li><svg viewBox="0 0 12 12" aria-hidden="true"><rect width="12" height="12" rx="2" fill="var(--silence)"/><path d="M0 12 12 0" stroke="var(--soft)"/></svg>silence</li>`;
}

let shownBlock = -1;
function writeBlock(k) {
  if (k === shownBlock) return;
  shownBlock = k;
  const kind = flagNames[flags[k]], chip = $("chip");
  chip.textContent = `lexeme ${lexemes[k]}`;
  chip.style.background = silent[k] ? colours.track : lexemeColour(lexemes[k]);
  chip.style.color = silent[k] ? colours.ink : "#16181d";
  $("card-block").textContent = `block ${k + 1}, ${(edges[k + 1] - edges[k]).toFixed(2)} s`;
  $("card-flag").innerHTML = `${signSvg(kind)} ends on: ${flagTitles[kind]}${silent[k] ? " · silent" : ""}`;
  // Scores may be probabilities or values of any size: the bar spans from the least to the best of the five.
  const row = scores[k], high = row[0], low = Math.min(...row), share = low >= 0 && high <= 1;
  const part = (score) => (share ? score / (high || 1) : (score - low) / (high - low || 1)) * 0.94 + 0.06;
  $("best").innerHTML = best[k].map((id, i) => `<li class="${id === lexemes[k] ? "chosen" : ""}"><span>${id}</span>`
    + `<span class="gauge"><i style="width:${(part(row[i]) * 100).toFixed(1)}%"></i></span>`
    + `<span class="value">${Number(row[i].toPrecision(3))}</span></li>`).join("");
  $("worth").hidden = !data.worth;
  if (data.worth) $("worth").textContent = worthInWords(k);
}

/** What the reward weighed, in a sentence: how likely people make the lexeme, what it is worth, and the runner-up. */
function worthInWords(k) {
  const { prior, advantage, runnerUp } = data.worth;
  const last = prior[k].length - 1, worth = advantage[k][last], [other, more] = runnerUp[k];
  const percent = prior[k][last] < 0.01 ? "under 1 %" : `${Math.round(prior[k][last] * 100)} %`;
  const size = Math.abs(worth) < 0.05 ? "as much as the usual choice"
    : `${Math.abs(worth).toFixed(1)} sd ${worth > 0 ? "more" : "less"} than the usual choice`;
  const than = Math.abs(more) < 0.05 ? "as much" : `${Math.abs(more).toFixed(1)} sd ${more > 0 ? "more" : "less"}`;
  return `Lexeme ${lexemes[k]}: people choose it here in ${percent} of cases; by the reward it is worth ${size}. `
    + `Runner-up ${other}: it would have been worth ${than}.`;
}

function writeClock(time) {
  const frame = Math.min(data.frames - 1, Math.floor(time * data.fps + 1e-6));
  $("clock").innerHTML = `${minutes(time, 2)} <small>/ ${minutes(data.duration, 1)} · frame ${frame}</small>`;
  const slider = timeline.canvas;
  slider.setAttribute("aria-valuenow", time.toFixed(3));
  slider.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds, block ${shownBlock + 1}, lexeme ${lexemes[shownBlock]}`);
  document.body.classList.toggle("playing", clock.playing);
  $("play").setAttribute("aria-label", clock.playing ? "Pause" : "Play");
}

// ---------------------------------------------------------------- one picture after the other

let stage = null, dirty = true, last = 0;
function changed() { dirty = true; }

function tick(now) {
  const easing = stage?.ease((now - last) / 1000) ?? false;
  last = now;
  if (dirty || easing || clock.playing) {
    dirty = false;
    const time = clamp(clock.time, 0, data.duration);
    if (clock.playing && !clock.audible && time >= data.duration) clock.pause();
    timeline.follow(time, clock.playing);
    writeBlock(blockAt(time));
    writeClock(time);
    timeline.draw(time);
    stage?.draw(time);
  }
  requestAnimationFrame(tick);
}

function resized() {
  timeline.canvas.style.height = `${rows.height}px`;
  timeline.fit();
  stage?.resize();
  changed();
}

// ---------------------------------------------------------------- hands on it

function bindStage(canvas) {
  const fingers = new Map();
  const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => { stage?.look("reset"); changed(); });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    stage?.zoom(Math.exp(clamp(event.deltaY, -120, 120) * 0.0015));
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before || !stage) return;
    const dx = event.clientX - before.x, dy = event.clientY - before.y;
    const wide = fingers.size === 2 ? spread() : 0;
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size === 2) {
      stage.zoom(wide / Math.max(spread(), 1));
      stage.pan(dx / 2, dy / 2);
    } else if (event.buttons & 2 || event.shiftKey) stage.pan(dx, dy);
    else stage.orbit(dx, dy);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
}

function bindScrub(canvas, timeOf, holds) {
  let resume = false, down = false;
  const move = (event) => clock.seek(timeOf(event.clientX - canvas.getBoundingClientRect().left));
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 0) return;
    canvas.setPointerCapture(event.pointerId);
    down = true;
    resume = clock.playing;
    if (resume) clock.pause();
    timeline.held = holds;
    move(event);
  });
  canvas.addEventListener("pointermove", (event) => { if (down) move(event); });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, () => {
      if (!down) return;
      down = timeline.held = false;
      if (resume) clock.play();
    });
  }
}

function step(frames) {
  clock.pause();
  // The middle of a frame's time, so that rounding in the player cannot fall back to the frame before.
  const frame = clamp(Math.floor(clock.time * data.fps + 1e-3) + frames, 0, data.frames - 1);
  clock.seek((frame + 0.02) / data.fps);
}

function stepBlock(way) {
  const now = clock.time, k = blockAt(now + 1e-3);
  if (way > 0) clock.seek(edges[Math.min(k + 1, edges.length - 1)] + 0.002);
  else clock.seek((now - edges[k] > 0.08 || k === 0 ? edges[k] : edges[k - 1]) + 0.002);
}

function toggleTrails() {
  if (!stage) return;
  stage.trails.group.visible = !stage.trails.group.visible;
  $("trails").setAttribute("aria-pressed", String(stage.trails.group.visible));
  changed();
}

function toggleHelp() {
  $("keys").hidden = !$("keys").hidden;
  $("help").setAttribute("aria-expanded", String(!$("keys").hidden));
  resized();
}

const toggle = () => (clock.playing ? clock.pause() : clock.play());
const look = (name) => { stage?.look(name); changed(); };
const keys = {
  " ": toggle,
  "ArrowLeft": (event) => (event.shiftKey ? stepBlock(-1) : step(-1)),
  "ArrowRight": (event) => (event.shiftKey ? stepBlock(1) : step(1)),
  "Home": () => clock.seek(0),
  "End": () => clock.seek(data.duration),
  "f": () => look("front"), "s": () => look("side"), "c": () => look("close"), "r": () => look("reset"), "t": toggleTrails, "?": toggleHelp,
  "+": () => timeline.zoom(1.3, clock.time), "-": () => timeline.zoom(1 / 1.3, clock.time),
};

function bindKeys() {
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const own = event.target.closest?.("button, select, summary");
    // A focused button keeps its space, a list its arrows.
    if (own && (event.key === " " || own.matches("select"))) return;
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action(event);
  });
}

function bindDesk() {
  $("play").addEventListener("click", toggle);
  $("back").addEventListener("click", () => step(-1));
  $("forward").addEventListener("click", () => step(1));
  $("speed").addEventListener("change", (event) => clock.setSpeed(Number(event.target.value)));
  $("trails").addEventListener("click", toggleTrails);
  $("help").addEventListener("click", toggleHelp);
  for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => look(button.dataset.view));
  bindScrub(timeline.canvas, (x) => timeline.left + x / timeline.scale, true);
  bindScrub(timeline.overview, (x) => (x / timeline.overview.clientWidth) * data.duration, false);
  timeline.canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const anchor = timeline.left + event.offsetX / timeline.scale;
    if (event.ctrlKey || event.metaKey) timeline.zoom(Math.exp(-clamp(event.deltaY, -120, 120) * 0.003), anchor);
    else {
      timeline.left += (event.deltaX + event.deltaY) / timeline.scale;
      timeline.fit();
      changed();
    }
  }, { passive: false });
  timeline.canvas.setAttribute("aria-valuemax", data.duration.toFixed(3));
}

async function raise() {
  const source = URL.createObjectURL(new Blob([$("three").textContent], { type: "text/javascript" }));
  try {
    stage = new Stage(await import(source), $("figure"));
  } catch (error) {
    $("stage-message").textContent = `The figure needs WebGL, which this browser does not offer here (${error.message}).`;
    $("stage-message").hidden = false;
  } finally {
    URL.revokeObjectURL(source);
  }
}

readColours();
writeFacts();
bindDesk();
bindStage($("figure"));
bindKeys();
loadSound();
resized();
await raise();
resized();
new ResizeObserver(resized).observe($("stage"));
new ResizeObserver(resized).observe(timeline.canvas);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readColours(); stage?.paint(); shownBlock = -1; changed(); });
// For the console: what is shown, and the pose as the figure has it.
window.preview = { clock, timeline, rotations, roots, poseAt: (time) => Array.from(poseAt(time, new Float32Array(joints * 4))), get stage() { return stage; } };
requestAnimationFrame(tick);
document.body.dataset.ready = "true";

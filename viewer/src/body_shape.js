// The body of our own figure: trunk, head, arms and legs, hung on its bones. Metres.

import {
  BufferGeometry, Float32BufferAttribute, Group, Matrix4, Skeleton, SkinnedMesh, SphereGeometry, Uint16BufferAttribute, Vector3,
} from "three";

import { carved } from "./face.js";
import { fingeredHand, relaxedHand } from "./hand_shape.js";
import { clamp } from "./numbers.js";

/** A tube of rounded rings around the spine, each ring bound to the two joints it lies between. */
function loft(figure, rings, chain, material) {
  const around = 40;
  const places = [], skinIndex = [], skinWeight = [], faces = [];
  const heights = chain.map((name) => figure.at(name).y);
  const indices = chain.map((name) => figure.tree.names.indexOf(name));
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
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(places, 3));
  geometry.setAttribute("skinIndex", new Uint16BufferAttribute(skinIndex, 4));
  geometry.setAttribute("skinWeight", new Float32BufferAttribute(skinWeight, 4));
  geometry.setIndex(faces);
  geometry.computeVertexNormals();
  const mesh = new SkinnedMesh(geometry, figure.materials[material]);
  mesh.castShadow = mesh.receiveShadow = true;
  mesh.frustumCulled = false;
  figure.group.add(mesh);
  mesh.bind(figure.skeleton ??= new Skeleton(figure.bones), new Matrix4());
}

export function buildTorso(figure) {
  const hips = figure.at("Hips").y, neck = figure.at("Neck").y, chest = figure.at("Spine3");
  const tall = neck - hips;
  const chain = ["Hips", "Spine", "Spine1", "Spine2", "Spine3", "Neck"];
  const row = (share, wide, deep, z) => [hips + share * tall, wide, deep, z];
  loft(figure, [
    row(-0.19, 0.002, 0.002, 0.0), row(-0.185, 0.070, 0.06, 0.0), row(-0.15, 0.130, 0.096, -0.003), row(-0.08, 0.148, 0.104, -0.006),
    row(-0.02, 0.140, 0.096, -0.006),
  ], chain, "trousers");
  loft(figure, [
    row(-0.155, 0.160, 0.112, -0.006), row(-0.15, 0.173, 0.126, -0.006), row(-0.13, 0.1755, 0.129, -0.006), row(0.0, 0.168, 0.121, -0.006),
    row(0.12, 0.156, 0.111, -0.004), row(0.26, 0.142, 0.101, 0.0),
    row(0.40, 0.145, 0.104, 0.002), row(0.54, 0.160, 0.114, 0.004), row(0.68, 0.175, 0.120, 0.002), row(0.80, 0.178, 0.114, -0.004),
    row(0.89, 0.160, 0.098, -0.010), row(0.95, 0.120, 0.080, -0.012), row(1.0, 0.078, 0.063, -0.008), row(1.03, 0.058, 0.054, -0.004),
    row(1.035, 0.050, 0.047, -0.004),
  ].map(([y, w, d, z]) => [y, w, d, z + chest.z * 0.4]), chain, "shirt");
}

export function buildHead(figure) {
    const zero = new Vector3();
  figure.limb(figure.bone("Neck"), new Vector3(0, -0.02, 0), figure.offset("Neck1"), 0.053, 0.050, "skin");
  figure.limb(figure.bone("Neck1"), zero, figure.offset("Head"), 0.050, 0.050, "skin");
  const head = figure.bone("Head");
  const tall = new Vector3().fromArray(figure.tree.tips.Head ?? [0, 0.17, 0.02]).length();
  const s = tall / 0.171, centre = [0, 0.092 * s, 0.016 * s], radii = [0.077 * s, 0.118 * s, 0.094 * s];
  figure.skull = figure.ball(head, centre, radii, "skin", [28, 20]); // the face is carved into it
  figure.headSize = s;
  carved(figure.skull.geometry);
  figure.ball(head, [0, 0.080 * s, 0.1065 * s], [0.0085 * s, 0.019 * s, 0.012 * s], "skin");
  figure.ball(head, [0, 0.068 * s, 0.111 * s], [0.0115 * s, 0.008 * s, 0.0105 * s], "skin");
  figure.dots = [-1, 1].map((x) => {
    figure.ball(head, [x * 0.074 * s, 0.085 * s, 0.008], [0.010, 0.025, 0.017], "skin");
    return figure.ball(head, [x * 0.028 * s, 0.100 * s, 0.0985 * s], [0.0075, 0.0095, 0.006], "shoe"); // an eye of a figure without a face
  });
  const hair = figure.mesh(head, hairGeometry(), "hair");
  hair.position.set(...centre);
  hair.scale.set(...radii);
}

/** Where hair begins, by the angle from the front: [radians, height on the skull, -1 to 1]. High over the forehead, back
 *  at the temples, down before the ear, around it, and low at the nape. */
const HAIRLINE = [[0, 0.6], [0.45, 0.56], [0.85, 0.44], [1.15, 0.3], [1.35, -0.02], [1.6, 0.02], [1.8, -0.22], [2.3, -0.5], [Math.PI, -0.58]];
/** Share of the skull's radius: how thick hair is on top, at the sides and behind, how deep its parting is, and how far it
 *  sinks into the skin where it ends. */
const HAIR = { top: 0.15, side: 0.085, back: 0.12, parting: 0.06, sunk: 0.03 };

function hairline(angle) {
  const k = Math.max(HAIRLINE.findIndex(([at]) => at >= angle), 1), [a, low] = HAIRLINE[k - 1], [b, high] = HAIRLINE[k];
  return low + (high - low) * clamp((angle - a) / (b - a), 0, 1);
}

/** Hair on a unit skull: thick on top and behind, thin towards the hairline, parted on the left, in locks that lie back. */
function hairGeometry() {
  const geometry = new SphereGeometry(1, 64, 40), place = geometry.attributes.position, smooth = (t) => t * t * (3 - 2 * t);
  for (let i = 0; i < place.count; i++) {
    const x = place.getX(i), y = place.getY(i), z = place.getZ(i), angle = Math.abs(Math.atan2(x, z));
    const full = smooth(clamp((y - hairline(angle)) / 0.22, 0, 1)), behind = smooth(clamp((0.3 - z) / 0.9, 0, 1));
    const thick = HAIR.side + (HAIR.top - HAIR.side) * smooth(clamp(y, 0, 1)) + (HAIR.back - HAIR.side) * behind;
    const parting = HAIR.parting * Math.exp(-(((x - 0.34) / 0.07) ** 2)) * clamp(2 * y, 0, 1) * smooth(clamp((z + 0.5) / 0.5, 0, 1));
    const locks = 0.012 * Math.sin(26 * (x - 0.34) + 5 * z) * smooth(clamp(1.6 * y, 0, 1)) + 0.01 * Math.sin(16 * angle + 3 * y) * behind;
    const out = 1 - HAIR.sunk + full * (thick + HAIR.sunk - parting + locks);
    place.setXYZ(i, x * out, y * out, z * out);
  }
  return carved(geometry);
}

export function buildArm(figure, side) {
    const zero = new Vector3(), name = (part) => side + part;
  const collar = figure.bone(name("Shoulder")), arm = figure.bone(name("Arm"));
  const fore = figure.bone(name("ForeArm")), hand = figure.bone(name("Hand"));
  const toArm = figure.offset(name("Arm")), toFore = figure.offset(name("ForeArm")), toHand = figure.offset(name("Hand"));
  figure.limb(collar, toArm.clone().multiplyScalar(0.12).add(new Vector3(0, -0.012, -0.008)),
    toArm.clone().add(new Vector3(0, -0.004, 0)), 0.062, 0.060, "shirt");
  figure.limb(arm, zero, toFore.clone().multiplyScalar(0.62), 0.059, 0.051, "shirt");
  figure.limb(arm, toFore.clone().multiplyScalar(0.5), toFore, 0.043, 0.039, "skin");
  figure.limb(fore, zero, toHand.clone().multiplyScalar(0.3), 0.039, 0.041, "skin");
  figure.limb(fore, toHand.clone().multiplyScalar(0.3), toHand, 0.041, 0.026, "skin");
  if (figure.bone(name("HandMiddle1"))) fingeredHand(figure, side);
  else relaxedHand(figure, hand, new Vector3().fromArray(figure.tree.tips[name("Hand")] ?? toHand.clone().multiplyScalar(0.6).toArray()));
}

/** Legs that stand still where the data knows nothing below the hips, and move where it does. */
export function buildLegs(figure) {
    figure.legs = new Group();
  figure.group.add(figure.legs);
  if (figure.bone("LeftUpLeg")) {
    for (const side of ["Left", "Right"]) buildLeg(figure, side);
    return;
  }
  for (const x of [-1, 1]) {
    const hip = new Vector3(x * 0.080, 0.89, 0), knee = new Vector3(x * 0.098, 0.50, 0.012), ankle = new Vector3(x * 0.106, 0.09, -0.02);
    figure.limb(figure.legs, hip, knee, 0.084, 0.056, "trousers");
    figure.limb(figure.legs, knee, ankle, 0.056, 0.044, "trousers");
    const shoe = figure.limb(figure.legs, new Vector3(x * 0.106, 0.043, -0.035), new Vector3(x * 0.128, 0.036, 0.115), 0.043, 0.036, "shoe");
    shoe.castShadow = true;
  }
}

function buildLeg(figure, side) {
    const zero = new Vector3(), joint = (part) => figure.bone(side + part);
  figure.limb(joint("UpLeg"), zero, figure.offset(side + "Leg"), 0.076, 0.056, "trousers");
  figure.limb(joint("Leg"), zero, figure.offset(side + "Foot"), 0.056, 0.044, "trousers");
  const ball = figure.offset(side + "ToeBase");
  figure.limb(joint("Foot"), new Vector3(0, ball.y * 0.62, -0.035), new Vector3(ball.x, ball.y * 0.75, ball.z * 0.95), 0.043, 0.037, "shoe");
  figure.limb(joint("ToeBase"), new Vector3(0, 0.014, -0.02), new Vector3(0, 0.012, 0.045), 0.036, 0.030, "shoe");
}

// The face of our own figure: a mouth that opens and shapes, eyes that move, lids and brows. Hung on the head; metres.

import { BufferGeometry, DoubleSide, Float32BufferAttribute, Group, Mesh, MeshStandardMaterial, SphereGeometry, TorusGeometry } from "three";

import { BLINK, BROWS, LEFT, UP, lipCurves, mouthOf } from "./mouth.js";
import { clamp } from "./numbers.js";

const COLUMNS = 25;
const COLOURS = { lip: "#b3685d", mouth: "#4a1f22", tooth: "#f3eee4", white: "#f7f4ee", iris: "#5a4634", pupil: "#17130f" };
/** Places on the head's front: the mouth, the eyes and the brows. */
const MOUTH_Y = 0.043, EYE = { x: 0.0295, y: 0.1, radius: 0.0145, deep: 0.0078 }, BROW = { y: 0.1225, half: 0.0145 };
/** How far decals lie before the skin, so that the facets of the head do not show through; the ridge of a lip more. */
const BEFORE = 0.0013, RIDGE = 0.0032;
/** Metres that the chin sinks at the widest mouth, and the heights between which the skin stretches for it. */
const CHIN = 0.013, STRETCH = [0.004, -0.03];
/** Turn of the upper lid, radians: open and shut; and of the lower one. */
const OPEN = -0.47, SHUT = 0.42, LOWER = 0.46;

/** The skull: a unit sphere made into the shape of a head, narrow at the chin, the face flatter than the back. */
export function carved(geometry) {
  const place = geometry.attributes.position;
  for (let i = 0; i < place.count; i++) {
    const [x, z] = carve(place.getX(i), place.getY(i), place.getZ(i));
    place.setX(i, x);
    place.setZ(i, z);
  }
  geometry.computeVertexNormals();
  return geometry;
}

function carve(x, y, z) {
  const low = Math.max(-y, 0);
  return [x * (1 - 0.19 * low ** 1.5), z * (1 - 0.16 * low ** 1.4) + 0.10 * low ** 1.3];
}

/** How far the jaw takes a height of the front along, 0 to 1. */
const share = (y) => {
  const t = clamp((MOUTH_Y + STRETCH[0] - y) / (STRETCH[0] - STRETCH[1]), 0, 1);
  return t * t * (3 - 2 * t);
};

export class Face {
  /** skull: the mesh of `buildHead`; size: of the head, 1 for the usual one. */
  constructor(figure, skull, size) {
    this.skull = skull;
    this.size = size;
    this.group = new Group();
    figure.bone("Head").add(this.group);
    this.materials = Object.fromEntries(Object.entries(COLOURS).map(([name, color]) => [name, new MeshStandardMaterial({
      name, color, roughness: name === "white" || name === "pupil" ? 0.3 : 0.7, side: DoubleSide })]));
    this.materials.skin = figure.materials.skin;
    this.materials.hair = figure.materials.hair;
    this.loosenJaw();
    this.strips = { mouth: this.strip("mouth"), tooth: this.strip("tooth"), upper: this.strip("lip", 3), lower: this.strip("lip", 3) };
    this.eyes = [1, -1].map((side) => this.eye(side));
    this.brows = [1, -1].map((side) => this.brow(side));
  }

  /** Give the skull a shape with the chin down. */
  loosenJaw() {
    const { geometry, position, scale } = this.skull, place = geometry.attributes.position, moved = new Float32Array(place.count * 3);
    for (let i = 0; i < place.count; i++) {
      const y = position.y + scale.y * place.getY(i), front = clamp(0.5 + 2 * place.getZ(i), 0, 1);
      moved[i * 3 + 1] = (-CHIN * this.size * share(y / this.size) * front) / scale.y;
    }
    geometry.morphTargetsRelative = true;
    geometry.morphAttributes.position = [new Float32BufferAttribute(moved, 3)];
    this.skull.updateMorphTargets();
  }

  /** The depth of the skin at a place of the front, the jaw being `open`. */
  skin(x, y, open = 0) {
    const { position, scale } = this.skull;
    let from = y; // where this piece of skin is with a shut mouth
    for (let turn = 0; turn < 3; turn++) from = y + CHIN * this.size * open * share(from / this.size);
    const v = clamp((from - position.y) / scale.y, -1, 1), low = Math.max(-v, 0);
    const u = (x - position.x) / scale.x / (1 - 0.19 * low ** 1.5);
    return position.z + scale.z * carve(u, v, Math.sqrt(Math.max(1 - u * u - v * v, 0)))[1];
  }

  /** A band of quads between rows of `COLUMNS` points, which `lay` places. */
  strip(material, rows = 2) {
    const geometry = new BufferGeometry(), faces = [];
    geometry.setAttribute("position", new Float32BufferAttribute(new Float32Array(rows * COLUMNS * 3), 3));
    for (let r = 0; r + 1 < rows; r++) {
      for (let k = 0; k + 1 < COLUMNS; k++) {
        const a = r * COLUMNS + k, b = a + COLUMNS;
        faces.push(a, b, a + 1, a + 1, b, b + 1);
      }
    }
    geometry.setIndex(faces);
    const mesh = new Mesh(geometry, this.materials[material]);
    mesh.receiveShadow = true;
    mesh.frustumCulled = false; // its size changes with every picture
    this.group.add(mesh);
    return mesh;
  }

  /** rows: for each a height and a distance before the skin, by column. */
  lay({ geometry }, curves, rows, open) {
    const place = geometry.attributes.position, s = this.size;
    rows.forEach((row, r) => curves.forEach((curve, k) => {
      const [height, before] = row(curve), x = curve[0] * s, y = (MOUTH_Y + height) * s;
      place.setXYZ(r * COLUMNS + k, x, y, this.skin(x, y, open) + before * s);
    }));
    place.needsUpdate = true;
    geometry.computeVertexNormals();
  }

  eye(side) {
    const { x, y, radius, deep } = EYE, s = this.size, r = radius * s, at = new Group(), ball = new Group();
    at.position.set(side * x * s, y * s, this.skin(x * s, y * s) - deep * s);
    const part = (to, geometry, material) => {
      const mesh = new Mesh(geometry, this.materials[material]);
      mesh.receiveShadow = true;
      to.add(mesh);
      return mesh;
    };
    const cap = (grow, angle) => new SphereGeometry(r * grow, 24, 8, 0, Math.PI * 2, 0, angle).rotateX(Math.PI / 2);
    part(ball, new SphereGeometry(r, 24, 16), "white");
    part(ball, cap(1.012, 0.5), "iris");
    part(ball, cap(1.022, 0.24), "pupil");
    const dome = () => new SphereGeometry(r * 1.09, 24, 12, 0, Math.PI * 2, 0, Math.PI / 2);
    const lid = part(at, dome(), "skin"), low = part(at, dome().rotateX(Math.PI), "skin");
    low.rotation.x = LOWER;
    // Lashes, so that a shut eye is more than a bulge.
    lid.add(new Mesh(new TorusGeometry(r * 1.09, r * 0.05, 6, 40).rotateX(Math.PI / 2), this.materials.pupil));
    at.add(ball);
    this.group.add(at);
    return { ball, lid };
  }

  brow(side) {
    const s = this.size, columns = 9, geometry = new BufferGeometry(), places = [], faces = [];
    const bar = new Group();
    bar.position.set(side * EYE.x * s, BROW.y * s, this.skin(EYE.x * s, BROW.y * s));
    for (let k = 0; k < columns; k++) {
      const t = -1 + (2 * k) / (columns - 1), x = t * BROW.half * s, thick = (0.0027 - 0.0011 * t * side) * s * (1 - 0.6 * t ** 6);
      const arch = (0.0032 * (1 - t * t) - 0.003 * Math.max(t * side, 0) ** 2) * s, depth = this.skin(bar.position.x + x, bar.position.y) - bar.position.z;
      for (const [up, out] of [[-1, 0], [0, 0.0034], [1, 0]]) places.push(x, arch + up * thick, depth + (BEFORE + out) * s);
      if (k) for (const r of [0, 1]) faces.push(3 * k - 3 + r, 3 * k + r, 3 * k - 2 + r, 3 * k - 2 + r, 3 * k + r, 3 * k + 1 + r);
    }
    geometry.setAttribute("position", new Float32BufferAttribute(places, 3));
    geometry.setIndex(faces);
    geometry.computeVertexNormals();
    bar.add(new Mesh(geometry, this.materials.hair));
    this.group.add(bar);
    return { bar, side, rest: bar.position.clone() };
  }

  /** face: the 20 numbers, as `mouth.js` has them. */
  show(face) {
    const mouth = mouthOf(face), curves = lipCurves(mouth, COLUMNS), { open } = mouth;
    this.skull.morphTargetInfluences[0] = open;
    this.lay(this.strips.mouth, curves, [([, , top]) => [top, BEFORE], ([, , , , bottom]) => [bottom, BEFORE]], open);
    this.lay(this.strips.tooth, curves, [([, , top]) => [top, BEFORE + 0.0005], ([, , , teeth]) => [teeth, BEFORE + 0.0005]], open);
    this.strips.tooth.visible = open > 0.08 || mouth.bite > 0.3;
    const ridge = (outer, inner) => [[outer, 0.0002], [(outer + inner) / 2, RIDGE + 0.002 * Math.max(-mouth.wide, 0)], [inner, BEFORE + 0.0009]];
    const rows = (outer, inner) => [0, 1, 2].map((row) => (curve) => ridge(curve[outer], curve[inner])[row]);
    this.lay(this.strips.upper, curves, rows(1, 2), open);
    this.lay(this.strips.lower, curves, rows(5, 4), open);
    for (const { ball, lid } of this.eyes) {
      ball.rotation.set(-face[UP], face[LEFT], 0, "YXZ");
      // The upper lid goes with the eye, as lids do.
      lid.rotation.x = OPEN - 0.35 * Math.min(face[UP], 0.2) + (SHUT - OPEN + 0.35 * Math.min(face[UP], 0.2)) * face[BLINK];
    }
    for (const { bar, side, rest } of this.brows) {
      const raised = Math.max(face[BROWS], 0), drawn = Math.max(-face[BROWS], 0), y = rest.y + (0.0075 * raised - 0.003 * drawn) * this.size;
      bar.position.set(rest.x - side * 0.003 * drawn * this.size, y, rest.z + this.skin(Math.abs(rest.x), y) - this.skin(Math.abs(rest.x), rest.y));
      bar.rotation.z = side * (0.07 * raised + 0.25 * drawn);
    }
  }

  set visible(shown) {
    this.group.visible = shown;
    if (!shown) this.skull.morphTargetInfluences[0] = 0;
  }

  dispose() { for (const name of Object.keys(COLOURS)) this.materials[name].dispose(); }
}

// Our own figure: a plain body on the joints of a take.

import { Bone, Group, LatheGeometry, Mesh, MeshStandardMaterial, SphereGeometry, Vector2, Vector3 } from "three";

import { buildArm, buildHead, buildLegs, buildTorso } from "./body_shape.js";
import { Face } from "./face.js";
import { processorDraws } from "./software.js";
import { colours } from "./theme.js";

const CLOTHES = ["shirt", "trousers", "skin", "shoe", "hair"];
const UP = new Vector3(0, 1, 0);

/** Sides of a limb and of a finger, steps of the round end of each, and columns and rows of a ball. The plain ones look the
 *  same at half the height of a screen. */
const FINE = { limb: [24, 7], finger: [24, 7], ball: [28, 20] }, PLAIN = { limb: [16, 4], finger: [8, 2], ball: [18, 12] };
/** Metres: a finger is thinner. */
const THIN = 0.02;

/** A limb along +Y from 0 to `length`, round at both ends. */
function limbGeometry(r0, r1, length, [sides, quarter]) {
  const points = [];
  for (const [radius, y, way] of [[r0, 0, -1], [r1, length, 1]]) {
    for (let i = 0; i <= quarter; i++) {
      // From the pole to the rim at the lower end, and back at the upper one.
      const a = (i / quarter) * Math.PI / 2;
      points.push(way < 0 ? new Vector2(Math.sin(a) * radius, y - Math.cos(a) * radius)
        : new Vector2(Math.cos(a) * radius, y + Math.sin(a) * radius));
    }
  }
  return new LatheGeometry(points, sides);
}

export class Figure {
  /** take: whose skeleton it has. second: it wears the other shirt. fine: with many triangles; by default where a GPU
   *  draws them. */
  constructor(take, second = false, fine = !processorDraws()) {
    this.detail = fine ? FINE : PLAIN;
    this.tree = take.skeleton;
    this.second = second;
    this.group = new Group();
    this.bones = this.tree.names.map((name, j) => {
      const bone = new Bone();
      bone.name = name;
      bone.position.fromArray(this.tree.offsets[j]);
      return bone;
    });
    this.tree.parents.forEach((parent, j) => (parent < 0 ? this.group : this.bones[parent]).add(this.bones[j]));
    this.materials = Object.fromEntries(CLOTHES.map((name) => [name, new MeshStandardMaterial({ name, roughness: 0.78, metalness: 0 })]));
    this.group.updateMatrixWorld(true);
    this.rest = this.bones.map((bone) => new Vector3().setFromMatrixPosition(bone.matrixWorld));
    buildTorso(this);
    buildHead(this);
    for (const side of ["Left", "Right"]) buildArm(this, side);
    buildLegs(this);
    this.paint();
  }

  /** Whether it can show a take. */
  fits(take) { return take.skeleton.names.length === this.tree.names.length; }

  bone(name) { return this.bones[this.tree.names.indexOf(name)]; }
  at(name) { return this.rest[this.tree.names.indexOf(name)]; }
  offset(name) { return new Vector3().fromArray(this.tree.offsets[this.tree.names.indexOf(name)]); }

  mesh(parent, geometry, material) {
    const mesh = new Mesh(geometry, this.materials[material]);
    mesh.castShadow = mesh.receiveShadow = true;
    parent.add(mesh);
    return mesh;
  }

  limb(parent, from, to, r0, r1, material) {
    const way = new Vector3().subVectors(to, from);
    const mesh = this.mesh(parent, limbGeometry(r0, r1, way.length(), this.detail[r0 < THIN ? "finger" : "limb"]), material);
    mesh.position.copy(from);
    mesh.quaternion.setFromUnitVectors(UP, way.normalize());
    return mesh;
  }

  ball(parent, centre, radii, material, round = null) {
    const mesh = this.mesh(parent, new SphereGeometry(1, ...(round ?? this.detail.ball)), material);
    mesh.position.set(...centre);
    mesh.scale.set(...radii);
    return mesh;
  }

  paint() {
    for (const [name, material] of Object.entries(this.materials)) {
      material.color.set(colours[name === "shirt" && this.second ? "shirt-b" : name]);
    }
  }

  /** poser: at the time that is to be shown. */
  show(poser) {
    const { local, root, face = null } = poser;
    this.express(face);
    this.bones.forEach((bone, j) => bone.quaternion.set(local[j * 4 + 1], local[j * 4 + 2], local[j * 4 + 3], local[j * 4]));
    this.bones[0].position.fromArray(root);
    // Legs that the motion lacks turn with the hips' yaw and stand under them.
    this.legs.rotation.y = 2 * Math.atan2(local[2], local[0]);
    this.legs.position.set(root[0], 0, root[2]);
    this.legs.scale.y = root[1] / this.tree.height;
  }

  /** face: the 20 numbers of one, or null for a take without a face. */
  express(face) {
    if (!face && !this.face) return;
    this.face ??= new Face(this, this.skull, this.headSize);
    this.face.visible = Boolean(face);
    for (const dot of this.dots) dot.visible = !face;
    if (face) this.face.show(face);
  }

  dispose() {
    this.group.traverse((node) => node.geometry?.dispose());
    this.face?.dispose();
    for (const material of Object.values(this.materials)) material.dispose();
  }
}

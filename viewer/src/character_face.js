// The face of a GLB that is no VRM: its morph targets, eyes and jaw, by the constants that gesticulator/face/page.py wrote.

import { Quaternion, Vector3 } from "three";

import { LEFT, NUMBERS, UP } from "./mouth.js";
import { clamp } from "./numbers.js";

const HIGH = new Vector3(0, 1, 0);

export class CharacterFace {
  /** told: { morphs, curves, eyes, jaw, open }; rest: node -> its rotations at rest, { local, world }; left: the character's, in the axes of the file. */
  static async read(gltf, told, rest, left) {
    const made = new CharacterFace(), { associations } = gltf.parser, node = (number) => gltf.parser.getDependency("node", number);
    Object.assign(made, { told, rest, left, meshes: [] });
    made.eyes = await Promise.all(told.eyes.map(node));
    made.jaw = told.jaw === null ? null : await node(told.jaw);
    gltf.scene.traverse((mesh) => {
      if (!mesh.morphTargetInfluences) return;
      // A mesh of several materials is a group of meshes.
      const number = associations.get(mesh)?.nodes ?? associations.get(mesh.parent)?.nodes;
      const rows = told.morphs.filter(([at, target]) => at === number && target < mesh.morphTargetInfluences.length);
      if (rows.length) made.meshes.push({ mesh, rows, still: [...mesh.morphTargetInfluences] });
    });
    return made;
  }

  /** The weight of each curve for the 20 numbers of a face, 0 to 1. */
  curves(face) {
    const part = (at) => Math.max(at < NUMBERS ? face[at] : -face[at - NUMBERS], 0);
    return Object.fromEntries(Object.entries(this.told.curves).map(([name, constants]) => (
      [name, clamp(Object.entries(constants).reduce((sum, [at, constant]) => sum + constant * part(Number(at)), 0), 0, 1)])));
  }

  /** face: the 20 numbers as `mouth.js` has them, or null for the face of the file. */
  show(face) {
    const curves = face && this.curves(face);
    for (const { mesh, rows, still } of this.meshes) {
      for (const [, target, found] of rows) {
        mesh.morphTargetInfluences[target] = face ? clamp(found.reduce((sum, [name, share]) => sum + share * curves[name], 0), 0, 1) : still[target];
      }
    }
    const turn = (axis, angle) => new Quaternion().setFromAxisAngle(axis, angle);
    for (const eye of this.eyes) this.turn(eye, face && turn(HIGH, face[LEFT]).multiply(turn(this.left, -face[UP])));
    if (this.jaw) this.turn(this.jaw, face && turn(this.left, this.told.open * curves.opening));
  }

  /** Turn a node from its rest by a turn of the world at rest; null: none. */
  turn(node, by) {
    const { local } = this.rest.get(node), above = this.rest.get(node.parent)?.world ?? new Quaternion();
    node.quaternion.copy(local);
    if (by) node.quaternion.premultiply(above).premultiply(by).premultiply(above.clone().invert());
  }
}

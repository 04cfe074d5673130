// The pose in which a skin was bound to its bones: the rest pose of a file may be another one, such as a frame of a stride.

import { Matrix4, Quaternion, Vector3 } from "three";

/** Largest median angle between the trunk at rest and as it was bound, radians: a stride turns it by a third of that. */
const MOST_TURN = Math.PI / 3;
/** Difference of the elements of two matrices that are equal, as a share of their scale. */
const EQUAL = 1e-3;
/** Share by which bones at rest may be longer than bound ones: bones of another length are no pose of theirs. */
const LONGER = 0.02;

/** Bone -> its world rotation when the largest skin of a scene was bound; empty where the file does not tell. */
export function boundTurns(scene) {
  let skin = null;
  scene.traverse((node) => {
    if (node.isSkinnedMesh && node.skeleton.bones.length > (skin?.skeleton.bones.length ?? 0)) skin = node;
  });
  if (!skin) return new Map();
  const { bones, boneInverses } = skin.skeleton, bound = boneInverses.map((inverse) => inverse.clone().invert());
  const space = spaceOf(skin, bones, boneInverses, bound);
  return new Map(space ? bones.map((bone, row) => [bone, turnOf(new Matrix4().multiplyMatrices(space, bound[row]))]) : []);
}

/** From the space of a mesh to the world: as most bones have it, which then rest as they were bound; else as a node has
 *  it that carries the mesh or the bones, and null where none does. */
function spaceOf(skin, bones, inverses, bound) {
  const seen = bones.map((bone, row) => new Matrix4().multiplyMatrices(bone.matrixWorld, inverses[row]));
  const agreeing = seen.map((space) => seen.filter((other) => equal(space, other)).length), most = Math.max(...agreeing);
  if (2 * most >= bones.length) return seen[agreeing.indexOf(most)];
  const rows = new Map(bones.map((bone, row) => [bone, row])), at = (matrix) => new Vector3().setFromMatrixPosition(matrix);
  const long = (matrices) => bones.reduce((sum, { parent }, row) => (
    rows.has(parent) ? sum + at(matrices[row]).distanceTo(at(matrices[rows.get(parent)])) : sum), 0);
  const scale = long(bones.map((bone) => bone.matrixWorld)) / long(bound);
  // Joints near the root are the trunk's; of the others most are fingers.
  const trunk = bones.map((bone, row) => [depth(bone), row]).sort((a, b) => a[0] - b[0]).slice(0, Math.max(3, bones.length / 3));
  let best = null, least = MOST_TURN;
  for (const node of [skin, ...bones.map(({ parent }) => parent).filter((parent) => parent && !rows.has(parent))]) {
    const space = node.matrixWorld, angles = trunk.map(([, row]) => (
      turnOf(new Matrix4().multiplyMatrices(space, bound[row])).angleTo(turnOf(bones[row].matrixWorld)))).sort((a, b) => a - b);
    const angle = angles[angles.length >> 1];
    if (Math.abs(Math.cbrt(Math.abs(space.determinant())) / scale - 1) < LONGER && angle < least - 1e-6) [best, least] = [space, angle];
  }
  return best;
}

function equal(a, b) {
  const most = EQUAL * Math.max(...a.elements.map(Math.abs));
  return a.elements.every((value, place) => Math.abs(value - b.elements[place]) <= most);
}

const turnOf = (matrix) => new Quaternion().setFromRotationMatrix(new Matrix4().extractRotation(matrix));

const depth = (node) => (node.parent ? 1 + depth(node.parent) : 0);

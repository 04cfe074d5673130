// The paths of the hands over the last moments, as ribbons that fade and face the viewer.

import { BufferAttribute, BufferGeometry, Color, DoubleSide, Group, Mesh, MeshBasicMaterial, Quaternion, Vector3 } from "three";

import { clamp } from "./numbers.js";
import { colours } from "./theme.js";

const SECONDS = 0.7;
const COUNT = 44;

export class Trails {
  constructor() {
    this.group = new Group();
    this.ribbons = ["Left", "Right"].map((side) => {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(new Float32Array(COUNT * 6), 3));
      geometry.setAttribute("color", new BufferAttribute(new Float32Array(COUNT * 8), 4));
      const faces = [];
      for (let i = 0; i + 1 < COUNT; i++) faces.push(2 * i, 2 * i + 1, 2 * i + 2, 2 * i + 2, 2 * i + 1, 2 * i + 3);
      geometry.setIndex(faces);
      const material = new MeshBasicMaterial({ vertexColors: true, transparent: true, side: DoubleSide, depthWrite: false });
      const mesh = new Mesh(geometry, material);
      mesh.frustumCulled = false;
      this.group.add(mesh);
      return { side, mesh, colour: new Color() };
    });
    this.paint();
  }

  paint() { for (const ribbon of this.ribbons) ribbon.colour.set(colours[ribbon.side.toLowerCase()]); }

  /** Where a palm is at a time, by forward kinematics along the chain of its joints. */
  palmAt(take, side, time, out) {
    const { parents, offsets, tips } = take.skeleton, turn = new Quaternion(), local = new Quaternion(), step = new Vector3();
    const chain = [];
    for (let j = take.row(`${side}Hand`); j >= 0; j = parents[j]) chain.unshift(j);
    const [a, b, share] = take.around(time), pose = this.pose ??= new Float32Array(4 * 64);
    for (const [depth, j] of chain.entries()) {
      take.blend(a, b, share, j, pose);
      local.set(pose[j * 4 + 1], pose[j * 4 + 2], pose[j * 4 + 3], pose[j * 4]);
      if (!depth) out.fromArray(take.rootAt(time, this.root ??= new Float32Array(3)));
      else out.add(step.fromArray(offsets[j]).applyQuaternion(turn));
      turn.multiply(local);
    }
    const tip = tips[`${side}Hand`] ?? offsets[take.row(`${side}HandMiddle1`)] ?? [0, 0, 0];
    return out.add(step.fromArray(tip).multiplyScalar(tips[`${side}Hand`] ? 0.6 : 1).applyQuaternion(turn));
  }

  show(take, time, camera) {
    const next = new Vector3(), along = new Vector3(), across = new Vector3(), view = new Vector3();
    const eye = this.group.worldToLocal(camera.position.clone());
    for (const { side, mesh, colour } of this.ribbons) {
      const place = mesh.geometry.attributes.position, paint = mesh.geometry.attributes.color;
      const places = Array.from({ length: COUNT + 1 }, (_, i) => (
        this.palmAt(take, side, Math.max(0, time - (i / (COUNT - 1)) * SECONDS), new Vector3())));
      for (let i = 0; i < COUNT; i++) {
        const age = i / (COUNT - 1), here = places[i];
        along.subVectors(here, next.copy(places[i + 1]));
        across.crossVectors(along, view.subVectors(eye, here)).normalize().multiplyScalar(0.014 * (1 - age) + 0.001);
        place.setXYZ(2 * i, here.x + across.x, here.y + across.y, here.z + across.z);
        place.setXYZ(2 * i + 1, here.x - across.x, here.y - across.y, here.z - across.z);
        // A hand at rest leaves no trail.
        const fade = (1 - age) ** 1.6 * 0.75 * clamp((along.length() * COUNT) / SECONDS / 0.6, 0, 1);
        for (const v of [2 * i, 2 * i + 1]) paint.setXYZW(v, colour.r, colour.g, colour.b, fade);
      }
      place.needsUpdate = paint.needsUpdate = true;
    }
  }
}

// A performer: a take on a body, our own figure or a character of the user's.

import { Group } from "three";

import { Figure } from "./figure.js";
import { Poser } from "./take.js";
import { Trails } from "./trails.js";

/** The materials of a ghost; where it is in the same place as the other one, it is behind. */
const GHOST = { transparent: true, opacity: 0.38, depthWrite: false, polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 8 };

export class Performer {
  constructor(take, second, trails) {
    this.group = new Group();
    this.second = second;
    this.trails = new Trails();
    this.trails.group.visible = trails;
    this.group.add(this.trails.group);
    this.character = null;
    this.figure = null;
    this.play(take);
  }

  get body() { return this.character ?? this.figure; }

  play(take) {
    this.take = take;
    this.poser = new Poser(take);
    if (this.figure?.fits(take)) return;
    const shown = this.figure?.group.visible ?? true;
    if (this.figure) {
      this.group.remove(this.figure.group);
      this.figure.dispose();
    }
    this.figure = new Figure(take, this.second);
    this.figure.group.visible = shown;
    this.group.add(this.figure.group);
  }

  /** Dress as a character; `null` as our own figure. */
  wear(character) {
    if (this.character) this.group.remove(this.character.group);
    this.character = character;
    if (character) this.group.add(character.group);
    this.figure.group.visible = !character;
  }

  /** Let it be seen through, or not any more. */
  ghost(on) {
    this.ghosted = on;
    this.body.group.traverse((node) => {
      for (const material of [node.material ?? []].flat()) {
        const { userData } = material;
        if (!on && !userData.solid) continue;
        userData.solid ??= Object.fromEntries(Object.keys(GHOST).map((name) => [name, material[name]]));
        Object.assign(material, on ? GHOST : userData.solid);
        material.needsUpdate = true;
      }
      if (node.isMesh) node.castShadow = !on;
    });
  }

  paint() {
    this.figure.paint();
    this.trails.paint();
  }

  show(time, camera) {
    this.poser.set(time);
    this.body.show(this.poser);
    // The paths are those of our own figure's hands, whose arms may be of another length.
    const paths = this.trails.group;
    paths.children.forEach((ribbon) => { ribbon.visible = !this.character; });
    if (paths.visible && !this.character) this.trails.show(this.take, time, camera);
  }
}

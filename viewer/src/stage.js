// The stage: light, floor and camera, and one or two performers on it.

import {
  Box3, CanvasTexture, DirectionalLight, Group, HemisphereLight, Mesh, MeshBasicMaterial, PCFShadowMap, PerspectiveCamera, PlaneGeometry, Scene,
  ShadowMaterial, SRGBColorSpace, Vector3, WebGLRenderer,
} from "three";

import { clamp } from "./numbers.js";
import { colours } from "./theme.js";

const VIEWS = {
  front: { yaw: 0, pitch: 0.02, distance: 4.7, x: 0, y: 1.0, z: 0 },
  side: { yaw: Math.PI / 2, pitch: 0.02, distance: 4.7, x: 0, y: 1.0, z: 0 },
  close: { yaw: 0.2, pitch: 0.04, distance: 2.75, x: 0, y: 1.27, z: 0 },
  reset: { yaw: 0.34, pitch: 0.09, distance: 4.7, x: 0, y: 1.0, z: 0 },
};
/** Metres between two performers, and how tall the figure is for which the views and these metres are made. */
const APART = 1.7, TALL = 1.75;
const calm = matchMedia("(prefers-reduced-motion: reduce)");

export class Stage {
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(26, 1, 0.1, 60);
    this.view = { ...VIEWS.reset };
    this.goal = { ...VIEWS.reset };
    this.performers = [];
    /** How many times as tall as our own figure the tallest performer is, and on what height the lowest one stands. */
    this.size = 1;
    this.floor = 0;
    this.addLights();
    this.addFloor();
    this.paint();
  }

  addLights() {
    this.sky = new HemisphereLight(0xffffff, 0xd8cbb8, 1.7);
    this.sun = new DirectionalLight(0xfff4e2, 1.7);
    // From the front and low, so that no face is in the dark.
    this.fill = new DirectionalLight(0xfff8f0, 0.9);
    this.fill.position.set(-1.2, 1.2, 3.4);
    this.sun.position.set(1.6, 3.6, 2.6);
    this.sun.target.position.set(0, 0.9, 0);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 1024);
    Object.assign(this.sun.shadow.camera, { left: -2.4, right: 2.4, top: 1.7, bottom: -1.7, near: 0.5, far: 10 });
    this.sun.shadow.bias = -0.0006;
    this.sun.shadow.normalBias = 0.018;
    this.sun.shadow.radius = 4;
    this.rim = new DirectionalLight(0xcfe4ff, 0.9);
    this.rim.position.set(-2.2, 2.4, -2.5);
    this.scene.add(this.sky, this.sun, this.sun.target, this.fill, this.rim);
  }

  /** Make views, light and floor fit the performers: a goblin or a giant fills the picture as our own figure does. */
  fit() {
    const boxes = this.performers.map(({ character }) => (character ? boxOf(character) : { low: 0, tall: TALL }));
    this.size = Math.max(...boxes.map(({ tall }) => tall), 0) / TALL || 1;
    this.floor = Math.min(...boxes.map(({ low }) => low));
    const { size, sun, rim, camera } = this, shadow = sun.shadow.camera;
    this.ground.scale.setScalar(Math.max(size, 0.3));
    this.ground.position.y = this.floor;
    sun.position.set(1.6, 3.6, 2.6).multiplyScalar(size);
    sun.target.position.set(0, 0.9 * size, 0);
    rim.position.set(-2.2, 2.4, -2.5).multiplyScalar(size);
    Object.assign(shadow, { left: -2.4 * size, right: 2.4 * size, top: 1.7 * size, bottom: -1.7 * size, near: 0.5 * size, far: 10 * size });
    sun.shadow.normalBias = 0.018 * size;
    shadow.updateProjectionMatrix();
    Object.assign(camera, { near: 0.1 * size, far: 60 * size });
    camera.updateProjectionMatrix();
  }

  addFloor() {
    this.ground = new Group();
    this.scene.add(this.ground);
    this.floorTexture = new CanvasTexture(document.createElement("canvas"));
    this.floorTexture.anisotropy = 8;
    this.floorTexture.colorSpace = SRGBColorSpace;
    const size = 10;
    const grid = new Mesh(new PlaneGeometry(size, size), new MeshBasicMaterial({ map: this.floorTexture, transparent: true, depthWrite: false }));
    const shade = new Mesh(new PlaneGeometry(size, size), new ShadowMaterial({ opacity: 0.26 }));
    for (const plane of [grid, shade]) {
      plane.rotation.x = -Math.PI / 2;
      this.ground.add(plane);
    }
    shade.receiveShadow = true;
    shade.position.y = 0.002;
  }

  /** Half-metre squares that fade with distance. */
  paintFloor() {
    const canvas = this.floorTexture.image, size = 1024, lines = 20, pen = canvas.getContext("2d");
    canvas.width = canvas.height = size;
    pen.clearRect(0, 0, size, size);
    pen.strokeStyle = colours.grid;
    for (let i = 0; i <= lines; i++) {
      const x = Math.round((i / lines) * (size - 2)) + 1;
      pen.lineWidth = i % 2 ? 1.2 : 2.2;
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
    for (const performer of this.performers) performer.paint();
    this.paintFloor();
    this.sky.intensity = 1.7 * Number(colours.light);
    this.sun.intensity = 1.7 * Number(colours.light);
  }

  /** Put performers on the stage, from left to right; over: all in one place. */
  cast(performers, over = false) {
    this.over = over;
    for (const performer of this.performers) this.scene.remove(performer.group);
    this.performers = performers;
    this.fit();
    performers.forEach((performer, place) => {
      const [x, z] = performer.take.middle();
      // Seen from the front, the first stands on the left.
      performer.group.position.set((place - (performers.length - 1) / 2) * (over ? 0 : APART * this.size) - x, 0, -z);
      this.scene.add(performer.group);
    });
  }

  look(name) {
    // Go the short way round.
    const turn = Math.PI * 2, goal = { ...VIEWS[name] };
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

  zoom(factor) { this.goal.distance = clamp(this.goal.distance * factor, 1.1, 14); }

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
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  /** posed(): called when all are in their pose, before the picture is drawn. */
  draw(time, posed = () => {}) {
    const { yaw, pitch } = this.view, [distance, x, y, z] = ["distance", "x", "y", "z"].map((name) => this.view[name] * this.size);
    const high = y + this.floor;
    // A narrow window needs more room for the arms, and two need more than one.
    const [wide, least] = this.performers.length > 1 && !this.over ? [1.9, 1.2] : [0.8, 1];
    const far = distance * Math.max(least, wide / this.camera.aspect);
    this.camera.position.set(x + far * Math.sin(yaw) * Math.cos(pitch), high + far * Math.sin(pitch), z + far * Math.cos(yaw) * Math.cos(pitch));
    this.camera.lookAt(x, high, z);
    this.camera.updateMatrixWorld();
    for (const performer of this.performers) performer.show(time, this.camera);
    posed();
    this.renderer.render(this.scene, this.camera);
  }

  /** Where a performer's feet are on the canvas, in CSS pixels; for what is written beneath. */
  feetOf(performer) {
    const at = new Vector3().setFromMatrixPosition(performer.group.matrixWorld);
    const [x, z] = performer.take.middle();
    at.x += x;
    at.z += z;
    at.y += this.floor;
    at.project(this.camera);
    return [((at.x + 1) / 2) * this.canvas.clientWidth, ((1 - at.y) / 2) * this.canvas.clientHeight];
  }
}

/** How high a character stands, and how tall it is, in the pose that it is in: metres. Measured once. */
function boxOf(character) {
  if (!character.box) {
    character.group.updateWorldMatrix(true, true);
    const { min, max } = new Box3().setFromObject(character.group, true), tall = max.y - min.y;
    // A file without a mesh, or with one that is nowhere, is as tall as ours.
    character.box = tall > 0.01 && Number.isFinite(tall) ? { low: min.y, tall } : { low: 0, tall: TALL };
  }
  return character.box;
}

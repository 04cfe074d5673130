// What a pointer does on the stage: orbit, pan with two fingers or the right button, zoom with wheel or pinch.

import { clamp } from "./numbers.js";

export function bindStage(stage, changed) {
  const { canvas } = stage, fingers = new Map();
  const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => { stage.look("reset"); changed(); });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    stage.zoom(Math.exp(clamp(event.deltaY, -120, 120) * 0.0015));
    changed();
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before.x, dy = event.clientY - before.y, wide = fingers.size === 2 ? spread() : 0;
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size === 2) {
      stage.zoom(wide / Math.max(spread(), 1));
      stage.pan(dx / 2, dy / 2);
    } else if (event.buttons & 2 || event.shiftKey) stage.pan(dx, dy);
    else stage.orbit(dx, dy);
    changed();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
}

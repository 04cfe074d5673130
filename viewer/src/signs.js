// The signs of beats: the shape tells the kind as well as the colour does.

import { picture } from "./dom.js";
import { colours } from "./theme.js";

const COLOUR = { "onset": "onset", "loud_pseudo": "loud", "even_pseudo": "even", "boundary": "boundary", "edited": "accent" };
export const TITLES = {
  "onset": "onset", "loud_pseudo": "pseudo-beat, loud", "even_pseudo": "pseudo-beat, even", "boundary": "start or end",
  "edited": "moved by you",
};
export const flagColour = (kind) => colours[COLOUR[kind] ?? "boundary"];

/** Draw a sign of radius r. */
export function drawSign(pen, kind, x, y, r) {
  pen.fillStyle = pen.strokeStyle = flagColour(kind);
  pen.lineWidth = r * 0.4;
  pen.beginPath();
  if (kind === "onset") pen.arc(x, y, r, 0, Math.PI * 2);
  else if (kind === "loud_pseudo") polygon(pen, x, y, r * 1.2, 4);
  else if (kind === "even_pseudo") pen.arc(x, y, r * 0.88, 0, Math.PI * 2);
  else if (kind === "edited") polygon(pen, x, y, r * 1.25, 3);
  else pen.rect(x - r * 0.8, y - r * 0.8, r * 1.6, r * 1.6);
  if (kind === "even_pseudo") pen.stroke(); else pen.fill();
}

function polygon(pen, x, y, r, corners) {
  for (let i = 0; i < corners; i++) {
    const a = -Math.PI / 2 + (i / corners) * Math.PI * 2;
    pen.lineTo(x + r * Math.cos(a), y + r * Math.sin(a));
  }
  pen.closePath();
}

/** The sign as an element. */
export function signPicture(kind) {
  const fill = `var(--${COLOUR[kind] ?? "boundary"})`;
  const shapes = {
    "onset": ["circle", { cx: 6, cy: 6, r: 4.5, fill }],
    "loud_pseudo": ["path", { d: "M6 .8 11.2 6 6 11.2 .8 6z", fill }],
    "even_pseudo": ["circle", { cx: 6, cy: 6, r: 4, fill: "none", "stroke-width": 1.8, stroke: fill }],
    "boundary": ["rect", { x: 2, y: 2, width: 8, height: 8, fill }],
    "edited": ["path", { d: "M6 1 11 10H1z", fill }],
  };
  return picture(shapes[kind] ?? shapes.boundary);
}

export const silencePicture = () => picture(["rect", { width: 12, height: 12, rx: 2, fill: "var(--silence)" }], ["path", { d: "M0 12 12 0", stroke: "var(--soft)" }]);

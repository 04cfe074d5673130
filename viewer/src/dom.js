// The page's elements. Text always goes in as text, so that no name of a user's can become an element.

export const $ = (id) => document.getElementById(id);

/** An element with properties, attributes (those with a hyphen, and role), and children (elements or text). */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "role" || name.includes("-")) made.setAttribute(name, value);
    else made[name] = value;
  }
  made.append(...children);
  return made;
}

const SVG = "http://www.w3.org/2000/svg";

/** A picture of 12 by 12 units: a list of [tag, attributes]. */
export function picture(...shapes) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 12 12");
  svg.setAttribute("aria-hidden", "true");
  for (const [tag, attributes] of shapes) {
    const shape = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) shape.setAttribute(name, value);
    svg.append(shape);
  }
  return svg;
}

/** Tell something for a while, and to screen readers. */
let fading = 0;
export function notice(text, bad = false) {
  const box = $("notice");
  box.textContent = text;
  box.hidden = !text;
  box.classList.toggle("bad", bad);
  clearTimeout(fading);
  // Faults stay until they are clicked away.
  if (text && !bad) fading = setTimeout(() => { box.hidden = true; }, 8000);
}

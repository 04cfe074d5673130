// Files that come in (a character, a motion, a plan) and go out.

import { $ } from "./dom.js";

/** Hand bytes or a text to the user as a file. */
export function save(name, content, type) {
  const url = URL.createObjectURL(new Blob([content], { type })), link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** A name that every system takes. */
export const fileName = (title, ending) => `${title.replace(/[^\p{L}\p{N}._-]+/gu, "_").replace(/^[._]+/, "").slice(0, 80) || "talk"}${ending}`;

/** Let files be dropped anywhere, and picked: take(file) for each. */
export function bindFiles(take) {
  const shade = $("drop");
  let depth = 0;
  const show = (by) => {
    depth = Math.max(0, depth + by);
    shade.hidden = !depth;
  };
  const holdsFiles = (event) => event.dataTransfer?.types.includes("Files");
  addEventListener("dragenter", (event) => { if (holdsFiles(event)) { event.preventDefault(); show(1); } });
  addEventListener("dragleave", (event) => { if (holdsFiles(event)) show(-1); });
  addEventListener("dragover", (event) => { if (holdsFiles(event)) event.preventDefault(); });
  addEventListener("drop", (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    show(-Infinity);
    for (const file of event.dataTransfer.files) take(file);
  });
  for (const id of ["pick-character", "pick-motion", "pick-plan"]) {
    $(id).addEventListener("change", (event) => {
      for (const file of event.target.files) take(file);
      event.target.value = "";
    });
  }
}

// Keyboard shortcuts, and the sheet that lists them.

import { $, element } from "./dom.js";

/** What is shown on the sheet: group, then [keys, what they do]. */
const SHEET = [
  ["Play", [["Space", "play, pause"], ["← →", "one frame"], ["Shift ← →", "one block"], ["Home End", "start, end"], ["I O", "in point, out point"],
    ["X", "no in and out point"], ["L", "loop"], ["V", "sound off, on"]]],
  ["Edit", [["Click", "select a block; Shift click: up to it"], ["1 to 5", "the lexeme of that rank"], ["H", "silence, or speech again"], ["M", "mirror"], ["K", "lock"],
    ["J", "select the gesture here, one stroke, then the next"], ["U", "its whole unit, from rest to rest"], ["Ctrl Shift ← →", "select more, less"], ["Ctrl ← →", "move what is selected by a beat"], ["Ctrl , .", "move the beat by a frame"],
    ["Shift ↑ ↓", "raise, lower the curve here"], ["Shift Delete", "no point of the curve here"], ["[ ]", "smaller, larger"], ["N", "draw again"], ["B", "add a beat here"], [", .", "squeeze, stretch the selected blocks"], ["Delete", "delete the beat"], ["Ctrl Z", "undo"], ["Ctrl Shift Z", "redo"],
    ["Ctrl C Ctrl V", "copy gestures, put them here"], ["Ctrl A", "select all"], ["Ctrl S", "save the plan"], ["Esc", "close the palette or the menu; select nothing"]]],
  ["Look", [["F S C R", "front, side, close, reset"], ["T", "paths of the hands"], ["P", "palette"], ["G", "pose: pin hands and head"], ["D", "side by side"], ["Y", "the other take as a ghost"], ["A", "the other take"], ["+ −", "zoom the timeline"], ["?", "this sheet"]]],
];

export function fillSheet() {
  $("sheet-keys").replaceChildren(...SHEET.map(([title, rows]) => element("section", {}, element("h3", {}, title),
    element("dl", {}, ...rows.map(([keys, does]) => element("div", {}, element("dt", {}, keys), element("dd", {}, does)))))));
}

/** actions: key, with "ctrl+" or "shift+" before it -> what it does. */
export function bindKeys(actions) {
  addEventListener("keydown", (event) => {
    if (event.altKey || document.querySelector("dialog[open]")) return;
    const { target } = event, key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const ctrl = event.ctrlKey || event.metaKey;
    // A focused button keeps its space, a list its letters and arrows, a slider its arrows.
    if (!ctrl && target.matches?.("button, summary") && (key === " " || key === "Enter")) return;
    if (!ctrl && target.matches?.("select, input[type=range]") && key !== "Escape") return;
    if (target.matches?.("input[type=search], input[type=number]") && key !== "Escape") return;
    const name = `${ctrl ? "ctrl+" : ""}${event.shiftKey && (ctrl || key.length > 1) ? "shift+" : ""}${key}`;
    if (!actions[name]) return;
    event.preventDefault();
    actions[name](event);
  });
}

// The knobs of the hands in the panel, and which knob's curve the timeline shows.

import { curveOf, withCurve } from "./curves.js";
import { $, element } from "./dom.js";

const HANDS = ["height", "speed", "radius"];

export function bindCurves(session, timeline, refresh) {
  const { knobs } = timeline, hands = HANDS.filter((knob) => knob in knobs);
  $("curve-knob").replaceChildren(...Object.entries(knobs).map(([knob, { name }]) => element("option", { value: knob }, name)));
  $("curve-knob").addEventListener("change", (event) => {
    timeline.knob = event.target.value;
    if (!timeline.curved) $("curve").click();
    refresh();
  });
  $("hands").hidden = !hands.length;
  for (const knob of hands) {
    const slider = $(`hand-${knob}`), { low, high, step } = knobs[knob];
    Object.assign(slider, { min: low, max: high, step });
    // The whole recording is drawn again, so not before the slider is let go.
    slider.addEventListener("change", () => session.edit(withCurve(session.plan, [[0, Number(slider.value)]], knob)));
    slider.addEventListener("input", () => { $(`hand-${knob}-is`).textContent = Number(slider.value).toFixed(2); });
  }
  const free = () => hands.reduce((plan, knob) => withCurve(plan, [], knob), session.plan);
  $("hands-free").addEventListener("click", () => session.edit(free()));
  const show = () => {
    for (const knob of hands) {
      const points = curveOf(session.plan, knob), slider = $(`hand-${knob}`), { low, high } = knobs[knob];
      if (document.activeElement !== slider) slider.value = points.length ? points[0][1] : (low + high) / 2;
      $(`hand-${knob}-is`).textContent = points.length > 1 ? "curve" : points.length ? points[0][1].toFixed(2) : "free";
    }
    $("hands-free").hidden = !hands.some((knob) => curveOf(session.plan, knob).length);
  };
  session.on("edited", show);
  show();
}

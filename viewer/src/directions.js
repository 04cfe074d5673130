// Who performs the take: performer, variation and legs, as lists to choose from in the panel.

import { $, element } from "./dom.js";

/** Variations to choose from. */
const VARIATIONS = 10;

const withSettings = (plan, settings) => ({ ...plan, made_by: { ...plan.made_by, settings } });

/** A plan on these legs: "standing", "seated", or none for null. */
export function withLegs(plan, legs) {
  const { legs: _, ...settings } = plan.made_by?.settings ?? {};
  return withSettings(plan, legs ? { ...settings, legs } : settings);
}

/** speakers: the names that the renderer knows; without them there is nothing to choose. */
export function bindDirections(session, speakers) {
  $("directions").hidden = !speakers;
  if (!speakers) return;
  const lists = {
    "direction-speaker": [speakers, (plan) => plan.speaker, (plan, speaker) => ({ ...plan, speaker })],
    "direction-variation": [Array.from({ length: VARIATIONS }, (_, number) => String(number)), (plan) => String(plan.variation ?? 0), varied],
    "direction-legs": [null, (plan) => plan.made_by?.settings?.legs ?? "", withLegs],
  };
  for (const [id, [names, , change]] of Object.entries(lists)) {
    if (names) $(id).replaceChildren(...names.map((name) => element("option", { value: name }, name)));
    $(id).addEventListener("change", (event) => session.edit(change(session.plan, event.target.value)));
  }
  const show = () => {
    for (const [id, [names, of]] of Object.entries(lists)) {
      const value = of(session.plan);
      // A plan from elsewhere may have been made with a name that is not in the list.
      if (names && ![...$(id).options].some((option) => option.value === value)) $(id).append(element("option", { value }, value));
      $(id).value = value;
    }
  };
  session.on("edited", show);
  show();
}

/** The take in another manner, with the same lexemes; blocks that were drawn again by themselves stay so. */
export function varied(plan, number) {
  const variation = Number(number), before = plan.variation ?? 0;
  const blocks = plan.blocks.map((block) => (
    block.draw?.variation === before && !block.locked ? { ...block, draw: { ...block.draw, variation } } : block));
  return { ...plan, variation, blocks };
}

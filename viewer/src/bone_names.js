// What the names of a character's bones say: Mixamo's, Unreal's, Unity's, Biped's, VRoid's, Blender's and our own.

const CENTRE = { hips: "Hips", pelvis: "Hips", head: "Head" };
const SIDED = {
  shoulder: "Shoulder", clavicle: "Shoulder", collar: "Shoulder", arm: "Arm", upperarm: "Arm", uparm: "Arm", forearm: "ForeArm",
  lowerarm: "ForeArm", hand: "Hand", wrist: "Hand", upleg: "UpLeg", upperleg: "UpLeg", thigh: "UpLeg", leg: "Leg", lowerleg: "Leg",
  calf: "Leg", shin: "Leg", foot: "Foot", ankle: "Foot", toebase: "ToeBase", toe: "ToeBase", toes: "ToeBase", ball: "ToeBase",
};
const FINGERS = { thumb: "Thumb", index: "Index", middle: "Middle", mid: "Middle", ring: "Ring", pinky: "Pinky", little: "Pinky" };
const PLACES = { proximal: 1, intermediate: 2, distal: 3 };
const NOISE = new Set(["mixamorig", "bip", "bip001", "j", "c", "def", "org", "character", "f"]);

/** The words of a name in lower case: "mixamorig:LeftUpLeg" is left, up, leg. */
function words(name) {
  const plain = name.split(/[:|]/).at(-1).replace(/^(mixamorig|bip)\d*/i, "");
  return (plain.match(/[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+/g) ?? []).map((word) => word.toLowerCase()).filter((word) => !NOISE.has(word));
}

/** Our joint that a name means; "Spine" and "Neck" for any of theirs, null where it says nothing known. */
export function jointOf(name) {
  const all = words(name);
  if (all.some((word) => ["end", "nub", "tip", "twist", "roll", "ik", "ctrl", "pole"].includes(word))) return null;
  const side = all.some((word) => word === "left" || word === "l") ? "Left" : all.some((word) => word === "right" || word === "r") ? "Right" : "";
  const rest = all.filter((word) => !["left", "l", "right", "r"].includes(word));
  const number = rest.find((word) => /^\d+$/.test(word)), place = PLACES[rest.find((word) => PLACES[word])] ?? Number(number);
  const key = rest.filter((word) => !/^\d+$/.test(word) && !PLACES[word]).join("");
  if (side) {
    const finger = FINGERS[key.replace(/^hand|^finger/, "")];
    if (finger) return place >= 1 && place <= 3 ? `${side}Hand${finger}${place}` : null;
    return SIDED[key] ? side + SIDED[key] : null;
  }
  if (/^(spine|chest|upperchest|torso)$/.test(key)) return "Spine";
  return key === "neck" ? "Neck" : CENTRE[key] ?? null;
}

/** Which of our joints each of a chain of `count` nodes takes, from the hips up. */
const SPINES = [[], ["Spine3"], ["Spine1", "Spine3"], ["Spine", "Spine2", "Spine3"], ["Spine", "Spine1", "Spine2", "Spine3"]];

/** Node -> our joint, by name. nodes: of a scene, those above first; the first node of a name is taken. */
export function jointsByName(nodes, nameOf) {
  const found = new Map(), taken = new Set(), spines = [], necks = [];
  for (const node of nodes) {
    const joint = jointOf(nameOf(node));
    if (joint === "Spine") spines.push(node);
    else if (joint === "Neck") necks.push(node);
    else if (joint && !taken.has(joint)) {
      taken.add(joint);
      found.set(node, joint);
    }
  }
  for (const [node, joint] of chains(spines, necks)) found.set(node, joint);
  return found;
}

/** [node, our joint] of the nodes of a spine and a neck, from below. */
export function chains(spines, necks) {
  const many = Math.min(spines.length, 4);
  return [...spines.slice(0, many).map((node, place) => [node, SPINES[many][place]]), ...necks.slice(0, 2).map((node, place) => [node, place ? "Neck1" : "Neck"])];
}

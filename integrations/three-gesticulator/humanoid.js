// Bones of the VRM humanoid: the bone above, and the joints of gesticulator whose world rotation it takes (of two, the
// middle). `upperChest` is left alone, since a VRM may lack it.

const SIDES = { left: "Left", right: "Right" };
const FINGERS = { Thumb: "Thumb", Index: "Index", Middle: "Middle", Ring: "Ring", Little: "Pinky" };

export const BONES = {
  hips: [null, ["Hips"]], spine: ["hips", ["Spine", "Spine1"]], chest: ["spine", ["Spine3"]],
  neck: ["chest", ["Neck"]], head: ["neck", ["Head"]],
};
for (const [side, name] of Object.entries(SIDES)) {
  Object.assign(BONES, {
    [`${side}Shoulder`]: ["chest", [`${name}Shoulder`]], [`${side}UpperArm`]: [`${side}Shoulder`, [`${name}Arm`]],
    [`${side}LowerArm`]: [`${side}UpperArm`, [`${name}ForeArm`]], [`${side}Hand`]: [`${side}LowerArm`, [`${name}Hand`]],
    [`${side}UpperLeg`]: ["hips", [`${name}UpLeg`]], [`${side}LowerLeg`]: [`${side}UpperLeg`, [`${name}Leg`]],
    [`${side}Foot`]: [`${side}LowerLeg`, [`${name}Foot`]], [`${side}Toes`]: [`${side}Foot`, [`${name}ToeBase`]],
  });
  for (const [finger, joint] of Object.entries(FINGERS)) {
    const parts = finger === "Thumb" ? ["Metacarpal", "Proximal", "Distal"] : ["Proximal", "Intermediate", "Distal"];
    parts.forEach((part, k) => {
      const above = k ? `${side}${finger}${parts[k - 1]}` : `${side}Hand`;
      BONES[`${side}${finger}${part}`] = [above, [`${name}Hand${joint}${k + 1}`]];
    });
  }
}

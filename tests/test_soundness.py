"""What comes out on a character is measured: sound ones pass, and each kind of fault is refused with its reason."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_module.errors import InputError
from gesticulator.characters.command import COMMAND
from gesticulator.characters.joints import find_joints
from gesticulator.characters.mapping import RigMapping, save_mapping
from gesticulator.characters.reading import read_character
from gesticulator.characters.retarget import Retargeter
from gesticulator.characters.rig import Character, decomposed
from gesticulator.characters.soundness import probe_motion
from gesticulator.infer import retargeter_for
from gesticulator.jobs import CharacterRequest
from tests.rigs import PLACES, Rig, as_glb, draw, placed


def read(rig: Rig, folder: Path) -> Character:
    """The rig with a mesh of tubes, read from a file."""
    file = folder / "rig.glb"
    file.write_bytes(as_glb(rig, tubes=True))
    return read_character(file)


@pytest.mark.parametrize("place", PLACES)
def test_a_sound_character_has_neither_fault_nor_doubt(place: str, tmp_path: Path) -> None:
    rig = placed(draw(7, "mixamo", "A"), place, np.random.default_rng(7), tmp_path / "rig.glb")
    moved = Retargeter(rig.character)
    assert [doubt for doubt in moved.doubts if "exchanged" not in doubt] == []
    assert ("exchanged" in " ".join(moved.doubts)) is (place == "mirrored")


def exchanged(joints: dict[str, int], one: str, other: str) -> dict[str, int]:
    """The joints with two sides, or two joints, in each other's place."""
    swap = {**{name: other + name.removeprefix(one) for name in joints if name.startswith(one)},
            **{name: one + name.removeprefix(other) for name in joints if name.startswith(other)}}
    return {swap.get(name, name): node for name, node in joints.items()}


def test_a_mapping_that_is_wrong_is_refused_with_the_line_to_correct(tmp_path: Path) -> None:
    character = read(draw(3, "mixamo", "A"), tmp_path)
    good = find_joints(character)
    names = character.names
    joints = dict(good.joints)
    cases: list[tuple[dict[str, int], str, str]] = [
        (exchanged(joints, "Left", "Right"), "toes point backwards", '"LeftFoot": "mixamorig:RightFoot"'),
        # A weapon in the hand, taken for the hand.
        ({**joints, "RightForeArm": joints["RightHand"], "RightHand": joints["RightHandIndex3"]}, "upper arm",
         '"RightForeArm": "mixamorig:RightHand"'),
        ({**joints, "LeftUpLeg": joints["LeftLeg"], "LeftLeg": joints["LeftFoot"], "LeftFoot": joints["LeftToeBase"]},
         "shin", '"LeftLeg": "mixamorig:LeftFoot"'),
    ]
    for wrong, reason, line in cases:
        kept = {name: node for name, node in wrong.items() if name == "RightHand"
                or not name.startswith(("RightHand", "LeftToeBase"))}
        with pytest.raises(InputError) as refused:
            Retargeter(character, RigMapping(kept, good.spine, good.neck))
        text = str(refused.value)
        assert "would come out wrong" in text and reason in text and line in text and "--mapping" in text, text
    assert names[joints["Head"]] == "mixamorig:Head"


def test_a_mesh_that_is_left_behind_is_refused(tmp_path: Path) -> None:
    character = read(draw(3, "mixamo", "A"), tmp_path)
    still = next(node for node, parent in enumerate(character.parents) if parent < 0)
    hand = find_joints(character).joints["LeftHand"]
    skin = character.skin
    torn = replace(skin, joints=np.where(skin.joints == hand, still, skin.joints))
    assert (torn.joints != skin.joints).any()
    with pytest.raises(InputError, match=r"mesh tears|mesh of its"):
        Retargeter(replace(character, skin=torn))


def test_four_legs_are_refused() -> None:
    places = {"root": (0, 0, 0), "hips": (0, 0.6, -0.4), "spine": (0, 0.62, 0.0), "chest": (0, 0.65, 0.3),
              "neck": (0, 0.75, 0.45), "head": (0, 0.9, 0.6)}
    parents = {"root": "", "hips": "root", "spine": "hips", "chest": "spine", "neck": "chest", "head": "neck"}
    for side, x in (("l", 0.12), ("r", -0.12)):
        arm, leg = ("upperarm", "forearm", "hand"), ("thigh", "shin", "foot")
        for names, top, z in ((arm, "chest", 0.35), (leg, "hips", -0.4)):
            for name, y in zip(names, (0.58, 0.3, 0.05), strict=True):
                places[f"{name}_{side}"] = (x, y, z)
                parents[f"{name}_{side}"], top = top, f"{name}_{side}"
    keys = list(places)
    at = np.array([places[key] for key in keys], dtype=float)
    above = [keys.index(parents[key]) if parents[key] else -1 for key in keys]
    local = np.array([place - (at[parent] if parent >= 0 else 0.0) for place, parent in zip(at, above, strict=True)])
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (len(keys), 1))
    horse = Character(tuple(keys), tuple(above), local, turns, np.ones((len(keys), 3)), Path("horse.glb"), "glb",
                      np.ones(len(keys), dtype=bool), unit=1.0)
    with pytest.raises(InputError, match="four legs"):
        Retargeter(horse)


def hung(rig: Character, nodes: list[int], on: int) -> Character:
    """The character with some nodes hung on another one, where they are."""
    whole, parents = rig.world_matrices(), list(rig.parents)
    translations, rotations = rig.translations.copy(), rig.rotations.copy()
    for node in nodes:
        parents[node] = on
        translations[node], rotations[node], _ = decomposed(np.linalg.inv(whole[on]) @ whole[node])
    order = sorted(range(len(rig)), key=lambda node: _depth(parents, node))
    back = {node: place for place, node in enumerate(order)}
    return replace(rig, names=tuple(rig.names[node] for node in order), node_ids=tuple(range(len(rig))),
                   parents=tuple(back[parents[node]] if parents[node] >= 0 else -1 for node in order),
                   translations=translations[order], rotations=rotations[order], scales=rig.scales[order],
                   skinned=rig.skinned[order], flesh=np.zeros((0, 3)), flesh_nodes=np.zeros(0, np.int64))


def rooted(style: str) -> Rig:
    """A rig of a style with a node above the hips."""
    return next(rig for rig in (draw(seed, style, "A") for seed in range(20))
                if rig.character.kind == "glb" and rig.character.parents[rig.truth["Hips"]] >= 0)


def test_limbs_that_hang_beside_the_trunk_are_refused_with_what_to_do() -> None:
    """Deforming bones that were exported without the controls that tie them together."""
    rig = rooted("rigify")
    tops = [rig.truth.get(side + "Shoulder", rig.truth[side + "Arm"]) for side in ("Left", "Right")]
    flat = hung(rig.character, tops, rig.character.parents[rig.truth["Hips"]])
    with pytest.raises(InputError, match="one tree"):
        Retargeter(flat)


def test_legs_whose_feet_hang_beside_them_stay_and_the_rest_gestures() -> None:
    """Toys whose feet are targets of inverse kinematics."""
    rig = rooted("quaternius")
    names = rig.character.names
    toy = hung(rig.character, [rig.truth[side + "Foot"] for side in ("Left", "Right")],
               rig.character.parents[rig.truth["Hips"]])
    moved = Retargeter(toy)
    assert not moved.legs and toy.names[moved.mapping.joints["LeftUpLeg"]] == names[rig.truth["LeftUpLeg"]]
    assert toy.names[moved.mapping.joints["LeftHand"]] == names[rig.truth["LeftHand"]]
    motion = moved(probe_motion())
    assert motion.translations is None and motion.hips not in motion.moved
    assert moved.mapping.joints["LeftForeArm"] in motion.moved


def _depth(parents: list[int], node: int) -> int:
    return 0 if node < 0 else 1 + _depth(parents, parents[node])


def test_a_confidence_is_measured_and_a_doubt_is_shown_by_both_commands(tmp_path: Path,
                                                                        capsys: pytest.CaptureFixture[str]) -> None:
    """Names that are all known, and a mapping that a user wrote, say nothing of a forearm half as long as the other."""
    rig = next(rig for rig in (draw(seed, "mixamo", "A") for seed in range(9)) if rig.character.kind == "glb")
    names, found = rig.character.names, {}
    for name, size in (("even", 1.0), ("odd", 0.5)):
        lengths = rig.character.translations.copy()
        lengths[names.index("mixamorig:LeftHand")] *= size
        file = tmp_path / f"{name}.glb"
        file.write_bytes(as_glb(replace(rig, character=replace(rig.character, translations=lengths))))
        character = read_character(file)
        mapping = find_joints(character)
        save_mapping(tmp_path / f"{name}.json", mapping, character)
        assert COMMAND.main("gesticulator character", [str(file), "--mapping", str(tmp_path / f"{name}.json")]) == 0
        found[name] = capsys.readouterr().out
    assert "100% sure" in found["even"] and "doubt" not in found["even"]
    assert "86% sure: look at the result" in found["odd"] and "doubt: " in found["odd"]
    retargeter_for(CharacterRequest(str(file), str(tmp_path / "odd.json")))
    doubt = found["odd"].split("doubt: ")[1].splitlines()[0]
    assert f"{doubt}; look at the result" in capsys.readouterr().err
    assert retargeter_for(CharacterRequest(str(file), str(tmp_path / "odd.json")), quiet=True) is not None
    assert capsys.readouterr().err == ""

"""Folders of exactly the layout in which Trinity, ZeroEGGS, MOCCA and Talking With Hands (by GENEA) are published, with
short motions and clicks."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from scipy.spatial.transform import Rotation

from data_module.types import Motion, Skeleton

RATE = 16000
_Bone = tuple[str, str, tuple[float, float, float]]
_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")


def rig(*, ends: bool = True) -> Skeleton:
    """The hierarchy that Trinity, ZeroEGGS and BEAT publish, fingers and legs and all; arms hang half down (A-pose)."""
    bones: list[_Bone] = [
        ("Hips", "", (0, 0, 0)), ("Spine", "Hips", (0, 0.07, 0)), ("Spine1", "Spine", (0, 0.11, 0)),
        ("Spine2", "Spine1", (0, 0.11, 0)), ("Spine3", "Spine2", (0, 0.1, 0)), ("Neck", "Spine3", (0, 0.14, 0)),
        ("Neck1", "Neck", (0, 0.04, 0.01)), ("Head", "Neck1", (0, 0.04, 0.01))]
    if ends:
        bones.append(("HeadEnd", "Head", (0, 0.17, 0)))
    for side, sign in (("Right", -1), ("Left", 1)):
        arm: list[_Bone] = [("Shoulder", "Spine3", (0.03, 0.09, 0)), ("Arm", "Shoulder", (0.15, 0, 0)),
                            ("ForeArm", "Arm", (0.2, -0.2, 0)), ("Hand", "ForeArm", (0.18, -0.18, 0))]
        arm += [(f"Hand{finger}{joint}", "Hand" if joint == 1 else f"Hand{finger}{joint - 1}", (0.03, -0.02, 0.001))
                for finger in _FINGERS for joint in (1, 2, 3, 4)]
        leg: list[_Bone] = [("UpLeg", "Hips", (0.09, -0.03, 0)), ("Leg", "UpLeg", (0, -0.42, 0)),
                            ("Foot", "Leg", (0, -0.4, 0)), ("ToeBase", "Foot", (0, -0.06, 0.13))]
        bones += [(side + name, above if above in ("Spine3", "Hips") else side + above, (sign * x, y, z))
                  for name, above, (x, y, z) in arm + leg]
    return _of_bones(bones)


def _of_bones(bones: list[_Bone]) -> Skeleton:
    names = tuple(name for name, _, _ in bones)
    parents = tuple(names.index(above) if above else -1 for _, above, _ in bones)
    return Skeleton(names, parents, np.array([offset for _, _, offset in bones], dtype=np.float64))


def hands_rig() -> Skeleton:
    """The hierarchy of Talking With Hands as GENEA gave it, in T-pose: twist joints in arms and legs, a fourth joint of
    each thumb at the wrist."""
    bones: list[_Bone] = [
        ("body_world", "", (0, 0, 0)), ("b_root", "body_world", (0, 0.95, 0)),
        ("b_spine0", "b_root", (0, 0.06, -0.01)), ("b_spine1", "b_spine0", (0, 0.11, 0)),
        ("b_spine2", "b_spine1", (0, 0.12, 0)), ("b_spine3", "b_spine2", (0, 0.12, 0)),
        ("b_neck0", "b_spine3", (0, 0.14, 0)), ("b_head", "b_neck0", (0, 0.09, 0.02)),
        ("b_head_null", "b_head", (0, 0.17, 0))]
    for side, sign in (("r", -1), ("l", 1)):
        arm: list[_Bone] = [
            (f"b_{side}_shoulder", "b_spine3", (0.03, 0.08, 0)),
            (f"p_{side}_scap", f"b_{side}_shoulder", (0.08, 0, -0.02)),
            (f"b_{side}_arm", f"p_{side}_scap", (0.07, 0, 0)),
            (f"b_{side}_arm_twist", f"b_{side}_arm", (0.14, 0, 0)),
            (f"b_{side}_forearm", f"b_{side}_arm_twist", (0.14, 0, 0)),
            (f"b_{side}_wrist_twist", f"b_{side}_forearm", (0.13, 0, 0)),
            (f"b_{side}_wrist", f"b_{side}_wrist_twist", (0.12, 0, 0)),
            (f"b_{side}_thumb0", f"b_{side}_wrist", (0.02, -0.01, 0.02))]
        arm += [(f"b_{side}_{finger.lower()}{joint}",
                 f"b_{side}_wrist" if joint == 1 and finger != "Thumb" else f"b_{side}_{finger.lower()}{joint - 1}",
                 (0.08 if joint == 1 and finger != "Thumb" else 0.03, 0, 0.02 - 0.02 * place if joint == 1 else 0))
                for place, finger in enumerate(_FINGERS) for joint in (1, 2, 3)]
        leg: list[_Bone] = [(f"b_{side}_upleg", "b_root", (0.09, -0.04, 0)),
                            (f"b_{side}_leg", f"b_{side}_upleg", (0, -0.42, 0)),
                            (f"b_{side}_foot_twist", f"b_{side}_leg", (0, -0.2, 0)),
                            (f"b_{side}_foot", f"b_{side}_foot_twist", (0, -0.2, 0))]
        bones += [(name, above, (sign * x, y, z)) for name, above, (x, y, z) in arm + leg]
    return _of_bones(bones)


def moving(seconds: float, fps: float, seed: int = 0, skeleton: Skeleton | None = None) -> Motion:
    """Every joint sways on its own."""
    skeleton = skeleton or rig()
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * fps))[:, None, None] / fps
    turns = 0.3 * np.sin(times * rng.uniform(1, 4, (1, len(skeleton), 3)) + rng.uniform(0, 6, (1, len(skeleton), 3)))
    quaternions = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat(scalar_first=True)
    root = np.array([0.0, 0.95, 0.0]) + 0.1 * np.sin(times[:, 0] * np.array([1.0, 2.0, 3.0]))
    return Motion(skeleton, quaternions.reshape(len(times), len(skeleton), 4), root, fps)


def bvh_in(motion: Motion, order: str = "ZXY", unit: float = 0.01, positions: bool = False) -> str:
    """A BVH file as other tools write it: any order of rotations, any unit, positions for every joint if wanted."""
    skeleton = motion.skeleton
    lines, columns = ["HIERARCHY"], []

    def joint(index: int, depth: int) -> None:
        pad = "\t" * depth
        offset = " ".join(f"{value:.6f}" for value in skeleton.offsets[index] / unit)
        six = index == 0 or positions
        channels = [f"{axis}position" for axis in "XYZ"] * six + [f"{axis}rotation" for axis in order]
        lines.extend([f"{pad}{'JOINT' if depth else 'ROOT'} {skeleton.names[index]}", pad + "{",
                      f"{pad}\tOFFSET {offset}", f"{pad}\tCHANNELS {len(channels)} {' '.join(channels)}"])
        if six:
            place = motion.root_positions if index == 0 else np.tile(skeleton.offsets[index], (len(motion), 1))
            columns.append(place / unit)
        turns = Rotation.from_quat(motion.rotations[:, index], scalar_first=True)
        columns.append(turns.as_euler(order, degrees=True))
        below = [child for child, parent in enumerate(skeleton.parents) if parent == index]
        for child in below:
            joint(child, depth + 1)
        if not below:
            lines.extend([f"{pad}\tEnd Site", pad + "\t{", f"{pad}\t\tOFFSET 0 0 0", pad + "\t}"])
        lines.append(pad + "}")

    joint(0, 0)
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / motion.fps:.6f}"]
    rows = np.concatenate(columns, axis=1)
    return "\n".join(lines) + "\n" + "\n".join(" ".join(f"{value:.6f}" for value in row) for row in rows) + "\n"


def write_clicks(path: Path, seconds: float, apart: float = 0.3) -> None:
    """Bursts of noise every `apart` seconds from `apart` on, over a faint floor."""
    rng = np.random.default_rng(0)
    sound = 1e-5 * rng.normal(size=round(seconds * RATE))
    burst = 0.3 * rng.normal(size=round(0.04 * RATE)) * np.exp(-np.arange(round(0.04 * RATE)) / (0.01 * RATE))
    for place in np.arange(apart, seconds - 0.05, apart):
        at = round(place * RATE)
        sound[at:at + len(burst)] += burst
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, sound, RATE)


def write_take(motion: Path, sound: Path, seconds: float = 2.0, seed: int = 0, swaying: Motion | None = None,
               **how: Any) -> Motion:
    """One BVH file and its WAV, which is half a second longer. swaying: the motion."""
    made = swaying or moving(seconds, 60.0, seed)
    motion.parent.mkdir(parents=True, exist_ok=True)
    motion.write_text(bvh_in(made, **how))
    write_clicks(sound, seconds + 0.5)
    return made


def google(words: list[tuple[str, float, float]]) -> list[dict[str, str]]:
    """Words as Google's recogniser times them."""
    return [{"start_time": f"{start:.3f}s", "end_time": f"{end:.3f}s", "word": word} for word, start, end in words]


def trinity(root: Path, train: tuple[int, ...] = (1, 8), test: tuple[int, ...] = (1,)) -> Path:
    """GENEA_Challenge_2020_data_release, with some of its recordings."""
    release = root / "GENEA_Challenge_2020_data_release"
    names = {f"Recording_{number:03d}": "Training_data" for number in train}
    names |= {f"TestSeq{number:03d}": "Test_data" for number in test}
    for seed, (name, part) in enumerate(names.items()):
        place = release / part
        write_take(place / "Motion" / f"{name}.bvh", place / "Audio" / f"{name}.wav", seed=seed)
        (place / "Transcripts").mkdir(exist_ok=True)
        said = [{"alternatives": [{"words": google([("So", 0.2, 0.5), ("we", 0.5, 0.7)])}]},
                {"alternatives": [{"words": google([("went.", 1.0, 1.4)])}]}]
        (place / "Transcripts" / f"{name}.json").write_text(json.dumps(said))
    return release


def zeroeggs(root: Path, numbers: tuple[int, ...] = (1, 5, 10, 67)) -> Path:
    """ZeroEGGS's folder data, with some of its recordings."""
    data = root / "data"
    styles = {1: "Neutral_0", 2: "Neutral_1", 5: "Neutral_4", 10: "Sad_4", 67: "Speech_2"}
    for number in numbers:
        name = f"{number:03d}_{styles[number]}"
        clean = data / "clean" / f"{name}_x_1_0"
        write_take(clean.with_suffix(".bvh"), clean.with_suffix(".wav"), seed=number, order="ZYX", positions=True)
    return data


def mocca(root: Path, names: tuple[str, ...] = ("speaker01_clip01", "speaker01_clip04", "speaker05_clip02")) -> Path:
    """MOCCA unpacked into one folder, with some of its recordings."""
    for seed, name in enumerate(names):
        take = root / "MOCCA" / name
        write_take(take.with_suffix(".bvh"), take.with_suffix(".wav"), seed=seed)
        take.with_suffix(".srt").write_text("1\n00:00:00,200 --> 00:00:01,000\n大家好\n\n"
                                            "2\n00:00:01,200 --> 00:00:01,900\n我是老师\n", encoding="utf-8")
    return root / "MOCCA"


GENEA = {2022: ("trn_2022_v1_000", "trn_2022_v1_001", "val_2022_v1_000"),
         2023: ("trn_2023_v0_000_main-agent", "trn_2023_v0_000_interloctr", "tst_2023_v0_000_interloctr")}
"""Recordings of the two releases."""


def genea(root: Path, year: int = 2022, motion: Motion | None = None) -> Path:
    """The release of GENEA 2022 or 2023, with some of its recordings, 4 s at 30 fps. motion: that of all."""
    release = root / f"genea{year}"
    for seed, name in enumerate(GENEA[year]):
        place = release / name[:3] / name.split("_")[3] if year == 2023 else release / name[:3]
        swaying = motion or moving(4.0, 30.0, seed, hands_rig())
        write_take(place / "bvh" / f"{name}.bvh", place / "wav" / f"{name}.wav", 4.0, swaying=swaying, positions=True)
        (place / "tsv").mkdir(exist_ok=True)
        (place / "tsv" / f"{name}.tsv").write_text("0.3\t0.55\tSo\n0.55\t0.9\twe\n0.9\t1.5\t#\n2.0\t3.0\twent.\n")
    if year == 2023:
        for part in ("trn", "tst"):
            (release / part / "metadata.csv").write_text(
                f"prefix,main-agent_id,main-agent_fingers,interloctr_id,interloctr_fingers\n"
                f"{part}_2023_v0_000,17,finger_incl,3,finger_excl\n")
    else:
        (release / "trn" / "trn_2022_v1_metadata.csv").write_text(
            "trn_2022_v1_000,finger_incl,1\ntrn_2022_v1_001,finger_excl,2\n")
    return release

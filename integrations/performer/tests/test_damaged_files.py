"""The performer's own files against damage, as `tests/test_fuzz_readers.py` tests those of the main package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from damaged import check_damaged
from gesticulator_performer.borrowed import load_borrowed
from gesticulator_performer.cues import CLIPS, MEANINGS, read_cues
from gesticulator_performer.repertoire import COLUMNS, TAKES, read_repertoire
from gesticulator_performer.sources import skm
from gesticulator_performer.strokes import load_strokes, read_manifest, standing_body
from gesticulator_performer.takes import load_takes
from reader_cases import Case

from data_module.motion import skeletons
from data_module.motion.bvh import bvh_text, write_bvh


def strokes(mutated: str) -> Callable[[Path], Path]:
    """Two clips of the 16-joint character, metres, in which one arm and then the other goes up and comes down."""
    def write(folder: Path) -> Path:
        rows = []
        for side in ("Left", "Right"):
            vectors = np.zeros((75, 16, 3))
            up = np.interp(np.arange(75), [0, 20, 35, 40, 60, 75], [0, 0, 1.2, 1.2, 0, 0])
            vectors[:, skeletons.CHARACTER.index(side + "Arm"), 2] = up
            motion = skeletons.from_vector(vectors.reshape(75, -1), 30.0)
            (folder / f"ann_{side}.bvh").write_text(bvh_text(skeletons.scaled(motion, 0.01)))
            rows.append(f"ann_{side}.bvh,ann,Standing,Beat,{side.lower()},75,{35 / 30}")
        head = "file,speaker,posture,lexeme,hand,frames,emphasis"
        (folder / "manifest.csv").write_text("\n".join([head, *rows, ""]))
        return folder / mutated

    return write


def _skeleton_text() -> str:
    joints = list(skm.JOINT_TABLE.values())
    inner = ""
    for n, name in enumerate(joints[1:], 1):
        x = 0.1 * n * (name.endswith("Lf") - name.endswith("Rt"))
        y = 0.0 if x else 0.2 * n
        inner += f"joint {name}\n{{ offset {x:g} {y:g} 0.0\nprerot axis 0 1 0 ang {n}\nchannel Quat\n}}\n"
    return f"# SK\nskeleton\nroot {joints[0]}\n{{ offset 0 1 0\nprerot axis 1 0 0 ang 5\nchannel Quat\n{inner}}}\nend\n"


def _motion_text() -> str:
    joints = list(skm.JOINT_TABLE.values())
    rows = np.random.default_rng(0).normal(size=(5, 3 + 3 * len(joints))).round(4)
    channels = "".join(f"{joints[0]} {axis}Pos\n" for axis in "XYZ") + "".join(f"{name} Quat\n" for name in joints)
    frames = "".join(f"kt {t / 30:.6f} fr {' '.join(map(str, row))}\n" for t, row in enumerate(rows))
    return f'SkMotion\n\nname "a"\n\nchannels {len(joints) + 3}\n{channels}\nframes 5\n{frames}\nready time: 0.05\n'


def _smartbody(mutated: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / "a.sk").write_text(_skeleton_text())
        (folder / "a.skm").write_text(_motion_text())
        return folder / mutated

    return write


def _read_smartbody(file: Path) -> object:
    bind, clip = skm.read_sk(file.with_suffix(".sk")), skm.read_skm(file.with_suffix(".skm"))
    return skeletons.to_character(skm.motion_of(bind, clip, path=str(file)))


def _read_strokes(file: Path) -> object:
    return read_manifest(file.parent), load_strokes(file.parent)


def _clips(mutated: str) -> Callable[[Path], Path]:
    """Clips of free motion: somebody who talks, somebody who stands, and a stroke that is lent to others."""
    def write(folder: Path) -> Path:
        strokes("manifest.csv")(folder)
        rows = ["file,person,licence,emphasis"]
        for name, side in (("cmu_18_08", "Left"), ("m_idle_neutral_01", "Right"), ("pn_me", "Right"),
                           ("pn_you", "Left")):
            (folder / f"{name}.bvh").write_bytes((folder / f"ann_{side}.bvh").read_bytes())
            rows.append(f"{name}.bvh,{'pn' if name.startswith('pn') else 'ann'},none,{35 / 30}")
        (folder / "manifest.csv").write_text("\n".join([*rows, ""]))
        return folder / mutated

    return write


def _read_clips(file: Path) -> object:
    return load_takes(file.parent), load_borrowed(file.parent)


def _meanings(mutated: str) -> Callable[[Path], Path]:
    """The tables of gestures with a meaning: two labels, and a clip of each."""
    def write(folder: Path) -> Path:
        (folder / MEANINGS).write_text(
            "label,category,cues_en,cues_de,cues_es,offensive,talk\n"
            "point_left,deictic,on the left; turn left,links,izquierda,no,yes\n"
            "wave_hello,emblem;greeting,hello,hallo,hola,no,yes\n")
        (folder / CLIPS).write_text(
            "file,person,label,ready,strokeStart,emphasis,stroke,relax\n"
            "strokes/ann/left.bvh,ann,point_left,0.4,0.5,0.8,0.9,1.2\n"
            "free_motion/wave.bvh,bob,wave_hello,,,,,\n")
        return folder / mutated

    return write


def _read_meanings(file: Path) -> object:
    return read_cues(file.parent)


def _takes(folder: Path) -> Path:
    """A take of a named gesture, and its table."""
    write_bvh(folder / "nod_small_1.bvh", skeletons.from_vector(np.zeros((30, 48)), 20.0), 1.0)
    (folder / TAKES).write_text(",".join(COLUMNS) + "\nnod_small_1.bvh,nod,small,none,no,free,0.1,0.2,0.4,0.8,1.2\n")
    return folder / TAKES


def _read_takes(file: Path) -> object:
    takes = read_repertoire(file.parent)
    body = standing_body("somebody", [skeletons.from_vector(np.zeros((2, 48)), 20.0)])
    return [takes.played(outline, body) for outline in takes.outlines]


READERS = {
    "smartbody, skeleton": Case(_smartbody("a.sk"), _read_smartbody),
    "smartbody, motion": Case(_smartbody("a.skm"), _read_smartbody),
    "strokes, manifest": Case(strokes("manifest.csv"), _read_strokes),
    "gestures with a meaning": Case(_meanings(MEANINGS), _read_meanings),
    "clips with a meaning": Case(_meanings(CLIPS), _read_meanings),
    "takes of named gestures": Case(_takes, _read_takes),
    "clips, manifest": Case(_clips("manifest.csv"), _read_clips, examples=0.5),
    "clips, motion": Case(_clips("cmu_18_08.bvh"), _read_clips, examples=0.5),
    "strokes, clip": Case(strokes("ann_Left.bvh"), _read_strokes),
}


@pytest.mark.parametrize("name", READERS)
def test_only_input_errors_come_out_of_damaged_files(name: str, tmp_path: Path) -> None:
    check_damaged(READERS[name], tmp_path)

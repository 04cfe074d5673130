"""The pictures of the page, in a headless Chromium: python docs/pictures/make_page.py [viewer] [talk] [BEFORE.bvh]

viewer.jpg shows two takes, talk.webp moves. The voice is of GESTICULATOR_DATA: a LibriVox reading (public domain).
BEFORE.bvh makes beside_a_person.mp4: a recorded person (takes/expressive there), what earlier weights or code made of
the first 14 s of that sound (seed 0), and what is made of it now. All three have the lips of the last, so that only the
gestures differ.
"""

import base64
import io
import os
import re
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import FINGERED, FINGERS, SIDES, facing, to_character
from data_module.speech.audio import load_speech
from data_module.types import Motion, Skeleton
from eval.clip.foreign import read_motion
from gesticulator import Gesticulator
from gesticulator.export import film
from gesticulator.export.html import write_comparison, write_preview

PICTURES = Path(__file__).resolve().parent
sys.path.insert(0, str(PICTURES.parents[1] / "tests"))
DATA = Path(os.environ["GESTICULATOR_DATA"])
SPEECH, FPS, COUNT = DATA / "speech" / "en_austen_0870.flac", 12, 84
PERSON, SECONDS, REPEATED = DATA / "takes" / "expressive", 14, 2
"""The recorded take, how much of it is shown, and how many frames of the film a picture of it lasts."""
LEFT, UP, AHEAD = np.eye(3)
REST = {"Hips|Spine|Chest|Neck|Head_": (-UP, AHEAD), "LeftShoulder|LeftArm": (-LEFT, AHEAD),
        "LeftHandWrist": (-LEFT, -UP), "RightShoulder|RightArm": (-LEFT, -AHEAD), "RightHandWrist": (-LEFT, UP)}
"""Where the X and Y axes of the take's joints point in a T-pose, by the beginning of their names."""
FONT = ImageFont.load_default(24)
HALL = (320, 400)
"""Pixels across and down for each of the three of the film."""
STAGE_AND_TIMELINE = """() => {
    for (const part of ["#top", "#inspector", ".views", ".bar"]) document.querySelector(part).hidden = true;
    document.querySelector("main").style.gridTemplate = '"stage" minmax(0, 1fr) "desk" auto / minmax(0, 1fr)';
    Object.assign(preview.stage.goal, { yaw: 0.3, pitch: 0.05, distance: 3.1, x: 0, y: 1.18, z: 0 });
    preview.stage.view = { ...preview.stage.goal }; }"""
STAGE = """() => { document.querySelector("#desk").hidden = true; document.querySelector("#trails").click(); }"""
PICTURE = """(seconds) => { preview.stage.draw(seconds); return preview.stage.canvas.toDataURL(); }"""


def recorded(path):
    """The motion of the recorded person on our skeleton. The take holds no rest pose, so its T-pose is put together:
    from `REST`, fingers straight, and joints that never move as they are."""
    with np.load(path) as take:
        names, parents = [name.removesuffix("jnt") for name in take["joints"]], tuple(take["parents"].tolist())
        turns, places, fps = take["rotation_wxyz"].astype(float), take["translation"].astype(float), float(take["fps"])
    rest = np.where(np.ptp(turns, axis=0).max(-1, keepdims=True) < 1e-3, turns[0], (1.0, 0.0, 0.0, 0.0))
    for joint, (name, parent) in enumerate(zip(names, parents, strict=True)):
        axes = next((axes for start, axes in REST.items() if re.match(start, name)), None)
        rest[joint] = rotation.from_axes((LEFT, UP), *axes) if axes else rotation.multiply(rest[parent], rest[joint])
    skeleton = Skeleton(tuple(names), parents, rotation.rotate(rest[list(parents)], places[0]))
    world = rotation.multiply(kinematics.chained(parents, turns), rotation.conjugate(rest))
    table = dict(zip(("Hips", "Spine", "Spine1", "Spine2", "Spine3", "Neck", "Head"),
                     ("Hips", "SpineLower", "SpineMiddle", "SpineUpper", "Chest", "Neck", "Head"), strict=True))
    for side in SIDES:
        table |= {side + ours: side + theirs for ours, theirs in (
            ("Shoulder", "Shoulder"), ("Arm", "ArmUpper"), ("ForeArm", "ArmLower"), ("Hand", "HandWrist"))}
        for finger in FINGERS:
            parts = ("Meta", "Proximal", "Distal") if finger == "Thumb" else ("Proximal", "Intermediate", "Distal")
            table |= {f"{side}Hand{finger}{place}": f"{side}Hand{finger}{part}" for place, part in enumerate(parts, 1)}
    motion = Motion(skeleton, kinematics.local_rotations(skeleton, world), places[:, 0], fps)
    return facing(to_character(motion, {ours: names.index(theirs + "_") for ours, theirs in table.items()}, FINGERED))


def write_film(browser, folder, system, before):
    from browser import OpenedPage
    def side_by_side(number):
        picture = Image.new("RGB", size, film.PAPER)
        for left, (name, opened) in zip(range(0, size[0], HALL[0]), pages.items(), strict=True):
            drawn = opened.page.evaluate(PICTURE, number / film.FPS).partition(",")[2]
            drawn = Image.open(io.BytesIO(base64.b64decode(drawn)))
            picture.paste(drawn, (left, 0), drawn)
            ImageDraw.Draw(picture).text((left + HALL[0] / 2, HALL[1] - 22), name, "white", FONT, "mm", stroke_width=3,
                                         stroke_fill="#262a31")
        return picture
    sound = load_speech(PERSON / "take.flac")
    now = system(replace(sound, samples=sound.samples[:SECONDS * sound.sample_rate]), face="lips").scene()
    motions = {"a person": recorded(PERSON / "take.npz"), "before": read_motion(before, fingers=True),
               "now": now.motion}
    pages = {}
    for name, motion in motions.items():
        address = write_preview(folder / "take.html", replace(now, motion=motion)).as_uri()
        pages[name] = opened = OpenedPage(browser, address, *HALL)
        opened.page.evaluate(STAGE_AND_TIMELINE)
        opened.page.evaluate(STAGE)
    size, frames = (HALL[0] * len(pages), HALL[1]), SECONDS * film.FPS
    drawn = (picture for number in range(0, frames, REPEATED) for picture in [side_by_side(number)] * REPEATED)
    film.write_pictures(PICTURES / "beside_a_person.mp4", drawn, film.sound_track(now.speech, frames), size)


def main(names, folder):
    from browser import PATIENCE, OpenedPage, chromium
    def shot(opened, seconds):
        opened.go_to(seconds)
        return Image.open(io.BytesIO(opened.page.screenshot(timeout=PATIENCE))).convert("RGB")
    system = Gesticulator.from_pretrained()
    takes = {name: system(SPEECH, text=SPEECH.with_suffix(".txt"), face="full", interpreter=name).scene()
             for name in ("lstm", "cql") if {"viewer", "talk"} & {*names}}
    with chromium() as browser:
        for before in (name for name in names if name.endswith(".bvh")):
            write_film(browser, folder, system, Path(before))
        if "viewer" in names:
            opened = OpenedPage(browser, write_comparison(folder / "speech.html", takes).as_uri(), 1440, 900)
            opened.page.evaluate("() => preview.session.select(9, 11)")
            shot(opened, 3.6).save(PICTURES / "viewer.jpg", quality=82)
        if "talk" in names:
            opened = OpenedPage(browser, write_preview(folder / "speech.html", takes["lstm"]).as_uri(), 720, 600)
            opened.page.evaluate(STAGE_AND_TIMELINE)
            first, *others = [shot(opened, number / FPS) for number in range(COUNT)]
            first.save(PICTURES / "talk.webp", save_all=True, append_images=others, duration=83, loop=0, quality=62)


if __name__ == "__main__":
    with TemporaryDirectory() as temporary:
        main(sys.argv[1:] or ["viewer", "talk"], Path(temporary))

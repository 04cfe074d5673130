"""The preview page in a real browser: it loads, plays, edits, saves, and swaps the character."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import OpenedPage
from gltf_reader import GlbFile, save
from performances import perform, write
from scipy.spatial.transform import Rotation
from small_characters import write_character

from data_module.motion import kinematics
from data_module.motion.skeletons import standing
from gesticulator.export import html
from gesticulator.export.clip import ClipLayout
from gesticulator.export.vrma import vrm_animation

SECONDS = 4.0


@pytest.fixture(scope="module")
def shown(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[OpenedPage]:
    path = write(tmp_path_factory.mktemp("preview") / "talk.html", perform(seconds=SECONDS))
    page = OpenedPage(browser, path.as_uri())
    yield page
    page.page.close()


@pytest.fixture
def opened(shown: OpenedPage) -> Iterator[OpenedPage]:
    """The page at the start of the recording, with nothing focused and nothing edited."""
    shown.page.evaluate("""() => {
        document.activeElement.blur();
        const { clock, session } = preview;
        document.getElementById("own-figure").click();
        clock.pause(); clock.setRange(null); clock.seek(0);
        while (session.lane.history.past.length) session.undo();
        session.select(null);
    }""")
    shown.settle(0.0)
    yield shown
    shown.check_quiet()


def test_playing_moves_time_and_figure_and_stays_in_its_range(opened: OpenedPage) -> None:
    page = opened.page
    before = np.array(opened.joints())
    page.keyboard.press("Space")
    page.wait_for_function("() => preview.clock.time > 0.6")
    page.keyboard.press("Space")
    stopped = page.evaluate("preview.clock.time")
    opened.settle(stopped)
    assert np.abs(np.array(opened.joints()) - before).max() > 0.01
    assert len([url for url in opened.requests if url.startswith("file:")]) == 1
    # From I to O: played to the end of it, and with L from its start again.
    opened.go_to(1.0)
    page.keyboard.press("i")
    opened.go_to(1.4)
    page.keyboard.press("o")
    assert page.evaluate("preview.clock.range") == pytest.approx([1.0, 1.4], abs=0.02)
    page.keyboard.press("Space")
    page.wait_for_function("() => !preview.clock.playing")
    opened.settle(1.4, near=0.05)
    page.keyboard.press("l")
    page.keyboard.press("Space")
    page.wait_for_function("() => preview.clock.playing && preview.clock.time > 1.1 && preview.clock.time < 1.3")
    page.wait_for_function("() => { const t = preview.clock.time, b = window.last; window.last = t; return t < b; }")
    assert 0.9 < page.evaluate("preview.clock.time") < 1.45
    page.keyboard.press("Space")
    page.keyboard.press("l")
    page.keyboard.press("x")
    assert page.evaluate("preview.clock.range") is None


def test_figure_stands_where_kinematics_says(opened: OpenedPage) -> None:
    """The page's scene graph and our forward kinematics agree on every joint of a frame reached by the arrow keys."""
    motion = standing(perform(seconds=SECONDS).motion)
    for _ in range(10):
        opened.page.keyboard.press("ArrowRight")
    opened.settle(10 / motion.fps, near=0.003)
    assert "frame 10" in opened.page.inner_text("#clock")
    np.testing.assert_allclose(opened.joints(), kinematics.positions_of(motion)[10], atol=4e-3)
    opened.page.keyboard.press("ArrowLeft")
    opened.settle(9 / motion.fps, near=0.003)


def test_buttons_and_keys(opened: OpenedPage) -> None:
    page = opened.page
    page.keyboard.press("End")
    opened.settle(SECONDS)
    page.keyboard.press("Home")
    opened.settle(0.0)
    page.click("[data-view=side]")
    page.wait_for_function("() => Math.abs(preview.stage.view.yaw - Math.PI / 2) < 0.01")
    page.click("#trails")
    assert page.get_attribute("#trails", "aria-pressed") == "false"
    page.select_option("#speed", "0.25")
    assert page.evaluate("preview.clock.sound.playbackRate") == 0.25
    page.select_option("#speed", "1")
    page.click("#mute")
    assert page.evaluate("preview.clock.sound.muted") is True
    page.click("#mute")
    page.keyboard.press("Space")  # plays, and does not press the button again
    page.wait_for_function("() => preview.clock.playing")
    assert page.evaluate("preview.clock.sound.muted") is False
    page.keyboard.press("Space")
    page.click("#file-menu summary")
    assert page.is_visible("#export-vrma")
    for width in (1280, 1440, 1920, 390, 800):
        page.set_viewport_size({"width": width, "height": 560})
        for part in ("#file-menu > div", "#save-plan", "#export-glb", "#help"):
            box = page.locator(part).bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= width, f"{part} at {width}"
    page.click("#facts")
    assert page.is_hidden("#export-vrma")
    assert page.text_content("#score-is") == "score: log-probability"
    page.click("#help")
    assert "side by side" in page.inner_text("#sheet")
    page.keyboard.press("Escape")
    unnamed = page.evaluate("""() => [...document.querySelectorAll('button, input, select')].filter((b) => !(
        b.hidden || b.getAttribute('aria-label') || b.labels?.length || b.textContent.trim())).length""")
    assert unnamed == 0
    # A recording that fits shows whole: the middle of the timeline is the middle of the sound.
    box = page.locator("#timeline").bounding_box()
    page.mouse.move(box["x"] + 5, box["y"] + 70)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 70, steps=3)
    page.mouse.up()
    opened.settle(SECONDS / 2)


def test_a_plan_is_edited_saved_and_opened(opened: OpenedPage, tmp_path: Path) -> None:
    page, first = opened.page, opened.plan()
    row = {name: page.evaluate(f"preview.timeline.rows.{name}.top + 9") for name in ("beats", "blocks")}
    box = page.locator("#timeline").bounding_box()

    def at(time: float, row: float) -> tuple[float, float]:
        return box["x"] + time / SECONDS * box["width"], box["y"] + row

    blocks = first["blocks"]
    # Block 2 gets the second of its alternatives, block 3 a silence, mirrored and a little larger.
    page.mouse.click(*at((blocks[2]["start"] + blocks[2]["end"]) / 2, row["blocks"]))
    page.keyboard.press("2")
    page.mouse.click(*at((blocks[3]["start"] + blocks[3]["end"]) / 2, row["blocks"]))
    was_silent = blocks[3]["silent"]
    for key in "hm]":
        page.keyboard.press(key)
    # The beat between blocks 5 and 6 is dragged, the one between 7 and 8 deleted.
    span = blocks[5]["end"] - blocks[5]["start"]
    page.mouse.move(*at(blocks[6]["start"], row["beats"]))
    page.mouse.down()
    page.mouse.move(*at(blocks[6]["start"] - span / 4, row["beats"]), steps=3)
    page.mouse.move(*at(blocks[6]["start"] - span / 3, row["beats"]), steps=3)
    page.mouse.up()
    page.mouse.click(*at(blocks[8]["start"], row["beats"]))
    page.keyboard.press("Delete")
    edited = opened.plan()
    new = edited["blocks"]
    second = blocks[2]["alternatives"][1]
    assert new[2] == {**blocks[2], "lexeme": second["lexeme"], "silent": False, "name": None,
                      "score": second["score"], "rank": None}
    assert new[3] == {**blocks[3], "silent": not was_silent, "mirror": True, "intensity": 1.1}
    moved = new[5]["end"]
    assert moved == pytest.approx(max(blocks[6]["start"] - span / 3, blocks[5]["start"] + 0.1), abs=0.02)
    assert new[5] == {**blocks[5], "end": moved, "flag": "edited"} and new[6] == {**blocks[6], "start": moved}
    assert new[7] == {**blocks[7], "end": blocks[8]["end"], "flag": blocks[8]["flag"]}
    untouched = [k for k in range(len(blocks)) if k not in (2, 3, 5, 6, 7, 8)]
    assert [new[k if k < 8 else k - 1] for k in untouched] == [blocks[k] for k in untouched]
    assert "5 edits" in page.inner_text("#status")
    # What is saved is that; each step goes back and forth; what was saved can be opened.
    plan = tmp_path / "talk.plan.json"
    plan.write_bytes(opened.saved("Control+s").read_bytes())
    assert json.loads(plan.read_text()) == edited
    for _ in range(6):  # a drag is one step
        page.keyboard.press("Control+z")
    assert opened.plan() == first and page.is_disabled("#undo")
    for _ in range(6):
        page.keyboard.press("Control+Shift+z")
    assert opened.plan() == edited and page.is_disabled("#redo")
    page.evaluate("() => { while (preview.session.lane.history.past.length) preview.session.undo(); }")
    page.set_input_files("#pick-plan", str(plan))
    page.wait_for_function("() => preview.session.lane.history.past.length === 1")
    assert opened.plan() == edited
    for text, said in (('{"blocks": [}', "no JSON"),
                       ('{"blocks": [{"start": 0, "end": 9, "lexeme": 1}]}', "another recording")):
        (tmp_path / "wrong.json").write_text(text)
        page.set_input_files("#pick-plan", str(tmp_path / "wrong.json"))
        page.wait_for_function("(said) => document.getElementById('notice').textContent.includes(said)", arg=said)
    assert opened.plan() == edited
    page.click("#notice")


BREAKS_OUT = "</script><img src=x onerror=broken=1>"


def test_gestures_are_asked_for_and_names_are_text(browser: Any, tmp_path: Path) -> None:
    made = perform(seconds=SECONDS).labelled(BREAKS_OUT)
    made = replace(made, decided=replace(made.decided, score_is=BREAKS_OUT, speaker=BREAKS_OUT, interpreter=BREAKS_OUT))
    takes = {BREAKS_OUT: made.scene(), "b": made.scene()}
    (tmp_path / "talk.html").write_text(html.page(takes, BREAKS_OUT, together=True))
    page = OpenedPage(browser, (tmp_path / "talk.html").as_uri())
    assert page.page.inner_text("h1") == page.page.locator("#labels span").first.inner_text() == BREAKS_OUT
    page.page.keyboard.press("d")
    page.page.evaluate("""() => {
        const { session } = preview;
        session.lane.history.refine({ ...session.plan, knobs: {}, gestures: [{ name: "wave" }, { name: "shrug" }],
            lexicon: [{ lexeme: 7, name: "<b>low sweep</b>", silent: false }] });
        session.tell("edited");
    }""")
    # A plan told in more detail: what can be asked for is listed when it is first shown.
    page.page.evaluate("() => { delete preview.inspector.names; preview.session.tell('edited'); }")
    page.go_to(0.6)
    page.page.wait_for_selector("#gesture option:nth-child(2)", state="attached")
    page.page.select_option("#gesture", "shrug")
    page.page.click("#add-cue")
    page.go_to(1.5)
    page.page.click("#add-cue")
    page.page.select_option("#knob-energy", "calm")
    page.page.select_option("#lexeme", "7")
    plan = page.plan()
    assert plan["cues"] == [{"gesture": "shrug", "word": "zwei", "occurrence": 1}, {"gesture": "shrug", "time": 1.5}]
    assert plan["knobs"] == {"energy": "calm"}
    block = next(block for block in plan["blocks"] if block["start"] <= 1.5 < block["end"])
    assert (block["lexeme"], block["name"]) == (7, "<b>low sweep</b>")
    # The card follows the clock, which ticks with the frames that are drawn.
    page.page.wait_for_function("name => document.getElementById('card-name').textContent === name",
                                arg="<b>low sweep</b>")
    page.page.click("#cues li button")
    assert page.plan()["cues"] == [{"gesture": "shrug", "time": 1.5}]
    assert page.saved("Control+s").read_text().count(json.dumps(BREAKS_OUT)) == 4
    assert BREAKS_OUT in page.page.inner_text("#notice")
    assert page.page.locator("img, b").count() == 0 and page.page.evaluate("window.broken === undefined")
    page.check_quiet()
    page.page.close()


def _direction(places: Any) -> np.ndarray:
    """[..., 3] from the first place to the second, of length 1."""
    way = np.array(places[1]) - np.array(places[0])
    return way / np.linalg.norm(way, axis=-1, keepdims=True)


ARMS = [("LeftArm", "LeftForeArm"), ("LeftForeArm", "LeftHand"), ("RightArm", "RightForeArm"),
        ("RightForeArm", "RightHand")]
BONES = {"LeftArm": "leftUpperArm", "LeftForeArm": "leftLowerArm", "LeftHand": "leftHand", "RightArm": "rightUpperArm",
         "RightForeArm": "rightLowerArm", "RightHand": "rightHand"}
PLACES = """async (names) => {
    const { group } = preview.stage.performers[0], character = preview.worn.first, found = {};
    group.updateWorldMatrix(true, true);
    for (const [name, bone] of names) {
        const node = character.vrm ? character.vrm.humanoid.getRawBoneNode(bone) : character.byJoint.get(name);
        found[name] = node.matrixWorld.elements.slice(12, 15);
    }
    return found;
}"""


def _places(file: GlbFile, frame: int = 25) -> dict[str, np.ndarray]:
    """Node -> where its last animation has it in a frame, metres."""
    worlds = file.worlds(len(file.document["animations"]) - 1)
    return dict(zip(file.names(), worlds[frame, :, :3, 3], strict=True))


@pytest.mark.parametrize("kind", ["GLB", "VRM 1.0", "VRM 0.x"])
def test_a_character_of_the_users_makes_the_gestures(opened: OpenedPage, tmp_path: Path, kind: str) -> None:
    page, motion = opened.page, standing(perform(seconds=SECONDS).motion)
    rig = tmp_path / ("rig.vrm" if "VRM" in kind else "rig.glb")
    write_character(rig, vrm=kind.removeprefix("VRM ") if "VRM" in kind else "")
    (tmp_path / "x.glb").write_bytes(b"<b>")
    page.set_input_files("#pick-character", str(tmp_path / "x.glb"))
    page.wait_for_function("() => document.getElementById('notice').textContent.includes('no GLB')")
    page.set_input_files("#pick-character", str(rig))
    page.wait_for_function("() => preview.stage.performers[0].character !== null")
    assert page.inner_text("#notice") == f"{rig.name}: a character of kind {kind}."
    opened.go_to(1.0)
    page.evaluate("() => preview.stage.draw(1.0)")
    places = page.evaluate(PLACES, list(BONES.items()))
    truth = dict(zip(motion.skeleton.names, kinematics.positions_of(motion)[25], strict=True))
    for a, b in ARMS:
        straight = _direction((places[a], places[b])) @ _direction((truth[a], truth[b]))
        assert straight > 0.999, f"{a} points {np.degrees(np.arccos(straight)):.1f} degrees elsewhere"
    # Her own file with one animation more: what it holds besides is as it was.
    made = tmp_path / "made.glb"
    made.write_bytes(opened.saved("#export-glb").read_bytes())
    before, after = (GlbFile.parse(path.read_bytes()) for path in (rig, made))
    assert [a["name"] for a in after.document["animations"]][-1] == "gesture"
    assert np.abs(after.worlds() - before.worlds()).max() < 1e-5
    for part in ("nodes", "meshes", "skins", "materials", "images", "extensions", "asset"):
        assert after.document.get(part) == before.document.get(part), part
    played = _places(after)
    names = {joint: next(name for name in played if name.endswith(joint)) for joint in BONES}
    faces = Rotation.from_euler("Y", 180 if kind == "VRM 0.x" else 0, degrees=True)
    for a, b in ARMS:
        assert _direction((played[names[a]], played[names[b]])) @ faces.apply(_direction((truth[a], truth[b]))) > 0.999
    page.evaluate("() => document.getElementById('own-figure').click()")
    page.wait_for_function("() => preview.stage.performers[0].character === null")


def _in_a_stride(path: Path) -> Path:
    """The character with a frame of a stride as its rest pose; its skin stays bound in the T-pose."""
    file = GlbFile.parse(path.read_bytes())
    nodes = {node.get("name", "").removeprefix("mixamorig:"): node for node in file.document["nodes"]}
    axes = dict(zip(file.names(), file.worlds()[0, :, :3, :3] / 0.01, strict=True))  # of joints in centimetres
    # The pelvis leans and twists, the chest turns back, the legs and arms swing.
    for name, turn in {"Hips": [8, 12, 3], "Spine2": [4, -15, -3], "LeftUpLeg": [-30, 0, 0], "RightUpLeg": [25, 0, 0],
                       "LeftArm": [20, 0, 0], "RightArm": [-20, 0, 0]}.items():
        own = Rotation.from_matrix(axes[f"mixamorig:{name}"])
        local = own.inv() * Rotation.from_euler("XYZ", turn, degrees=True) * own
        nodes[name]["rotation"] = (Rotation.from_quat(nodes[name]["rotation"]) * local).as_quat().tolist()
    return save(path, file.document, file.binary)


def test_a_character_that_rests_in_a_stride_stands_upright(opened: OpenedPage, tmp_path: Path) -> None:
    """The page makes the same poses of a character, whatever pose its file rests in: taken for upright, that pose makes
    the trunk lean by 12.2 degrees."""
    page, trunks = opened.page, {}
    names = [[name, ""] for name in ("Hips", "Neck", "Head", "LeftArm", "RightArm", "LeftUpLeg", "RightUpLeg")]
    for name, rig in (("still.glb", write_character(tmp_path / "still.glb")),
                      ("stride.glb", _in_a_stride(write_character(tmp_path / "stride.glb")))):
        page.set_input_files("#pick-character", str(rig))
        page.wait_for_function("(name) => preview.stage.performers[0].character?.name === name", arg=name)
        opened.go_to(1.0)
        page.evaluate("() => preview.stage.draw(1.0)")
        trunks[name] = page.evaluate(PLACES, names)
    for a, b in (("Hips", "Neck"), ("Neck", "Head"), ("RightArm", "LeftArm"), ("RightUpLeg", "LeftUpLeg")):
        straight, leaning = (_direction((trunks[name][a], trunks[name][b])) for name in trunks)
        lean = np.degrees(np.arccos(np.clip(straight @ leaning, -1.0, 1.0)))
        assert lean < 0.5, f"{a} to {b} leans by {lean:.1f} degrees"


def test_motion_is_saved_as_vrma_and_glb(opened: OpenedPage, tmp_path: Path) -> None:
    motion = standing(perform(seconds=SECONDS).motion)
    ours, theirs, figure = tmp_path / "ours.vrma", tmp_path / "page.vrma", tmp_path / "figure.glb"
    ours.write_bytes(vrm_animation(motion, ClipLayout(keys=0.0)))
    theirs.write_bytes(opened.saved("#export-vrma").read_bytes())
    a, b = (GlbFile.parse(path.read_bytes()) for path in (ours, theirs))
    told, made = (file.document["extensions"]["VRMC_vrm_animation"] for file in (a, b))
    assert made["specVersion"] == "1.0"
    assert made["humanoid"]["humanBones"].keys() == told["humanoid"]["humanBones"].keys()
    for frame in (0, 25, 99):
        mine, made = _places(a, frame), _places(b, frame)
        assert mine.keys() == made.keys()
        assert max(np.abs(mine[bone] - made[bone]).max() for bone in mine) < 2e-3
    figure.write_bytes(opened.saved("#export-glb").read_bytes())
    file, truth = GlbFile.parse(figure.read_bytes()), kinematics.positions_of(motion)[25]
    indices = {part["indices"] for mesh in file.document["meshes"] for part in mesh["primitives"]}
    fine = sum(file.document["accessors"][number]["count"] // 3 for number in indices)
    drawn = opened.page.evaluate("() => preview.stage.renderer.info.render.triangles")
    assert drawn < 40_000, "plain where the processor draws, and twice, with the shadow"
    assert fine > 1.2 * drawn, "fine in files"
    played, rest = _places(file), dict(zip(file.names(), file.worlds()[0, :, :3, 3], strict=True))
    for name, place in zip(motion.skeleton.names, truth, strict=True):
        assert np.abs(played[name] - place).max() < 3e-3
    assert np.abs(_direction((rest["LeftArm"], rest["LeftHand"])) - [1, 0, 0]).max() < 1e-5, "at rest in a T-pose"
    # What the page wrote is a character that the page takes, and makes the same gestures.
    opened.page.set_input_files("#pick-character", str(figure))
    opened.page.wait_for_function("() => preview.stage.performers[0].character !== null")
    opened.go_to(1.0)
    opened.page.evaluate("() => preview.stage.draw(1.0)")
    places = opened.page.evaluate(PLACES, list(BONES.items()))
    at = dict(zip(motion.skeleton.names, truth, strict=True))
    assert max(np.abs(places[name] - at[name]).max() for name in BONES) < 5e-3


SEEN = """([view, bones]) => {
    const { stage } = preview, { byJoint } = stage.performers[0].character, at = stage.camera.position.clone();
    stage.look(view); stage.draw(1.0);
    return bones.map((b) => at.setFromMatrixPosition(byJoint.get(b).matrixWorld).project(stage.camera).toArray()); }"""


def test_the_camera_fits_a_goblin_and_a_giant_in_every_view(opened: OpenedPage, tmp_path: Path) -> None:
    rig, page, seen, views = write_character(tmp_path / "rig.glb"), opened.page, {}, ("front", "side", "close", "reset")
    for scale in (b"[0.01, 0.01, 0.01]", b"[2e-3, 2e-3, 2e-3]", b"[0.09, 0.09, 0.09]"):
        name = f"{len(seen)}.glb"
        (tmp_path / name).write_bytes(rig.read_bytes().replace(b"[0.01, 0.01, 0.01]", scale))
        page.set_input_files("#pick-character", str(tmp_path / name))
        page.wait_for_function("(name) => preview.stage.performers[0].character?.name === name", arg=name)
        for view in views:
            seen[scale, view] = np.array(page.evaluate(SEEN, [view, ["Head", "Hips", "LeftHand", "LeftFoot"]]))[:, :2]
    for (scale, view), places in seen.items():
        np.testing.assert_allclose(places, seen[b"[0.01, 0.01, 0.01]", view], atol=0.02, err_msg=f"{scale!r}, {view}")
        assert view == "close" or np.abs(places[0]).max() < 0.9, "the head is in sight"

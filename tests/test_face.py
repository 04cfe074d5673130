"""The face: visemes of phones, lips from sound, blinks, brows and gaze, and the shapes of characters."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from face_samples import at_rest
from hypothesis import given, settings
from hypothesis import strategies as st
from performances import turned
from safetensors.numpy import save

from data_module.errors import InputError
from data_module.motion.skeletons import CHARACTER
from data_module.types import Motion
from gesticulator.face.life import RATE, FaceLife
from gesticulator.face.lips import (
    HIDDEN,
    LOOK_AHEAD,
    REACH,
    SHIPPED,
    STACKED,
    LipFeatures,
    Lips,
    VisemeStepper,
    load_weights,
    with_dominance,
    with_strength,
)
from gesticulator.face.motion import FaceMotion
from gesticulator.face.shapes import ARKIT, arkit, find_shapes, lacking, oculus, vrm
from gesticulator.face.track import FaceTrack, in_head
from gesticulator.face.visemes import CLOSED, OPENINGS, SILENT, VISEMES, of_arpabet, opening
from gesticulator.options import InferenceOptions


def _mouth(name: str, frames: int = 1) -> FaceMotion:
    face = at_rest(frames, 60.0)
    face.visemes[:] = 0.0
    face.visemes[:, VISEMES.index(name)] = 1.0
    return face


# ------------------------------------------------------------------------------------------------------------ visemes

@pytest.mark.parametrize(("phone", "names"), [
    ("M", ("PP",)), ("p", ("PP",)), ("F", ("FF",)), ("TH", ("TH",)), ("CH", ("DD", "CH")), ("AY1", ("aa", "ih")),
    ("ow", ("oh", "ou")), ("UW0", ("ou",)), ("SIL", ())])
def test_phones_have_the_shapes_of_their_sounds(phone: str, names: tuple[str, ...]) -> None:
    assert of_arpabet(phone) == tuple(VISEMES.index(name) for name in names)


def test_lips_meet_in_silence_and_on_p_and_open_widest_on_a() -> None:
    assert OPENINGS[SILENT] == OPENINGS[CLOSED] == 0.0 and VISEMES[int(OPENINGS.argmax())] == "aa"
    assert opening(np.eye(15)).max() == 1.0


# --------------------------------------------------------------------------------------------------------------- lips

def _sound(seconds: float = 1.5) -> np.ndarray:
    rng = np.random.default_rng(0)
    sound = rng.standard_normal(round(16000 * seconds)) * np.repeat(rng.uniform(0, 0.2, round(50 * seconds)), 320)
    return sound.astype(np.float32)


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(0, 5000), max_size=12))
def test_pieces_of_any_size_give_the_same_mouth(sizes: list[int]) -> None:
    sound, whole, parts = _sound(0.6), Lips(), Lips()
    whole.feed(sound)
    whole.finish()
    at = 0
    for size in sizes:
        parts.feed(sound[at:at + size])
        at += size
    parts.feed(sound[at:])
    parts.finish()
    times = np.arange(30) / 60
    assert np.array_equal(whole.weights, parts.weights) and np.array_equal(whole.at(times), parts.at(times))


def test_the_network_waits_for_80_ms_of_sound_and_no_more() -> None:
    assert LOOK_AHEAD <= 0.08 and REACH < 0.25
    sound = _sound()
    frames = np.array(LipFeatures().feed(sound))
    later = sound.copy()
    later[round(0.5 * 16000):] = 0.0
    other = np.array(LipFeatures().feed(later))
    changed = np.flatnonzero((frames != other).any(axis=1))
    assert (changed[0] + 0.5) / 50 > 0.5 - LOOK_AHEAD - 0.02
    assert len(frames) / 50 >= len(sound) / 16000 - LOOK_AHEAD - 0.02


def test_dominance_shuts_lips_that_might_be_open() -> None:
    weights = np.zeros(15)
    weights[CLOSED], weights[VISEMES.index("aa")] = 0.5, 0.5
    assert opening(with_dominance(weights)) < 0.12
    assert with_dominance(np.eye(15)) == pytest.approx(np.eye(15))


@pytest.mark.parametrize(("mouth", "expected"), [(0.0, 0.0), (0.5, 0.3), (1.0, 0.6), (2.0, 1.0)])
def test_the_mouth_knob_scales_the_opening(mouth: float, expected: float) -> None:
    visemes = np.zeros((1, 15))
    visemes[0, VISEMES.index("aa")], visemes[0, SILENT] = 0.6, 0.4
    strong = with_strength(visemes, mouth)
    assert opening(strong)[0] == pytest.approx(expected) and strong[0, SILENT] == pytest.approx(1 - expected)


def test_silence_and_steady_noise_shut_the_mouth() -> None:
    rng = np.random.default_rng(1)
    for sound in (np.zeros(32000, np.float32), (0.003 * rng.standard_normal(48000)).astype(np.float32)):
        lips = Lips()
        lips.feed(sound)
        lips.finish()
        assert opening(lips.rows(20, len(sound) // 320 - 5)).max() < 0.05


def test_the_network_in_numpy_is_torchs() -> None:
    weights = {name: torch.from_numpy(value) for name, value in load_weights().items()}
    memory = torch.nn.GRU(HIDDEN, HIDDEN, batch_first=True)
    memory.load_state_dict({name.removeprefix("memory."): value for name, value in weights.items() if "memory" in name})
    frames = weights["mean"] + weights["deviation"] * torch.randn(12, STACKED, generator=torch.manual_seed(0))
    with torch.inference_mode():
        enter = torch.nn.functional.linear((frames - weights["mean"]) / weights["deviation"], weights["enter.weight"],
                                           weights["enter.bias"]).relu()
        both = torch.cat([enter, memory(enter[None])[0][0]], dim=-1)
        expected = torch.nn.functional.linear(both, weights["leave.weight"], weights["leave.bias"]).softmax(-1)
    step = VisemeStepper(load_weights())
    np.testing.assert_allclose(np.array([step(frame) for frame in frames.numpy()]), expected.numpy(), atol=2e-5)


def test_weights_are_small_and_are_what_their_record_says(tmp_path: Path) -> None:
    record = json.loads((SHIPPED / "face.json").read_text())
    data = (SHIPPED / "visemes.safetensors").read_bytes()
    assert len(data) < 2_000_000 and hashlib.sha256(data).hexdigest() == record["sha256"]["visemes.safetensors"]
    folder = tmp_path / "face"
    shutil.copytree(SHIPPED, folder)
    (folder / "visemes.safetensors").write_bytes(data[:-1] + b"x")
    with pytest.raises(InputError, match="not the file"):
        load_weights(folder)
    (folder / "visemes.safetensors").unlink()
    with pytest.raises(InputError, match="does not exist"):
        load_weights(folder)


def test_weights_of_another_shape_or_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    weights = {**load_weights(), "leave.weight": load_weights()["leave.weight"][:-1]}
    with pytest.raises(InputError, match=r"leave\.weight: \(14, 224\) instead of \(15, 224\)"):
        VisemeStepper(weights)
    data = save({**load_weights(), "leave.bias": np.full(15, np.nan, np.float32)})
    (tmp_path / "visemes.safetensors").write_bytes(data)
    record = json.loads((SHIPPED / "face.json").read_text())
    record["sha256"]["visemes.safetensors"] = hashlib.sha256(data).hexdigest()
    (tmp_path / "face.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="not finite numbers"):
        load_weights(tmp_path)


# -------------------------------------------------------------------------------------------------- lids, brows, eyes

def _run(seconds: float, seed: int, state: str = "speaking", silent: float = 0.0) -> np.ndarray:
    life = FaceLife(seed)
    return np.array([life.step(state, silent) for _ in range(round(seconds * RATE))])


def test_people_blink_about_17_times_a_minute_at_irregular_intervals() -> None:
    lids = _run(120, 3)[:, 0]
    starts = np.flatnonzero((lids[1:] > 0.5) & (lids[:-1] <= 0.5)) / RATE
    gaps = np.diff(starts)
    assert 20 <= len(starts) <= 48 and gaps.std() > 0.5 and gaps.min() >= 0.68
    assert lids.max() > 0.99 and lids.min() >= 0.0


def test_phrases_end_with_blinks_more_often_than_not() -> None:
    followed = 0
    for seed in range(30):
        life = FaceLife(seed)
        rows = [life.step("speaking", 0.0 if step < 60 else 1.0)[0] for step in range(110)]
        followed += max(rows[75:100]) > 0.9
    assert followed >= 15


def test_gaze_by_state() -> None:
    listening, thinking = _run(6, 1, "listening", 1.0)[:, 2:], _run(6, 1, "thinking left", 1.0)[20:, 2:]
    assert np.degrees(np.abs(listening)).max() < 2.5
    assert np.degrees(thinking[:, 0]).min() > 5 and np.degrees(thinking[:, 1]).min() > 4
    assert np.degrees(_run(6, 1, "thinking right", 1.0)[20:, 2]).max() < -5


def test_a_phrase_ends_with_the_eyes_on_the_other() -> None:
    away = 0
    for seed in range(8):
        life = FaceLife(seed)
        rows = np.array([life.step("speaking", 0.0 if step < 200 else 1.0)[2:] for step in range(260)])
        assert np.degrees(np.abs(rows[225:])).max() < 2.5
        away += np.degrees(np.abs(rows[:200])).max() > 5
    assert away >= 4


def test_brows_rise_on_some_beats_and_only_after_them() -> None:
    raised = 0
    for beat in range(60):
        life = FaceLife(beat)
        life.accent(0.5)
        brows = np.array([life.step("speaking", 0.0)[1] for _ in range(80)])
        assert not brows[:26].any()
        raised += brows.max() > 0.9
    assert 10 <= raised <= 35


def _head(degrees: float, frames: int = 5) -> Motion:
    return turned(CHARACTER, frames, Head=np.array([0.0, np.radians(degrees), 0.0]))


def test_eyes_hold_their_target_while_the_head_turns() -> None:
    assert in_head(np.zeros((5, 2)), _head(0.0)) == pytest.approx(0.0)
    eyes = np.degrees(in_head(np.zeros((5, 2)), _head(10.0)))
    assert eyes[:, 0] == pytest.approx(-10.0, abs=0.6) and eyes[:, 1] == pytest.approx(0.0, abs=1e-6)
    assert np.degrees(np.abs(in_head(np.zeros((5, 2)), _head(80.0)))).max() <= 28.0


def test_lips_alone_leave_the_rest_of_the_face() -> None:
    face = FaceTrack(InferenceOptions(face="lips"))
    shown = face.frames(0, _head(20.0))
    assert shown.lips_only and not shown.blink.any() and not shown.gaze.any()


# ------------------------------------------------------------------------------------------------------------- shapes

def test_mouths_in_the_names_of_the_formats() -> None:
    wide, shut = arkit(_mouth("aa")), arkit(_mouth("PP"))
    assert wide["jawOpen"][0] > 0.5 and shut["jawOpen"][0] == 0.0 and shut["mouthPressLeft"][0] > 0.3
    assert arkit(_mouth("ou"))["mouthPucker"][0] > 0.5
    assert oculus(_mouth("FF"))["viseme_FF"][0] == 1.0
    assert vrm(_mouth("oh"))["oh"][0] == 1.0 and not any(vrm(_mouth("PP"))[name][0] for name in ("aa", "ih", "ou"))
    assert not any(curve.any() for curve in arkit(at_rest(3, 30.0)).values())


def test_eyes_that_look_left_look_out_on_the_left() -> None:
    face = at_rest(1, 60.0)
    face.gaze[:] = np.radians([15.0, -10.0])
    shapes = arkit(face)
    assert shapes["eyeLookOutLeft"][0] == shapes["eyeLookInRight"][0] == pytest.approx(0.5)
    assert shapes["eyeLookDownLeft"][0] > 0.3 and shapes["eyeLookUpLeft"][0] == shapes["eyeLookOutRight"][0] == 0.0


@pytest.mark.parametrize("spell", [lambda name: name, lambda name: name.replace("Left", "_L").replace("Right", "_R"),
                                   lambda name: f"Face.{name[0].upper()}{name[1:]}"])
def test_arkit_is_found_in_the_spellings_of_tools(spell: object) -> None:
    found = find_shapes(spell(name) for name in ARKIT)  # type: ignore[operator]
    assert sorted(curve for curve, _ in found.values()) == sorted(ARKIT)


# Shapes of published rigs and tools, with their own prefixes -> the curves that drive some of them.
PUBLISHED = {
    "Apple's ARKit": ("jawOpen mouthFunnel mouthPucker mouthPress_L eyeBlink_L", "jawOpen mouthFunnel mouthPucker"),
    "Ready Player Me": ("viseme_aa viseme_PP viseme_E viseme_I viseme_O viseme_U eyeBlinkLeft", "viseme_aa viseme_ih"),
    "Wolf3D's first": ("mouthOpen mouthSmile eyesClosed", "opening vrm_blink"),
    "Faceit": ("Face.JawOpen Face.MouthFunnel Face.MouthPucker Face.EyeBlinkLeft", "jawOpen mouthFunnel eyeBlinkLeft"),
    "MetaHuman": ("CTRL_expressions_jawOpen CTRL_expressions_mouthFunnelDL CTRL_expressions_mouthPressL "
                  "CTRL_expressions_mouthLipsPurseUL", "jawOpen mouthFunnel mouthPucker"),
    "Character Creator": ("V_Open V_Explosive V_Dental_Lip V_Tight_O V_Affricate Eye_Blink_L",
                          "viseme_aa viseme_PP viseme_ou eyeBlinkLeft"),
    "Fuse": ("Blink_Left Blink_Right MouthOpen MouthNarrow_Left Smile_Left", "opening mouthPucker eyeBlinkLeft"),
    "VRoid": ("Face.M_F00_000_00_Fcl_MTH_A Face.M_F00_000_00_Fcl_MTH_I Face.M_F00_000_00_Fcl_MTH_U "
              "Face.M_F00_000_00_Fcl_EYE_Close", "vrm_aa vrm_ih vrm_ou vrm_blink"),
    "Unity-chan": ("blendShape1.MTH_A blendShape1.MTH_I blendShape1.MTH_U blendShape3.EYE_DEF_C", "vrm_aa vrm_blink"),
    "VRChat": ("vrc.v_pp vrc.v_ff vrc.v_th vrc.v_aa vrc.v_e vrc.v_ih vrc.v_oh vrc.blink_left", "viseme_aa viseme_PP"),
    "Cats": ("vrc.v_aa vrc.v_ch vrc.v_oh Blink", "viseme_aa viseme_CH viseme_oh vrm_blink"),
    "MikuMikuDance": ("あ い う え お まばたき", "vrm_aa vrm_ih vrm_ou vrm_ee vrm_oh vrm_blink"),
    "VRM": ("aa ih ou ee oh blink", "vrm_aa vrm_ih vrm_ou vrm_ee vrm_oh vrm_blink"),
    "Rocketbox": ("blendShape1.AA_VI_01_PP blendShape1.AA_VI_02_FF blendShape1.AA_VI_03_TH blendShape1.AA_VI_10_aa",
                  "viseme_PP viseme_FF viseme_TH viseme_aa"),
    "Genesis 8, FACS": ("Genesis8Female__facs_jnt_JawOpen Genesis8Female__facs_bs_MouthFunnel "
                        "Genesis8Female__facs_bs_MouthPucker", "jawOpen mouthFunnel mouthPucker"),
    "Genesis 8": ("head__eCTRLvAA head__eCTRLvEE head__eCTRLvOW head__eCTRLvUW head__eCTRLvM head__eCTRLvF "
                  "head__eCTRLvW head__eCTRLvK", "viseme_aa viseme_ih viseme_oh viseme_ou viseme_PP viseme_FF"),
    "Sumerian": ("face_shapes.ca_jawOpen face_shapes.ai_aa face_shapes.ai_oh face_shapes.ai_ee", "vrm_aa vrm_oh"),
    "Polly": ("h_visemes.aa h_visemes.E h_visemes.u h_visemes.p h_visemes.f h_visemes.S h_visemes.k",
              "viseme_aa viseme_PP viseme_FF viseme_ou"),
    "Movement": ("jawDrop lipPucker_L lipFunneler_LB lipPressor_L lipSuck_RT lipCornerPuller_L eyesClosed_L",
                 "jawOpen mouthPucker mouthFunnel mouthRollUpper mouthSmileLeft eyeBlinkLeft"),
    "SRanipal": ("Jaw_Open Mouth_Pout Mouth_O_Shape Mouth_Upper_UpLeft Eye_Left_Blink",
                 "jawOpen mouthPucker mouthFunnel mouthUpperUpLeft eyeBlinkLeft"),
    "VRCFaceTracking": ("JawOpen LipPuckerUpperLeft LipFunnelLowerRight EyeClosedLeft",
                        "jawOpen mouthPucker mouthFunnel eyeBlinkLeft"),
    "Manuel Bastioni Lab": ("Expressions_mouthOpen_max Expressions_eyeClosedL_max Expressions_mouthSmile_max",
                            "opening eyeBlinkLeft"),
    "Adobe Character Animator": ("Aah Ee Oh W-Oo M F L S D", "viseme_aa viseme_oh viseme_PP viseme_FF viseme_nn"),
}


@pytest.mark.parametrize("rig", PUBLISHED)
def test_the_shapes_of_published_rigs_are_found(rig: str) -> None:
    names, expected = map(str.split, PUBLISHED[rig])
    assert set(expected) <= {curve for curve, _ in find_shapes(names).values()}


def test_a_mouth_of_some_shapes_of_arkit_uses_them_and_names_the_others() -> None:
    """A smile is known to other tools, too, and does not replace what speech moves."""
    some = find_shapes(["jawOpen", "mouthSmile"])
    assert some["jawOpen"] == ("jawOpen", 1.0)
    assert {"mouthFunnel", "mouthPress"} <= set(lacking(curve for curve, _ in some.values()))
    most = find_shapes(name for name in ARKIT if name != "jawOpen")
    assert {"mouthFunnel", "mouthPucker", "mouthPressLeft", "mouthRollLower"} <= most.keys()
    assert lacking(curve for curve, _ in most.values()) == ["jawOpen"]
    assert lacking(ARKIT) == lacking(["vrm_aa"]) == lacking(["eyeBlinkLeft"]) == []


def test_nothing_is_found_among_other_shapes() -> None:
    assert find_shapes(["Muscular", "hat", "Fat_01", ""]) == {}


def test_a_mood_is_a_smile_in_silence() -> None:
    face = FaceTrack(InferenceOptions(face="full", mood=-1.0)).frames(0, _head(0.0, 180))
    assert np.array_equal(face.smile, np.full(180, -1.0)) and face.brows[0] == pytest.approx(-0.25)
    with pytest.raises(InputError, match="is for a face"):
        InferenceOptions(mood=0.5)

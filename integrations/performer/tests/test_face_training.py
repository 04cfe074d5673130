"""The training of the network of the lips."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from gesticulator_performer.face import training
from gesticulator_performer.face.known_phones import VisemeSpan, labels, of_ipa, spans
from gesticulator_performer.face.training import FaceTraining, LabelledRows, VisemeNet, fit, stacked
from hypothesis import given
from hypothesis import strategies as st

from gesticulator.face.lips import SAMPLE_RATE, STACKED, LipFeatures, VisemeStepper
from gesticulator.face.visemes import SILENT, of_arpabet


def test_a_small_network_learns_which_band_is_loud() -> None:
    rng = np.random.default_rng(0)
    recordings = []
    for _ in range(6):
        kinds = np.repeat(rng.integers(0, 3, 20), 12)
        rows = np.full((480, 33), -12.0, np.float32)
        for frame, kind in enumerate(kinds):
            rows[2 * frame:2 * frame + 2, 10 * kind:10 * kind + 10] = -3.0
        rows[:, 32] = -4.0
        recordings.append(LabelledRows(rows, kinds + 9))
    net = fit(recordings, FaceTraining(epochs=24, batch=4, rate=5e-3))
    one = recordings[0]
    with torch.inference_mode():
        found = net(torch.from_numpy(stacked(one.rows))[None])[0].argmax(-1).numpy()
    assert (found == one.labels).mean() > 0.8


def test_a_longer_pause_is_silence_and_keeps_what_was_before() -> None:
    rng = np.random.default_rng(0)
    visemes = np.concatenate([np.full(30, 10), np.zeros(10, int), np.full(200, 12)])
    piece = LabelledRows(rng.standard_normal((480, 33)).astype(np.float32), visemes)
    longer = training.with_long_pause(piece, np.random.default_rng(1))
    assert len(longer.labels) == 240 and (longer.labels == SILENT).sum() >= 35
    assert np.array_equal(longer.rows[:80], piece.rows[:80])


def test_streamed_features_are_those_of_the_training() -> None:
    sound = np.random.default_rng(1).normal(0.0, 0.05, 2 * SAMPLE_RATE).astype(np.float32)
    streamed, whole = np.array(LipFeatures().feed(sound)), stacked(training.rows_of(sound))
    np.testing.assert_allclose(streamed[5:60], whole[5:60], atol=2e-3)
    assert streamed.shape[1] == STACKED


def test_the_stepper_computes_what_the_network_was_trained_as() -> None:
    torch.manual_seed(0)
    net = VisemeNet().eval()
    net.mean.copy_(torch.randn(STACKED))
    net.deviation.copy_(torch.rand(STACKED) + 0.5)
    frames = torch.randn(12, STACKED)
    with torch.inference_mode():
        expected = torch.softmax(net(frames[None])[0], -1).numpy()
    step = VisemeStepper({name: value.numpy() for name, value in net.state_dict().items()})
    np.testing.assert_allclose(np.array([step(frame) for frame in frames.numpy()]), expected, atol=2e-5)


@pytest.mark.parametrize(("ipa", "arpabet"), [("m", "M"), ("θ", "TH"), ("tʃ", "CH"), ("aɪ", "AY1"), ("ŋ", "NG"),
                                              ("uː", "UW0"), ("ɡ", "g"), ("ɹ", "R"), ("", "SIL")])
def test_both_alphabets_name_the_same_shapes(ipa: str, arpabet: str) -> None:
    assert of_ipa(ipa) == of_arpabet(arpabet)


@given(st.lists(st.sampled_from(range(1, 15)), min_size=1, max_size=3), st.floats(0, 5), st.floats(0.02, 1))
def test_a_phones_shapes_tile_its_time(visemes: list[int], start: float, length: float) -> None:
    parts = spans(visemes, start, start + length)
    assert [part.viseme for part in parts] == visemes
    assert parts[0].start == start and parts[-1].end == pytest.approx(start + length)
    assert all(a.end == b.start for a, b in zip(parts, parts[1:], strict=False))


def test_a_frame_has_the_shape_at_its_middle() -> None:
    track = [VisemeSpan(3, 0.04, 0.1), VisemeSpan(5, 0.1, 0.12)]
    assert labels(track, 8, 50.0).tolist() == [0, 0, 3, 3, 3, 5, 0, 0]

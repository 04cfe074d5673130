"""What a viewer sees of motion as played: decisions read off it, and their agreement with the performer's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_infer import babble

from data_module.speech.audio import as_speech
from eval.renderings import TEST, AcceptanceVoice, BundleSystem, KeptRenderings
from eval.runner.played import PERFORMER, REPLAYED, VoicePlayer
from eval.runner.played_seen import HAND, SIZE, STARTS, agreement, decisions, kappa, seen
from gesticulator.bundle import bundle as bundles


def test_kappa_by_hand() -> None:
    # Of ten blocks eight agree; by chance .5 * .6 + .5 * .4 would.
    first, second = np.array([1] * 5 + [0] * 5), np.array([1, 1, 1, 1, 0, 1, 1, 0, 0, 0])
    agreed = float((first == second).mean())
    chance = 0.5 * 0.6 + 0.5 * 0.4
    assert kappa(first, second) == pytest.approx((agreed - chance) / (1 - chance))
    assert kappa(first, first) == 1.0
    assert np.isnan(kappa(np.zeros(4, np.int64), np.zeros(4, np.int64)))


def test_a_unit_starts_where_hands_act_after_rest() -> None:
    own = np.array([[0, 0, 0, 0], [1, 2, 1, 1], [2, 2, 1, 1], [4, 3, 0, 0], [0, 0, 0, 0], [2, 1, 3, 1]])
    found = seen(own)
    assert found[STARTS].tolist() == [0, 1, 0, 0, 0, 1]
    assert found[HAND].tolist() == [0, 2, 2, 3, 0, 1] and found[SIZE].tolist() == [0, 1, 1, 0, 0, 3]


def test_the_same_motion_agrees_and_another_moment_of_it_does_not(tmp_path: Path) -> None:
    ours = BundleSystem("ours", bundles.SHIPPED, KeptRenderings(None))
    sound = as_speech(babble(24.0), 16000)
    own = ours.perform(AcceptanceVoice("babble", sound, TEST), 0)[0].motion
    made = VoicePlayer(ours, None).play(AcceptanceVoice("babble", sound, TEST, own), 3, (), {})
    motion = made.motions[PERFORMER]
    found = decisions(ours.bundle, made, PERFORMER)
    assert len(found) == len(motion) and len(np.unique(found[:, 0])) > 1, "hands act, and not throughout"
    assert isinstance(made.motions, dict)
    made.motions.update({REPLAYED: motion.clone(), "late": motion.roll(7, 0)})
    same = agreement(ours.bundle, [made], (REPLAYED, "late"))
    assert same[REPLAYED][STARTS].mean == same[REPLAYED][HAND].mean == 1.0
    assert same["late"][HAND].mean < 0.6

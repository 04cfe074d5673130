"""Measurements of one clip of motion beside its speech, shared by the tables of `eval`.

Speeds are those of the wrists as seen from the facing hips, m/s; times are seconds from the clip's begin. The formulas
themselves are the metric chapters'.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_module.motion import bvh, skeletons
from data_module.motion.kinematics import resample
from data_module.motion.motion_beats import motion_beats
from data_module.speech.audio import load_speech
from data_module.speech.onsets import detect_onsets
from data_module.speech.silence import FRAME, pauses, silent_frames
from data_module.types import Array, Motion, Speech
from eval import stats
from eval.metrics import pmb
from eval.metrics.smoothness import hand_speeds

SETTLED = 1.0
"""Seconds of silence after which a frame counts as silent: by then the hands have come to rest."""
TAKE = Path("takes") / "beat_scott"
"""In GESTICULATOR_DATA: a real take, one BVH and one WAV."""
TAKE_FPS = 15.0
"""Frame rate of the take (BEAT states 1/15 s in the file)."""


@dataclass(frozen=True)
class ClipMeasurement:
    """One clip. onsets [m], beats [n]: of the speech and the motion, seconds. hand_speed [T - 1, 2]: m/s; silent
    [T - 1]: frames in a settled silence."""

    onsets: Array
    beats: Array
    duration: float
    hand_speed: Array
    silent: NDArray[np.bool_]

    def rhythm(self) -> tuple[float, float, float]:
        """PMB, its chance level, and its share above that (RG Eq. 22), percent; NaN without motion beats."""
        percent = pmb.pmb(self.beats, self.onsets)
        by_chance = pmb.chance(self.beats, self.onsets, self.duration)
        return percent, by_chance, 100.0 * pmb.above_chance(percent, by_chance)

    @property
    def speech_speed(self) -> float:
        """Mean hand speed outside settled silence, m/s; NaN where there is no such frame."""
        return stats.mean(self.hand_speed[~self.silent])


def measure(motion: Motion, speech: Speech) -> ClipMeasurement:
    """Beats, speeds and silences of a motion of the 16-joint character and its speech."""
    motion = skeletons.upper_body(motion)
    speed = hand_speeds(motion)
    return ClipMeasurement(detect_onsets(speech.samples, speech.sample_rate), motion_beats(motion), speech.duration,
                           speed, _settled(speech, len(speed), motion.fps))


def _settled(speech: Speech, frames: int, fps: float) -> NDArray[np.bool_]:
    """[frames] of motion before which the speech was silent for `SETTLED` seconds."""
    # Pauses as the system detects them.
    quiet = pauses(silent_frames(speech.samples, speech.sample_rate))
    # A frame is settled when the whole second before it was silent: the retraction is then over.
    window = round(SETTLED / FRAME)
    settled = np.convolve(quiet, np.ones(window))[:len(quiet)] >= window - 0.5
    at = np.minimum((np.arange(frames) / fps / FRAME).astype(int), len(settled) - 1)
    return np.asarray(settled[at], dtype=bool)


def real_take(fps: float, own_rig: bool = False) -> tuple[Motion, Speech] | None:
    """The real take that lies in GESTICULATOR_DATA at this frame rate; None without it. It is on our character, or on
    its own rig with its fingers."""
    place = os.environ.get("GESTICULATOR_DATA")
    folder = Path(place) / TAKE if place else None
    if folder is None or not folder.is_dir():
        return None
    with warnings.catch_warnings():
        # The file's header contradicts itself; `TAKE_FPS` is what its authors state.
        warnings.simplefilter("ignore", bvh.BvhWarning)
        motion = bvh.read_bvh(next(iter(sorted(folder.glob("*.bvh")))), fps=TAKE_FPS)
    motion = motion if own_rig else skeletons.to_character(motion)
    return resample(motion, fps), load_speech(next(iter(sorted(folder.glob("*.wav")))))

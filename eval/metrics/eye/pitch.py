"""Pitch and trunk: does the trunk move when the voice rises?

Theory: of all links between sound and motion in three real speakers, one survives the exchange of their sounds: pitch
goes with the speed of the trunk and head, at once. F0 by pYIN at 100 Hz, its logarithm less the mean of the recording,
unvoiced frames left out; trunk speed is the turning speed of the chest; both are smoothed by 0.1 s and taken at 20 Hz.
The figure is Pearson's r over voiced frames, averaged over recordings, the largest at lags of -0.1 to +0.1 s
(`Coupling.best`); `chance` is its distribution when sounds are exchanged among recordings.

Good: .13 at no lag for a real speaker. What fools it: a trunk that moves in speech and rests in pauses gains nothing,
as pauses are unvoiced and left out; but a trunk that follows loudness gains, because loud syllables are often high.

    >>> pitch = np.sin(np.arange(400) / 9.0)
    >>> speed = np.roll(pitch, 2)
    >>> int(LAGS[np.argmax(lagged(pitch, speed))])
    2
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.motion import rotation
from data_module.speech.audio import SAMPLE_RATE, resample
from data_module.types import Array, Speech
from eval.metrics.eye.body import HZ, CommonBody
from eval.metrics.eye.hands import correlation

RATE = 20
"""Frames a second of both tracks."""
LAGS = np.arange(-2, 3)
"""Frames that count as at once: -0.1 to +0.1 s; positive where the trunk is late."""
_PITCH_HZ, _SMOOTHING, _SEED = 100, 0.1, 1
_LOWEST, _HIGHEST = 60.0, 500.0
"""Hertz of voices."""
_FEWEST = 2 * RATE
"""Voiced frames without which a correlation is not defined."""


def pitch_track(speech: Speech) -> Array:
    """[T] at `RATE`: log F0 less its mean over the recording, smoothed over voiced frames; NaN where unvoiced."""
    import librosa

    samples = resample(speech, SAMPLE_RATE).samples
    f0, _, _ = librosa.pyin(samples.astype(np.float32), fmin=_LOWEST, fmax=_HIGHEST, sr=SAMPLE_RATE,
                            hop_length=SAMPLE_RATE // _PITCH_HZ, frame_length=1024)
    voiced = np.isfinite(f0)
    logs = np.log(np.where(voiced, f0, 1.0))
    # Unvoiced frames are set to the mean, 0, and the weight below takes them out of the smoothing again.
    logs = np.where(voiced, logs - (logs[voiced].mean() if voiced.any() else 0.0), 0.0)
    width = _SMOOTHING * _PITCH_HZ
    weight = gaussian_filter1d(voiced.astype(np.float64), width)
    smooth = gaussian_filter1d(logs, width) / np.maximum(weight, 1e-6)
    return np.asarray(np.where(voiced, smooth, np.nan)[::_PITCH_HZ // RATE])


def trunk_speed(body: CommonBody) -> Array:
    """[T] at `RATE`: degrees a second of the chest's rotation, smoothed by 0.1 s."""
    # The sign of a turn is no matter: the trunk may turn to either side with a high voice.
    turns = np.degrees(rotation.angle_between(body.chest[:-1], body.chest[1:])) * HZ
    return np.asarray(gaussian_filter1d(turns, _SMOOTHING * HZ)[::round(HZ) // RATE])


def lagged(pitch: Array, speed: Array) -> Array:
    """[lags] Pearson's r of voiced pitch [T] with the speed [T] so many frames later; NaN where there is too little."""
    frames = min(len(pitch), len(speed))
    pitch, speed, out = pitch[:frames], speed[:frames], np.full(len(LAGS), np.nan)
    for at, lag in enumerate(LAGS.tolist()):
        early, late = pitch[max(0, -lag):frames - max(0, lag)], speed[max(0, lag):frames + min(0, lag)]
        voiced = np.isfinite(early)
        # Frames that the lag moves out of the recording are lost, so the count differs by lag.
        if voiced.sum() >= _FEWEST:
            out[at] = correlation(np.stack([early[voiced], late[voiced]], axis=1))
    return out


@dataclass(frozen=True)
class Coupling:
    """Over recordings. best: the largest mean r of `LAGS`; chance: [draws] that when sounds are exchanged."""

    best: float
    chance: Array

    @property
    def p(self) -> float:
        """Share of the exchanges that do as well; the observed order counts as one."""
        return float((1 + (self.chance >= self.best - 1e-12).sum()) / (1 + len(self.chance)))


def _best(pairs: Array) -> float:
    """Of recordings [n, lags]."""
    by_lag = np.nanmean(pairs, axis=0)
    return float(np.nanmax(by_lag)) if np.isfinite(by_lag).any() else float("nan")


def coupling(pitches: Sequence[Array], speeds: Sequence[Array], draws: int = 200) -> Coupling:
    """Of recordings with their pitch and trunk speed. With one recording there is no exchange, and no chance."""
    # All pairs once: exchanges only pick among them.
    pairs = np.array([[lagged(pitch, speed) for speed in speeds] for pitch in pitches])
    rng, every = np.random.default_rng(_SEED), np.arange(len(speeds))
    chance = [_best(pairs[rng.permutation(len(speeds)), every]) for _ in range(draws if len(speeds) > 1 else 0)]
    return Coupling(_best(pairs[every, every]), np.array(chance))

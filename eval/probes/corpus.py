"""Is the scripted performer good enough to learn from? `gesticulator probe corpus --data FOLDER`

Everything is measured on the finished files (BVH, FLAC and the truth in JSON), as a stranger would: motion beats are
found anew on the motion, and set beside a real take when one is given. Theory: a stroke's beat is where its arms brake
hardest (`motion_beats`, mode A). What fools it: a motion that brakes all the time hits every plan, so the share that
hits by chance (the plan shifted in time) is printed beside it.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from data_module.errors import InputError
from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.bvh import BvhWarning, read_bvh
from data_module.motion.motion_beats import acting_positions, acting_speed, beats_of_speed, motion_beats
from data_module.speech.audio import load_speech
from data_module.speech.beats import detect_onsets
from data_module.types import Array, Motion, Speech
from eval.clip import Rhythm, rhythm
from eval.stats import Interval, mean_interval
from eval.table import Cell, Column, Table

TOLERANCE = 0.02
"""Seconds: how near a motion beat must be to its plan."""
STILL = 0.1
PERCENTILES = (5, 25, 50, 75, 95, 99)
TORSO_RADIUS = 0.115
REAL_NAME = "real take"
_COMPARE_FPS = 15.0
_SEAM = 0.05
_ACTING = {"right": (0, 1), "left": (2, 3), "both": (0, 1, 2, 3)}
_ARM_JOINTS = tuple(side + part for side in ("Right", "Left") for part in ("Arm", "ForeArm", "Hand"))


@dataclass(frozen=True)
class MeasuredRecording:
    """What is measured on one recording. Speeds in m/s, heights in m over the hips, accelerations in rad/s2."""

    name: str
    split: str
    misses: Array
    shifted_misses: Array
    rhythm: Rhythm
    beats_per_second: float
    speeds: Array
    heights: Array
    in_torso: float
    seam: Array
    away: Array
    acceleration: Array
    gains: Array
    features: Array
    clips: tuple[str, ...]


def stroke_misses(motion: Motion, strokes: Sequence[Mapping[str, Any]], shift: float = 0.0) -> Array:
    """Seconds from each planned beat (plus `shift`) to the nearest motion beat of its acting arms, [strokes]."""
    positions = acting_positions(motion)
    found = {hand: beats_of_speed(acting_speed(positions[:, list(joints)], motion.fps), motion.fps)
             for hand, joints in _ACTING.items()}
    out = np.full(len(strokes), np.inf)
    for k, stroke in enumerate(strokes):
        times = found[stroke["hand"]]
        if len(times):
            out[k] = float(np.abs(times - (stroke["beat"] + shift) % motion.duration).min())
    return out


def in_torso(positions: Array, table: Mapping[str, int]) -> float:
    """Share of hand-frames inside a capsule round the spine, from joint positions [T, J, 3]."""
    low = positions[:, table["Hips"]]
    high = positions[:, table.get("Spine2", table["Neck"])]
    axis = high - low
    hands = positions[:, [table["RightHand"], table["LeftHand"]]]
    share = np.einsum("thc,tc->th", hands - low[:, None], axis) / np.sum(axis * axis, axis=-1)[:, None]
    nearest = low[:, None] + np.clip(share, 0.0, 1.0)[..., None] * axis[:, None]
    return float((np.linalg.norm(hands - nearest, axis=-1) < TORSO_RADIUS).mean())


def angular_acceleration(motion: Motion, joints: Sequence[int]) -> Array:
    """[T - 2, joints] rad/s2: how fast the local angular velocity of joints changes."""
    q = motion.rotations[:, list(joints)]
    velocity = rotation.to_exponential_map(rotation.multiply(rotation.conjugate(q[:-1]), q[1:])) * motion.fps
    return np.linalg.norm(np.diff(velocity, axis=0), axis=-1) * motion.fps


def _seams(motion: Motion, joints: Sequence[int], strokes: Sequence[Mapping[str, Any]]) -> tuple[Array, Array]:
    """Angular acceleration near the joins of strokes, and in the rest of the strokes, of the acting arms."""
    values = angular_acceleration(motion, joints)
    times = (np.arange(len(values)) + 1.0) / motion.fps
    near, away = [], []
    for columns, hand in ((slice(0, 3), "right"), (slice(3, 6), "left")):
        own = [s for s in strokes if s["hand"] in (hand, "both")]
        edges = np.array([time for s in own for time in (s["start"], s["hold_end"])])
        inside: NDArray[np.bool_] = np.zeros(len(times), dtype=bool)
        for stroke in own:
            inside |= (times > stroke["start"]) & (times < stroke["end"])
        close = np.abs(times[:, None] - edges).min(axis=1) < _SEAM if len(edges) else inside & False
        near.append(values[close, columns].ravel())
        away.append(values[inside & ~close, columns].ravel())
    return np.concatenate(near), np.concatenate(away)


def gain_features(speech: Speech, times: Array) -> Array:
    """What low-level audio says about the vigour of syllables at `times`: [n, 6], levels in dB and brightness.

    Levels over 0.2, 0.6 and 2 s against the recording's median speech level; the same of the sound above 1 kHz, whose
    share grows with vocal effort.
    """
    hop = speech.sample_rate // 100
    count = len(speech.samples) // hop
    frames = speech.samples[:count * hop].reshape(count, hop).astype(np.float64)
    bright = np.diff(speech.samples[:count * hop], prepend=0.0).reshape(count, hop).astype(np.float64)
    powers = np.stack([(frames ** 2).mean(axis=1), (bright ** 2).mean(axis=1)]) + 1e-10
    loud = powers[:, powers[0] > np.percentile(powers[0], 40)]
    middle = 10.0 * np.log10(np.median(loud, axis=1))
    out = np.zeros((len(times), 6))
    for column, width in enumerate((0.2, 0.6, 2.0)):
        for k, time in enumerate(times):
            low, high = int(max(0, (time - width / 3.0) * 100)), int(min(count, (time + width * 2.0 / 3.0) * 100))
            mean = powers[:, low:max(high, low + 1)].mean(axis=1)
            out[k, column::3] = 10.0 * np.log10(mean) - middle
    return out


def gain_r2(train: Sequence[tuple[Array, Array]], test: Sequence[tuple[Array, Array]]) -> Array:
    """R2 of stroke gain (log) from audio features on each test recording's strokes; a linear fit on the others.

    Each pair is features [n, 6] and gains [n]. The variance is that about the training mean, over all test strokes.
    """
    x, y = np.concatenate([f for f, _ in train]), np.log(np.concatenate([g for _, g in train]))
    mean, scale = x.mean(axis=0), x.std(axis=0) + 1e-9
    design = np.column_stack([(x - mean) / scale, np.ones(len(x))])
    weights = np.linalg.solve(design.T @ design + 1.0 * np.eye(design.shape[1]), design.T @ y)
    pairs = [(np.log(g), np.column_stack([(f - mean) / scale, np.ones(len(f))]) @ weights) for f, g in test if len(g)]
    spread = np.concatenate([(g - y.mean()) ** 2 for g, _ in pairs]).mean()
    return np.array([1.0 - ((g - said) ** 2).mean() / spread for g, said in pairs])


def measure(name: str, motion: Motion, speech: Speech, truth: Mapping[str, Any] | None = None) -> MeasuredRecording:
    """Everything about one recording; without its truth (a real take) what needs it is empty."""
    table = skeletons.find_table(motion.skeleton.names)
    joints = [table[joint] for joint in _ARM_JOINTS]
    strokes = truth["strokes"] if truth else []
    positions = kinematics.positions_of(motion)
    hands = positions[:, [table["RightHand"], table["LeftHand"]]]
    beats = motion_beats(motion)
    onsets = detect_onsets(speech.samples, speech.sample_rate)
    duration = min(motion.duration, speech.duration)
    matched = rhythm(beats, onsets, duration)
    seam, away = _seams(motion, joints, strokes)
    times = np.array([s["syllable"] for s in strokes])
    return MeasuredRecording(
        name, str(truth["split"]) if truth else "real", stroke_misses(motion, strokes),
        stroke_misses(motion, strokes, shift=7.3), matched, len(beats) / motion.duration,
        (np.linalg.norm(np.diff(hands, axis=0), axis=-1) * motion.fps).ravel().astype(np.float32),
        (hands[..., 1] - positions[:, table["Hips"], None, 1]).ravel().astype(np.float32),
        in_torso(positions, table), seam, away,
        angular_acceleration(kinematics.resample(motion, _COMPARE_FPS), joints).ravel(),
        np.array([s["gain"] for s in strokes]), gain_features(speech, times),
        tuple(str(s["clip"]).removesuffix("-mirrored") for s in strokes))


def measure_folder(folder: Path, limit: int | None = None) -> list[MeasuredRecording]:
    """Measure every recording of a data set, or `limit` of them, evenly chosen. InputError when there is none."""
    files = sorted(path for path in folder.glob("*.json") if path.with_suffix(".bvh").is_file())
    if not files:
        raise InputError(folder, "holds no recording (NAME.bvh, NAME.flac and NAME.json)", "build the data set first")
    if limit is not None and limit < len(files):
        files = [files[i] for i in np.linspace(0, len(files) - 1, limit).round().astype(int)]
    takes = []
    for path in tqdm(files, desc="measuring", unit="recording", disable=not sys.stderr.isatty()):
        truth = json.loads(path.read_text(encoding="utf-8"))
        speech = load_speech(path.with_suffix(".flac"))
        takes.append(measure(path.stem, read_bvh(path.with_suffix(".bvh")), speech, truth))
    return takes


def _pooled(takes: Sequence[MeasuredRecording], field: str, levels: Sequence[float] = PERCENTILES
            ) -> dict[str, Interval]:
    """Mean over recordings of each percentile, with its interval."""
    rows = np.array([np.percentile(getattr(take, field), levels) for take in takes if len(getattr(take, field))])
    return {f"{level:g}": mean_interval(rows[:, k]) for k, level in enumerate(levels)} if len(rows) else {}


def longest_repetition(clips: Sequence[str]) -> int:
    """The longest run of one clip in a row (1: none twice)."""
    longest = run = min(len(clips), 1)
    for before, now in zip(clips, clips[1:], strict=False):
        run = run + 1 if now == before else 1
        longest = max(longest, run)
    return longest


def summary(takes: Sequence[MeasuredRecording]) -> dict[str, Any]:
    """The figures over recordings, each with n and a bootstrap interval over recordings where it is a mean."""
    from scipy.stats import combine_pvalues

    counts = [len(take.misses) for take in takes]
    out: dict[str, Any] = {
        "recordings": len(takes), "strokes": sum(counts),
        "pmb_percent": mean_interval([take.rhythm.pmb for take in takes]),
        "pmb_chance_percent": mean_interval([take.rhythm.chance for take in takes]),
        "pmb_above_chance": mean_interval([take.rhythm.above_chance / 100.0 for take in takes]),
        "pmb_p": float(combine_pvalues([take.rhythm.p_value for take in takes]).pvalue),
        "motion_beats_per_second": mean_interval([take.beats_per_second for take in takes]),
        "hand_speed_m_s": _pooled(takes, "speeds"),
        "share_under_0.1_m_s": mean_interval([float((take.speeds < STILL).mean()) for take in takes]),
        "hand_height_over_hips_m": _pooled(takes, "heights", (5, 50, 95)),
        "hand_in_torso": mean_interval([take.in_torso for take in takes]),
        "angular_acceleration_15fps_rad_s2": _pooled(takes, "acceleration", (50, 95, 99)),
    }
    if sum(counts):
        playing = [take for take in takes if len(take.misses)]
        out |= {
            "beats_within_20_ms": mean_interval([float((t.misses <= TOLERANCE).mean()) for t in playing],
                                                [float(len(t.misses)) for t in playing]),
            "beats_within_20_ms_by_chance": mean_interval(
                [float((t.shifted_misses <= TOLERANCE).mean()) for t in playing]),
            "median_miss_ms": 1000.0 * float(np.median(np.concatenate([t.misses for t in playing]))),
            "seam_over_away_angular_acceleration": {
                str(level): mean_interval([float(np.percentile(t.seam, level) / np.percentile(t.away, level))
                                     for t in playing if len(t.seam) and len(t.away)]) for level in (50, 95)},
            "longest_clip_repetition": max(longest_repetition(t.clips) for t in playing),
            "gain_r2": _gain_figure(playing),
        }
    return out


def _gain_figure(takes: Sequence[MeasuredRecording]) -> Interval:
    """R2 on the split "test", fitted on the others; without such a split every fifth recording is held out."""
    held = [take.split == "test" for take in takes]
    if not any(held) or all(held):
        held = [k % 5 == 4 for k in range(len(takes))]
    train = [(t.features, t.gains) for t, out in zip(takes, held, strict=True) if not out]
    test = [(t.features, t.gains) for t, out in zip(takes, held, strict=True) if out]
    if not train or not test:
        return mean_interval([])
    return mean_interval(gain_r2(train, test), [float(len(g)) for _, g in test if len(g)])


def acceptance(figures: Mapping[str, Any], real: Mapping[str, Any] | None = None) -> dict[str, bool]:
    """Which of the corpus's acceptance figures are met."""
    met = {
        "95 % of motion beats within 20 ms of plan": figures["beats_within_20_ms"].mean >= 0.95,
        "PMB above chance at 0.1 s of 0.3 or more, p < 0.01":
            figures["pmb_above_chance"].mean >= 0.3 and figures["pmb_p"] < 0.01,
        "seams no worse than elsewhere (95th percentile)":
            figures["seam_over_away_angular_acceleration"]["95"].mean <= 1.0,
        "hand in torso under 0.5 %": figures["hand_in_torso"].mean < 0.005,
        "stroke size from audio, R2 of 0.4 or more": figures["gain_r2"].mean >= 0.4,
        "no clip twice in a row": figures["longest_clip_repetition"] <= 1,
    }
    if real is not None:
        ours, theirs = (f["angular_acceleration_15fps_rad_s2"] for f in (figures, real))
        met["angular acceleration within twice the real take's"] = all(
            ours[level].mean <= 2.0 * theirs[level].mean for level in ours)
    return met


TITLES = {"pmb_percent": "PMB at 0.1 s, %", "pmb_chance_percent": "its chance level, %",
          "pmb_above_chance": "PMB above chance", "pmb_p": "p of PMB, combined",
          "motion_beats_per_second": "motion beats, Hz", "share_under_0.1_m_s": "share of hands under 0.1 m/s",
          "hand_in_torso": "share of hands in the torso", "beats_within_20_ms": "motion beats within 20 ms of plan",
          "beats_within_20_ms_by_chance": "the same by chance", "median_miss_ms": "median miss, ms",
          "longest_clip_repetition": "longest run of one clip", "gain_r2": "stroke size from audio, R2",
          "hand_speed_m_s": "hand speed, m/s", "hand_height_over_hips_m": "hand height over hips, m",
          "angular_acceleration_15fps_rad_s2": "angular acceleration at 15 fps, rad/s2",
          "seam_over_away_angular_acceleration": "angular acceleration, seams over the rest"}


def tables(figures: Mapping[str, Mapping[str, Any]], met: Mapping[str, bool]) -> list[Table]:
    """Every figure of the corpus and, where given, of a real take; and which acceptance figures are met."""
    rows: dict[str, dict[str, Cell]] = {}
    for name, summed in figures.items():
        for key, value in summed.items():
            if key in TITLES:
                each = {f", {level} %": one for level, one in value.items()} if isinstance(value, dict) else {"": value}
                for suffix, one in each.items():
                    rows.setdefault(TITLES[key] + suffix, {})[name] = one
    counts = "; ".join(f"{name}: {own['recordings']} recordings, {own['strokes']} strokes"
                       for name, own in figures.items())
    accepted: dict[str, dict[str, Cell]] = {claim: {"met": "yes" if good else "NO"} for claim, good in met.items()}
    return [Table("A data set as a stranger would measure it", {name: Column(name, digits=3) for name in figures}, rows,
                  "figure", [f"{counts}. Where a percentile is named, the mean over recordings of that percentile."]),
            *([Table("Acceptance", {"met": Column("met")}, accepted, "figure")] if met else [])]


def arguments(parser: argparse.ArgumentParser) -> None:
    """A data set, and a real take beside it."""
    add = parser.add_argument
    add("--data", type=Path, required=True, metavar="FOLDER", help="NAME.bvh, NAME.flac, NAME.json")
    add("--limit", type=int, help="measure this many recordings, evenly chosen (default: all)")
    add("--real", type=Path, metavar="TAKE.bvh", help="a real take to set beside")
    add("--real-fps", type=float, help="its frame rate, when its header is wrong")
    add("--real-wav", type=Path, metavar="WAV", help="its sound")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Measure a data set; InputError for one that is none."""
    if (arguments.real is None) != (arguments.real_wav is None):
        raise InputError("--real", "needs --real-wav, and the other way round", "give both or neither")
    if arguments.limit is not None and arguments.limit < 1:
        raise InputError("--limit", "must be 1 or more", "leave it out to measure all")
    figures = {"corpus": summary(measure_folder(arguments.data, arguments.limit))}
    if arguments.real is not None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore" if arguments.real_fps else "default", BvhWarning)
            motion = read_bvh(arguments.real, fps=arguments.real_fps)
        figures[REAL_NAME] = summary([measure(REAL_NAME, motion, load_speech(arguments.real_wav))])
    met = acceptance(figures["corpus"], figures.get(REAL_NAME)) if figures["corpus"]["strokes"] else {}
    return tables(figures, met)

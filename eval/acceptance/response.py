"""How the motion responds to a change of the input: effort, level, style controls, words, exports.

- Effort (`effort`): every reading in GESTICULATOR_DATA said again lively and subdued at its own level
  (`stimuli.said_with`). With the same seed, size is the median stroke amplitude and speed the mean hand speed in
  speech; the figure is the ratio of lively to subdued, the geometric mean over readings of the better of the two, and
  the share of readings in the right order. A reading that is 6 dB quieter must be the same take.
- Controls (`controls`): what a style control requests must rise from low to mid and from mid to high on the same voices
  with the same seed. Other words, in the times of the right ones, must change lexemes; the control is the same sound
  0.1 dB fainter. Every interpreter must run.
- Stability (`stability`): the same sound exported again, and with one word changed (`eval.metrics.eye.stability`).

What fools them: a speaking rate alone makes strokes faster, so that amplitude is shown too; a hand that trembles is a
fast hand; a system that ignores the sound is perfectly stable.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from data_module.controls import FEATURES, LEVELS, per_frame
from data_module.errors import InputError, install_line
from data_module.motion.phases import gesture_units, runs
from data_module.types import Array, Speech
from eval import stats
from eval.acceptance import stimuli
from eval.acceptance.bounds import Measured, Results
from eval.clip.excerpts import spread_out
from eval.metrics import eye
from eval.metrics.eye import common_body, hear, stability
from eval.metrics.eye.body import HZ, CommonBody
from eval.metrics.eye.together import hand_speeds
from eval.renderings import AcceptanceVoice, BundleSystem, Rendering
from eval.stats import Interval

SIZE, SPEED = "eye_stroke_amplitude", "eye_speech_speed"
CLIPS, SECONDS = 6, 20.0
"""Voices and seconds of the group `controls`."""
FAINTER = 0.1
"""Decibels of the control of other words."""
NEEDED = ("lstm", "cql", "statistical")
"""Interpreters that a bundle should have."""
LONGEST = 40.0
"""Seconds of a voice in the group `stability`."""

# ------------------------------------------------------------------------------------------------------------- effort

def effort_figures(values: Array, apart: Sequence[float]) -> Results:
    """values: [size and speed, lively and subdued, readings]; apart: cm between the hands of each reading and the same
    reading 6 dB quieter."""
    # Logarithms, so that twice as large and half as large cancel.
    logs = np.log(values[:, 0] / values[:, 1])
    # Effort shows in size with some systems and in speed with others; either will do.
    best = int(np.nanargmax(np.nanmean(logs, axis=1)))
    shown = ", ".join(f"{name} {np.exp(np.nanmean(log)):.2f}, in order in {int((log > 0).sum())} of {len(log)}"
                      for name, log in zip(("size", "speed"), logs, strict=True))
    mean = stats.mean_interval(logs[best])
    ratio = Interval(math.exp(mean.mean), math.exp(mean.low), math.exp(mean.high), mean.n)
    return {("effort_ratio", ""): Measured(ratio, shown),
            ("effort_ordered", ""): Measured(stats.mean_interval((logs[best] > 0).astype(float)),
                                             f"by {('size', 'speed')[best]}"),
            ("hands_apart", "a reading 6 dB quieter"): Measured(stats.mean_interval(apart))}


def effort(system: BundleSystem, renderings: int) -> Results:
    """The group `effort`; two seeds of every reading."""
    try:
        import parselmouth  # noqa: F401 - fail before anything is rendered
    except ImportError:
        return {("effort_ratio", ""): Measured(
            missing=f"praat-parselmouth is not installed ({install_line('effort')})")}
    sounds = stimuli.readings()
    if not sounds:
        return {("effort_ratio", ""): Measured(missing=f"GESTICULATOR_DATA has no folder {stimuli.READINGS}")}
    seeds = range(min(2, renderings))

    def voice(name: str, speech: Speech) -> AcceptanceVoice:
        return AcceptanceVoice(name, replace(speech, words=None))

    def size_and_speed(name: str, speech: Speech) -> list[float]:
        rows = [eye.figures(system.render(voice(name, speech), seed).motion, hear(speech)) for seed in seeds]
        return [float(np.mean([row[figure] for row in rows])) for figure in (SIZE, SPEED)]

    # The same seed for both readings: only the sound differs.
    values = np.array([[size_and_speed(name, stimuli.said_with(speech, manner)) for name, speech in sounds]
                       for manner in (stimuli.LIVELY, stimuli.SUBDUED)]).transpose(2, 0, 1)
    apart = []
    for name, speech in sounds:
        first, quieter = (common_body(system.render(voice(name, sound), 0).motion)
                          for sound in (speech, stimuli.EXPORTS["6 dB quieter"](speech)))
        apart.append(stability.difference(first, quieter).hands)
    return effort_figures(values, apart)


# ----------------------------------------------------------------------------------------------------------- controls

def order_figures(values: Mapping[tuple[str, str], Array]) -> Results:
    """(Feature, level) -> the realised value of each clip [n], to how far each level lies over the one below it."""
    results: Results = {}
    for feature in FEATURES:
        low, mid, high = (values[feature, level] for level in LEVELS)
        shown = ", ".join(f"{level} {values[feature, level].mean():.3f}" for level in LEVELS)
        remark = f"{shown}; in order in {100.0 * float(np.mean((low < mid) & (mid < high))):.0f} % of clips"
        for lower, upper in itertools.pairwise(LEVELS):
            results[f"control_{feature}", f"{upper} over {lower}"] = Measured(
                stats.paired(values[feature, upper], values[feature, lower]), remark)
    return results


def controls(system: BundleSystem, voices: Sequence[AcceptanceVoice]) -> Results:
    """The group `controls`: style controls, words, interpreters, size."""
    short = [stimuli.derived(voice, "short", stimuli.middle_of(voice, SECONDS)) for voice in spread_out(voices, CLIPS)]
    results = _style_controls(system, short) | _words(system, voices)
    for name in sorted({*NEEDED, *system.gesticulator.bundle.interpreters}):
        results["interpreter", name] = _interpreter(system, short[0], name)
    results["megabytes", ""] = Measured(Interval.exact(system.megabytes, 1))
    return results


def _style_controls(system: BundleSystem, voices: Sequence[AcceptanceVoice]) -> Results:
    if system.bundle.levels is None:
        return {("controls_work", ""): Measured(Interval.exact(0.0, 1), "the bundle was trained without style editing")}
    # The same seed at every level: only the request differs.
    return order_figures({(feature, level): np.array([
        per_frame(system.render(voice, 0, **{f"hand_{feature}": level}).motion).mean(axis=0)[column]
        for voice in voices])
        for (column, feature), level in itertools.product(enumerate(FEATURES), LEVELS)})


def _words(system: BundleSystem, voices: Sequence[AcceptanceVoice]) -> Results:
    """Shares of blocks with another lexeme under another voice's words, and where the sound is a little fainter."""
    if not system.gesticulator.reads_text:
        return {("other_lexemes", "other words"): Measured(Interval.exact(0.0, 1), "the bundle does not read words")}
    spoken = [voice for voice in voices if any(word.text.strip() for word in voice.speech.words or ())]
    if len(spoken) < 2:
        return {("other_lexemes", "other words"): Measured(missing="fewer than two voices have words")}
    # Each voice is given the words of the next one, so every text is right once and wrong once.
    spoken = spread_out(spoken, CLIPS)
    changed, fainter = [], []
    for voice, other in zip(spoken, [*spoken[1:], spoken[0]], strict=True):
        swapped = replace(voice, speech=stimuli.other_words(voice.speech, other.speech.words or ()))
        quiet = replace(voice, speech=replace(
            voice.speech, samples=np.float32(10.0 ** (-FAINTER / 20.0)) * voice.speech.samples))
        right, wrong, again = (system.render(sound, 0).lexemes for sound in (voice, swapped, quiet))
        changed.append(float((right != wrong).mean()))
        fainter.append(float((right != again).mean()) if len(right) == len(again) else 1.0)
    return {("other_lexemes", "other words"): Measured(stats.mean_interval(changed), "same sound, times and seed"),
            ("other_lexemes", "0.1 dB fainter"): Measured(stats.mean_interval(fainter), "the right words")}


def _interpreter(system: BundleSystem, voice: AcceptanceVoice, name: str) -> Measured:
    """1 if the interpreter gives motion as long as the sound, else 0."""
    try:
        performance = system.perform(voice, 0, interpreter=name)
    except InputError as error:
        return Measured(Interval.exact(0.0, 1), str(error))
    # Half a take without an error is worse than an error, so the length counts.
    whole = abs(performance.motion.duration - performance.duration) <= 1.0 / performance.fps
    return Measured(Interval.exact(float(whole), 1),
                    f"{len(np.unique(performance.lexemes))} lexemes in {len(performance.lexemes)} blocks")


# ---------------------------------------------------------------------------------------------------------- stability

def moved(first: Rendering, again: Rendering) -> list[float]:
    """Of a rendering against the first one: cm between the hands, % of the time with other lexemes, % of partings after
    which both come together."""
    apart = stability.difference(common_body(first.motion), common_body(again.motion))
    return [apart.hands, stability.other_lexemes((first.edges, first.lexemes), (again.edges, again.lexemes)),
            apart.healed]


def same_take(system: BundleSystem, voices: Sequence[AcceptanceVoice], renderings: int) -> Results:
    """The group `stability`, on the readings of GESTICULATOR_DATA or, without them, on some of the voices."""
    seeds = range(min(2, renderings))
    sounds = [AcceptanceVoice(name, speech) for name, speech in stimuli.readings()] or [
        stimuli.derived(voice, "exported", stimuli.middle_of(voice, LONGEST)) for voice in spread_out(voices, CLIPS)]
    values: dict[str, list[list[float]]] = {name: [] for name in (*stimuli.EXPORTS, "another seed")}
    for voice, seed in itertools.product(sounds, seeds):
        first = system.render(voice, seed)
        # How far apart two takes of one sound are: without it "2 cm apart" says nothing.
        values["another seed"].append(moved(first, system.render(voice, seed + len(seeds))))
        for name, change in stimuli.EXPORTS.items():
            values[name].append(moved(first, system.render(replace(voice, speech=change(voice.speech)), seed)))
    results: Results = {(figure, name): Measured(stats.mean_interval(column)) for name, rows in values.items()
                        for figure, column in zip(("hands_apart", "lexemes_apart", "healed"), zip(*rows, strict=True),
                                                  strict=True)}
    return results | _word_changed(system, voices, seeds)


def units_of(body: CommonBody) -> list[tuple[float, float]]:
    """Seconds from and to of the gesture units of a motion; those of both hands that overlap are joined."""
    speed, active = hand_speeds(body), np.zeros(len(body), bool)
    for hand in (0, 1):
        for begin, stop in gesture_units(body.hands[:, hand, 1], speed[:, hand], HZ):
            active[begin:stop] = True
    return [(begin / HZ, stop / HZ) for begin, stop in runs(active)]


def moved_by_word(first: Rendering, again: Rendering, time: float) -> tuple[float, float]:
    """After a change of the word at a time: cm between the hands before its gesture unit, and % of other lexemes from
    the second unit after it on. NaN for what the motion is too short for."""
    body, other = common_body(first.motion), common_body(again.motion)
    units, changed = units_of(body), units_of(other)
    at, new = _unit_at(units, time), _unit_at(changed, time)
    # The new word may call for a gesture that is prepared earlier than that of the old one.
    begin = min([time, *(unit[0] for unit in (*units[at:at + 1], *changed[new:new + 1]))])
    frames = round(begin * HZ)
    before = stability.difference(body.crop(0, frames), other.crop(0, frames)).hands if begin > 1.0 else math.nan
    if at + 2 >= len(units):
        return before, math.nan
    # The unit of the word itself and the one after it may differ; from then on the take must be the old one.
    late = int(np.searchsorted(first.edges[:-1], units[at + 2][0]))
    rest = first.edges[late:], first.lexemes[late:]
    return before, stability.other_lexemes(rest, (again.edges, again.lexemes))


def _unit_at(units: Sequence[tuple[float, float]], time: float) -> int:
    """The index of the unit at a time, or of the next one; their number without any."""
    return next((k for k, (_, stop) in enumerate(units) if stop > time), len(units))


def _word_changed(system: BundleSystem, voices: Sequence[AcceptanceVoice], seeds: Sequence[int]) -> Results:
    """One word in the middle of every voice that has words becomes another."""
    pairs = []
    for voice in spread_out([voice for voice in voices if len(voice.speech.words or ()) > 1], CLIPS):
        try:
            speech, time = stimuli.word_changed(voice.speech)
        except ValueError:
            continue
        swapped = replace(voice, speech=speech)
        pairs += [moved_by_word(system.render(voice, seed), system.render(swapped, seed), time) for seed in seeds]
    if not pairs or not system.gesticulator.reads_text:
        return {}
    before, after = (stats.mean_interval(values) for values in zip(*pairs, strict=True))
    return {("before_word", ""): Measured(before), ("after_word", ""): Measured(after)}

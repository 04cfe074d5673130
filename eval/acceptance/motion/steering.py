"""Do the hand controls, the words, the interpreters and the plan of a performance still work, and what does it cost?

A control is in order when what it asks for rises from low to mid and from mid to high by 2 cm (height, radius) or
2 cm/s (speed), on the same voices with the same seed. Other words, in the times of the right ones, must change more
than a tenth of the lexemes; the control is the same sound 0.1 dB fainter with its own words, which must change nearly
none: an interpreter that any trifle throws off its course "follows" the words as well. Speed is measured properly, warm
and cold, by `benchmarks/realtime.py`; what is told here is what the renderings of this probe took, whatever else the
machine was doing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from data_module.controls import FEATURES, LEVELS
from data_module.errors import InputError
from data_module.types import Array, Speech, Word
from eval import stats
from eval.ablate.style_editing import realised
from eval.acceptance.motion.sounds import heard_of, spread_out
from eval.claim import ANY, Bound, Verdict, at_least, at_most, judged, skipped
from eval.renderings import AcceptanceVoice, BundleSystem
from eval.table import Table
from gesticulator.sampling.loop import BEST

STEP = 0.02
"""Metres, or metres a second, from level to level."""
CLIPS, SECONDS = 6, 20.0
OTHER_WORDS = 0.10
"""Share of blocks that other words must change."""
FAINTER, BY_CHANCE = 0.1, 0.02
"""Decibels of the control, and the share of blocks that it may change."""
NEEDED = ("lstm", "cql", "statistical")
MEGABYTES, FACTOR = 20.0, 0.05
_EPS = 1e-6


def order_clauses(realised_by: Mapping[tuple[str, str], Array]) -> list[Verdict]:
    """Feature and level -> what was realised on each clip [n], in the feature's unit."""
    out = []
    for feature in FEATURES:
        unit = "m/s" if feature == "speed" else "m"
        told = ", ".join(f"{level} {realised_by[feature, level].mean():.3f}" for level in LEVELS)
        for lower, upper in itertools.pairwise(LEVELS):
            out.append(judged(f"hand {feature}, {upper} over {lower}, {unit}", stats.paired(
                realised_by[feature, upper], realised_by[feature, lower]), at_least(STEP), digits=3, reason=told))
    return out


def plan_faults(plan: Mapping[str, Any], duration: float) -> list[str]:
    """What is wrong with what `--plan-out` writes: blocks that tile the sound, each with `BEST` lexemes, best first."""
    faults = []
    blocks = plan.get("blocks")
    if not isinstance(blocks, list) or not blocks:
        return ["no blocks"]
    last = 0.0
    for number, block in enumerate(blocks):
        if not {"start", "end", "alternatives"} <= set(block):
            faults.append(f"block {number} lacks start, end or alternatives")
            continue
        if abs(block["start"] - last) > _EPS or block["end"] <= block["start"]:
            faults.append(f"block {number} does not begin where the last one ended")
        last = block["end"]
        lexemes = block["alternatives"]
        if len(lexemes) != BEST or any(not {"lexeme", "score"} <= set(one) for one in lexemes):
            faults.append(f"block {number} has no {BEST} lexemes with their scores")
            continue
        scores = [one["score"] for one in lexemes]
        if not all(math.isfinite(score) for score in scores) or any(a < b for a, b in itertools.pairwise(scores)):
            faults.append(f"block {number} has scores that do not fall")
    if abs(last - duration) > 0.05:
        faults.append(f"the blocks end at {last:.2f} s of {duration:.2f}")
    return faults


def other_words(speech: Speech, others: Sequence[Word]) -> Speech:
    """The same speech whose words, in their own times, are another's; ValueError where either has none."""
    told = [word.text for word in others if word.text.strip()]
    if not told or not speech.words:
        raise ValueError("both must have words")
    changed = tuple(replace(word, text=told[k % len(told)]) if word.text.strip() else word
                    for k, word in enumerate(speech.words))
    return replace(speech, words=changed)


def words_clause(changed: Sequence[float]) -> Verdict:
    """Shares of blocks with another lexeme, of each voice."""
    return judged("blocks with another lexeme under other words, share", stats.mean_interval(changed),
                  Bound(low=math.nextafter(OTHER_WORDS, 1.0)), reason="same sound, times and seed")


def fainter_clause(changed: Sequence[float]) -> Verdict:
    """Shares of blocks with another lexeme, of each voice 0.1 dB fainter."""
    return judged(f"the same with the right words, the sound {FAINTER} dB fainter", stats.mean_interval(changed),
                  at_most(BY_CHANCE), reason="the control: other words must change more")


# ------------------------------------------------------------------------------------------------------------- group

def run(ours: BundleSystem, voices: Sequence[AcceptanceVoice]) -> tuple[list[Verdict], list[Table]]:
    """Everything of this group."""
    short = [AcceptanceVoice(f"{voice.name} short", replace(heard_of(voice, SECONDS), words=None), "made", None,
                             voice.performer, voice.group) for voice in spread_out(voices, CLIPS)]
    clauses = [*_controls(ours, short), *_words(ours, voices)]
    clauses += [_interpreter(ours, short[0], name) for name in sorted({*NEEDED, *ours.gesticulator.interpreters})]
    made, _ = ours.perform(short[0], 0)
    faults = plan_faults(made.explain(), made.duration)
    clauses.append(judged("faults of the plan (--explain)", float(len(faults)), at_most(0.0), digits=0,
                          reason="; ".join(faults[:3])))
    return [*clauses, *_cost(ours, short)], []


def _controls(ours: BundleSystem, voices: Sequence[AcceptanceVoice]) -> list[Verdict]:
    if ours.bundle.levels is None:
        return [judged("hand controls are heard", 0.0, at_least(1.0), digits=0,
                       reason="the bundle was trained without style editing")]
    found = {}
    for column, feature in enumerate(FEATURES):
        for level in LEVELS:
            asked: dict[str, Any] = {f"hand_{feature}": level}
            found[feature, level] = np.array([realised(ours.render(voice, 0, **asked).motion)[column]
                                              for voice in voices])
    return order_clauses(found)


def _words(ours: BundleSystem, voices: Sequence[AcceptanceVoice]) -> list[Verdict]:
    """Voices of the test split with another's words, and a little fainter."""
    name = "blocks with another lexeme under other words, share"
    if not ours.gesticulator.reads_text:
        return [judged(name, 0.0, at_least(OTHER_WORDS), reason="the bundle does not read words")]
    spoken = [voice for voice in voices if any(word.text.strip() for word in voice.speech.words or ())]
    if len(spoken) < 2:
        return [skipped(name, "fewer than two voices have words")]
    spoken = spread_out(spoken, CLIPS)
    changed, fainter = [], []
    for voice, other in zip(spoken, [*spoken[1:], spoken[0]], strict=True):
        swapped = replace(voice, name=f"{voice.name} reworded",
                          speech=other_words(voice.speech, other.speech.words or ()))
        quiet = replace(voice, name=f"{voice.name} fainter", speech=replace(
            voice.speech, samples=np.float32(10.0 ** (-FAINTER / 20.0)) * voice.speech.samples))
        right, wrong, again = (ours.render(one, 0).lexemes for one in (voice, swapped, quiet))
        changed.append(float((right != wrong).mean()))
        fainter.append(float((right != again).mean()) if len(right) == len(again) else 1.0)
    return [words_clause(changed), fainter_clause(fainter)]


def _interpreter(ours: BundleSystem, voice: AcceptanceVoice, name: str) -> Verdict:
    title = f"interpreter {name} runs"
    try:
        made, _ = ours.perform(voice, 0, interpreter=name)
    except InputError as error:
        return judged(title, 0.0, at_least(1.0), digits=0, reason=str(error))
    frames = abs(made.motion.duration - made.duration) <= 1.0 / made.fps
    return judged(title, float(frames), at_least(1.0), digits=0,
                  reason=f"{len(np.unique(made.lexemes))} lexemes in {len(made.lexemes)} blocks")


def _cost(ours: BundleSystem, voices: Sequence[AcceptanceVoice]) -> list[Verdict]:
    factors = [ours.perform(voice, 1)[1] / voice.speech.duration for voice in voices]
    # The first one opens models and caches.
    warm = stats.mean_interval(factors[1:] or factors)
    return [judged("size of the bundle, MB", ours.megabytes, at_most(MEGABYTES), digits=1),
            judged("real-time factor of these renderings, features included", warm, ANY, digits=3,
                   reason=f"at most {FACTOR} is required, by benchmarks/realtime.py on a free machine")]


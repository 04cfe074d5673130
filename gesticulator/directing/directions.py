"""From options, knobs, cues and plans to instructions for each block and changes of the generated poses."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.controls import FEATURES, LIMITS, UNITS, Controls, Curve
from data_module.errors import InputError, shown
from data_module.types import Array, Speech, Word
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock, representation_of
from gesticulator.bundle.files import lexicon_hash
from gesticulator.directing.shaping import (
    FADE,
    MIRROR_FADE,
    OTHER_HAND,
    REST_FADE,
    ArmScales,
    Shaper,
    eased_levels,
    levels_at,
    nearest_turn,
    rest_share,
)
from gesticulator.options import FPS, InferenceOptions, interpreter_name
from gesticulator.plan.checks import plain_word as plain_word
from gesticulator.plan.gestures import EXPRESSIONS, GESTURES, near_gestures
from gesticulator.plan.plan import (
    ENERGIES,
    ENERGY_SIZES,
    GestureCue,
    GesturePlan,
    KnobCurve,
    LexemeName,
    PlanKnobs,
    edited_blocks,
)
from gesticulator.sampling.loop import ControlRows, Request

MeantCues = Callable[[float], Sequence["MeantCue"]]
"""Gives the gestures that begin up to a time."""
LONGEST_GESTURE = 4.0
"""Seconds from the start of a named gesture to its apex, or from there to its end, at most (a test measures it)."""
_BROKEN_OFF = 1.2
"""Seconds in which a gesture ends that an interruption breaks off: so long the hands take to hang."""
_VOWEL_SHARE, _EARLY = 0.3, 0.11
"""A stroke falls at this share of its word, less this many seconds. Measured on two read sonnets: the vowel of the
loudest syllable begins there, and a beat of the hand leads the voice by .075 s in the median."""


def still_frames(knobs: PlanKnobs, times: Array, start: float) -> NDArray[np.bool_] | None:
    """[K] whether the knobs require the hands to rest, in the frames at `times` [K] of a block that begins at `start`;
    None if in no frame."""
    ranges = knobs.still_at(start, float(times[-1]))
    return np.any([(times > begin) & (times <= stop) for begin, stop in ranges], axis=0) if ranges else None


def bias_of(bundle: Bundle, hand: str | None) -> NDArray[np.float64] | None:
    """[S] what a handedness adds to an interpreter's scores; None without a handedness."""
    if hand is None:
        return None
    from gesticulator.directing.lexeme_names import handed_bias

    bias = handed_bias(bundle, hand)
    if bias is None:
        raise InputError(f"handedness {hand}", "needs lexemes that can be decoded one by one, and this bundle's cannot",
                         "leave it out")
    return bias


# --------------------------------------------------------------------------------------------------------- cues

@dataclass(frozen=True)
class CueAt:
    """A cue and the time of its stroke, seconds. lexeme: the one it names, or None for a gesture of `GESTURES`."""

    cue: GestureCue
    time: float
    lexeme: int | None = None


@dataclass(frozen=True)
class MeantCue:
    """A gesture that the words call for, or a mark in them. time: of its stroke; broken_off: when an interruption ended
    it, seconds."""

    cue: GestureCue
    time: float
    broken_off: float | None = None


def cues_at(cues: Sequence[GestureCue], words: Sequence[Word], duration: float,
            names: Callable[[], Sequence[LexemeName]]) -> list[CueAt]:
    """The cues of the body with the times of their strokes. names: returns the lexicon's names; called only for
    gestures that are not in `GESTURES`.

    `InputError` for a word that is not spoken, a time beyond the end and an unknown gesture.
    """
    out, spoken = [], dict[str, list[Word]]()
    lexemes: dict[str, int] | None = None
    for word in words if cues else ():
        spoken.setdefault(plain_word(word.text), []).append(word)
    for cue in cues:
        if cue.gesture in EXPRESSIONS:
            continue
        lexeme = None
        if cue.gesture not in GESTURES:
            lexemes = {entry.name: entry.lexeme for entry in names()} if lexemes is None else lexemes
            lexeme = lexemes.get(cue.gesture)
            if lexeme is None:
                raise InputError(f"gesture {shown(cue.gesture)}", "is unknown", near_gestures(cue.gesture, lexemes))
        out.append(CueAt(cue, _time_of(cue, words, spoken, duration), lexeme))
    return out


def expressions_at(cues: Sequence[GestureCue], words: Sequence[Word], duration: float) -> list[tuple[float, str]]:
    """(time, name) of the cues of the face, seconds; raises as `cues_at`."""
    spoken = dict[str, list[Word]]()
    for word in words:
        spoken.setdefault(plain_word(word.text), []).append(word)
    return [(_time_of(cue, words, spoken, duration), cue.gesture) for cue in cues if cue.gesture in EXPRESSIONS]


def _time_of(cue: GestureCue, words: Sequence[Word], spoken: Mapping[str, Sequence[Word]], duration: float) -> float:
    if cue.time is not None:
        if not 0 <= cue.time <= duration:
            raise InputError(f"cue at {cue.time:g} s", f"is not within the {duration:.2f} s of the sound",
                             "choose an earlier time")
        return float(cue.time)
    matches = spoken.get(plain_word(cue.word or ""), ())
    if not words:
        raise InputError(f"cue at the word {shown(cue.word)}", "needs the words of the recording",
                         "give them with --text, or a time instead of the word")
    if len(matches) < cue.occurrence:
        raise InputError(f"cue at the word {shown(cue.word)}, occurrence {cue.occurrence}",
                         f"is impossible: the word is spoken {len(matches)} times", "choose among " + _listed(words))
    return stroke_of_word(matches[cue.occurrence - 1])


def stroke_of_word(word: Word) -> float:
    """Seconds at which the stroke of a word's gesture falls: just before its stressed vowel, as far as the times of the
    word tell. `word_sound.WordSounds.stroke` knows it better where the sound is there."""
    return max(word.start + _VOWEL_SHARE * (word.end - word.start) - _EARLY, 0.0)


def _listed(words: Sequence[Word]) -> str:
    distinct = list(dict.fromkeys(plain_word(word.text) for word in words if plain_word(word.text)))
    return ", ".join(distinct[:30]) + (" ..." if len(distinct) > 30 else "")


def _names(bundle: Bundle) -> Sequence[LexemeName]:
    from gesticulator.directing.lexeme_names import lexeme_names

    return lexeme_names(bundle)


class Director:
    """Turns options into instructions for each block, for files and streams."""

    def __init__(self, bundle: Bundle, options: InferenceOptions, words: Sequence[Word], duration: float) -> None:
        """words: those known so far; duration: seconds, infinite in a stream."""
        self._knobs, self._bias = options.knobs, bias_of(bundle, options.handedness)
        self._cues = [cue for cue in cues_at(options.cues, words, duration, lambda: _names(bundle))
                      if cue.lexeme is not None]

    def request(self, speech: SpeechBlock, times: Array, control: ControlRows | None) -> Request:
        """The request for a block with frames at `times` [K], seconds; control: rows [K, 2 F], or None."""
        start, end = speech.start, float(times[-1])
        lexeme = next((cue.lexeme for cue in self._cues if start < cue.time <= end or cue.time == start == 0.0), None)
        return Request(speech, control, lexeme, still=still_frames(self._knobs, times, start), bias=self._bias)


# -------------------------------------------------------------------------------------------------------- plans

_OF_THE_PLAN = ("speaker", "temperature", "beta", "hand_height", "hand_speed", "hand_radius", "controls")


def planned(options: InferenceOptions) -> InferenceOptions:
    """The options to render the plan of `options`: those of the plan, with the given knobs and cues added to the plan.

    `InputError` for options that the plan determines, and for a plan without the settings that are needed to replay it.
    """
    plan = options.plan
    assert plan is not None
    determined = [name for name in _OF_THE_PLAN if getattr(options, name) is not None]
    if determined or isinstance(options.interpreter, str):
        raise InputError(f"--{(determined or ['interpreter'])[0].replace('_', '-')}", "is determined by the plan",
                         "leave it out, or render without a plan")
    if options.interpreter is not None and interpreter_name(options.interpreter) != plan.interpreter:
        raise InputError(f"interpreter {interpreter_name(options.interpreter)}", f"is not that of the plan, "
                         f"{shown(plan.interpreter)}", "pass the object that the plan was made with")
    settings = plan.made_by.get("settings")
    if not isinstance(settings, dict) or not isinstance(settings.get("temperature"), int | float):
        raise plan.error(("made_by",), "lacks the settings of its generation", "leave it as --plan-out wrote it")
    knobs = plan.knobs
    combined: dict[str, Any] = {
        "intensity": float(options.intensity) if options.intensity != 1.0 else knobs.intensity,
        "mirror": options.mirror or knobs.mirror,
        "energy": options.energy if options.energy != "neutral" else knobs.energy,
        "activity": knobs.activity if options.activity is None else float(options.activity),
        "handedness": options.handedness or knobs.handedness,
        "hold_still": tuple(dict.fromkeys((*knobs.hold_still, *options.hold_still)))}
    plan = replace(plan, knobs=PlanKnobs(**combined), cues=(*plan.cues, *options.cues))
    if options.meaning == "off":
        plan = replace(plan, meanings=tuple(one for one in plan.meanings if one.gesture is None))
    if options.variation:
        plan = replace(plan, blocks=tuple(block if block.locked else replace(block, draw=replace(
            block.draw, variation=int(options.variation))) for block in plan.blocks))
    try:
        return InferenceOptions(
            speaker=plan.speaker, interpreter=options.interpreter or plan.interpreter, seed=plan.seed,
            temperature=settings["temperature"], beta=settings.get("beta"),
            fps=options.fps if options.fps != FPS else settings.get("fps", FPS), gain=settings.get("gain", 0.0),
            controls=_controls(settings, plan), plan=_cued(plan), cues=plan.cues,
            legs=options.legs or settings.get("legs") == "standing",
            seated=options.seated or settings.get("legs") == "seated", face=options.face, mouth=options.mouth,
            mood=options.mood, **combined)
    except (TypeError, ValueError) as error:
        raise plan.error(("made_by", "settings"), f"cannot be used ({error})", "leave it as it was written") from None


def _controls(settings: Mapping[str, Any], plan: GesturePlan) -> Controls | None:
    """The controls of the hands: curves of the plan, else those of its generation."""
    values: dict[str, float | Curve] = {}
    for name in FEATURES:
        value = settings.get(f"hand_{name}")
        if value is not None:
            values[name] = Curve(tuple(value["times"]), tuple(value["values"])) if isinstance(value, dict) else value
    for at, curve in enumerate(plan.curves):
        if curve.knob in FEATURES:
            low, high = LIMITS[curve.knob]
            if not all(low <= value <= high for value in curve.values):
                raise plan.error(("curves", at, "values"), f"are outside of {low:g} to {high:g} {UNITS[curve.knob]}",
                                 "give values within it")
            values[curve.knob] = Curve(curve.times, curve.values)
    return Controls(**values) if values else None


def _words(plan: GesturePlan) -> tuple[Word, ...]:
    return tuple(Word(word.text, word.start, word.end) for word in plan.words)


def _cued(plan: GesturePlan) -> GesturePlan:
    """The plan with the lexemes of its cues in their blocks."""
    blocks = list(plan.blocks)
    for cue in cues_at(plan.cues, _words(plan), plan.duration, lambda: plan.lexicon):
        if cue.lexeme is not None:
            at = next((i for i, block in enumerate(blocks) if cue.time <= block.end), len(blocks) - 1)
            blocks[at] = replace(blocks[at], lexeme=cue.lexeme)
    return replace(plan, blocks=tuple(blocks))


def with_planned_words(speech: Speech, plan: GesturePlan) -> Speech:
    """The speech with the words of the plan, or without words if it has none."""
    return replace(speech, words=_words(plan) or None)


def check_bundle_of(bundle: Bundle, plan: GesturePlan) -> None:
    """`InputError` for a plan of another bundle."""
    made_with = plan.made_by.get("bundle")
    if not isinstance(made_with, dict) or made_with.get("lexicon") != lexicon_hash(bundle.vectors):
        raise plan.error(("made_by", "bundle"), "is another bundle than this one",
                         "render the plan with the bundle that made it")


def check_plan_of(bundle: Bundle, plan: GesturePlan, sound: str) -> None:
    """`InputError` for a plan of another sound or another bundle, or with a lexeme that the bundle does not have.
    sound: the hash of the sound (`sound_hash`)."""
    check_bundle_of(bundle, plan)
    if plan.sound.sha256 != sound:
        raise plan.error(("sound",), f"is {plan.sound.name or 'another sound'}, {plan.sound.duration:.2f} s, and not "
                         "the one that was given", "give the sound that the plan was made for, or add --retime if it "
                         "was exported again")
    size = len(bundle.vectors)
    for at, block in enumerate(plan.blocks):
        if block.lexeme is not None and block.lexeme >= size:
            raise plan.error(("blocks", at, "lexeme"), f"is {block.lexeme}", f"give 0 to {size - 1}, or null")
    if not bundle.system.BLOCKS and any(edited_blocks(plan)):
        raise plan.error(("blocks",), "cannot be generated one by one: this bundle decodes all of its codes together",
                         "use a bundle with a lexicon of blocks")


# ------------------------------------------------------------------------------------------------------- shaping

@dataclass(frozen=True)
class ShapeLevels:
    """What the knobs ask for at M times. arms: sizes of the arms; mirrored: [M] the way to the mirror image."""

    arms: ArmScales
    mirrored: Array


class Shaping:
    """Applies intensity, mirroring and named gestures to generated poses [M, D_m] at rising seconds [M]."""

    def __init__(self, bundle: Bundle, options: InferenceOptions, speaker: int, words: Sequence[Word], edges: Array,
                 meant: MeantCues | None = None) -> None:
        """edges: [N + 1] seconds of the blocks; without a plan, the start and the end (infinity for a stream) are
        enough. meant: called with the last of the seconds, gives the gestures that the words call for."""
        representation = representation_of(bundle.config)
        if representation.name != "rotations":
            raise InputError("intensity, energy, handedness, cues and plans", "need a bundle of joint rotations, and "
                             "this one has joint positions", "leave them out")
        self._edges, self._meant, self._seed = edges, meant, options.seed or 0
        self._sizes, self._both, self._mirrored, self._locked = _levels(options, len(edges) - 1)
        self._curves = [] if options.plan is None else _sizing(options.plan)
        self._shares = [eased_levels(edges, rest_share(side), REST_FADE, self._locked) for side in self._sizes.T]
        cues = cues_at(options.cues, words, float(edges[-1]), lambda: _names(bundle))
        self._cues = sorted([(cue.cue, cue.time) for cue in cues if cue.lexeme is None], key=_by_time)
        self._shaper = Shaper(bundle.statistics, representation, speaker)

    def levels(self, times: Array) -> ShapeLevels:
        """The levels at `times` [M]."""
        edges, locked = self._edges, self._locked
        intensity = np.stack([levels_at(edges, side, times, FADE, locked) for side in self._sizes.T], axis=1)
        share = np.stack([levels_at(edges, side, times, REST_FADE, locked) for side in self._shares], axis=1)
        if self._curves:
            factor = _sizes_at(self._curves[0], times)
            for curve in self._curves[1:]:
                factor = factor * _sizes_at(curve, times)
            factor = 1.0 + (factor - 1.0) * levels_at(edges, 1.0 - locked, times, FADE, locked)
            intensity = np.minimum(intensity * factor[:, None], 2.0)
            share = share * rest_share(np.minimum(factor, 1.0))[:, None]
        return ShapeLevels(ArmScales(intensity, share, levels_at(edges, self._both, times, REST_FADE, locked)),
                           levels_at(edges, self._mirrored, times, MIRROR_FADE, locked))

    def named(self, times: Array) -> list[MeantCue]:
        """The gestures that may be made within `times`, by the times of their strokes."""
        if not len(times):
            return []
        begin, end = float(times[0]) - LONGEST_GESTURE, float(times[-1]) + LONGEST_GESTURE
        cues = self._cues[bisect_left(self._cues, begin, key=_by_time):bisect_right(self._cues, end, key=_by_time)]
        called = [one for one in self._meant(float(times[-1])) if begin <= one.time <= end] if self._meant else []
        return sorted([*(MeantCue(cue, time) for cue, time in cues), *called], key=lambda one: one.time)

    def __call__(self, poses: Array, times: Array) -> Array:
        """The next poses."""
        levels = self.levels(times)
        poses = self._shaper.mirrored(self._shaper.shaped(poses, times, levels.arms), levels.mirrored)
        return _with_gestures(poses, times, self.named(times), self._seed)


def gestures_over(meant: MeantCues, seed: int) -> Callable[[Array, Array], Array]:
    """A function that lays named gestures over generated poses [M, 3 J] at seconds [M] and changes nothing else.

    meant: called with the last of the seconds, gives the gestures; seed: of their variation.
    """
    def shape(poses: Array, times: Array) -> Array:
        return _with_gestures(poses, times, meant(float(times[-1])), seed) if len(times) else poses

    return shape


def _by_time(cue: tuple[GestureCue, float]) -> float:
    return cue[1]


def _with_gestures(poses: Array, times: Array, cues: Sequence[MeantCue], seed: int) -> Array:
    """Poses [M, D] at seconds [M] with named gestures, and with those that were broken off as they end; seed: of their
    variation."""
    if not cues:
        return poses
    from gesticulator.directing.named_gestures import laid_over

    for one in cues:
        if one.broken_off is None:
            continue
        whole = laid_over(poses, times, [(one.cue, one.time)], seed)
        share = np.clip((times - one.broken_off) / _BROKEN_OFF, 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        poses = np.where(share[:, None] == 1.0, poses, np.where(share[:, None] == 0.0, whole, whole + share[:, None] * (
            nearest_turn(poses.reshape(len(poses), -1, 3), whole.reshape(len(poses), -1, 3)).reshape(poses.shape)
            - whole)))
    played = sorted((one for one in cues if one.broken_off is None), key=lambda one: one.time)
    return laid_over(poses, times, [(one.cue, one.time) for one in played], seed)


def _levels(options: InferenceOptions, count: int) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Of N blocks: [N, 2] intensities of the left and the right hand; [N] 1.0 where each hand joins in the other's
    strokes; [N] 1.0 where the block is mirrored; [N] whether it is locked."""
    if options.plan is None:
        both = np.full(count, float(options.handedness == "both"))
        return np.array([_hands(options.knobs)] * count), both, np.zeros(count), np.zeros(count, bool)
    now, first = options.plan.knobs, options.plan.drawn.knobs
    locked = [block.locked for block in options.plan.blocks]
    hands = np.where(np.array(locked)[:, None], _hands(first), _hands(now, _steady_energy(options.plan)))
    sizes = np.minimum(np.array([block.intensity for block in options.plan.blocks])[:, None] * hands, 2.0)
    whole = options.mirrored
    mirrored = [block.mirror != (not whole and (first if block.locked else now).mirror)
                for block in options.plan.blocks]
    both = np.where(locked, float(first.handedness == "both"), float(now.handedness == "both"))
    return sizes, both, np.array(mirrored, dtype=np.float64), np.array(locked)


def _hands(knobs: PlanKnobs, factor: float = 1.0) -> tuple[float, float]:
    """Intensities of the left and the right hand. factor: on the size, by a curve that is constant."""
    size = min(knobs.size * factor, 2.0)
    return (size * (OTHER_HAND if knobs.handedness == "right" else 1.0),
            size * (OTHER_HAND if knobs.handedness == "left" else 1.0))


def _sizing(plan: GesturePlan) -> list[KnobCurve]:
    """The curves that vary the size of gestures; one of energy that is constant is as the knob (`_steady_energy`)."""
    intensity, energy = plan.curve("intensity"), plan.curve("energy")
    return [curve for curve in (intensity, None if _is_steady(energy) else energy) if curve is not None]


def _is_steady(curve: KnobCurve | None) -> bool:
    return curve is not None and len(set(curve.values)) == 1


def _steady_energy(plan: GesturePlan) -> float:
    """The factor on intensity of a curve of energy that is constant; 1 for another one, and without one."""
    curve = plan.curve("energy")
    return float(_sizes_at(curve, np.zeros(1))[0]) if curve is not None and _is_steady(curve) else 1.0


def _sizes_at(curve: KnobCurve, times: Array) -> Array:
    """[M] the factor on intensity at `times` [M] of a curve of intensity or of energy."""
    values: Array = np.interp(times, curve.times, curve.values)
    return np.interp(values, np.arange(len(ENERGIES)), ENERGY_SIZES) if curve.knob == "energy" else values

"""From what a user asks (options, knobs, cues, a plan) to what is done about it: directions and changes of poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.controls import FEATURES, Controls, Curve
from data_module.errors import InputError, shown
from data_module.types import Array, Blocks, Speech, Word
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.bundle.files import lexicon_hash
from gesticulator.directing.editing import still_frames
from gesticulator.directing.shaping import (
    FADE,
    MIRROR_FADE,
    OTHER_HAND,
    REST_FADE,
    AskedSizes,
    Shaper,
    eased_levels,
    left_by,
    levels_at,
)
from gesticulator.drawing.drawer import Direction
from gesticulator.options import FPS, InferenceOptions, interpreter_name
from gesticulator.plan.plan import GESTURES, GestureCue, GesturePlan, LexemeName, PlanKnobs, edited_blocks, sound_hash

Shaping = Callable[[Array, Array], Array]
_PUNCTUATION = " .,;:!?\"'“”‘’„«»()[]-–—…¿¡"


def bias_of(bundle: Bundle, hand: str | None) -> NDArray[np.float64] | None:
    """[S] what a handedness adds to an interpreter's scores; None for none."""
    if hand is None:
        return None
    from gesticulator.directing.lexeme_names import handed_bias

    bias = handed_bias(bundle, hand)
    if bias is None:
        raise InputError(f"handedness {hand}", "needs lexemes that can be looked at one by one, and this bundle's "
                         "cannot", "leave it out")
    return bias


# --------------------------------------------------------------------------------------------------------- cues

@dataclass(frozen=True)
class CueAt:
    """A cue and the second at which its stroke arrives. lexeme: what it asks of the lexicon, or None."""

    cue: GestureCue
    time: float
    lexeme: int | None = None


def cues_at(cues: Sequence[GestureCue], words: Sequence[Word], duration: float,
            names: Callable[[], Sequence[LexemeName]]) -> list[CueAt]:
    """When each cue is due. names: of the lexicon, asked only for a gesture that is none of `GESTURES`.

    `InputError` for a word that is not said, a time beyond the end and a gesture that nobody knows.
    """
    out = []
    for cue in cues:
        lexeme = None
        if cue.gesture not in GESTURES:
            lexeme = next((one.lexeme for one in names() if one.name == cue.gesture), None)
            if lexeme is None:
                raise InputError(f"gesture {shown(cue.gesture)}", "is unknown", f"choose among {', '.join(GESTURES)}, "
                                 "or a name of the lexicon (gesticulator plan names)")
        out.append(CueAt(cue, _time_of(cue, words, duration), lexeme))
    return out


def _time_of(cue: GestureCue, words: Sequence[Word], duration: float) -> float:
    if cue.time is not None:
        if not 0 <= cue.time <= duration:
            raise InputError(f"cue at {cue.time:g} s", f"is not in the {duration:.2f} s of the sound",
                             "choose a time in it")
        return float(cue.time)
    wanted = plain_word(cue.word or "")
    said = [word for word in words if plain_word(word.text) == wanted]
    if not words:
        raise InputError(f"cue at the word {shown(cue.word)}", "needs the words", "give them with --text, or a time")
    if len(said) < cue.occurrence:
        raise InputError(f"cue at the word {shown(cue.word)}", f"is said {len(said)} times, and "
                         f"{cue.occurrence} is asked for", "choose among " + _listed(words))
    word = said[cue.occurrence - 1]
    # The stroke arrives with the word's stressed part, which no transcript tells: a third into it.
    return word.start + (word.end - word.start) / 3.0


def plain_word(text: str) -> str:
    """A word without punctuation and capitals, as cues are compared."""
    return text.strip(_PUNCTUATION).casefold()


def _listed(words: Sequence[Word]) -> str:
    every = list(dict.fromkeys(plain_word(word.text) for word in words if plain_word(word.text)))
    return ", ".join(every[:30]) + (" ..." if len(every) > 30 else "")


def _names(bundle: Bundle) -> Sequence[LexemeName]:
    from gesticulator.directing.lexeme_names import lexeme_names

    return lexeme_names(bundle)


class Director:
    """Says of each block what the options ask for, in a file and in a stream."""

    def __init__(self, bundle: Bundle, options: InferenceOptions, words: Sequence[Word], duration: float) -> None:
        """words: what is said, as far as it is known; duration: seconds, infinite in a stream."""
        self._knobs, self._bias = options.knobs, bias_of(bundle, options.handedness)
        self._due = [one for one in cues_at(options.cues, words, duration, lambda: _names(bundle))
                     if one.lexeme is not None]

    def direction(self, times: Array, start: float) -> Direction:
        """Of the block with frames at `times` [K] seconds, which begins at `start`."""
        end = float(times[-1])
        lexeme = next((one.lexeme for one in self._due if start < one.time <= end or one.time == start == 0.0), None)
        return Direction(lexeme, still=still_frames(self._knobs, times, start), bias=self._bias)


def directions(bundle: Bundle, options: InferenceOptions, speech: Speech, blocks: Blocks) -> list[Direction]:
    """What the options say of each block of a first drawing."""
    director = Director(bundle, options, speech.words or (), float(blocks.edges[-1]))
    times = blocks.knot_times.reshape(len(blocks), -1)
    return [director.direction(own, float(start)) for own, start in zip(times, blocks.edges, strict=False)]


# -------------------------------------------------------------------------------------------------------- plans

_OF_THE_PLAN = ("speaker", "temperature", "beta", "hand_height", "hand_speed", "hand_radius", "controls")


def planned(options: InferenceOptions) -> InferenceOptions:
    """The options of a rendering: the plan's, with the knobs and cues that were given beside it put into the plan.

    `InputError` for what belongs to the first drawing, and where the plan lacks what is needed to replay it.
    """
    plan = options.plan
    assert plan is not None
    for name in _OF_THE_PLAN:
        if getattr(options, name) is not None:
            raise InputError(f"--{name.replace('_', '-')}", "belongs to what the plan replays",
                             "leave it out, or render without a plan")
    if isinstance(options.interpreter, str):
        raise InputError("--interpreter", "belongs to what the plan replays", "leave it out, or render without a plan")
    if options.interpreter is not None and interpreter_name(options.interpreter) != plan.interpreter:
        raise InputError(f"interpreter {interpreter_name(options.interpreter)}", f"is not that of the plan, "
                         f"{shown(plan.interpreter)}", "pass the object that the plan was made with")
    settings = plan.made_by.get("settings")
    if not isinstance(settings, dict) or not isinstance(settings.get("temperature"), int | float):
        raise plan.error(("made_by",), "does not tell how it was drawn", "leave it as --plan-out wrote it")
    knobs = plan.knobs
    given: dict[str, Any] = {
        "intensity": float(options.intensity) if options.intensity != 1.0 else knobs.intensity,
        "mirror": options.mirror or knobs.mirror,
        "energy": options.energy if options.energy != "neutral" else knobs.energy,
        "activity": knobs.activity if options.activity is None else float(options.activity),
        "handedness": options.handedness or knobs.handedness,
        "hold_still": tuple(dict.fromkeys((*knobs.hold_still, *options.hold_still)))}
    plan = replace(plan, knobs=PlanKnobs(**given), cues=(*plan.cues, *options.cues))
    if options.variation:
        plan = replace(plan, blocks=tuple(block if block.locked else replace(block, draw=replace(
            block.draw, variation=int(options.variation))) for block in plan.blocks))
    try:
        return InferenceOptions(
            speaker=plan.speaker, interpreter=options.interpreter or plan.interpreter, seed=plan.seed,
            temperature=settings["temperature"], beta=settings.get("beta"),
            fps=options.fps if options.fps != FPS else settings.get("fps", FPS), gain=settings.get("gain", 0.0),
            controls=_controls(settings), plan=_cued(plan), cues=plan.cues,
            legs=options.legs or settings.get("legs") == "standing",
            seated=options.seated or settings.get("legs") == "seated", **given)
    except (TypeError, ValueError) as error:
        raise plan.error(("made_by", "settings"), f"cannot be used ({error})", "leave it as it was written") from None


def _controls(settings: Mapping[str, Any]) -> Controls | None:
    given = {}
    for name in FEATURES:
        value = settings.get(f"hand_{name}")
        if value is not None:
            given[name] = Curve(tuple(value["times"]), tuple(value["values"])) if isinstance(value, dict) else value
    return Controls(**given) if given else None


def _cued(plan: GesturePlan) -> GesturePlan:
    """The plan with the lexemes that its cues ask for in their blocks."""
    words = [Word(word.text, word.start, word.end) for word in plan.words]
    blocks = list(plan.blocks)
    for due in cues_at(plan.cues, words, plan.duration, lambda: plan.lexicon):
        if due.lexeme is not None:
            at = next((i for i, block in enumerate(blocks) if due.time <= block.end), len(blocks) - 1)
            blocks[at] = replace(blocks[at], lexeme=due.lexeme)
    return replace(plan, blocks=tuple(blocks))


def with_planned_words(speech: Speech, plan: GesturePlan) -> Speech:
    """The speech with the words of the plan, where they were read."""
    if not plan.words:
        return replace(speech, words=None)
    return replace(speech, words=tuple(Word(word.text, word.start, word.end) for word in plan.words))


def check_plan_of(bundle: Bundle, plan: GesturePlan, speech: Speech) -> None:
    """`InputError` where a plan is of another sound or of another bundle, or names lexemes that there are not."""
    theirs = plan.made_by.get("bundle")
    if not isinstance(theirs, dict) or theirs.get("lexicon") != lexicon_hash(bundle.vectors):
        raise plan.error(("made_by", "bundle"), "is another bundle than this one",
                         "render it with the one that made it")
    if plan.sound.sha256 != sound_hash(speech):
        raise plan.error(("sound",), f"is {plan.sound.name or 'another sound'}, {plan.sound.duration:.2f} s, and not "
                         "the one that was given", "give the sound that the plan was made of")
    size = len(bundle.vectors)
    for at, block in enumerate(plan.blocks):
        if block.lexeme is not None and block.lexeme >= size:
            raise plan.error(("blocks", at, "lexeme"), f"is {block.lexeme}", f"give 0 to {size - 1}, or null")
    if not bundle.system.blocks and any(edited_blocks(plan)):
        raise plan.error(("blocks",), "cannot be drawn anew: this bundle decodes all of its codes together",
                         "use a bundle with a lexicon of blocks")


# ------------------------------------------------------------------------------------------------------- shaping

def shaping(bundle: Bundle, options: InferenceOptions, speaker: int, words: Sequence[Word], edges: Array) -> Shaping:
    """What intensity, mirrored blocks and gestures by name make of drawn poses [M, D_m] at seconds [M].

    edges: [N + 1] seconds of the blocks; without a plan from the start to the end (of a stream: infinity) is enough.
    """
    representation = representation_of(bundle.config)
    if representation.name != "rotations":
        raise InputError("intensity, energy, handedness, cues and plans", "need a bundle of joint rotations, and this "
                         "one has places", "leave them out")
    sizes, both, mirrored, kept = _levels(options, len(edges) - 1)
    left = [eased_levels(edges, left_by(own), REST_FADE, kept) for own in sizes.T]
    due = [one for one in cues_at(options.cues, words, float(edges[-1]), lambda: _names(bundle)) if one.lexeme is None]
    shaper = Shaper(bundle.statistics, representation, speaker)

    def shape(poses: Array, times: Array) -> Array:
        poses = shaper.shaped(poses, times, AskedSizes(
            np.stack([levels_at(edges, own, times, FADE, kept) for own in sizes.T], axis=1),
            np.stack([levels_at(edges, own, times, REST_FADE, kept) for own in left], axis=1),
            levels_at(edges, both, times, REST_FADE, kept)))
        poses = shaper.mirrored(poses, levels_at(edges, mirrored, times, MIRROR_FADE, kept))
        if due:
            from gesticulator.directing.named_gestures import laid_over

            poses = laid_over(poses, times, [(one.cue, one.time) for one in due])
        return poses

    return shape


def _levels(options: InferenceOptions, count: int) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """[N, 2] intensities of the left and the right hand; [N] whether both take part, and whether the block is mirrored,
    0 or 1; [N] whether it is locked."""
    if options.plan is None:
        both = np.full(count, float(options.handedness == "both"))
        return np.array([_hands(options.knobs)] * count), both, np.zeros(count), np.zeros(count, bool)
    now, then = options.plan.knobs, options.plan.drawn.knobs
    kept = [block.locked for block in options.plan.blocks]
    hands = np.where(np.array(kept)[:, None], _hands(then), _hands(now))
    sizes = np.minimum(np.array([block.intensity for block in options.plan.blocks])[:, None] * hands, 2.0)
    whole = options.mirrored
    mirrored = [block.mirror != (not whole and (then if block.locked else now).mirror) for block in options.plan.blocks]
    both = np.where(kept, float(then.handedness == "both"), float(now.handedness == "both"))
    return sizes, both, np.array(mirrored, dtype=np.float64), np.array(kept)


def _hands(knobs: PlanKnobs) -> tuple[float, float]:
    """Intensities of the left and the right hand."""
    return (knobs.size * (OTHER_HAND if knobs.handedness == "right" else 1.0),
            knobs.size * (OTHER_HAND if knobs.handedness == "left" else 1.0))

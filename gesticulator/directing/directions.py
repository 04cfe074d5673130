"""From options, knobs, cues and plans to instructions for each block, and whether a plan fits its sound and bundle."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.controls import FEATURES, Controls, Curve
from data_module.errors import InputError, shown
from data_module.types import Array, Speech, Word
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock
from gesticulator.bundle.files import lexicon_hash
from gesticulator.directing.cues import cues_at
from gesticulator.directing.lexeme_names import lexeme_names
from gesticulator.options import FPS, HAND_LIMITS, HAND_UNITS, InferenceOptions, interpreter_name
from gesticulator.plan.plan import GesturePlan, PlanKnobs, edited_blocks
from gesticulator.sampling.loop import ControlRows, Request


def still_frames(knobs: PlanKnobs, times: Array, start: float) -> NDArray[np.bool_] | None:
    """[K] whether the hands are to rest, at `times` [K] of a block that begins at `start`; None if nowhere."""
    ranges = knobs.still_at(start, float(times[-1]))
    return np.any([(times > begin) & (times <= stop) for begin, stop in ranges], axis=0) if ranges else None


class Director:
    """Turns options into instructions for each block, for files and streams."""

    def __init__(self, bundle: Bundle, options: InferenceOptions, words: Sequence[Word], duration: float) -> None:
        """words: those known so far; duration: seconds, infinite in a stream."""
        self._knobs = options.knobs
        self._cues = [cue for cue in cues_at(options.cues, words, duration, lambda: lexeme_names(bundle))
                      if cue.lexeme is not None]

    def request(self, speech: SpeechBlock, times: Array, control: ControlRows | None) -> Request:
        """The request for a block with frames at `times` [K], seconds; control: rows [K, 2 F], or None."""
        # A cue at a beat belongs to the block that ends there, as a stroke does; one at 0 has only the first block.
        start, end = speech.start, float(times[-1])
        lexeme = next((cue.lexeme for cue in self._cues if start < cue.time <= end or cue.time == start == 0.0), None)
        still = still_frames(self._knobs, times, start)
        return Request(speech, control, lexeme, still=still, wanted=lexeme is not None)


# -------------------------------------------------------------------------------------------------------- plans

# They were drawn into the plan's lexemes and random numbers: another value would contradict what is replayed.
_OF_THE_PLAN = ("speaker", "temperature", "hand_height", "hand_speed", "hand_radius", "controls")


def planned(options: InferenceOptions) -> InferenceOptions:
    """The options to render the plan of `options`: those of the plan, with the given knobs and cues added to the plan.
    `InputError` for options that the plan determines, and for a plan without the settings that are needed to replay
    it."""
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
    # An option that is given overrides the plan's knob; one at its default leaves it alone.
    combined: dict[str, Any] = {
        "intensity": float(options.intensity) if options.intensity != 1.0 else knobs.intensity,
        "mirror": options.mirror or knobs.mirror,
        "energy": options.energy if options.energy != "neutral" else knobs.energy,
        "activity": knobs.activity if options.activity is None else float(options.activity),
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
            temperature=settings["temperature"],
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
            low, high = HAND_LIMITS[curve.knob]
            if not all(low <= value <= high for value in curve.values):
                within = f"{low:g} to {high:g} {HAND_UNITS[curve.knob]}"
                raise plan.error(("curves", at, "values"), f"are outside of {within}", "give values within it")
            values[curve.knob] = Curve(curve.times, curve.values)
    return Controls(**values) if values else None


def _words(plan: GesturePlan) -> tuple[Word, ...]:
    return tuple(Word(word.text, word.start, word.end) for word in plan.words)


def _cued(plan: GesturePlan) -> GesturePlan:
    # Cues of lexemes are choices of blocks; those of named gestures are blended over the motion later.
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
    made_with: Any = plan.made_by.get("bundle")
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

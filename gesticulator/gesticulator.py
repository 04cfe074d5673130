"""The product in Python: `Gesticulator.from_pretrained()("speech.wav")` gives a `Performance`."""

from __future__ import annotations

import difflib
import os
import warnings
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.controls import FEATURES, LEVELS, Controls, Curve, Levels
from data_module.errors import InputError, shown
from data_module.speech.audio import SAMPLE_RATE, SpeechInput, amplified, as_speech, resample
from data_module.types import Blocks, Speech
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.bundle import load as load_bundle
from gesticulator.bundle.features import SpeechFeatures, front_end_for
from gesticulator.bundle.files import bundle_folder
from gesticulator.options import HAND_LIMITS, HAND_UNITS, HandControl, InferenceOptions
from gesticulator.performance import Assembler, Performance
from gesticulator.plan.plan import ENERGIES, named, sound_hash, words_of
from gesticulator.sampling import loop
from gesticulator.sampling.cutter import BlockCutter, encode_speech
from gesticulator.sampling.loop import BlockMotion, GeneratedMotion, Generation, Request, Setup, controls_at
from interpreters import INTERPRETERS
from interpreters.base import as_interpreter

if TYPE_CHECKING:
    from data_module.text.transcript import Text
    from data_module.text.word_vectors import WordEncoder
    from gesticulator.directing.lexeme_names import LexemeName
    from gesticulator.editing.render import PlanRenderer
    from gesticulator.editing.retiming import Retimed
    from gesticulator.plan.plan import GesturePlan
    from gesticulator.stream import Stream

__all__ = ["Gesticulator"]

# Spreads from the mean of the training data beyond which a hand control is far from them.
_FAR = 3.0


class ControlWarning(UserWarning):
    """A control value is valid, but far from the training data."""


class Gesticulator:
    """A loaded bundle that turns speech into gesture, block by block (RG 6, Eq. 15)."""

    def __init__(self, bundle: Bundle) -> None:
        self.bundle = bundle
        # One for all performances: it remembers interpreter objects and warnings that were given.
        self.resolver = SetupResolver(bundle)
        self.keeps_generations = False
        """Whether performances keep the state before each block (`Performance.generation`), from which edits start."""
        self.on_block: loop.OnBlock | None = None  # of the recording that is being generated
        self._front_end = front_end_for(bundle.config, bundle.runners.get("encoder"))
        self._names: tuple[LexemeName, ...] | None = None

    @classmethod
    def from_pretrained(cls, path: str | os.PathLike[str] | None = None, revision: str | None = None) -> Gesticulator:
        """Load a bundle: "default" (also if none is given), "paper", a folder, or "org/name" of a hub, at a revision.

        Output is bit for bit reproducible on one machine with the same number of threads.
        """
        return cls(load_bundle(bundle_folder(path if revision is None else f"{path}@{revision}")))

    @property
    def reads_text(self) -> bool:
        """True when the bundle has an interpreter that reads the words."""
        return "interpreter_text" in self.bundle.parts

    def lexeme_names(self) -> tuple[LexemeName, ...]:
        """A name for each lexeme of the bundle (`gesticulator.directing.lexeme_names`), computed on the first call."""
        from gesticulator.directing.lexeme_names import lexeme_names

        if self._names is None:
            self._names = lexeme_names(self.bundle)
        return self._names

    @cached_property
    def word_encoder(self) -> WordEncoder:
        """The word encoder that the bundle was trained with."""
        self._check_reads_text()
        assert self.bundle.text is not None
        return self.bundle.text.open()

    # ------------------------------------------------------------------------------------------------- recordings

    def __call__(self, speech: SpeechInput, sample_rate: float | None = None, *, text: Text | None = None,
                 encoded: SpeechFeatures | None = None, **options: Any) -> Performance:
        """Gesture for a recording.

        speech: the path of a sound file, samples [n] or [n, channels] with their `sample_rate` in hertz, or a `Speech`,
        with or without words. text: the spoken text as a `str`, or the path of a transcript (plain text, TextGrid, SRT,
        VTT, JSON). Without words the audio-only models are used (RG 6.3). encoded: the result of `encode_speech` for
        this speech, to avoid encoding it again. options: the fields of `InferenceOptions`. `InputError` for unusable
        input.

        >>> g = Gesticulator.from_pretrained()
        >>> g("speech.wav", text="Hello there", hand_height="low", seed=3).save("gesture.bvh")
        """
        checked = InferenceOptions(**options)
        if checked.transcribe is not None and text is not None:
            raise InputError("transcribe", "hears words, and text gives them", "leave one of them out")
        # A plan brings its own gain, so the sound is prepared after the plan is read.
        recording = as_speech(speech, sample_rate)
        name = Path(speech).name if isinstance(speech, str | os.PathLike) else ""
        if checked.plan is not None:
            performance = self._of_plan(recording, checked, text)
            return performance.labelled(name, performance.decided.notes)
        recording, note = self._with_words(_prepared(recording, checked), text, checked.transcribe)
        # The words are in the speech from here on, and in the plan.
        checked = replace(checked, transcribe=None)
        if checked.cues:
            from gesticulator.directing.cues import without_mismatches

            checked = without_mismatches(checked, recording.words or ())
        performance = self._generate(recording, checked, encoded)
        return performance.labelled(name, () if note is None else (note,))

    def encode_speech(self, speech: Speech, blocks: Blocks | None = None, cutters: list[BlockCutter] | None = None
                      ) -> SpeechFeatures:
        """Cut a speech at 16 kHz into blocks, or into the given ones, and encode it, with its words if the bundle reads
        text. cutters: see `cutter.encode_speech`."""
        words = self.word_encoder if self._reads_words_of(speech) else None
        return encode_speech(speech, self.bundle.config, self._front_end, words, blocks, cutters)

    def assembler(self, speech: Speech, options: InferenceOptions) -> Assembler:
        """What makes performances out of generated blocks of a speech at 16 kHz."""
        return Assembler(self.bundle, speech, options, self._setup(speech, options))

    def _setup(self, speech: Speech, options: InferenceOptions) -> Setup:
        return self.resolver.setup(options, self._reads_words_of(speech))

    def _reads_words_of(self, speech: Speech) -> bool:
        return self.reads_text and any(word.text.strip() for word in speech.words or ())

    def _check_reads_text(self) -> None:
        if not self.reads_text:
            raise InputError("text", "is not read by this bundle", "use a bundle trained with text, or leave it out")

    def _with_words(self, speech: Speech, text: Text | None, model: str | os.PathLike[str] | None
                    ) -> tuple[Speech, str | None]:
        """The speech with the words of a text (`str`) or a transcript file, or those that a recogniser hears, and a
        line on their times. model: of the recogniser, which a speech with words does not need."""
        if text is None and (model is None or speech.words):
            return speech, None
        self._check_reads_text()
        from data_module.text.transcript import as_transcript, with_transcript

        if text is not None:
            transcript = as_transcript(text, speech)
        else:
            from data_module.text.transcription import transcribed

            assert model is not None
            heard = transcribed(speech, model)
            if heard is None:
                return speech, "no words heard"
            transcript = heard
        with_words, timing = with_transcript(speech, transcript)
        return with_words, timing.note

    def _generate(self, speech: Speech, options: InferenceOptions, encoded: SpeechFeatures | None) -> Performance:
        """A first generation, for speech at 16 kHz with its words."""
        # Marks in the text ([shrug]) become cues; the words themselves are read without them.
        if any(word.marks for word in speech.words or ()):
            from gesticulator.directing.marks import with_mark_cues

            options = with_mark_cues(options, speech.words or (), speech.duration)
        setup = self._setup(speech, options)
        generated, generation = self._looped(speech, options, setup, encoded)
        performance = self.assemble(Assembler(self.bundle, speech, options, setup), generated)
        return performance if generation is None else replace(performance, generation=generation)

    def _looped(self, speech: Speech, options: InferenceOptions, setup: Setup, encoded: SpeechFeatures | None
                ) -> tuple[GeneratedMotion, Generation | None]:
        """The generated blocks, and what edits start from if generations are kept. The features of the sound, 56 MB for
        an hour of mel bands, end with this call."""
        # Copies of the cutter let an edited beat be cut again without the whole sound.
        cutters: list[BlockCutter] | None = [] if self.keeps_generations else None
        encoded = self.encode_speech(speech, cutters=cutters) if encoded is None else encoded
        state = loop.begin(self.bundle, setup, encoded.text is not None)
        states, blocks = [state], list[BlockMotion]()
        for request in self._requests(speech, options, setup, encoded):
            block, state = loop.step(self.bundle, setup, state, request)
            blocks.append(block)
            if self.keeps_generations:
                states.append(state)
            if self.on_block is not None:
                self.on_block(len(blocks), len(encoded))
        generated = GeneratedMotion(encoded.blocks, blocks, self.bundle.system.motion_of(self.bundle, setup, blocks))
        return generated, Generation(encoded, blocks, states, cutters or ()) if self.keeps_generations else None

    def _requests(self, speech: Speech, options: InferenceOptions, setup: Setup, encoded: SpeechFeatures
                  ) -> list[Request]:
        """A request for each of the N blocks of a first generation."""
        times = encoded.blocks.knot_times.reshape(len(encoded), -1)
        parts = [(encoded.block(i), controls_at(self.bundle.levels, setup.controls, times[i]))
                 for i in range(len(encoded))]
        if not options.directed:
            return [Request(block, control) for block, control in parts]
        from gesticulator.directing.directions import Director

        # Directions are resolved to block times once: cues and stillness.
        director = Director(self.bundle, options, speech.words or (), float(encoded.blocks.edges[-1]))
        return [director.request(block, knots, control)
                for (block, control), knots in zip(parts, times, strict=True)]

    def assemble(self, assembler: Assembler, generated: GeneratedMotion) -> Performance:
        """The performance of generated blocks."""
        return assembler.performance(generated, self.lexeme_names)

    # ------------------------------------------------------------------------------------------------------ plans

    def _of_plan(self, speech: Speech, options: InferenceOptions, text: Text | None) -> Performance:
        """The performance of the plan of the options, which is first moved onto this sound if they say so."""
        from gesticulator.directing import directions as directing

        assert options.plan is not None
        retiming = None
        if options.retime:
            from gesticulator.directing.cues import OptionWarning

            moved = self.retimed(options.plan, speech, text=text)
            retiming = str(moved)
            for line in moved.losses:
                warnings.warn(OptionWarning(line), stacklevel=4)
            options = replace(options, plan=moved.plan, retime=False)
        options = directing.planned(options)
        assert options.plan is not None
        performance = self.render(directing.with_planned_words(_prepared(speech, options), options.plan), options)
        return replace(performance, retiming=retiming).labelled(
            "", (retiming,) if retiming else performance.decided.notes)

    def render(self, speech: Speech, options: InferenceOptions, renderer: PlanRenderer | None = None
               ) -> Performance:
        """Render the plan of the options (as returned by `directing.planned`) for a speech at 16 kHz.

        renderer: the `plan_renderer` of the same first generation; then only edited blocks are generated.
        """
        from gesticulator.directing.directions import check_plan_of

        assert options.plan is not None
        # Lexemes are numbers in one lexicon, and times belong to one sound.
        check_plan_of(self.bundle, options.plan, sound_hash(speech))
        renderer = renderer or self.plan_renderer(speech, options)
        performance = self.assemble(self.assembler(speech, options), renderer.render(options.plan, self.on_block))
        return replace(performance, generation=renderer.generation()) if self.keeps_generations else performance

    def plan_renderer(self, speech: Speech, options: InferenceOptions, generation: Generation | None = None
                      ) -> PlanRenderer:
        """A renderer for all plans of one first generation; each then costs only its edited blocks. speech: at 16 kHz.

        options: with a plan of that generation, as returned by `directing.planned`; generation: the first one, if it
        was kept.
        """
        from gesticulator.editing.render import PlanRenderer

        plan = options.plan
        assert plan is not None
        return PlanRenderer(self.bundle, self._setup(speech, options), speech.samples,
                            partial(self.encode_speech, speech), plan, generation)

    def retimed(self, plan: GesturePlan, speech: SpeechInput, sample_rate: float | None = None, *,
                text: Text | None = None) -> Retimed:
        """A plan on another export of its sound, and a report of what was kept, moved, decided anew and lost
        (`gesticulator.editing.retiming`).

        speech, sample_rate: the new sound, as in `__call__`; text: its text or transcript, if its words are others.
        `InputError` for a sound that has too little of the old speech, and for a plan of another bundle.
        """
        from gesticulator.directing import directions as directing
        from gesticulator.editing import retiming

        directing.check_bundle_of(self.bundle, plan)
        recording = _prepared(as_speech(speech, sample_rate), directing.planned(InferenceOptions(plan=plan)))
        # Words of the new file are not read: those of the plan are moved, or the given text is aligned.
        recording = replace(recording, words=None)
        words = None if text is None else words_of(self._with_words(recording, text, None)[0])
        if words is None and sound_hash(recording) == plan.sound.sha256:
            return retiming.Retimed(plan, len(plan.blocks))
        draft = retiming.drafted(plan, recording, self.encode_speech(recording), words)
        # Blocks whose beats found no counterpart are decided anew by the models.
        if None not in draft.plan.drawn.lexemes:
            return draft
        renderer = self.plan_renderer(directing.with_planned_words(recording, draft.plan),
                                      directing.planned(InferenceOptions(plan=draft.plan)))
        return replace(draft, plan=named(retiming.decided(draft.plan, renderer.generation().blocks),
                                         self.lexeme_names()))

    # ---------------------------------------------------------------------------------------------------- streams

    def stream(self, sample_rate: float = SAMPLE_RATE, *, latency: str = "full", text: bool = False,
               **options: Any) -> Stream:
        """Gesture for speech as it arrives, see `gesticulator.stream.Stream`.

        sample_rate: hertz of the sound that will be fed; latency: "full" or "low" (`BlockCutter`); text: words will be
        added; options: the fields of `InferenceOptions`. Several streams may share a `Gesticulator`. Models load when
        they are first used, in a tenth of a second; the one that reads words takes a third.
        """
        from gesticulator.stream import Stream

        checked = InferenceOptions(**options)
        if checked.transcribe is not None:
            raise InputError("transcribe", "is not for streams", "give the words by add_words")
        cutter = partial(BlockCutter, self.bundle.config, self._front_end, self.word_encoder if text else None)
        stream = Stream(self.bundle, self.resolver.setup(checked, text), checked, cutter, sample_rate)
        stream.latency = latency
        return stream


def _prepared(speech: Speech, options: InferenceOptions) -> Speech:
    """The speech as the models need it: amplified by the gain, resampled to `SAMPLE_RATE`."""
    return resample(amplified(speech, options.gain), SAMPLE_RATE)


# --------------------------------------------------------------------------------------------------------- the setup

class InterpreterWarning(UserWarning):
    """An interpreter was chosen that is no better than another, or worse (`InterpreterEntry.doubt`)."""


class SetupResolver:
    """Resolves options for one bundle."""

    def __init__(self, bundle: Bundle) -> None:
        self._bundle = bundle

    def speaker(self, name: str | None) -> int:
        """The index of a performer, or of the default one for None; `InputError` lists the known names."""
        speakers = self._bundle.speakers
        if name is None:
            # A bundle of other data may not have the performer that the preset names.
            preferred = self._bundle.config.default_speaker
            return speakers.index(preferred) if preferred in speakers else 0
        if name not in speakers:
            near = difflib.get_close_matches(name, speakers, 1)
            raise InputError(f"speaker {shown(name)}", "is not in the bundle",
                             (f"did you mean {near[0]}? " if near else "") + f"choose among {', '.join(speakers)}")
        return speakers.index(name)

    def setup(self, options: InferenceOptions, text: bool) -> Setup:
        """The setup of a performance. text: its words are read. `InputError` for options that the bundle cannot
        follow."""
        bundle, defaults = self._bundle, self._bundle.config.selection
        activity = (defaults.activity if options.activity is None else options.activity) * ENERGIES[options.energy][1]
        # With rest by phrases (silence.rest=life) activity works without a gate, which would only rank the phrases.
        if 0 < activity < 1 and "gate" not in bundle.parts and not bundle.config.rests_by_phrase:
            raise InputError(f"activity {activity:g}", "needs a gate, and this bundle has none", "use 0 or 1")
        if options.variation and not bundle.system.VARIES:
            raise InputError(f"variation {options.variation}", "needs a generator that samples, and this bundle's is "
                             "deterministic", "leave it out, or choose another seed")
        chosen = options.interpreter or bundle.interpreters[0]
        # An object may have `start` and `step` alone, and gets defaults for the rest.
        interpreter = as_interpreter(bundle.interpreter_named(chosen, text) if isinstance(chosen, str) else chosen)
        known = INTERPRETERS.get(interpreter.name)
        temperature = options.temperature
        if temperature is None and known is not None:
            temperature = known.temperature
        if temperature is None:
            # Q values and log-probabilities have different scales, so each has a default of its own.
            temperature = defaults.q_temperature if interpreter.gives_values else defaults.temperature
        # Interpreters of other packages have no figures of ours, so there is nothing to warn of.
        if known is not None and known.doubt:
            warnings.warn(InterpreterWarning(known.doubt), stacklevel=2)
        return Setup(interpreter, self.speaker(options.speaker), temperature, int(options.seed), activity,
                     hand_controls(bundle, options), int(options.variation), text)


def hand_controls(bundle: Bundle, options: InferenceOptions) -> Controls:
    """The hand controls of the options as numbers: "low", "mid" and "high" by the bundle's levels, curves as they
    are. `InputError` for an invalid control, or if the bundle was trained without style editing."""
    controls = options.controls or Controls()
    if controls == Controls() and not any(hand is not None for hand in options.hands):
        return controls
    levels = bundle.levels
    if levels is None:
        raise InputError(f"the control of {', '.join(FEATURES)}", "is not supported by this bundle",
                         "use a bundle trained with generator.use_control")
    if options.controls is not None:
        return controls

    def number(feature: str, value: HandControl) -> float | Curve | None:
        if value is None or isinstance(value, Curve):
            return value
        # The same parser as on the command line, so a level and a number mean the same.
        text = value if isinstance(value, str) else repr(float(value))
        return hand_target(f"--hand-{feature}", text, feature, levels)

    return Controls(**{name: number(name, hand) for name, hand in zip(FEATURES, options.hands, strict=True)})


def hand_target(flag: str, text: str, feature: str, levels: Levels) -> float:
    """The target of a feature from "low", "mid" or "high", or a number in its unit. `InputError` names the flag. A
    value far from the training data gives a `ControlWarning` and is used."""
    plain = text.strip()
    if plain.lower() in LEVELS:
        return levels.value(feature, plain.lower())
    try:
        number, (low, high) = float(plain), HAND_LIMITS[feature]
    except ValueError:
        raise InputError(f"{flag} {text!r}", f"is neither a level nor a number ({HAND_UNITS[feature]})",
                         f"give {', '.join(LEVELS)} or a number such as {levels.value(feature, 'mid'):.2f}") from None
    if not low <= number <= high:  # also NaN
        raise InputError(f"{flag} {plain}", f"is not a possible {feature} of a hand",
                         f"give {HAND_UNITS[feature]} from {low:g} to {high:g}")
    index = FEATURES.index(feature)
    if abs(number - levels.mean[index]) > _FAR * levels.spread[index]:
        # Attributed to this module, because commands show only the warnings of our packages.
        warnings.warn(ControlWarning(
            f"{flag} {plain}: a {feature} of {number:g} {HAND_UNITS[feature]} is far from the training data (low "
            f"{levels.value(feature, 'low'):.2f}, high {levels.value(feature, 'high'):.2f}); expect less"),
            stacklevel=1)
    return number

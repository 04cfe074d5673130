"""The product in Python: `Gesticulator.from_pretrained()("speech.wav")` gives a `Performance`."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from data_module.controls import FEATURES, Controls, Curve, parse
from data_module.errors import InputError, shown
from data_module.speech.audio import SAMPLE_RATE, SpeechInput, amplified, as_speech, resample
from data_module.types import Array, Blocks, Motion, Speech
from gesticulator.body.motion_path import MotionPath
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.bundle import load as load_bundle
from gesticulator.bundle.features import SpeechFeatures, front_end_for, representation_of
from gesticulator.bundle.files import bundle_folder, lexicon_hash
from gesticulator.options import FPS as FPS
from gesticulator.options import HandControl, InferenceOptions, interpreter_name
from gesticulator.performance import Performance
from gesticulator.plan.plan import sound_hash
from gesticulator.sampling import loop
from gesticulator.sampling.cutter import BlockCutter, encode_speech
from gesticulator.sampling.loop import BlockMotion, ControlRows, GeneratedMotion, OnBlock, Request, Setup, controls_at
from gesticulator.version import __version__
from interpreters import INTERPRETERS
from interpreters.base import as_interpreter

if TYPE_CHECKING:
    from data_module.text.transcript import Text
    from data_module.text.word_vectors import WordEncoder
    from gesticulator.directing.directions import Shaping
    from gesticulator.directing.lexeme_names import LexemeName
    from gesticulator.directing.record import Origin
    from gesticulator.editing.render import Generation, PlanRenderer
    from gesticulator.editing.retiming import Retimed, RetimingReport
    from gesticulator.face.motion import FaceMotion
    from gesticulator.plan.plan import GesturePlan, PlanMeaning
    from gesticulator.stream import Stream
    from interpreters.base import Interpreter, LexemeInterpreter

__all__ = ["Gesticulator"]

R = TypeVar("R", bound=SpeechInput)
_WARM_SECONDS = 2
"""Sound for warming up, seconds: several blocks."""


class InterpreterWarning(UserWarning):
    """An interpreter was chosen that is no better than another, or worse (`InterpreterEntry.doubt`)."""


class Gesticulator:
    """A loaded bundle that turns speech into gesture, block by block (RG 6, Eq. 15)."""

    def __init__(self, bundle: Bundle, device: str | torch.device = "cpu") -> None:
        """bundle: its models are moved to the device. device: a torch device, such as "cpu" or "cuda"."""
        self.device = _usable(device)
        self.bundle = _moved(bundle, self.device)
        self._front_end = front_end_for(self.bundle.config, self.bundle.encoder)
        self._words: WordEncoder | None = None
        self._names: tuple[LexemeName, ...] | None = None
        self._used_interpreters: dict[str, LexemeInterpreter] = {}
        self._remarked = set[str]()
        self._warm: set[bool] = set()
        self.keeps_generations = False
        """Whether performances keep the state before each block (`Performance.generation`), from which edits start."""

    @classmethod
    def from_pretrained(cls, path: str | os.PathLike[str] | None = None, *, device: str | torch.device = "cpu"
                        ) -> Gesticulator:
        """Load a bundle: "default" (also if none is given), "paper", or a folder. device: "cpu" or "cuda".

        Output is bit for bit reproducible on one machine with the same device and number of threads.
        """
        device = _usable(device)  # fail before the bundle is loaded
        return cls(load_bundle(bundle_folder(path)), device)

    @property
    def speakers(self) -> tuple[str, ...]:
        """Names of the performers in the training data; each has a gesture style of its own."""
        return self.bundle.speakers

    @property
    def interpreters(self) -> tuple[str, ...]:
        """Names of the bundle's lexeme interpreters; the first is the default."""
        return self.bundle.interpreters

    def speaker_index(self, speaker: str | None) -> int:
        """The index of a performer, or of the default one for None; `InputError` lists the known names."""
        if speaker is None:
            preferred = self.bundle.config.default_speaker
            return self.speakers.index(preferred) if preferred in self.speakers else 0
        if speaker not in self.speakers:
            raise InputError(f"speaker {speaker}", "is not in the bundle", f"choose among {', '.join(self.speakers)}")
        return self.speakers.index(speaker)

    @property
    def reads_text(self) -> bool:
        """True when the bundle has an interpreter that reads the words."""
        return "interpreter_text" in self.bundle.parts

    def interpreter(self, name: str, text: bool = False) -> Interpreter:
        """The bundle's lexeme interpreter of this name; with `text`, its variant that reads the words."""
        return self.bundle.interpreter_named(name, text)

    def lexeme_names(self) -> tuple[LexemeName, ...]:
        """A name for each lexeme of the bundle (`gesticulator.directing.lexeme_names`), computed on the first call."""
        from gesticulator.directing.lexeme_names import lexeme_names

        if self._names is None:
            self._names = lexeme_names(self.bundle)
        return self._names

    def word_encoder(self) -> WordEncoder:
        """The word encoder that the bundle was trained with, opened on the first call."""
        from data_module.text.word_vectors import WordEncoder

        if self._words is None:
            if self.bundle.text is None:
                raise InputError("text", "is not read by this bundle", "use a bundle trained with text")
            self._words = WordEncoder.open(self.bundle.text.encoder)
            if self._words.width + 1 != self.bundle.text.width:
                raise InputError(self.bundle.text.encoder, "is not the word encoder that the bundle was trained with",
                                 "install the same version")
        return self._words

    def read(self, speech: Speech, text: Text) -> tuple[Speech, str]:
        """Speech with the words of a text (`str`) or a transcript file, and a line on how the words were timed."""
        self._check_reads_text()
        from data_module.text.transcript import as_transcript, with_transcript

        with_words, timing = with_transcript(speech, as_transcript(text, speech))
        return with_words, timing.note

    def _heard(self, speech: Speech, model: str | os.PathLike[str]) -> tuple[Speech, str]:
        """Speech at 16 kHz with the words that a recogniser hears, and a line on them."""
        self._check_reads_text()
        from data_module.text.transcript import with_transcript
        from data_module.text.transcription import transcribed

        transcript = transcribed(speech, model)
        if transcript is None:
            return speech, "no words heard"
        with_words, timing = with_transcript(speech, transcript)
        return with_words, timing.note.replace("times given", "heard with their times", 1)

    def _check_reads_text(self) -> None:
        if not self.reads_text:
            raise InputError("text", "is not read by this bundle", "use a bundle trained with text, or leave it out")

    @overload
    def __call__(self, speech: SpeechInput, sample_rate: float | None = None, *, text: Text | None = None,
                 encoded: SpeechFeatures | None = None, on_block: OnBlock | None = None,
                 **options: Any) -> Performance: ...

    @overload
    def __call__(self, speech: list[R] | tuple[R, ...], sample_rate: float | None = None, *,
                 text: Sequence[Text | None] | None = None, encoded: None = None, on_block: OnBlock | None = None,
                 **options: Any) -> list[Performance]: ...

    def __call__(self, speech: SpeechInput | list[R] | tuple[R, ...], sample_rate: float | None = None, *,
                 text: Text | Sequence[Text | None] | None = None, encoded: SpeechFeatures | None = None,
                 on_block: OnBlock | None = None, **options: Any
                 ) -> Performance | list[Performance]:
        """Gesture for a recording, or for each of a list of them.

        speech: the path of a sound file, samples [n] or [n, channels] with their `sample_rate` in hertz, or a `Speech`,
        with or without words. text: the spoken text as a `str`, or the path of a transcript (plain text, TextGrid, SRT,
        VTT, JSON); for a list of recordings, a list of texts. Without words the audio-only models are used (RG 6.3).
        encoded: the result of `encode_speech` for this speech, to avoid encoding it again. on_block(done, total) is
        called after each block. options: the fields of `InferenceOptions`. `InputError` for unusable input.

        >>> g = Gesticulator.from_pretrained()
        >>> g("speech.wav", text="Hello there", hand_height="low", seed=3).save("gesture.bvh")
        """
        checked = InferenceOptions.of(options)
        if checked.transcribe is not None and text is not None:
            raise InputError("transcribe", "hears words, and text gives them", "leave one of them out")
        if isinstance(speech, list | tuple):
            if encoded is not None:
                raise InputError("encoded", "cannot be used with a list of recordings", "give one recording")
            texts = _texts_for(len(speech), text)
            return [self._one(recording, sample_rate, transcript, checked, None, on_block)
                    for recording, transcript in zip(speech, texts, strict=True)]
        return self._one(speech, sample_rate, text, checked, encoded, on_block)  # type: ignore[arg-type]

    def perform(self, speech: Speech, options: InferenceOptions | None = None, *,
                encoded: SpeechFeatures | None = None, on_block: OnBlock | None = None) -> Performance:
        """Gesture for a `Speech` at any sample rate, with or without words; see `__call__`."""
        options = options or InferenceOptions()
        return self._perform(_prepared(speech, options), options, encoded, on_block)

    def _perform(self, speech: Speech, options: InferenceOptions, encoded: SpeechFeatures | None,
                 on_block: OnBlock | None) -> Performance:
        """`perform` for speech that was resampled to `SAMPLE_RATE` and amplified (`_prepared`)."""
        if options.plan is not None:
            return self.render(speech, options, on_block=on_block)
        if any(word.marks for word in speech.words or ()):
            from gesticulator.directing.marks import with_mark_cues

            options = with_mark_cues(options, speech.words or ())
        cast = self.cast(options, self.reads_words_of(speech))
        cutters: list[BlockCutter] | None = [] if self.keeps_generations else None
        encoded = self.encode_speech(speech, cutters=cutters) if encoded is None else encoded
        state = loop.begin(self.bundle, cast, encoded.text is not None)
        states, blocks = [state], list[BlockMotion]()
        for request in self._requests(speech, options, cast, encoded):
            block, state = loop.step(self.bundle, cast, state, request)
            blocks.append(block)
            if self.keeps_generations:
                states.append(state)
            if on_block is not None:
                on_block(len(blocks), len(encoded))
        motion = loop.motion_of(self.bundle, cast, blocks)
        performance = self._performance(speech, options, cast, GeneratedMotion(encoded.blocks, blocks, motion))
        if not self.keeps_generations:
            return performance
        from gesticulator.editing.render import Generation

        return replace(performance, generation=Generation(encoded, blocks, states, cutters or ()))

    def _requests(self, speech: Speech, options: InferenceOptions, setup: Setup, encoded: SpeechFeatures
                  ) -> list[Request]:
        """A request for each of the N blocks of a first generation."""
        rows = self._control_rows(setup.controls, encoded.blocks)
        parts = [(encoded.block(i), None if rows is None else rows[i]) for i in range(len(encoded))]
        if not options.directed:
            return [Request(block, control) for block, control in parts]
        from gesticulator.directing.directions import Director

        director = Director(self.bundle, options, speech.words or (), float(encoded.blocks.edges[-1]))
        times = encoded.blocks.knot_times.reshape(len(encoded), -1)
        return [director.request(block, knots, control)
                for (block, control), knots in zip(parts, times, strict=True)]

    def stream(self, sample_rate: float = SAMPLE_RATE, *, latency: str = "full", text: bool = False,
               **options: Any) -> Stream:
        """Gesture for speech as it arrives, see `gesticulator.stream.Stream`.

        sample_rate: hertz of the sound that will be fed; latency: "full" or "low" (`BlockCutter`); text: words will be
        added; options: the fields of `InferenceOptions`. Several streams may share a `Gesticulator`. The first one
        takes seconds to open, see `warm`.
        """
        checked = InferenceOptions.of(options)
        if checked.transcribe is not None:
            raise InputError("transcribe", "is not for streams", "give the words by add_words")
        self.warm(text)
        return self._stream(sample_rate, latency, text, checked)

    def warm(self, text: bool = False) -> None:
        """Load, compile and try everything that is needed on first use by a stream, so that no block waits for it:
        one to three seconds, the first time. text: also what reads words. `stream` does it, if it has not been done."""
        if text in self._warm:
            return
        if text:
            self._check_reads_text()
        self._warm.add(text)
        noise = np.random.default_rng(0).normal(0, 0.05, _WARM_SECONDS * SAMPLE_RATE).astype(np.float32)
        try:
            for latency in ("full", "low"):
                stream = self._stream(SAMPLE_RATE, latency, text, InferenceOptions())
                stream.feed(noise)
                stream.idle(0.5)
                stream.finish()
        except InputError:  # a bundle that cannot stream says so when a stream is opened
            self._warm.discard(text)

    def _stream(self, sample_rate: float, latency: str, text: bool, checked: InferenceOptions) -> Stream:
        from gesticulator.stream import Stream

        if text:
            self._check_reads_text()
        cutter = partial(BlockCutter, self.bundle.config, self._front_end, self.word_encoder() if text else None,
                         latency)
        return Stream(self.bundle, self.cast(checked, text), checked, cutter, sample_rate)

    def cast(self, options: InferenceOptions, text: bool) -> Setup:
        """The performer for these options, with the bundle's defaults filled in. text: words are read."""
        defaults = self.bundle.config.selection
        activity = (defaults.activity if options.activity is None else options.activity) * options.energy_share
        self._check_activity(activity)
        self._check_variation(int(options.variation))
        controls = self.controls(options)
        speaker = self.speaker_index(options.speaker)
        interpreter = as_interpreter(self._chosen_interpreter(options, text))
        temperature = _own_temperature(interpreter) if options.temperature is None else options.temperature
        if temperature is None:
            temperature = defaults.q_temperature if interpreter.gives_values else defaults.temperature
        self._remark(interpreter)
        interpreter = interpreter.steered(options.beta, temperature)
        return Setup(interpreter, speaker, temperature, defaults.top, int(options.seed), activity, controls,
                     int(options.variation), interpreter.beta)

    def _remark(self, interpreter: Interpreter) -> None:
        """Warn once (`InterpreterWarning`) of an interpreter that is no better than another by our figures."""
        known = INTERPRETERS.get(interpreter.name)
        if known is not None and known.doubt and interpreter.name not in self._remarked:
            self._remarked.add(interpreter.name)
            warnings.warn(InterpreterWarning(known.doubt), stacklevel=3)

    def _chosen_interpreter(self, options: InferenceOptions, text: bool) -> LexemeInterpreter:
        """The interpreter object of the options, or the one of their name: the bundle's, or an object used before.

        `InputError` for a plan that was made with an object which was never passed to this `Gesticulator`.
        """
        chosen = options.interpreter or self.interpreters[0]
        if not isinstance(chosen, str):
            self._used_interpreters[interpreter_name(chosen)] = chosen
            return chosen
        if chosen in self.interpreters or options.plan is None:
            return self.interpreter(chosen, text)
        if chosen not in self._used_interpreters:
            raise options.plan.error(("interpreter",), f"is {shown(chosen)}, which is not in the bundle",
                                     "pass the object that the plan was made with: interpreter=...")
        return self._used_interpreters[chosen]

    def render(self, speech: Speech, options: InferenceOptions, renderer: PlanRenderer | None = None,
               on_block: OnBlock | None = None) -> Performance:
        """Render the plan of the options (as returned by `directing.planned`) for a speech at 16 kHz.

        renderer: the `plan_renderer` of the same first generation; then only edited blocks are generated.
        """
        from gesticulator.directing import directions as directing

        assert options.plan is not None
        directing.check_plan_of(self.bundle, options.plan, sound_hash(speech))
        renderer = renderer or self.plan_renderer(speech, options)
        generated = renderer.render(options.plan, on_block)
        performance = self._performance(speech, options, self.cast(options, self.reads_words_of(speech)), generated)
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
        for curve in plan.manner.curves:
            for time in curve.times:
                self._check_activity(plan.manner.share_at(time))
        cast = self.cast(options, self.reads_words_of(speech))
        return PlanRenderer(self.bundle, cast, speech.samples, partial(self.encode_speech, speech), plan, generation)

    def retimed(self, plan: GesturePlan, speech: SpeechInput, sample_rate: float | None = None, *,
                text: Text | None = None, on_block: OnBlock | None = None) -> Retimed:
        """A plan on another export of its sound, and a report of what was kept, moved, decided anew and lost
        (`gesticulator.editing.retiming`).

        speech, sample_rate: the new sound, as in `__call__`; text: its text or transcript, if its words are others.
        `InputError` for a sound that has too little of the old speech, and for a plan of another bundle.
        """
        from gesticulator.directing import directions as directing
        from gesticulator.directing.record import named, words_of
        from gesticulator.editing import retiming

        directing.check_bundle_of(self.bundle, plan)
        recording = _prepared(as_speech(speech, sample_rate), directing.planned(InferenceOptions(plan=plan)))
        recording = replace(recording, words=None)
        words = None if text is None else words_of(self.read(recording, text)[0])
        if words is None and sound_hash(recording) == plan.sound.sha256:
            return retiming.unchanged(plan)
        draft = retiming.drafted(plan, recording, self.encode_speech(recording), words)
        if None not in draft.plan.drawn.lexemes:
            return draft
        renderer = self.plan_renderer(directing.with_planned_words(recording, draft.plan),
                                      directing.planned(InferenceOptions(plan=draft.plan)))
        return replace(draft, plan=named(retiming.decided(draft.plan, renderer.generation(on_block).blocks),
                                         self.lexeme_names()))

    def _performance(self, speech: Speech, options: InferenceOptions, cast: Setup, rendering: GeneratedMotion
                     ) -> Performance:
        from gesticulator.directing.record import plan_of, rendered_plan

        cut, blocks = rendering.cut, rendering.blocks
        meanings = self._meanings(speech, options)
        shaping = self.shaping(speech, options, cast.speaker, cut.edges, meanings)
        motion = self.to_motion(rendering.motion, cut, cast.speaker, options, shaping)
        if options.plan is not None and options.plan.pins:
            from gesticulator.body.pins import pinned

            motion = pinned(motion, options.plan)
        origin = self.origin(speech, options, cast, meanings)
        plan = (plan_of(speech, cut, blocks, origin) if options.plan is None else
                rendered_plan(options.plan, speech, blocks, origin))
        return Performance(motion, speech, cut, np.array([block.lexeme for block in blocks], np.int64),
                           np.stack([block.code for block in blocks]), plan, origin.options, self.lexeme_names,
                           rest=partial(self._rest_pose, cast.speaker), face=self._face(speech, options, plan, motion))

    def shaping(self, speech: Speech, options: InferenceOptions, speaker: int, edges: Array,
                meanings: tuple[PlanMeaning, ...]) -> Shaping | None:
        """The changes of the generated poses in blocks with these edges [N + 1]; None for none."""
        if not options.shaped and not meanings:
            return None
        from gesticulator.directing import directions as directing
        from gesticulator.directing.meanings import played_meanings

        played = played_meanings(meanings)
        return directing.Shaping(self.bundle, options, speaker, speech.words or (), edges, lambda until: played)

    def origin(self, speech: Speech, options: InferenceOptions, cast: Setup, meanings: tuple[PlanMeaning, ...]
               ) -> Origin:
        """Provenance of a performance with these options."""
        from gesticulator.directing.record import Origin

        used = replace(options, speaker=self.speakers[cast.speaker],
                       interpreter=options.interpreter or self.interpreters[0],
                       temperature=cast.temperature, beta=cast.beta,
                       activity=self.bundle.config.selection.activity if options.activity is None else options.activity,
                       controls=cast.controls, hand_height=None, hand_speed=None, hand_radius=None)
        return Origin(used, self._program(), self._settings(used, self.reads_words_of(speech)), cast.score_is, meanings)

    def _face(self, speech: Speech, options: InferenceOptions, plan: GesturePlan, motion: Motion) -> FaceMotion | None:
        """The face over the frames of the body; None where none is asked for."""
        if options.face == "off":
            return None
        from gesticulator.face.track import face_of

        cues: list[tuple[float, str]] = []
        if options.cues:
            from gesticulator.directing.directions import expressions_at

            cues = expressions_at(options.cues, speech.words or (), speech.duration)
        return face_of(options, speech.samples, plan.blocks, motion, speech.words or (), cues)

    def _rest_pose(self, speaker: int) -> Motion:
        """The speaker's resting pose, a motion of one frame."""
        return representation_of(self.bundle.config).motion(self.bundle.statistics.rest_pose[speaker][None], 1.0)

    def _meanings(self, speech: Speech, options: InferenceOptions) -> tuple[PlanMeaning, ...]:
        """The meanings of the plan, or those that the words call for."""
        if options.plan is not None:
            return options.plan.meanings
        if not speech.words or not self._shows_meanings:
            return ()
        from gesticulator.directing.meanings import track_of

        track = track_of(options, speech)
        if track is None:
            return ()
        track.add(speech.words)
        return track.meanings()

    @property
    def _shows_meanings(self) -> bool:
        """Whether named gestures can be blended over the motion of this bundle."""
        return representation_of(self.bundle.config).name == "rotations"

    def _one(self, speech: SpeechInput, sample_rate: float | None, text: Text | None, options: InferenceOptions,
             encoded: SpeechFeatures | None, on_block: OnBlock | None) -> Performance:
        recording, report = as_speech(speech, sample_rate), None
        notes: tuple[str, ...] = ()
        if options.plan is not None:
            from gesticulator.directing import directions as directing

            if options.retime:
                moved, report = self._moved(options, recording, text)
                options, notes = replace(options, plan=moved, retime=False), report.lines()[:1]
            options = directing.planned(options)
        recording = _prepared(recording, options)
        if options.plan is not None:
            recording = directing.with_planned_words(recording, options.plan)
        elif text is not None:
            recording, note = self.read(recording, text)
            notes = (note,)
        elif options.transcribe is not None and not recording.words:
            recording, note = self._heard(recording, options.transcribe)
            notes = (note,)
        # The words are in the speech from here on, and in the plan.
        options = replace(options, transcribe=None)
        if options.plan is None and (options.cues or options.hold_still):
            from gesticulator.directing.mismatches import without_mismatches

            options = without_mismatches(options, recording.words or (), recording.duration)
        performance = self._perform(recording, options, encoded, on_block)
        name = Path(speech).name if isinstance(speech, str | os.PathLike) else ""
        if report is not None:
            performance = replace(performance, retiming=report)
        elif options.plan is not None:
            notes = performance.notes
        return performance.labelled(name, notes)

    def _moved(self, options: InferenceOptions, speech: Speech, text: Text | None
               ) -> tuple[GesturePlan, RetimingReport]:
        """The plan of the options on this sound, with a warning for each thing that was lost."""
        from gesticulator.directing.mismatches import warn_of_losses

        assert options.plan is not None
        moved = self.retimed(options.plan, speech, text=text)
        warn_of_losses(moved.report.losses)
        return moved.plan, moved.report

    def encode_speech(self, speech: Speech, blocks: Blocks | None = None, cutters: list[BlockCutter] | None = None
                      ) -> SpeechFeatures:
        """Cut a speech at 16 kHz into blocks, or into the given ones, and encode it, with its words if the bundle reads
        text. cutters: see `cutter.encode_speech`."""
        words = self.word_encoder() if self.reads_words_of(speech) else None
        return encode_speech(speech, self.bundle.config, self._front_end, words, blocks, cutters)

    def reads_words_of(self, speech: Speech) -> bool:
        """Whether the words of a speech are read."""
        return self.reads_text and any(word.text.strip() for word in speech.words or ())

    def _check_variation(self, variation: int) -> None:
        if variation and not self.bundle.system.VARIES:
            raise InputError(f"variation {variation}", "needs a generator that samples, and this bundle's is "
                             "deterministic", "leave it out, or choose another seed")

    def _check_activity(self, activity: float) -> None:
        # With rest by phrases (silence.rest=life) activity works without a gate, which would only rank the phrases.
        if 0 < activity < 1 and "gate" not in self.bundle.parts and not self.bundle.rests_by_phrase:
            raise InputError(f"activity {activity:g}", "needs a gate, and this bundle has none", "use 0 or 1")

    def controls(self, options: InferenceOptions) -> Controls:
        """The hand controls of the options as numbers: "low", "mid" and "high" by the bundle's levels, curves from
        their files.

        `InputError` for an invalid control, or if the bundle was trained without style editing.
        """
        controls = options.controls or Controls.free()
        if controls == Controls.free() and not any(hand is not None for hand in options.hands):
            return controls
        if self.bundle.levels is None:
            raise InputError(f"the control of {', '.join(FEATURES)}", "is not supported by this bundle",
                             "use a bundle trained with generator.use_control")
        values = {name: self._control(name, hand) for name, hand in zip(FEATURES, options.hands, strict=True)}
        return Controls(**values) if options.controls is None else controls

    def _control(self, feature: str, value: HandControl) -> float | Curve | None:
        assert self.bundle.levels is not None
        if value is None or isinstance(value, Curve):
            return value
        text = os.fspath(value) if isinstance(value, str | os.PathLike) else repr(float(value))
        return parse(f"hand_{feature}", text, feature, self.bundle.levels)

    def _control_rows(self, controls: Controls, blocks: Blocks) -> ControlRows | None:
        """[N, K, 2 F] rows of the controls, or None where nothing is controlled."""
        rows = controls_at(self.bundle.levels, controls, blocks.knot_times)
        return None if rows is None else rows.reshape(len(blocks), blocks.frames, -1)

    def _program(self) -> dict[str, Any]:
        """The version and the bundle, in plain values."""
        return {"gesticulator": __version__, "bundle": {"preset": self.bundle.config.name,
                                                        "lexicon": lexicon_hash(self.bundle.vectors)}}

    def _settings(self, options: InferenceOptions, words: bool) -> dict[str, Any]:
        """Everything that a generation depends on, in plain values. options: with the bundle's defaults filled in;
        words: whether words were read."""
        settings: dict[str, Any] = {
            "speaker": options.speaker, "interpreter": interpreter_name(options.interpreter or self.interpreters[0]),
            "words": words, "seed": int(options.seed), "variation": int(options.variation),
            **{key: float(getattr(options, key)) for key in ("temperature", "activity", "fps", "gain")}}
        if options.beta is not None:
            settings["beta"] = float(options.beta)
        if options.legs or options.seated:
            settings["legs"] = "seated" if options.seated else "standing"
        controls = options.controls or Controls.free()
        for feature, value in zip(FEATURES, (controls.height, controls.speed, controls.radius), strict=True):
            if value is not None:
                settings[f"hand_{feature}"] = ({"times": list(value.times), "values": list(value.values)}
                                               if isinstance(value, Curve) else float(value))
        return settings

    def to_motion(self, features: NDArray[np.float32], blocks: Blocks, speaker: int,
                  options: InferenceOptions, shaping: Callable[[Array, Array], Array] | None = None) -> Motion:
        """Normalised blocks [N, K, D_m], warped back onto the time of the speech and smoothed (RG 4.2.2, 7.1.2).

        shaping: poses [K, D_m] at seconds [K] -> poses with intensity, mirroring and named gestures applied.
        """
        path = MotionPath(self.bundle, speaker, options, shaping=shaping)
        parts = [path.push(at, block) for at, block in zip(blocks.knot_times.reshape(len(blocks), -1), features,
                                                           strict=True)]
        pieces = [part for part in (*parts, path.finish(float(blocks.edges[-1]))) if part is not None]
        return replace(pieces[0], rotations=np.concatenate([piece.rotations for piece in pieces]),
                       root_positions=np.concatenate([piece.root_positions for piece in pieces]))


def _texts_for(count: int, text: Text | Sequence[Text | None] | None) -> Sequence[Text | None]:
    """One text for each of `count` recordings; `InputError` for a single text or another number of texts."""
    if text is None:
        return [None] * count
    if isinstance(text, str | os.PathLike):
        raise InputError("text", f"is a single text for {count} recordings", "give a list with one text (or None) each")
    if len(text) != count:
        raise InputError("text", f"has {len(text)} entries for {count} recordings", "give one (or None) for each")
    return text


def _prepared(speech: Speech, options: InferenceOptions) -> Speech:
    """The speech as the models need it: amplified by the gain, resampled to `SAMPLE_RATE`."""
    return resample(amplified(speech, options.gain), SAMPLE_RATE)


def _own_temperature(interpreter: Interpreter) -> float | None:
    """The default temperature of an interpreter by its entry; None for that of the bundle."""
    return INTERPRETERS[interpreter.name].temperature if interpreter.name in INTERPRETERS else None


def _usable(device: str | torch.device) -> torch.device:
    """The torch device; `InputError` if torch does not know it or cannot use it here."""
    try:
        usable = torch.device(device)
        torch.empty(1, device=usable)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"device {device}", f"cannot be used ({str(error).splitlines()[0]})",
                         'choose "cpu", or "cuda" where torch finds a GPU') from None
    return usable


def _moved(bundle: Bundle, device: torch.device) -> Bundle:
    """The bundle with its models on the device; the same object for the CPU."""
    if device.type == "cpu":
        return bundle
    return replace(bundle, vectors=bundle.vectors.to(device), parts=_PartsOn(device, bundle.parts))


class _PartsOn(Mapping[str, nn.Module]):
    """The models of a bundle, each moved to a device on first access."""

    def __init__(self, device: torch.device, parts: Mapping[str, nn.Module]) -> None:
        self._device, self._parts = device, parts

    def __getitem__(self, name: str) -> nn.Module:
        return self._parts[name].to(self._device)

    def __contains__(self, name: object) -> bool:
        return name in self._parts

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

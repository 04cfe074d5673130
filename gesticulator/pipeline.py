"""The product in Python: `Gesticulator.from_pretrained()("speech.wav")` gives a `Performance`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, Unpack, overload

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from data_module.controls import FEATURES, Controls, Curve, parse
from data_module.errors import InputError, shown
from data_module.speech.audio import SAMPLE_RATE, SpeechInput, amplified, as_speech, resample
from data_module.types import Array, Blocks, Motion, Speech
from gesticulator.body.motion_path import MotionPath
from gesticulator.bundle.bundle import SHIPPED, Bundle
from gesticulator.bundle.bundle import load as load_bundle
from gesticulator.bundle.features import SpeechFeatures, front_end_for
from gesticulator.bundle.files import lexicon_hash
from gesticulator.drawing.cutter import BlockCutter, encode_speech
from gesticulator.drawing.driver import Cast, ControlRows, Driver, OnBlock, Rendering, controls_at, requests
from gesticulator.drawing.rollout import Sampling
from gesticulator.options import FPS as FPS
from gesticulator.options import HandControl, InferenceArguments, InferenceOptions, interpreter_name
from gesticulator.performance import Performance
from gesticulator.version import __version__
from interpreters.base import as_interpreter

if TYPE_CHECKING:
    from data_module.text.transcript import Text
    from data_module.text.word_vectors import WordEncoder
    from gesticulator.directing.editing import PlanRenderer
    from gesticulator.plan.plan import LexemeName
    from gesticulator.stream import Stream
    from interpreters.base import Interpreter, LexemeInterpreter

__all__ = ["Gesticulator"]

R = TypeVar("R", bound=SpeechInput)


class Gesticulator:
    """A loaded bundle that turns speech into gesture, block by block (RG 6, Eq. 15)."""

    def __init__(self, bundle: Bundle, device: str | torch.device = "cpu") -> None:
        """bundle: its models are moved to the device. device: what torch calls it, such as "cpu" or "cuda"."""
        self.device = _usable(device)
        self.bundle = _moved(bundle, self.device)
        self._front_end = front_end_for(self.bundle.config, self.bundle.encoder)
        self._words: WordEncoder | None = None
        self._names: tuple[LexemeName, ...] | None = None
        self._played: dict[str, LexemeInterpreter] = {}

    @classmethod
    def from_pretrained(cls, path: str | os.PathLike[str] | None = None, *, device: str | torch.device = "cpu"
                        ) -> Gesticulator:
        """Load a bundle's folder; the shipped one when no path is given. device: "cpu" or "cuda".

        Bytes are the same from run to run on one machine with one device and one number of threads.
        """
        device = _usable(device)  # before the work of loading
        return cls(load_bundle(Path(path) if path is not None else SHIPPED), device)

    @property
    def speakers(self) -> tuple[str, ...]:
        """The performers whose habits the bundle knows."""
        return self.bundle.speakers

    @property
    def interpreters(self) -> tuple[str, ...]:
        """Names of the lexeme interpreters that the bundle holds; the first is taken when none is named."""
        return self.bundle.interpreters

    def speaker_index(self, speaker: str | None) -> int:
        """The number of a performer; InputError lists the known ones."""
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
        """The lexeme interpreter of that name over the bundle's lexicon; with `text`, the one that reads the words."""
        return self.bundle.interpreter_named(name, text)

    def lexeme_names(self) -> tuple[LexemeName, ...]:
        """A name for each lexeme of the bundle (`gesticulator.directing.lexeme_names`), worked out once."""
        from gesticulator.directing.lexeme_names import lexeme_names

        if self._names is None:
            self._names = lexeme_names(self.bundle)
        return self._names

    def word_encoder(self) -> WordEncoder:
        """The word encoder that the bundle was trained on, opened once."""
        from data_module.text.word_vectors import WordEncoder

        if self._words is None:
            if self.bundle.text is None:
                raise InputError("text", "is not read by this bundle", "use a bundle trained with text")
            self._words = WordEncoder.open(self.bundle.text.encoder)
            if self._words.width + 1 != self.bundle.text.width:
                raise InputError(self.bundle.text.encoder, "is not the word encoder that the bundle was trained on",
                                 "install the same version")
        return self._words

    def read(self, speech: Speech, text: Text) -> tuple[Speech, str]:
        """Speech with the words of a text (`str`) or of a transcript's file, and a line on how their times were got."""
        if not self.reads_text:
            raise InputError("text", "is not read by this bundle", "use a bundle trained with text, or leave it out")
        from data_module.text.transcript import as_transcript, with_transcript

        spoken, timing = with_transcript(speech, as_transcript(text, speech))
        return spoken, timing.note

    @overload
    def __call__(self, speech: SpeechInput, sample_rate: float | None = None, *, text: Text | None = None,
                 encoded: SpeechFeatures | None = None, on_block: OnBlock | None = None,
                 **options: Unpack[InferenceArguments]) -> Performance: ...

    @overload
    def __call__(self, speech: list[R] | tuple[R, ...], sample_rate: float | None = None, *,
                 text: Sequence[Text | None] | None = None, encoded: None = None, on_block: OnBlock | None = None,
                 **options: Unpack[InferenceArguments]) -> list[Performance]: ...

    def __call__(self, speech: SpeechInput | list[R] | tuple[R, ...], sample_rate: float | None = None, *,
                 text: Text | Sequence[Text | None] | None = None, encoded: SpeechFeatures | None = None,
                 on_block: OnBlock | None = None, **options: Unpack[InferenceArguments]
                 ) -> Performance | list[Performance]:
        """Gesture for a recording, or for each of a list of them.

        speech: the path of a sound file, samples [n] or [n, channels] with their `sample_rate` in hertz, or a `Speech`;
        words that it carries are read. text: what is said, as a `str`, or as the path of a transcript (plain text,
        TextGrid, SRT, VTT, JSON); a list of them for a list of recordings. Without words the audio-only path is taken
        (RG 6.3). encoded: what `encode_speech` gave for this speech, to gesture for it again without encoding it
        again. on_block(done, total) is called after each block. options: the fields of `InferenceOptions`.
        `InputError` for what cannot be used.

        >>> g = Gesticulator.from_pretrained()
        >>> g("speech.wav", text="Hello there", hand_height="low", seed=3).save("gesture.bvh")
        """
        asked = InferenceOptions.of(options)
        if isinstance(speech, list | tuple):
            if encoded is not None:
                raise InputError("encoded", "is one for several recordings", "give one recording")
            texts = _texts_for(len(speech), text)
            return [self._one(one, sample_rate, said, asked, None, on_block)
                    for one, said in zip(speech, texts, strict=True)]
        return self._one(speech, sample_rate, text, asked, encoded, on_block)  # type: ignore[arg-type]

    def perform(self, speech: Speech, options: InferenceOptions | None = None, *,
                encoded: SpeechFeatures | None = None, on_block: OnBlock | None = None) -> Performance:
        """Gesture for a `Speech` at any sample rate, with the words that it carries; see `__call__`."""
        options = options or InferenceOptions()
        return self._perform(_prepared(speech, options), options, encoded, on_block)

    def _perform(self, speech: Speech, options: InferenceOptions, encoded: SpeechFeatures | None,
                 on_block: OnBlock | None) -> Performance:
        """`perform` for speech that is at `SAMPLE_RATE` and as loud as it was asked for."""
        if options.plan is not None:
            return self.render(speech, options, on_block=on_block)
        cast = self.cast(options, self._reads(speech))
        encoded = self.encode_speech(speech) if encoded is None else encoded
        directions = None
        if options.directed:
            from gesticulator.directing import directions as directing

            directions = directing.directions(self.bundle, options, speech, encoded.blocks)
        driver = Driver(self.bundle, cast)
        driver.begin(encoded.text is not None)
        blocks = driver.run(requests(encoded, self._control_rows(cast.controls, encoded), directions), on_block)
        return self._performance(speech, options, cast, Rendering(encoded, blocks, driver.motion(blocks)))

    def stream(self, sample_rate: float = SAMPLE_RATE, *, latency: str = "full", text: bool = False,
               **options: Unpack[InferenceArguments]) -> Stream:
        """Gesture for speech while it arrives, see `gesticulator.stream.Stream`.

        sample_rate: hertz of the sound that will be fed; latency: "full", or "low" (see there); text: words will come;
        options: the fields of `InferenceOptions`. Several streams may share a `Gesticulator`.
        """
        from gesticulator.stream import Stream

        asked = InferenceOptions.of(options)
        if text and not self.reads_text:
            raise InputError("text", "is not read by this bundle", "use a bundle trained with text, or leave it out")
        cutter = partial(BlockCutter, self.bundle.config, self._front_end, self.word_encoder() if text else None,
                         latency)
        return Stream(self.bundle, self.cast(asked, text), asked, cutter, sample_rate)

    def cast(self, options: InferenceOptions, text: bool) -> Cast:
        """Who gestures, and how, with nothing left to the bundle; text: words are read."""
        chosen = self.bundle.config.selection
        activity = (chosen.activity if options.activity is None else options.activity) * options.energy_share
        self._check_activity(activity)
        self._check_variation(int(options.variation))
        controls = self.controls(options)
        who = self.speaker_index(options.speaker)
        system = as_interpreter(self._chosen_interpreter(options, text))
        temperature = options.temperature
        if temperature is None:
            temperature = chosen.q_temperature if system.gives_values else chosen.temperature
        system = system.steered(options.beta, temperature)
        sampling = Sampling(temperature, chosen.top, int(options.seed))
        return Cast(system, who, sampling, activity, controls, int(options.variation), system.beta)

    def _chosen_interpreter(self, options: InferenceOptions, text: bool) -> LexemeInterpreter:
        """The object of the options, or that of their name: the bundle's, or one that was played here before.

        `InputError` for the name of a plan that was made with an object which this Gesticulator has not seen.
        """
        chosen = options.interpreter or self.interpreters[0]
        if not isinstance(chosen, str):
            self._played[interpreter_name(chosen)] = chosen
            return chosen
        if chosen in self.interpreters or options.plan is None:
            return self.interpreter(chosen, text)
        if chosen not in self._played:
            raise options.plan.error(("interpreter",), f"is {shown(chosen)}, which is not in the bundle",
                                     "pass the object that the plan was made with: interpreter=...")
        return self._played[chosen]

    def render(self, speech: Speech, options: InferenceOptions, renderer: PlanRenderer | None = None,
               on_block: OnBlock | None = None) -> Performance:
        """The plan of the options (as `directing.planned` gives them) for a speech at 16 kHz, rendered.

        renderer: what `plan_renderer` gave for this drawing, so that only edited blocks are drawn.
        """
        from gesticulator.directing import directions as directing

        assert options.plan is not None
        directing.check_plan_of(self.bundle, options.plan, speech)
        rendering = (renderer or self.plan_renderer(speech, options, on_block)).render(options.plan)
        return self._performance(speech, options, self.cast(options, self._reads(speech)), rendering)

    def plan_renderer(self, speech: Speech, options: InferenceOptions, on_block: OnBlock | None = None) -> PlanRenderer:
        """What renders the plans of one first drawing of a speech (at 16 kHz), each in the time of its edits.

        options: with a plan of that drawing, as `directing.planned` gives them.
        """
        from gesticulator.directing import directions as directing
        from gesticulator.directing.editing import PlanRenderer, Redrawer

        plan = options.plan
        assert plan is not None
        cast = self.cast(options, self._reads(speech))
        cast = replace(cast, sampling=replace(cast.sampling, variation=plan.variation))
        rhythm = self.bundle.config.rhythm
        return PlanRenderer(Redrawer(
            lambda activity: Driver(self.bundle, replace(cast, activity=activity)),
            lambda blocks: self.encode_speech(speech, blocks),
            lambda encoded: self._control_rows(cast.controls, encoded),
            lambda hand: directing.bias_of(self.bundle, hand), rhythm.frames, rhythm.fps), plan, on_block)

    def _performance(self, speech: Speech, options: InferenceOptions, cast: Cast, rendering: Rendering) -> Performance:
        from gesticulator.directing.record import Origin, plan_of, rendered_plan

        encoded, blocks, shaping = rendering.encoded, rendering.blocks, None
        if options.shaped:
            from gesticulator.directing import directions as directing

            shaping = directing.shaping(self.bundle, options, cast.speaker, speech.words or (), encoded.blocks.edges)
        motion = self.to_motion(rendering.motion, encoded, cast.speaker, options, shaping)
        used = replace(options, speaker=self.speakers[cast.speaker],
                       interpreter=options.interpreter or self.interpreters[0],
                       temperature=cast.sampling.temperature, beta=cast.beta,
                       activity=self.bundle.config.selection.activity if options.activity is None else options.activity,
                       controls=cast.controls, hand_height=None, hand_speed=None, hand_radius=None)
        origin = Origin(used, self._program(), self._settings(used, self._reads(speech)), cast.score_is)
        plan = (plan_of(speech, encoded.blocks, blocks, origin) if options.plan is None else
                rendered_plan(options.plan, speech, blocks, origin))
        return Performance(motion, speech, encoded.blocks, np.array([block.lexeme for block in blocks], np.int64),
                           np.stack([block.code for block in blocks]), plan, used, self.lexeme_names)

    def _one(self, speech: SpeechInput, sample_rate: float | None, text: Text | None, options: InferenceOptions,
             encoded: SpeechFeatures | None, on_block: OnBlock | None) -> Performance:
        if options.plan is not None:
            from gesticulator.directing import directions as directing

            options = directing.planned(options)
        spoken = _prepared(as_speech(speech, sample_rate), options)
        notes: tuple[str, ...] = ()
        if options.plan is not None:
            spoken = directing.with_planned_words(spoken, options.plan)
        elif text is not None:
            spoken, note = self.read(spoken, text)
            notes = (note,)
        if options.plan is None and (options.cues or options.hold_still):
            from gesticulator.directing.mismatches import without_mismatches

            options = without_mismatches(options, spoken.words or (), spoken.duration)
        made = self._perform(spoken, options, encoded, on_block)
        name = Path(speech).name if isinstance(speech, str | os.PathLike) else ""
        return made.labelled(name, made.notes if options.plan is not None else notes)

    def encode_speech(self, speech: Speech, blocks: Blocks | None = None) -> SpeechFeatures:
        """A speech at 16 kHz cut into blocks (into these, where told) and encoded, with its words where the bundle
        reads them."""
        words = self.word_encoder() if self._reads(speech) else None
        return encode_speech(speech, self.bundle.config, self._front_end, words, blocks)

    def _reads(self, speech: Speech) -> bool:
        return self.reads_text and any(word.text.strip() for word in speech.words or ())

    def _check_variation(self, variation: int) -> None:
        if variation and not self.bundle.system.varies:
            raise InputError(f"variation {variation}", "needs a generator that samples, and the bundle's draws "
                             "a lexeme in one way", "leave it out, or choose another seed")

    def _check_activity(self, activity: float) -> None:
        # Where phrases rest (silence.rest=life) a gate only ranks them.
        if 0 < activity < 1 and "gate" not in self.bundle.parts and not self.bundle.system.lives:
            raise InputError(f"activity {activity:g}", "needs a gate, and this bundle has none", "use 0 or 1")

    def controls(self, options: InferenceOptions) -> Controls:
        """What the options ask of the hands, in numbers: levels are the bundle's, files are read.

        `InputError` where a control cannot be used, or the bundle was trained without style editing.
        """
        asked = options.controls or Controls.free()
        if asked == Controls.free() and not any(hand is not None for hand in options.hands):
            return asked
        if self.bundle.levels is None:
            raise InputError(f"the control of {', '.join(FEATURES)}", "is not heard by this bundle",
                             "use a bundle trained with generator.use_control")
        given = {name: self._control(name, hand) for name, hand in zip(FEATURES, options.hands, strict=True)}
        return Controls(**given) if options.controls is None else asked

    def _control(self, feature: str, asked: HandControl) -> float | Curve | None:
        assert self.bundle.levels is not None
        if asked is None or isinstance(asked, Curve):
            return asked
        text = os.fspath(asked) if isinstance(asked, str | os.PathLike) else repr(float(asked))
        return parse(f"hand_{feature}", text, feature, self.bundle.levels)

    def _control_rows(self, controls: Controls, encoded: SpeechFeatures) -> ControlRows | None:
        """[N, K, 2 F] rows of the controls, or None where nothing is controlled."""
        blocks = encoded.blocks
        rows = controls_at(self.bundle.levels, controls, blocks.knot_times)
        return None if rows is None else rows.reshape(len(blocks), blocks.frames, -1)

    def _program(self) -> dict[str, Any]:
        """The version and the bundle, in plain values."""
        return {"gesticulator": __version__, "bundle": {"preset": self.bundle.config.name,
                                                        "lexicon": lexicon_hash(self.bundle.vectors)}}

    def _settings(self, options: InferenceOptions, words: bool) -> dict[str, Any]:
        """Everything that a generation depends on, in plain values. options: with nothing left to the bundle; words:
        whether they were read."""
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

    def to_motion(self, features: NDArray[np.float32], encoded: SpeechFeatures, speaker: int,
                  options: InferenceOptions, shaping: Callable[[Array, Array], Array] | None = None) -> Motion:
        """Normalised blocks [N, K, D_m] on the speech's own clock, smoothed, as motion (RG 4.2.2, 7.1.2).

        shaping: poses [K, D_m] at seconds [K] -> poses, what knobs make of them.
        """
        path, blocks = MotionPath(self.bundle, speaker, options, shaping=shaping), encoded.blocks
        parts = [path.push(at, block) for at, block in zip(blocks.knot_times.reshape(len(blocks), -1), features,
                                                           strict=True)]
        made = [part for part in (*parts, path.finish(float(blocks.edges[-1]))) if part is not None]
        return replace(made[0], rotations=np.concatenate([part.rotations for part in made]),
                       root_positions=np.concatenate([part.root_positions for part in made]))


def _texts_for(count: int, text: Text | Sequence[Text | None] | None) -> Sequence[Text | None]:
    """A text for each of several recordings; `InputError` where there is one for all, or another number of them."""
    if text is None:
        return [None] * count
    if isinstance(text, str | os.PathLike):
        raise InputError("text", f"is one for {count} recordings", "give a list with a text (or None) for each")
    if len(text) != count:
        raise InputError("text", f"has {len(text)} entries for {count} recordings", "give one (or None) for each")
    return text


def _prepared(speech: Speech, options: InferenceOptions) -> Speech:
    """The speech as the models take it: amplified as asked, at `SAMPLE_RATE`."""
    return resample(amplified(speech, options.gain), SAMPLE_RATE)


def _usable(device: str | torch.device) -> torch.device:
    """The device; `InputError` where torch does not know it or cannot use it here."""
    try:
        found = torch.device(device)
        torch.empty(1, device=found)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"device {device}", f"cannot be used ({str(error).splitlines()[0]})",
                         'choose "cpu", or "cuda" where torch finds a GPU') from None
    return found


def _moved(bundle: Bundle, device: torch.device) -> Bundle:
    """The bundle with its models on the device; itself on the CPU."""
    if device.type == "cpu":
        return bundle
    return replace(bundle, vectors=bundle.vectors.to(device), parts=_PartsOn(device, bundle.parts))


class _PartsOn(Mapping[str, nn.Module]):
    """The models of a bundle, each moved to a device when it is asked for first."""

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

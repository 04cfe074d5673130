"""The product in Python: `Gesticulator.from_pretrained()(speech) -> Performance`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.blocks import denormalise
from data_module.controls import FEATURES, Controls
from data_module.errors import InputError
from data_module.speech.audio import SAMPLE_RATE, load_speech, resample
from data_module.types import Array, Motion, Speech
from gesticulator.bundle import SHIPPED, Bundle
from gesticulator.bundle import load as load_bundle
from gesticulator.performance import BEST, Performance
from gesticulator.speech_features import SpeechFeatures, encode_speech, front_end_for
from gesticulator.statistics import control_rows, representation_of
from interpreters.base import BlockFeatures, LexemeInterpreter, select

if TYPE_CHECKING:
    from data_module.text.word_vectors import WordEncoder
    from lexicon.racer import RacerCodec

FPS = 60.0
"""Frames per second of the result when not told: the models' 20 fps knots, interpolated."""


class Gesticulator:
    """A loaded bundle that turns speech into gesture, block by block (RG 6, Eq. 15)."""

    def __init__(self, bundle: Bundle) -> None:
        self.bundle = bundle
        self._front_end = front_end_for(bundle.config, bundle.encoder)
        self._words: WordEncoder | None = None

    @classmethod
    def from_pretrained(cls, path: str | PathLike[str] | None = None) -> Gesticulator:
        """Load a bundle's folder; the shipped one when no path is given."""
        return cls(load_bundle(Path(path) if path is not None else SHIPPED))

    @property
    def speakers(self) -> tuple[str, ...]:
        """The performers whose habits the bundle knows."""
        return self.bundle.speakers

    def speaker_index(self, speaker: str | None) -> int:
        """The number of a performer; InputError lists the known ones."""
        if speaker is None:
            preferred = self.bundle.config.default_speaker
            return self.speakers.index(preferred) if preferred in self.speakers else 0
        if speaker not in self.speakers:
            raise InputError(f"--speaker {speaker}", "is not in the bundle", f"choose among {', '.join(self.speakers)}")
        return self.speakers.index(speaker)

    @property
    def reads_text(self) -> bool:
        """True when the bundle has an interpreter that reads the words."""
        return "interpreter_text" in self.bundle.parts

    def interpreter(self, name: str, text: bool = False) -> LexemeInterpreter:
        """The lexeme interpreter of that name over the bundle's lexicon; with `text`, the one that reads the words."""
        return self.bundle.interpreter_named(name, text)

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

    def read(self, speech: Speech, text: str | PathLike[str]) -> tuple[Speech, str]:
        """Speech with the words of a transcript file, and a line on how their times were got."""
        if not self.reads_text:
            raise InputError("--text", "is not read by this bundle", "use a bundle trained with text, or leave it out")
        from data_module.text.transcript import read_transcript, with_transcript

        spoken, timing = with_transcript(speech, read_transcript(Path(text), speech))
        return spoken, timing.note

    def __call__(self, speech: Speech | str | PathLike[str], *, text: str | PathLike[str] | None = None,
                 speaker: str | None = None, seed: int = 0, fps: float | None = None,
                 interpreter: str | LexemeInterpreter | None = None, temperature: float | None = None,
                 controls: Controls | None = None, activity: float | None = None, encoded: SpeechFeatures | None = None,
                 on_block: Callable[[int, int], None] | None = None) -> Performance:
        """Gesture for a recording.

        speech: a `Speech` at any sample rate, or the path of a sound file; words that it carries are read. text: a
        transcript of it (plain text, TextGrid, SRT, VTT, JSON). Without words the audio-only path is taken (RG 6.3).
        speaker: a performer's habits. fps: frames per second of the result (60). interpreter: what chooses the lexemes,
        by name ("lstm", "cql", "statistical"; the bundle's first when none is named) or as an object. temperature:
        how freely lexemes are drawn, 0 for always the likeliest. controls: what is asked of hand height, speed and
        radius (RG 7.2.1). activity: how readily to gesture at all, 0 (stillness) to 1 (always). encoded: what
        `encode_speech` gave for this speech, to gesture for it again without encoding it again. What is not given is
        the bundle's own.
        on_block(done, total) is called after each block. The same seed, bundle and speech give the same
        result.
        """
        if not isinstance(speech, Speech):
            speech = load_speech(speech)
        if fps is not None and not 1 <= fps <= 1000:
            raise InputError(f"--fps {fps:g}", "is out of range", "choose 1 to 1000")
        if temperature is not None and temperature < 0:
            raise InputError(f"--temperature {temperature:g}", "is negative", "choose 0 or more")
        chosen = self.bundle.config.selection
        activity = chosen.activity if activity is None else activity
        self._check(activity, controls)
        speech = resample(speech, SAMPLE_RATE)
        note = ""
        if text is not None:
            speech, note = self.read(speech, text)
        who = self.speaker_index(speaker)
        reads = self._reads(speech)
        encoded = self.encode_speech(speech) if encoded is None else encoded
        interpreter = self.bundle.interpreters[0] if interpreter is None else interpreter
        system = self.interpreter(interpreter, reads) if isinstance(interpreter, str) else interpreter
        of_value = getattr(system, "gives_values", False)
        usual = chosen.q_temperature if of_value else chosen.temperature
        asked = None
        if controls is not None and self.bundle.levels is not None:
            values, given = controls.at(encoded.blocks.knot_times)
            rows = control_rows(self.bundle.levels, values, np.broadcast_to(given, values.shape))
            asked = rows.reshape(len(encoded.blocks), encoded.blocks.frames, -1)
        rolls = _Decoded if self.bundle.config.tokens == "racer" else _Roll
        roll = rolls(self.bundle, system, who, np.random.default_rng(seed),
                     usual if temperature is None else temperature, chosen.top or None, activity)
        made = roll.run(encoded, asked, on_block)
        motion = self.to_motion(made.motion, encoded, who, FPS if fps is None else fps)
        return Performance(motion=motion, speech=speech, blocks=encoded.blocks, lexemes=made.lexemes, best=made.best,
                           scores=made.scores, codes=made.codes, gate=made.gate, notes=(note,) if note else (),
                           score_is="expected return" if of_value else "log-probability")

    def encode_speech(self, speech: Speech) -> SpeechFeatures:
        """A speech at 16 kHz cut into blocks and encoded, with its words where the bundle reads them."""
        words = self.word_encoder() if self._reads(speech) else None
        return encode_speech(speech, self.bundle.config, self._front_end, words)

    def _reads(self, speech: Speech) -> bool:
        return self.reads_text and any(word.text.strip() for word in speech.words or ())

    def _check(self, activity: float, controls: Controls | None) -> None:
        if not 0 <= activity <= 1:
            raise InputError(f"--activity {activity:g}", "is out of range", "choose 0 (stillness) to 1 (always)")
        if 0 < activity < 1 and "gate" not in self.bundle.parts:
            raise InputError(f"--activity {activity:g}", "needs a gate, and this bundle has none", "use 0 or 1")
        if controls is not None and controls != Controls.free() and self.bundle.levels is None:
            raise InputError(f"the control of {', '.join(FEATURES)}", "is not heard by this bundle",
                             "use a bundle trained with generator.use_control")

    def to_motion(self, features: NDArray[np.float32], encoded: SpeechFeatures, speaker: int, fps: float) -> Motion:
        """Normalised blocks [N, K, D_m] on the speech's own clock, smoothed, as motion at `fps` (RG 4.2.2, 7.1.2)."""
        statistics = self.bundle.statistics
        poses: Array = statistics.denormalise(features.astype(np.float64), speaker)
        frames = denormalise(poses, statistics.rest_pose[speaker], encoded.blocks, fps,
                             self.bundle.config.motion.smoothing)
        return representation_of(self.bundle.config).motion(frames, fps)


@dataclass(frozen=True)
class _Made:
    """Motion features [N, K, D_m], lexemes [N], the best lexemes [N, M] and their scores [N, M], style codes [N, d_z]
    and the gate's probabilities [N]."""

    motion: NDArray[np.float32]
    lexemes: NDArray[np.int64]
    best: NDArray[np.int64]
    scores: NDArray[np.float64]
    codes: NDArray[np.float32]
    gate: NDArray[np.float64]


_SETTLES_AFTER = 2
"""Quiet blocks that are played as they are generated: the arms come down in them."""


def settled(last: Tensor, block: Tensor, share: float) -> Tensor:
    """A block of rest [B, K, D_m]: evenly from the last pose [B, 1, D_m] a share of the way to the block's mean pose.

    The distance to rest shrinks by `share` with each block, so a long rest becomes still.
    """
    frames = block.shape[1]
    steps = torch.arange(1, frames + 1, dtype=block.dtype)[:, None] / frames
    return last + share * steps * (block.mean(dim=1, keepdim=True) - last)


class _Roll:
    """One performance in the making: the states of interpreter, gate, style and generator."""

    def __init__(self, bundle: Bundle, interpreter: LexemeInterpreter, speaker: int,
                 rng: np.random.Generator, temperature: float, top: int | None, activity: float) -> None:
        self.bundle, self.interpreter, self.speaker, self.rng = bundle, interpreter, speaker, rng
        self.temperature, self.top, self.activity = temperature, top, activity
        s = bundle.statistics
        self.quiet = None if s.quiet_low is None else torch.as_tensor(s.quiet_low, dtype=torch.float32)

    @torch.inference_mode()
    def run(self, encoded: SpeechFeatures, asked: NDArray[np.float32] | None,
            on_block: Callable[[int, int], None] | None) -> _Made:
        """Every block in turn. asked: [N, K, 2 F] rows of the control, or None."""
        b = self.bundle
        generator, style = b.generator_and_style(encoded.text is not None)
        gate = b.gate if self.activity < 1 else None
        vectors, count = b.vectors, len(encoded.blocks)
        best_count = min(BEST, len(vectors))
        previous = b.rest_lexeme(self.speaker)
        rest = b.rest_feature(self.speaker)
        past = rest.expand(1, b.frames, -1)
        state = generator.first_state(rest[None], vectors[[previous]])
        inner, style_state = self.interpreter.start(self.speaker, previous), style.start(self.speaker)
        free, free_state = inner, state
        guidance = b.config.selection.guidance
        gate_state = None if gate is None else gate.start(self.speaker)
        bounds = torch.as_tensor(b.statistics.bounds, dtype=torch.float32)
        made = _Made(np.empty((count, *past.shape[1:]), np.float32), np.empty(count, np.int64),
                     np.empty((count, best_count), np.int64), np.empty((count, best_count)),
                     np.empty((count, style.code_width), np.float32), np.full(count, np.nan))
        resting = _SETTLES_AFTER  # who has not begun is at rest
        for i in range(count):
            features = self._features(encoded, i, asked)
            closed = self.activity == 0
            if gate is not None and gate_state is not None:
                made.gate[i], gate_state = gate.step(gate_state, features)
                closed = not gate.opened(float(made.gate[i]), self.activity)
            scores, inner = self.interpreter.step(inner, features, previous)
            if asked is not None:
                unasked, free = self.interpreter.step(free, replace(features, control=None), previous)
                scores = unasked + guidance * (scores - unasked)
            quiet = closed or (features.silent and b.config.silence.mask)
            previous = select(scores, allowed=b.silent if quiet else None, temperature=self.temperature, top=self.top,
                              rng=self.rng)
            if closed and self.quiet is not None:
                # A block on which nothing is to be done is one on which nothing is said.
                features = replace(features, low=self.quiet, silent=True)
            code, style_state = style.step(style_state, features, previous)
            audio = generator.encode_audio(features.low[None])
            control = None if features.control is None else features.control[None]
            block, state, _ = generator.step(past, audio, vectors[[previous]], code, state, control=control)
            if asked is not None:
                unled, free_state, _ = generator.step(past, audio, vectors[[previous]], code, free_state)
                block = unled + guidance * (block - unled)
            resting = resting + 1 if quiet else 0
            if resting > _SETTLES_AFTER and b.config.silence.rest_decay > 0:
                block = settled(past[:, -1:], block, b.config.silence.rest_decay)
            # What it was never shown it must not feed itself: one odd pose would lead to the next.
            past = torch.clamp(block, *bounds)
            made.motion[i], made.lexemes[i], made.codes[i] = past[0].numpy(), previous, code[0].numpy()
            self._note(made, i, scores, on_block)
        return made

    @staticmethod
    def _note(made: _Made, i: int, scores: NDArray[np.float64], on_block: Callable[[int, int], None] | None) -> None:
        made.best[i] = np.argsort(-scores, kind="stable")[:made.best.shape[1]]
        made.scores[i] = scores[made.best[i]]
        if on_block is not None:
            on_block(i + 1, len(made.best))

    def _features(self, encoded: SpeechFeatures, i: int, asked: NDArray[np.float32] | None) -> BlockFeatures:
        s = self.bundle.statistics
        low = torch.as_tensor(s.low.apply(encoded.low[i]), dtype=torch.float32)
        high = torch.as_tensor(s.high.apply(encoded.high[i]), dtype=torch.float32)
        text = None if encoded.text is None else torch.as_tensor(encoded.text[i])
        return BlockFeatures(low, high, bool(encoded.blocks.silent[i]), text,
                             None if asked is None else torch.as_tensor(asked[i]))


class _Decoded(_Roll):
    """A performance of RACER's own: codes are chosen one by one and decoded together, without a generator (RACER 5.2).

    There is no style, no gate and no silence in it; `activity` 0 holds the resting code.
    """

    @torch.inference_mode()
    def run(self, encoded: SpeechFeatures, asked: NDArray[np.float32] | None,
            on_block: Callable[[int, int], None] | None) -> _Made:
        """Every code in turn; nothing can be asked of the style."""
        codec = cast("RacerCodec", self.bundle.lexicon)
        count, best = len(encoded.blocks), min(BEST, len(codec.vectors))
        rest = previous = self.bundle.rest_lexeme(self.speaker)
        made = _Made(np.empty((0, 0, 0), np.float32), np.empty(count, np.int64), np.empty((count, best), np.int64),
                     np.empty((count, best)), np.zeros((count, 0), np.float32), np.full(count, np.nan))
        state = self.interpreter.start(self.speaker, previous)
        for i in range(count):
            scores, state = self.interpreter.step(state, self._features(encoded, i, asked), previous)
            previous = select(scores, temperature=self.temperature, top=self.top, rng=self.rng)
            made.lexemes[i] = previous = rest if self.activity == 0 else previous
            self._note(made, i, scores, on_block)
        # The resting code before the first: the codec then begins where the figure stands.
        codes = torch.as_tensor(np.concatenate([[rest], made.lexemes]))[None]
        return replace(made, motion=codec.decode_tokens(codes)[0, 1:].numpy())

"""Where the paper's form loses its timing: PMB above chance, by both detectors of `eval.metrics.eye.voice`, from the
performer's motion to what is played, one step of the pipeline at a time; and of what is played with other sounds."""

from __future__ import annotations

from typing import cast

import numpy as np
import torch
from torch import Tensor

from data_module import blocks as block_module
from data_module.store import Recording, Store
from data_module.types import Array, Motion
from eval.clip.excerpts import excerpt
from eval.metrics.encode import normalised_blocks
from eval.metrics.eye import VoiceActivity, common_body, hear, voice
from eval.metrics.pmb import wrapped
from eval.renderings import SECONDS, SHORTEST
from eval.stats import mean_interval
from eval.table import Column, Table
from generator.model import BlockInputs, Generator
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.gesticulator import Gesticulator
from lexicon.autoencoder import Lexicon


def timing_table(store: Store, bundle: Bundle, limit: int | None) -> Table:
    """The table over test recordings of 20 s or more, the first `limit` of them; intervals are over recordings."""
    infos = [info for info in store.of_split("test") if info.seconds >= SHORTEST][:limit]
    pieces = [excerpt(store.load(info.name, bundle.config.motion.joints), SECONDS) for info in infos]
    sounds, each = [hear(piece.speech) for piece in pieces], [_steps(bundle, piece) for piece in pieces]
    rows = {name: [_above(steps[name], sound) for steps, sound in zip(each, sounds, strict=True)] for name in each[0]}
    rows["played, other sounds"] = [
        np.nanmean([_above(steps["played"], other) for other in sounds if other is not sound], axis=0)
        for steps, sound in zip(each, sounds, strict=True)]
    detectors = ("first", "second")
    return Table("Timing", {key: Column(f"PMB above chance, {key} detector", "%", 0, "high") for key in detectors},
                 {name: {key: mean_interval(np.array(values)[:, k]) for k, key in enumerate(detectors)}
                  for name, values in rows.items()}, "motion", [f"{len(infos)} test recordings."])


def _above(motion: Motion, sound: VoiceActivity) -> Array:
    hands = common_body(motion).hands
    return np.array([voice.above_chance(beats, wrapped(onsets, sound.duration, motion.duration), motion.duration)
                     for beats, onsets in zip((voice.hand_beats(hands), voice.summed_beats(hands)), sound.onsets,
                                              strict=True)])


@torch.no_grad()
def _steps(bundle: Bundle, piece: Recording) -> dict[str, Motion]:
    config, statistics, name = bundle.config, bundle.statistics, piece.info.speaker
    lexicon, generator = cast(Lexicon, bundle.block_lexicon), cast(Generator, bundle.generator)
    representation, blocks = representation_of(config), block_module.cut(piece.speech, config.rhythm)
    first = block_module.first_pose(piece.motion, representation)
    true, past = normalised_blocks(config, statistics, piece.motion, blocks, name)

    def back(features: Tensor, smoothing: float = config.motion.smoothing) -> Motion:
        poses = statistics.denormalise(features.flatten(0, 1).double().numpy(), statistics.speakers.index(name))
        fps = piece.motion.fps
        return representation.motion(block_module.denormalise(poses, first, blocks, fps, smoothing), fps)

    vectors = lexicon.vectors[lexicon.label(true)]
    speech = Gesticulator(bundle).encode_speech(piece.speech, blocks)
    low = np.stack([statistics.low.apply(speech.block(i).low) for i in range(len(true))]).astype(np.float32)
    codes = vectors.new_zeros(1, len(true), config.generator.style_width)
    given = BlockInputs(torch.as_tensor(low)[None], vectors[None], codes)
    generated, _ = generator.roll_out(past.frames[:1, -1:].expand(-1, true.shape[1], -1), given)
    return {"performer": piece.motion, "blocks at 20 fps and back": back(true, 0.0), "the same, five taps": back(true),
            "lexicon, not quantised": back(lexicon.decode(lexicon.latents(true))),
            "lexemes, decoded": back(lexicon.decode(vectors)),
            "generator, true lexemes, zero codes": back(generated[0]),
            "played": Gesticulator(bundle)(piece.speech, speaker=name, seed=0).motion}

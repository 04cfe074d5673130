"""Rhythmic Gesticulator step by step, from a recording to a BVH file, in the order of the paper (RG 4 to 6).

    python examples/rhythmic_gesticulator.py examples/speech.flac gesture.bvh

The motion is that of `gesticulator infer examples/speech.flac --bundle paper`; the same steps stand in
`gesticulator/systems/paper.py`.
"""

from __future__ import annotations

import sys

import numpy as np

from data_module.motion.bvh import write_bvh
from data_module.speech.audio import SAMPLE_RATE, load_speech, resample
from data_module.types import Motion, Speech
from gesticulator.body.motion_path import MotionPath
from gesticulator.bundle.bundle import Bundle, load
from gesticulator.bundle.features import front_end_for
from gesticulator.bundle.files import NAMED
from gesticulator.options import InferenceOptions
from gesticulator.sampling.cutter import encode_speech
from gesticulator.sampling.loop import Keys
from interpreters.base import BlockFeatures, select


def gesture(bundle: Bundle, speech: Speech, seed: int = 0) -> Motion:
    """Motion for a speech at 16 kHz, without words."""
    settings, statistics = bundle.config, bundle.statistics
    speaker = bundle.speakers.index(settings.default_speaker)

    # RG 4.2: beats are detected, and each block between two of them is stretched to K frames. RG 4.1: the speech
    # encoder gives two levels of features of each block and its neighbours, low [N, 3K, d] and high [N, 3K, d].
    encoded = encode_speech(speech, settings, front_end_for(settings, bundle.runners.get("encoder")))

    # RG 6: s_0 is a silent lexeme, M_0 the resting pose.
    lexeme = bundle.rest_lexeme(speaker)
    past = np.repeat(bundle.rest_feature(speaker)[None], bundle.frames, axis=0)
    interpreter, style, generator = (bundle.runners[name] for name in ("interpreter", "style", "generator"))
    history = interpreter.start(speaker, lexeme)
    style_state = style.start(speaker)
    decoder = generator.start(past[-1], bundle.vectors[lexeme])

    blocks = []
    for i in range(len(encoded)):
        block = encoded.block(i)
        features = BlockFeatures(statistics.low.apply(block.low), statistics.high.apply(block.high), block.silent[1],
                                 past=past, durations=block.durations[:2])

        # RG 6.1, Eq. 16 to 18: the lexeme from high-level audio, the speaker and the lexemes before. In silence only
        # silent lexemes may follow (RG 6.4.1). One is sampled; the noise is a function of the seed and the time.
        scores, history = interpreter.step(history, features, lexeme)
        lexeme = select(scores, allowed=bundle.silent if features.silent else None,
                        temperature=settings.selection.temperature,
                        noise=Keys(seed).gumbel(block.keyed_at, len(scores)))

        # RG 6.2, Eq. 19: the style code from low-level audio and the lexeme.
        code, style_state = style.step(style_state, features, lexeme)

        # RG 5.2, Eq. 15: the motion of the block from the block before, low-level audio, lexeme and style code.
        audio = generator.encode_audio(features.low)
        motion, decoder = generator.step(past, audio, bundle.vectors[lexeme], code, decoder)
        past = np.clip(motion, *statistics.bounds.astype(np.float32))  # within the training data
        blocks.append(past)

    # RG 4.2.2: the blocks are stretched back onto the rhythm of the speech, denormalised and smoothed (RG 7.1.2).
    path = MotionPath(bundle, speaker, InferenceOptions())
    times = encoded.blocks.knot_times.reshape(len(blocks), -1)
    parts = [path.push(knots, block) for knots, block in zip(times, blocks, strict=True)]
    parts.append(path.finish(float(encoded.blocks.edges[-1])))
    frames = [part for part in parts if part is not None]
    return Motion(frames[0].skeleton, np.concatenate([part.rotations for part in frames]),
                  np.concatenate([part.root_positions for part in frames]), frames[0].fps)


def main(sound: str, output: str) -> None:
    """Gesture for one recording, written as BVH."""
    write_bvh(output, gesture(load(NAMED["paper"]), resample(load_speech(sound), SAMPLE_RATE)))
    print(output)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""RACER step by step, from a recording to a BVH file, in the order of the paper (RACER 4.3 and 5.2).

    python examples/racer.py examples/speech.flac gesture.bvh
    python examples/racer.py examples/speech.flac gesture.bvh MY_BUNDLE

Without a bundle, the Q-network of the shipped bundle `paper` chooses among the lexemes of Rhythmic Gesticulator's
lexicon, whose VQ-VAE decodes them. With a bundle of the preset `racer-native`, it chooses among the codes of RACER's
codec, which decodes them together. `gesticulator/systems/racer.py` has the same steps.
"""

from __future__ import annotations

import sys

import numpy as np

from data_module.layers_run import Floats
from data_module.motion.bvh import write_bvh
from data_module.speech.audio import SAMPLE_RATE, load_speech, resample
from data_module.types import Motion, Speech
from gesticulator.body.motion_path import MotionPath
from gesticulator.bundle.bundle import Bundle, load
from gesticulator.bundle.features import SpeechFeatures, front_end_for
from gesticulator.bundle.files import bundle_folder
from gesticulator.options import InferenceOptions
from gesticulator.sampling.cutter import encode_speech
from interpreters.base import BlockFeatures
from lexicon.racer_run import CodecRunner


def codes_of(bundle: Bundle, encoded: SpeechFeatures, speaker: int) -> list[int]:
    """The actions a_1 to a_N, one for each block of speech (RACER 4.3)."""
    statistics, policy = bundle.statistics, bundle.runners["q_network"]
    code = bundle.rest_lexeme(speaker)  # a_0
    history, codes = policy.start(speaker, code), []
    for i in range(len(encoded)):
        block = encoded.block(i)
        features = BlockFeatures(statistics.low.apply(block.low), statistics.high.apply(block.high), block.silent[1],
                                 durations=block.durations[:2])
        # Eq. 9: Q(s_t, a) for every action a, from the audio and the actions before (the state s_t).
        values, history = policy.step(history, features, code)
        # Eq. 12: the policy takes the action of the largest value.
        code = int(np.argmax(values))
        codes.append(code)
    return codes


def decoded(bundle: Bundle, codes: list[int], speaker: int) -> Floats:
    """[N, K, D_m] the motion of N codes (RACER 5.2)."""
    lexicon = bundle.runners["lexicon"]
    if isinstance(lexicon, CodecRunner):
        # The decoder sees the codes of the whole recording at once, after one of rest.
        return lexicon.decode([bundle.rest_lexeme(speaker), *codes])[1:]
    return lexicon.shown()[codes]


def gesture(bundle: Bundle, speech: Speech) -> Motion:
    """Motion for a speech at 16 kHz."""
    speaker = bundle.speakers.index(bundle.config.default_speaker)
    encoded = encode_speech(speech, bundle.config, front_end_for(bundle.config, bundle.runners.get("encoder")))
    blocks = decoded(bundle, codes_of(bundle, encoded, speaker), speaker)

    # Back onto the time of the speech, denormalised and smoothed.
    path = MotionPath(bundle, speaker, InferenceOptions())
    times = encoded.blocks.knot_times.reshape(len(blocks), -1)
    parts = [path.push(knots, block) for knots, block in zip(times, blocks, strict=True)]
    parts.append(path.finish(float(encoded.blocks.edges[-1])))
    frames = [part for part in parts if part is not None]
    return Motion(frames[0].skeleton, np.concatenate([part.rotations for part in frames]),
                  np.concatenate([part.root_positions for part in frames]), frames[0].fps)


def main(sound: str, output: str, bundle: str = "paper") -> None:
    """Gesture for one recording, written as BVH."""
    write_bvh(output, gesture(load(bundle_folder(bundle)), resample(load_speech(sound), SAMPLE_RATE)))
    print(output)


if __name__ == "__main__":
    main(*sys.argv[1:])

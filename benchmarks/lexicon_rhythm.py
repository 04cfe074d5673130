"""Do lexemes carry the rhythm? `python benchmarks/lexicon_rhythm.py --data STORE --work DIR [--set ...]`

A lexicon that names poses is of no use to the beat. The probe is linear, so it says what is in the lexemes and not how
well a network was trained: each block is regressed (ridge, training split) on the last pose of the block before and
the one-hot lexeme, rolled out over held-out talks with their true lexemes, and its motion beats are set against the
onsets. DIR is the work folder of `gesticulator.train` where the lexicon of those settings was trained
(`--stage lexicon`); it is trained there when it was not.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from data_module.blocks import cut, denormalise
from data_module.motion.motion_beats import motion_beats
from data_module.motion.skeletons import from_vector
from data_module.speech.beats import detect_onsets
from data_module.store import Store
from data_module.types import Array
from eval.bootstrap import interval
from eval.metrics import pmb
from gesticulator import config as configs
from gesticulator.pipeline import FPS
from gesticulator.prepare import Corpus, prepare
from gesticulator.train import Run, train_lexicon

_RIDGE = 10.0


def regression(corpus: Corpus, labels: np.ndarray, size: int) -> Array:
    """[D_m + S + 1, K * D_m] weights from (last pose before, one-hot lexeme, 1) to the block."""
    motion = corpus.motion.numpy().astype(np.float64)
    before = np.concatenate([motion[:1, -1], motion[:-1, -1]])
    begins = np.flatnonzero(np.diff(corpus.recording, prepend=-1))
    before[begins] = corpus.first.numpy()[corpus.recording[begins]]
    rows = np.concatenate([before, np.eye(size)[labels], np.ones((len(motion), 1))], axis=1)[corpus.select("train")]
    wanted = motion[corpus.select("train")].reshape(len(rows), -1)
    return np.linalg.solve(rows.T @ rows + _RIDGE * np.eye(rows.shape[1]), rows.T @ wanted)


def roll_out(weights: Array, corpus: Corpus, labels: np.ndarray, recording: int, size: int) -> Array:
    """[N, K, D_m] of a recording, each block from what was made before it."""
    pose, made = corpus.first.numpy()[recording].astype(np.float64), []
    for block in corpus.blocks_of(recording):
        row = np.concatenate([pose, np.eye(size)[labels[block]], [1.0]])
        made.append((row @ weights).reshape(corpus.motion.shape[1:]))
        pose = made[-1][-1]
    return np.stack(made)


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--data", required=True)
    p.add_argument("--work", required=True)
    p.add_argument("--preset", default="default")
    p.add_argument("--split", default="val", choices=("val", "test"), help="choices are made on val")
    p.add_argument("--set", action="append", default=[], dest="settings")
    p.add_argument("--out", help="JSON file; a row is added under the settings' names")
    a = p.parse_args()
    config = configs.with_settings(configs.preset(a.preset), a.settings)
    store = Store.open(a.data)
    run = Run(config, store, Path(a.work), progress=False)
    run.corpus = corpus = prepare(store, config, run.work, progress=False)
    lexicon, _ = train_lexicon(run)
    size = config.lexicon.size
    labels = lexicon.label(corpus.motion).numpy()
    weights = regression(corpus, labels, size)
    above: dict[str, list[float]] = {"performer": [], "lexemes": []}
    for recording in corpus.recordings(a.split):
        if not corpus.names[recording].startswith("talk"):
            continue
        speech = store.load(corpus.names[recording]).speech
        blocks, onsets = cut(speech, config.rhythm), detect_onsets(speech.samples, speech.sample_rate)
        s, speaker = corpus.statistics, int(corpus.speaker_of[recording])
        for name, features in (("performer", corpus.motion[torch.as_tensor(corpus.blocks_of(recording))].numpy()),
                               ("lexemes", roll_out(weights, corpus, labels, recording, size))):
            poses = s.denormalise(features.astype(np.float64), speaker)
            beats = motion_beats(from_vector(denormalise(poses, s.rest_pose[speaker], blocks, FPS), FPS))
            level = pmb.chance(beats, onsets, speech.duration).mean
            above[name].append(100 * pmb.above_chance(pmb.pmb(beats, onsets), level))
    row = {name: interval(values).to_dict() for name, values in above.items()}
    title = " ".join([a.preset, *a.settings])
    print(title, json.dumps(row))
    if a.out:
        out = Path(a.out)
        rows = json.loads(out.read_text()) if out.exists() else {}
        out.write_text(json.dumps({**rows, title: row}, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Does contrast with the words bring the high level nearer to them? (RG 4.1.3, Eq. 1 and 2)

`python benchmarks/word_contrast.py STORE [--steps 4000] [--out FILE.json]`

The speech encoder of a preset is trained by predictive coding and then by the contrast, twice: once as published, and
once with the encoder held fixed, so that only the projections into the common space learn. On the test split, of each
frame in which a word sounds: does the most similar frame of its block at a level have the same word?

What fools it: a word is voiced and a pause is not, so a level that only knows loudness finds the right frames, too,
with any word. So every frame is also asked with the vector of another word of its recording; only what is lost by that
is due to the words.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from data_module.layers import freeze
from data_module.speech.speech_encoder import HIGH, LEVELS, TextContrast
from data_module.types import Array
from eval import stats
from eval.context import opened
from eval.table import Column, Provenance, Table, publish
from gesticulator.bundle.config import with_settings
from gesticulator.training import fit as fitting
from gesticulator.training.presets import preset
from gesticulator.training.stages.base import Run
from gesticulator.training.stages.corpus import BLOCKS
from gesticulator.training.stages.speech import CONTRAST, ContrastWindows

_WINDOWS = 64
"""Of a test recording, evenly spread."""
TRAINED, FIXED = "encoder trained", "encoder fixed"
OWN, OTHER = "own word", "another word"


def fixed(run: Run, learn: ContrastWindows) -> TextContrast:
    """The projections alone, trained as `CONTRAST` is, on the encoder as predictive coding left it."""
    settings, seed = run.schedule(CONTRAST), run.seed(CONTRAST)
    assert CONTRAST.build is not None
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = CONTRAST.build(run)
    model.encoder.requires_grad_(False)
    with tempfile.TemporaryDirectory() as scratch:  # a checkpoint would be continued with other settings, too
        fitting.fit("contrast, fixed", model, fitting.Task(lambda rng: learn.sample(rng, settings.batch)), settings,
                    Path(scratch),
                    fitting.FitOptions(seed=seed, checkpoint_seconds=float("inf"), progress=run.progress))
    freeze(model)
    return model


def with_other_words(batch: fitting.Batch) -> fitting.Batch:
    """The same windows, in which every frame of a word has the vector of a word half of the windows away."""
    spoken = batch["word"] >= 0
    text = batch["text"].clone()
    rows = text[spoken]
    text[spoken] = rows.roll(len(rows) // 2, dims=0)
    return {**batch, "text": text}


def chance(word: Tensor) -> float:
    """Of words [B, K], -1 for none: how often any frame of the block has the anchor's word, as `retrieval` counts."""
    same = word[:, :, None] == word[:, None]
    anchors = (word >= 0) & ~same.all(dim=-1)
    return float(same[anchors].float().mean())


def asked(models: dict[str, TextContrast], recordings: Sequence[ContrastWindows]) -> tuple[dict[str, Array], Array]:
    """Shares [recordings, 8] by "MODEL, WORD", and by chance [recordings]; recordings without an anchor are left
    out."""
    rows: dict[str, list[Array]] = {f"{name}, {word}": [] for name in models for word in (OWN, OTHER)}
    luck = []
    for windows in recordings:
        batch = windows.batch(windows.blocks[np.linspace(0, len(windows.blocks) - 1, _WINDOWS).astype(int)])
        if not np.isfinite(by_luck := chance(batch["word"])):
            continue
        luck.append(by_luck)
        for word, own in ((OWN, batch), (OTHER, with_other_words(batch))):
            for name, model in models.items():
                rows[f"{name}, {word}"].append(model.retrieval(own).double().numpy())
    return {name: np.stack(own) for name, own in rows.items()}, np.array(luck)


def tables(shares: dict[str, Array], luck: Array, groups: Sequence[str], notes: Sequence[str]) -> list[Table]:
    """Shares by level, and what the contrast brings to the high one, whose intervals are the claim."""
    percent = {name: 100.0 * own for name, own in shares.items()}
    columns = {name: Column(name, "%", 1) for name in percent}
    levels = {f"level {level + 1}": {name: stats.mean_interval(own[:, level], groups=list(groups))
                                     for name, own in percent.items()} for level in range(LEVELS)}
    by_luck = stats.mean_interval(100.0 * luck, groups=list(groups))

    def apart(first: str, second: str) -> stats.Interval:
        return stats.paired(percent[first][:, HIGH - 1], percent[second][:, HIGH - 1], groups=list(groups))

    brought = {f"{TRAINED} - {FIXED}, {OWN}": apart(f"{TRAINED}, {OWN}", f"{FIXED}, {OWN}"),
               f"{TRAINED}: {OWN} - {OTHER}": apart(f"{TRAINED}, {OWN}", f"{TRAINED}, {OTHER}")}
    shown = brought | {f"{FIXED}: {OWN} - {OTHER}": apart(f"{FIXED}, {OWN}", f"{FIXED}, {OTHER}")}
    return [Table("Level 8", {"difference": Column("difference", "points", 1)},
                  {name: {"difference": value} for name, value in shown.items()}, "less",
                  [*notes, "Paired over recordings. The claim rests on the first two."],
                  {"claim": [value.to_dict() for value in brought.values()]}),
            Table("Frames of a word whose nearest frame has the same word", columns,
                  levels | {"chance": dict.fromkeys(columns, by_luck)}, "level",
                  ["By the frame's own word, and by another of the recording: what loudness alone finds."])]


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--preset", default="paper", help="whose encoder (default paper)")
    p.add_argument("--steps", type=int, default=4000, help="steps of the contrast (default 4000)")
    p.add_argument("--limit", type=int, help="test recordings (default: all)")
    p.add_argument("--work", metavar="DIR", help="work folder, in which stages are kept (default: STORE.work)")
    p.add_argument("--quiet", action="store_true")
    p.add_argument("--out")
    a = p.parse_args()
    store, work = opened(a.store, a.work)
    run = Run(with_settings(preset(a.preset), (f"schedules.contrast.steps={a.steps}",)), store, work,
              progress=not a.quiet)
    corpus, frames = run.get(BLOCKS), run.config.rhythm.frames
    known = ContrastWindows.of(corpus, corpus.recordings("train", with_text=True), frames)
    models = {TRAINED: run.get(CONTRAST), FIXED: fixed(run, known)}
    test = corpus.recordings("test", with_text=True)[:a.limit]
    shares, luck = asked(models, [ContrastWindows.of(corpus, (recording,), frames) for recording in test])
    passes = a.steps * run.schedule(CONTRAST).batch / len(known.blocks)
    note = (f"Preset {a.preset}, width {run.config.encoder.width}; {a.steps} steps of the contrast, {passes:.1f} "
            f"passes over {len(known.blocks)} blocks with a word; {len(luck)} test recordings, {_WINDOWS} windows of "
            f"each. Loss on the validation split {run.figures['contrast']['contrast']:.3f} nats.")
    publish(tables(shares, luck, [str(k) for k in range(len(luck))], [note]), a.out,
            Provenance.now(shlex.join(["python", "benchmarks/word_contrast.py", *sys.argv[1:]])))


if __name__ == "__main__":
    main()

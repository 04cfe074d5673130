"""What a part of the lexeme interpreter bought: text, the right text, the learned speech levels. With and without.

    python -m eval.parts --data STORE --work DIR [--bundle DIR] [--out docs/results/parts.json]

Every row reads the same test recordings over the same lexicon, with the true lexeme before each block (teacher
forcing), so that two rows differ by the part alone; differences are paired over recordings with bootstrap 95 %
intervals. Accuracy is the share of blocks whose best score is the performer's lexeme. Drawn is the share of right
lexemes when they are drawn as the product draws them, at the bundle's temperature: the mean probability of the
performer's lexeme. Surprise is the mean negative log-probability of that lexeme in nats (less is better).

Rows: `text` reads the right words; `wrong text` is the same interpreter on the words of other recordings, which is
what a transcript without meaning would give (the mean over five of them); `audio only` is the interpreter that never
reads. `mel` is the audio-only interpreter on mel bands instead of the learned levels: it is trained here (in DIR, kept)
with the same settings.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.errors import one_line_errors
from data_module.store import Store
from eval.bootstrap import interval
from eval.results import publish
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator.stages import CORPUS, INTERPRETER, LEXICON, TOKENS, Run
from gesticulator.stages.corpus import Corpus, prepare, weights_hash
from interpreters.lstm import LstmInterpreter
from lexicon.inventory import nearest_silent

Scores = dict[str, NDArray[np.float64]]
_MEL = ("front_end.name=mel", "front_end.bands=32")


def hinted_labels(bundle: bundles.Bundle, corpus: Corpus) -> NDArray[np.int64]:
    """[N] lexemes of all blocks, silent blocks with the silent lexeme nearest to their own (RG 6.4.1)."""
    labels = bundle.block_models.lexicon.label(corpus.motion).numpy()
    nearest = nearest_silent(bundle.lexicon.vectors.double().numpy(), bundle.silent)
    return np.where(corpus.silent, nearest[labels], labels) if bundle.config.silence.hint else labels


@torch.inference_mode()
def teacher_forced(model: LstmInterpreter, corpus: Corpus, labels: NDArray[np.int64], recordings: Sequence[int],
                   words_of: Sequence[int] | None = None, temperature: float = 1.0) -> Scores:
    """Accuracy and drawn (percent) and surprise (nats a block) on each recording; block 0 is given.

    words_of: for each recording, the one whose words are read instead of its own, block by block. temperature: at
    which lexemes are drawn.
    """
    accuracy, drawn, surprise = [], [], []
    for place, recording in enumerate(recordings):
        own = corpus.blocks_of(recording)
        wanted = torch.as_tensor(labels[own])[None]
        text = None
        if model.config.reads:
            source = own if words_of is None else corpus.blocks_of(words_of[place])
            text = corpus.text(np.resize(source, len(own))[1:])[None]
        speaker = torch.nn.functional.one_hot(torch.tensor([int(corpus.speaker_of[recording])]), model.speakers)
        logits, _ = model.scores(wanted[:, :-1], corpus.high[torch.as_tensor(own[1:])].float()[None], speaker.float(),
                                 None, text)
        right = wanted[:, 1:]
        accuracy.append(100 * float((logits.argmax(-1) == right).float().mean()))
        chances = torch.softmax(logits / temperature, -1).gather(-1, right[..., None])
        drawn.append(100 * float(chances.mean()))
        surprise.append(float(torch.nn.functional.cross_entropy(logits[0], right[0])))
    return {"accuracy": np.array(accuracy), "drawn": np.array(drawn), "surprise": np.array(surprise)}


def another(recordings: Sequence[int], on: int = 1) -> list[int]:
    """For each recording the one that is `on` places further, so that nobody reads their own; ValueError for one alone
    or for a whole turn."""
    if on % max(len(recordings), 1) == 0:
        raise ValueError("a wrong text takes two recordings with words")
    return [recordings[(place + on) % len(recordings)] for place in range(len(recordings))]


def wrongly_read(model: LstmInterpreter, corpus: Corpus, labels: NDArray[np.int64], recordings: Sequence[int],
                 temperature: float = 1.0, most: int = 5) -> Scores:
    """As `teacher_forced`, the mean over up to `most` wrong texts."""
    turns = range(1, max(2, min(most + 1, len(recordings))))
    every = [teacher_forced(model, corpus, labels, recordings, another(recordings, on), temperature) for on in turns]
    return {key: np.mean([scores[key] for scores in every], axis=0) for key in every[0]}


def table(rows: dict[str, Scores], pairs: Sequence[tuple[str, str]], sizes: Sequence[int]) -> dict[str, Any]:
    """Intervals of each row and of the paired differences (first minus second)."""
    out: dict[str, Any] = {"rows": {}, "differences": {}}
    for name, scores in rows.items():
        out["rows"][name] = {key: interval(values, sizes).to_dict() for key, values in scores.items()}
    for first, second in pairs:
        out["differences"][f"{first} - {second}"] = {
            key: interval(rows[first][key] - rows[second][key], sizes).to_dict() for key in rows[first]}
    return out


def parts(store: Store, bundle: bundles.Bundle, work: Path, *, progress: bool = True) -> dict[str, Any]:
    """The table, as plain values: "text" on the test recordings that have words, "speech levels" on all."""
    workers = os.cpu_count() or 1
    corpus = prepare(store, bundle.config, work, bundle.encoder, workers=workers, progress=progress)
    labels = hinted_labels(bundle, corpus)
    out: dict[str, Any] = {}
    drawn_at = bundle.config.selection.temperature or 1.0
    if bundle.interpreter_text is not None:
        spoken = corpus.recordings("test", with_text=True)
        sizes = [len(corpus.blocks_of(r)) - 1 for r in spoken]
        out["text"] = table({
            "text": teacher_forced(bundle.interpreter_text, corpus, labels, spoken, temperature=drawn_at),
            "wrong text": wrongly_read(bundle.interpreter_text, corpus, labels, spoken, drawn_at),
            "audio only": teacher_forced(bundle.block_models.interpreter, corpus, labels, spoken,
                                         temperature=drawn_at)},
            (("text", "wrong text"), ("text", "audio only")), sizes)
    if bundle.encoder is not None:
        every = corpus.recordings("test")
        mel, mel_corpus = _on_mel(store, bundle, work, workers, progress)
        out["speech levels"] = table({
            "vqwav2vec": teacher_forced(bundle.block_models.interpreter, corpus, labels, every, temperature=drawn_at),
            "mel": teacher_forced(mel, mel_corpus, labels, every, temperature=drawn_at)},
            (("vqwav2vec", "mel"),), [len(corpus.blocks_of(r)) - 1 for r in every])
    return out


def _on_mel(store: Store, bundle: bundles.Bundle, work: Path, workers: int, progress: bool
            ) -> tuple[LstmInterpreter, Corpus]:
    # The same silent lexemes as the bundle's, by hand or found, so that both rows are taught the same labels.
    config = configs.with_settings(bundle.config, [*_MEL, f"silence.lexemes={bundle.silent.tolist()}"])
    run = Run(config, store, work, progress=progress, workers=workers)
    lexicon = bundle.block_models.lexicon
    for node in (LEXICON, TOKENS):
        run.provide(node, lexicon, weights_hash(lexicon))
    return run.get(INTERPRETER), run.get(CORPUS)


def markdown(result: dict[str, Any]) -> str:
    """The tables for a reader."""
    lines: list[str] = []
    for title, part in result.items():
        lines += [f"| {title} | accuracy, % | drawn, % | surprise, nats |", "|---|---|---|---|"]
        lines += [f"| {name} | " + " | ".join(
            f"{row[key]['mean']:.{digits}f} [{row[key]['low']:.{digits}f}, {row[key]['high']:.{digits}f}]"
            for key, digits in (("accuracy", 1), ("drawn", 1), ("surprise", 3))) + " |"
            for name, row in (*part["rows"].items(), *part["differences"].items())]
        lines.append("")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser("eval.parts", description="What text and the learned speech levels bought.")
    p.add_argument("--data", required=True, metavar="STORE")
    p.add_argument("--bundle", metavar="DIR", help="default: the shipped one")
    p.add_argument("--work", required=True, metavar="DIR", help="where blocks and the mel interpreter are kept")
    p.add_argument("--out", metavar="FILE.json", help="a .md is written beside it")
    arguments = p.parse_args(argv)
    with one_line_errors("eval.parts"):
        torch.set_num_threads(1)
        work = Path(arguments.work)
        work.mkdir(parents=True, exist_ok=True)
        result = parts(Store.open(arguments.data), bundles.load(arguments.bundle or bundles.SHIPPED), work)
        publish(result, markdown(result), arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())

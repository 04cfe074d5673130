"""What a part of the lexeme interpreter bought: text, the right text, the learned speech levels. With and without.

    python -m eval.parts --data STORE --work DIR [--bundle DIR] [--out docs/results/parts.json]

Every row reads the same test recordings over the same lexicon, with the true lexeme before each block (teacher
forcing), so that two rows differ by the part alone; differences are paired over recordings with bootstrap 95 %
intervals. Accuracy is the share of blocks whose best score is the performer's lexeme; surprise is the mean negative
log-probability of that lexeme in nats (less is better) and tells more, since lexemes are drawn and not only maximised.

Rows: `text` reads the right words; `wrong text` is the same interpreter on the words of another recording, which is
what a transcript without meaning would give; `audio only` is the interpreter that never reads. `mel` is the audio-only
interpreter on mel bands instead of the learned levels: it is trained here (in DIR, kept) with the same settings.
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
from eval.results import keep
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator.prepare import Corpus, prepare
from gesticulator.train import Run, label, train_interpreter
from interpreters.lstm import LstmInterpreter
from lexicon.inventory import nearest_silent

Scores = dict[str, NDArray[np.float64]]
_MEL = ("front_end.name=mel", "front_end.bands=32")


def hinted_labels(bundle: bundles.Bundle, corpus: Corpus) -> NDArray[np.int64]:
    """[N] lexemes of all blocks, silent blocks with the silent lexeme nearest to their own (RG 6.4.1)."""
    labels = bundle.lexicon.label(corpus.motion).numpy()
    nearest = nearest_silent(bundle.lexicon.vectors.double().numpy(), bundle.silent)
    return np.where(corpus.silent, nearest[labels], labels) if bundle.config.silence.hint else labels


@torch.inference_mode()
def teacher_forced(model: LstmInterpreter, corpus: Corpus, labels: NDArray[np.int64], recordings: Sequence[int],
                   words_of: Sequence[int] | None = None) -> Scores:
    """Accuracy (percent) and surprise (nats a block) on each recording; block 0 is given.

    words_of: for each recording, the one whose words are read instead of its own, block by block.
    """
    accuracy, surprise = [], []
    for place, recording in enumerate(recordings):
        own = corpus.blocks_of(recording)
        wanted = torch.as_tensor(labels[own])[None]
        text = None
        if model.encode_text is not None:
            source = own if words_of is None else corpus.blocks_of(words_of[place])
            text = corpus.text(np.resize(source, len(own))[1:])[None]
        speaker = torch.nn.functional.one_hot(torch.tensor([int(corpus.speaker_of[recording])]), model.speakers)
        logits, _ = model.scores(wanted[:, :-1], corpus.high[torch.as_tensor(own[1:])].float()[None], speaker.float(),
                                 None, text)
        right = wanted[:, 1:]
        accuracy.append(100 * float((logits.argmax(-1) == right).float().mean()))
        surprise.append(float(torch.nn.functional.cross_entropy(logits[0], right[0])))
    return {"accuracy": np.array(accuracy), "surprise": np.array(surprise)}


def another(corpus: Corpus, recordings: Sequence[int]) -> list[int]:
    """For each recording the next one with words, so that nobody reads their own; ValueError for one alone."""
    if len(recordings) < 2:
        raise ValueError("a wrong text takes two recordings with words")
    return [recordings[(place + 1) % len(recordings)] for place in range(len(recordings))]


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
    if bundle.interpreter_text is not None:
        spoken = corpus.recordings("test", with_text=True)
        sizes = [len(corpus.blocks_of(r)) - 1 for r in spoken]
        out["text"] = table({
            "text": teacher_forced(bundle.interpreter_text, corpus, labels, spoken),
            "wrong text": teacher_forced(bundle.interpreter_text, corpus, labels, spoken, another(corpus, spoken)),
            "audio only": teacher_forced(bundle.interpreter, corpus, labels, spoken)},
            (("text", "wrong text"), ("text", "audio only")), sizes)
    if bundle.encoder is not None:
        every = corpus.recordings("test")
        mel, mel_corpus = _on_mel(store, bundle, work, workers, progress)
        out["speech levels"] = table({
            "vqwav2vec": teacher_forced(bundle.interpreter, corpus, labels, every),
            "mel": teacher_forced(mel, mel_corpus, labels, every)},
            (("vqwav2vec", "mel"),), [len(corpus.blocks_of(r)) - 1 for r in every])
    return out


def _on_mel(store: Store, bundle: bundles.Bundle, work: Path, workers: int, progress: bool
            ) -> tuple[LstmInterpreter, Corpus]:
    run = Run(configs.with_settings(bundle.config, _MEL), store, work, progress=progress)
    run.corpus = prepare(store, run.config, work, workers=workers, progress=progress)
    # The same silent lexemes as the bundle's, by hand or found, so that both rows are taught the same labels.
    run.config = configs.with_settings(run.config, [f"silence.lexemes={bundle.silent.tolist()}"])
    model, _ = train_interpreter(run, bundle.lexicon, label(run, bundle.lexicon))
    return model, run.corpus


def markdown(result: dict[str, Any]) -> str:
    """The tables for a reader."""
    lines: list[str] = []
    for title, part in result.items():
        lines += [f"| {title} | accuracy, % | surprise, nats |", "|---|---|---|"]
        lines += [f"| {name} | " + " | ".join(
            f"{row[key]['mean']:.{digits}f} [{row[key]['low']:.{digits}f}, {row[key]['high']:.{digits}f}]"
            for key, digits in (("accuracy", 1), ("surprise", 3))) + " |"
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
        if arguments.out:
            keep(result, markdown(result), arguments.out)
        print(markdown(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Does the lexeme interpreter hear, read and see? `gesticulator probe evidence --data STORE --work DIR`

Theory: an input matters as far as nothing else tells the same. So the interpreter is trained again with that input
spoiled, everything else being as it was, and the two are set side by side on the test recordings, with the true
lexemes and the true motion before each block. What the spoiled one lacks, in nats a block, is what the input is worth:
the gain. An interpreter that is not trained again would be surprised by the spoiled input, and seem to lean on it more
than it can. Seeds differ in the training of the interpreter alone (corpus, lexicon and speech levels are shared);
intervals are over seeds and recordings, drawn anew together.

Rows of "Sound and body": `as it is`; `sound rolled`, where each spoken block hears another spoken block of its own
recording, half a recording away (so voice, level, pauses and the length of blocks are told as before, and the moment is
not); `another's sound`, the same from another recording, of the same performer where there is one; `no sound`, which
hears nothing, not even how long a block is; `no pose`, which does not see the body. Rows of "Words": the interpreter
that reads, and the one that was taught on the words of other recordings, both on top of the same one that hears. Spoken
blocks alone count but for `NLL, all`: what is done in a silence is mostly rest, which the sound tells at once.

"Loops", with a bundle: its free-running performances of the test recordings beside the performer's lexemes. An
interpreter that hears its own past may fall into saying one thing again and again. Silent lexemes do not count: a rest
may last. The longest run should be at most 1.5 times the performer's.

What fools it: early stopping is what keeps a spoiled input from being learned by heart; without patience in the
schedule the spoiled rows are worse than they need be, and the gain too large. Recordings that share their speech with
training ones are known from it. `no sound` differs from the others in what it cannot know, such as pauses.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from data_module.errors import InputError
from data_module.store import Recording, Store
from eval import stats
from eval.context import EvalContext
from eval.metrics.diversity import distinct_2, longest_run, repetition
from eval.table import Cell, Column, Table
from gesticulator import config as configs
from gesticulator import presets
from gesticulator.config import Config, digest
from gesticulator.performance import InferenceOptions
from gesticulator.pipeline import Gesticulator
from gesticulator.stages import (
    BLOCKS,
    CORPUS,
    INTERPRETER,
    INTERPRETER_TEXT,
    LABELS,
    LEXICON,
    TOKENS,
    Corpus,
    Node,
    Run,
    Stage,
)
from gesticulator.stages.interpreter import teacher_logits
from interpreters.lstm import LstmInterpreter

AS_IT_IS, NO_POSE = "as it is", "no pose"
ROLLED, ANOTHERS, NO_SOUND = "sound rolled", "another's sound", "no sound"
WORDS, WRONG_WORDS = "words", "another's words"
MOST_RUN = 1.5
"""Times the performer's longest run that a performance's may be."""
COLUMNS = {"nll": Column("NLL", "nats", 3, "low"), "accuracy": Column("accuracy", "%", 1, "high"),
           "nll_all": Column("NLL, all", "nats", 3, "low"), "gain": Column("gain over it", "nats", 3, "high"),
           "gain_all": Column("gain over it, all", "nats", 3, "high")}
LOOPS = {"longest": Column("longest run", "blocks, mean", 1, "low"),
         "most": Column("longest of all", "blocks", 0, "low"),
         "repeated": Column("repeated", "%", 1, "near"), "distinct": Column("distinct-2", "", 3, "near")}
Numbers = NDArray[np.int64]
Array = NDArray[np.float64]


# ------------------------------------------------------------------------------------------------- what is spoiled

def rolled(corpus: Corpus) -> Numbers:
    """[N] for each block the one whose sound it hears: of each recording the spoken blocks half of them further, so
    that none hears itself where there are two; silent blocks their own."""
    order = np.arange(len(corpus.silent))
    for recording in range(len(corpus.names)):
        spoken = _spoken(corpus, recording)
        order[spoken] = np.roll(spoken, len(spoken) // 2)
    return order


def of_another(corpus: Corpus, with_text: bool = False) -> Numbers:
    """[N] as `rolled`, from the spoken blocks of another recording, block by block (again from its start where it is
    shorter): the next one of the split and of the same performer; where there is none, the next of the split, of the
    performer, or of all. with_text: among recordings with words.

    InputError for a store with one recording.
    """
    order = np.arange(len(corpus.silent))
    count = len(corpus.names)
    there = [len(_spoken(corpus, r)) > 0 and (bool(corpus.has_text[r]) or not with_text) for r in range(count)]
    for recording in np.flatnonzero(there):
        others = [other % count for other in range(recording + 1, recording + count) if there[other % count]]
        if not others:
            raise InputError("the store", "has one recording, and another's is to be heard", "add recordings")
        split, who = corpus.splits[recording], corpus.speaker_of[recording]
        chosen = min(others, key=lambda r, split=split, who=who: (  # type: ignore[misc]
            corpus.splits[r] != split, corpus.speaker_of[r] != who))
        own = _spoken(corpus, int(recording))
        order[own] = np.resize(_spoken(corpus, chosen), len(own))
    return order


def _spoken(corpus: Corpus, recording: int) -> Numbers:
    own = corpus.blocks_of(recording)
    return own[~corpus.silent[own]]


def sounding(corpus: Corpus, order: Numbers) -> Corpus:
    """The corpus with the high-level sound of other blocks; the last column, the length of the blocks, is their own."""
    high = corpus.high[torch.as_tensor(order)].clone()
    high[..., -1] = corpus.high[..., -1]
    return replace(corpus, high=high)


def deaf(corpus: Corpus) -> Corpus:
    """The corpus without sound."""
    return replace(corpus, high=torch.zeros_like(corpus.high))


def reading(corpus: Corpus, order: Numbers) -> Corpus:
    """The corpus with the words of other blocks."""
    if corpus.word_at is None:
        raise InputError("the store", "has no words", "leave the words out")
    return replace(corpus, word_at=corpus.word_at[torch.as_tensor(order)])


# ------------------------------------------------------------------------------------------------- training and figures

@dataclass
class EvidenceRun:
    """What the rows share, and the interpreters that are trained for them. first: the run of the settings as they are;
    seeds: how many."""

    first: Run
    seeds: int
    _runs: dict[tuple[str, int], Run] = field(default_factory=dict)

    @property
    def corpus(self) -> Corpus:
        """As it is."""
        return self.first.get(CORPUS)

    def run(self, name: str, seed: int, corpus: Corpus | None = None, config: Config | None = None) -> Run:
        """The run of a row at a seed: over `corpus` where it is given, which goes by the row's name."""
        key = (name, seed)
        if key not in self._runs:
            config = replace(config or self.first.config, seed=seed)
            own = Run(config, self.first.store, self.first.work, self.first.device, self.first.progress)
            nodes: tuple[Node[Any], ...] = (BLOCKS, LEXICON, TOKENS, LABELS, CORPUS)
            for node in nodes:
                value: Any = self.first.get(node)
                own.provide(node, value, self.first.key(node))
            if corpus is not None:
                own.provide(CORPUS, corpus, digest(self.first.key(CORPUS), "evidence", name))
            self._runs[key] = own
        return self._runs[key]


@dataclass(frozen=True)
class RowFigures:
    """A row: [seeds, recordings] each, means over the spoken blocks but `nll_all`; NaN where there is none."""

    nll: Array
    accuracy: Array
    nll_all: Array


def figures(models: Sequence[LstmInterpreter], corpus: Corpus, labels: Numbers, recordings: Sequence[int]
            ) -> RowFigures:
    """Of interpreters of several seeds on recordings of a corpus; block 0 is given."""
    rows = [[_of_recording(model, corpus, labels, recording) for recording in recordings] for model in models]
    nll, accuracy, everything = np.array(rows, dtype=np.float64).transpose(2, 0, 1)
    return RowFigures(nll, accuracy, everything)


def _of_recording(model: LstmInterpreter, corpus: Corpus, labels: Numbers, recording: int) -> tuple[float, ...]:
    blocks = corpus.blocks_of(recording)
    logits, right = teacher_logits(model, corpus, blocks, labels[blocks]), torch.as_tensor(labels[blocks[1:]])
    nll = functional.cross_entropy(logits, right, reduction="none").double().numpy()
    hit, spoken = (logits.argmax(-1) == right).numpy(), ~corpus.silent[blocks[1:]]
    if not spoken.any():
        return float("nan"), float("nan"), float(nll.mean())
    return float(nll[spoken].mean()), 100 * float(hit[spoken].mean()), float(nll.mean())


def table(title: str, rows: Mapping[str, RowFigures], base: str, sizes: tuple[Numbers, Numbers],
          facts: Mapping[str, Any] | None = None) -> Table:
    """Each row with its intervals, and what `base` gains over it, paired over seeds and recordings.

    sizes: spoken blocks and all blocks of each recording.
    """
    body: dict[str, dict[str, Cell]] = {}
    for name, row in rows.items():
        body[name] = {"nll": stats.crossed(row.nll, sizes[0]), "accuracy": stats.crossed(row.accuracy, sizes[0]),
                      "nll_all": stats.crossed(row.nll_all, sizes[1])}
        if name != base:
            body[name] |= {"gain": stats.crossed(row.nll - rows[base].nll, sizes[0]),
                           "gain_all": stats.crossed(row.nll_all - rows[base].nll_all, sizes[1])}
    return Table(title, COLUMNS, body, "interpreter", facts=facts or {})


def loops(performed: Sequence[Numbers], played: Mapping[str, Sequence[Numbers]], silent: Numbers) -> Table:
    """Runs and repetition of lexemes: the performer's row and those of performances of the same recordings."""
    rows: dict[str, dict[str, Cell]] = {}
    longest = {name: np.array([longest_run([one], silent) for one in own])
               for name, own in {"performer": performed, **played}.items()}
    for name, own in {"performer": performed, **played}.items():
        rows[name] = {"longest": stats.mean_interval(longest[name]), "most": float(np.nanmax(longest[name])),
                      "repeated": 100 * repetition(own, silent), "distinct": distinct_2(own)}
    times = {name: float(np.nanmean(longest[name]) / np.nanmean(longest["performer"])) for name in played}
    notes = [f"{name}: the longest run is {ratio:.2f} times the performer's, "
             f"{'within' if ratio <= MOST_RUN else 'over'} the bound of {MOST_RUN}." for name, ratio in times.items()]
    return Table("Loops", LOOPS, rows, "lexemes", notes)


# ---------------------------------------------------------------------------------------------------------- the probe

def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, a work folder, settings, seeds, and a bundle where its loops are asked for."""
    parser.add_argument("--data", required=True, metavar="STORE", help="a store built by `gesticulator build`")
    parser.add_argument("--work", metavar="DIR", help="a work folder of `gesticulator train` (default: STORE.work)")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--set", nargs="+", action="extend", default=[], metavar="PATH=VALUE", help="settings")
    parser.add_argument("--split", default="test", choices=("val", "test"), help="choices are made on val")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="trainings of each interpreter (default: 3)")
    parser.add_argument("--limit", type=int, metavar="N", help="the first N recordings of the split only")
    parser.add_argument("--bundle", metavar="DIR", help="measure the loops of this bundle too")
    parser.add_argument("--no-words", action="store_true", help="leave the interpreters that read out")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """"Sound and body", "Words" where they are read, "Loops" where a bundle is given."""
    if arguments.seeds < 1:
        raise InputError(f"--seeds {arguments.seeds}", "trains nothing", "choose 1 or more")
    torch.set_num_threads(1)
    config = configs.with_settings(presets.preset(arguments.preset), arguments.set)
    if config.tokens != "lexicon":
        raise InputError(arguments.preset, "has no lexeme interpreter", "choose a preset with a lexicon")
    store = Store.open(arguments.data)
    work = Path(arguments.work) if arguments.work else Path(f"{store.path}.work")
    work.mkdir(parents=True, exist_ok=True)
    shared = EvidenceRun(Run(config, store, work, progress=not arguments.quiet), arguments.seeds)
    found = [sound(shared, arguments.split, arguments.limit)]
    if INTERPRETER_TEXT.wanted(config) and not arguments.no_words:
        found.append(words(shared, arguments.split, arguments.limit))
    if arguments.bundle:
        found.append(bundle_loops(EvalContext.of(arguments), arguments.split))
    return found


def sound(shared: EvidenceRun, split: str, limit: int | None = None) -> Table:
    """What sound and body are worth."""
    corpus, config = shared.corpus, shared.first.config
    spoiled: dict[str, tuple[Callable[[], Corpus] | None, Config]] = {
        AS_IT_IS: (None, config), ROLLED: (lambda: sounding(corpus, rolled(corpus)), config),
        ANOTHERS: (lambda: sounding(corpus, of_another(corpus)), config), NO_SOUND: (lambda: deaf(corpus), config)}
    if config.interpreter.pose_features:
        blind = replace(config.interpreter, pose_features=0)
        spoiled[NO_POSE] = (None, replace(config, interpreter=blind))
    recordings = corpus.recordings(split)[:limit]
    rows = {}
    for name, (make, own) in spoiled.items():
        heard = make() if make else None
        runs = [shared.run(name, seed, heard, own) for seed in _seeds(shared)]
        rows[name] = figures(_trained(runs, INTERPRETER), heard or corpus, _labels(shared), recordings)
    return table("Sound and body", rows, AS_IT_IS, _sizes(corpus, recordings), _facts(shared, split, recordings))


def words(shared: EvidenceRun, split: str, limit: int | None = None) -> Table:
    """What the words are worth, on the recordings that have any."""
    corpus = shared.corpus
    recordings = corpus.recordings(split, with_text=True)[:limit]
    wrong = reading(corpus, of_another(corpus, with_text=True))
    rows = {}
    for name, read in ((WORDS, None), (WRONG_WORDS, wrong)):
        runs = []
        for seed in _seeds(shared):
            hears, own = shared.run(AS_IT_IS, seed), shared.run(name, seed, read)
            own.provide(INTERPRETER, hears.get(INTERPRETER), hears.key(INTERPRETER))
            runs.append(own)
        rows[name] = figures(_trained(runs, INTERPRETER_TEXT), read or corpus, _labels(shared), recordings)
    alone = [shared.run(AS_IT_IS, seed) for seed in _seeds(shared)]
    rows["no words"] = figures(_trained(alone, INTERPRETER), corpus, _labels(shared), recordings)
    return table("Words", rows, WORDS, _sizes(corpus, recordings), _facts(shared, split, recordings))


def bundle_loops(context: EvalContext, split: str) -> Table:
    """Free-running performances of a bundle beside the performer, as each speaks, at the bundle's own settings."""
    recordings, numbers = context.recordings(split), context.numbers(split)
    performed = [context.labels[context.corpus.blocks_of(number)] for number in numbers]
    played = {"bundle": list(_played(context.system, recordings))}
    return loops(performed, played, context.bundle.silent)


def _played(system: Gesticulator, recordings: Sequence[Recording]) -> Iterator[Numbers]:
    for recording in recordings:
        own = recording.info.speaker if recording.info.speaker in system.speakers else None
        yield system.perform(recording.speech, InferenceOptions(speaker=own)).lexemes


def _seeds(shared: EvidenceRun) -> range:
    return range(1, shared.seeds + 1)


def _trained(runs: Sequence[Run], stage: Stage[LstmInterpreter]) -> list[LstmInterpreter]:
    return [own.get(stage) for own in runs]


def _labels(shared: EvidenceRun) -> Numbers:
    return shared.first.get(LABELS).hinted


def _sizes(corpus: Corpus, recordings: Sequence[int]) -> tuple[Numbers, Numbers]:
    """Spoken blocks and all blocks of each recording, without the first."""
    rows = [corpus.silent[corpus.blocks_of(recording)][1:] for recording in recordings]
    return np.array([int((~own).sum()) for own in rows]), np.array([len(own) for own in rows])


def _facts(shared: EvidenceRun, split: str, recordings: Sequence[int]) -> dict[str, Any]:
    first = shared.first
    return {"store": {"name": first.store.corpus, "fingerprint": first.store.fingerprint,
                      f"{split}_recordings": len(recordings)},
            "seeds": shared.seeds, "settings": {"preset": first.config.name,
                                                "interpreter": configs.to_dict(first.config.interpreter)}}

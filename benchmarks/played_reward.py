"""Does a reward know a person from a shuffle? `python benchmarks/played_reward.py STORE [--bundle DIR] [--steps 300]`.

Recordings of the training split are played with the performer's lexemes and with others (`eval.runner.played`). Two
ensembles that share neither recordings, seeds nor sizes are trained in each of the forms

- published: the contrast of windows (RACER Eq. 6 and 7), poses read linearly, captured and played motion;
- speeds: the same, and the motion encoder also reads speeds;
- played: the same, and what other policies play to the same sound are negatives of the performer's lexemes;
- both: the same, and half of the windows are of lexemes that the lexicon decodes, as policies are taught on them.

Then the test split: the reward of the performer's lexemes as played, less that of each policy, paired over recordings
(unit selection splices captured motion, so it is also held against the captured motion of the recording itself); what
of it is common to any sound; how often the window of a sound is found among those of its recording; and what
`gesticulator probe rewards` asks of a reward (`eval.probes.rewards`), of lexemes as they are decoded.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from eval import stats
from eval.context import EvalContext, opened
from eval.metrics.reward_model import RewardProbe
from eval.probes.rewards import figures, spoken
from eval.renderings import BundleSystem, KeptRenderings, UnitSystem
from eval.runner.decoded_windows import Decoder
from eval.runner.played import PERFORMER, REPLAYED, UNITS, PlayedVoice, VoicePlayer
from eval.runner.played_reward import (
    BOTH,
    ENSEMBLES,
    FORMS,
    Amounts,
    PlayedScores,
    arguments,
    found,
    judged,
    kept,
    learned,
    margins,
    scored,
)
from eval.stats import Interval
from eval.table import Cell, Column, Provenance, Table, publish
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.training.stages.q_network import takes_of
from interpreters.reward import RewardEnsemble

OTHERS = ("cql", "advantage")
"""Played on the test split alone: no reward was trained against them."""


@dataclass(frozen=True)
class Judged:
    """What one ensemble of one form says of the test split."""

    scores: PlayedScores
    retrieval: Mapping[str, Interval]
    captured: Mapping[str, Interval]
    asked: Mapping[str, bool]


def kinds_of(test: Sequence[PlayedVoice]) -> list[str]:
    """The kinds of motion that all voices have."""
    return [kind for kind in test[0].motions if all(kind in voice.motions for voice in test)]


def asked(model: RewardEnsemble, context: EvalContext, split: str, decoder: Decoder | None) -> dict[str, bool]:
    """What `gesticulator probe rewards` asks of a reward, of the recordings of a split. decoder: of a reward that was
    trained on what it decodes."""
    takes = [take for take in takes_of(context.corpus, context.labels, split)
             if len(take.blocks) >= model.config.window][:context.limit]
    probe = RewardProbe.of(model, context.bundle, context.corpus, context.labels,
                           None if decoder is None else decoder.context)
    every = spoken([probe.every(take) for take in takes], takes)
    return figures(probe, takes, context.corpus.silent, every)[3]


def judge(model: RewardEnsemble, test: Sequence[PlayedVoice], said: Mapping[str, bool]) -> Judged:
    """Everything that an ensemble says of the test voices; said: see `asked`."""
    return Judged(scored(model, test, kinds_of(test)), found(model, test, REPLAYED), found(model, test, PERFORMER),
                  said)


# ------------------------------------------------------------------------------------------------------------- tables

_FOUND = {"motion_r1": "sound found for a motion, %", "audio_r1": "motion found for a sound, %",
          "chance_r1": "chance, %", "times": "times chance"}


def tables(said: Mapping[tuple[str, str], Judged], test: Sequence[PlayedVoice], notes: Sequence[str]) -> list[Table]:
    """Rewards, margins and retrieval of all ensembles."""
    kinds, group = kinds_of(test), [voice.group for voice in test]
    columns = {f"{form}, {name}": Column(f"{form}, {name}", digits=3) for form, name in said}
    named = {f"{form}, {name}": own for (form, name), own in said.items()}

    def rows(cell: Mapping[str, Mapping[str, Cell]]) -> dict[str, dict[str, Cell]]:
        return {row: {name: own[row] for name, own in cell.items()} for row in next(iter(cell.values()))}

    apart = [kind for kind in kinds if kind not in (REPLAYED, PERFORMER)]
    less = {name: {**margins(own.scores, apart, group),
                   f"{PERFORMER} less {UNITS}": margins(own.scores, (UNITS,), group, PERFORMER)[UNITS]}
            for name, own in named.items()}
    sound = {name: {kind: stats.paired(own.scores.own(REPLAYED), own.scores.own(kind), groups=group)
                    for kind in apart} for name, own in named.items()}
    means = {name: {kind: stats.mean_interval(own.scores.whole[kind], groups=group) for kind in kinds}
             for name, own in named.items()}
    hits = {name: {f"{label}{title}": (own.captured if label else own.retrieval)[key]
                   for label in ("", "captured: ") for key, title in _FOUND.items()} for name, own in named.items()}
    return [Table("Mean reward of motion as played", columns, rows(means), "motion", list(notes)),
            Table("The performer's lexemes less others, paired over recordings", columns, rows(less), "less",
                  ["An interval above 0: the ensemble prefers what the performer's lexemes give."]),
            Table("The same, of what only the sound of the moment gives", columns, rows(sound), "less",
                  ["m . (u - mean u): what any sound would give is left out."]),
            Table("Retrieval within a recording, windows one window apart", columns, rows(hits), "figure"),
            Table("Asked of a reward", columns, rows({
                name: {claim: "yes" if holds else "no" for claim, holds in own.asked.items()}
                for name, own in named.items()}), "claim",
                ["As by `gesticulator probe rewards`: captured motion, and lexemes as the lexicon decodes them."])]


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments(p, Amounts(60, 25.0, 2, 300))
    p.add_argument("--forms", nargs="+", default=list(FORMS), choices=FORMS)
    p.add_argument("--others", nargs="*", default=list(OTHERS), help="more interpreters on the test split")
    a = p.parse_args()
    store, work = opened(a.store, a.work)
    folder = bundle_folder(a.bundle)
    ours = BundleSystem("ours", folder, KeptRenderings(None))
    player = VoicePlayer(ours, work / "played")
    spliced = {UNITS: UnitSystem(UNITS, store, work, KeptRenderings(work / "units"), ours.bundle.config.rhythm)}
    learn = learned(player, store, a)
    test = judged(player, store, a, a.others, spliced)
    context = EvalContext.over(store, ours.bundle, work, a.limit, not a.quiet)
    said = {}
    for form in a.forms:
        decoder = Decoder.of(ours.bundle, context.corpus, context.labels) if form == BOTH else None
        for number, name in enumerate(ENSEMBLES):
            model = kept(form, number, learn, work, a, decoder)
            said[form, name] = judge(model, test, asked(model, context, a.split, decoder))
    note = (f"{len(learn)} training recordings ({a.learn_seconds:g} s of each) and {len(test)} {a.split} recordings "
            f"({a.seconds:g} s), evenly spread, one seed; {a.steps} steps of each of {a.members} models an ensemble. "
            f"Cosines, -1 to 1. {PERFORMER}: the captured motion; {REPLAYED}: what the generator makes of the lexemes "
            "that the motion is read as.")
    publish(tables(said, test, [note]), a.out, Provenance.now(
        shlex.join(["python", "benchmarks/played_reward.py", *sys.argv[1:]]), folder / INDEX))


if __name__ == "__main__":
    main()

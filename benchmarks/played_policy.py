"""What does a policy learn from a reward that knows a person from a shuffle?

`python benchmarks/played_policy.py STORE [--policies NAME ...]`

Two ensembles are trained on motion as it is played and as it is decoded (`benchmarks/played_reward.py`, the form
"both"): the first teaches policies, the second judges and shares neither recordings, seeds nor sizes with it. On the
first, by the stages of training themselves and over the lexicon and the LSTM of a bundle, are trained

- supervised: the Q-network by its conservative term alone, which is a classifier of the performers' lexemes;
- cql A: conservative Q-learning with an alpha of A (RACER Eq. 11);
- advantage B: the LSTM reweighted by exp(B A), with the critics of `interpreters.advantage`.

Q-networks are drawn from at the temperature at which they are as undecided as the LSTM is, and `advantage` at its own.
Every policy plays the judged split; rewards are paired over recordings.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch

from eval import stats
from eval.ablate.policy import entropy_of, matched_temperature
from eval.ablate.racer import forced_values
from eval.context import EvalContext, opened
from eval.renderings import BundleSystem, KeptRenderings
from eval.runner.decoded_windows import Decoder
from eval.runner.played import PERFORMER, REPLAYED, FurtherPolicy, PlayedVoice, VoicePlayer
from eval.runner.played_reward import (
    BOTH,
    ENSEMBLES,
    Amounts,
    PlayedScores,
    arguments,
    found,
    judged,
    kept,
    learned,
    scored,
)
from eval.runner.played_seen import SEEN, agreement
from eval.table import Column, Provenance, Table, publish
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import digest, with_settings
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.training.stages import CORPUS, ENCODER, Run
from gesticulator.training.stages.advantage import ADVANTAGE
from gesticulator.training.stages.caches import weights_hash
from gesticulator.training.stages.corpus import BLOCKS
from gesticulator.training.stages.interpreter import INTERPRETER, teacher_logits
from gesticulator.training.stages.labels import LABELS
from gesticulator.training.stages.lexicon import LEXICON, TOKENS
from gesticulator.training.stages.q_network import Q_NETWORK, takes_of
from gesticulator.training.stages.reward import REWARD, TAUGHT_REWARD, reward_table, taught_reward
from interpreters.advantage import AdvantageInterpreter
from interpreters.cql import QNetwork
from interpreters.reward import RewardEnsemble
from interpreters.reward_table import Centred, EnsembleReward

OTHERS = ("cql", "advantage")
"""Of the bundle, which learned from the published form of the reward."""


@dataclass(frozen=True)
class Pupil:
    """A policy to train. settings: changes of the bundle's; beta: of `advantage`, None for a Q-network."""

    settings: tuple[str, ...] = ()
    beta: float | None = None

    @classmethod
    def named(cls, name: str) -> Pupil:
        """supervised, "cql A" or "advantage B"; ValueError for others."""
        kind, _, value = name.partition(" ")
        if name == "supervised":
            return cls(("cql.temporal=0",))
        if kind == "cql":
            return cls((f"cql.conservative={float(value)}", "cql.warm_up=0"))
        if kind == "advantage":
            return cls(beta=float(value))
        raise ValueError(f"{name} is none of: supervised, cql A, advantage B")


@dataclass(frozen=True)
class School:
    """What policies are trained on: a bundle's parts, a reward, and a corpus with what decodes lexemes on it."""

    context: EvalContext
    reward: RewardEnsemble
    decoder: Decoder

    @property
    def bundle(self) -> Bundle:
        """The bundle."""
        return self.context.bundle

    @cached_property
    def taught_reward(self) -> EnsembleReward | Centred:
        """The reward as policies are taught it, which takes minutes and is the same for all. Lexemes are decoded as the
        reward has learned to read them."""
        corpus = self.context.corpus
        table = reward_table(self.reward, self.bundle.block_models.lexicon, corpus, context=self.decoder.context)
        return taught_reward(table, corpus, self.bundle.config.episodes.baseline)

    def run(self, settings: Sequence[str]) -> Run:
        """A training run in which everything but the policies is there."""
        run = self._begun(settings)
        run.provide(TAUGHT_REWARD, self.taught_reward, digest(weights_hash(self.reward), "decoded without residuals"))
        return run

    def _begun(self, settings: Sequence[str]) -> Run:
        context, parts = self.context, self.bundle.block_models
        run = Run(with_settings(self.bundle.config, settings), context.store, context.work, progress=context.progress)
        for node, model in ((LEXICON, parts.lexicon), (TOKENS, parts.lexicon), (INTERPRETER, parts.interpreter),
                            (REWARD, self.reward), (ENCODER, self.bundle.encoder)):
            if model is not None:
                run.provide(node, model, weights_hash(model))
        for corpus in (BLOCKS, CORPUS):
            run.provide(corpus, context.corpus, context.store.fingerprint)
        return run

    def taught(self, pupil: Pupil) -> FurtherPolicy:
        """The policy, trained now or read from the work folder."""
        run, selection = self.run(pupil.settings), self.bundle.config.selection
        if pupil.beta is not None:
            critics = run.get(ADVANTAGE)
            prior = self.bundle.block_models.interpreter
            return FurtherPolicy(AdvantageInterpreter(prior, critics, pupil.beta), selection.temperature or 1.0,
                                 digest(weights_hash(critics), pupil.beta))
        network = run.get(Q_NETWORK)
        return FurtherPolicy(network, self.temperature(run, network), weights_hash(network))

    @torch.no_grad()
    def temperature(self, run: Run, network: QNetwork) -> float:
        """At which a Q-network is as undecided as the LSTM, on the performers' past of the validation split."""
        corpus, labels, scores, nats = run.get(CORPUS), run.get(LABELS).hinted, [], []
        selection = self.bundle.config.selection
        for take in [take for take in takes_of(corpus, labels, "val") if len(take.blocks) > 1][:8]:
            scores.append(forced_values(network, corpus, take))
            nats.append(teacher_logits(self.bundle.block_models.interpreter, corpus, take.blocks, take.lexemes))
        return matched_temperature(torch.cat(scores), entropy_of(torch.cat(nats) / (selection.temperature or 1.0)))


# ------------------------------------------------------------------------------------------------------------- tables

def less(scores: PlayedScores, kinds: Sequence[str], than: str, group: Sequence[str], own: bool = False
         ) -> dict[str, stats.Interval]:
    """The reward of each kind less that of one, paired over voices; own: of what only the sound of the moment gives."""
    value = scores.own if own else scores.whole.__getitem__
    return {kind: stats.paired(value(kind), value(than), groups=list(group)) for kind in kinds if kind != than}


def tables(models: Mapping[str, RewardEnsemble], test: Sequence[PlayedVoice], pupils: Sequence[str],
           temperatures: Mapping[str, float], notes: Sequence[str]) -> list[Table]:
    """Rewards of all policies by both ensembles, and their margins."""
    kinds = [kind for kind in test[0].motions if kind != PERFORMER]
    group = [voice.group for voice in test]
    scores = {name: scored(model, test, kinds) for name, model in models.items()}
    columns = {name: Column(f"{name} ensemble, which {role}", digits=3)
               for name, role in zip(models, ("teaches", "judges"), strict=True)}
    policies = [*pupils, *(kind for kind in kinds if kind not in (REPLAYED, *pupils))]

    def rows(title: str, than: str, own: bool = False) -> Table:
        each = {name: less(score, policies, than, group, own) for name, score in scores.items()}
        return Table(title, columns, {kind: {name: each[name][kind] for name in each}
                                      for kind in policies if kind != than}, "policy",
                     ["An interval above 0: the ensemble prefers this policy."])

    means = {name: {kind: stats.mean_interval(score.whole[kind], groups=group) for kind in kinds}
             for name, score in scores.items()}
    hits = {name: found(model, test, REPLAYED) for name, model in models.items()}
    return [Table("Mean reward of motion as played", columns | {"temperature": Column("temperature", digits=3)},
                  {kind: {name: means[name][kind] for name in means} | {"temperature": temperatures.get(kind)}
                   for kind in kinds}, "policy", list(notes)),
            rows("Less the LSTM, paired over recordings", "lstm"),
            rows("Less the LSTM, of what only the sound of the moment gives", "lstm", True),
            rows("Less the performer's lexemes", REPLAYED),
            Table("Retrieval within a recording, windows one window apart, times chance", columns,
                  {REPLAYED: {name: own["times"] for name, own in hits.items()}}, "motion", [])]


def seen_table(bundle: Bundle, test: Sequence[PlayedVoice]) -> Table:
    """What a viewer sees of all policies."""
    kinds = [kind for kind in test[0].motions if kind != PERFORMER]
    return Table("Decisions that a viewer sees: agreement with the performer", {
        name: Column(name, digits=3) for name in SEEN}, agreement(bundle, test, kinds), "policy",
        ["Cohen's kappa of the blocks of a recording: 1 for the performer's decisions, 0 for chance. Without words, so "
         "without meanings."])


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments(p, Amounts(153, 60.0, 4, 1500))
    p.add_argument("--policies", nargs="+", default=["supervised", "cql 1", "cql 0.02", "advantage 1"])
    p.add_argument("--others", nargs="*", default=list(OTHERS), help="more interpreters of the bundle")
    a = p.parse_args()
    store, work = opened(a.store, a.work)
    folder = bundle_folder(a.bundle)
    ours = BundleSystem("ours", folder, KeptRenderings(None))
    player = VoicePlayer(ours, work / "played")
    learn = learned(player, store, a)
    torch.manual_seed(0)
    context = EvalContext.over(store, ours.bundle, work, None, not a.quiet)
    decoder = Decoder.of(ours.bundle, context.corpus, context.labels)
    models = {name: kept(BOTH, number, learn, work, a, decoder) for number, name in enumerate(ENSEMBLES)}
    heard = len(learn)
    del learn
    school = School(context, models[ENSEMBLES[0]], decoder)
    player.further = {name: school.taught(Pupil.named(name)) for name in a.policies}
    test = judged(player, store, a, (*a.others, *a.policies))
    temperatures = {name: policy.temperature for name, policy in player.further.items()}
    note = (f"Rewards of {heard} training recordings ({a.learn_seconds:g} s of each), {a.steps} steps of each of "
            f"{a.members} models an ensemble; {len(test)} {a.split} recordings ({a.seconds:g} s), evenly spread, one "
            "seed. Cosines, -1 to 1.")
    made = [*tables(models, test, a.policies, temperatures, [note]), seen_table(ours.bundle, test)]
    publish(made, a.out, Provenance.now(
        shlex.join(["python", "benchmarks/played_policy.py", *sys.argv[1:]]), folder / INDEX))


if __name__ == "__main__":
    main()

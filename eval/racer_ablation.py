"""RACER's ablation over our lexicon, and a sweep of alpha: what does conservative Q-learning buy? (RACER 5.5, Table 2)

    python -m eval.racer_ablation --data STORE --work DIR [--bundle DIR] [--only ROW ...] [--seeds 3] [--motion]

Every row is a Q-network of the same size, trained for the same number of steps and begun alike at the same seed; a row
is the settings that it changes, as after --set, and how it learns. `--list` shows them. "offline" learns from the
episodes of the training split (interpreters/episodes.py); "online" acts in the recorded speech, epsilon-greedily, and
learns from what it remembers; "actor-critic" begins as the supervised network of its seed (so it has had twice the
steps in all) and learns from what it has just done. The speech, the lexicon and both reward models are the bundle's and
the data set is drawn once, so that seeds differ by network, batches and roll-outs alone. Policies take the best lexeme
on their own past, in silence among the silent lexemes.

The network is small (`PRESET`): on one thread a step of 32 windows costs 0.11 s (supervised) to 0.2 s offline, 0.3 s
online and 0.4 s for the actor-critic, so 45 s to 3 min a run; judging it on 4,000 decisions takes 20 s more. Discount,
target period and the baseline of the reward are the bundle's own.

A finished (row, seed) is kept at once as ROW-SEED.json, under a hash of all that shapes it, and its weights in the work
folder: a command that was stopped goes on, and two may share the rows between them.

What fools it: the training reward is what most rows were made to please and `supervised` was not; believe what the
judging model says too. The paper's figures stand beside ours for their order alone: other data, another reward model,
another lexicon. Fewer than three seeds decide nothing and are marked.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from tqdm import tqdm

from data_module.errors import InputError, one_line_errors
from data_module.files import write_text
from data_module.layers import freeze
from data_module.speech.audio import SAMPLE_RATE, resample
from data_module.store import Recording, Store
from data_module.types import Array
from eval import policies
from eval.bootstrap import DRAWS, Interval, pseudo_values
from eval.figures import measure
from eval.metrics import fgd, gesture_features, pmb
from eval.parts import hinted_labels
from eval.policies import Chosen, Column, Ground, Lexemes, Policy, Rewards, walk
from eval.results import dumped, keep, loaded
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator import fit as fitting
from gesticulator.config import Config
from gesticulator.pipeline import Gesticulator
from gesticulator.prepare import Corpus, prepare, weights_hash
from gesticulator.racer import (
    decoded_lexemes,
    features_of,
    new_q_network,
    q_batch,
    reward_table,
    takes_of,
    taught_reward,
)
from gesticulator.speech_features import SpeechFeatures
from gesticulator.train import Run
from interpreters.actor_critic import ActorCritic, ActorCriticConfig
from interpreters.cql import ConservativeQ, QNetwork, without_dropout
from interpreters.episodes import Episodes, SilentLexemes, Take, build, distance_rewards
from interpreters.reward import Centred, RewardTable
from interpreters.simulator import Choose, Replay, Simulator, collect
from lexicon.inventory import nearest_silent

VERSION = 1
"""Raised when the same settings would no longer give the same figures."""
PRESET = ("cql.width=64", "cql.layers=4", "cql.heads=4", "schedules.cql.steps=300",
          "schedules.cql.batch=32")
"""What all rows share, on top of the bundle's settings."""
SEEDS = 3
DECIDED = 3
"""Fewer seeds decide nothing."""
ACT_EVERY = 2
"""Steps of the online row between two roll-outs of a batch of episodes."""
MEMORY = 4096
"""Windows that it remembers."""
GREEDY_AT, LEAST_EPSILON = 0.5, 0.1
"""epsilon falls from 1 to the least one by this share of the steps."""
MOTION = 4
"""Test recordings that the generator plays with --motion."""


@dataclass(frozen=True)
class Row:
    """A variant: the settings that it changes, as after --set, and how it learns."""

    about: str
    settings: tuple[str, ...] = ()
    training: str = "offline"
    """"offline", "online" or "actor-critic"."""


ROWS: dict[str, Row] = {
    "supervised": Row("cross-entropy on the lexeme of the data, which is the conservative term alone",
                      ("cql.temporal=0",)),
    "distance": Row("rewarded by nearness to the recorded motion, brought to the scale of the other reward",
                    ("episodes.reward=distance",)),
    "dqn": Row("no conservative term; acts in the recorded speech and learns from what it remembers",
               ("cql.conservative=0", "cql.warm_up=0"), "online"),
    "actor-critic": Row("begins as `supervised`, then policy gradients on what it has just done; a tenth of the rate, "
                        "since it shall not forget what it began as", ("schedules.cql.rate=0.0001",), "actor-critic"),
    "cql": Row("ours"),
    "literal": Row("ours on what people did and nothing else, the paper's own data set",
                   ("episodes.truth=1", "episodes.sampled=0", "episodes.statistical=0", "episodes.perturbed=0",
                    "episodes.baseline=0", "cql.warm_up=0")),
    **{f"alpha={alpha}": Row(f"ours with alpha {alpha}", (f"cql.conservative={alpha}",))
       for alpha in ("0.05", "0.1", "0.5", "1", "4", "10")},
}
OURS = "cql"
SUPERVISED = "supervised"

PAPER: dict[str, dict[str, float]] = {
    name: dict(zip(("maje", "mad", "fgd", "pmb", "return"), values, strict=False)) for name, values in {
        "supervised": (56.22, 1.81, 16.69, 78.54), "distance": (58.96, 2.94, 23.55, 72.09),
        "dqn": (59.44, 1.81, 15.46, 76.63, 4.23), "actor-critic": (60.18, 1.76, 17.69, 78.02, 3.93),
        "cql": (50.33, 1.21, 13.44, 89.58, 9.34)}.items()}
"""RACER Table 2, on Trinity."""

COLUMNS: dict[str, Column] = {
    **{key: column for key, column in policies.COLUMNS.items() if column.part != "motion"},
    **{key: Column(title, 2, "values", False) for key, title in policies.Q_COLUMNS.items()}}
MOTION_COLUMNS: dict[str, Column] = {"pmb": Column("PMB, %", 1, "motion", False),
                                     "fgd": Column("FGD, by the jackknife", 2, "motion", False),
                                     **{key: column for key, column in policies.COLUMNS.items()
                                        if column.part == "motion"}}


def twins(config: Config) -> dict[str, str]:
    """For each row the first one that is the same under these settings: itself, or `cql` for one alpha."""
    first: dict[str, str] = {}
    out = {}
    for name, row in ROWS.items():
        out[name] = first.setdefault(configs.digest(configs.with_settings(config, row.settings), row.training), name)
    return out


# -------------------------------------------------------------------------------------------- what all rows stand on

@dataclass(frozen=True)
class Bench:
    """What all rows share. run: settings, store and corpus as the training command knows them; takes: the training
    split; tables: reward tables by the prefix of their columns; shapes: hash of the data and of the bundle's parts."""

    bundle: bundles.Bundle
    run: Run
    takes: list[Take]
    silent: SilentLexemes
    ground: Ground
    tables: dict[str, RewardTable]
    _taught: dict[int, RewardTable | Centred] = field(default_factory=dict, init=False)
    shapes: str

    @classmethod
    def of(cls, store: Store, bundle: bundles.Bundle, work: Path, preset: Sequence[str], limit: int | None = None,
           progress: bool = True) -> Bench:
        """From a bundle over a lexicon with both reward models; InputError for another, and without test speech."""
        if bundle.reward is None or bundle.reward_judge is None:
            raise InputError("the bundle", "lacks one of the two reward models", "train with schedules.reward.steps")
        lexicon = bundle.drawn.lexicon
        run = Run(configs.with_settings(bundle.config, preset), store, work, progress=progress)
        run.corpus = prepare(store, run.config, work, bundle.encoder, workers=os.cpu_count() or 1, progress=progress)
        labels = hinted_labels(bundle, run.corpus)
        ground = Ground.of(bundle, run.corpus, labels, limit)
        if not ground.takes:
            raise InputError(store.path, "has no test recording with a decision in it", "build the store again")
        silent = SilentLexemes(bundle.silent, nearest_silent(lexicon.vectors.double().numpy(), bundle.silent))
        takes = [replace(take, lexemes=silent.relabel(take)) for take in takes_of(run.corpus, labels, "train")]
        parts = (lexicon, bundle.drawn.interpreter, bundle.reward, bundle.reward_judge, bundle.encoder)
        shapes = configs.digest(VERSION, store.fingerprint, [weights_hash(part) for part in parts if part is not None],
                                bundle.silent.tolist(), bundle.config.silence.mask)
        tables = {"": reward_table(bundle.reward, lexicon, run.corpus),
                  "judge_": reward_table(bundle.reward_judge, lexicon, run.corpus)}
        return cls(bundle, run, takes, silent, ground, tables, shapes)

    @property
    def corpus(self) -> Corpus:
        """The store's blocks."""
        return self.run.corpus

    def taught(self, config: Config) -> RewardTable | Centred:
        """The training reward as policies are taught it under the settings."""
        draws = config.episodes.baseline
        if draws not in self._taught:
            self._taught[draws] = taught_reward(self.tables[""], self.corpus, draws)
        return self._taught[draws]

    def config(self, name: str) -> Config:
        """The settings of a row."""
        return configs.with_settings(self.run.config, ROWS[name].settings)

    @cached_property
    def played(self) -> tuple[list[Recording], list[SpeechFeatures]]:
        """The recordings that are played, and what the system hears of them."""
        recordings = [self.run.store.load(self.corpus.names[take.recording]) for take in self.ground.takes[:MOTION]]
        system = Gesticulator(self.bundle)
        return recordings, [system.encode_speech(resample(replace(one.speech, words=None), SAMPLE_RATE))
                            for one in recordings]

    def key(self, name: str, seed: int) -> str:
        """Hash of everything that shapes the network of a row."""
        row = ROWS[name]
        how = {"online": [ACT_EVERY, MEMORY, GREEDY_AT, LEAST_EPSILON], "offline": [],
               "actor-critic": [ActorCriticConfig(), self.config(SUPERVISED)]}[row.training]
        return configs.digest(self.shapes, self.config(name), row.training, how, seed)


class Known:
    """A reward that is written down for every lexeme on every block of the corpus (what `Rewards` asks for)."""

    def __init__(self, table: Tensor) -> None:
        """table: [N, S]."""
        self.table, self.window = table, 1

    def every(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """[B, S] on the last of blocks [B, 1]."""
        return self.table[blocks[:, -1]]

    def sequence_every(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """[M, S] on blocks [M]."""
        return self.table[blocks]


def rescaled(table: Tensor, episodes: Episodes) -> Tensor:
    """A reward table [N, S] with the mean and spread, over the decisions of a data set, of the rewards there.

    That changes no order between lexemes, and by how much to trust the data's is then asked at one scale for both.
    """
    theirs = np.concatenate([episode.reward[1:] for episode in episodes.episodes]).astype(np.float64)
    ours = np.concatenate([table.numpy()[episode.blocks, episode.actions][1:] for episode in episodes.episodes])
    scale = theirs.std() / max(float(ours.std()), 1e-6)
    return (table - float(ours.mean())) * float(scale) + float(theirs.mean())


def acted(bench: Bench, config: Config) -> Episodes:
    """The offline data set with the contrastive reward, kept in the work folder; every seed learns from the same."""
    told = replace(config.episodes, reward="contrastive")
    key = configs.digest(bench.shapes, told, config.statistical, config.seed)
    file = bench.run.work / f"racer-ablation-{key}.npz"
    if not file.exists():
        lexicon, lstm = bench.bundle.drawn.lexicon, bench.bundle.drawn.interpreter
        build(bench.takes, told, bench.taught(config).sequence, silent=bench.silent, vectors=lexicon.vectors.numpy(),
              interpreters={"sampled": lstm, "statistical": bench.bundle.statistical()},
              features=features_of(bench.corpus), seed=config.seed).save(file)
    return Episodes.load(file)


def rewarded(bench: Bench, config: Config) -> tuple[Episodes, Rewards]:
    """The offline data set with the reward of the settings, and that reward."""
    episodes = acted(bench, config)
    if config.episodes.reward == "contrastive":
        return episodes, bench.taught(config)
    table = rescaled(distance_rewards(decoded_lexemes(bench.bundle.drawn.lexicon), bench.corpus.motion), episodes)
    own = [replace(e, reward=table.numpy()[e.blocks, e.actions].astype(np.float32)) for e in episodes.episodes]
    return Episodes(own, cloned=episodes.cloned, stretch=episodes.stretch), Known(table)


# --------------------------------------------------------------------------------------------------------- learning

@dataclass(frozen=True)
class Learner:
    """What `fit` needs: a model, its batches and what happens before a step."""

    model: ConservativeQ | ActorCritic
    make_batch: fitting.MakeBatch
    before_step: Callable[[int], None]


def latest(policy: QNetwork | ActorCritic, corpus: Corpus, seen: dict[str, Tensor]) -> Tensor:
    """Scores [B, S] of the lexeme to be chosen now, after what was seen (see `interpreters.simulator.Choose`)."""
    config = (policy.actor if isinstance(policy, ActorCritic) else policy).config
    heard = q_batch(corpus, seen, config.lookahead)
    return policy.values(heard["previous"], heard["audio"], heard["speaker"], heard["silent"])[:, -1]


def epsilon_greedy(network: QNetwork, corpus: Corpus, epsilon: float, rng: np.random.Generator) -> Choose:
    """The best allowed lexeme, or with probability epsilon any allowed one."""
    def choose(seen: dict[str, Tensor]) -> Tensor:
        values, silent = latest(network, corpus, seen), seen["silent"][:, -1]
        anything = network.choose(torch.as_tensor(rng.random(values.shape)), silent)
        explores = torch.as_tensor(rng.random(len(values)) < epsilon)
        return torch.where(explores, anything, network.choose(values, silent))

    return choose


def drawn(policy: ActorCritic, corpus: Corpus, rng: np.random.Generator) -> Choose:
    """A lexeme drawn from pi(. | s) over those allowed: the best after Gumbel noise on the log-probabilities."""
    def choose(seen: dict[str, Tensor]) -> Tensor:
        values = latest(policy, corpus, seen)
        noise = torch.as_tensor(rng.gumbel(size=values.shape))
        return policy.actor.choose(values + noise, seen["silent"][:, -1])

    return choose


def epsilon_at(step: int, steps: int) -> float:
    """How often the online row tries anything, at a step of so many."""
    return max(LEAST_EPSILON, 1 - (1 - LEAST_EPSILON) * step / max(1.0, GREEDY_AT * steps))


def offline(bench: Bench, config: Config, network: QNetwork, seed: int) -> Learner:
    """Conservative Q-learning, or what the settings leave of it, on the recorded episodes (RACER Eq. 11)."""
    model, (episodes, _) = ConservativeQ(network), rewarded(bench, config)
    return Learner(model, lambda rng: q_batch(bench.corpus, episodes.windows(
        rng, config.schedules.cql.batch, config.cql.decisions), config.cql.lookahead), model.before_step)


def online(bench: Bench, config: Config, network: QNetwork, seed: int) -> Learner:
    """DQN: every `ACT_EVERY` steps a batch of episodes is acted out and remembered."""
    model, memory = ConservativeQ(network), Replay(MEMORY)
    simulator = Simulator(bench.takes, bench.taught(config).rewards, bench.tables[""].window)
    count, decisions, steps = config.schedules.cql.batch, config.cql.decisions, config.schedules.cql.steps

    def before_step(step: int) -> None:
        model.before_step(step)
        if step % ACT_EVERY == 0:
            rng = np.random.default_rng([seed, step, 1])  # not the numbers that the step's batch is drawn with
            with without_dropout(network):
                memory.add(collect(simulator, epsilon_greedy(network, bench.corpus, epsilon_at(step, steps), rng), rng,
                                   count, decisions))

    return Learner(model, lambda rng: q_batch(bench.corpus, memory.windows(rng, count), config.cql.lookahead),
                   before_step)


def actor_critic(bench: Bench, config: Config, network: QNetwork, seed: int) -> Learner:
    """Policy gradients on what the policy has just done, beginning as the supervised network of the seed."""
    supervised = trained(bench, SUPERVISED, seed)[0]
    assert isinstance(supervised, QNetwork)
    model = policy_for("actor-critic", config, network)
    assert isinstance(model, ActorCritic)
    model.begin_as(supervised)
    simulator = Simulator(bench.takes, bench.taught(config).rewards, bench.tables[""].window)

    def make_batch(rng: np.random.Generator) -> fitting.Batch:
        return q_batch(bench.corpus, collect(simulator, drawn(model, bench.corpus, rng), rng,
                                             config.schedules.cql.batch, config.cql.decisions), config.cql.lookahead)

    return Learner(model, make_batch, model.before_step)


TRAININGS = {"offline": offline, "online": online, "actor-critic": actor_critic}


def untrained(bench: Bench, name: str, seed: int) -> QNetwork:
    """The network that a row begins with, the same for all rows of a seed."""
    torch.manual_seed(seed)
    return new_q_network(with_config(bench.run, bench.config(name)), bench.bundle.drawn.lexicon, bench.bundle.silent)


def policy_for(training: str, config: Config, network: QNetwork) -> QNetwork | ActorCritic:
    """What acts, of an untrained network."""
    return ActorCritic(network, ActorCriticConfig(gamma=config.cql.gamma)) if training == "actor-critic" else network


def trained(bench: Bench, name: str, seed: int) -> tuple[QNetwork | ActorCritic, float]:
    """The network of a row, trained now or read from the work folder, and how many seconds that took.

    A training that is stopped begins anew: what was remembered of roll-outs is not kept.
    """
    row, config, began = ROWS[name], bench.config(name), time.monotonic()
    file = bench.run.work / f"racer-ablation-{bench.key(name, seed)}.safetensors"
    network = untrained(bench, name, seed)
    if file.exists():
        policy = policy_for(row.training, config, network)
        policy.load_state_dict(load_file(file))
    else:
        learner = TRAININGS[row.training](bench, config, network, seed)
        began = time.monotonic()  # without the data set, or the network that it begins as
        with tempfile.TemporaryDirectory() as folder:
            fitting.fit(f"{name}, seed {seed}", learner.model, learner.make_batch, learner.model.losses,
                        config.schedules.cql, Path(folder), seed=seed, before_step=learner.before_step,
                        checkpoint_seconds=float("inf"), progress=bench.run.progress)
        policy = learner.model.online if isinstance(learner.model, ConservativeQ) else learner.model
        _save(policy, file)
    freeze(policy)
    return policy, time.monotonic() - began


def with_config(run: Run, config: Config) -> Run:
    """The same run with other settings, over the corpus as it is."""
    own = dataclasses.replace(run, config=config)
    own.corpus = run.corpus
    return own


def _save(policy: nn.Module, file: Path) -> None:
    """Whole or not at all."""
    temporary = file.with_suffix(f".{os.getpid()}.tmp")
    save_file({key: value.detach().contiguous() for key, value in policy.state_dict().items()}, temporary)
    os.replace(temporary, file)


# ---------------------------------------------------------------------------------------------------------- judging

def judged(bench: Bench, policy: Policy, valued: Rewards | None, gamma: float) -> tuple[Chosen, list[dict[str, float]]]:
    """What a policy did on the test recordings, and its figures on each.

    valued: the reward whose discounted sum its scores estimate; None where they are no values.
    """
    ground = bench.ground
    free = [walk(policy, ground, take) for take in ground.takes]
    forced = [walk(policy, ground, take, teacher=True) for take in ground.takes]
    chosen = Chosen([lexemes for lexemes, _ in free], [lexemes for lexemes, _ in forced])
    training = [take.lexemes for take in bench.takes]
    rows = []
    for place, take in enumerate(ground.takes):
        values = policies.lexeme_values(chosen, place, ground, dict(bench.tables), bench.bundle.drawn.interpreter,
                                        training)
        nll, gap = policies.conservative_gaps(forced[place][1], take.lexemes[1:], ground.allowed(take)[1:])
        rows.append(values | {"nll": nll, "gap": gap} | calibration(take, *free[place], valued, gamma))
    return chosen, rows


def calibration(take: Take, lexemes: Lexemes, scores: Array, valued: Rewards | None, gamma: float) -> dict[str, float]:
    """By how much Q overrates the first decision, and Spearman's rho of Q with the return-to-go; NaN for no values.

    lexemes: [M] that the policy took, scores: [M - 1, S] its own.
    """
    if valued is None:
        return {"calibration": float("nan"), "spearman": float("nan")}
    q = policies.taken(scores, lexemes[1:])
    returns = policies.return_to_go(policies.taken(policies.every_reward(valued, take, lexemes), lexemes[1:]), gamma)
    return {"calibration": float(q[0] - returns[0]), "spearman": policies.rank_correlation(q, returns)}


def values_of(bench: Bench, name: str) -> Rewards | None:
    """The reward that a row's scores are sums of; None where they are logits."""
    row, config = ROWS[name], bench.config(name)
    if row.training == "actor-critic" or not config.cql.temporal:
        return None
    return bench.taught(config) if row.training == "online" else rewarded(bench, config)[1]


def cell(bench: Bench, name: str, seed: int, out: Path) -> dict[str, Any]:
    """One row at one seed: read from `out` if it was finished under the same key, else trained, judged and written."""
    file = out / f"{name}-{seed}.json"
    names = [bench.corpus.names[take.recording] for take in bench.ground.takes]
    key = configs.digest(bench.key(name, seed), names)
    known = _finished(file, key)
    if known is not None:
        return known
    policy, seconds = trained(bench, name, seed)
    config = bench.config(name)
    chosen, rows = judged(bench, Policy(policy), values_of(bench, name), config.cql.gamma)
    result = {
        "row": name, "seed": seed, "key": key, "training": ROWS[name].training, "settings": list(ROWS[name].settings),
        "steps": config.schedules.cql.steps, "seconds": round(seconds, 1),
        "recordings": [{"name": who, "decisions": len(take.blocks) - 1, **figures}
                       for who, take, figures in zip(names, bench.ground.takes, rows, strict=True)],
        "lexemes": [lexemes.tolist() for lexemes in chosen.free[:MOTION]]}
    write_text(file, dumped(result))
    return result


def _finished(file: Path, key: str) -> dict[str, Any] | None:
    try:
        known: dict[str, Any] = loaded(file.read_text())
    except (FileNotFoundError, ValueError):
        return None
    return known if known.get("key") == key else None


# ----------------------------------------------------------------------------------------------------------- motion

def with_motion(bench: Bench, found: dict[str, Any], by: Sequence[gesture_features.Features], out: Path
                ) -> dict[str, Any]:
    """A finished cell with the figures of its motion on the first `MOTION` test recordings, kept in its file.

    The distance in the first network has a value for each recording by the jackknife.
    """
    key = configs.digest(found["key"], weights_hash(bench.bundle.drawn.generator),
                         weights_hash(bench.bundle.drawn.style), [one.sha256 for one in by], MOTION, "jackknife")
    if found.get("motion", {}).get("key") == key:
        return found
    recordings, heard = bench.played
    motions = policies.perform(Gesticulator(bench.bundle), recordings, [np.array(own) for own in found["lexemes"]],
                               found["row"], bench.run.progress, heard)
    rows = []
    for place, (motion, recording) in enumerate(zip(motions, recordings, strict=True)):
        clip = measure(motion, recording.speech)
        rows.append({"pmb": pmb.pmb(clip.beats, clip.onsets),
                     **policies.motion_values(clip, motion, recording.motion, seed=place)})
    real = [recording.motion for recording in recordings]
    if by:
        both = [gesture_features.pooled(clips, by[0]) for clips in (motions, real)]

        def distance(chosen: list[int]) -> float:
            ours, theirs = (np.concatenate([features[k] for k in chosen]) for features in both)
            return fgd.distance(ours, theirs) if min(len(ours), len(theirs)) > 1 else float("nan")

        for row, value in zip(rows, pseudo_values(distance, len(rows)), strict=True):
            row["fgd"] = float(value)
    distances = {f"{one.name}, {one.frames} at {one.fps:g} fps": fgd.measure(
        gesture_features.pooled(motions, one), gesture_features.pooled(real, one), one, paired=True).to_dict()
        for one in by}
    result = {**found, "motion": {"key": key, "recordings": rows, "fgd": distances}}
    write_text(out / f"{found['row']}-{found['seed']}.json", dumped(result))
    return result


# -------------------------------------------------------------------------------------------------------- the table

def interval_over(values: ArrayLike, weights: ArrayLike) -> Interval:
    """Mean and 95 % bootstrap interval of values [seeds, clips], seeds and clips drawn anew together; NaN left out.

    weights: [clips]. With one seed it is the interval over clips.
    """
    own = np.atleast_2d(np.asarray(values, dtype=np.float64))
    weight = np.isfinite(own) * np.asarray(weights, dtype=np.float64)
    total = np.where(weight > 0, own, 0.0) * weight
    clips = int((weight > 0).any(axis=0).sum())
    if clips == 0:
        return Interval(float("nan"), float("nan"), float("nan"), 0)
    rng, (seeds, count) = np.random.default_rng(0), own.shape
    times = [rng.multinomial(n, np.full(n, 1 / n), size=DRAWS).astype(np.float64) for n in (seeds, count)]
    sums, masses = ((times[0] @ part * times[1]).sum(axis=1) for part in (total, weight))
    low, high = np.percentile(sums[masses > 0] / masses[masses > 0], [2.5, 97.5])
    return Interval(float(total.sum() / weight.sum()), float(low), float(high), clips)


def _matrix(cells: Iterable[dict[str, Any]], key: str) -> Array:
    """[seeds, clips] of one figure."""
    return np.array([[own[key] for own in one["recordings"]] for one in cells], dtype=np.float64)


def tabled(cells: dict[str, dict[int, dict[str, Any]]]) -> dict[str, Any]:
    """Rows and paired differences (ours minus the row, at the seeds that both have). cells: by row and seed."""
    out: dict[str, Any] = {"rows": {}, "differences": {}}
    for name, by_seed in cells.items():
        one = next(iter(by_seed.values()))
        sizes = [own["decisions"] for own in one["recordings"]]
        weights = {key: sizes if column.by_blocks else [1] * len(sizes) for key, column in COLUMNS.items()}
        out["rows"][name] = {
            "about": ROWS[name].about, "settings": list(ROWS[name].settings), "training": ROWS[name].training,
            "run_as": one["row"], "steps": one["steps"], "seconds": [own["seconds"] for own in by_seed.values()],
            "seeds": sorted(by_seed), "decided": len(by_seed) >= DECIDED, "paper": PAPER.get(name, {}),
            "figures": {key: interval_over(_matrix(by_seed.values(), key), weights[key]).to_dict() for key in COLUMNS}}
        shared = sorted(set(by_seed) & set(cells.get(OURS, {})))
        if shared and one["row"] != OURS:
            out["differences"][f"{OURS} - {name}"] = {
                "seeds": shared, "decided": len(shared) >= DECIDED, "figures": {
                    key: interval_over(_matrix([cells[OURS][s] for s in shared], key)
                                       - _matrix([by_seed[s] for s in shared], key), weights[key]).to_dict()
                    for key in COLUMNS}}
    return out


def motion_table(cells: dict[str, dict[int, dict[str, Any]]]) -> dict[str, Any]:
    """Rows of motion: intervals over seeds and the few recordings; Frechet distances of the first seed's set."""
    out = {}
    for name, by_seed in cells.items():
        own = [one["motion"] for _, one in sorted(by_seed.items()) if "motion" in one]
        if own:
            count = len(own[0]["recordings"])
            out[name] = {"paper": PAPER.get(name, {}), "seeds": len(own), "fgd": own[0]["fgd"], "figures": {
                key: interval_over([[row.get(key, np.nan) for row in one["recordings"]] for one in own],
                                   [1] * count).to_dict() for key in MOTION_COLUMNS}}
    return out


def ablation(store: Store, bundle: bundles.Bundle, work: Path, out: Path, *, only: Sequence[str] = (),
             seeds: int = SEEDS, preset: Sequence[str] = PRESET, limit: int | None = None,
             by: Sequence[gesture_features.Features] | None = None, progress: bool = True) -> dict[str, Any]:
    """Run what is asked for and is not finished; all rows that are finished, as plain values.

    only: rows to run (all); seeds: how many, from 1 on; limit: test recordings at most; by: what the Frechet distance
    is measured in, None for no motion.
    """
    bench = Bench.of(store, bundle, work, preset, limit, progress)
    same, names = twins(bench.run.config), [bench.corpus.names[take.recording] for take in bench.ground.takes]
    out.mkdir(parents=True, exist_ok=True)
    asked = list(dict.fromkeys(same[name] for name in only or ROWS))
    jobs = [(name, seed) for seed in range(1, seeds + 1) for name in asked]
    for name, seed in tqdm(jobs, desc="rows", disable=not progress):
        found = cell(bench, name, seed, out)
        if by is not None:
            with_motion(bench, found, by, out)
    cells: dict[str, dict[int, dict[str, Any]]] = {}
    for name, twin in same.items():
        for seed in range(1, seeds + 1):
            known = _finished(out / f"{twin}-{seed}.json", configs.digest(bench.key(twin, seed), names))
            if known is not None:
                cells.setdefault(name, {})[seed] = known
    config = bench.run.config
    return {"store": {"name": store.corpus, "fingerprint": store.fingerprint, "test_recordings": len(names),
                      "decisions": sum(len(take.blocks) - 1 for take in bench.ground.takes)},
            "settings": {"preset": list(preset), "steps": config.schedules.cql.steps, "gamma": config.cql.gamma,
                         "copies": -(-config.schedules.cql.steps // config.cql.copy_every), "seeds": seeds},
            **tabled(cells), "motion": motion_table(cells)}


def _cell(value: dict[str, float], digits: int) -> str:
    if not np.isfinite(value["mean"]):
        return "-"
    return f"{value['mean']:.{digits}f} [{value['low']:.{digits}f}, {value['high']:.{digits}f}]"


def _line(name: str, row: dict[str, Any], shown: dict[str, Column], papers: Sequence[str]) -> str:
    """A line of a table; the paper's figure stands behind ours where a column has one."""
    cells = []
    for key, column in shown.items():
        cells.append(_cell(row["figures"][key], column.digits))
        if key in papers:
            cells.append(str(row.get("paper", {}).get(key, "")))
    return f"| {name} | " + " | ".join(cells) + " |"


def _head(part: str, shown: dict[str, Column], papers: Sequence[str]) -> list[str]:
    titles = [title for key, column in shown.items()
              for title in (column.title, *(["the paper's, on other data"] if key in papers else []))]
    return [f"| {part} | " + " | ".join(titles) + " |", "|---" * (len(titles) + 1) + "|"]


def _named(name: str, row: dict[str, Any]) -> str:
    same = row.get("run_as", name)
    undecided = "" if row["decided"] else f" (undecided: {len(row['seeds'])} of {DECIDED} seeds)"
    return name + (f" = {same}" if same != name else "") + undecided


def markdown(result: dict[str, Any]) -> str:
    """The tables for a reader."""
    told, how = result["store"], result["settings"]
    lines = [f"Test split: {told['test_recordings']} recordings, {told['decisions']} decisions; {how['steps']} steps a "
             f"row, {how['copies']} copies of the target. Means over seeds and recordings with bootstrap 95 % "
             "intervals, both drawn anew; differences are paired.", ""]
    for part in dict.fromkeys(column.part for column in COLUMNS.values()):
        shown = {key: column for key, column in COLUMNS.items() if column.part == part}
        papers = [key for key in shown if key == "return"]
        lines += _head(part, shown, papers)
        lines += [_line(_named(name, row), row, shown, papers)
                  for name, row in (*result["rows"].items(), *result["differences"].items())]
        lines.append("")
    if result["motion"]:
        lines += _motion_lines(result["motion"])
    lines += ["| row | settings | learns | seconds a run |", "|---|---|---|---|"]
    lines += [f"| {name} | {' '.join(row['settings'])} | {row['training']} | "
              f"{', '.join(f'{seconds:.0f}' for seconds in row['seconds'])} |" for name, row in result["rows"].items()]
    return "\n".join(lines) + "\n"


def _motion_lines(rows: dict[str, Any]) -> list[str]:
    papers = [key for key in MOTION_COLUMNS if any(key in row["paper"] for row in rows.values())]
    lines = _head(f"motion, {MOTION} recordings at most", MOTION_COLUMNS, papers)
    lines += [_line(f"{name} ({row['seeds']} seeds)" if row["seeds"] > 1 else f"{name} (1 seed)", row, MOTION_COLUMNS,
                    papers) for name, row in rows.items()]
    networks = list(next(iter(rows.values()))["fgd"])
    lines += ["", "| FGD of the first seed's set | " + " | ".join([*networks, "the paper's, on other data"]) + " |",
              "|---" * (len(networks) + 2) + "|"]
    for name, row in rows.items():
        own = [_cell({**one["interval"], "mean": one["distance"]}, 2) + ("*" if one["reason"] else "")
               for one in row["fgd"].values()]
        lines.append(f"| {name} | " + " | ".join([*own, str(row["paper"].get("fgd", ""))]) + " |")
    return [*lines, "", "\\* fewer windows than the network's features call for (see `eval.metrics.fgd`).", ""]


def listing() -> str:
    """What there is to run."""
    return "\n".join(f"{name:14} {row.training:13} {' '.join(row.settings) or '(the settings as they are)'}\n"
                     f"{'':14} {row.about}" for name, row in ROWS.items())


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser("eval.racer_ablation", description="RACER's ablation over our lexicon, and alpha.")
    p.add_argument("--data", metavar="STORE", help="needed, except with --list")
    p.add_argument("--work", metavar="DIR", help="where blocks, episodes and networks are kept (needed likewise)")
    p.add_argument("--bundle", metavar="DIR", help="default: the shipped one")
    p.add_argument("--only", nargs="+", default=[], metavar="ROW", help="rows to run; the table has all finished ones")
    p.add_argument("--seeds", type=int, default=SEEDS, metavar="N", help=f"seeds 1 to N ({SEEDS})")
    p.add_argument("--steps", type=int, metavar="N", help="training steps of every row")
    p.add_argument("--limit", type=int, metavar="N", help="the first N test recordings only")
    p.add_argument("--motion", action="store_true", help="play each row through the generator on a few recordings")
    p.add_argument("--out", default="docs/results/racer", metavar="DIR", help="for ROW-SEED.json and table.json, .md")
    p.add_argument("--list", action="store_true", help="show the rows and stop")
    return p


def _checked(arguments: argparse.Namespace) -> None:
    for name in ("seeds", "steps", "limit"):
        value = getattr(arguments, name)
        if value is not None and value < 1:
            raise InputError(f"--{name} {value}", "is too few", "choose 1 or more")
    unknown = [name for name in arguments.only if name not in ROWS]
    if unknown:
        raise InputError(f"--only {' '.join(unknown)}", "is no row", f"choose among {', '.join(ROWS)}")
    if arguments.data is None or arguments.work is None:
        raise InputError("--data and --work", "are needed", "give a store and a folder to keep things in")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    arguments = parser().parse_args(argv)
    if arguments.list:
        print(listing())
        return 0
    with one_line_errors("eval.racer_ablation"):
        _checked(arguments)
        torch.set_num_threads(1)
        store, work, out = Store.open(arguments.data), Path(arguments.work), Path(arguments.out)
        work.mkdir(parents=True, exist_ok=True)
        bundle = bundles.load(arguments.bundle or bundles.SHIPPED)
        preset = (*PRESET, *([f"schedules.cql.steps={arguments.steps}"] if arguments.steps else []))
        result = ablation(store, bundle, work, out, only=arguments.only, seeds=arguments.seeds, preset=preset,
                          limit=arguments.limit, by=policies.networks(store, work) if arguments.motion else None)
        keep(result, markdown(result), out / "table.json")
        print(markdown(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Lexeme interpreters judged as policies over one lexicon, one generator and the same test speech (RG Table 6, more).

    python -m eval.policies --data STORE --work DIR [--bundle DIR] [--out docs/results/policies.json] [--limit N]

Every policy is given the performer's first lexeme of a recording and chooses the rest by itself, in silent blocks among
the silent lexemes alone (where the bundle masks); the lexemes that are judged are the ones that the generator then
plays, gate open. Rows: `performer` is the true lexemes with the silent hint, `lstm` and `statistical` draw as the
bundle draws, `cql` chooses as the bundle has it (arg max, RACER), `commonest` never changes, `greedy` takes the lexeme
of the highest training reward at each block by trying them all, and `random` draws any lexeme alike.

What fools it: the training reward is what `greedy` and `cql` were made to please. A policy that gains there and not
under the judging model, which trained on other recordings, has found a hole in the reward and not a better gesture.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import spearmanr
from torch import Tensor
from tqdm import tqdm

from data_module.errors import InputError, one_line_errors
from data_module.motion.kinematics import resample
from data_module.store import Recording, Store
from data_module.types import Array, Motion
from eval.baselines import to_common_length
from eval.bootstrap import interval
from eval.figures import Clip, Commonest, measure
from eval.metrics import fgd, gesture_features, pmb
from eval.metrics.diversity import distinct_2, diversity, longest_run, unseen_bigrams
from eval.metrics.joint_error import motion_error
from eval.parts import hinted_labels, table
from eval.results import publish
from gesticulator import bundle as bundles
from gesticulator.pipeline import Gesticulator
from gesticulator.prepare import Corpus, prepare
from gesticulator.racer import features_of, reward_table, takes_of, taught_reward
from gesticulator.speech_features import SpeechFeatures
from interpreters import BlockFeatures, LexemeInterpreter, LstmInterpreter, select
from interpreters.episodes import Take

Lexemes = NDArray[np.int64]
Mask = NDArray[np.bool_]

EPISODE = 15
"""Decisions in an episode, RACER's 6 seconds of codes."""
RARE = 0.01
"""A choice that the lstm gives less than this is out of distribution."""
SEED = 0
PAIRS = (("cql", "lstm"), ("cql", "statistical"))
FGD_FRAMES = (34, 60)
"""Windows of our own networks, at 15 fps: that of the papers' network, and one of 4 s."""
FGD_FOLDER = "fgd"
"""In GESTICULATOR_DATA: where the papers' network lies, if it is there."""


@dataclass(frozen=True)
class Column:
    """A quantity of the table: its heading, how many digits are shown, in which of the tables, and whether its mean is
    over blocks (recordings count by their length) or over recordings."""

    title: str
    digits: int
    part: str
    by_blocks: bool = True


COLUMNS: dict[str, Column] = {
    "return": Column(f"return of {EPISODE} steps", 2, "training reward", False),
    "cosine": Column("cosine", 3, "training reward"),
    "regret": Column("regret", 3, "training reward"),
    "judge_return": Column(f"return of {EPISODE} steps", 2, "judging reward", False),
    "judge_cosine": Column("cosine", 3, "judging reward"),
    "judge_regret": Column("regret", 3, "judging reward"),
    "free_running": Column("right, free-running, %", 1, "lexemes"),
    "teacher_forced": Column("right, teacher-forced, %", 1, "lexemes"),
    "diversity": Column("diversity, nats", 2, "lexemes", False),
    "longest_run": Column("longest run", 1, "lexemes", False),
    "distinct_2": Column("distinct-2", 2, "lexemes", False),
    "rare": Column("out of distribution, %", 1, "support"),
    "unseen_bigrams": Column("unseen bigrams, %", 1, "support"),
    "silent": Column("silent lexeme in silence, %", 1, "support", False),
    "pmb_above_chance": Column("PMB above chance, %", 1, "motion", False),
    "speech_speed": Column("hands in speech, m/s", 3, "motion", False),
    "silence_speed": Column("hands in silence, m/s", 3, "motion", False),
    "maje": Column("MAJE, mm", 1, "motion", False),
    "mad": Column("MAD, mm/s^2", 0, "motion", False),
}
Q_COLUMNS = {"nll": "E[logsumexp Q - Q(a_data)]", "gap": "E[max Q - Q(a_data)]",
             "calibration": "Q(s_1, a_1) - discounted return", "spearman": "Spearman of Q with the return-to-go"}


# ------------------------------------------------------------------------------- quantities: arrays in, numbers out

def episode_return(rewards: Array, steps: int = EPISODE) -> float:
    """The sum of r over `steps` decisions, the mean over all such windows of rewards [n]; NaN for fewer than that."""
    if len(rewards) < steps:
        return float("nan")
    return float(np.lib.stride_tricks.sliding_window_view(rewards, steps).sum(axis=1).mean())


def taken(values: Array, lexemes: Lexemes) -> Array:
    """[n] the value of the lexeme that was taken, from the values of all [n, S]."""
    return np.asarray(np.take_along_axis(values, lexemes[:, None], axis=1)[:, 0], dtype=np.float64)


def regret(rewards: Array, lexemes: Lexemes, allowed: Mask) -> float:
    """Mean over i of max_a r(s_i, a) - r(s_i, a_i), a among those allowed; rewards and allowed: [n, S]."""
    return float((np.where(allowed, rewards, -np.inf).max(axis=1) - taken(rewards, lexemes)).mean())


def silent_share(lexemes: Lexemes, silent: Mask, silent_lexemes: Lexemes) -> float:
    """Percent of silent blocks with a silent lexeme; NaN without a silent block."""
    return 100.0 * float(np.isin(lexemes[silent], silent_lexemes).mean()) if silent.any() else float("nan")


def return_to_go(rewards: Array, gamma: float) -> Array:
    """[n] G_i = r_i + gamma G_{i+1}, nothing after the last (RACER Eq. 1)."""
    out, after = np.empty(len(rewards)), 0.0
    for i in range(len(rewards) - 1, -1, -1):
        out[i] = after = float(rewards[i]) + gamma * after
    return out


def conservative_gaps(q: Array, lexemes: Lexemes, allowed: Mask) -> tuple[float, float]:
    """E[logsumexp Q - Q(a)] and E[max Q - Q(a)] over the lexemes a of the data, q and allowed [n, S] (RACER Eq. 11).

    The first is what the conservative term brings down, and is the surprise at the data, in nats, if Q were logits.
    """
    masked, own = np.where(allowed, q, -np.inf), taken(q, lexemes)
    return float((logsumexp(masked, axis=1) - own).mean()), float((masked.max(axis=1) - own).mean())


def rank_correlation(first: Array, second: Array) -> float:
    """Spearman's rho of two rows [n]; NaN where either is constant or has fewer than two values."""
    if len(first) < 2 or np.ptp(first) == 0 or np.ptp(second) == 0:
        return float("nan")
    return float(spearmanr(first, second).statistic)


# --------------------------------------------------------------------------------------------------------- policies

@dataclass(frozen=True)
class Ground:
    """What all policies stand on. takes: the test recordings, with the performer's lexemes (hinted); the first lexeme
    of a take is given, decision i is block i from 1 on. silent: [n] the silent lexemes; masked: whether they are all
    that may be chosen in silence. size: S."""

    corpus: Corpus
    takes: list[Take]
    silent: Lexemes
    masked: bool
    size: int

    @classmethod
    def of(cls, bundle: bundles.Bundle, corpus: Corpus, labels: Lexemes, limit: int | None = None) -> Ground:
        """The first `limit` test recordings that hold a decision, with lexemes from labels [N]."""
        takes = [take for take in takes_of(corpus, labels, "test") if len(take.blocks) > 1]
        return cls(corpus, takes[:limit], bundle.silent, bundle.config.silence.mask, len(bundle.lexicon.vectors))

    def allowed(self, take: Take) -> Mask:
        """[M, S] which lexemes may be chosen on each block."""
        return allowed_lexemes(take.silent & self.masked, self.silent, self.size)


@dataclass(frozen=True)
class Policy:
    """An interpreter and how a lexeme is chosen from its scores (`interpreters.select`)."""

    interpreter: LexemeInterpreter
    temperature: float = 0.0
    top: int | None = None


@dataclass(frozen=True)
class Chosen:
    """What a policy did on each take, [M] lexemes: on its own past, and on the performer's."""

    free: list[Lexemes]
    forced: list[Lexemes]


class Rewards(Protocol):
    """What is asked of a reward table (interpreters/reward.py)."""

    window: int
    """Blocks that a reward looks back on."""

    def every(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """[B, S] rewards of each last lexeme after a history [B, W - 1] on blocks [B, W]."""
        ...

    def sequence_every(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """[M, S] rewards of each lexeme at each block of a recording, the ones before it as they are."""
        ...


class Anything:
    """All lexemes alike, whatever is said: drawn from, the policy that knows nothing."""

    def __init__(self, size: int) -> None:
        self._size = size

    def start(self, speaker: int, first_lexeme: int) -> None:
        """There is no state."""
        return

    def step(self, state: None, features: BlockFeatures, previous_lexeme: int) -> tuple[Array, None]:
        """Zeros [S]."""
        return np.zeros(self._size), None


class Told:
    """Lexemes that are known beforehand, one sequence after the other: each `start` begins the next."""

    def __init__(self, sequences: Iterable[Lexemes], size: int) -> None:
        self._coming, self._size = iter(sequences), size

    def start(self, speaker: int, first_lexeme: int) -> Iterator[int]:
        """The state is what is yet to come."""
        return iter(next(self._coming).tolist())

    def step(self, state: Iterator[int], features: BlockFeatures, previous_lexeme: int) -> tuple[Array, Iterator[int]]:
        """Scores [S] that leave one choice."""
        scores = np.full(self._size, -1e3)
        scores[next(state)] = 0.0
        return scores, state


def allowed_lexemes(silent: Mask, silent_lexemes: Lexemes, size: int) -> Mask:
    """[M, S] True where a lexeme may be chosen: any in speech, a silent one in silence (all, where there is none)."""
    allowed = np.ones((len(silent), size), dtype=bool)
    if len(silent_lexemes):
        allowed[silent] = np.isin(np.arange(size), silent_lexemes)
    return allowed


def walk(policy: Policy, ground: Ground, take: Take, teacher: bool = False) -> tuple[Lexemes, Array]:
    """The lexemes [M] that a policy takes and its scores [M - 1, S] for them; the first lexeme is given.

    teacher: what it hears as its past is the performer's lexemes. Draws depend on the seed and the recording alone.
    """
    rng, allowed = np.random.default_rng([SEED, take.recording]), ground.allowed(take)
    features = features_of(ground.corpus)
    lexemes, scores = take.lexemes.copy(), np.empty((len(take.blocks) - 1, ground.size))
    state = policy.interpreter.start(take.speaker, int(lexemes[0]))
    for i in range(1, len(lexemes)):
        previous = int((take.lexemes if teacher else lexemes)[i - 1])
        scores[i - 1], state = policy.interpreter.step(state, features(int(take.blocks[i])), previous)
        lexemes[i] = select(scores[i - 1], allowed=np.flatnonzero(allowed[i]), temperature=policy.temperature,
                            top=policy.top, rng=rng)
    return lexemes, scores


def greedy(rewards: Rewards, ground: Ground, take: Take, teacher: bool = False) -> Lexemes:
    """The lexemes [M] of the highest reward at each block, found by trying every one after those before.

    No other choice has a higher reward at that block; over many blocks a patient one may do better still.
    """
    lexemes, allowed = take.lexemes.copy(), ground.allowed(take)
    for i in range(1, len(lexemes)):
        begin = max(0, i - rewards.window + 1)
        past = torch.as_tensor((take.lexemes if teacher else lexemes)[begin:i])[None]
        blocks = torch.as_tensor(take.blocks[begin:i + 1])[None]
        each = rewards.every(past, blocks, torch.ones(blocks.shape))[0].double().numpy()
        lexemes[i] = int(np.where(allowed[i], each, -np.inf).argmax())
    return lexemes


@torch.inference_mode()
def behaviour(model: LstmInterpreter, ground: Ground, take: Take, lexemes: Lexemes) -> Array:
    """[M - 1] pi_beta: what the lstm, among those allowed, gives each of `lexemes` [M] after the ones before it."""
    audio = ground.corpus.high[torch.as_tensor(take.blocks[1:])].float()[None]
    speaker = torch.nn.functional.one_hot(torch.tensor([take.speaker]), model.speakers).float()
    logits, _ = model.scores(torch.as_tensor(lexemes[:-1])[None], audio, speaker)
    blocked = torch.as_tensor(~ground.allowed(take)[1:])
    share = logits[0].double().masked_fill(blocked, -torch.inf).softmax(dim=-1).numpy()
    return taken(share, lexemes[1:])


def every_reward(rewards: Rewards, take: Take, lexemes: Lexemes) -> Array:
    """[M - 1, S] the reward that each lexeme would have had at each decision."""
    each: Array = rewards.sequence_every(torch.as_tensor(lexemes), torch.as_tensor(take.blocks))[1:].double().numpy()
    return each


# ------------------------------------------------------------------------------------------------------------- rows

def lexeme_values(chosen: Chosen, place: int, ground: Ground, tables: dict[str, Rewards], lstm: LstmInterpreter,
                  training: Sequence[Lexemes]) -> dict[str, float]:
    """What the lexemes of one take tell. tables: reward tables by the prefix of their columns; lstm: what tells common
    choices from rare ones; training: the lexemes of the training split."""
    take, free, forced = ground.takes[place], chosen.free[place], chosen.forced[place]
    own, right, allowed, values = free[1:], take.lexemes[1:], ground.allowed(take)[1:], dict[str, float]()
    for prefix, rewards in tables.items():
        each = every_reward(rewards, take, free)
        got = taken(each, own)
        values |= {f"{prefix}return": episode_return(got), f"{prefix}cosine": float(got.mean()),
                   f"{prefix}regret": regret(each, own, allowed)}
    return values | {
        "free_running": 100.0 * float((own == right).mean()),
        "teacher_forced": 100.0 * float((forced[1:] == right).mean()),
        "diversity": diversity(own, ground.size).nats, "longest_run": longest_run([own]),
        "distinct_2": distinct_2([free]),
        "rare": 100.0 * float((behaviour(lstm, ground, take, free) < RARE).mean()),
        "unseen_bigrams": 100.0 * unseen_bigrams([free], training),
        "silent": silent_share(own, take.silent[1:], ground.silent)}


def motion_values(clip: Clip, generated: Motion, truth: Motion, seed: int) -> dict[str, float]:
    """PMB above chance (percent, at `pmb.DELTA`), mean speeds of the hands (m/s), MAJE (mm) and MAD (mm/s^2) of a clip.

    The speaker's own motion is brought to the frame rate of the other, and both are cut to the shorter.
    """
    chance = pmb.chance(clip.beats, clip.onsets, clip.duration, seed=seed)
    speech, silence = clip.hand_speed[~clip.silent], clip.hand_speed[clip.silent]
    ours, theirs = to_common_length([generated], [resample(truth, generated.fps)])
    error = motion_error(ours[0], theirs[0])
    return {"pmb_above_chance": 100.0 * pmb.above_chance(pmb.pmb(clip.beats, clip.onsets), chance.mean),
            "speech_speed": float(speech.mean()) if speech.size else float("nan"),
            "silence_speed": float(silence.mean()) if silence.size else float("nan"),
            "maje": error.maje, "mad": error.mad}


def perform(system: Gesticulator, recordings: Sequence[Recording], lexemes: Sequence[Lexemes], label: str,
            progress: bool, heard: Sequence[SpeechFeatures] | None = None) -> list[Motion]:
    """What the generator makes of these lexemes [M] for the speech of these recordings, the gate open. heard: what the
    system has heard of each before."""
    told = Told(lexemes, len(system.bundle.lexicon.vectors))
    return [system(replace(recording.speech, words=None), speaker=recording.info.speaker, interpreter=told,
                   temperature=0.0, activity=1.0, encoded=heard[place] if heard else None).motion
            for place, recording in enumerate(tqdm(recordings, desc=label, disable=not progress))]


def q_values(policy: Policy, ground: Ground, take: Take, rewards: Rewards, gamma: float) -> dict[str, float]:
    """What the Q values tell of one take: the gaps on the performer's lexemes, the rest on the policy's own."""
    _, on_data = walk(policy, ground, take, teacher=True)
    lexemes, scores = walk(policy, ground, take)
    q = taken(scores, lexemes[1:])
    realised = return_to_go(taken(every_reward(rewards, take, lexemes), lexemes[1:]), gamma)
    nll, gap = conservative_gaps(on_data, take.lexemes[1:], ground.allowed(take)[1:])
    return {"nll": nll, "gap": gap, "calibration": float(q[0] - realised[0]), "spearman": rank_correlation(q, realised)}


def columns(rows: Sequence[dict[str, float]]) -> dict[str, Array]:
    """Each key's values, one a recording."""
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def compared(rows: dict[str, dict[str, Array]], sizes: Sequence[int]) -> dict[str, Any]:
    """Intervals of all rows and of the paired differences; sizes: blocks of each recording (see `Column`)."""
    out: dict[str, Any] = {"rows": {name: {} for name in rows}, "differences": {}}
    for by_blocks in (True, False):
        own = {name: {key: row[key] for key, column in COLUMNS.items() if column.by_blocks == by_blocks}
               for name, row in rows.items()}
        part = table(own, PAIRS, sizes if by_blocks else [1] * len(sizes))
        for kind, named in part.items():
            for name, values in named.items():
                out[kind].setdefault(name, {}).update(values)
    return out


# -------------------------------------------------------------------------------------------------------------- FGD

def networks(store: Store, work: Path, progress: bool = True) -> list[gesture_features.Features]:
    """Our own networks, trained on the store's training split once and kept in `work`; the papers' where it is."""
    found: list[gesture_features.Features] = []
    for frames in FGD_FRAMES:
        folder = work / f"fgd-{store.fingerprint[:12]}-{frames}"
        if not (folder / "gesture_features.json").is_file():
            gesture_features.save(gesture_features.train(
                store, folder, gesture_features.AutoencoderConfig(frames=frames), progress=progress), folder)
        found.append(gesture_features.as_features(gesture_features.load(folder)))
    place = os.environ.get("GESTICULATOR_DATA")
    if place and (Path(place) / FGD_FOLDER).is_dir():
        found.append(gesture_features.published(Path(place) / FGD_FOLDER))
    return found


def fgd_difference(first: Sequence[Array], second: Sequence[Array], real: Sequence[Array]) -> dict[str, float]:
    """FGD of the first clips' features [n, E] less that of the second's, clips redrawn together; NaN for one clip.

    The interval is the basic bootstrap's, as in `eval.metrics.fgd.measure`, for the same reason.
    """
    kept = np.flatnonzero([min(map(len, clips)) > 0 for clips in zip(first, second, real, strict=True)])

    def apart(chosen: Lexemes) -> float:
        one, other, theirs = (np.concatenate([clips[k] for k in chosen]) for clips in (first, second, real))
        return fgd.distance(one, theirs) - fgd.distance(other, theirs)

    if len(kept) < 2:
        return {**dict.fromkeys(("mean", "low", "high"), float("nan")), "clips": len(kept)}
    got, rng = apart(kept), np.random.default_rng(SEED)
    low, high = np.percentile([apart(rng.choice(kept, len(kept))) for _ in range(fgd.DRAWS)], [2.5, 97.5])
    return {"mean": got, "low": 2 * got - float(high), "high": 2 * got - float(low), "clips": len(kept)}


def fgd_table(motions: dict[str, list[Motion]], real: list[Motion], by: Sequence[gesture_features.Features]
              ) -> dict[str, Any]:
    """For each network the figures of all rows and the paired differences."""
    out: dict[str, Any] = {}
    for one in by:
        theirs = gesture_features.pooled(real, one)
        ours = {name: gesture_features.pooled(own, one) for name, own in motions.items()}
        out[f"{one.name}, {one.frames} at {one.fps:g} fps"] = {
            "rows": {name: fgd.measure(own, theirs, one, paired=True).to_dict() for name, own in ours.items()},
            "differences": {f"{a} - {b}": fgd_difference(ours[a], ours[b], theirs) for a, b in PAIRS}}
    return out


# -------------------------------------------------------------------------------------------------------- the table

def rows_of(bundle: bundles.Bundle, lstm: LexemeInterpreter, cql: LexemeInterpreter) -> dict[str, Policy]:
    """The policies that choose by scores, as the bundle would have them choose."""
    told, size = bundle.config.selection, len(bundle.lexicon.vectors)
    top = told.top or None
    return {"lstm": Policy(lstm, told.temperature, top), "lstm arg max": Policy(lstm),
            "statistical": Policy(bundle.statistical(), told.temperature, top),
            "cql": Policy(cql, told.q_temperature, top), "commonest": Policy(Commonest(bundle)),
            "random": Policy(Anything(size), 1.0)}


def choices(policies: dict[str, Policy], ground: Ground, rewards: Rewards, progress: bool) -> dict[str, Chosen]:
    """What every row of the table did."""
    truth = [take.lexemes for take in ground.takes]
    out = {"performer": Chosen(truth, truth)}
    for name, policy in tqdm(policies.items(), desc="lexemes", disable=not progress):
        out[name] = Chosen(*([walk(policy, ground, take, teacher)[0] for take in ground.takes]
                             for teacher in (False, True)))
    out["greedy"] = Chosen(*([greedy(rewards, ground, take, teacher) for take in ground.takes]
                             for teacher in (False, True)))
    return out


def policies(store: Store, bundle: bundles.Bundle, work: Path, by: Sequence[gesture_features.Features], *,
             limit: int | None = None, progress: bool = True) -> dict[str, Any]:
    """Every table, as plain values. by: what the Frechet distance is measured in; limit: test recordings at most.

    InputError for a bundle without a Q-network and both reward models, or without the lstm to compare with, and for a
    store without a test recording.
    """
    lstm, cql, reward, judge = bundle.interpreter, bundle.q_network, bundle.reward, bundle.reward_judge
    if lstm is None or cql is None or reward is None or judge is None:
        raise InputError("the bundle", "lacks the lstm, the Q-network or one of the two reward models",
                         "use one over a lexicon, with schedules.reward.steps and schedules.cql.steps")
    corpus = prepare(store, bundle.config, work, bundle.encoder, workers=os.cpu_count() or 1, progress=progress)
    labels = hinted_labels(bundle, corpus)
    ground = Ground.of(bundle, corpus, labels, limit)
    if not ground.takes:
        raise InputError(store.path, "has no test recording with a decision in it", "build the store again")
    table = reward_table(reward, bundle.lexicon, corpus)
    tables: dict[str, Rewards] = {"": table, "judge_": reward_table(judge, bundle.lexicon, corpus)}
    training = [labels[corpus.blocks_of(r)] for r in corpus.recordings("train")]
    by_scores = rows_of(bundle, lstm, cql)
    chosen = choices(by_scores, ground, tables[""], progress)
    system, recordings = Gesticulator(bundle), [store.load(corpus.names[take.recording]) for take in ground.takes]
    motions, rows = dict[str, list[Motion]](), dict[str, dict[str, Array]]()
    for name, own in chosen.items():
        motions[name] = perform(system, recordings, own.free, name, progress)
        rows[name] = columns([
            lexeme_values(own, k, ground, tables, lstm, training)
            | motion_values(measure(motion, recording.speech), motion, recording.motion, seed=k)
            for k, (motion, recording) in enumerate(zip(motions[name], recordings, strict=True))])
    gamma = cql.config.gamma
    taught = taught_reward(table, corpus, bundle.config.episodes.baseline)
    q = columns([q_values(by_scores["cql"], ground, take, taught, gamma) for take in ground.takes])
    return {"store": {"name": store.corpus, "fingerprint": store.fingerprint, "test_recordings": len(recordings),
                      "decisions": sum(len(take.blocks) - 1 for take in ground.takes)},
            "settings": {"episode": EPISODE, "rare": RARE, "gamma": gamma, "seed": SEED,
                         "temperatures": {name: policy.temperature for name, policy in by_scores.items()}},
            **compared(rows, [len(take.blocks) - 1 for take in ground.takes]),
            "q_network": {key: interval(values).to_dict() for key, values in q.items()},
            "fgd": fgd_table(motions, [recording.motion for recording in recordings], by)}


def _cell(value: dict[str, float], digits: int) -> str:
    return f"{value['mean']:.{digits}f} [{value['low']:.{digits}f}, {value['high']:.{digits}f}]"


def _figure(row: dict[str, Any]) -> str:
    """A cell of the FGD table: a difference, or a figure of `fgd`, starred when its windows are too few."""
    if "distance" not in row:
        return _cell(row, 2)
    return _cell({**row["interval"], "mean": row["distance"]}, 2) + ("*" if row["reason"] else "")


def markdown(result: dict[str, Any]) -> str:
    """The tables for a reader."""
    told = result["store"]
    lines = [f"Test split: {told['test_recordings']} recordings, {told['decisions']} decisions. Means with bootstrap "
             "95 % intervals over recordings; differences are paired.", ""]
    for part in dict.fromkeys(column.part for column in COLUMNS.values()):
        own = {key: column for key, column in COLUMNS.items() if column.part == part}
        lines += [f"| {part} | " + " | ".join(column.title for column in own.values()) + " |",
                  "|---" * (len(own) + 1) + "|"]
        lines += [f"| {name} | " + " | ".join(_cell(row[key], column.digits) for key, column in own.items()) + " |"
                  for name, row in (*result["rows"].items(), *result["differences"].items())]
        lines.append("")
    if result["fgd"]:
        lines += ["| FGD | " + " | ".join(result["fgd"]) + " |", "|---" * (len(result["fgd"]) + 1) + "|"]
        for kind in ("rows", "differences"):
            for name in next(iter(result["fgd"].values()))[kind]:
                lines.append(f"| {name} | " + " | ".join(_figure(own[kind][name]) for own in result["fgd"].values())
                             + " |")
        lines += ["", "\\* fewer windows than the network's features call for (see `eval.metrics.fgd`).", ""]
    lines += ["| cql | mean |", "|---|---|"]
    lines += [f"| {title} | {_cell(result['q_network'][key], 3)} |" for key, title in Q_COLUMNS.items()]
    return "\n".join(lines) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser("eval.policies", description="Lexeme interpreters judged as policies.")
    p.add_argument("--data", required=True, metavar="STORE")
    p.add_argument("--work", required=True, metavar="DIR", help="where blocks and the networks of FGD are kept")
    p.add_argument("--bundle", metavar="DIR", help="default: the shipped one")
    p.add_argument("--out", default="docs/results/policies.json", metavar="FILE.json",
                   help="a .md is written beside it")
    p.add_argument("--limit", type=int, metavar="N", help="the first N test recordings only")
    arguments = p.parse_args(argv)
    with one_line_errors("eval.policies"):
        torch.set_num_threads(1)
        if arguments.limit is not None and arguments.limit < 1:
            raise InputError(f"--limit {arguments.limit}", "leaves no recording", "choose 1 or more")
        store, work = Store.open(arguments.data), Path(arguments.work)
        work.mkdir(parents=True, exist_ok=True)
        bundle = bundles.load(arguments.bundle or bundles.SHIPPED)
        result = policies(store, bundle, work, networks(store, work), limit=arguments.limit)
        publish(result, markdown(result), arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())

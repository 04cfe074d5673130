"""A reward trained and judged on motion as it is played: does it know a person from a shuffle?

The published reward (RACER Eq. 6 to 8) tells a window of motion from the windows of other moments. It never sees motion
that a policy makes, so nothing in it speaks against lexemes drawn at random, and a motion of no character at all suits
every sound a little. `train` can add what it lacks: rivals that other policies play to the same sound, as negatives of
the performer's lexemes played by the same generator, and speeds (`RewardConfig.speeds`).

That reward says little of motion as policies are taught on it, which the lexicon decodes: so in the form "both" half of
the windows are decoded (`eval.runner.decoded_windows`).

Two ensembles of other recordings, sizes and seeds share nothing. A score is the mean cosine of the windows of a clip.

What fools it: a reward that is taught to refuse a generator's look would refuse every policy. So its positives are
generated, too, and only lexemes differ; the captured motion is shown and not claimed.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file, save
from torch import Tensor

from data_module.files import write_bytes
from data_module.layers import freeze
from data_module.store import Store
from data_module.types import Array
from eval import stats
from eval.metrics.ranking import retrieval
from eval.renderings import held_out_voices
from eval.runner.decoded_windows import DecodedWindows, Decoder
from eval.runner.played import MAJORITY, PERFORMER, RANDOM, REPLAYED, PlayedVoice, VoicePlayer
from eval.stats import Interval
from gesticulator.bundle.config import FitSettings, digest
from gesticulator.training import fit as fitting
from gesticulator.training.stages.reward import groups
from interpreters.reward import RewardEnsemble
from interpreters.settings import RewardConfig

_TOGETHER = 8
"""Windows of one voice in a batch."""
_DECODED = 0.5
"""Share of the batches that are decoded windows, where there are any."""
RIVALS = (RANDOM, MAJORITY, "statistical", "lstm")
"""What a reward is trained against."""
SIZES = (RewardConfig(width=64, projection=48, rivals=3, members=2, shortest=4),
         RewardConfig(width=80, projection=32, kernel=2, dilations=(1, 2, 3), rivals=3, members=2, shortest=4))
"""Of the two ensembles."""
ENSEMBLES = ("first", "second")
BOTH = "both"
RIVALLED = ("played", BOTH)
"""Forms that are trained against rivals."""
FORMS = ("published", "speeds", *RIVALLED)


@dataclass(frozen=True)
class Amounts:
    """What an ensemble is trained on by default: recordings and seconds of each, models and steps of each."""

    learn: int
    learn_seconds: float
    members: int
    steps: int


def arguments(p: argparse.ArgumentParser, default: Amounts) -> None:
    """What `learned` and `judged` read, and how ensembles are trained."""
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    p.add_argument("--learn", type=int, default=default.learn,
                   help=f"recordings of the training split (default {default.learn})")
    p.add_argument("--learn-seconds", type=float, default=default.learn_seconds,
                   help=f"of each training recording (default {default.learn_seconds:g})")
    p.add_argument("--split", default="test", choices=("val", "test"), help="judged on (val: to choose settings by)")
    p.add_argument("--limit", type=int, default=60, help="recordings of that split (default 60)")
    p.add_argument("--seconds", type=float, default=25.0, help="of each judged recording (default 25)")
    p.add_argument("--steps", type=int, default=default.steps,
                   help=f"training steps of each reward model (default {default.steps})")
    p.add_argument("--members", type=int, default=default.members,
                   help=f"reward models of an ensemble (default {default.members})")
    p.add_argument("--work", metavar="DIR",
                   help="work folder, in which motion and ensembles are kept (default: STORE.work)")
    p.add_argument("--quiet", action="store_true")
    p.add_argument("--out")


def learned(player: VoicePlayer, store: Store, a: argparse.Namespace) -> list[PlayedVoice]:
    """The training voices, as the performer's lexemes and the rivals play them."""
    voices = held_out_voices(store, a.learn, player.joints, "train", a.learn_seconds, spread=True)
    return player.voices(voices, (REPLAYED, *RIVALS), progress=not a.quiet)


def judged(player: VoicePlayer, store: Store, a: argparse.Namespace, more: Sequence[str],
           others: Mapping[str, Any] | None = None) -> list[PlayedVoice]:
    """The voices that are judged, played by more policies and by other systems, too (see `VoicePlayer.voices`)."""
    voices = held_out_voices(store, a.limit, player.joints, a.split, a.seconds, spread=True)
    return player.voices(voices, (REPLAYED, *RIVALS, *more), others, not a.quiet)


@dataclass(frozen=True)
class PlayedWindows:
    """Windows of voices, as batches for `RewardModel.losses`. motions: the kinds that are positives; rivals: those that
    are negatives on the same sound, `config.rivals` drawn for each window; none without."""

    voices: Sequence[PlayedVoice]
    config: RewardConfig
    motions: Sequence[str]
    rivals: Sequence[str] = ()

    def sample(self, rng: np.random.Generator, count: int) -> fitting.Batch:
        """A batch of `count` windows, eight of each voice; all of one kind of motion."""
        kind = str(rng.choice(list(self.motions)))
        among = [voice for voice in self.voices if kind in voice.motions and len(voice.silent) >= 2]
        longest = self.config.longest
        rows: list[tuple[int, NDArray[np.int64], NDArray[np.float32]]] = []
        for place in rng.choice(len(among), size=-(-count // _TOGETHER), replace=len(among) < -(-count // _TOGETHER)):
            total = len(among[place].silent)
            for _ in range(_TOGETHER):
                length = min(int(rng.integers(self.config.shortest, longest + 1)), total)
                start = int(rng.integers(total - length + 1))
                at = np.full(longest, start, np.int64)
                at[-length:] = np.arange(start, start + length)
                rows.append((int(place), at, (np.arange(longest) >= longest - length).astype(np.float32)))
        return self._batch(among, kind, rows[:count], rng)

    def _batch(self, among: Sequence[PlayedVoice], kind: str,
               rows: Sequence[tuple[int, NDArray[np.int64], NDArray[np.float32]]], rng: np.random.Generator
               ) -> fitting.Batch:
        places, valid = np.array([row[0] for row in rows]), np.stack([row[2] for row in rows])
        # Blocks of different voices must be no neighbours for `groups`.
        numbers = np.stack([row[1] for row in rows]) + 100_000 * places[:, None]
        silent = np.stack([among[place].silent[at] for place, at, _ in rows])
        batch = {"motion": torch.stack([among[place].motions[kind][at] for place, at, _ in rows]),
                 "audio": torch.stack([among[place].audio[at] for place, at, _ in rows]),
                 "log_duration": torch.stack([among[place].log_duration[at] for place, at, _ in rows]),
                 "valid": torch.as_tensor(valid), "group": torch.as_tensor(groups(numbers, valid, silent)),
                 "rivalled": torch.zeros(len(rows))}
        if self.rivals and kind == REPLAYED and self.config.rivals:
            batch["rivalled"] = torch.ones(len(rows))
            batch["rival"] = torch.stack([torch.stack([
                among[place].motions[str(name)][at] for name in rng.choice(list(self.rivals), self.config.rivals)])
                for place, at, _ in rows])
        return batch


def _sized(config: RewardConfig, one: PlayedVoice) -> RewardEnsemble:
    """An untrained ensemble for voices like this one."""
    return RewardEnsemble(config, one.audio.shape[1], one.motions[PERFORMER].shape[2], one.audio.shape[2])


def train(windows: PlayedWindows, settings: FitSettings, seed: int, progress: bool = True,
          decoded: DecodedWindows | None = None) -> RewardEnsemble:
    """An ensemble of these settings, trained on the windows and frozen; decoded: half of the batches are of these."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = _sized(windows.config, windows.voices[0])

    def sample(rng: np.random.Generator) -> fitting.Batch:
        source = decoded if decoded is not None and rng.random() < _DECODED else windows
        return source.sample(rng, settings.batch)

    with tempfile.TemporaryDirectory() as scratch:
        fitting.fit(f"reward {seed}", model, fitting.Task(sample, before_step=model.before_step), settings,
                    Path(scratch), fitting.FitOptions(seed=seed, checkpoint_seconds=float("inf"), progress=progress))
    freeze(model)
    return model


def _config(form: str, number: int, members: int) -> RewardConfig:
    """Of the ensemble of this number in one of `FORMS`."""
    return replace(SIZES[number], speeds=form != "published", members=members,
                   rivals=SIZES[number].rivals if form in RIVALLED else 0)


def trained(form: str, number: int, learn: Sequence[PlayedVoice], how: Amounts, decoder: Decoder | None = None,
            progress: bool = True) -> RewardEnsemble:
    """The ensemble of this number, in one of `FORMS`, on its half of the recordings. decoder: for the form "both",
    which trains as many steps again."""
    config, half = _config(form, number, how.members), learn[number::2]
    windows = PlayedWindows(half, config, (PERFORMER, REPLAYED), RIVALS if form in RIVALLED else ())
    decoded = None
    if form == BOTH:
        assert decoder is not None
        names = {voice.name for voice in half}
        decoded = DecodedWindows(decoder, [r for r, name in enumerate(decoder.corpus.names) if name in names], config)
    steps = how.steps * how.members * (1 if decoded is None else 2)
    settings = FitSettings(steps=steps, batch=64, rate=1e-3, schedule="cosine", weight_decay=0.05)
    return train(windows, settings, 1 + number, progress, decoded)


def kept(form: str, number: int, learn: Sequence[PlayedVoice], work: Path, a: argparse.Namespace,
         decoder: Decoder | None = None) -> RewardEnsemble:
    """The ensemble of this number, trained now or read from the work folder (see `trained`)."""
    made_of = [digest([voice.name for voice in learn], [float(voice.motions[kind].double().sum()) for voice in learn
                                                        for kind in (PERFORMER, REPLAYED, *RIVALS)])]
    if form == BOTH:
        assert decoder is not None
        made_of.append(digest(decoder.labels.tolist(), decoder.drawn.tolist(), float(decoder.context.added.sum())))
    file = work / f"ensemble-{digest(made_of, _config(form, number, a.members), number, a.steps)}.safetensors"
    if not file.is_file():
        how = Amounts(a.learn, a.learn_seconds, a.members, a.steps)
        write_bytes(file, save(trained(form, number, learn, how, decoder, not a.quiet).state_dict()))
    with torch.random.fork_rng():
        model = _sized(_config(form, number, a.members), learn[0])
    model.load_state_dict(load_file(file))
    freeze(model)
    return model


# ------------------------------------------------------------------------------------------------------- what it says

def whole_windows(voice: PlayedVoice, length: int) -> NDArray[np.int64]:
    """[n, W] the windows of a voice that are not silent throughout, one block apart."""
    count = len(voice.silent) - length + 1
    if count < 1:
        return np.zeros((0, length), np.int64)
    at = np.arange(count)[:, None] + np.arange(length)
    return at[~voice.silent[at].all(axis=1)]


@torch.no_grad()
def vectors(model: RewardEnsemble, voice: PlayedVoice, kind: str, at: NDArray[np.int64]) -> tuple[Tensor, Tensor]:
    """[members, n, P] motion and audio vectors of windows [n, W]."""
    valid, times = torch.ones(at.shape), voice.log_duration[at]
    motion = [one.embed_motion(one.block_motion(voice.motions[kind][at], times), valid) for one in model.models]
    heard = [one.embed_audio(one.block_audio(voice.audio[at]), valid) for one in model.models]
    return torch.stack(motion), torch.stack(heard)


@dataclass(frozen=True)
class PlayedScores:
    """Mean reward of each voice [voices] by kind of motion. whole: the cosine; common: the part that any sound of the
    corpus would give, m . mean u; own: the rest, which only the sound of the moment gives."""

    whole: dict[str, Array]
    common: dict[str, Array]

    def own(self, kind: str) -> Array:
        """[voices]."""
        return self.whole[kind] - self.common[kind]


def scored(model: RewardEnsemble, voices: Sequence[PlayedVoice], kinds: Sequence[str]) -> PlayedScores:
    """Every kind of motion on every voice."""
    length = model.config.window
    each = [whole_windows(voice, length) for voice in voices]
    embedded = [{kind: vectors(model, voice, kind, at) for kind in kinds if len(at)}
                for voice, at in zip(voices, each, strict=True)]
    centre = torch.cat([next(iter(own.values()))[1] for own in embedded if own], dim=1).mean(dim=1, keepdim=True)

    def mean(value: Tensor) -> float:
        return float(value.sum(-1).double().mean())

    nan = float("nan")
    return PlayedScores({kind: np.array([mean(own[kind][0] * own[kind][1]) if own else nan for own in embedded])
                   for kind in kinds},
                  {kind: np.array([mean(own[kind][0] * centre) if own else nan for own in embedded]) for kind in kinds})


def found(model: RewardEnsemble, voices: Sequence[PlayedVoice], kind: str) -> dict[str, Interval]:
    """Retrieval among the windows of the same recording, one window apart (see `eval.metrics.ranking.retrieval`), with
    times: how many times chance the mean of both ways at 1 is, over recordings."""
    length = model.config.window
    rows: dict[str, list[float]] = {}
    for voice in voices:
        at = whole_windows(voice, length)
        at = at[np.unique(at[:, 0] // length, return_index=True)[1]] if len(at) else at
        if len(at) < 3:
            continue
        motion, heard = vectors(model, voice, kind, at)
        pairs = torch.einsum("knp,kmp->nm", motion, heard).double().numpy() / len(motion)
        hits = retrieval(pairs, np.ones(pairs.shape, dtype=bool))
        for name, own in hits.items():
            rows.setdefault(name, []).append(float(np.mean(own)))
        hit = 0.5 * (rows["motion_r1"][-1] + rows["audio_r1"][-1])
        rows.setdefault("times", []).append(hit / rows["chance_r1"][-1])
    return {name: stats.mean_interval(values) for name, values in rows.items()}


def margins(scores: PlayedScores, kinds: Sequence[str], group: Sequence[str], first: str = REPLAYED
            ) -> dict[str, Interval]:
    """The performer's reward less that of each kind, paired over voices."""
    return {kind: stats.paired(scores.whole[first], scores.whole[kind], groups=list(group)) for kind in kinds}

"""A small performance made by rule, for the tests of what is written and shown; the example; the shipped system."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import soundfile

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, BeatFlag, Blocks, Motion, Samples, Skeleton, Speech, Word
from gesticulator.export import writers
from gesticulator.export.clip import ClipLayout
from gesticulator.gesticulator import Gesticulator
from gesticulator.options import InferenceOptions
from gesticulator.performance import Origin, Performance, plan_of
from gesticulator.plan.plan import Block, BlockDraw, LexemeChoice
from gesticulator.sampling.loop import BlockMotion

RATE = 16000
EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "speech.flac"
NONE = np.empty((1, 0), np.float32)


@lru_cache(maxsize=1)
def system() -> Gesticulator:
    """The shipped system, one for all tests that change nothing in it."""
    return Gesticulator.from_pretrained()


def example(seconds: float | None = None) -> Speech:
    """The beginning of the example recording, or all of it."""
    samples, rate = soundfile.read(EXAMPLE, frames=-1 if seconds is None else round(seconds * RATE), dtype="float32")
    return Speech(samples, rate)


def babble(seconds: float, seed: int = 0) -> Samples:
    """Syllables of a buzz over faint noise at `RATE`, with a pause in every four seconds."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    buzz = np.sign(np.sin(2 * np.pi * 130 * time)) * np.clip(np.sin(2 * np.pi * 3.1 * time), 0, 1) ** 2
    return (0.2 * buzz * (time % 4.0 <= 3.0) + 0.001 * rng.normal(size=len(time))).astype(np.float32)


def turned(skeleton: Skeleton, frames: int, fps: float = 60.0, **joints: Array) -> Motion:
    """A motion at rest but for some joints; joints: their quaternions [T, 4] or exponential maps [T, 3] or [3]."""
    turns = np.zeros((frames, len(skeleton), 4))
    turns[..., 0] = 1.0
    for name, turn in joints.items():
        turns[:, skeleton.index(name)] = turn if turn.shape[-1] == 4 else rotation.from_exponential_map(turn)
    return Motion(skeleton, turns, np.zeros((frames, 3)), fps)


def write_example(path: Path, seconds: float, subtype: str | None = None) -> Path:
    """Write its first seconds into a file of this name; subtype: of the samples, by soundfile."""
    speech = example(seconds)
    soundfile.write(path, speech.samples, speech.sample_rate, subtype=subtype)
    return path


def perform(seconds: float = 2.5, fps: float = 25.0, seed: int = 3, root_height: float = 0.0,
            skeleton: Skeleton = CHARACTER) -> Performance:
    """Small smooth motion on a tone with a silent middle, cut into blocks at random; written with every frame."""
    rng = np.random.default_rng(seed)
    count = round(seconds * fps)
    waves = rng.normal(size=(2, len(skeleton), 3)) * 0.4
    phase = np.linspace(0, 2 * np.pi, count)[:, None, None]
    turns = rotation.from_exponential_map(waves[0] * np.sin(phase) + waves[1] * np.cos(phase))
    motion = Motion(skeleton, rotation.continuous(turns), np.tile([0.0, root_height, 0.0], (count, 1)), fps)
    time = np.arange(round(seconds * RATE)) / RATE
    tone = 0.4 * np.sin(2 * np.pi * 220 * time) * (np.abs(time - seconds / 2) > seconds / 8)
    speech = Speech(tone.astype(np.float32), RATE, (Word("</script><b>", 0.1, 0.4), Word("zwei", 0.5, 0.9)))
    inner = np.cumsum(rng.uniform(0.2, 0.5, 200))
    edges = np.concatenate([[0.0], inner[inner < seconds - 0.1], [speech.duration]])
    n = len(edges) - 1
    flags = rng.choice([1, 2, 3], n).astype(np.int8)
    flags[-1] = BeatFlag.BOUNDARY
    best = np.stack([rng.choice(64, 5, replace=False) for _ in range(n)])
    scores = np.sort(rng.uniform(size=(n, 5)), axis=1)[:, ::-1].copy()
    cut = Blocks(edges, flags, rng.random(n) < 0.3, 8, 30.0)
    blocks = [BlockMotion(_block(cut, i, best[i].tolist(), scores[i].tolist()), int(best[i, 0]), NONE,
                          NONE[0]) for i in range(n)]
    settings = {"seed": 0, "variation": 0, "speaker": "", "interpreter": ""}
    plan = plan_of(speech, cut, blocks, Origin(InferenceOptions(), {}, settings, "log-probability"))
    return Performance(motion, speech, cut, best[:, 0].copy(), np.empty((n, 0), np.float32), plan,
                       clip=ClipLayout(keys=0.0))


def _block(cut: Blocks, i: int, best: list[int], scores: list[float]) -> Block:
    flag = BeatFlag(int(cut.flags[i])).name.lower()
    return Block(float(cut.edges[i]), float(cut.edges[i + 1]), best[0], bool(cut.silent[i]), BlockDraw(0, 0, i), flag,
                 alternatives=tuple(LexemeChoice(n, "", score) for n, score in zip(best, scores, strict=True)))


def write(path: Path, performance: Performance) -> Path:
    """Write the scene of a performance into a folder that is there."""
    return writers.write(path, performance.scene())

"""The activity gate, the planner of gesture units, and the style codes of those units.

The gate decides whether a block is gestured (RG 8, third limitation). The planner is trained on the phases of gesture
measured on the corpus' motion. The style codes (RG 6.3) are measured on the units too; `unit_style_task` trains their
interpreter.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.motion.phases import HandPhases, Phase, hand_places, phases_of, runs
from data_module.types import Array
from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import representation_of
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage
from gesticulator.training.stages.corpus import BLOCKS, Corpus
from gesticulator.training.stages.lexicon import LABELS, model_sizes
from gesticulator.training.stages.speech import CORPUS
from gesticulator.training.stages.windows import Windows, sequences, task_of, validation
from interpreters.gate import ActivityGate
from interpreters.planner import UnitPlanner, UnitStyleInterpreter
from interpreters.planner_run import APEXES, CODE, HANDS, PHASES, SIZES

RATE = 30.0
"""Frames per second at which phases are measured."""
_SMALL, _LARGE = 0.15, 0.3
"""Bounds of a medium stroke, metres."""


def block_units(corpus: Corpus, config: Config) -> NDArray[np.int64]:
    """[N, 4] the decision (of `interpreters.planner`) measured on each block of a corpus."""
    out = [units_of(hands_of(corpus, config, recording), edges_of(corpus, recording))
           for recording in range(len(corpus.names))]
    return np.concatenate(out) if out else np.zeros((0, 4), np.int64)


def edges_of(corpus: Corpus, recording: int) -> Array:
    """[M + 1] seconds of the edges of a recording's blocks."""
    return np.concatenate([[0.0], np.cumsum(corpus.durations[corpus.blocks_of(recording)])])


def hands_of(corpus: Corpus, config: Config, recording: int) -> Array:
    """[T, 2, 3] places of the left and the right hand over the hips, metres, at `RATE`."""
    rows = corpus.motion[torch.as_tensor(corpus.blocks_of(recording))].double().numpy()
    edges = edges_of(corpus, recording)
    poses = corpus.statistics.denormalise(rows.reshape(-1, rows.shape[-1]), int(corpus.speaker_of[recording]))
    motion = representation_of(config).motion(poses, config.rhythm.fps)
    frames = rows.shape[1]
    shares = np.arange(1, frames + 1) / frames
    times = (edges[:-1, None] + np.diff(edges)[:, None] * shares).ravel()
    return hand_places(motion, RATE, times, max(2, int(edges[-1] * RATE)))


def units_of(hands: Array, edges: Array) -> NDArray[np.int64]:
    """[M, 4] the decision measured on each of M blocks with edges [M + 1] seconds, from the places [T, 2, 3] of the
    left and the right hand at `RATE`: the phase of the hand that moves more."""
    hand_phases = [phases_of(hands[:, side], RATE) for side in (0, 1)]
    # Only compared between hands, so the unit (metres per frame) does not matter.
    speeds = np.linalg.norm(np.gradient(hands, axis=0), axis=-1)
    frames = np.minimum(np.round(edges * RATE).astype(int), len(hands))
    out = np.zeros((len(edges) - 1, 4), dtype=np.int64)
    for k, (first, last) in enumerate(zip(frames[:-1], frames[1:], strict=True)):
        # A block shorter than a frame still shows one.
        last = max(last, first + 1)
        phases = [_phase(side.labels[first:last]) for side in hand_phases]
        # A block gestures if either hand does; the faster acting hand gives phase and size.
        acting = [phase != Phase.REST for phase in phases]
        if not any(acting):
            continue
        leading = max((0, 1), key=lambda side: (acting[side], speeds[first:last, side].mean()))
        stroke = _stroke(hand_phases[leading], phases[leading], first, last)
        out[k] = phases[leading], HANDS.index(_name(acting)), *stroke
    return out


def _phase(labels: NDArray[np.int8]) -> int:
    """The most frequent phase of a block, the stroke where its apex region takes a third of it."""
    counts = np.bincount(labels, minlength=len(Phase))
    return int(Phase.STROKE) if 3 * counts[Phase.STROKE] >= counts.sum() else int(counts.argmax())


def _name(acting: Sequence[bool]) -> str:
    return "both" if all(acting) else "left" if acting[0] else "right"


def _stroke(hand: HandPhases, phase: int, first: int, last: int) -> tuple[int, int]:
    """Size and time of the stroke that a block prepares or makes."""
    if phase not in (Phase.PREPARATION, Phase.STROKE):
        return 0, 0
    coming = next((stroke for stroke in hand.strokes if stroke.apex >= first), None)
    if coming is None:
        return 0, 0
    size = "small" if coming.size < _SMALL else "large" if coming.size > _LARGE else "medium"
    apex = "now" if coming.apex < last else "next" if coming.apex < 2 * last - first else "later"
    return SIZES.index(size), APEXES.index(apex)


UNITS: Node[NDArray[np.int64]] = Node(
    "units", settings=(), needs=lambda config: (BLOCKS,), make=lambda run: block_units(run.get(BLOCKS), run.config))
"""[N, 4] the decisions measured on the blocks."""


def _plain_windows(run: Run) -> tuple[Windows, list[fitting.Batch]]:
    """Windows of the training and of the validation split, without words and controls."""
    corpus, labelled, length = run.get(CORPUS), run.get(LABELS), run.config.window
    return (Windows(corpus, sequences(corpus, labelled.labels, "train", labelled.style_numbers), length),
            validation(corpus, labelled.labels, length))


def _planner_task(run: Run, model: UnitPlanner) -> fitting.Task:
    corpus, labelled, units = run.get(CORPUS), run.get(LABELS), run.get(UNITS)
    train = corpus.select("train")
    model.count(labelled.hinted[train], units[train])

    def validate(batches: list[fitting.Batch]) -> Figures:
        each = [model.losses(batch) for batch in batches]
        means = {name: sum(float(losses[name]) for losses in each) / len(each) for name in each[0]}
        return {"nll": sum(means.values()), **means}

    return task_of(run, *_plain_windows(run), validate, {"units": torch.as_tensor(units)}, "nll")


PLANNER: Stage[UnitPlanner] = Stage(
    "planner", settings=("planner", "window"), needs=lambda config: (CORPUS, LABELS, UNITS), schedule="planner",
    wanted=lambda config: config.schedules.planner.steps > 0, part="planner",
    build=lambda run: models.build("planner", model_sizes(run)), train=_planner_task)


def _gate_task(run: Run, model: ActivityGate) -> fitting.Task:
    active = torch.as_tensor(run.get(LABELS).active.astype(np.float32))

    def validate(batches: list[fitting.Batch]) -> Figures:
        return {"nll": sum(float(model.losses(b)["activity"]) for b in batches) / len(batches)}

    return task_of(run, *_plain_windows(run), validate, {"active": active}, "nll")


GATE: Stage[ActivityGate] = Stage(
    "gate", settings=("gate", "window"), needs=lambda config: (CORPUS, LABELS), schedule="gate",
    wanted=lambda config: config.schedules.gate.steps > 0, part="gate",
    build=lambda run: models.build("gate", model_sizes(run)), train=_gate_task)


_LONGEST_UNIT = 14
"""Blocks of a unit, at most; a longer one is cut, since the style of a talk changes within seconds."""
_LOG_FLOOR = 0.02
"""Added to speeds (m/s) and ranges (m) before the logarithm, which a still hand would send to minus infinity."""
_LARGEST_CODE = 2.5
"""Bound on a code, standard deviations: outliers of captured motion are clipped."""
_FEWEST_UNITS = 20
"""Units from which on a speaker's own mean and deviation are used."""


def spans(acting: NDArray[np.bool_], longest: int = _LONGEST_UNIT) -> list[tuple[int, int]]:
    """(first, last) blocks of the units in acting [M], last excluded; long runs are cut into equal parts."""
    out = []
    for first, last in runs(acting):
        # Ceiling division: the fewest parts of at most `longest` blocks.
        parts = -(-(last - first) // longest)
        cuts = np.linspace(first, last, parts + 1).round().astype(int)
        out += list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))
    return out


def style_of(hands: Array) -> Array:
    """[4] speed, range, height and reach (`interpreters.planner.CODE`) of hands [T, 2, 3] over the hips at `RATE`,
    logarithms of m/s and m, and m."""
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=-1).mean() * RATE if len(hands) > 1 else 0.0
    # The larger of the two hands: one-handed gestures must not count as half.
    spread = np.sqrt(hands.var(axis=0).sum(axis=-1)).max()
    reach = np.linalg.norm(hands[..., [0, 2]], axis=-1)
    height = hands[..., 1].max(axis=1).mean()
    return np.array([np.log(speed + _LOG_FLOOR), np.log(spread + _LOG_FLOOR), height, reach.mean()])


def unit_codes(run: Run) -> NDArray[np.float32]:
    """[N, d_z] the style code of each block's unit, standardised per speaker on the training split; 0 at rest."""
    corpus, units = run.get(BLOCKS), run.get(UNITS)
    acting = units[:, 0] != PHASES.index("rest")
    rows: list[tuple[int, NDArray[np.int64], Array]] = []
    for recording in range(len(corpus.names)):
        blocks = corpus.blocks_of(recording)
        hands, edges = hands_of(corpus, run.config, recording), edges_of(corpus, recording)
        for first, last in spans(acting[blocks]):
            begin = round(edges[first] * RATE)
            # At least two frames: a speed needs a difference.
            unit_hands = hands[begin:max(round(edges[last] * RATE), begin + 2)]
            if len(unit_hands):
                rows.append((recording, blocks[first:last], style_of(unit_hands)))
    codes = np.zeros((len(units), len(CODE)), dtype=np.float32)
    if not rows:
        return codes
    values = np.stack([row[2] for row in rows])
    who = corpus.speaker_of[[row[0] for row in rows]]
    train = np.array([corpus.splits[row[0]] == "train" for row in rows])
    # Speakers with few units are standardised by all speakers together.
    everyone = values[train] if train.any() else values
    for speaker in np.unique(who):
        known = values[train & (who == speaker)]
        known = known if len(known) >= _FEWEST_UNITS else everyone
        deviation = np.maximum(known.std(axis=0), 1e-3)
        values[who == speaker] = (values[who == speaker] - known.mean(axis=0)) / deviation
    for (_, blocks, _), code in zip(rows, np.clip(values, -_LARGEST_CODE, _LARGEST_CODE), strict=True):
        codes[blocks] = code
    return codes


UNIT_CODES: Node[NDArray[np.float32]] = Node(
    "unit_codes", settings=(), needs=lambda config: (BLOCKS, UNITS), make=unit_codes)
"""[N, d_z] the style codes of the blocks' units."""


def unit_style_task(run: Run, model: UnitStyleInterpreter) -> fitting.Task:
    """Train on the codes of the training split, then set the gain on those of the validation split."""
    acting = torch.as_tensor(run.get(UNITS)[:, 0] != PHASES.index("rest")).float()

    def validate(batches: list[fitting.Batch]) -> Figures:
        rows = []
        for batch in batches:
            there = (batch["valid"] * batch["acting"]) > 0
            rows.append((model.predict(batch["audio_low"], batch["speaker"])[0][there].cpu(),
                         batch["code"][there].cpu()))
        predicted, measured = (torch.cat(column) for column in zip(*rows, strict=True))
        model.calibrate(predicted, measured)
        return {"code_error": float((predicted - measured).pow(2).mean())}

    codes = {"code": torch.as_tensor(run.get(UNIT_CODES)), "acting": acting}
    return task_of(run, *_plain_windows(run), validate, codes, "code_error")

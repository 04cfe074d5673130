"""A performance: what can be asked of it, what it is, and how it is written to a file.

Nothing heavy is imported before it is needed, so that the command line checks its numbers against the same ranges
before numpy and torch are loaded.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

from data_module.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_module.controls import Controls, Curve
    from data_module.types import Array, Blocks, Motion, Speech
    from gesticulator.characters.mapping import RigMapping
    from gesticulator.characters.retarget import CharacterMotion
    from gesticulator.characters.rig import Character
    from gesticulator.plan.plan import GestureCue, GesturePlan, LexemeName
    from interpreters.base import LexemeInterpreter

ENERGIES: Mapping[str, tuple[float, float]] = {"calm": (0.6, 0.6), "neutral": (1.0, 1.0), "lively": (1.5, 1.0)}
"""Energy -> what intensity and activity are multiplied by: calm is smaller gestures in six tenths of the phrases."""
HANDS = ("left", "right", "both")
"""What handedness may prefer."""
HandControl: TypeAlias = "float | str | os.PathLike[str] | Curve | None"

FPS = 60.0
"""Frames per second of a performance when not told: the models' 20 fps frames, interpolated."""
BEST = 5
"""How many candidates a block keeps."""

# The blocks must end where the sound ends; a cut on the frame grid may miss it by less than this.
_END_TOLERANCE = 0.05

WRITERS = {
    ".bml": "gesticulator.plan.bml:write_bml",
    ".bvh": "gesticulator.performance:write_bvh_file",
    ".csv": "gesticulator.export.table:write_csv",
    ".fbx": "gesticulator.export.fbx:write_fbx",
    ".g1.csv": "gesticulator.export.g1:write_g1",
    ".gif": "gesticulator.export.film:write_gif",
    ".glb": "gesticulator.export.glb:write_glb",
    ".html": "gesticulator.export.html:write_preview",
    ".json": "gesticulator.directing.record:write_plan",
    ".mp4": "gesticulator.export.film:write_film",
    ".npz": "gesticulator.export.smplx:write_smplx",
    ".parquet": "gesticulator.export.table:write_parquet",
    ".usda": "gesticulator.export.usd:write_usd",
    ".usdc": "gesticulator.export.usd:write_usd",
    ".vrma": "gesticulator.export.vrma:write_vrma",
    ".webm": "gesticulator.export.film:write_film",
}
"""Suffix -> module and name of writer(path, performance) -> path, imported when something is written. A new format is
one writer in `gesticulator.export` and one entry here."""
NEEDS = {
    ".gif": ("PIL", "Pillow", "video"),
    ".mp4": ("av", "PyAV", "video"),
    ".parquet": ("pyarrow", "pyarrow", "parquet"),
    ".usda": ("pxr", "usd-core", "usd"),
    ".usdc": ("pxr", "usd-core", "usd"),
    ".webm": ("av", "PyAV", "video"),
}
"""Suffix -> module that its writer imports, the package that has it, and our extra that installs it."""
UNITS = {"cm": 0.01, "m": 1.0}
"""Unit of length of a BVH file -> metres."""


@dataclass(frozen=True)
class Range:
    """The numbers that a setting takes: low to high, both included; whole: no fractions."""

    low: float
    high: float
    advice: str
    whole: bool = False

    def parse(self, name: str, text: str) -> float:
        """The number that a text gives; `InputError` with the name where it gives none or one out of range."""
        try:
            # Python reads 0_4 as 4, which nobody means here.
            number = math.nan if "_" in text else int(text) if self.whole else float(text)
        except ValueError:
            raise InputError(f"{name} {text[:40]}", f"is no {'whole ' if self.whole else ''}number",
                             f"choose {self.advice}") from None
        return self.check(name, number)

    def check(self, name: str, number: float) -> float:
        """The number itself; `InputError` with the name where it is out of range or no number at all."""
        if isinstance(number, bool) or not hasattr(number, "__index__" if self.whole else "__float__"):
            raise InputError(f"{name} {number!r}", f"is no {'whole ' if self.whole else ''}number",
                             f"choose {self.advice}")
        if not self.low <= number <= self.high:  # also NaN
            shown = f"{number:g}" if not abs(number) > 1e300 or math.isinf(number) else "of that size"
            raise InputError(f"{name} {shown}", "is out of range", f"choose {self.advice}")
        return number


RANGES = {
    "seed": Range(0, 2**64 - 1, "a whole number from 0", whole=True),
    "variation": Range(0, 2**32 - 1, "a whole number from 0", whole=True),
    # At 1000 the lexemes are already as good as equally likely.
    "temperature": Range(0, 1000, "0 (always the likeliest lexeme) to 1000"),
    "beta": Range(0, 20, "0 (the behaviour policy itself) to 20"),
    "activity": Range(0, 1, "0 (stillness) to 1 (never holds back)"),
    "fps": Range(1, 1000, "1 to 1000 frames per second"),
    # 64 dB bring the faintest speech that is listened for (-90 dBFS) to the usual level (-26 dBFS).
    "intensity": Range(0, 2, "0 (the hands hang) to 2 (largest)"),
    "gain": Range(-70, 70, "-70 to 70 decibels"),
    # Far above any machine's cores; beyond the system's limit on threads torch ends the process.
    "threads": Range(1, 256, "1 to 256 threads", whole=True),
}
"""What each number may be. "threads" belongs to the command, the others to `InferenceOptions`."""


@dataclass(frozen=True)
class InferenceOptions:
    """What is asked of a performance; what is None is the bundle's own choice. `InputError` for a value out of range.

    A hand control is "low", "mid" or "high" (quantiles of the training data), a number in its unit, a `Curve` over
    time, or the path of a CSV file with the columns time and value (RG 7.2.1).
    """

    speaker: str | None = None
    """Whose habits of moving: a performer of the bundle (`Gesticulator.speakers`), not a voice."""
    interpreter: str | LexemeInterpreter | None = None
    """What chooses the lexemes: a name of `Gesticulator.interpreters` ("lstm", "cql", "advantage", "statistical") or an
    object."""
    seed: int = 0
    """The same seed, bundle and speech give the same performance."""
    variation: int = 0
    """The same beats and lexemes, drawn in another manner; 0 is the seed's own."""
    temperature: float | None = None
    """How freely lexemes are sampled, 0 to 1000: 0 takes the likeliest, 1 samples from the interpreter's scores."""
    beta: float | None = None
    """Of the interpreter "advantage": how far lexemes are drawn to what the reward says they are worth, 0 to 20. 0
    gives exactly the lexemes of "lstm"; a lexeme of one standard deviation above the mean is e^beta times likelier."""
    activity: float | None = None
    """How much of the time of speech to gesture in, 0 (stillness) to 1 (all of it); bundles that know no rest by
    phrases (silence.rest=decay) take it as the threshold of their gate."""
    fps: float = FPS
    """Frames per second of the motion, 1 to 1000."""
    gain: float = 0.0
    """Decibels by which the recording is amplified first, -70 to 70; beyond full scale it is clipped."""
    hand_height: HandControl = None
    """Height of the right hand over the hips, metres."""
    hand_speed: HandControl = None
    """Mean speed of both hands, metres per second."""
    hand_radius: HandControl = None
    """Mean horizontal distance of both hands from the body's axis, metres."""
    controls: Controls | None = None
    """The three hand controls in one object, instead of them."""
    intensity: float = 1.0
    """How large gestures are, 0 (the hands hang) to 2; 1 as they are drawn
    (`gesticulator.directing.shaping`)."""
    mirror: bool = False
    """Exchange left and right."""
    energy: str = "neutral"
    """"calm", "neutral" or "lively": a named combination of intensity and activity, on top of them."""
    handedness: str | None = None
    """Which hand is preferred: "left", "right", or "both", where each takes part in the other's strokes."""
    hold_still: tuple[tuple[float, float], ...] = ()
    """Ranges of seconds, each from and to, in which the hands rest."""
    cues: tuple[GestureCue, ...] = ()
    """Gestures asked for at words or times."""
    plan: GesturePlan | None = None
    """Render this plan: what was drawn is replayed, what was edited is drawn anew. Seed, variation, speaker,
    interpreter and controls are the plan's."""
    legs: bool = False
    """Give her legs to stand on (54 joints): the weight shifts, the feet are planted (`gesticulator.body.stance`)."""
    seated: bool = False
    """Let her sit: with legs, they and the hips quite still."""

    def __post_init__(self) -> None:
        for name in ("seed", "variation", "temperature", "beta", "activity", "intensity", "fps", "gain"):
            value = getattr(self, name)
            if value is not None or name not in ("temperature", "beta", "activity"):
                RANGES[name].check(name, value)
        if self.controls is not None and any(part is not None for part in self.hands):
            raise InputError("controls", "are given beside hand_height, hand_speed or hand_radius", "give one or other")
        if self.energy not in ENERGIES:
            raise InputError(f"energy {self.energy}", "is unknown", f"choose among {', '.join(ENERGIES)}")
        if self.handedness not in (None, *HANDS):
            raise InputError(f"handedness {self.handedness}", "is unknown", f"choose among {', '.join(HANDS)}")
        for begin, stop in self.hold_still:
            if not 0 <= begin < stop < math.inf:
                raise InputError(f"hold_still {begin:g}-{stop:g}", "is no range of seconds", "write it as 3.2-5.0")

    @property
    def energy_share(self) -> float:
        """What the energy multiplies activity by."""
        return ENERGIES[self.energy][1]

    @property
    def directed(self) -> bool:
        """Whether blocks are drawn otherwise than the models would."""
        return bool(self.hold_still or self.cues or self.handedness)

    @property
    def shaped(self) -> bool:
        """Whether drawn poses are changed."""
        sized = self.intensity != 1.0 or ENERGIES[self.energy][0] != 1.0
        return bool(self.plan or self.cues or self.handedness or sized)

    @property
    def mirrored(self) -> bool:
        """Whether the whole motion is mirrored; where a plan locks blocks, they are left as they are."""
        return self.mirror and not (self.plan is not None and any(block.locked for block in self.plan.blocks))

    @property
    def hands(self) -> tuple[HandControl, ...]:
        """The hand controls in the order of `data_module.controls.FEATURES`."""
        return self.hand_height, self.hand_speed, self.hand_radius


class InferenceArguments(TypedDict, total=False):
    """The fields of `InferenceOptions` as keyword arguments, for type checkers."""

    speaker: str | None
    interpreter: str | LexemeInterpreter | None
    seed: int
    variation: int
    temperature: float | None
    beta: float | None
    activity: float | None
    fps: float
    gain: float
    hand_height: HandControl
    hand_speed: HandControl
    hand_radius: HandControl
    controls: Controls | None
    intensity: float
    mirror: bool
    energy: str
    handedness: str | None
    hold_still: tuple[tuple[float, float], ...]
    cues: tuple[GestureCue, ...]
    plan: GesturePlan | None
    legs: bool
    seated: bool


# ---------------------------------------------------------------------------------------------------- the result

@dataclass(frozen=True)
class LexemeWorth:
    """What the interpreter "advantage" weighed, for the M best lexemes of each block and, last, the one that was
    played. prior: [N, M + 1] how likely the behaviour policy makes it; advantage: [N, M + 1] how much more than the
    behaviour policy's mean the reward expects of it, in standard deviations."""

    prior: NDArray[np.float64]
    advantage: NDArray[np.float64]

    def entry(self, block: int, candidate: int) -> dict[str, float]:
        """Of a candidate (-1: the lexeme that was played), ready for JSON."""
        return {"prior": float(self.prior[block, candidate]), "advantage": float(self.advantage[block, candidate])}

    def runner_up(self, best: NDArray[np.int64], played: int, block: int) -> dict[str, float]:
        """The best of the candidates [M] that was not played: its lexeme, and by how much more (or less) than the
        played one the reward expects of it."""
        other = next((place for place, lexeme in enumerate(best) if int(lexeme) != played), 0)
        return {"id": int(best[other]), "worth_more": float(
            self.advantage[block, other] - self.advantage[block, -1])}


@dataclass(frozen=True)
class Performance:
    """Gesture for one recording.

    motion: on the character of 16, 46 or, with legs, 54 joints, at any frame rate. speech: the sound. blocks: N blocks
    that tile it. lexemes: [N] the lexeme that was played. best: [N, M] the M best lexemes, best first; scores: [N, M]
    what the interpreter thought of them, falling along M. M is `BEST`, or the size of the lexicon where that is
    smaller. The played lexeme need not be the first of `best` (it may have been drawn, or asked for). codes: [N, d_z]
    style codes. gate: [N] how likely a gesture was on each block, NaN where the gate was not asked. notes: what the
    user should know, a line each.
    """

    motion: Motion
    speech: Speech
    blocks: Blocks
    lexemes: NDArray[np.int64]
    best: NDArray[np.int64]
    scores: NDArray[np.float64]
    codes: NDArray[np.float32] | None = None
    gate: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    score_is: str = "log-probability"
    """What the scores are: natural logarithms of probabilities, or "Q value". A Q value is what RACER's Q-network gives
    a lexeme. It ranks lexemes, and is no expected return: the conservative loss pushes it down where the data have few
    examples (RACER Eq. 11), so its size is not that of any sum of rewards."""
    weighed: LexemeWorth | None = None
    """Of the interpreter "advantage": what the candidates are worth."""
    character: CharacterMotion | None = None
    """The same motion on a character of the user's, shown by .bvh, .glb, .fbx, .usda, .usdc, .csv, .parquet."""
    made_by: Mapping[str, Any] = field(default_factory=dict)
    """What made it, in plain values: the version, the bundle, and the settings that were asked for or chosen."""
    options: InferenceOptions | None = None
    """What was asked, with nothing left to the bundle."""
    names: Callable[[], tuple[LexemeName, ...]] | None = None
    """The names of the lexemes, worked out when they are asked for."""
    sound_name: str = ""
    """The file of the sound."""

    def __post_init__(self) -> None:
        import numpy as np

        n = len(self.blocks)
        if self.lexemes.shape != (n,) or self.best.ndim != 2 or len(self.best) != n or self.best.shape[1] == 0:
            raise ValueError(f"lexemes {self.lexemes.shape} and best {self.best.shape} do not fit {n} blocks")
        if self.scores.shape != self.best.shape or not np.isfinite(self.scores).all():
            raise ValueError(f"scores must be finite and shaped as best, {self.best.shape}")
        if (np.diff(self.scores, axis=1) > 0).any():
            raise ValueError("scores must fall: the best candidate first")
        if self.weighed is not None and self.weighed.prior.shape != (n, self.best.shape[1] + 1):
            raise ValueError(f"the worth of lexemes {self.weighed.prior.shape} does not fit best {self.best.shape}")
        if self.blocks.edges[0] != 0 or abs(self.blocks.edges[-1] - self.speech.duration) > _END_TOLERANCE:
            raise ValueError(f"blocks from {self.blocks.edges[0]} to {self.blocks.edges[-1]} s do not tile "
                             f"{self.speech.duration} s of sound")

    @property
    def duration(self) -> float:
        """Seconds of sound."""
        return self.speech.duration

    @property
    def fps(self) -> float:
        """Frames per second of the motion."""
        return self.motion.fps

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints, the root first, parents before children."""
        return self.motion.skeleton.names

    @property
    def rotations(self) -> Array:
        """[T, J, 4] local rotations, unit quaternions, w first; the identity is the T-pose."""
        return self.motion.rotations

    def positions(self) -> Array:
        """[T, J, 3] where the joints are, metres: Y up, facing +Z, the floor at 0, as in the files that are written."""
        from data_module.motion.kinematics import positions_of
        from data_module.motion.skeletons import standing

        return positions_of(standing(self.motion))

    def save(self, path: str | os.PathLike[str], *, unit: str = "cm") -> Path:
        """Write it, whole or not at all, in the format of the suffix (`WRITERS`): .bvh, .glb, .fbx and so on the
        motion, .html a page that plays it, .json its plan.

        unit: "cm" or "m", the unit of length of a BVH file; all other formats are in metres, or tell their unit.
        Folders that are missing are made. `InputError` for an unknown suffix, or where what its writer needs is not
        installed; OSError where the disk refuses.
        """
        check_output(path, unit)  # before a folder is made
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        return write(path, self, unit=unit)

    def on(self, character: Character | str | os.PathLike[str],
           mapping: RigMapping | str | os.PathLike[str] | None = None, *, contacts: bool = True) -> Performance:
        """The performance with its motion on a character as well (`gesticulator.characters.retarget`), which `save`
        then writes.

        character: a file (.bvh, .glb, .gltf, .vrm, .fbx), or what `read_character` gives. mapping: a file as
        `save_mapping` writes it, where her joints are not found. contacts: keep hands out of her trunk.
        `InputError` where she cannot be read, or her joints can only be guessed.
        """
        from gesticulator.characters.retarget import retarget

        return replace(self, character=retarget(self, character, mapping, contacts=contacts))

    def plan(self) -> GesturePlan:
        """What was decided, as a plan that can be edited and rendered again (`InferenceOptions.plan`)."""
        made: GesturePlan = import_module("gesticulator.directing.record").plan_of(self)
        return made

    def explain(self) -> dict[str, Any]:
        """Why each block got its gesture, ready for JSON: `plan` in plain values (docs/plan.md)."""
        return self.plan().to_dict()


# ---------------------------------------------------------------------------------------------------- its files

def suffix_of(path: str | os.PathLike[str]) -> str:
    """The ending of a path that picks its format, in small letters: the last one, or the last two where those are one
    format (".g1.csv"); "" where it has none."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    both = "".join(suffixes[-2:])
    return both if both in WRITERS else "".join(suffixes[-1:])


def check_output(path: str | os.PathLike[str], unit: str = "cm") -> None:
    """`InputError` where a file of that name cannot be written here: its suffix is unknown (the known ones are listed),
    or what its writer needs is not installed, or the unit is not its own."""
    target = Path(path)
    suffix = suffix_of(target)
    if suffix not in WRITERS:
        said = f"'{target.suffix}' is no format that can be written" if target.suffix else "has no suffix"
        raise InputError(target, said, f"use one of {', '.join(sorted(WRITERS))}")
    if unit not in UNITS:
        raise InputError(f"unit {unit}", "is unknown", f"use one of {', '.join(UNITS)}")
    if unit != "cm" and suffix != ".bvh":
        raise InputError(target, f"cannot be in {unit}", "the unit is for .bvh; other formats have their own")
    module, package, extra = NEEDS.get(suffix, ("", "", ""))
    if module and find_spec(module) is None:
        raise InputError(target, f"needs {package}, which is not installed", f'pip install "gesticulator[{extra}]"')
    if suffix == ".fbx":
        from gesticulator.characters.blender import check_blender

        check_blender(target)


def writer_for(path: str | os.PathLike[str]) -> Callable[[Path, Performance], Path]:
    """The writer for a path by its suffix, in any case; `InputError` as of `check_output`."""
    check_output(path)
    module, name = WRITERS[suffix_of(path)].split(":")
    found: Callable[[Path, Performance], Path] = getattr(import_module(module), name)
    return found


def write(path: str | os.PathLike[str], performance: Performance, *, unit: str = "cm") -> Path:
    """Write a performance, whole or not at all, in the format of the suffix; unit: that of a BVH file.

    Returns `path`. `InputError` as of `check_output`; OSError where the disk refuses.
    """
    check_output(path, unit)
    return (writer_for(path) if unit == "cm" else partial(write_bvh_file, unit=unit))(Path(path), performance)


def write_bvh_file(path: Path, performance: Performance, unit: str = "cm") -> Path:
    """Write the motion, standing on the floor, at its own frame rate. Returns `path`.

    A character of a BVH file is written as that file has her, in its own unit.
    """
    from data_module.motion import bvh
    from data_module.motion.skeletons import standing

    moved = performance.character
    if moved is not None and moved.character.kind == "bvh":
        from gesticulator.characters.bvh_rig import write_character_bvh

        placed = None if moved.translations is None else (moved.hips, moved.translations)
        write_character_bvh(path, moved.character, moved.rotations, placed, moved.fps)
        return path
    motion = standing(performance.motion)
    if moved is not None:
        from gesticulator.export.nodes import of_character, with_identity_rest

        motion = with_identity_rest(of_character(moved))
    bvh.write_bvh(path, motion, UNITS[unit])
    return path

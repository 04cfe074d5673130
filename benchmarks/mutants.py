"""Do the tests notice a wrong formula? Sixty one-line mutants, each with the test file that must kill it.

    python benchmarks/mutants.py [--only SUBSTRING] [--list] [--out docs/results/mutants.json]

A mutant replaces a fragment of one line of a formula. Its test file runs on a temporary copy of the tree, never on the
checkout, with `pytest -x -n 0`. It is killed when a test fails within the limit, 60 s of processor time, that passes
again without it; a mutant that breaks the import, or a test that fails without it, proves nothing and counts as an
error. Exit code 1 if one survives, is in error, or if its fragment does not occur exactly once in its file.

`--only` runs the mutants whose formula, file or test contains the substring. With `--out` the rows of one run replace
those of the same name in the file, so that the sixty can be run in parts. Each run of pytest is a fork of a process
that has loaded the libraries once, which halves the time; Linux and macOS alone can do that.
"""

from __future__ import annotations

import argparse
import importlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eval.table import Table

ROOT = Path(__file__).parents[1]
LIMIT = 60.0
"""Seconds of processor time in which a test file must kill its mutant."""
PATIENCE = 5.0
"""Times the limit on the clock, after which a run is stopped: the machine may be busy with other work."""
PACKAGES = {"data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval"}
LIBRARIES = ("numpy", "torch", "scipy.stats", "scipy.signal", "scipy.ndimage", "scipy.spatial.transform", "scipy.fft",
             "sklearn.cluster", "librosa", "soxr", "soundfile", "hypothesis.strategies", "pytest")
KILLED, SURVIVED, ERROR = "killed", "survived", "error"


@dataclass(frozen=True)
class Mutant:
    """A wrong formula. formula: its name in words; file: where it stands; fragment: a part of one line of it;
    replacement: what stands there instead; test: the file that must notice."""

    formula: str
    file: str
    fragment: str
    replacement: str
    test: str

    def occurrences(self, root: Path = ROOT) -> int:
        """How often the fragment occurs in its file; 0 where the file is missing."""
        path = root / self.file
        return path.read_text(encoding="utf-8").count(self.fragment) if path.is_file() else 0

    @property
    def haystack(self) -> str:
        """What `--only` searches."""
        return f"{self.formula} {self.file} {self.test}"


MUTANTS = (
    # generator
    Mutant("style divergence (RG Eq. 14) without its logarithm", "generator/losses.py", "- 1.0 - variance.log()",
           "- 1.0", "tests/test_generator.py"),
    Mutant("temperature of the Gumbel choice ignored", "generator/model.py", "tau=temperature", "tau=1.0",
           "tests/test_generator.py"),
    Mutant("last pose added to a block without fading out", "generator/model.py", "self.fade * past[:, -1:]",
           "past[:, -1:]", "tests/test_generator.py"),
    Mutant("perceptual loss (RG Eq. 11): first power for the second", "generator/losses.py",
           "(encoder(generated) - target).pow(2)", "(encoder(generated) - target).abs()", "tests/test_generator.py"),
    Mutant("flow matching: the target velocity is u + noise", "generator/flow.py", "v - (u - noise)",
           "v - (u + noise)", "tests/test_flow.py"),
    Mutant("slope at the end of a step of the Adams method taken at its start", "generator/flow.py",
           "head(predicted, i * step,", "head(u, (i - 1) * step,", "tests/test_flow.py"),
    Mutant("classifier-free guidance with the wrong sign", "generator/flow.py",
           "v = v + (gains *", "v = v - (gains *", "tests/test_flow.py"),
    Mutant("quintic fade of a shifted past", "generator/flow.py", "(1 + 3 * x + 6 * x * x)", "(1 + 3 * x)",
           "tests/test_flow.py"),
    # lexicon
    Mutant("commitment loss (RG Eq. 3) detached from the encoder", "lexicon/quantizer.py",
           "commitment = (latents - chosen", "commitment = (latents.detach() - chosen", "tests/test_lexicon.py"),
    Mutant("straight-through estimator passes no gradient", "lexicon/quantizer.py",
           "latents + (chosen - latents).detach()", "chosen.detach() + 0 * latents", "tests/test_lexicon.py"),
    Mutant("moving average of the codebook: decay and step swapped", "lexicon/quantizer.py",
           "one_hot.t() @ latents), alpha=1 - self.decay", "one_hot.t() @ latents), alpha=self.decay",
           "tests/test_lexicon.py"),
    Mutant("squared distance to the codes without its factor 2", "lexicon/quantizer.py", "- 2 * latents @",
           "- latents @", "tests/test_lexicon.py"),
    Mutant("codebook loss moves the encoder instead of the codes", "lexicon/quantizer.py",
           "(latents.detach() - chosen)", "(latents - chosen.detach())", "tests/test_lexicon.py"),
    Mutant("RACER's reconstruction (Eq. 5) squared", "lexicon/racer.py", "masked_mean(error.abs(), mask)",
           "masked_mean(error.pow(2), mask)", "tests/test_racer_codec.py"),
    Mutant("transitions (RG Eq. 24) normalised over the wrong axis", "lexicon/inventory.py",
           "moves.sum(axis=1, keepdims=True)", "moves.sum(axis=0, keepdims=True)", "tests/test_lexicon.py"),
    # interpreters
    Mutant("conservative term (RACER Eq. 11): maximum for log-sum-exp", "interpreters/cql.py",
           "-torch.inf).logsumexp(-1)", "-torch.inf).amax(-1)", "tests/test_cql.py"),
    Mutant("Bellman target (RACER Eq. 10) bootstraps past the end", "interpreters/cql.py",
           "next_value.masked_fill(terminal.bool(), 0.0)", "next_value", "tests/test_cql.py"),
    Mutant("Bellman target without the discount", "interpreters/cql.py", "reward + gamma * next_value",
           "reward + next_value", "tests/test_cql.py"),
    Mutant("actor's loss ignores the sign of the error", "eval/ablate/actor_critic.py", "nll * error.detach()",
           "nll * error.detach().abs()", "tests/test_actor_critic.py"),
    Mutant("advantage of critics without the discount", "interpreters/advantage.py",
           "self.reward + gamma * self.future", "self.reward + self.future", "tests/test_advantage.py"),
    Mutant("advantage is the mean of the critics, not the least", "interpreters/advantage.py",
           "least = each.amin(-2)", "least = each.mean(-2)", "tests/test_advantage.py"),
    Mutant("advantage weight not multiplied by the temperature", "interpreters/advantage.py",
           "(self.temperature or 1.0) * self.beta * advantage", "self.beta * advantage", "tests/test_advantage.py"),
    Mutant("InfoNCE (RACER Eq. 7) without its temperature", "interpreters/reward.py", "motion / temperature",
           "motion", "tests/test_reward.py"),
    Mutant("InfoNCE in one direction alone", "interpreters/reward.py", "functional.cross_entropy(by_audio, pairs)",
           "functional.cross_entropy(logits, pairs)", "tests/test_reward.py"),
    Mutant("statistical interpreter (RG Eq. 24) ignores the past frequencies", "interpreters/statistical.py",
           "(state.target - frequencies)", "(state.target)", "tests/test_interpreters.py"),
    Mutant("sampling ignores the temperature", "interpreters/base.py", "(masked - masked.max()) / temperature",
           "(masked - masked.max())", "tests/test_interpreters.py"),
    Mutant("reward by differences is the reward of the prefix", "interpreters/episodes.py",
           "np.diff(prefix, prepend=np.float32(0))", "prefix", "tests/test_episodes.py"),
    # data_module
    Mutant("onsets: peaks need not stand above their surroundings", "data_module/speech/onsets.py",
           "/ (high - low) + _RISE", "/ (high - low)", "tests/test_beats.py"),
    Mutant("next beat may come before d_min", "data_module/speech/beats.py",
           "low, high = beat + settings.d_min, beat + settings.d_max",
           "low, high = beat + settings.merge, beat + settings.d_max", "tests/test_beats.py"),
    Mutant("pseudo-beat leaves no room before the next onset", "data_module/speech/beats.py",
           "time - settings.d_min for time in ahead", "time for time in ahead", "tests/test_beats.py"),
    Mutant("block phases: the knots begin on the first beat", "data_module/types.py",
           "np.arange(1, self.frames + 1) / self.frames", "np.arange(self.frames) / self.frames",
           "tests/test_blocks.py"),
    Mutant("warp: slopes at uneven knots weighted the wrong way round", "data_module/blocks.py",
           "(lines[:-1] * steps[1:] + lines[1:] * steps[:-1])", "(lines[:-1] * steps[:-1] + lines[1:] * steps[1:])",
           "tests/test_blocks.py"),
    Mutant("conjugate of a quaternion leaves one axis", "data_module/motion/rotation.py",
           "np.array([1.0, -1.0, -1.0, -1.0])", "np.array([1.0, -1.0, -1.0, 1.0])", "tests/test_rotation.py"),
    Mutant("slerp weights by the share instead of its sine", "data_module/motion/rotation.py",
           "np.sin((1.0 - share) * angle) / safe)", "(1.0 - share) * sine / safe)", "tests/test_rotation.py"),
    Mutant("exponential maps unrolled by half turns", "data_module/motion/rotation.py", "turn = 2.0 * np.pi",
           "turn = np.pi", "tests/test_rotation.py"),
    Mutant("forward kinematics: bones turned by their own joint", "data_module/motion/kinematics.py",
           "rotation.rotate(world[..., parent, :], skeleton.offsets[joint])",
           "rotation.rotate(world[..., joint, :], skeleton.offsets[joint])", "tests/test_kinematics.py"),
    Mutant("silence begins at the noise floor, without a margin", "data_module/speech/silence.py",
           "levels <= np.maximum(floor + MARGIN, limit)", "levels <= np.maximum(floor, limit)",
           "tests/test_silence.py"),
    Mutant("gain of a recording as decibels of power", "data_module/speech/audio.py", "10.0 ** (decibels / 20)",
           "10.0 ** (decibels / 10)", "tests/test_audio.py"),
    Mutant("motion beats at accelerations, not at decelerations", "data_module/motion/motion_beats.py",
           "curve = -acceleration if", "curve = acceleration if", "tests/test_motion_beats.py"),
    Mutant("inertialisation: a coefficient of the quintic", "data_module/motion/kinematics.py", "8.0 * s4",
           "7.0 * s4", "tests/test_takes.py"),
    Mutant("velocity before a block not scaled to its duration", "data_module/motion/movement.py",
           "velocity = (last - before) * ratio", "velocity = last - before", "tests/test_movement.py"),
    Mutant("BVH angles written in radians", "data_module/motion/bvh.py",
           "np.degrees(self._unwrap(euler))", "self._unwrap(euler)", "tests/test_bvh.py"),
    # gesticulator
    Mutant("inverse of the normaliser forgets the mean", "gesticulator/bundle/features.py",
           "values * self.spread + self.mean", "values * self.spread", "tests/test_features.py"),
    Mutant("tempo column in seconds instead of logarithms", "gesticulator/bundle/features.py",
           "logs = np.log(durations / longest)", "logs = durations / longest", "tests/test_speech_features.py"),
    Mutant("inverse kinematics: a sign in the law of cosines", "gesticulator/characters/inverse_kinematics.py",
           "far ** 2 - second ** 2", "far ** 2 + second ** 2", "tests/test_inverse_kinematics.py"),
    Mutant("retargeting: the constant of a bone left out", "gesticulator/characters/retarget.py",
           "turns[segment.node] = turn @ segment.constant", "turns[segment.node] = turn",
           "tests/test_retarget_rigs.py"),
    Mutant("rest decay: a block goes towards itself, not towards its mean pose", "gesticulator/systems/paper.py",
           "(block.mean(dim=1, keepdim=True) - last)", "(block - last)", "tests/test_pipeline.py"),
    Mutant("rest: a hand that stops does not start from its own speed", "gesticulator/body/rest.py",
           "(s**3 - 2 * s**2 + s) * slope", "(s**3 - s**2) * slope", "tests/test_rest.py"),
    Mutant("knobs: levels of blocks blend in straight lines", "gesticulator/directing/shaping.py",
           "* u * u * (3.0 - 2.0 * u)", "* u", "tests/test_shaping.py"),
    Mutant("head turns in straight lines instead of a quintic", "gesticulator/body/life.py",
           "minimum_jerk(np.clip(share, 0.0, 1.0))", "np.clip(share, 0.0, 1.0)", "tests/test_head_turns.py"),
    Mutant("returns (RACER Eq. 1) not discounted", "gesticulator/training/stages/advantage.py",
           "float(rewards[i]) + gamma * after", "float(rewards[i]) + after", "tests/test_advantage.py"),
    Mutant("quaternions written to glTF with w first", "gesticulator/export/gltf.py",
           'turns[..., [1, 2, 3, 0]].astype("<f4")', 'turns.astype("<f4")', "tests/test_export_formats.py"),
    # eval
    Mutant("FGD (RACER Eq. 13): the root counted once", "eval/metrics/fgd.py", "- 2.0 * shared", "- shared",
           "tests/test_fgd.py"),
    Mutant("FGD: the distance of the means is not squared", "eval/metrics/fgd.py", "(a.mean - b.mean) ** 2",
           "abs(a.mean - b.mean)", "tests/test_fgd.py"),
    Mutant("PMB (RG Eq. 22): one onset for several motion beats", "eval/metrics/pmb.py", "pairs[index] = free",
           "pairs[index], free = free, free - 1", "tests/test_pmb.py"),
    Mutant("beat consistency: a narrower Gaussian", "eval/metrics/beat_consistency.py", "(2.0 * sigma ** 2)",
           "(sigma ** 2)", "tests/test_beat_consistency.py"),
    Mutant("entropy (RG Eq. 23) in bits instead of nats", "eval/metrics/diversity.py", "shares * np.log(shares)",
           "shares * np.log2(shares)", "tests/test_diversity.py"),
    Mutant("basic bootstrap without its reflection", "eval/stats.py", "2.0 * got - high, 2.0 * got - low",
           "low, high", "tests/test_stats.py"),
    Mutant("analysis of variance: eta squared is the share within", "eval/study/anova.py", "1.0 - within / float(",
           "within / float(", "tests/test_study.py"),
    Mutant("Hellinger distance without its roots", "eval/metrics/smoothness.py",
           "np.sqrt(p / p.sum()) - np.sqrt(q / q.sum())", "p / p.sum() - q / q.sum()", "tests/test_smoothness.py"),
)


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant, the processor seconds that its test file took, and which test killed it, or why none."""

    verdict: str
    seconds: float
    note: str = ""


def copied_tree(target: Path) -> None:
    """The files of the checkout that git does not ignore, as they are now."""
    listed = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT,
                            check=True, capture_output=True).stdout.decode().split("\0")
    for name in filter(None, listed):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, target / name)


def load_libraries() -> None:
    """Import what nearly every test file imports and no mutant touches: forks need not do it again."""
    for name in LIBRARIES:
        importlib.import_module(name)
    own = sorted({name.split(".")[0] for name in sys.modules} & PACKAGES)
    if own:
        raise RuntimeError(f"{', '.join(own)} would be the checkout's in every fork, without mutants")


@dataclass(frozen=True)
class Ended:
    """How a run of pytest ended. code: None where it was stopped; seconds: of the processor; failed: the test that
    failed first, empty for none; output: its last lines."""

    code: int | None
    seconds: float
    failed: str
    output: str


class FirstFailure:
    """A plugin of pytest that writes down which test fails first."""

    def __init__(self, note: Path) -> None:
        self.note = note

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Called by pytest for each phase of each test."""
        if report.failed and not self.note.exists():
            self.note.write_text(report.nodeid, encoding="utf-8")


def run_tests(tree: Path, tests: str, limit: float) -> Ended:
    """Run a test file of a tree, or one test of it."""
    with tempfile.TemporaryDirectory() as folder:
        output, note = Path(folder) / "output", Path(folder) / "failed"
        child = os.fork()
        if child == 0:
            os.setsid()
            stream = os.open(output, os.O_WRONLY | os.O_CREAT)
            os.dup2(stream, 1)
            os.dup2(stream, 2)
            os._exit(pytest_in(tree, tests, FirstFailure(note)))
        code, seconds = awaited(child, PATIENCE * limit)
        lines = output.read_text(encoding="utf-8", errors="replace").splitlines() if output.exists() else []
        failed = note.read_text(encoding="utf-8") if note.exists() else ""
    return Ended(code, seconds, failed, "\n".join(lines[-15:]))


def pytest_in(tree: Path, tests: str, plugin: FirstFailure) -> int:
    """Exit code of pytest in this process, which sees the packages of a tree alone."""
    os.chdir(tree)
    checkout = {str(ROOT), str(ROOT / "benchmarks")}
    sys.path[:] = [str(tree), *(path for path in sys.path if path not in checkout)]
    os.environ |= {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    import pytest

    code = int(pytest.main(["-x", "-n", "0", "-q", "--no-header", "-p", "no:cacheprovider", tests], [plugin]))
    sys.stdout.flush()
    return code


def awaited(child: int, patience: float) -> tuple[int | None, float]:
    """Exit code and processor seconds of a child, with the children that it waited for; it is stopped, code None, after
    so many seconds on the clock."""
    until = time.monotonic() + patience
    while time.monotonic() < until:
        ended, status, used = os.wait4(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    _, _, used = os.wait4(child, 0)
    return None, used.ru_utime + used.ru_stime


def tried(mutant: Mutant, tree: Path, limit: float) -> Outcome:
    """Run a mutant's test file on the copied tree with its line replaced, and put the line back.

    A test that fails for another reason kills nothing: the one that failed must pass once the line is put back.
    """
    count = mutant.occurrences(tree)
    if count != 1:
        return Outcome(ERROR, 0.0, f"its fragment occurs {count} times in {mutant.file}")
    path = tree / mutant.file
    original = path.read_text(encoding="utf-8")
    try:
        write_source(path, original.replace(mutant.fragment, mutant.replacement))
        ended = run_tests(tree, mutant.test, limit)
    finally:
        write_source(path, original)
    if ended.code == 0:
        return Outcome(SURVIVED, ended.seconds)
    if ended.code is None or ended.seconds > limit:
        return Outcome(SURVIVED, ended.seconds, f"not noticed within {limit:g} s")
    if ended.code != 1:
        return Outcome(ERROR, ended.seconds, f"pytest ended with {ended.code}:\n{ended.output}")
    again = run_tests(tree, ended.failed, limit)
    if again.code != 0:
        return Outcome(ERROR, ended.seconds, f"{ended.failed} fails without the mutant, too:\n{again.output}")
    return Outcome(KILLED, ended.seconds, ended.failed.partition("::")[2])


def write_source(path: Path, text: str) -> None:
    """Write a module without leaving compiled code behind that has its time stamp and size."""
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        compiled.unlink()
    path.write_text(text, encoding="utf-8")


def judged(mutants: Iterable[Mutant], limit: float) -> dict[Mutant, Outcome]:
    """Each mutant's outcome, printed as it comes."""
    load_libraries()
    outcomes: dict[Mutant, Outcome] = {}
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        copied_tree(tree)
        for mutant in mutants:
            outcome = outcomes[mutant] = tried(mutant, tree, limit)
            print(f"{outcome.verdict:8}  {outcome.seconds:5.1f} s  {mutant.file}: {mutant.formula}"
                  + (f"\n{'':20}{outcome.note}" if outcome.note else ""), flush=True)
    return outcomes


def table(outcomes: dict[Mutant, Outcome], earlier: Sequence[Table] = ()) -> Table:
    """The outcomes in the order of `MUTANTS`, with those of an earlier run where a mutant did not run now."""
    from eval.table import Column, Table  # not before the forks: they must see the tree's packages

    rows: dict[str, Any] = dict(earlier[0].rows) if earlier else {}
    for mutant, outcome in outcomes.items():
        rows[mutant.formula] = {"file": f"`{mutant.file}`", "test": f"`{mutant.test}`", "verdict": outcome.verdict,
                                "seconds": outcome.seconds}
    rows = {mutant.formula: rows[mutant.formula] for mutant in MUTANTS if mutant.formula in rows}
    killed = sum(row["verdict"] == KILLED for row in rows.values())
    lacking = f"; {len(MUTANTS) - len(rows)} more were not run" if len(rows) < len(MUTANTS) else ""
    notes = [f"{killed} of {len(rows)} mutants are killed{lacking}. Seconds are processor time of the test "
             "file up to its first failing test."]
    columns = {"file": Column("file"), "test": Column("test that must notice"), "verdict": Column("verdict"),
               "seconds": Column("time", "s", 1)}
    return Table("Mutants of formulas", columns, rows, "formula, mutated", notes)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--only", default="", metavar="SUBSTRING", help="of the formula, the file or the test")
    p.add_argument("--list", action="store_true", help="print the mutants and run nothing")
    p.add_argument("--limit", type=float, default=LIMIT, metavar="SECONDS", help="processor time of a test file")
    p.add_argument("--out", type=Path, help="write the table here (.json, and .md beside it)")
    asked = p.parse_args(arguments)
    chosen = [mutant for mutant in MUTANTS if asked.only in mutant.haystack]
    if asked.list:
        for mutant in chosen:
            print(f"{mutant.file}: {mutant.formula} ({mutant.test})\n  - {mutant.fragment}\n  + {mutant.replacement}")
        return 0
    if not chosen:
        p.error(f"no mutant matches {asked.only!r}")
    started = time.perf_counter()
    outcomes = judged(chosen, asked.limit)
    if asked.out:
        from eval.table import Provenance, load, publish

        publish([table(outcomes, load(asked.out) if asked.out.exists() else ())], asked.out,
                Provenance.now("python benchmarks/mutants.py"))
    killed = sum(outcome.verdict == KILLED for outcome in outcomes.values())
    print(f"{killed} of {len(outcomes)} killed in {time.perf_counter() - started:.0f} s")
    return 0 if killed == len(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())

"""What every test shares: the outside data, a calm hypothesis and one thread for torch."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest
import torch
import toy
from filelock import FileLock
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from gesticulator import Gesticulator

# No deadline: the first call of a numerical library is slow and says nothing about the code under test.
settings.register_profile("project", deadline=None, max_examples=50, derandomize=True,
                          suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("project")


def pytest_configure(config: pytest.Config) -> None:
    """Fills numba's cache of librosa before there are workers: two that fill a new one together read each other's
    half-written machine code and crash (4 of 12 pairs of processes did, on an empty cache)."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        import librosa
        import numpy as np

        # Most is compiled as these names are looked up, the path finder of pyin when it is first called.
        sound = np.sin(np.arange(8000, dtype=np.float32) / 10)
        librosa.onset.onset_detect(y=sound, sr=16000)
        librosa.pyin(sound, fmin=60, fmax=400, sr=16000)


def pytest_runtest_setup() -> None:
    """One thread for each test: a command that ran before it may have set torch to all cores."""
    torch.set_num_threads(1)


SLOW_FIXTURES = {"tiny_bundle", "tiny_movement_bundle"}
"""What takes half a minute or more to make."""
SLOW = frozenset((Path(__file__).parent / "slow.txt").read_text(encoding="utf-8").split())
"""FILE::FUNCTION of the other tests, and of fixtures of one file, that take about a second of the processor or more."""


FULL = frozenset((Path(__file__).parent / "full.txt").read_text(encoding="utf-8").split())
"""FILE::FUNCTION of the longest tests, most of which cover in the large what other tests cover in the small: stories of
browsers and characters, and commands from end to end."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="run the longest tests (tests/full.txt), too")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what is slow, so that `pytest -m "not slow"` is done in three minutes. The longest tests are left out unless
    --full is given or a test is named."""
    longest = []
    for item in items:
        function = getattr(item, "originalname", item.name)
        fixtures = set(getattr(item, "fixturenames", ()))
        if SLOW_FIXTURES & fixtures or SLOW & {f"{item.path.name}::{name}" for name in {function, *fixtures}}:
            item.add_marker(pytest.mark.slow)
        if f"{item.path.name}::{function}" in FULL:
            longest.append(item)
    if longest and not config.getoption("full") and not any("::" in argument for argument in config.args):
        config.hook.pytest_deselected(items=longest)
        items[:] = [item for item in items if item not in longest]


@pytest.fixture(scope="session")
def outside_data() -> Path:
    """The folder that holds strokes/, speech/, takes/ and fgd/; the test is skipped where it is not to be had."""
    told = os.environ.get("GESTICULATOR_DATA")
    if not told:
        pytest.skip("GESTICULATOR_DATA is not set: this test needs the outside data")
    folder = Path(told).expanduser().resolve()
    if not folder.is_dir():
        pytest.skip(f"GESTICULATOR_DATA names no folder: {folder}")
    return folder


def _part_of(folder: Path, name: str, needed: str) -> Path:
    if not (folder / name / needed).is_file():
        pytest.skip(f"{folder} lacks {name}/{needed}, which this test measures: get the whole of the outside data")
    return folder / name


@pytest.fixture(scope="session")
def free_motion(outside_data: Path) -> Path:
    """The folder of real takes in the outside data."""
    return _part_of(outside_data, "free_motion", "manifest.csv")


@pytest.fixture(scope="session")
def meaning_data(outside_data: Path) -> Path:
    """The folder of gestures with a meaning in the outside data."""
    return _part_of(outside_data, "meaning", "meanings.csv")


@pytest.fixture(scope="session")
def blender() -> None:
    """Skips the test, with the reason, where there is no Blender."""
    from data_module.errors import InputError
    from gesticulator.characters.blender import check_blender

    try:
        check_blender(Path(__file__))
    except InputError as lacking:
        pytest.skip(str(lacking))


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], int]) -> Path:
    """The folder `name` that `make` fills and returns 0 for, once for all processes of a run: the others wait for the
    one that came first. Tests read it and change nothing in it."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared" / name
    folder.parent.mkdir(parents=True, exist_ok=True)
    complete = folder.with_suffix(".complete")
    with FileLock(folder.with_suffix(".lock")):
        if not complete.exists():
            assert make(folder) == 0
            complete.touch()
    return folder


def trained_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], int]) -> Path:
    """A copy, for this process alone, of the bundle that `make` trains once for all, with its work folder beside it."""
    trained, own = made_once(factory, name, make), factory.mktemp(name) / "bundle"
    for suffix in ("", ".work"):
        shutil.copytree(trained.with_name(name + suffix), own.with_name("bundle" + suffix))
    return own


@pytest.fixture(scope="module")
def system() -> Gesticulator:
    """The shipped system, one for each file of tests."""
    from gesticulator import Gesticulator

    return Gesticulator.from_pretrained()


@pytest.fixture(scope="module")
def g() -> Gesticulator:
    """A bundle that was never trained, with every part."""
    from untrained import untrained

    from gesticulator import Gesticulator

    return Gesticulator(untrained())


@pytest.fixture(scope="session")
def toy_corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of BVH, WAV and JSON files that toy.py writes."""
    return made_once(tmp_path_factory, "toy", toy.write)


@pytest.fixture(scope="session")
def tiny_store(toy_corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of the toy corpus, three minutes, built once for all tests by the real command."""
    from gesticulator.cli import main

    return made_once(tmp_path_factory, "store", lambda folder: main(
        ["build", "folder", "--source", str(toy_corpus), "--out", str(folder), "--workers", "1"]))


@pytest.fixture(scope="session")
def tiny_bundle(tiny_store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The `tiny` preset, trained once by the real command."""
    from gesticulator.cli import main

    return trained_once(tmp_path_factory, "trained", lambda out: main(
        ["train", "--data", str(tiny_store), "--out", str(out), "--preset", "tiny", "--threads", "1", "--quiet"]))


@pytest.fixture(scope="session")
def tiny_movement_bundle(tiny_store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The `default` preset (movements, flow head, 46 joints) at toy size, trained once by the real command."""
    from gesticulator.cli import main

    short = {"generator": 60, "interpreter": 60, "interpreter_text": 0, "gate": 20, "planner": 20, "reward": 10,
             "cql": 10, "style": 20}
    settings = [*(f"schedules.{stage}.steps={steps}" for stage, steps in short.items()),
                *(f"schedules.{stage}.batch=8" for stage in short), "schedules.interpreter.validations=2", *(
        "text.encoder=", "interpreter.text_head=0", "front_end.bands=16", "lexicon.size=24", "lexicon.levels=[8]",
        "lexicon.code_width=16", "lexicon.hidden=24",
        "schedules.lexicon.steps=200", "schedules.lexicon.batch=128",
        "lexicon.trunk_components=6", "lexicon.arm_components=10", "lexicon.finger_components=3",
        "generator.motion_features=12", "generator.audio_features=8", "generator.audio_bottleneck=8",
        "generator.hidden=32", "generator.groups=4", "generator.classes=8", "generator.blocks=8",
        "generator.context=48", "generator.lexeme_width=12", "generator.flow_width=48",
        "interpreter.audio_bottleneck=8", "interpreter.pose_features=12", "interpreter.lexeme_features=8",
        "interpreter.width=32", "interpreter.memory=4", "gate.width=16", "gate.audio_features=4",
        "gate.audio_bottleneck=8", *(f"{of}.{size}" for of in ("reward", "judge")
          for size in ("width=16", "projection=8", "window=4", "longest=6", "members=2")),
        "cql.width=16", "cql.heads=2", "cql.layers=2", "cql.decisions=6", "cql.audio_features=4",
        "cql.audio_bottleneck=8", "cql.copy_every=5", "episodes.prefix=2")]
    given = ["--threads", "1", "--quiet", *(part for setting in settings for part in ("--set", setting))]
    return trained_once(tmp_path_factory, "moving", lambda out: main(
        ["train", "--data", str(tiny_store), "--out", str(out), "--preset", "default", *given]))


@pytest.fixture(scope="session")
def judge(outside_data: Path) -> ModuleType:
    """The program that defines the figures, where it lies beside the data."""
    file = outside_data.parent / "tools" / "judge.py"
    if not file.is_file():
        pytest.skip("the program that defines the figures for the eye (tools/judge.py) is not beside the outside data")
    spec = importlib.util.spec_from_file_location("judge_of_motion", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Its dataclasses look their own module up.
    sys.modules[spec.name] = module
    written, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = written
    return module


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs `gesticulator` with input that is wrong, and gives the line that says so: the only one that is printed on
    either stream, before exit code 2."""
    def line(*arguments: str | Path) -> str:
        from gesticulator.cli import main

        capfd.readouterr()  # of commands that the test ran before
        with pytest.raises(SystemExit) as left:
            main([*map(str, arguments)])
        out, error = capfd.readouterr()
        assert (left.value.code, out, error.count("\n")) == (2, "", 1), out + error
        assert error.startswith("gesticulator: ")
        return error

    return line


@pytest.fixture(scope="session")
def three_js() -> Path:
    """The folder tests/js with three.js and three-vrm, which `.ci/run` installs. Skips without, and says why."""
    folder = Path(__file__).resolve().parent / "js"
    if not (folder / "node_modules" / "three").is_dir():
        pytest.skip("three.js is not installed: npm ci --prefix tests/js")
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless Chromium; the test is skipped, with the reason, where there is none."""
    from browser import chromium

    with chromium() as window:
        yield window

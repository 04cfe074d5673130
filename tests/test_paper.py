"""Both papers in their own form: the presets `paper` and `paper-quick`, the shipped bundle, and bundles by name."""

import importlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from performances import example

from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.config import Config, from_dict, to_dict
from gesticulator.bundle.files import CARD, INDEX, NAMED, bundle_folder, read_index
from gesticulator.cli import main
from gesticulator.gesticulator import Gesticulator
from gesticulator.training.presets import preset
from gesticulator.training.stages import wanted

CHOOSERS = ("lstm", "cql", "cql-literal", "statistical")
TOY = ("encoder.width=16", "lexicon.size=12", "lexicon.code_width=32", "lexicon.widths=[16,24,32,32]",
       "generator.motion_features=16", "generator.audio_features=8", "generator.audio_bottleneck=8",
       "generator.hidden=48", "generator.groups=4", "generator.classes=8", "generator.lstm_width=32",
       "generator.lstm_layers=1", "interpreter.width=32", "interpreter.audio_features=8",
       "interpreter.audio_bottleneck=8", "interpreter.text_features=8", "interpreter.text_bottleneck=8",
       "style.width=16", "style.audio_features=8", "style.audio_bottleneck=8", "reward.width=16",
       "reward.projection=8", "judge.width=12", "judge.projection=8",
       "episodes.prefix=2", *(f"{q}.{size}" for q in ("cql", "cql_literal") for size in (
           "width=16", "heads=2", "layers=2", "decisions=6", "audio_features=4", "audio_bottleneck=8",
           "copy_every=4")))
STEPS = {"speech": 8, "contrast": 8, "lexicon": 60, "generator": 12, "interpreter": 12, "style": 12, "reward": 8,
         "cql": 8, "cql_literal": 8}


@pytest.fixture(scope="module")
def toy(tiny_store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The preset `paper` at toy size, trained by the real command."""
    out = tmp_path_factory.mktemp("paper") / "bundle"
    short = [f"schedules.{stage}.{what}" for stage, steps in STEPS.items() for what in (
        f"steps={steps}", "batch=64" if stage == "lexicon" else "batch=8", "validations=1")]
    assert main(["train", "--data", str(tiny_store), "--out", str(out), "--preset", "paper", "--threads", "1",
                 "--quiet", *(part for setting in (*TOY, *short) for part in ("--set", setting))]) == 0
    return out


@pytest.fixture(scope="module")
def paper() -> Gesticulator:
    return Gesticulator.from_pretrained("paper")


def test_the_preset_is_both_papers_and_trains_every_stage(toy: Path) -> None:
    names = {stage.name for stage in wanted(preset("paper"))}
    assert names == {"speech", "contrast", "lexicon", "interpreter", "interpreter_text", "generator", "style",
                     "reward", "reward_judge", "q_network", "q_network_literal"}
    bundle = bundles.load(toy)
    assert set(bundle.figures) == names and all(np.isfinite(list(values.values())).all()
                                                for values in bundle.figures.values())
    assert bundle.interpreters == CHOOSERS and set(bundle.parts) >= {"encoder", "style"}
    assert bundle.config.motion.joints == 16 and bundle.config.system == "paper"
    assert not np.allclose(bundle.statistics.low.mean, bundle.statistics.high.mean), "two levels of speech"


def flat(values: Mapping[str, Any], path: str = "") -> dict[str, str]:
    """Every setting by its path, as the page writes its value."""
    found: dict[str, str] = {}
    for name, value in values.items():
        found |= flat(value, f"{path}{name}.") if isinstance(value, Mapping) else {path + name: written(value)}
    return found


def written(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(written, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, int | float) else str(value) or "none"


def listed() -> dict[str, tuple[str, str]]:
    """What docs/paper.md says of a setting or constant: the papers' value and ours."""
    rows: dict[str, tuple[str, str]] = {}
    for line in (Path(__file__).parents[1] / "docs" / "paper.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if len(cells) == 4 and cells[0].startswith("`") and "." in cells[0] + "." and line.count("|") == 5:
            names = re.findall(r"`([^`]+)`", cells[0])
            both = [[part.strip() for part in cell.split(";")] for cell in cells[1:3]]
            for at, name in enumerate(names):
                assert all(len(parts) in (1, len(names)) for parts in both), name
                rows[name] = tuple(parts[at % len(parts)] for parts in both)  # type: ignore[assignment]
    return rows


def test_what_differs_from_the_papers_is_in_the_table_of_the_page_and_nothing_else() -> None:
    ours, rg, racer = (flat(to_dict(preset(name))) for name in ("paper", "paper-trinity", "racer-trinity"))
    table, published = listed(), {}
    for name in ours:
        # The second Q-network is RACER's, too; the judge and what is not trained belong to no paper.
        of = name.replace("cql_literal", "cql")
        from_racer = of.startswith(("cql.", "reward.", "episodes.", "schedules.cql.", "schedules.reward."))
        published[name] = (racer if from_racer else rg)[of]
    differing = {name for name in ours if published[name] != ours[name]} - {"name"}
    differing -= {name for name in differing if name.startswith("judge.")}
    assert differing <= set(table), sorted(differing - set(table))
    for name, (theirs, here) in table.items():
        if name in ours:
            assert here == ours[name], name
            assert name not in differing or theirs == published[name], name
        else:
            module, _, constant = name.rpartition(".")
            assert here == written(getattr(importlib.import_module(module), constant)), name


QUICK = {
    "widths": {"encoder.width", "cql.width", "generator.motion_features", "generator.hidden", "generator.groups",
               "generator.lstm_width", "interpreter.width", "interpreter.text_features", "interpreter.text_bottleneck",
               "style.width", *(f"{part}.{what}" for part in ("generator", "interpreter", "style")
                                for what in ("audio_features", "audio_bottleneck"))},
    "steps": {f"schedules.{stage}.steps" for stage in STEPS},
    "batch": {f"schedules.{stage}.batch" for stage in STEPS},
}
"""What the system of the tables may have otherwise than `paper`, by kind."""


def test_the_system_of_the_tables_is_the_papers_but_for_widths_steps_and_batches() -> None:
    ours, quick = (flat(to_dict(preset(name))) for name in ("paper", "paper-quick"))
    differing = {name for name in ours if ours[name] != quick[name]} - {"name"}
    assert differing <= set().union(*QUICK.values()), sorted(differing)
    assert all(float(quick[name]) <= float(ours[name]) for name in differing), "narrower and shorter"


@pytest.mark.parametrize("name", list(NAMED))
def test_a_shipped_bundle_is_found_by_its_name_wherever_the_command_runs(name: str, tmp_path: Path,
                                                                         monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert bundle_folder(name) == NAMED[name] and (bundle_folder(name) / INDEX).is_file()
    assert bundle_folder(None) == NAMED["default"]
    (tmp_path / name).mkdir()
    (tmp_path / name / INDEX).write_text("{}")
    assert bundle_folder(name) == NAMED[name], "a folder of that name does not change what a command does"
    assert bundle_folder(f"./{name}") == bundle_folder(Path(name)) == Path(name)


def test_the_shipped_bundle_is_small_and_says_what_it_was_trained_on() -> None:
    folder = NAMED["paper"]
    assert sum(file.stat().st_size for file in folder.iterdir()) <= 12e6
    index = read_index(folder)
    config, made = from_dict(Config, index["config"]), preset("paper")
    assert config == made, "the preset makes this bundle"
    default = read_index(NAMED["default"])
    assert index["provenance"]["licence"] in default["provenance"]["licence"], "the default's corpus has more parts"
    for key in ("store", "seed"):
        assert index["provenance"][key] == default["provenance"][key]
    card = (folder / CARD).read_text()
    assert index["provenance"]["fingerprint"] in card and "## Limits" in card


@pytest.mark.parametrize("interpreter", CHOOSERS)
def test_the_example_is_gestured_by_each_interpreter(interpreter: str, paper: Gesticulator) -> None:
    spoken = example(6.0)
    made, again, other = (paper(spoken, interpreter=interpreter, seed=seed) for seed in (1, 1, 2))
    assert np.isfinite(made.motion.rotations).all() and made.motion.duration == pytest.approx(6.0, abs=0.05)
    np.testing.assert_array_equal(made.motion.rotations, again.motion.rotations)
    literal = interpreter == "cql-literal"
    assert np.array_equal(made.lexemes, other.lexemes) == literal, "only arg max does not depend on the seed"
    silent = np.isin(made.lexemes, paper.bundle.silent)
    assert silent[made.blocks.silent].all(), "the mask: silent lexemes in silence"

"""What every entry of every table of plug-ins keeps.

What a kind does beyond that is tested beside it: writers in `test_export`, interpreters in `test_interpreters`, data
sets on samples in `test_corpora`, metrics in `test_metric_contracts`.
"""

import argparse
import importlib
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import SimpleNamespace

import pytest

from data_module.corpora.base import Options
from data_module.corpora.table import CORPORA, open_corpus
from data_module.errors import InputError
from data_module.registry import Registry, RegistryEntry
from eval.pictures import PLOTS
from gesticulator.characters.reading import READERS, read_character
from gesticulator.cli import Command
from gesticulator.export.writers import WRITERS
from gesticulator.training.presets import preset
from gesticulator.training.stages import STAGES
from gesticulator.training.stages.base import Node, Run, Stage
from interpreters import INTERPRETERS

TABLES: tuple[Registry[RegistryEntry], ...] = (INTERPRETERS, WRITERS, READERS, CORPORA)  # type: ignore[assignment]


@pytest.mark.parametrize(("table", "name"), [pytest.param(table, name, id=f"{table.kind} {name}")
                                             for table in TABLES for name in table])
def test_an_entry_can_be_loaded_and_says_what_it_is(table: Registry[RegistryEntry], name: str) -> None:
    entry = table[name]
    assert entry.about and "\n" not in entry.about and not entry.about.endswith(".")
    if entry.needs is None:
        found = table.load(name)
        assert callable(found) and found.__doc__


@pytest.mark.parametrize("name", [name for name in CORPORA if name != "performer"])
def test_a_data_set_refuses_an_empty_folder_in_one_line(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        open_corpus(name, tmp_path, Options()).items()
    assert "\n" not in str(caught.value) and caught.value.advice


@pytest.mark.parametrize("suffix", [suffix for suffix in READERS if suffix != ".fbx"])
def test_a_reader_of_characters_refuses_what_is_none_in_one_line(suffix: str, tmp_path: Path) -> None:
    for content in (b"", b"\0\xff no character", b"{}"):
        (tmp_path / f"a{suffix}").write_bytes(content)
        with pytest.raises(InputError) as caught:
            read_character(tmp_path / f"a{suffix}")
        assert "\n" not in str(caught.value) and f"a{suffix}" in str(caught.value)


@pytest.mark.parametrize("name", PLOTS)
def test_a_plot_has_arguments_a_run_and_a_line_about_it(name: str) -> None:
    tool = PLOTS.load(name)
    parser = argparse.ArgumentParser()
    tool.arguments(parser)
    assert callable(tool.run) and tool.__doc__ and PLOTS[name].about and "\n" not in PLOTS[name].about
    assert parser.format_help().count("--") > 1, "it takes options"


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_is_trained_and_kept_by_what_shapes_it(name: str) -> None:
    stage, config = STAGES[name], preset("tiny")
    assert isinstance(stage, Stage) and stage.name == name
    assert callable(stage.build) and callable(stage.train) and isinstance(stage.wanted(config), bool)
    assert all(isinstance(need, Node) and need is not stage for need in stage.needs(config))
    run = Run(config, SimpleNamespace(fingerprint="f"), Path("work"))  # type: ignore[arg-type]
    reseeded = Run(replace(config, seed=config.seed + 1), run.store, run.work)
    assert run.key(stage) == run.key(stage) != reseeded.key(stage)
    assert run.schedule(stage).steps >= 0


@pytest.mark.parametrize("point", sorted(entry_points(group="gesticulator.commands")), ids=lambda point: point.name)
def test_a_verb_is_a_command_with_a_summary_and_an_example(point: EntryPoint) -> None:
    command = getattr(importlib.import_module(point.module), point.attr)
    assert isinstance(command, Command) and command.summary
    assert command.examples, f"{point.name} shows no example in its help"
    assert point.name in command.parser(f"gesticulator {point.name}").format_help()

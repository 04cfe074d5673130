"""The table of data sets by their names on the command line.

A new data set is one file in this folder with a reader (`data_module.corpora.base`) and one entry of `CORPORA`; or an
entry point of another package.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from data_module.errors import InputError
from data_module.registry import Registry, RegistryEntry

if TYPE_CHECKING:
    from data_module.corpora.base import Options, Reader

CORPORA: Registry[RegistryEntry] = Registry("corpora", "a data set that can be read", {
    "folder": RegistryEntry(
        "your own NAME.bvh of any rig beside NAME.flac, .wav, .mp3 or .ogg, optionally with a transcript "
        "NAME.TextGrid, NAME.json (words with times), NAME.srt, NAME.vtt or NAME.txt",
        "data_module.corpora.folder:Folder"),
    "trinity": RegistryEntry(
        "Trinity Speech-Gesture: GENEA_Challenge_2020_data_release, with Training_data/ and Test_data/",
        "data_module.corpora.trinity:Trinity"),
    "zeroeggs": RegistryEntry(
        "ZeroEGGS: its folder data, with clean/", "data_module.corpora.zeroeggs:ZeroEggs"),
    "mocca": RegistryEntry(
        "MOCCA Gesture Dataset: speakerNN_clipNN.bvh, .wav and .srt", "data_module.corpora.mocca:Mocca"),
    "beat": RegistryEntry(
        "BEAT: beat_english_v0.2.1, with a folder per speaker", "data_module.corpora.beat:Beat"),
    "beat2": RegistryEntry(
        "BEAT2: beat_english_v2.0.0, with smplxflame_30/, wave16k/ and train_test_split.csv",
        "data_module.corpora.beat2:Beat2"),
    "genea": RegistryEntry(
        "Talking With Hands as GENEA 2022 or 2023 gave it, with trn/ and val/ (main-agent/, interloctr/), each with "
        "bvh/, wav/ and tsv/", "data_module.corpora.genea:Genea"),
    "ted": RegistryEntry(
        "TED Gesture: ted_dataset, with lmdb_train/, lmdb_val/ and lmdb_test/", "data_module.corpora.ted:Ted"),
}, RegistryEntry)
"""By name: reader(source, options) -> `Reader`."""

SEPARATE = {"performer": "pip install gesticulator-performer, or in a checkout: pip install -e integrations/performer"}
"""Data sets of distributions of their own, and how to install them."""


def reader_of(name: str) -> Any:
    """The class of the reader `name`; `InputError` for an unknown one, or for one whose distribution is missing."""
    if name not in CORPORA and name in SEPARATE:
        raise InputError(name, "is a distribution of its own, which is not installed", SEPARATE[name])
    return CORPORA.load(name)


def open_corpus(name: str, source: Path | None, options: Options) -> Reader:
    """The reader `name` on the folder `source`; `InputError` for an unknown reader or a missing folder."""
    reader = reader_of(name)
    # Checked here for all readers, so that each begins with a folder that is there.
    if source is not None and not source.is_dir():
        raise InputError(source, "is not a folder" if source.exists() else "does not exist", "check --source")
    return cast("Reader", reader(source, options))

"""The tables of data sets and of sources of strokes, by their names on the command line.

A new data set is one file in this folder with a reader (`data_module.corpora.base`) and one entry of `CORPORA`; or an
entry point of another package.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

from data_module.errors import InputError
from data_module.registry import Registry, RegistryEntry

if TYPE_CHECKING:
    from data_module.corpora.base import Options, Reader, StrokeSource

CORPORA: Registry[RegistryEntry] = Registry("corpora", "a data set that can be read", {
    "performer": RegistryEntry(
        "scripted motion made of real strokes (SOURCE/strokes) on real (SOURCE/speech) and synthetic speech",
        "data_module.corpora.performer:Performer"),
    "folder": RegistryEntry(
        "your own NAME.bvh of any rig beside NAME.flac, .wav, .mp3 or .ogg, optionally with a transcript "
        "NAME.TextGrid, NAME.json (words with times), NAME.srt, NAME.vtt or NAME.txt",
        "data_module.corpora.folder:Folder"),
    "trinity": RegistryEntry(
        "Trinity Speech-Gesture: GENEA_Challenge_2020_data_release, with Training_data/ and Test_data/",
        "data_module.corpora.trinity:Trinity"),
    "zeroeggs": RegistryEntry(
        "ZeroEGGS: its folder data, with clean/ and info.csv", "data_module.corpora.zeroeggs:ZeroEggs"),
    "mocca": RegistryEntry(
        "MOCCA Gesture Dataset: speakerNN_clipNN.bvh, .wav and .srt", "data_module.corpora.mocca:Mocca"),
    "beat": RegistryEntry(
        "BEAT: beat_english_v0.2.1, with a folder per speaker", "data_module.corpora.beat:Beat"),
    "beat2": RegistryEntry(
        "BEAT2: beat_english_v2.0.0, with smplxflame_30/, wave16k/ and train_test_split.csv",
        "data_module.corpora.beat2:Beat2"),
    "ted": RegistryEntry(
        "TED Gesture: ted_dataset, with lmdb_train/, lmdb_val/ and lmdb_test/", "data_module.corpora.ted:Ted"),
}, RegistryEntry)
"""By name: reader(source, options) -> `Reader`."""

STROKE_SOURCES: Registry[RegistryEntry] = Registry("strokes", "a source of strokes that can be read", {
    "smartbody": RegistryEntry(
        "SmartBody's data/behaviorsets; writes the folder strokes/ for `performer` instead of a store",
        "data_module.corpora.smartbody:SmartBody"),
}, RegistryEntry)
"""The same for sources that make a folder of strokes instead of a store."""


def open_corpus(name: str, source: Path | None, options: Options) -> Reader:
    """The reader `name` on the folder `source`; `InputError` for an unknown reader or a missing folder."""
    if name not in CORPORA:
        raise InputError(name, "is not a data set that can be read",
                         f"take one of {', '.join((*CORPORA, *STROKE_SOURCES))}")
    _check_folder(source)
    return cast("Reader", CORPORA.load(name)(source, options))


def open_strokes(name: str, source: Path | None, options: Options) -> StrokeSource:
    """The source of strokes `name`, a key of `STROKE_SOURCES`, on the folder `source`; `InputError` without it."""
    _check_folder(source)
    return cast("StrokeSource", STROKE_SOURCES.load(name)(source, options))


def _check_folder(source: Path | None) -> None:
    if source is not None and not source.is_dir():
        raise InputError(source, "is not a folder" if source.exists() else "does not exist", "check --source")

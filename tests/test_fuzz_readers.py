"""Every reader of files against broken files: only `InputError` comes out, within 500,000 calls and 500 MB.

A real file of each kind is written, damaged as disks, programs and people damage files (flipped bits, a cut end,
pieces that are missing or there twice, foreign bytes, numbers far too large), and read. A file that happens to be still
good may be read. A new reader is a new entry of `READERS`: a test below finds each function that reads files or parses
text by what it calls (`reader_finder`), runs every case, and names the readers that none of them ran.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from types import CodeType

import pytest
from counted import counted_calls, profiled
from hypothesis import HealthCheck, Phase, given, settings
from reader_cases import READERS, Case, damages
from reader_finder import readers_of

from data_module.corpora.base import DroppedError
from data_module.errors import InputError
from data_module.text.transcript import FORMATS
from gesticulator.serve.protocol import RefusedError

resource = pytest.importorskip("resource", reason="what a process has taken is POSIX's to tell")

CALLS, MEGABYTES = 500_000, 500.0
"""What one reading may take: calls of Python and C functions, not seconds, which differ between machines."""
EXAMPLES = int(os.environ.get("GESTICULATOR_FUZZ", "20"))
"""Damaged files per reader; the variable is for a longer search."""


# ---------------------------------------------------------------------------------------------------- the property

def _peak() -> float:
    """Megabytes that this process has held at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _held() -> float:
    """Megabytes that it holds now, where the system tells; else what it has held at most."""
    file = Path("/proc/self/statm")
    return int(file.read_text().split()[1]) * resource.getpagesize() / 1e6 if file.is_file() else _peak()


@pytest.mark.parametrize("name", READERS)
def test_only_input_errors_come_out_of_damaged_files(name: str, tmp_path: Path) -> None:
    case = READERS[name]
    file = case.sample(tmp_path)
    content = case.content(file)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        case.read(file)
    beside = {other: other.read_bytes() for other in tmp_path.rglob("*") if other.is_file()}

    @settings(max_examples=max(5, round(case.examples * EXAMPLES)), deadline=None, database=None, derandomize=True,
              phases=(Phase.generate, Phase.shrink), suppress_health_check=list(HealthCheck))
    @given(damages())
    def survives(wanted: list[tuple[Callable[..., None], float, float, int]]) -> None:
        data = bytearray(content)
        for damage, a, b, choice in wanted:
            damage(data, a, b, choice)
        for other, old in beside.items():
            other.write_bytes(old)
        case.packed(file, bytes(data))
        said = ""
        before, peak = _held(), _peak()
        try:
            with warnings.catch_warnings(), counted_calls() as calls:
                warnings.simplefilter("ignore")
                warnings.filterwarnings("error", category=RuntimeWarning)
                case.read(file)
        except (InputError, DroppedError, RefusedError) as error:
            said = str(error)
        assert "\n" not in said and len(said) < 1000 + len(str(tmp_path))
        grown = _peak() - before if _peak() > peak else 0.0
        assert calls.count < CALLS and grown < MEGABYTES, f"{calls.count} calls, {grown:.0f} MB"

    survives()


# ---------------------------------------------------------------------------------------------------- completeness

ROOT = Path(__file__).parents[1]
PACKAGES = ("data_module", "gesticulator", "eval", "lexicon", "interpreters", "generator")
NO_CASE = {
    "a table of the program itself": "gesticulator/plan/gestures.py:_read_table eval/study/meaning.py:sayings",
    "a table of the outside data; a cell that is no number is named with its line": """
        eval/probes/recognition.py:read_clips eval/probes/recognition.py:_described""",
    "an option of the command line, tested with what is no number": "gesticulator/export/clip.py:parse_keys",
    "a build's own work folder, where a file that is cut counts as missing": """
        data_module/build.py:Workshop.outcome data_module/build_report.py:Outcome.from_json
        data_module/store.py:StoreWriter.__init__ data_module/store.py:StoreWriter.has
        data_module/store.py:StoreWriter.finish""",
    "a training's own work folder": """
        gesticulator/training/fit.py:Checkpoint.load gesticulator/training/fit.py:StepLog.__init__
        gesticulator/training/fit.py:_step_of gesticulator/training/fit.py:late_gain
        gesticulator/training/stages/advantage.py:CounterfactualRewards.load
        gesticulator/training/stages/base.py:Run.train_stage gesticulator/training/stages/base.py:finished
        gesticulator/training/stages/base.py:keep gesticulator/training/stages/caches.py:_encode_one
        gesticulator/training/stages/caches.py:read_arrays gesticulator/training/stages/caches.py:whole
        gesticulator/training/stages/corpus.py:Corpus.sound
        gesticulator/training/stages/rows.py:StoredRows.__init__ gesticulator/training/stages/rows.py:StoredRows._read
        gesticulator/training/stages/rows.py:_to_member gesticulator/training/stages/stored.py:_write
        gesticulator/training/stages/stored.py:written gesticulator/training/stages/training.py:TimedRun.times
        gesticulator/training/stages/training.py:claim interpreters/episodes.py:Episodes.load""",
    "an evaluation's own work folder": """
        eval/acceptance/motion/command.py:run eval/baselines/unit_selection.py:_read
        eval/rows/cells.py:CellStore._append eval/rows/cells.py:CellStore.gather eval/rows/cells.py:CellStore.lines
        eval/ablate/figures.py:_key_of eval/context.py:_reward_model eval/ablate/racer.py:_trained
        eval/renderings.py:KeptRenderings.get eval/renderings.py:Rendering.unpacked
        eval/runner/judge.py:PlayedStore.read eval/runner/played.py:VoicePlayer._kept
        eval/runner/played_reward.py:kept""",
    "calls a reader that has a case": """
        data_module/corpora/base.py:load data_module/corpora/performer.py:Performer._reading
        data_module/corpora/ted.py:Ted.read eval/runner/ablate.py:ablate eval/runner/ablate.py:redraw
        eval/runner/rg.py:RgRows.clips eval/probes/face.py:run gesticulator/training/face.py:recordings_of
        gesticulator/page/session.py:EditSession.exported gesticulator/page/session.py:EditSession.opened
        gesticulator/page/export.py:exported
        gesticulator/bundle/models.py:StoredParts.__getitem__ gesticulator/serve/connection.py:Connection._hello
        gesticulator/serve/connection.py:Connection._read gesticulator/page/session.py:EditSession.answer
        gesticulator/serve/session.py:Session._add_words interpreters/base.py:opened""",
    "the bytes are hashed, copied or thrown away, not parsed": """
        data_module/corpora/smartbody.py:SmartBody.write data_module/text/word_vectors.py:_fingerprint
        gesticulator/batch/run.py:file_hash gesticulator/export/html.py:character_data
        gesticulator/serve/connection.py:Connection._swallow eval/renderings.py:program_key""",
    "a file that this process, its worker or its child wrote a moment ago": """
        data_module/files.py:_holder data_module/performer/espeak.py:_spoken
        data_module/performer/flite.py:timed_phrase gesticulator/characters/fbx_rig.py:read_fbx_character
        gesticulator/export/fbx.py:write_fbx gesticulator/export/film.py:_frame
        gesticulator/export/film.py:encode_pictures
        gesticulator/export/own_fbx.py:write_animated gesticulator/export/usd.py:write_usd
        gesticulator/serve/metrics.py:read_figures eval/probes/stability.py:_as_mp3
        gesticulator/characters/blender.py:_Worker.wait gesticulator/characters/blender.py:_Worker._last_line""",
    "messages of another process of the same server": """
        gesticulator/serve/output_process.py:_play gesticulator/serve/relay.py:_goes_on
        gesticulator/serve/relay.py:relay gesticulator/serve/relay.py:_carry""",
    "runs in a child process, whose parent has a case": """
        data_module/performer/espeak_child.py:main data_module/speech/mp3_child.py:main
        gesticulator/export/fbx_child.py:animate gesticulator/characters/blender_jobs.py:main""",
    "Gesticulator.read, whose transcripts have a case": """
        eval/probes/stability.py:_words_changed""",
    "a file of the installation": """
        gesticulator/batch/ray_pool.py:_runs_here gesticulator/serve/page.py:pages gesticulator/version.py:_is_ours
        eval/probes/meaning.py:judgements""",
    "a model that another library reads": """
        data_module/speech/learned_front_ends.py:_open data_module/text/alignment.py:_loaded_decoder
        eval/metrics/stressed_vowels.py:_decoder
        data_module/text/word_vectors.py:_load""",
    "LMDB's library maps the file into memory and trusts it; each value that it gives has a case": """
        data_module/corpora/ted.py:_database""",
}
"""Why a reader has no case -> the readers, "file:Class.function"."""


def _found() -> dict[str, list[str]]:
    """Every reader of the packages and what it reads with."""
    return {f"{file.relative_to(ROOT).as_posix()}:{function}": calls
            for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))
            for function, calls in readers_of(file.read_text(encoding="utf-8")).items()}


def _run(case: Case, file: Path) -> set[CodeType]:
    """The code of every function that runs while a case reads a file."""
    ran: set[CodeType] = set()
    with warnings.catch_warnings(), profiled(lambda frame, event, _: ran.add(frame.f_code)):
        warnings.simplefilter("ignore")
        case.read(file)
    return ran


def _reached(folder: Path) -> dict[str, list[str]]:
    """Every function of the packages that runs while the sample of a case is read, with the cases."""
    for module in [module for name, module in sys.modules.items() if name.partition(".")[0] in PACKAGES]:
        for value in vars(module).values():
            getattr(value, "cache_clear", int)()  # a file that another test has read is read again
    reached: dict[str, list[str]] = {}
    for number, (name, case) in enumerate(READERS.items()):
        place = folder / str(number)
        place.mkdir()
        for code in _run(case, case.sample(place)):
            if Path(code.co_filename).is_relative_to(ROOT):
                where = f"{Path(code.co_filename).relative_to(ROOT).as_posix()}:{code.co_qualname}"
                reached.setdefault(where, []).append(name)
    return reached


def test_every_reader_has_a_case_or_a_reason_to_have_none(tmp_path: Path) -> None:
    """`NO_CASE` is checked both ways: a reader that has a case by now, or is gone, has to leave it."""
    for extra in ("av", "pyarrow"):
        pytest.importorskip(extra)
    found, reached = _found(), _reached(tmp_path)
    excused = {name for names in NO_CASE.values() for name in names.split()}
    lacking = {name: calls for name, calls in found.items() if name not in reached and name not in excused}
    assert not lacking, f"no case of reader_cases.READERS runs these: {lacking}"
    stale = sorted(excused - found.keys() | excused & reached.keys())
    assert not stale, f"these have a case by now, or are no readers: {stale}"
    assert {f"transcript {suffix}" for suffix in FORMATS} <= set(READERS)


PLANTED = '''
import json
import struct
from pathlib import Path

import numpy as np
import soundfile as sf

from data_module import files
from data_module.files import read_json as loaded


class Thing:
    def settings(self, place):
        return loaded(place, "again")

    @classmethod
    def of(cls, place):
        with Path(place).open("rb") as stream:
            def head():
                return struct.unpack("<I", stream.read(4))
            return head()


def weights(place):
    return np.load(place)


def wave(place):
    import zipfile
    return sf.read(zipfile.ZipFile(place).open("member"))


def table(place):
    return files.read_table(place, "again")


def seconds(text):
    try:
        return float(text)
    except (TypeError, ValueError):
        return None


async def packet(socket):
    return await socket.recv()


def plain(place, value):
    np.save(place, value)
    with open(place, "w") as stream, Path(place).open(mode="wb"):
        stream.write(json.dumps(value))
    return float(value), json.loads(json.dumps(value)), value.copy()
'''


def test_a_reader_is_found_by_what_it_does() -> None:
    assert readers_of(PLANTED) == {
        "Thing.settings": ["data_module.files.read_json"], "Thing.of": ["pathlib.Path().open"],
        "Thing.of.<locals>.head": ["?stream.read", "struct.unpack"], "weights": ["numpy.load"],
        "wave": ["soundfile.read", "zipfile.ZipFile", "zipfile.ZipFile().open"],
        "table": ["data_module.files.read_table"], "seconds": ["a number of a text"], "packet": ["?socket.recv"]}

"""Every reader of files against broken files: only `InputError` comes out, within 500,000 calls and 500 MB.

A real file of each kind is written, damaged as disks, programs and people damage files (flipped bits, a cut end,
pieces that are missing or there twice, foreign bytes, numbers far too large), and read. A file that happens to be still
good may be read. A new reader is a new entry of `READERS`: a test below finds each function that reads files or parses
text by what it calls (`reader_finder`), runs every case, and names the readers that none of them ran.
"""

import sys
import warnings
from fnmatch import fnmatchcase
from pathlib import Path
from types import CodeType

import pytest
from damaged import check_damaged
from reader_cases import READERS, Case
from reader_finder import readers_of

from data_module.text.transcript import FORMATS


@pytest.mark.parametrize("name", READERS)
def test_only_input_errors_come_out_of_damaged_files(name: str, tmp_path: Path) -> None:
    check_damaged(READERS[name], tmp_path)


# ---------------------------------------------------------------------------------------------------- completeness

ROOT = Path(__file__).parents[1]
PACKAGES = ("data_module", "gesticulator", "eval", "lexicon", "interpreters", "generator")
NO_CASE = {
    "a file of the program itself": """
        gesticulator/plan/gestures.py:<module> gesticulator/directing/meaning_cues.py:meaning_cues
        gesticulator/export/html.py:_asset""",
    "an option of the command line, tested with what is no number": "gesticulator/export/clip.py:parse_keys",
    "a build's own work folder, where a file that is cut counts as missing": "data_module/store.py:StoreWriter.*",
    "a training's own work folder": "gesticulator/training/*",
    "an evaluation's own work folder": "eval/acceptance/*:* eval/ablate/*:* eval/context.py:*",
    "calls a reader that has a case": """
        data_module/corpora/base.py:load data_module/corpora/ted.py:Ted.read data_module/corpora/genea.py:Genea.read
        gesticulator/live/*:* gesticulator/bundle/models.py:StoredPart.read gesticulator/bundle/command.py:_run
        interpreters/base.py:opened""",
    "the bytes are hashed, copied or thrown away, not parsed": """
        data_module/text/word_vectors.py:_fingerprint gesticulator/bundle/files.py:replace_folder
        gesticulator/export/html.py:character_data gesticulator/page/edits.py:Edits.save""",
    "a file that this process, its worker or its child wrote a moment ago": """
        data_module/files.py:lock gesticulator/characters/blender.py:_converted
        gesticulator/export/fbx.py:write_fbx gesticulator/export/film.py:* gesticulator/export/usd.py:write_usd""",
    "the note that pip left beside this distribution": "data_module/errors.py:install_line",
    "runs in a child process, whose parent has a case": "gesticulator/export/blender_child.py:compare_materials",
    "a model that another library reads": """
        data_module/text/alignment.py:_loaded_decoder data_module/text/word_vectors.py:_bert
        data_module/text/word_vectors.py:WordEncoder.open
        gesticulator/gesticulator.py:Gesticulator.word_encoder""",
    "LMDB's library maps the file into memory and trusts it; each value that it gives has a case": """
        data_module/corpora/ted.py:_database""",
}
"""Why a reader has no case -> patterns of readers, "file:Class.function"."""


def _found() -> dict[str, list[str]]:
    """Every reader of the packages and what it reads with."""
    return {f"{file.relative_to(ROOT).as_posix()}:{function}": calls
            for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))
            for function, calls in readers_of(file.read_text(encoding="utf-8")).items()}


def _run(case: Case, file: Path) -> set[CodeType]:
    """The code of every function that runs while a case reads a file."""
    ran: set[CodeType] = set()
    before = sys.getprofile()
    sys.setprofile(lambda frame, event, _: ran.add(frame.f_code))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            case.read(file)
    finally:
        sys.setprofile(before)
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
    for extra in ("av", "pyarrow"):
        pytest.importorskip(extra)
    reached, excused = _reached(tmp_path), [pattern for patterns in NO_CASE.values() for pattern in patterns.split()]
    lacking = {name: calls for name, calls in _found().items()
               if name not in reached and not any(fnmatchcase(name, pattern) for pattern in excused)}
    assert not lacking, f"no case of reader_cases.READERS runs these: {lacking}"
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

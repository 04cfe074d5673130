"""gesticulator build CORPUS --out STORE (python -m data_module.build): read or make a data set, and write its store.

    gesticulator build performer --source DIR --out STORE    # DIR holds strokes/ and speech/
    gesticulator build performer --preset tiny --out STORE   # three minutes, in seconds, from nothing
    gesticulator build folder --source DIR --out STORE       # your own NAME.bvh beside NAME.wav
    gesticulator build trinity --source DIR --out STORE      # somebody's data set; --help lists them all
    gesticulator build smartbody --source DIR --out STROKES  # the performer's strokes, from what is published

An interrupted build is resumed; the result does not depend on that, nor on the number of workers. A report (minutes,
blocks, intervals, units, missing joints, omissions with reasons) is printed and written to STORE/report.json.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from data_module import build_report as reports
from data_module.build_report import Outcome, Report
from data_module.errors import InputError, one_line_errors
from data_module.files import lock, remove_unfinished, write_text

if TYPE_CHECKING:
    from data_module.corpora.base import Item, Options
    from data_module.truth import Truth

DATASET = "dataset"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass
class Workshop:
    """The data that a worker needs to make recordings; opened once per process."""

    corpus: str
    source: Path | None
    options: Options
    writer: Any
    dataset: Path | None
    reader: Any = field(default=None, repr=False)

    def outcome_file(self, item: Item) -> Path:
        """The file of a recording's outcome until the end of the build."""
        return Path(self.writer.partial / "recordings" / f"{item.info.name}.report")

    def outcome(self, item: Item) -> Outcome | None:
        try:
            return Outcome.from_json(self.outcome_file(item).read_text(encoding="utf-8"))
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def made(self, item: Item) -> Outcome | None:
        """The outcome of a recording that an interrupted build had finished in store, report and data set; else None.
        """
        name, outcome = item.info.name, self.outcome(item)
        whole = outcome is not None and self.writer.has(name) and (
            self.dataset is None or (self.dataset / f"{name}.json").is_file())
        return outcome if whole else None

    def make(self, item: Item) -> Outcome:
        outcome = self._written(item)
        write_text(self.outcome_file(item), outcome.as_json())
        return outcome

    def _written(self, item: Item) -> Outcome:
        import warnings

        from data_module import intervals
        from data_module.corpora.base import DroppedError, Imported, load
        from data_module.corpora.folder import write_recording
        from data_module.corpora.table import open_corpus
        from data_module.motion import skeletons
        from data_module.motion.relaxed_hands import with_relaxed_hands
        from data_module.motion.standing_legs import with_standing_legs

        if self.reader is None:
            self.reader = open_corpus(self.corpus, self.source, self.options)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            try:
                recording = load(self.reader, item)
                character = with_relaxed_hands(skeletons.to_character(recording.motion,
                                                                      skeleton=skeletons.WHOLE_BODY))
                if recording.stands:
                    character = with_standing_legs(character)
            except DroppedError as reason:
                return Outcome(item.info.name, dropped=str(reason))
            except InputError as error:
                if error.subject != "skeleton":
                    raise
                return Outcome(item.info.name, dropped=str(error))
        if self.dataset is not None:
            write_recording(self.dataset, recording)
        blocks, apart = intervals.measure(recording.speech)
        known = "given" if recording.speech.words else ""
        unit, words = (recording.unit, recording.words) if isinstance(recording, Imported) else ("", known)
        messages = tuple(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, UserWarning)))
        self.writer.add(recording, character)
        return Outcome(item.info.name, recording.speech.duration, character.absent, blocks, apart.as_json(), unit,
                       words, warnings=messages, meanings=_meanings(recording.truth))


def _meanings(truth: Truth | None) -> dict[str, tuple[int, int]]:
    """Label of each gesture with a meaning -> how many come from clips and from scripts."""
    from data_module.truth import SCRIPTED

    out: dict[str, tuple[int, int]] = {}
    for stroke in truth.strokes if truth else ():
        if stroke.meaning:
            clips, scripts = out.get(stroke.meaning, (0, 0))
            drawn = stroke.clip.startswith(SCRIPTED)
            out[stroke.meaning] = (clips + (not drawn), scripts + drawn)
    return out


Making: TypeAlias = "Callable[[Workshop, Sequence[Item]], Iterator[Outcome]]"
"""Makes recordings in any order and yields their outcomes, except for those that failed."""


@dataclass(frozen=True)
class BuildRequest:
    """A request to build the store `out` of a corpus, and with `dataset` the data set `out`/dataset."""

    corpus: str
    source: Path | None
    out: Path
    options: Options
    dataset: bool = True


def build(request: BuildRequest, making: Making | None = None, progress: bool = True) -> Report:
    """Build a store; making: by default in this process, in sequence. An existing store with the same settings is not
    changed. `InputError` if it has other settings, if nothing is usable, if recordings failed, or if another process
    builds there."""
    begun = time.monotonic()
    with lock(request.out, "a build", beside=True):
        site = _Site.opened(request)
        if isinstance(site, Report):
            return site
        outcomes = {outcome.name: outcome for outcome in site.build(site.items, making or one_by_one, progress)}
        return replace(site.finish(outcomes), elapsed=time.monotonic() - begun)


def build_share(request: BuildRequest, making: Making, mine: Callable[[Sequence[Item]], Sequence[Item]],
                progress: bool = True) -> list[Outcome] | None:
    """Make the recordings of a store selected by `mine`, in parallel with other processes; their outcomes (also of
    existing recordings), or None if the store exists. The store is finished by `build`. `InputError` as there."""
    with lock(request.out, "a share of a build", beside=True, shared=True):
        site = _Site.opened(request)
        return None if isinstance(site, Report) else list(site.build(mine(site.items), making, progress))


@dataclass
class _Site:
    """An unfinished build. reused: number of existing recordings."""

    request: BuildRequest
    workshop: Workshop
    items: Sequence[Item]
    reused: int = 0

    @classmethod
    def opened(cls, request: BuildRequest) -> _Site | Report:
        """A new or resumed build; or the report of an existing store."""
        from data_module import store
        from data_module.corpora.table import open_corpus

        begun, corpus, source, out = time.monotonic(), request.corpus, request.source, request.out
        reader = open_corpus(corpus, source, request.options)
        settings, seed = dict(reader.settings()), request.options.seed
        there = store.matching(out, corpus, settings, seed)
        if there is not None:
            if request.dataset and not (out / DATASET).is_dir():
                raise InputError(out, "was built without its data set", "delete it, or say --no-dataset")
            return Report(there, reports.report_of(there), time.monotonic() - begun, len(there.recordings))
        writer = store.StoreWriter(out, corpus, settings, seed, reader.licence)
        folder = writer.partial / DATASET if request.dataset else None
        if folder is not None:
            folder.mkdir(exist_ok=True)
        return cls(request, Workshop(corpus, source, request.options, writer, folder, reader), reader.items())

    def build(self, items: Sequence[Item], making: Making, progress: bool) -> Iterator[Outcome]:
        from tqdm import tqdm

        todo = []
        for item in items:
            there = self.workshop.made(item)
            if there is None:
                todo.append(item)
            else:
                yield there
        self.reused = len(items) - len(todo)
        # A reader is opened again in each process. None: no bar if the output is not a terminal.
        with tqdm(total=len(todo), unit="recording", disable=None if progress else True) as bar:
            for outcome in making(replace(self.workshop, reader=None), todo):
                bar.update()
                yield outcome

    def finish(self, outcomes: Mapping[str, Outcome]) -> Report:
        workshop, items, writer = self.workshop, self.items, self.workshop.writer
        failed = [item.info.name for item in items if item.info.name not in outcomes]
        if failed:
            raise InputError(self.request.out, f"is not finished: {len(failed)} of {len(items)} recordings failed, "
                             f"such as {failed[0]}", "correct them and build again; finished recordings are kept")
        usable = [item.info for item in items if not outcomes[item.info.name].dropped]
        if not usable:
            reason = next((outcome.dropped for outcome in outcomes.values()), "it is empty")
            writer.discard()
            raise InputError(workshop.source or workshop.corpus, f"has no recording that can be used ({reason})",
                             "see the formats in --help")
        if workshop.dataset is not None:
            for info in usable:
                _share(writer.partial / "recordings" / f"{info.name}.flac", workshop.dataset / f"{info.name}.flac")
        infos = [replace(info, seconds=outcomes[info.name].seconds, absent=outcomes[info.name].absent)
                 for info in usable]
        content = reports.summary(infos, [outcomes[item.info.name] for item in items], workshop.reader.notes())
        write_text(writer.partial / reports.FILE, json.dumps(content, indent=1, ensure_ascii=False))
        remove_unfinished(writer.partial)
        return Report(writer.finish([info.name for info in usable]), content, 0.0, self.reused)


def one_by_one(workshop: Workshop, items: Sequence[Item]) -> Iterator[Outcome]:
    return map(workshop.make, items)


_workshop: Workshop | None = None


def in_processes(workers: int, workshop: Workshop, items: Sequence[Item]) -> Iterator[Outcome]:
    """Make recordings in so many processes."""
    if workers <= 1:
        yield from one_by_one(workshop, items)
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed

    # Spawned, not forked: the same on every system, and numpy reads the number of threads anew.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(items) or 1), context, _begin, (workshop,)) as pool:
        futures = [pool.submit(_work, item) for item in items]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _begin(workshop: Workshop) -> None:
    global _workshop
    for variable in _ONE_THREAD:
        os.environ[variable] = "1"
    _workshop = workshop
    end_with_parent()


def end_with_parent() -> None:
    """End a worker when its parent was killed; it would wait for work forever."""
    import multiprocessing
    import threading

    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _work(item: Item) -> Outcome:
    if _workshop is None:
        raise RuntimeError("the worker was not begun")
    return _workshop.make(item)


def _share(file: Path, place: Path) -> None:
    """The same file in two places: a hard link if possible, else a copy."""
    import shutil

    place.unlink(missing_ok=True)
    try:
        os.link(file, place)
    except OSError:
        shutil.copyfile(file, place)


def _formats() -> str:
    import textwrap

    from data_module.corpora.table import CORPORA, STROKE_SOURCES

    names = {**CORPORA, **STROKE_SOURCES}
    width = max(map(len, names))
    lines = [textwrap.fill(entry.about, 118, initial_indent=f"  {name:<{width}}  ", subsequent_indent=" " * (width + 4))
             for name, entry in names.items()]
    title = "corpora, and what SOURCE contains (the modules in data_module/corpora show the folders):"
    return "\n".join([title, *lines])


def _make_strokes(name: str, source: Path | None, out: Path, options: Options) -> int:
    """Clips without speech: `out` becomes the folder strokes/ that the performer plays, not a store."""
    from data_module.corpora.table import open_strokes

    with lock(out, "a build", beside=True):
        maker = open_strokes(name, source, options)
        count = maker.write(out)
    print(f"{out}: {count} strokes, with manifest.csv; the performer takes them as SOURCE/strokes")
    for note in maker.notes():
        print(f"  {note}")
    print(f"  licence: {maker.licence}")
    return 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of a build, and in the epilog the list of data sets."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _formats() + (f"\n\n{parser.epilog}" if parser.epilog else "")
    parser.add_argument("corpus", help="one of the names below")
    parser.add_argument("--source", type=Path, metavar="DIR",
                        help="the source data (performer: default is the variable GESTICULATOR_DATA)")
    parser.add_argument("--out", type=Path, required=True, metavar="STORE", help="output folder")
    parser.add_argument("--seed", type=int, default=1, help="performer: random seed of the corpus (default 1)")
    parser.add_argument("--hours", type=float, default=4.2, help="performer: hours of synthetic speech (default 4.2)")
    parser.add_argument("--links", type=float, default=1.0, metavar="SHARE",
                        help="performer: strength of the links between speech and motion that it plants by rule "
                        "(stroke size and trunk by vocal effort, chest by pitch, gestures by meaning, styles), from 0 "
                        "to 1 (default 1)")
    parser.add_argument("--carriage", type=float, default=0.0, metavar="SHARE",
                        help="performer: strength of a further link, by which the hands are carried higher and farther "
                        "out with vocal effort and pitch range, from 0 to 1, times --links (default 0)")
    parser.add_argument("--repertoire", type=Path, metavar="DIR",
                        help="performer: takes of named gestures (gesticulator gestures --takes DIR), which it plays "
                        "at words that call for them; gesticulator build draws them if DIR does not exist")
    parser.add_argument("--preset", choices=("default", "tiny"), default="default",
                        help="performer: tiny is three minutes, which need no data and no other program")
    parser.add_argument("--languages", default="", metavar="de,es",
                        help="performer: only talks and readings in these languages: cmn, de, en, es (default: "
                        "English talks and all readings)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1,
                        help="number of processes (default: one per core)")
    parser.add_argument("--no-dataset", action="store_true", help="write only the store, without BVH files")
    parser.add_argument("--fps", type=float, help="frames per second, if the header of the BVH files is wrong")
    parser.add_argument("--unit", type=float, help="metres per unit of the BVH files, if not as reported")
    parser.add_argument("--split", default="", metavar="80/10/10|FILE",
                        help="folder: percentages for training, validation and test (default 80/10/10, with at least "
                        "one recording in each if there are three), or a file with a line NAME,train|val|test per "
                        "recording")
    parser.add_argument("--speaker", default="", metavar="NAME|REGEX",
                        help="folder: the speaker of every recording, or a pattern whose group matches it in the file "
                        "name, such as '^([a-z]+)' (default: the part before the first '_' if several recordings "
                        "share it, else the folder's name)")
    parser.add_argument("--verbose", action="store_true", help="print the histogram of intervals between onsets too")
    parser.add_argument("--histogram", type=Path, metavar="FILE.png",
                        help="plot the intervals between onsets and between beats (needs matplotlib)")


def _check_histogram(file: Path) -> None:
    import importlib.util

    if file.suffix.lower() != ".png" or not file.parent.is_dir():
        raise InputError(file, "cannot be written", "give a .png file in a folder that is there")
    if importlib.util.find_spec("matplotlib") is None:
        raise InputError("--histogram", "needs matplotlib, which is not installed",
                         "pip install 'gesticulator[figures]'")


def asked_for(arguments: argparse.Namespace) -> BuildRequest:
    """The request in `arguments`; InputError for invalid ones."""
    for variable in _ONE_THREAD:
        os.environ.setdefault(variable, "1")
    from data_module.corpora.base import Options

    for name in ("hours", "workers", "fps", "unit"):
        value = getattr(arguments, name)
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"--{name}", f"is {value:g}", "give a number above 0")
    for name in ("links", "carriage"):
        if not 0 <= getattr(arguments, name) <= 1:
            raise InputError(f"--{name}", f"is {getattr(arguments, name):g}", "give a number from 0 to 1")
    if arguments.seed < 0:
        raise InputError("--seed", f"is {arguments.seed}", "give 0 or more")
    source = arguments.source
    if source is None and arguments.corpus == "performer" and arguments.preset != "tiny":
        data = os.environ.get("GESTICULATOR_DATA")
        source = Path(data) if data else None
    for name in ("split", "speaker"):
        if getattr(arguments, name) and arguments.corpus != "folder":
            raise InputError(f"--{name}", f"is only for folder, not for {arguments.corpus}", "leave it out")
    if arguments.histogram is not None:
        _check_histogram(arguments.histogram)
    languages = tuple(filter(None, arguments.languages.split(",")))
    options = Options(arguments.seed, arguments.hours, arguments.preset, arguments.fps, arguments.unit, languages,
                      arguments.split, arguments.speaker, arguments.links, arguments.carriage, arguments.repertoire)
    return BuildRequest(arguments.corpus, source, arguments.out, options, not arguments.no_dataset)


def run(arguments: argparse.Namespace, making: Making | None = None) -> int:
    """Build the request in `arguments` and print the report; making: see `build` (by default in --workers processes).
    Returns 0; InputError if the input cannot be used."""
    request = asked_for(arguments)
    from data_module.corpora.table import STROKE_SOURCES

    if request.corpus in STROKE_SOURCES:
        return _make_strokes(request.corpus, request.source, request.out, request.options)
    report = build(request, making or partial(in_processes, arguments.workers))
    for line in report.lines(arguments.verbose):
        print(line)
    if arguments.histogram is not None:
        from data_module import intervals

        intervals.draw(arguments.histogram, report.intervals(), f"{report.store.corpus} ({report.store.path.name})")
        print(f"  {arguments.histogram}: the histogram of intervals")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """The command. Returns 0; exits with 2 and one line if the input cannot be used."""
    parser = argparse.ArgumentParser(
        prog="python -m data_module.build", formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Read or make a data set, write its store, and report what is in it.")
    add_arguments(parser)
    arguments = parser.parse_args(argv)
    with one_line_errors("build"):
        return run(arguments)


if __name__ == "__main__":
    sys.exit(main())

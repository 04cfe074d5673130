"""gesticulator build CORPUS --out STORE (python -m data_module.build): read or make a data set, and write its store.

    gesticulator build performer --source DIR --out STORE    # DIR holds strokes/ and speech/
    gesticulator build performer --preset tiny --out STORE   # three minutes, in seconds, from nothing
    gesticulator build folder --source DIR --out STORE       # your own NAME.bvh beside NAME.wav
    gesticulator build trinity --source DIR --out STORE      # somebody's data set; --help lists them all
    gesticulator build smartbody --source DIR --out STROKES  # the performer's strokes, from what is published

A build that was stopped goes on where it was; the result does not depend on that, nor on the number of workers. What
was found (minutes, blocks, intervals, units, joints that are lacking, what was left out and why) is printed and kept in
STORE/report.json.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module import build_report as reports
from data_module.build_report import Outcome, Report
from data_module.errors import InputError, one_line_errors
from data_module.files import lock, remove_unfinished, write_text

if TYPE_CHECKING:
    from data_module.corpora import Item, Options
    from data_module.store import StoreWriter

DATASET = "dataset"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass
class _Workshop:
    """What a worker needs to make recordings; opened once per process."""

    corpus: str
    source: Path | None
    options: Options
    writer: Any
    dataset: Path | None
    reader: Any = field(default=None, repr=False)

    def make(self, item: Item) -> Outcome:
        """Read one recording and write it into the data set and the store, the mark of completion last."""
        import warnings

        from data_module import corpora, intervals
        from data_module.corpora.folder import write_recording
        from data_module.motion import skeletons
        from data_module.motion.relaxed_hands import with_relaxed_hands
        from data_module.motion.standing_legs import with_standing_legs

        if self.reader is None:
            self.reader = corpora.open_corpus(self.corpus, self.source, self.options)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            try:
                recording = corpora.load(self.reader, item)
                character = with_relaxed_hands(skeletons.to_character(recording.motion,
                                                                      skeleton=skeletons.WHOLE_BODY))
                if recording.stands:
                    character = with_standing_legs(character)
            except corpora.DroppedError as reason:
                return Outcome(item.info.name, dropped=str(reason))
            except InputError as error:
                if error.subject != "skeleton":
                    raise
                return Outcome(item.info.name, dropped=str(error))
        if self.dataset is not None:
            write_recording(self.dataset, recording)
        blocks, apart = intervals.measure(recording.speech)
        known = "given" if recording.speech.words else ""
        unit, words = (recording.unit, recording.words) if isinstance(recording, corpora.Imported) else ("", known)
        said = tuple(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, UserWarning)))
        outcome = Outcome(item.info.name, recording.speech.duration, character.absent, blocks, apart.as_json(), unit,
                          words, warnings=said)
        write_text(_outcome_file(self.writer, item), outcome.as_json())
        self.writer.add(recording, character)
        return outcome


def _outcome_file(writer: StoreWriter, item: Item) -> Path:
    """Where a recording's outcome waits for the end of the build; the finished store has it in its report."""
    return Path(writer.partial / "recordings" / f"{item.info.name}.report")


def build(corpus: str, source: Path | None, out: Path, options: Options, *, workers: int = 1, dataset: bool = True,
          progress: bool = True) -> Report:
    """Build the store `out` of a corpus, with `workers` processes, and the data set `out`/dataset when asked.

    A store that is there already with the same settings is left as it is. `InputError` when it has other settings,
    when nothing can be used, or while another process builds there.
    """
    with lock(out, "a build", beside=True):
        return _build(corpus, source, out, options, workers, dataset, progress)


def _build(corpus: str, source: Path | None, out: Path, options: Options, workers: int, dataset: bool,
           progress: bool) -> Report:
    from data_module import corpora, store

    begun = time.monotonic()
    reader = corpora.open_corpus(corpus, source, options)
    settings = dict(reader.settings())
    there = store.matching(out, corpus, settings, options.seed)
    if there is not None:
        if dataset and not (out / DATASET).is_dir():
            raise InputError(out, "was built without its data set", "delete it, or say --no-dataset")
        return Report(there, reports.report_of(there), time.monotonic() - begun, len(there.recordings))
    writer = store.StoreWriter(out, corpus, settings, options.seed, reader.licence)
    folder = writer.partial / DATASET if dataset else None
    if folder is not None:
        folder.mkdir(exist_ok=True)
    items = reader.items()
    todo = [item for item in items if not _is_done(writer, folder, item)]
    waiting = {item.info.name for item in todo}
    outcomes = {item.info.name: Outcome.from_json(_outcome_file(writer, item).read_text(encoding="utf-8"))
                for item in items if item.info.name not in waiting}
    workshop = _Workshop(corpus, source, options, writer, folder)
    outcomes |= {outcome.name: outcome for outcome in _made(workshop, todo, workers, progress)}
    kept = [item.info for item in items if not outcomes[item.info.name].dropped]
    if not kept:
        reason = next((outcome.dropped for outcome in outcomes.values()), "it is empty")
        writer.discard()
        raise InputError(source or corpus, f"has no recording that can be used ({reason})", "see the formats in --help")
    if folder is not None:
        for info in kept:
            _share(writer.partial / "recordings" / f"{info.name}.flac", folder / f"{info.name}.flac")
    infos = [replace(info, seconds=outcomes[info.name].seconds, absent=outcomes[info.name].absent) for info in kept]
    told = reports.summary(infos, [outcomes[item.info.name] for item in items], reader.notes())
    write_text(writer.partial / reports.FILE, json.dumps(told, indent=1, ensure_ascii=False))
    remove_unfinished(writer.partial)
    finished = writer.finish([info.name for info in kept])
    return Report(finished, told, time.monotonic() - begun, len(items) - len(todo))


def _is_done(writer: StoreWriter, folder: Path | None, item: Item) -> bool:
    """Whether a build that was stopped had finished this recording, whole, in store, report and data set."""
    name = item.info.name
    try:
        Outcome.from_json(_outcome_file(writer, item).read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError, KeyError):
        return False
    return (writer.has(name)
            and (folder is None or (folder / f"{name}.json").is_file()))


def _made(workshop: _Workshop, items: Sequence[Item], workers: int, progress: bool) -> Iterator[Outcome]:
    from tqdm import tqdm

    # None: no bar where the output is no terminal.
    with tqdm(total=len(items), unit="recording", disable=None if progress else True) as bar:
        results = map(workshop.make, items) if workers <= 1 else _in_parallel(workshop, items, workers)
        for outcome in results:
            bar.update()
            yield outcome


_workshop: _Workshop | None = None


def _in_parallel(workshop: _Workshop, items: Sequence[Item], workers: int) -> Iterator[Outcome]:
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


def _begin(workshop: _Workshop) -> None:
    global _workshop
    for variable in _ONE_THREAD:
        os.environ[variable] = "1"
    _workshop = workshop
    _end_with_parent()


def _end_with_parent() -> None:
    """A worker whose build was killed would wait for work for ever."""
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
    """The same file in two places: a hard link where the disk can, a copy elsewhere."""
    import shutil

    place.unlink(missing_ok=True)
    try:
        os.link(file, place)
    except OSError:
        shutil.copyfile(file, place)


_FORMATS = """\
what can be read, and what SOURCE is (each reader's own file in data_module/corpora draws its folders):
  performer  scripted performances of real strokes (SOURCE/strokes) on real (SOURCE/speech) and synthetic speech
  folder     your own NAME.bvh of any rig beside NAME.flac, .wav, .mp3 or .ogg, and what is said, where you have it, as
             NAME.TextGrid, NAME.json (words with times), NAME.srt, NAME.vtt or NAME.txt
  trinity    Trinity Speech-Gesture: GENEA_Challenge_2020_data_release, with Training_data/ and Test_data/
  zeroeggs   ZeroEGGS: its folder data, with clean/ and info.csv
  mocca      MOCCA Gesture Dataset: speakerNN_clipNN.bvh, .wav and .srt
  beat       BEAT: beat_english_v0.2.1, with a folder per speaker
  beat2      BEAT2: beat_english_v2.0.0, with smplxflame_30/, wave16k/ and train_test_split.csv
  ted        TED Gesture: ted_dataset, with lmdb_train/, lmdb_val/ and lmdb_test/
  smartbody  SmartBody's data/behaviorsets; makes the folder strokes/ for the performer instead of a store
"""


def _make_strokes(name: str, source: Path | None, out: Path, options: Options) -> int:
    """Clips without speech: `out` becomes the folder strokes/ that the performer plays, not a store."""
    from data_module import corpora

    with lock(out, "a build", beside=True):
        maker = corpora.open_strokes(name, source, options)
        count = maker.write(out)
    print(f"{out}: {count} strokes, with manifest.csv; the performer takes them as SOURCE/strokes")
    for note in maker.notes():
        print(f"  {note}")
    print(f"  licence: {maker.licence}")
    return 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What a build takes, and at the end of the help what can be read."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _FORMATS + (f"\n{parser.epilog}" if parser.epilog else "")
    parser.add_argument("corpus", help="one of those below")
    parser.add_argument("--source", type=Path, metavar="DIR",
                        help="the data to build from (performer: default is the variable GESTICULATOR_DATA)")
    parser.add_argument("--out", type=Path, required=True, metavar="STORE", help="the folder to write")
    parser.add_argument("--seed", type=int, default=1, help="performer: another seed, another corpus (default 1)")
    parser.add_argument("--hours", type=float, default=4.2, help="performer: synthetic speech to make (default 4.2)")
    parser.add_argument("--preset", choices=("default", "tiny"), default="default",
                        help="performer: tiny is three minutes that need no data and no other program")
    parser.add_argument("--languages", default="", metavar="de,es", help="performer: talks and readings in these "
                        "languages only: cmn, de, en, es (default: English talks, and every reading)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one per core)")
    parser.add_argument("--no-dataset", action="store_true", help="write the store only, no BVH files")
    parser.add_argument("--fps", type=float, help="frames per second, where the header of BVH files is wrong")
    parser.add_argument("--unit", type=float, help="metres per unit of BVH files, where it is not as reported")
    parser.add_argument("--split", default="", metavar="80/10/10|FILE", help="folder: shares in percent for training, "
                        "validation and test (default 80/10/10, with a recording at least in each where there are "
                        "three), or a file with a line NAME,train|val|test for each recording")
    parser.add_argument("--speaker", default="", metavar="NAME|REGEX", help="folder: who gestures in every recording, "
                        "or a pattern whose group finds it in the file's name, such as '^([a-z]+)' (default: what "
                        "stands before the first '_' where several recordings share it, else the folder's name)")
    parser.add_argument("--histogram", type=Path, metavar="FILE.png",
                        help="draw the intervals between onsets and between beats (needs matplotlib)")


def _check_histogram(file: Path) -> None:
    """Before an hour of work, not after it."""
    import importlib.util

    if file.suffix.lower() != ".png" or not file.parent.is_dir():
        raise InputError(file, "cannot be written", "give a .png file in a folder that is there")
    if importlib.util.find_spec("matplotlib") is None:
        raise InputError("--histogram", "needs matplotlib, which is not installed",
                         "pip install 'gesticulator[figures]'")


def run(arguments: argparse.Namespace) -> int:
    """Build what `arguments` ask for and print the report. Returns 0; InputError when the input cannot be used."""
    for variable in _ONE_THREAD:
        os.environ.setdefault(variable, "1")
    from data_module.corpora import STROKE_SOURCES, Options

    for name in ("hours", "workers", "fps", "unit"):
        value = getattr(arguments, name)
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"--{name}", f"is {value:g}", "give a number above 0")
    if arguments.seed < 0:
        raise InputError("--seed", f"is {arguments.seed}", "give 0 or more")
    source = arguments.source
    if source is None and arguments.corpus == "performer" and arguments.preset != "tiny":
        data = os.environ.get("GESTICULATOR_DATA")
        source = Path(data) if data else None
    for name in ("split", "speaker"):
        if getattr(arguments, name) and arguments.corpus != "folder":
            raise InputError(f"--{name}", f"is not for {arguments.corpus}, which has its own", "leave it out")
    languages = tuple(filter(None, arguments.languages.split(",")))
    options = Options(arguments.seed, arguments.hours, arguments.preset, arguments.fps, arguments.unit, languages,
                      arguments.split, arguments.speaker)
    if arguments.corpus in STROKE_SOURCES:
        return _make_strokes(arguments.corpus, source, arguments.out, options)
    if arguments.histogram is not None:
        _check_histogram(arguments.histogram)
    report = build(arguments.corpus, source, arguments.out, options, workers=arguments.workers,
                   dataset=not arguments.no_dataset)
    for line in report.lines():
        print(line)
    if arguments.histogram is not None:
        from data_module import intervals

        intervals.draw(arguments.histogram, report.intervals(), f"{report.store.corpus} ({report.store.path.name})")
        print(f"  {arguments.histogram}: the histogram of intervals")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """The command. Returns 0; leaves with 2 and one line when the input cannot be used."""
    parser = argparse.ArgumentParser(
        prog="python -m data_module.build", formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Read or make a data set, write its store, and report what is in it.")
    add_arguments(parser)
    arguments = parser.parse_args(argv)
    with one_line_errors("build"):
        return run(arguments)


if __name__ == "__main__":
    sys.exit(main())

"""gesticulator build CORPUS --out STORE: read or make a data set, and write its store.

    gesticulator build folder --source DIR --out STORE    # your own NAME.bvh beside NAME.wav
    gesticulator build trinity --source DIR --out STORE   # a published data set; --help lists them all
    gesticulator build folder --help                      # the options of one of them

The result does not depend on the number of workers. A report (minutes, blocks, units, missing joints, omissions with
reasons) is printed and written to STORE/report.json.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError
from data_module.files import lock, new_folder, write_text

if TYPE_CHECKING:
    from data_module.build_report import Outcome
    from data_module.corpora.base import Item, Options

DATASET = "dataset"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass
class Workshop:
    """The data that a worker needs to make recordings; the reader is opened once per process. dataset: the folder of
    the data set beside the store, None for none."""

    corpus: str
    source: Path | None
    options: Options
    writer: Any
    dataset: Path | None
    reader: Any = field(default=None, repr=False)

    def make(self, item: Item) -> Outcome:
        """Write one recording."""
        import warnings

        from data_module.blocks import cut
        from data_module.build_report import Outcome
        from data_module.corpora.base import DroppedError, Imported, load
        from data_module.corpora.folder import write_recording
        from data_module.corpora.table import open_corpus
        from data_module.motion import skeletons
        from data_module.motion.relaxed_hands import with_relaxed_hands
        from data_module.motion.standing_legs import with_standing_legs

        # Once in each process: a reader may hold open databases, which cannot be sent to another one.
        if self.reader is None:
            self.reader = open_corpus(self.corpus, self.source, self.options)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            try:
                recording = load(self.reader, item)
                table = skeletons.find_table(recording.motion.skeleton.names, self.options.joints)
                character = with_relaxed_hands(skeletons.to_character(recording.motion, table, skeletons.WHOLE_BODY))
                # A performer who stands gets planted feet, so that the legs of a store do not slide.
                if recording.stands:
                    character = with_standing_legs(character)
            except DroppedError as reason:
                return Outcome(item.info.name, dropped=str(reason))
            except InputError as error:
                # A skeleton that cannot be retargeted spoils one recording; any other error spoils the build.
                if error.subject != "skeleton":
                    raise
                return Outcome(item.info.name, dropped=str(error))
        sound = self.writer.add(recording, character)
        if self.dataset is not None:
            write_recording(self.dataset, recording)
            _share(sound, self.dataset / sound.name)
        known = "given" if recording.speech.words else ""
        unit, words = (recording.unit, recording.words) if isinstance(recording, Imported) else ("", known)
        # A warning is repeated for every file that a recording has; the report needs it once.
        messages = tuple(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, UserWarning)))
        return Outcome(item.info.name, recording.speech.duration, character.absent, len(cut(recording.speech)), unit,
                       words, warnings=messages)


def _share(file: Path, place: Path) -> None:
    """The same file in two places: a hard link if possible, else a copy."""
    import shutil

    try:
        os.link(file, place)
    except OSError:
        shutil.copyfile(file, place)


def build(workshop: Workshop, workers: int) -> dict[str, Any]:
    """Fill the store of a workshop whose reader is open, and return the content of its report. `InputError` if nothing
    is usable."""
    from tqdm import tqdm

    from data_module import build_report as reports

    reader, writer = workshop.reader, workshop.writer
    if workshop.dataset is not None:
        workshop.dataset.mkdir()
    items: Sequence[Item] = reader.items()
    outcomes: dict[str, Outcome] = {}
    # disable=None: no bar if the output is not a terminal.
    with tqdm(total=len(items), unit="recording", disable=None) as bar:
        for outcome in _made(workshop, items, workers):
            outcomes[outcome.name] = outcome
            bar.update()
    infos = [replace(item.info, seconds=outcomes[item.info.name].seconds) for item in items
             if not outcomes[item.info.name].dropped]
    if not infos:
        reason = next((outcome.dropped for outcome in outcomes.values()), "it is empty")
        raise InputError(workshop.source or workshop.corpus, f"has no recording that can be used ({reason})",
                         "see the formats in --help")
    content = reports.summary(infos, [outcomes[item.info.name] for item in items], reader.notes())
    write_text(writer.path / reports.FILE, json.dumps(content, indent=1, ensure_ascii=False))
    writer.finish([info.name for info in infos])
    return content


_workshop: Workshop | None = None


def _made(workshop: Workshop, items: Sequence[Item], workers: int) -> Iterator[Outcome]:
    """Make recordings in so many processes."""
    if workers <= 1:
        yield from map(workshop.make, items)
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed

    # Spawned, not forked: the same on every system, and numpy reads the number of threads anew.
    context = multiprocessing.get_context("spawn")
    # Without the reader, which each process opens again.
    with ProcessPoolExecutor(min(workers, len(items) or 1), context, _begin, (replace(workshop, reader=None),)) as pool:
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
    _end_with_parent()


def _end_with_parent() -> None:
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


def formats() -> str:
    """The data sets that can be built, one paragraph each, for --help."""
    import textwrap

    from data_module.corpora.table import CORPORA

    width = max(map(len, CORPORA))
    lines = [textwrap.fill(entry.about, 118, initial_indent=f"  {name:<{width}}  ", subsequent_indent=" " * (width + 4))
             for name, entry in CORPORA.items()]
    title = "corpora, and what SOURCE contains (the modules in data_module/corpora show the folders):"
    return "\n".join([title, *lines])


def choose_corpus(parser: argparse.ArgumentParser) -> None:
    """The first step of parsing: the name of the data set, with the list of them in the epilog; its arguments, which
    depend on it, are the rest."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = formats() + (f"\n\n{parser.epilog}" if parser.epilog else "")
    parser.add_argument("corpus", help="one of the names below; NAME --help lists its options")
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="--source DIR --out STORE and options")


def add_arguments(parser: argparse.ArgumentParser, corpus: str) -> None:
    """The second step of parsing: the arguments of a build of `corpus`, those of its reader included. `InputError` for
    an unknown corpus."""
    from data_module.corpora.table import reader_of

    # Only now is it known which data set is meant, and so which options there are.
    reader = reader_of(corpus)
    parser.set_defaults(corpus=corpus)
    parser.add_argument("--source", type=Path, metavar="DIR", help="the source data")
    parser.add_argument("--out", type=Path, required=True, metavar="STORE", help="output folder")
    if hasattr(reader, "arguments"):
        reader.arguments(parser)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1,
                        help="number of processes (default: one per core)")
    parser.add_argument("--no-dataset", action="store_true", help="write only the store, without BVH files")
    parser.add_argument("--fps", type=float, help="frames per second, if the header of the BVH files is wrong")
    parser.add_argument("--unit", type=float, help="metres per unit of the BVH files, if not as reported")
    parser.add_argument("--joints", type=Path, metavar="FILE.json", help="which joints of the BVH files are which, if "
                        "their names are not known; gesticulator character FILE.bvh --save-mapping writes it")


def run(arguments: argparse.Namespace) -> int:
    """Build the store for `arguments`, as of `add_arguments`, and print the report. Returns 0; InputError if the input
    cannot be used, if something is at --out, or if another process builds there."""
    # Before numpy is imported, which reads these variables once; processes are parallel already.
    for variable in _ONE_THREAD:
        os.environ.setdefault(variable, "1")
    from data_module.build_report import report_lines
    from data_module.corpora.base import Options
    from data_module.corpora.table import open_corpus, reader_of
    from data_module.motion.joint_map import read_joint_table
    from data_module.store import Store, StoreWriter

    for name in ("workers", "fps", "unit"):
        value = getattr(arguments, name)
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"--{name}", f"is {value:g}", "give a number above 0")
    reader = reader_of(arguments.corpus)
    options = reader.options(arguments) if hasattr(reader, "options") else Options(arguments.fps, arguments.unit)
    table = None if arguments.joints is None else read_joint_table(arguments.joints)
    options = replace(options, joints=table)
    with lock(arguments.out, "a build", beside=True):
        reader = open_corpus(arguments.corpus, arguments.source, options)
        settings = {**reader.settings(), **({} if table is None else {"joints": table})}
        with new_folder(arguments.out) as unfinished:
            writer = StoreWriter(unfinished, arguments.corpus, settings, options.seed, reader.licence)
            dataset = None if arguments.no_dataset else unfinished / DATASET
            content = build(Workshop(arguments.corpus, arguments.source, options, writer, dataset, reader),
                            arguments.workers)
        for line in report_lines(Store.open(arguments.out), content):
            print(line)
    return 0

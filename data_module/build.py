"""python -m data_module.build CORPUS --out STORE: read or make a data set, and write its store.

    python -m data_module.build performer --source DIR --out STORE    # DIR holds strokes/ and speech/
    python -m data_module.build performer --preset tiny --out STORE   # three minutes, in seconds, from nothing
    python -m data_module.build folder --source DIR --out STORE       # your own NAME.bvh beside NAME.wav

A build that was stopped goes on where it was; the result does not depend on that, nor on the number of workers.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError, one_line_errors

if TYPE_CHECKING:
    from data_module.corpora import Item, Options
    from data_module.store import Store

DATASET = "dataset"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Outcome:
    """What became of one recording: seconds written, or why it was dropped, and what was said on the way."""

    name: str
    seconds: float = 0.0
    dropped: str = ""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Report:
    """What a build did: the store, what was dropped and why, warnings and notes, and how long it took."""

    store: Store
    outcomes: tuple[Outcome, ...] = ()
    notes: tuple[str, ...] = ()
    elapsed: float = 0.0
    reused: int = 0

    def lines(self) -> Iterator[str]:
        """The report, line by line, for the terminal."""
        infos = self.store.recordings
        minutes = sum(info.seconds for info in infos) / 60
        yield (f"{self.store.path}: {self.store.corpus}, {len(infos)} recordings, {minutes:.1f} minutes, built in "
               f"{self.elapsed:.0f} s ({self.reused} recordings were there already)")
        for split in ("train", "val", "test"):
            own = [info for info in infos if info.split == split]
            by: dict[str, float] = defaultdict(float)
            for info in own:
                by[info.speaker] += info.seconds / 60
            people = ", ".join(f"{name} {amount:.1f}" for name, amount in sorted(by.items()))
            voices = ", ".join(sorted({info.voice for info in own}))
            yield (f"  {split:5s} {len(own):4d} recordings {sum(by.values()):7.1f} minutes"
                   + (f"  speakers: {people}  voices: {voices}" if own else ""))
        lacking = Counter(joint for info in infos for joint in info.absent)
        for joint, count in lacking.items():
            yield f"  joint {joint} is lacking in {count} recordings: it follows its parent and is masked"
        for outcome in self.outcomes:
            if outcome.dropped:
                yield f"  dropped {outcome.name}: {outcome.dropped}"
            yield from (f"  {outcome.name}: {line}" for line in outcome.warnings)
        yield from (f"  {note}" for note in self.notes)
        yield f"  licence: {self.store.licence}"
        yield f"  fingerprint: {self.store.fingerprint}"


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

        from data_module import corpora, skeletons
        from data_module.corpora.folder import write_recording

        if self.reader is None:
            self.reader = corpora.open_corpus(self.corpus, self.source, self.options)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            try:
                recording = corpora.load(self.reader, item)
                character = skeletons.to_character(recording.motion)
            except corpora.DroppedError as reason:
                return Outcome(item.info.name, dropped=str(reason))
            except InputError as error:
                if error.subject != "skeleton":
                    raise
                return Outcome(item.info.name, dropped=str(error))
        if self.dataset is not None:
            write_recording(self.dataset, recording)
        self.writer.add(recording, character)
        said = tuple(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, UserWarning)))
        return Outcome(item.info.name, recording.speech.duration, warnings=said)


def build(corpus: str, source: Path | None, out: Path, options: Options, *, workers: int = 1, dataset: bool = True,
          progress: bool = True) -> Report:
    """Build the store `out` of a corpus, with `workers` processes, and the data set `out`/dataset when asked.

    A store that is there already with the same settings is left as it is. `InputError` when it has other settings, or
    when nothing can be used.
    """
    from data_module import corpora, store

    begun = time.monotonic()
    reader = corpora.open_corpus(corpus, source, options)
    settings = dict(reader.settings())
    there = store.matching(out, corpus, settings, options.seed)
    if there is not None:
        if dataset and not (out / DATASET).is_dir():
            raise InputError(out, "was built without its data set", "delete it, or say --no-dataset")
        return Report(there, elapsed=time.monotonic() - begun, reused=len(there.recordings))
    writer = store.StoreWriter(out, corpus, settings, options.seed, reader.licence)
    folder = writer.partial / DATASET if dataset else None
    if folder is not None:
        folder.mkdir(exist_ok=True)
    items = reader.items()
    todo = [item for item in items if not (writer.has(item.info.name) and (
        folder is None or (folder / f"{item.info.name}.json").is_file()))]
    workshop = _Workshop(corpus, source, options, writer, folder)
    outcomes = sorted(_made(workshop, todo, workers, progress), key=lambda outcome: outcome.name)
    dropped = {outcome.name for outcome in outcomes if outcome.dropped}
    names = [item.info.name for item in items if item.info.name not in dropped]
    if not names:
        reason = next((outcome.dropped for outcome in outcomes), "it is empty")
        writer.discard()
        raise InputError(source or corpus, f"has no recording that can be used ({reason})", "see the formats in --help")
    if folder is not None:
        for name in names:
            _share(writer.partial / "recordings" / f"{name}.flac", folder / f"{name}.flac")
    finished = writer.finish(names)
    return Report(finished, tuple(outcomes), tuple(reader.notes()), time.monotonic() - begun, len(items) - len(todo))


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


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m data_module.build", formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Read or make a data set, and write its store.",
        epilog="performer: scripted performances of real strokes (SOURCE/strokes) on real (SOURCE/speech) and\n"
               "synthetic speech.   folder: your own NAME.bvh beside NAME.flac, .wav, .mp3 or .ogg, and NAME.json\n"
               "with the words where you have them.")
    parser.add_argument("corpus", help="performer or folder")
    parser.add_argument("--source", type=Path, metavar="DIR",
                        help="the data to build from (performer: default is the variable GESTICULATOR_DATA)")
    parser.add_argument("--out", type=Path, required=True, metavar="STORE", help="the folder to write")
    parser.add_argument("--seed", type=int, default=1, help="performer: another seed, another corpus (default 1)")
    parser.add_argument("--hours", type=float, default=4.2, help="performer: synthetic speech to make (default 4.2)")
    parser.add_argument("--preset", choices=("default", "tiny"), default="default",
                        help="performer: tiny is three minutes that need no data and no other program")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one per core)")
    parser.add_argument("--no-dataset", action="store_true", help="write the store only, no BVH files")
    parser.add_argument("--fps", type=float, help="folder: frames per second, where the BVH header is wrong")
    parser.add_argument("--unit", type=float, help="folder: metres per unit of the BVH files, where the guess is wrong")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """The command. Returns 0; leaves with 2 and one line when the input cannot be used."""
    arguments = _arguments(argv)
    for variable in _ONE_THREAD:
        os.environ.setdefault(variable, "1")
    with one_line_errors("build"):
        from data_module.corpora import Options

        for name in ("hours", "workers", "fps", "unit"):
            value = getattr(arguments, name)
            if value is not None and not 0 < value < float("inf"):
                raise InputError(f"--{name}", f"is {value:g}", "give a number above 0")
        if arguments.seed < 0:
            raise InputError("--seed", f"is {arguments.seed}", "give 0 or more")
        source = arguments.source
        if source is None and arguments.corpus == "performer" and arguments.preset != "tiny":
            told = os.environ.get("GESTICULATOR_DATA")
            source = Path(told) if told else None
        options = Options(arguments.seed, arguments.hours, arguments.preset, arguments.fps, arguments.unit)
        report = build(arguments.corpus, source, arguments.out, options, workers=arguments.workers,
                       dataset=not arguments.no_dataset)
        for line in report.lines():
            print(line)
    return 0


if __name__ == "__main__":
    sys.exit(main())

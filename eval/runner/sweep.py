"""Rows and seeds of an ablation at once: on a Ray cluster, or as jobs of Slurm.

What all rows share (cuts, speech encoder, lexicon, networks) is made before them; what some share is made by whoever
needs it first, and the others wait for it. A worker keeps its cell as a file of its own, which whoever writes the
tables gathers into cells.jsonl: so no two machines write to one file.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from data_module.errors import InputError, complain
from data_module.settings import whole_number
from gesticulator.batch import Doing, TaskOutcome
from gesticulator.cli import PROGRAM

if TYPE_CHECKING:
    from eval.runner.row import Ablation

MakeContext: TypeAlias = "Callable[[], Ablation]"
"""Opens the store and makes what rows stand on; called once in each worker."""
RowSeed: TypeAlias = tuple[str, int]
MINUTES = 24 * 60
"""Of a job of Slurm, where nobody says: a row of the preset takes an hour or two on a core."""


def prepare(make: MakeContext, tasks: Sequence[RowSeed]) -> None:
    """Make what rows share: the store's cuts, what is heard, the lexicon, and for RACER's rows what they stand on. A
    job of its own calls it."""
    from eval.rows.cells import family

    ablation = make()
    for group in dict.fromkeys(family(name) for name, _ in tasks):
        ablation.family(group)
    ablation.rg.judge  # noqa: B018 - is made at its first use


def do_row(make: MakeContext, task: RowSeed) -> float:
    """Make the cell of a row at a seed, if it is not there; its seconds of training. A job of its own calls it."""
    return _do(_beside_others(make), task)


def _beside_others(make: MakeContext) -> Ablation:
    """An ablation whose cells are files of their own until they are gathered."""
    ablation = make()
    return replace(ablation, cells=replace(ablation.cells, alone=False))


def _do(ablation: Ablation, task: RowSeed) -> float:
    return float(ablation.cell(*task).get("seconds", {}).get("training", 0.0))


def _worker(make: MakeContext, tasks: Sequence[RowSeed]) -> Doing:
    import torch

    torch.set_num_threads(1)
    ablation = _beside_others(make)
    return lambda number: _do(ablation, tasks[number])


def rows_at_once(ablation: Ablation, tasks: Sequence[RowSeed], make: MakeContext,
                 outcomes: Callable[[Any, Sequence[int]], Iterator[TaskOutcome]]) -> dict[str, str]:
    """Do what is not finished of rows and seeds; what failed, as "ROW, seed SEED" -> a line.

    outcomes: does them by their numbers given what makes a worker, such as `done_on_ray`.
    """
    from tqdm import tqdm

    ablation.cells.gather()
    ablation.rg.judge  # noqa: B018 - what all rows share is made before them
    # Rows that are the same network as another stand on its cell.
    tasks = list(dict.fromkeys((ablation.original(name), seed) for name, seed in tasks))
    waiting = [number for number, (name, seed) in enumerate(tasks)
               if ablation.cells.finished(name, seed, ablation.key(name, seed)) is None]
    failed = {}
    with tqdm(total=len(waiting), desc="rows", disable=not ablation.context.progress) as bar:
        for one in outcomes(partial(_worker, make, tasks), waiting) if waiting else ():
            name, seed = tasks[one.number]
            bar.update()
            if one.error:
                failed[f"{name}, seed {seed}"] = one.error
                complain(f"{PROGRAM}: {name}, seed {seed}: {one.error}")
            ablation.cells.gather()
    return failed


# --------------------------------------------------------------------------------------------------------------- Slurm

def slurm_options(given: Sequence[str]) -> dict[str, Any]:
    """Options of submitit, such as slurm_partition=cpu or timeout_min=600, as the command line gives them; InputError
    for what is none, and where submitit or Slurm is not there."""
    from importlib.util import find_spec

    if find_spec("submitit") is None:
        raise InputError("--slurm", "needs submitit, which is not installed", "pip install 'gesticulator[slurm]'")
    options: dict[str, Any] = {"cluster": "slurm", "timeout_min": MINUTES}
    for text in given:
        name, mark, value = text.partition("=")
        if not (name and mark and value):
            raise InputError(f"--slurm {text}", "is not an option", "write it as slurm_partition=cpu")
        number = whole_number(value, 2**63 - 1)
        options[name] = value if number is None else number
    if options["cluster"] == "slurm" and shutil.which("sbatch") is None:
        raise InputError("--slurm", "finds no sbatch here", "run it where jobs are submitted, or say cluster=local")
    return options


def submit(make: MakeContext, tasks: Sequence[RowSeed], folder: Path, options: Mapping[str, Any]) -> list[str]:
    """Submit a job that makes what rows share and, after it, an array of one job for each row and seed; their numbers.

    folder: for the scripts, what they run, and what they print. options: see `slurm_options`.
    """
    import submitit

    own = {name: value for name, value in options.items() if name != "cluster"}
    executor = submitit.AutoExecutor(folder=folder / "%j", cluster=options["cluster"])
    try:
        executor.update_parameters(name=PROGRAM, **own)
        first = executor.submit(prepare, make, list(tasks))
        if options["cluster"] == "slurm":
            more = {**own.get("slurm_additional_parameters", {}), "dependency": f"afterok:{first.job_id}"}
            executor.update_parameters(slurm_additional_parameters=more)
        else:
            first.result()
        jobs = executor.map_array(partial(do_row, make), list(tasks))
    except (NameError, TypeError, ValueError) as error:  # submitit's, for an option it does not know
        raise InputError("--slurm", str(error).splitlines()[0][:200], "see submitit's documentation") from None
    finally:
        with contextlib.suppress(OSError):
            (folder / "%j").rmdir()  # which submitit makes before it knows the numbers
    return [first.job_id, *(job.job_id for job in jobs)]

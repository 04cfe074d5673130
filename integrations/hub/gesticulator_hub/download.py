"""Bundles by the id of a hub: downloaded, checked, and stored on this machine.

A repository holds the files of a bundle's folder. huggingface_hub downloads them into its cache (HF_HOME), which serves
without a network as well. HF_ENDPOINT names another hub, HF_TOKEN opens private repositories, and with
HF_HUB_OFFLINE=1 nothing is looked up.
"""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from data_module.registry import Requirement
from gesticulator.bundle.files import INDEX, Weights, read_index
from gesticulator.jobs import file_hash

REQUIREMENT = Requirement("huggingface_hub", "huggingface_hub", "hub")


def downloaded(name: str) -> Path:
    """The folder of a bundle "org/name" or "org/name@revision"; revision: a branch, a tag or a commit.

    `InputError` in one line: huggingface_hub is not installed, there is no such id or revision, it is not for everyone,
    neither the hub nor a stored copy can be reached, it is no bundle or one of another format, the disk is too small,
    or a file is not the one that the bundle was made with.
    """
    REQUIREMENT.check(name)
    repository, _, revision = name.partition("@")
    # The index first: another format is refused, and the names of its files are known, before weights are downloaded.
    folder = _snapshot(name, repository, revision, [INDEX])
    if not (folder / INDEX).is_file():
        raise InputError(name, f"is not a bundle (no {INDEX})", "give a repository that gesticulator bundle push made")
    try:
        files = read_index(folder)["files"]
    except InputError as error:
        raise InputError(name, error.wrong, error.advice) from None
    check_space(name, repository, revision, files, folder)
    folder = _snapshot(name, repository, revision, [INDEX, *files])
    check_files(name, folder, f"delete {folder.parents[1]} to download it again")
    return folder


def check_space(name: str, repository: str, revision: str, files: Sequence[str], folder: Path) -> None:
    """`InputError` if what is missing of the files is larger than the free space around `folder`."""
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import DryRunError

    try:
        with one_line(name):
            plan = snapshot_download(repository, revision=revision or None, allow_patterns=list(files), dry_run=True)
    except DryRunError:
        return  # without a network nothing is downloaded
    missing, free = sum(file.file_size for file in plan if file.will_download), shutil.disk_usage(folder).free
    if missing > free:
        raise InputError(name, f"needs {missing / 1e6:.0f} MB, and {folder.parents[1]} has {free / 1e6:.0f} MB left",
                         "make room, or name another disk by HF_HOME")


def check_files(name: str, folder: Path, advice: str) -> None:
    """`InputError` about `name` unless the folder has every file of its index, with the hash that stands there."""
    weights = Weights(folder, read_index(folder))
    wrong = [file for file, digest in weights.listed.items() if file_hash(folder / file) != digest]
    if wrong:
        raise InputError(name, f"{wrong[0]} is not the file that the bundle was made with (wrong SHA-256)", advice)


def _snapshot(name: str, repository: str, revision: str, files: Sequence[str]) -> Path:
    from huggingface_hub import snapshot_download

    with one_line(name):
        return Path(snapshot_download(repository, revision=revision or None, allow_patterns=list(files)))


@contextmanager
def one_line(name: str) -> Iterator[None]:
    """Errors of huggingface_hub as an `InputError` about `name`."""
    from huggingface_hub.errors import DryRunError

    try:
        yield
    except (DryRunError, InputError):
        raise
    except Exception as error:  # noqa: BLE001 - the client passes on what HTTP libraries raise
        raise InputError(name, *_reason(error)) from None


def _reason(error: Exception) -> tuple[str, str]:
    """What is wrong and what to do."""
    from huggingface_hub import constants
    from huggingface_hub import errors as of_hub

    known: list[tuple[Any, tuple[str, str]]] = [
        (of_hub.GatedRepoError, ("is not for everyone", "ask for access on its page, then set HF_TOKEN")),
        (of_hub.RepositoryNotFoundError, (f"is neither a folder here nor a repository of {constants.ENDPOINT}",
                                          "check the spelling; a private one needs HF_TOKEN")),
        (of_hub.RevisionNotFoundError, ("has no such revision", "name a branch, a tag or a commit of it")),
        ((of_hub.LocalEntryNotFoundError, of_hub.OfflineModeIsEnabled),
         (f"is neither a folder nor stored on this machine, and {constants.ENDPOINT} cannot be reached",
          "try again with a network, or give a folder")),
        (of_hub.HFValidationError, ("is no id of a repository", "write it as org/name or org/name@revision"))]
    for kinds, reason in known:
        if isinstance(error, kinds):
            return reason
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return "does not fit on the disk", "make room, or name another disk by HF_HOME"
    status = getattr(getattr(error, "response", None), "status_code", None)
    if status in (401, 403):
        return f"is refused by {constants.ENDPOINT} (status {status})", "set HF_TOKEN to a token with the right"
    return f"cannot be exchanged with {constants.ENDPOINT} ({type(error).__name__}: {error})", "try again later"

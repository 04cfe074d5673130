"""A bundle as one commit of a hub's repository: all of its files appear together or none does."""

from __future__ import annotations

from pathlib import Path

from gesticulator.bundle.files import INDEX, read_index
from gesticulator_hub.download import one_line


def upload(folder: Path, repository: str, card: str, branch: str, private: bool) -> str:
    """Upload the files of a bundle's index, the index and its page (README.md); the address of the commit.

    A repository and a branch that do not exist are made. `InputError` in one line where the hub refuses or cannot be
    reached.
    """
    from huggingface_hub import CommitOperationAdd, HfApi

    api, files = HfApi(), [INDEX, *read_index(folder)["files"]]
    with one_line(repository):
        api.create_repo(repository, private=private, exist_ok=True)
        if branch != "main":
            api.create_branch(repository, branch=branch, exist_ok=True)
        done = api.create_commit(
            repository, [CommitOperationAdd("README.md", card.encode()),
                         *(CommitOperationAdd(name, str(folder / name)) for name in files)],
            commit_message="Upload a bundle", revision=branch)
    return str(done.commit_url)

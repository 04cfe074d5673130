"""Every reader of files against broken files: only `InputError` comes out, within 500,000 calls and 500 MB.

A real file of each kind is written, damaged as disks, programs and people damage files (flipped bits, a cut end,
pieces that are missing or there twice, foreign bytes, numbers far too large), and read. A file that happens to be still
good may be read. A new reader is a new entry of `READERS`.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from damaged import check_damaged
from reader_cases import READERS

from data_module.text.transcript import FORMATS


@pytest.mark.parametrize("name", READERS)
def test_only_input_errors_come_out_of_damaged_files(name: str, tmp_path: Path) -> None:
    check_damaged(READERS[name], tmp_path)


def test_every_format_of_transcripts_has_a_case() -> None:
    assert {f"transcript {suffix}" for suffix in FORMATS} <= set(READERS)

"""Pages of strips: several systems at the same seconds."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from performances import perform

from data_module.errors import InputError
from data_module.motion import bvh
from eval.commands import PLOT
from eval.pictures.strips import page_times

matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed")


def test_four_poses_a_second_as_far_as_the_motion_goes() -> None:
    np.testing.assert_allclose(page_times(2.0, 1.5, 60.0), [2.0, 2.25, 2.5, 2.75, 3.0, 3.25])
    assert len(page_times(0.0, 15.0, 60.0)) == 60 and page_times(58.0, 15.0, 59.0)[-1] == 58.75
    for start, seconds in ((60.0, 1.0), (-1.0, 1.0), (0.0, 0.0), (float("nan"), 1.0)):
        with pytest.raises(InputError):
            page_times(start, seconds, 59.0)


def test_command_draws_a_page_of_files(tmp_path: Path, refused: Callable[..., str],
                                       capfd: pytest.CaptureFixture[str]) -> None:
    import soundfile

    made = perform(seconds=3.0)
    for name in ("talk", "other"):
        bvh.write_bvh(tmp_path / f"{name}.bvh", made.motion)
    soundfile.write(tmp_path / "talk.wav", made.speech.samples, made.speech.sample_rate)
    out = tmp_path / "page.png"
    given = ["strip", str(tmp_path / "talk.bvh"), str(tmp_path / "other.bvh"), "--sound", str(tmp_path / "talk.wav"),
             "--seconds", "1", "--out", str(out)]
    assert PLOT.main("gesticulator plot", given) == 0
    assert capfd.readouterr().out.strip() == str(out)
    first = out.read_bytes()
    ink = (matplotlib.image.imread(out)[..., :3] < 0.9).any(axis=-1)
    # Two sources, two views each, and a waveform: ink in each fifth of the page, left and right.
    assert all(half.mean() > 0.02 for part in np.array_split(ink, 5) for half in np.array_split(part, 2, axis=1))
    PLOT.main("gesticulator plot", given)
    assert out.read_bytes() == first
    for arguments, told in ((["strip"], "nothing to draw"), (["strip", "--ours"], "no sound")):
        assert told in refused("plot", *arguments, "--out", out)

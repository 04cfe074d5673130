"""A page to try gestures on a voice: record or upload one, watch, download. Run by `python app.py`, or as a Space."""

from __future__ import annotations

import html
import os
import tempfile
import time
import warnings
from functools import cache
from pathlib import Path

import gradio as gr
import soundfile

from data_module.errors import InputError, one_line
from gesticulator import Gesticulator
from gesticulator.cli import limited_threads

SECONDS = 60.0
"""Longest recording."""
MEGABYTES = 30
"""Largest upload, of a recording or a character."""
WAITING = 16
"""People in the queue; one is served at a time."""
KEPT = 3600
"""Seconds for which files stay on the server."""
FORMATS = {"bvh": "BVH: Blender, MotionBuilder", "glb": "GLB: the character with its motion",
           "vrma": "VRMA: any VRM character"}
INTRODUCTION = """# Gestures for a voice
Speech in, upper-body gestures out. Record or upload some seconds of speech, and watch. Recordings are deleted within an
hour. The page runs on one processor, for one person at a time."""


@cache
def gesticulator() -> Gesticulator:
    """The models, loaded once. GESTICULATOR_BUNDLE names others: a folder, or ORG/NAME of a hub."""
    return Gesticulator.from_pretrained(os.environ.get("GESTICULATOR_BUNDLE"))


def check_upload(path: str | None, what: str) -> None:
    """gr.Error, which the page shows, for a missing or too large file."""
    if not path:
        raise gr.Error(f"Give a {what} first.", print_exception=False)
    if Path(path).stat().st_size > MEGABYTES * 1e6:
        raise gr.Error(f"The {what} is larger than {MEGABYTES} MB.", print_exception=False)


def check_length(recording: str) -> None:
    """gr.Error for more than `SECONDS`, before anything is decoded, as far as the file says how long it is."""
    try:
        seconds = soundfile.info(recording).duration
    except soundfile.SoundFileError:
        return  # not a format that tells; the sound is measured when it is read
    if seconds > SECONDS:
        raise gr.Error(f"The recording has {seconds:.0f} s; at most {SECONDS:.0f} s are taken.", print_exception=False)


def perform(recording: str | None, speaker: str, size: float, character: str | None, seed: float
            ) -> tuple[str, str, str, str, str]:
    """The page that plays the performance, three files, and a line about it."""
    check_upload(recording, "recording")
    assert recording is not None
    check_length(recording)
    if character:
        check_upload(character, "character")
    begin, folder = time.perf_counter(), Path(tempfile.mkdtemp(prefix="gesture-", dir=cache_folder()))
    try:
        with limited_threads(1), warnings.catch_warnings(record=True) as remarks:
            warnings.simplefilter("always")
            made = gesticulator()(recording, speaker=speaker, intensity=size, seed=int(seed), legs=True,
                                  face="full" if character else "off")
            if made.duration > SECONDS:
                raise gr.Error(f"At most {SECONDS:.0f} s are taken.", print_exception=False)
            shown = made.on(character) if character else made
            files = [str((shown if suffix == "glb" else made).save(folder / f"gesture.{suffix}")) for suffix in FORMATS]
            page = shown.save(folder / "page.html").read_text(encoding="utf-8")
    except (InputError, OSError) as error:
        raise gr.Error(one_line(error), print_exception=False) from None
    notes = [str(remark.message) for remark in remarks if "gesticulator" in type(remark.message).__module__]
    line = " ".join([f"{made.duration:.1f} s of speech in {time.perf_counter() - begin:.1f} s.", *notes])
    # In a frame of its own: neither page can reach into the other.
    frame = (f'<iframe title="performance" sandbox="allow-scripts allow-downloads" allow="autoplay; fullscreen" '
             f'style="width:100%;height:640px;border:0" srcdoc="{html.escape(page)}"></iframe>')
    return frame, *files, line


def cache_folder() -> str:
    """Where Gradio may serve files from, and deletes old ones."""
    folder = Path(os.environ.get("GRADIO_TEMP_DIR") or Path(tempfile.gettempdir()) / "gradio")
    folder.mkdir(parents=True, exist_ok=True)
    return str(folder)


def page() -> gr.Blocks:
    """The page."""
    speakers = gesticulator().bundle.speakers
    with gr.Blocks(title="Gestures for a voice", delete_cache=(KEPT, KEPT)) as blocks:
        gr.Markdown(INTRODUCTION)
        with gr.Row():
            with gr.Column(scale=1):
                recording = gr.Audio(sources=["upload", "microphone"], type="filepath", elem_id="recording",
                                     label=f"Speech, at most {SECONDS:.0f} s")
                speaker = gr.Dropdown(list(speakers), value=gesticulator().bundle.config.default_speaker or speakers[0],
                                      label="Manner of moving")
                size = gr.Slider(0.0, 2.0, 1.0, step=0.1, label="Size of the gestures")
                character = gr.File(file_types=[".vrm", ".glb"], label="Character (VRM or GLB, optional)",
                                    elem_id="character")
                seed = gr.Number(0, precision=0, minimum=0, maximum=2**32 - 1, label="Take")
                button = gr.Button("Gesture", variant="primary", elem_id="start")
            with gr.Column(scale=2):
                shown, line = gr.HTML(elem_id="page"), gr.Markdown(elem_id="line")
                with gr.Row():
                    files = [gr.DownloadButton(label, elem_id=suffix) for suffix, label in FORMATS.items()]
        button.click(perform, [recording, speaker, size, character, seed], [shown, *files, line],
                     concurrency_limit=1)
    return blocks.queue(max_size=WAITING, default_concurrency_limit=1)


if __name__ == "__main__":
    page().launch(max_file_size=f"{MEGABYTES}mb", share=False)

"""`gesticulator view talk.flac`: a page that plays and edits the performance, with the models as its backend."""

from __future__ import annotations

import argparse
import gc
import json
import signal
import tempfile
import time
import webbrowser
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError, one_line
from data_module.files import opened
from gesticulator.cli import Command, limited_threads, our_warnings, status
from gesticulator.infer import Worker, load
from gesticulator.jobs import Job, RunSettings, performance_arguments, run_settings_of, settings_of

if TYPE_CHECKING:
    from gesticulator.characters.rig import Character
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.page.edits import Edits
    from gesticulator.page.server import PageServer
    from gesticulator.performance import Performance

SHOWN = (".glb", ".gltf", ".vrm")
"""Suffixes of characters that the page can show."""


def arguments(p: argparse.ArgumentParser) -> None:
    p.usage = f"{p.prog} SPEECH [options]"
    p.add_argument("speech", metavar="SPEECH", type=Path, help="an audio file, as for gesticulator infer")
    page = p.add_argument_group("page")
    page.add_argument("--port", type=int, default=0, metavar="N", help="port on 127.0.0.1 (default: any free one)")
    page.add_argument("--no-browser", action="store_true", help="print the address instead of opening a window")
    performance_arguments(p)
    p.set_defaults(face="full")  # what somebody looks at should look back


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted. The page opens at once, and shows what is done until the performance is there."""
    from gesticulator.page.edits import held, place_of
    from gesticulator.page.server import PageServer

    begin, settings, job = time.perf_counter(), run_settings_of(args), _job(args)
    # As an interruption, so that the edits are saved.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with (PageServer(args.port) as server, held(place_of(args.speech)), our_warnings(), server.in_background(),
          tempfile.TemporaryDirectory(prefix="gesticulator-") as folder):
        # At once, though the output is a pipe: who starts the program reads the address from it.
        print(f"{server.url}  (Ctrl C ends it)", flush=True)
        started = not args.no_browser and webbrowser.open(_way_in(Path(folder), server.url))
        with limited_threads(settings.threads):
            try:
                _prepare(server, job, settings)
            except (InputError, OSError, MemoryError, ImportError) as error:
                server.progress |= {"failed": one_line(error)}
                # A page asks several times a second; a browser may still be starting.
                server.told.wait(5.0 if started else 1.0)
                raise
            status("")
            print(f"{job.name}: ready after {time.perf_counter() - begin:.1f} s", flush=True)
            with suppress(KeyboardInterrupt):
                while True:
                    time.sleep(1.0)
            server.rendering.acquire()  # a rendering that is under way ends first
            server.edits.save()
    return 0


def _job(args: argparse.Namespace) -> Job:
    """The recording; `InputError` for errors that can be found before loading anything."""
    if args.character is not None and Path(args.character).suffix.lower() not in SHOWN:
        raise InputError(args.character, "cannot be shown by the page", f"give one of {', '.join(SHOWN)}")
    opened(args.speech).close()
    return replace(settings_of(args), source=args.speech, text=None if args.text is None else Path(args.text))


def _prepare(server: PageServer, job: Job, settings: RunSettings) -> None:
    """Generate the performance, and give the server its page and the renderer of edited plans."""
    source = job.source
    assert source is not None

    def say(doing: str, share: float, logged: bool = True) -> None:
        server.progress = {"name": source.name, "doing": doing, "share": share}
        status(f"{source.name}: {doing}", logged=logged)

    def on_block(done: int, total: int) -> None:
        doing = f"generating gestures, block {done} of {total}" if done < total else "putting the motion together"
        say(doing, 0.1 + 0.8 * done / total, logged=done in (1, total))

    say("loading the models", 0.0)
    from gesticulator.export import html
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.page.palette import moving_figures
    from gesticulator.page.session import EditSession, levels_of

    # A character that stands on its legs in its file needs legs in the motion, too.
    chosen, stands = _character(job)
    gesticulator = Gesticulator.from_pretrained(settings.bundle)
    gesticulator.keeps_generations = True
    job = replace(job, options=replace(job.options, legs=job.options.legs or stands))
    say("reading the recording", 0.05)
    gesticulator.on_block = on_block
    performance, edits = _performed(gesticulator, job)
    gesticulator.on_block = None
    say("making the page", 0.9)
    session = EditSession(gesticulator, performance, edits)
    scene = performance.scene()
    live = {"token": server.token, "renderings": [session.opened(performance)],
            "levels": levels_of(gesticulator.bundle), "speakers": list(gesticulator.bundle.speakers)}
    more = {"live": live, **({} if chosen is None else html.character_data(*chosen, scene.face))}
    if performance.retiming is not None:
        print(f"  {performance.retiming}", flush=True)
        edits.notice = f"The edits were moved onto the new sound. {performance.retiming}"
    if edits.notice:
        more["notice"] = edits.notice
    server.page = html.page({performance.decided.interpreter: scene}, html.title_of(source), more=more).encode()
    server.edits = edits
    # What stays for the whole session need not be looked through for garbage, which would delay edits by a third of a
    # second now and then.
    gc.collect()
    gc.freeze()
    # Decoding all lexemes takes a second: only when the palette is opened, and once.
    speaker = gesticulator.resolver.speaker(performance.decided.speaker)
    server.figures = cache(lambda: json.dumps(moving_figures(gesticulator.bundle, speaker)).encode())
    server.render = session.answer


def _character(job: Job) -> tuple[tuple[Character, dict[str, int]] | None, bool]:
    """The requested character with our joint -> its node in the file, if any, and whether it stands on its legs."""
    if job.character is None:
        return None, False
    from gesticulator.characters.mapping import check
    from gesticulator.characters.reading import choose

    # The mapping may be saved before anything else: it is what a user corrects when joints are wrong.
    character, mapping = choose(job.character.file, job.character.mapping, job.character.save_mapping)
    check(mapping, character)
    joints = {joint: character.node_ids[node] for joint, node in mapping.named().items()}
    return (character, joints), mapping.legs and not job.options.seated


def _performed(gesticulator: Gesticulator, job: Job) -> tuple[Performance, Edits]:
    """The performance, and the owner of its plan: of the edits that were saved beside the sound, where they can be
    gone on with and no plan is given by name, which comes before them. If the sound was exported again since, it is
    what has a place in it."""
    from data_module.speech.audio import SAMPLE_RATE, amplified, resample
    from gesticulator.directing.directions import planned
    from gesticulator.page.edits import Edits, place_of, put_aside, saved_beside
    from gesticulator.plan.plan import sound_hash
    from gesticulator.plan.plan_file import read_plan

    assert job.source is not None
    worker, speech, place, notice = Worker(gesticulator), load(job), place_of(job.source), ""
    saved = saved_beside(job.source) if job.options.plan is None else None
    if saved is not None:
        try:
            options = replace(job.options, plan=(plan := read_plan(saved)))
            # The hash of a plan is of the sound as the models take it: with its gain, at their rate.
            moved = sound_hash(resample(amplified(speech, planned(options).gain), SAMPLE_RATE)) != plan.sound.sha256
            performance = worker.performed(replace(job, options=replace(options, retime=moved)), speech)
        except (InputError, OSError) as error:
            notice = put_aside(saved, str(error))
        else:
            how = "moved onto the new sound" if moved else "opened"
            print(f"{saved}: the saved edits are {how}; without this file none are", flush=True)
            return performance, Edits(place, opened=saved == place and not moved)
    return worker.performed(job, speech), Edits(place, notice=notice)


def _way_in(folder: Path, url: str) -> str:
    """The address of a file that leads to the page: a browser's command line can be read by all users of the machine,
    a file in a folder of one's own cannot."""
    file = folder / "open.html"
    file.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={url}"><title>gesticulator</title>')
    return file.as_uri()


COMMAND = Command(
    "open a page that plays a performance and edits its plan", arguments, run,
    examples=(
        "view talk.flac",
        "view talk.flac --text talk.txt --character rig.vrm",
        "view talk.flac --plan talk.plan.json",
        "view talk.flac --interpreter cql --port 8123 --no-browser",
    ))

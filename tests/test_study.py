"""The user study: what raters see tells nothing about systems, and known answers give known figures."""

import base64
import itertools
import json
import re
from argparse import Namespace
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from performances import perform
from scipy import stats

from data_module.errors import InputError
from data_module.motion import bvh
from data_module.types import Array, Speech
from eval.commands import STUDY
from eval.study import anova
from eval.study import command as study
from eval.study.anova import Key, KeyItem, RatedItem, RatingFile
from eval.table import load
from gesticulator.export.figure import figure_points

NAMES = ("zebrafish", "quokka", "marmoset")
RATE = 16000


def ask(arguments: list[str]) -> int:
    return STUDY.main("gesticulator study", arguments)


def _voice(seconds: float, seed: int) -> Array:
    """Noise in syllables, which counts as speech, after a second of silence."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    return 0.3 * rng.normal(size=len(time)).clip(-3, 3) * np.sin(np.pi * 4 * time) ** 2 * (time > 1.0)


@pytest.fixture(scope="module")
def systems(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Three systems of different frame rates, two recordings of 9 s each."""
    folders = {}
    for k, name in enumerate(NAMES):
        folders[name] = tmp_path_factory.mktemp(name)
        for take in range(2):
            soundfile.write(folders[name] / f"walrus{take}.wav", _voice(9.0, take), RATE)
            motion = perform(9.0, fps=(20.0, 30.0, 60.0)[k], seed=10 * take + k).motion
            bvh.write_bvh(folders[name] / f"walrus{take}.bvh", motion)
    return folders


@pytest.fixture(scope="module")
def made(systems: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study of 4 clips of 2 s."""
    out = tmp_path_factory.mktemp("study")
    assert ask(["make", "--out", str(out), "--clips", "4", "--seconds", "2", "--raters", "24", "--systems",
                       *(f"{name}={folder}" for name, folder in systems.items())]) == 0
    return out


def _data(page: Path) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="study">(.*?)</script>', page.read_text(), re.DOTALL)
    assert found
    return json.loads(found.group(1))


# ---------------------------------------------------------------- the page

def test_nothing_in_the_page_names_a_system(made: Path, systems: dict[str, Path]) -> None:
    page, key = (made / "page" / "index.html").read_text(), json.loads((made / "key.json").read_text())
    assert [file.name for file in (made / "page").iterdir()] == ["index.html"], "the key must not lie with the page"
    for word in (*NAMES, "walrus", *map(str, systems.values()), *(folder.name for folder in systems.values())):
        assert word.lower() not in page.lower()
    assert key["systems"] == list(NAMES)
    assert not re.search(r"https?://|\bfetch\(|XMLHttpRequest|sendBeacon|WebSocket|@import", page)
    assert "default-src 'none'" in page and "connect-src 'none'" in page
    # Nor does the form of an item: all are as long, and their order follows ids that are hashes.
    told = _data(made / "page" / "index.html")
    assert {frozenset(item) for item in told["items"]} == {frozenset(("id", "sound", "motion"))}
    assert len({len(item["motion"]) for item in told["items"]}) == 1
    ids = [item["id"] for item in told["items"]]
    assert ids == sorted(ids) and set(ids) == set(key["items"]) and len(ids) == 12
    assert all(re.fullmatch("[0-9a-f]{10}", name) for name in ids)


def test_items_hold_the_motion_and_the_sound_that_the_key_says(made: Path, systems: dict[str, Path],
                                                               tmp_path: Path) -> None:
    told, key = _data(made / "page" / "index.html"), json.loads((made / "key.json").read_text())
    sounds: dict[int, set[int]] = {}
    for item in told["items"]:
        own = key["items"][item["id"]]
        clip = key["clips"][own["clip"]]
        sounds.setdefault(own["clip"], set()).add(item["sound"])
        motion = bvh.read_bvh(systems[own["system"]] / f"{clip['recording']}.bvh")
        expected = figure_points(motion, clip["start"] + np.arange(61) / 30)
        steps = np.frombuffer(base64.b64decode(item["motion"]), "<i2").reshape(61, len(told["points"]), 3)
        for number, name in enumerate(told["points"]):
            np.testing.assert_allclose(steps[:, number] / told["stepsPerMetre"], expected[name], atol=1e-4)
        (tmp_path / "clip.ogg").write_bytes(base64.b64decode(told["sounds"][item["sound"]]))
        heard, rate = soundfile.read(tmp_path / "clip.ogg")
        said = _voice(9.0, int(clip["recording"][-1]))[round(clip["start"] * RATE):][:len(heard)]
        assert rate == RATE and len(heard) == 2 * RATE + 1 and np.corrcoef(heard, said)[0, 1] > 0.8
    # One sound for all versions of a clip.
    assert all(len(own) == 1 for own in sounds.values()) and len(sounds) == 4


def test_same_input_gives_the_same_page_and_another_seed_another(made: Path, systems: dict[str, Path],
                                                                 tmp_path: Path) -> None:
    def again(folder: str, seed: int) -> Path:
        return study.make(systems, tmp_path / folder, Namespace(
            clips=4, seconds=2, raters=24, seed=seed, aspects=study.DEFAULT_ASPECTS))

    same = again("again", 0)
    # Not the texts themselves: pytest would explain at length how two megabytes differ.
    assert hash(same.read_bytes()) == hash((made / "page" / "index.html").read_bytes())
    first, other = _data(same), _data(again("other", 1))
    assert other["study"] != first["study"] and other["orders"] != first["orders"]
    assert not {item["id"] for item in other["items"]} & {item["id"] for item in first["items"]}


def test_clips_do_not_overlap_have_speech_and_are_spread(systems: dict[str, Path]) -> None:
    takes = study.read_takes(systems)
    chosen = study.choose_clips(takes, 6, 2.0, seed=3)
    assert all(clip.speech >= study.ENOUGH_SPEECH for clip in chosen)
    assert Counter(clip.take for clip in chosen[:2]) == {0: 1, 1: 1}
    for a, b in itertools.combinations(chosen, 2):
        assert a.take != b.take or abs(a.start - b.start) >= 2.0 - 1e-3
    quiet = Speech(np.full(9 * RATE, 1e-6, np.float32), RATE)
    with pytest.raises(InputError, match="only 0 stretches"):
        study.choose_clips([study.StudyTake("still", quiet, takes[0].motions)], 1, 2.0, seed=0)


# ---------------------------------------------------------------- the order

@pytest.mark.parametrize("n", [2, 3, 4, 5, 6])
def test_williams_rows_balance_places_and_neighbours(n: int) -> None:
    rows = study.williams(n)
    assert all(sorted(row) == list(range(n)) for row in rows.tolist())
    each = len(rows) // n
    assert all((np.bincount(column, minlength=n) == each).all() for column in rows.T)
    after = Counter(pair for row in rows.tolist() for pair in itertools.pairwise(row))
    assert len(after) == n * (n - 1) and len(set(after.values())) == 1


def test_orders_differ_between_raters_and_are_balanced() -> None:
    rows = study.orders(systems=3, clips=4, raters=24, seed=5)
    assert all(sorted(row) == list(itertools.product(range(4), range(3))) for row in rows)
    assert len({tuple(row) for row in rows}) == 12, "a rater's order comes again only after the whole design"
    # Over 24 raters: each system in each place among a clip's versions, and each clip in each place, equally often.
    places = Counter((clip, system, index % 3) for row in rows for index, (clip, system) in enumerate(row))
    assert set(places.values()) == {24 // 3}
    clips = Counter((row[3 * place][0], place) for row in rows for place in range(4))
    assert set(clips.values()) == {24 // 4}
    # A single rater sees no system first all the time.
    assert all(max(Counter(row[3 * place][1] for place in range(4)).values()) < 4 for row in rows)
    assert rows != study.orders(3, 4, 24, seed=6)


# ---------------------------------------------------------------- figures

def _key(systems: int = 3, clips: int = 4) -> Key:
    names = tuple("ABCDEF"[:systems])
    items = {f"item{c}_{k}": KeyItem(c, name) for c in range(clips) for k, name in enumerate(names)}
    return Key("s1", names, ("beat_match",), ({},) * clips, items)


def _table(values: Array) -> anova.Ratings:
    """Ratings [R, C, K] of one aspect, by way of single answers."""
    files = {str(r + 1): RatingFile("s1", str(r + 1), tuple(
        RatedItem(f"item{c}_{k}", {"beat_match": int(values[r, c, k])})
        for c, k in np.ndindex(*values.shape[1:]) if np.isfinite(values[r, c, k]))) for r in range(len(values))}
    return anova.gather(files, _key(values.shape[2], values.shape[1]))


def _rows_of(ratings: anova.Ratings) -> tuple[Any, Any]:
    """The rows of the systems and of the pairs."""
    systems, pairs = anova.tables(ratings)
    return systems.rows, pairs.rows


def test_anova_and_tukey_of_a_worked_example() -> None:
    """Means 5, 9, 10 of six each: SSB = 84, SSW = 68, F = (84 / 2) / (68 / 15) = 9.26; Tukey's reach is
    q(0.05; 3, 15) sqrt(MSW / 6) = 3.674 * 0.8692 = 3.19."""
    groups = np.array([[6, 8, 4, 5, 3, 4], [8, 12, 9, 11, 6, 8], [13, 9, 11, 8, 7, 12]], dtype=float)
    f, p = anova.one_way(list(groups))
    assert f == pytest.approx((84 / 2) / (68 / 15))
    assert p == pytest.approx(float(stats.f.sf(42 / (68 / 15), 2, 15))) == pytest.approx(0.0024, abs=5e-5)
    _, pairs = _rows_of(_table(groups.T[:, None, :]))
    reach = float(stats.studentized_range.ppf(0.95, 3, 15)) * np.sqrt(68 / 15 / 6)
    assert reach == pytest.approx(3.19, abs=0.01)
    for row, difference in zip(pairs.values(), (-4, -5, -1), strict=True):
        assert row["Tukey"].mean == pytest.approx(difference)
        assert row["Tukey"].low == pytest.approx(difference - reach, abs=2e-3)
        assert row["Tukey"].high == pytest.approx(difference + reach, abs=2e-3)
        assert ("*" in row["p"]) == (abs(difference) > reach)


def test_rank_counts_share_the_better_place() -> None:
    nan = np.nan
    values = np.array([[[5, 3, 1], [4, 4, 2], [3, 3, 3], [1, nan, 5]]], dtype=float)
    assert anova.rank_counts(values).tolist() == [[3, 0, 0], [2, 1, 0], [1, 0, 2]]
    first = _rows_of(_table(values))[0]["A"]
    assert (first["ratings"], first["mean, bootstrap"].mean) == (4, 3.25)
    assert [first[f"place {place}"] for place in (1, 2, 3)] == [3, 0, 0]


def test_what_is_odd_is_named_and_what_is_undefined_is_none() -> None:
    values = np.random.default_rng(4).integers(1, 6, (3, 4, 3)).astype(float)
    values[1] = 4
    values[2, 0, 0] = np.nan
    notes = _table(values).notes
    assert notes == ("rater 2: gives 4 to everything; consider leaving that file out",
                     "rater 3: 1 of 12 answers are missing")
    rated = RatingFile("s1", "1", (RatedItem("item0_0", {"beat_match": 3}),))
    ratings = anova.gather({"a": rated, "b": rated}, _key())
    systems, pairs = _rows_of(ratings)
    assert systems["A"]["ratings"] == 1 and systems["B"]["mean, bootstrap"].text() == "-"
    assert {row["p"] for row in pairs.values()} == {"-"}
    for odd in (ratings, _table(np.full((3, 4, 2), 4.0))):
        assert anova.tables(odd)[0].notes[-1] == "One-way ANOVA is not defined."


# ---------------------------------------------------------------- the command

def _files(made: Path, folder: Path, raters: int = 4) -> list[Path]:
    """Ratings as the page saves them: quokka better than the others."""
    key = json.loads((made / "key.json").read_text())
    rng = np.random.default_rng(0)
    files = []
    for rater in range(1, raters + 1):
        answers = [{"item": item, "place": n + 1, "plays": 1, "seconds": 9.5, "ratings": {
                    aspect: int(np.clip(rng.integers(1, 4) + 2 * (own["system"] == "quokka"), 1, 5))
                    for aspect in key["aspects"]}} for n, (item, own) in enumerate(key["items"].items())]
        files.append(folder / f"r{rater}.json")
        files[-1].write_text(json.dumps({"study": key["study"], "rater": str(rater), "answers": answers}))
    return files


def test_analyse_command_writes_tables(made: Path, tmp_path: Path) -> None:
    files = [str(file) for file in _files(made, tmp_path)]
    out = tmp_path / "figures" / "study.json"
    assert ask(["analyse", "--key", str(made / "key.json"), "--out", str(out), *files]) == 0
    systems, pairs, *_ = load(out)
    assert systems.title == "human likeness" and "4 raters" in systems.notes[0] and len(systems.notes) == 2
    quokka: Any = systems.rows["quokka"]
    assert quokka["ratings"] == 16 and quokka["mean, bootstrap"].mean > quokka["mean, bootstrap"].low > 3
    assert "p < 0.0001 ***" in systems.notes[-1]
    assert ["**" in str(row["p"]) for row in pairs.rows.values()] == [True, False, True]


def _bad(folder: Path, told: Any) -> Path:
    file = folder / "bad.json"
    file.write_text(told if isinstance(told, str) else json.dumps(told))
    return file


@pytest.mark.parametrize(("change", "says"), [
    (lambda told: "{", "is not valid JSON"),
    (lambda told: [1], "is not a file of ratings"),
    (lambda told: told | {"study": "other"}, "belongs to study 'other'"),
    (lambda told: told | {"rater": ""}, "rater"),
    (lambda told: told | {"answers": [{"item": "nobody", "ratings": {"beat_match": 3}}]}, "does not know"),
    (lambda told: told | {"answers": [told["answers"][0] | {"ratings": {"beat_match": 6}}]}, "<= 5"),
    (lambda told: told | {"answers": [told["answers"][0] | {"ratings": {"beat_match": "2.5"}}]}, "int"),
    (lambda told: told | {"answers": [own | {"ratings": {"beat_match": k + 1}} for k, own in
                                      enumerate([told["answers"][0]] * 2)]}, "twice and differently"),
    (lambda told: told | {"answers": []}, "length >= 1"),
])
def test_bad_ratings_are_one_line_and_exit_2(made: Path, tmp_path: Path, refused: Any, change: Any, says: str) -> None:
    told = json.loads(_files(made, tmp_path, raters=1)[0].read_text())
    assert says in refused("study", "analyse", "--key", made / "key.json", _bad(tmp_path, change(told)))


def test_other_bad_input_is_one_line_and_exit_2(made: Path, systems: dict[str, Path], tmp_path: Path,
                                                refused: Any) -> None:
    good = [f"{name}={folder}" for name, folder in systems.items()]
    (tmp_path / "empty").mkdir()
    other = tmp_path / "other"
    other.mkdir()
    (other / "walrus0.bvh").write_bytes((systems["quokka"] / "walrus0.bvh").read_bytes())
    soundfile.write(other / "walrus0.wav", _voice(8.0, 77), RATE)
    rated = str(_files(made, tmp_path, raters=1)[0])
    make, analyse = ["make", "--out", str(tmp_path / "out"), "--systems"], ["analyse", "--key"]
    for command, says in [
        ([*make, good[0]], "two systems"), ([*make, good[0], "nothing"], "NAME=VALUE"),
        ([*make, good[0], good[0]], "given before"), ([*make, good[0], "b=/nowhere/at/all"], "not a folder"),
        ([*make, good[0], f"b={tmp_path / 'empty'}"], "holds no motion"),
        ([*make, good[0], f"b={other}"], "different lengths"), ([*make, *good, "--clips", "99"], "only"),
        ([*make, *good, "--seconds", "0"], "1 s"), ([*make, *good, "--raters", "0"], "1 rater"),
        ([*analyse, str(tmp_path / "none.json"), rated], "none.json"), ([*analyse, rated, rated], "not the key"),
    ]:
        assert says in refused("study", *command)
    assert not (tmp_path / "out").exists()


# ---------------------------------------------------------------- in a browser

def placed(key: Key, name: str) -> tuple[int, int]:
    """The numbers of an item's clip and system."""
    return key.items[name].clip, key.systems.index(key.items[name].system)


def test_a_rater_goes_through_the_page(browser: Any, made: Path, tmp_path: Path) -> None:
    """Clip by clip in a rater's order; questions open at the end of a clip; answers outlive a reload."""
    path, complaints, requests = made / "page" / "index.html", [], []
    told = _data(path)
    page = browser.new_page(viewport={"width": 1100, "height": 800})
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(path.as_uri() + "?rater=26")
    page.click("#begin button")
    order = told["orders"][25 % 24]
    for place, item in enumerate(order):
        if place == 2:
            page.reload()
            page.click("#begin button")
        assert page.inner_text("#place") == f"Clip {place + 1} of 12"
        assert page.evaluate("trial.item.id") == told["items"][item]["id"]
        assert page.is_disabled("#next") and page.is_disabled("#questions input >> nth=0")
        before = page.evaluate("document.getElementById('figure').toDataURL()")
        page.click("#play")
        if place == 0:
            page.wait_for_function("() => sound.currentTime > 0.5", timeout=20_000)
            assert page.evaluate("document.getElementById('figure').toDataURL()") != before, "the figure must move"
        else:
            page.evaluate("sound.currentTime = 1.8")
        page.wait_for_function("() => trial.seen", timeout=20_000)
        for number, (name, _) in enumerate(told["questions"]):
            assert page.is_disabled("#next")
            page.check(f"input[name={name}][value='{1 + (place + number) % 5}']")
        page.click("#next")
    assert page.is_visible("#end")
    with page.expect_download() as saved:
        page.click("#save")
    file = tmp_path / saved.value.suggested_filename
    saved.value.save_as(file)
    page.close()
    assert complaints == [] and all(url.startswith(("file:", "data:", "blob:")) for url in requests)
    key = anova.read_key(made / "key.json")
    ratings = anova.read_ratings([file], key)
    assert file.name == f"ratings-{key.study}-26.json" and ratings.notes == () and ratings.raters == ("26",)
    for place, item in enumerate(order):
        assert ratings.values[0, *placed(key, told["items"][item]["id"]), 1] == 1 + (place + 1) % 5


@pytest.mark.parametrize("change", [
    {"clips": [{}] * 600_000}, {"systems": ["a", "a"]}, {"systems": "ab"}, {"aspects": []}, {"study": 5},
    {"items": {"x": {"clip": 10**200, "system": "ours"}}},
])
def test_a_key_that_asks_for_too_much_or_holds_other_things_is_refused(change: dict[str, Any], tmp_path: Path) -> None:
    key = {"study": "s", "systems": ["ours", "truth"], "aspects": ["beat_match"], "clips": [{}],
           "items": {"x": {"clip": 0, "system": "ours"}, "y": {"clip": 0, "system": "truth"}}}
    file = tmp_path / "key.json"
    file.write_text(json.dumps(key))
    assert anova.read_key(file).aspects == ("beat_match",)
    file.write_text(json.dumps(key | change))
    with pytest.raises(InputError, match="is not the key of a study"):
        anova.read_key(file)

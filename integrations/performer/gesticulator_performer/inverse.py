"""Synthesise speech for recorded motion: stressed vowels fall on motion beats, phrases and pauses follow the motion.

The motion is a real person's. It is cut into phrases at its rests; for each of them the best phrase of a pool is
aligned with the motion beats, and its sound is stretched so that vowels and beats coincide. The pool of a voice holds
the time of every vowel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from data_module.motion.motion_beats import beats_of_speed
from data_module.types import Array, Samples, Speech, Word
from gesticulator_performer import cues, text, voices
from gesticulator_performer.joints import FPS
from gesticulator_performer.sound import RATE, Sounded, decibels, recorded, with_tilt
from gesticulator_performer.syllables import Nucleus, Phrase, Spoken, listen
from gesticulator_performer.takes import WRISTS, arms_speed
from gesticulator_performer.text import Part

_LEAST_LETTERS, _LONGEST_LETTERS = 6, 70
# Probability that a phrase is joined with the next of its sentence, because motion has phrases of up to 6 s.
_JOINED = 0.55
# Silence between the phrases while their prominence is measured, seconds.
_PAUSE = 0.3
NO_VOWEL = np.inf
SLOWEST, FASTEST = 0.80, 1.25
"""Bounds of the playing rate of a phrase, relative to the voice's own rate."""
# Delay of the vowel after the motion beat, seconds: mean, standard deviation, and the largest deviation.
_LEAD, _LOOSENESS, _LOOSEST = 0.038, 0.055, 0.13
# Costs: of log rate squared per second, of a second between the edges of phrase and window, of a strong beat without a
# vowel, and of a prominent vowel without a beat.
_RATE_COST, _EDGE_COST, _SKIPPED_BEAT, _SKIPPED_STRESS = 6.0, 1.0, 1.3, 0.12
_STRESS_REWARD, _MEANING_REWARD = 0.4, 0.7
# Seconds by which a phrase may begin before and after the window's start, and end before and after its end.
_START_SLACK, _END_SLACK = (0.2, 0.35), (0.55, 0.15)
# Vowels of less prominence are not put on a beat.
_UNSTRESSED = -1.2
_RATES = np.exp(np.linspace(np.log(SLOWEST), np.log(FASTEST), 7))
# Phrases of suitable length that are tried on each window.
_CANDIDATES = 200
# Length of motion phrases, seconds: mean, standard deviation, least and greatest.
_PHRASE, _PHRASE_SPREAD, _SHORTEST, _LONGEST = 2.6, 1.0, 0.9, 6.0
# Least seconds between two beats that carry vowels.
_BEATS_APART = 0.12
_MINIMA_APART, _SPEED_WEIGHT, _LENGTH_WEIGHT = 0.2, 1.5, 0.35
# A pause extends from its cut while speed stays under this share of the median; greatest and least seconds to either
# side.
_REST_SHARE, _LONGEST_REST, _LEAST_REST = 0.45, 1.2, 0.08
_LEAST_WINDOW = 0.6
# Share of the pauses that are moved off their rest, because real speakers pause while moving too, and the seconds by
# which they are moved.
_MOVED_SHARE, _MOVED = 0.4, (0.35, 0.9)
# Effort = .3 tanh(.55 (local + global energy)) + .6 noise; energy is the z-score of the phrase's mean log speed. Size
# goes with effort mildly: two of three real speakers show no correlation of loudness with hand speed.
_EFFORT_OF_ENERGY, _EFFORT_NOISE = 0.3, 0.6
# Mean and spread of the mean log speed of the stretches of all takes, as measured; 0.2 is added to the spread so that
# the variation within a talk counts more.
_ENERGY, _ENERGY_SPREAD = 0.41, 0.66
# Effort that hands carried a standard deviation and more above the talk's mean add, at full strength of that link.
_EFFORT_OF_CARRIAGE = 0.5
# DB of loudness per unit of local log speed.
_BESIDE = 0.25


@dataclass(frozen=True)
class Pool:
    """The phrases of a voice. texts: [B]; durations: [B] seconds; vowels: [B, I] seconds of vowel onsets from each
    phrase's first sample, infinite beyond the last; prominence: [B, I]; asks: [B, I] index in `cues.MOVEMENTS` of
    the movement that the vowel's word asks for, -1 for none; level: the RMS over all phrases."""

    voice: str
    texts: tuple[str, ...]
    durations: Array
    vowels: Array
    prominence: Array
    asks: Array
    level: float


def phrase_texts(rng: np.random.Generator, count: int, split: str, used: set[str]) -> tuple[str, ...]:
    """`count` new phrases of the grammar, some of them joined; none is in `used`, to which they are added."""
    phrases: list[str] = []
    while len(phrases) < count:
        for utterance in text.compose(rng, 60.0, split, used):
            waiting = ""
            for place, part in enumerate(utterance.parts):
                waiting = f"{waiting} {part.text}".strip()
                goes_on = len(waiting) < _LONGEST_LETTERS and rng.random() < _JOINED
                if goes_on and place < len(utterance.parts) - 1:
                    continue
                if len(waiting) >= _LEAST_LETTERS and waiting not in used:
                    phrases.append(waiting)
                    used.add(waiting)
                waiting = ""
    return tuple(phrases[:count])


def make_pool(voice: str, texts: Sequence[str]) -> Pool:
    spoken = voices.sound_all([text.Part(one, 0.0, _PAUSE) for one in texts], voices.VOICES[voice])
    gap = np.zeros(round(_PAUSE * RATE), dtype=np.float32)
    offset, pieces = 0, []
    nuclei: list[Nucleus] = []
    phrases: list[Phrase] = []
    words: list[Word] = []
    for one in spoken:
        at = offset / RATE
        nuclei += [replace(n, start=n.start + at, vowel=n.vowel + at, end=n.end + at, word=n.word + len(words))
                   for n in voices.nuclei_of(one.phones)]
        words += [replace(w, start=w.start + at, end=w.end + at) for w in one.words]
        phrases.append(Phrase(at, at + len(one.samples) / RATE, 0.0))
        pieces += [one.samples, gap]
        offset += len(one.samples) + len(gap)
    speech = Speech(np.concatenate(pieces), RATE, tuple(words))
    syllables = listen(speech, phrases, nuclei, "en")
    counts = [len(voices.nuclei_of(one.phones)) for one in spoken]
    starts = np.cumsum([0, *counts])
    first_words = np.cumsum([0, *(len(one.words) for one in spoken)])
    shape = (len(spoken), max(counts))
    vowels, prominence, asks = np.full(shape, NO_VOWEL), np.zeros(shape), np.full(shape, -1)
    for k, (one, phrase) in enumerate(zip(spoken, phrases, strict=True)):
        inside = syllables[starts[k]:starts[k + 1]]
        vowels[k, :len(inside)] = [s.vowel - phrase.start for s in inside]
        prominence[k, :len(inside)] = [s.prominence for s in inside]
        wanted = cues.movements_of([w.text for w in one.words])
        for place, syllable in enumerate(inside):
            best = max(s.prominence for s in inside if s.word == syllable.word)
            if syllable.prominence == best:
                asks[k, place] = wanted[syllable.word - first_words[k]]
    level = float(np.sqrt(np.mean(np.concatenate([one.samples for one in spoken]) ** 2))) + 1e-9
    return Pool(voice, tuple(texts), np.array([len(one.samples) / RATE for one in spoken]), vowels, prominence,
                asks, level)


def stretched(samples: Samples, anchors: Array) -> Samples:
    """Time-stretch samples at 16 kHz with the pitch unchanged: WSOLA with windows of 40 ms. anchors: [K, 2] seconds in
    and out, rising in both columns, the first (0, 0), the last at the end of the samples."""
    import pytsmod

    marks = np.round(anchors.T * RATE).astype(int)
    marks[0, -1] = min(marks[0, -1], len(samples) - 1)
    keep = np.concatenate([[True], (np.diff(marks) > 0).all(axis=0)])
    out = pytsmod.wsola(samples.astype(np.float64), marks[:, keep], win_size=640, syn_hop_size=320, tolerance=200)
    return np.asarray(out, dtype=np.float32).ravel()[:marks[1, -1]]


@dataclass(frozen=True)
class Window:
    """The seconds of motion that a phrase has to fill."""

    start: float
    end: float


@dataclass(frozen=True)
class Wanted:
    """The requirements of a window on its phrase. beats: [n] seconds, rising, at which vowels should fall; strength:
    [n]; movement: [n, M] z-scores of the features of motion (`cues.MOVEMENTS`) at each beat."""

    window: Window
    beats: Array
    strength: Array
    movement: Array


@dataclass(frozen=True)
class Candidates:
    """B phrases. indices: [B] in the pool; durations: [B]; vowels: [B, I], infinite beyond the last; prominence."""

    indices: NDArray[np.int64]
    durations: Array
    vowels: Array
    prominence: Array


@dataclass(frozen=True)
class Match:
    """A phrase of a pool on a window. anchors: [K, 2] seconds in the phrase and in the talk; beats: vowels on beats."""

    phrase: int
    cost: float
    anchors: Array
    beats: int


def log_speed(speed: Array) -> Array:
    """[T] log of the arms' speed smoothed over 0.1 s, with a floor of 0.1 m/s."""
    return np.log(gaussian_filter1d(speed, 0.1 * FPS, mode="nearest") + 0.1)


def speech_for(places: Array, pool: Pool, movements: Array,
               rng: np.random.Generator) -> Spoken:
    """Speech for the joint positions [T, 16, 3] (60 fps, facing frame) of a talk. movements: [T, M] z-score of each of
    `cues.MOVEMENTS` at each frame. InputError comes from the voice's program. Same arguments and generator state,
    same bytes."""
    speed = arms_speed(places)
    windows = phrase_windows(speed, rng)
    beats = beats_of_speed(speed, FPS)
    strength = _strengths(speed, beats)
    targets = beats + np.clip(rng.normal(_LEAD, _LOOSENESS, len(beats)), _LEAD - _LOOSEST, _LEAD + _LOOSEST)
    efforts = _efforts(log_speed(speed), windows, _carried(places), rng)
    features = movements[np.minimum((beats * FPS).astype(int) + 6, len(movements) - 1)]
    free = np.ones(len(pool.texts), dtype=bool)
    laid: list[tuple[Match, Sounded, float]] = []
    for window, effort in zip(windows, efforts, strict=True):
        near = np.flatnonzero((targets > window.start + 0.02) & (targets < window.end + 0.05))
        near = near[np.argsort(targets[near])]
        wanted = Wanted(window, targets[near], strength[near], features[near])
        best = _best(pool, free, wanted, rng)
        if best is None:
            continue
        free[best.phrase] = False
        match, sounded = _spoken_again(pool, best, effort, wanted)
        laid.append((match, sounded, effort))
    return _laid_out(pool, laid, log_speed(speed), rng)


def phrase_windows(speed: Array, rng: np.random.Generator) -> list[Window]:
    """The phrases of a motion from its speed [T], in order, without the rests between them. Cuts are minima of the
    speed, chosen by dynamic programming for low speed at the cuts and phrases of about 2.6 s; some cuts are then moved
    off their rests."""
    smooth = gaussian_filter1d(speed, 0.15 * FPS, mode="nearest")
    middle = float(np.median(smooth))
    cuts = _cuts(smooth, middle)
    rests = [_rest(smooth, cut, middle) for cut in cuts]
    for k in range(1, len(cuts) - 1):
        if rng.random() < _MOVED_SHARE:
            by = round(float(rng.uniform(*_MOVED)) * FPS) * (1 if rng.random() < 0.5 else -1)
            half = round(float(rng.uniform(0.08, 0.3)) * FPS)
            at = int(np.clip(cuts[k] + by, cuts[k - 1] + FPS, cuts[k + 1] - FPS))
            rests[k] = (at - half, at + half)
    windows = [Window(max(a[1] / FPS, 0.05), b[0] / FPS) for a, b in zip(rests, rests[1:], strict=False)]
    return [window for window in windows if window.end - window.start > _LEAST_WINDOW]


def _cuts(smooth: Array, middle: float) -> list[int]:
    minima = find_peaks(-smooth, distance=round(_MINIMA_APART * FPS))[0]
    places = np.concatenate([[0], minima[(minima > 0) & (minima < len(smooth) - 1)], [len(smooth) - 1]])
    best, before = np.full(len(places), np.inf), np.zeros(len(places), dtype=int)
    best[0] = 0.0
    for k in range(1, len(places)):
        length = (places[k] - places[:k]) / FPS
        cost = best[:k] + _LENGTH_WEIGHT * ((length - _PHRASE) / _PHRASE_SPREAD) ** 2
        cost += 50.0 * ((length < _SHORTEST) | (length > _LONGEST))
        before[k] = int(cost.argmin())
        best[k] = cost.min() + _SPEED_WEIGHT * smooth[places[k]] / max(middle, 1e-6)
    cuts = [len(places) - 1]
    while cuts[-1]:
        cuts.append(int(before[cuts[-1]]))
    return [int(places[k]) for k in reversed(cuts)]


def _rest(smooth: Array, cut: int, middle: float) -> tuple[int, int]:
    slow = smooth < _REST_SHARE * middle
    most, least = round(_LONGEST_REST * FPS), round(_LEAST_REST * FPS)
    first = cut
    while first > max(0, cut - most) and slow[first - 1]:
        first -= 1
    last = cut
    while last < min(len(smooth) - 1, cut + most) and slow[last + 1]:
        last += 1
    return min(first, cut - least), max(last, cut + least)


def _strengths(speed: Array, beats: Array) -> Array:
    """[n] deceleration at each beat over half its standard deviation, clipped to 0.4 .. 2."""
    slope = -np.gradient(speed) * FPS
    at = np.interp(beats * FPS, np.arange(len(speed)), slope)
    return np.clip(at / max(0.5 * float(slope.std()), 1e-6), 0.4, 2.0)


def _carried(places: Array) -> Array:
    """[T] z-score of how high and how far out the higher hand is, from joint positions [T, 16, 3]."""
    hands = places[:, list(WRISTS)] - places[:, :1]
    at = hands[..., 1].argmax(axis=1)
    higher = hands[np.arange(len(hands)), at]
    both = np.stack([higher[:, 1], np.linalg.norm(higher[:, [0, 2]], axis=-1)], axis=1)
    return ((both - both.mean(axis=0)) / (both.std(axis=0) + 1e-6)).mean(axis=1)


def _means(track: Array, windows: Sequence[Window]) -> Array:
    """[windows] the mean of a track [T] in each."""
    return np.array([track[round(w.start * FPS):max(round(w.start * FPS) + 1, round(w.end * FPS))].mean()
                     for w in windows])


def _efforts(level: Array, windows: Sequence[Window], carried: Array,
             rng: np.random.Generator) -> list[float]:
    """The effort of each window, -1 to 1, from the energy of its motion, and from how its hands are `carried` [T]."""
    if not windows:
        return []
    means = _means(level, windows)
    local = (means - means.mean()) / (means.std() + 1e-6)
    whole = (means - _ENERGY) / _ENERGY_SPREAD
    effort = _EFFORT_OF_ENERGY * np.tanh(0.55 * (local + whole))
    effort = effort + rng.normal(0.0, _EFFORT_NOISE, len(means))
    effort = effort + _EFFORT_OF_CARRIAGE * np.tanh(_means(carried, windows))
    return np.clip(effort, -1.0, 1.0).tolist()


def _best(pool: Pool, free: NDArray[np.bool_], wanted: Wanted, rng: np.random.Generator) -> Match | None:
    start, end = wanted.window.start, wanted.window.end
    length = pool.durations / (end - start)
    fitting = np.flatnonzero(free & (length > SLOWEST * 0.97) & (length < FASTEST * 1.03))
    if not len(fitting):
        return None
    chosen = rng.permutation(fitting)[:_CANDIDATES]
    if len(wanted.beats):
        candidates = Candidates(chosen, pool.durations[chosen], pool.vowels[chosen], pool.prominence[chosen])
        return assign(candidates, wanted, rewards(pool, chosen, wanted))
    k = int(chosen[0])
    rate = float(np.clip(length[k], SLOWEST, FASTEST))
    return Match(k, 0.0, np.array([[0.0, start], [pool.durations[k], start + pool.durations[k] / rate]]), 0)


def rewards(pool: Pool, chosen: NDArray[np.int64], wanted: Wanted) -> Array:
    """[B, I, n] the reward for each vowel on each beat: stress on strong beats, words on motion of their cues."""
    stress = 0.8 + _STRESS_REWARD * np.clip(pool.prominence[chosen], -1.2, 2.0)
    asks = pool.asks[chosen]
    fits = np.where(asks >= 0, 1.0, 0.0)[..., None] * wanted.movement.T[np.maximum(asks, 0)]
    return stress[:, :, None] * wanted.strength + _MEANING_REWARD * fits


def assign(candidates: Candidates, wanted: Wanted, reward: Array) -> Match | None:
    """The cheapest monotone assignment of vowels to beats over all candidates; None if no candidate fits the bounds.
    Dynamic programming over pairs (vowel i, beat j): C[i, j] = min over earlier pairs of C + 6 ln(rate)^2 dt + cost of
    the vowels and beats skipped between them - reward [B, I, n] of the pair. Rates stay in [SLOWEST, FASTEST]."""
    usable = np.isfinite(candidates.vowels) & (candidates.prominence > _UNSTRESSED)
    at = np.where(usable, candidates.vowels, 0.0)
    stress = np.where(usable, np.clip(candidates.prominence, 0.0, 2.0), 0.0)
    vowels = np.pad(np.cumsum(stress, axis=1), ((0, 0), (1, 0))) * _SKIPPED_STRESS
    beats = np.concatenate([[0.0], np.cumsum(wanted.strength)]) * _SKIPPED_BEAT
    shape = (*at.shape, len(wanted.beats))
    table = _Table(at, vowels, beats, np.full(shape, np.inf), np.full((*shape, 2), -1), np.zeros(shape))
    for j in range(len(wanted.beats)):
        best = _begun(table, wanted, j)
        for earlier in range(j):
            if wanted.beats[j] - wanted.beats[earlier] >= _BEATS_APART:
                best = _gone_on(table, wanted, best, earlier, j)
        table.cost[..., j] = np.where(usable, best - reward[..., j], np.inf)
    return _ended(candidates, wanted, table)


@dataclass(frozen=True)
class _Table:
    """The dynamic program. at: [B, I] vowels; skipped_vowels: [B, I + 1], skipped_beats: [n + 1] cumulated costs; cost:
    [B, I, n]; back: [B, I, n, 2] the pair before, -1 for none; begin: [B, I, n] seconds at which the phrase begins."""

    at: Array
    skipped_vowels: Array
    skipped_beats: Array
    cost: Array
    back: NDArray[np.int64]
    begin: Array


def _begun(table: _Table, wanted: Wanted, j: int) -> Array:
    """[B, I] the cost of beat j as the first, at the best rate from the phrase's start; stores the start in `table`."""
    first = table.at[..., None] / _RATES
    start = wanted.beats[j] - first
    window = wanted.window.start
    allowed = (start >= window - _START_SLACK[0]) & (start <= window + _START_SLACK[1])
    price = _RATE_COST * np.log(_RATES) ** 2 * first + _EDGE_COST * np.abs(start - window)
    price = np.where(allowed, price, np.inf)
    pick = price.argmin(axis=-1)[..., None]
    table.begin[..., j] = np.take_along_axis(start, pick, axis=-1)[..., 0]
    return price.min(axis=-1) + table.skipped_beats[j] + table.skipped_vowels[:, :-1]


def _gone_on(table: _Table, wanted: Wanted, best: Array, earlier: int, j: int) -> Array:
    """[B, I] the lower of `best` and the cost of beat j after an earlier beat; stores the way back in `table`."""
    lasts = wanted.beats[j] - wanted.beats[earlier]
    rate = (table.at[:, None, :] - table.at[:, :, None]) / lasts
    fine = (rate >= SLOWEST) & (rate <= FASTEST)
    price = table.cost[:, :, earlier, None] + _RATE_COST * lasts * np.log(np.where(fine, rate, 1.0)) ** 2
    price = price + table.skipped_beats[j] - table.skipped_beats[earlier + 1]
    price = price + table.skipped_vowels[:, None, :-1] - table.skipped_vowels[:, 1:, None]
    price = np.where(fine, price, np.inf)
    source, least = price.argmin(axis=1), price.min(axis=1)
    better = least < best
    table.back[..., j, 0] = np.where(better, source, table.back[..., j, 0])
    table.back[..., j, 1] = np.where(better, earlier, table.back[..., j, 1])
    return np.where(better, least, best)


def _ended(candidates: Candidates, wanted: Wanted, table: _Table) -> Match | None:
    """The candidate with the lowest total cost over all possible ends, traced back to its start."""
    rest = (candidates.durations[:, None, None] - table.at[:, :, None])[..., None] / _RATES
    end = wanted.beats[None, None, :, None] + rest
    window = wanted.window.end
    allowed = (end >= window - _END_SLACK[0]) & (end <= window + _END_SLACK[1])
    price = np.where(allowed, _RATE_COST * np.log(_RATES) ** 2 * rest + _EDGE_COST * np.abs(end - window), np.inf)
    total = table.cost + price.min(axis=-1) + (table.skipped_beats[-1] - table.skipped_beats[1:])
    total = total + (table.skipped_vowels[:, -1:] - table.skipped_vowels[:, 1:])[:, :, None]
    b, i, j = (int(k) for k in np.unravel_index(int(total.argmin()), total.shape))
    cost = float(total[b, i, j])
    if not np.isfinite(cost):
        return None
    last, duration = float(end[b, i, j, int(price[b, i, j].argmin())]), float(candidates.durations[b])
    pairs = [(i, j)]
    while table.back[b, i, j, 0] >= 0:
        i, j = (int(k) for k in table.back[b, i, j])
        pairs.append((i, j))
    inner = [(float(table.at[b, i]), float(wanted.beats[j])) for i, j in reversed(pairs)]
    first = (0.0, float(table.begin[b, pairs[-1][0], pairs[-1][1]]))
    anchors = [first, *(pair for pair in inner if 0.01 < pair[0] < duration - 0.01), (duration, last)]
    return Match(int(candidates.indices[b]), cost, np.array(anchors), len(pairs))


def _spoken_again(pool: Pool, match: Match, effort: float, wanted: Wanted) -> tuple[Match, Sounded]:
    """Speak the phrase with its effort and align it again, because effort changes the rate and so the vowel times."""
    k = match.phrase
    sounded = voices.sound_all([Part(pool.texts[k], effort, 0.0)], voices.VOICES[pool.voice])[0]
    duration = len(sounded.samples) / RATE
    times = np.array([n.vowel for n in voices.nuclei_of(sounded.phones)])
    count = int(np.isfinite(pool.vowels[k]).sum())
    if len(wanted.beats) and len(times) == count:
        one, vowels = np.array([k]), pool.vowels[k].copy()
        vowels[:count] = times
        again = assign(Candidates(one, np.array([duration]), vowels[None], pool.prominence[one]), wanted,
                       rewards(pool, one, wanted))
        if again is not None:
            return again, sounded
    # Otherwise keep the alignment of the phrase at effort 0, scaled to the new duration.
    return replace(match, anchors=match.anchors * np.array([duration / pool.durations[k], 1.0])), sounded


def _laid_out(pool: Pool, laid: Sequence[tuple[Match, Sounded, float]], level: Array,
              rng: np.random.Generator) -> Spoken:
    """Place the phrases in time at the loudness of their effort, record them and measure the syllables. level: log
    speed [T] of the motion, which is heard beside the effort."""
    count = round(len(level) / FPS * RATE)
    dry, active = np.zeros(count, dtype=np.float32), np.zeros(count, dtype=bool)
    near = (level - level.mean()) / (level.std() + 1e-6)
    words: list[Word] = []
    nuclei: list[Nucleus] = []
    phrases: list[Phrase] = []
    for match, sounded, effort in laid:
        start = max(0.0, float(match.anchors[0, 1]), phrases[-1].end + 0.01 if phrases else 0.0)
        anchors = match.anchors - np.array([0.0, match.anchors[0, 1]])
        samples = with_tilt(stretched(sounded.samples, anchors), effort)
        first = round(start * RATE)
        samples = samples[:max(0, count - first)]
        if not len(samples):
            continue
        times = (first + np.arange(len(samples))) / RATE
        local = _BESIDE * np.tanh(np.interp(times, np.arange(len(near)) / FPS, near))
        gain = 0.1 / pool.level * decibels(voices.LOUDER * effort) * 10.0 ** (local / 20.0)
        dry[first:first + len(samples)] += samples * gain.astype(np.float32)
        active[first:first + len(samples)] = True
        end = (first + len(samples)) / RATE
        unmoved = voices.nuclei_of(sounded.phones)
        moved = np.interp([[n.start, n.vowel, n.end] for n in unmoved], anchors[:, 0], anchors[:, 1]) + start
        nuclei += [Nucleus(float(a), float(b), float(c), n.word + len(words))
                   for n, (a, b, c) in zip(unmoved, np.minimum(moved, end), strict=True)]
        spans = np.interp([[w.start, w.end] for w in sounded.words], anchors[:, 0], anchors[:, 1]) + start
        spans = np.minimum(spans, end)
        words += [Word(w.text, float(a), float(b)) for w, (a, b) in zip(sounded.words, spans, strict=True)]
        phrases.append(Phrase(start, end, effort))
    speech = Speech(recorded(dry, active, rng), RATE, tuple(words), pool.voice)
    return Spoken(speech, listen(speech, phrases, nuclei, "en"), tuple(phrases), "en")

"""Plan a performance: which hand plays each phrase, which stroke falls on which syllable, its size and its speed.

Words with a meaning take their stroke with some probability; prominent syllables then take beats. Size and speed
follow the loudness of the syllable and the effort of its phrase, so that they are predictable from the sound.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.types import Array
from gesticulator_performer.cues import BEATS, Asked, beat_level, lexemes_of
from gesticulator_performer.strokes import LEFT, RIGHT, Stroke, StrokeSet
from gesticulator_performer.syllables import Phrase, Spoken, Syllable
from gesticulator_performer.tables import table
from gesticulator_performer.voices import NEUTRAL, StyleTrack

HANG, LOW, STAY = "hang", "low", "stay"
HANGING_LEVEL = 0.04
"""Level, as a share of the home pose, of a hand that hangs while the other one acts."""
# Probability that a raised hand keeps its level when the next phrase begins.
_STAY_UP = 0.4
# Seconds before a phrase at which a hand starts to move, and their standard deviation.
_EARLY, _JITTER = 0.3, 0.13
# Length in seconds of the pauses in which the hands may sink before the next phrase.
_FALL_GAP = (0.45, 1.7)
# Weights of strokes of the left hand, the right hand and both, by the acting hands.
_WEIGHTS = {(LEFT,): (1.0, 0.03, 0.10), (RIGHT,): (0.03, 1.0, 0.10), (LEFT, RIGHT): (0.12, 0.12, 1.0)}
# Lag of one hand in a two-handed stroke, seconds, and the standard deviation of the log ratio of the two gains.
_LAG, _UNEVEN = (0.03, 0.08), 0.13
REST_PAUSE = 1.6
"""Pause in speech, seconds, after which the arms go to rest."""
BRAKE = 0.789
"""Share of the length of a minimum-jerk movement at which it decelerates hardest."""
# Least seconds between the beats of two strokes.
_MIN_GAP = 0.5
# Least seconds from the start of a stroke to its beat; with less room the stroke is not played.
_MIN_PREPARATION = 0.42
# Seconds after a beat in which its arm takes no new stroke, because it is still decelerating.
_AFTER_BEAT = 0.12
# Gap between the end of a hold and the next stroke, seconds, below which the hold is extended instead of retracted.
_JOIN = 1.2
# Largest factor on the length of an extended hold.
_STRETCH = 1.6
# Longest hold after stretching, seconds.
_LONGEST_HOLD = 1.0
# Number of recent clips that are unlikely to be repeated.
_RECENT = 3
# Factor on the probability of a recent clip.
_RECENT_WEIGHT = 0.1
# Slopes: log gain by vigour, log gain by amplitude, log speed by tempo, eagerness by tempo.
_SIZE_OF_DRIVE, _SIZE_OF_STYLE, _PACE_OF_STYLE, _EAGER_OF_TEMPO = 0.28, 0.4, 0.25, 0.9
# Largest gain: beyond it elbows fold and hands come near the face.
_LARGEST = 1.75
# Log of the wished size of a take from a script, by vigour and amplitude, and the standard deviation about it.
_SIZE_OF_TAKES, _SPREAD_OF_TAKES = np.array([0.35, 0.3]), 0.3
# Earliest and latest apex of a gesture under a budget, seconds from the stressed vowel.
_APEX = (-0.16, 0.02)
# Under a budget: seconds between two gestures with a meaning, and until a label comes again.
_BUDGET = (3.0, 20.0)
# Least share of its preparation and stroke that a take from a script is given.
_HURRIED = 0.6
# Seconds before such a gesture in which no beat is placed, so that its preparation has room.
_READIED = 0.75


@dataclass(frozen=True)
class Manner:
    """The manner of a performance, drawn per talk so that two talks of a performer differ.

    both: probability that a phrase is played with both hands; dominant: share of the other phrases that the preferred
    hand plays; switch: probability that the next phrase is drawn anew; hanging: probability that the idle hand hangs;
    falling: probability that hands sink in a short pause; gain, hold, drift: factors on the excursion, the holds and
    the drift of the arms; small_beats: least prominence of a free syllable that gets a small beat; eagerness: added to
    the performer's; sympathy: share of the acting hand's motion that the hanging hand follows; trunk: factor on the
    trunk's motion; drop: seconds in which the arms come to rest.
    """

    both: float
    dominant: float
    switch: float
    hanging: float
    falling: float
    gain: float
    hold: float
    drift: float
    small_beats: float
    eagerness: float
    trunk: float
    sympathy: float = 0.08
    drop: float = 1.7


@dataclass(frozen=True)
class PhraseHands:
    """The sides that act from `start` to `end` (seconds), and what the idle one does."""

    start: float
    end: float
    acting: tuple[int, ...]
    idle: str


def draw_manner(rng: np.random.Generator) -> Manner:
    return Manner(both=rng.uniform(0.7, 0.95), dominant=rng.uniform(0.55, 0.8), switch=rng.uniform(0.35, 0.7),
                  hanging=rng.uniform(0.05, 0.25), falling=rng.uniform(0.05, 0.3),
                  gain=float(np.clip(1.65 * np.exp(rng.normal(0.0, 0.07)), 1.4, 1.85)), hold=rng.uniform(1.1, 1.7),
                  drift=rng.uniform(1.2, 2.0), small_beats=rng.uniform(1.4, 2.2), eagerness=rng.uniform(0.0, 0.7),
                  trunk=float(np.exp(rng.normal(0.0, 0.15))))


STEADY = Manner(both=0.85, dominant=0.67, switch=0.5, hanging=0.12, falling=0.15, gain=1.5, hold=1.3, drift=1.45,
                small_beats=0.2, eagerness=0.1, trunk=1.0)
"""The fixed manner of a talk with an audible style: nothing but the style varies."""


def hands_of_phrases(phrases: Sequence[Phrase], manner: Manner, preferred: int,
                     rng: np.random.Generator) -> tuple[PhraseHands, ...]:
    shares = ((1.0 - manner.both) * manner.dominant, (1.0 - manner.both) * (1.0 - manner.dominant), manner.both)
    choices = ((preferred,), (1 - preferred,), (LEFT, RIGHT))
    out: list[PhraseHands] = []
    for phrase in sorted(phrases, key=lambda p: p.start):
        if not out or rng.random() < manner.switch:
            acting = choices[int(rng.choice(3, p=shares))]
        idle = HANG if rng.random() < manner.hanging else LOW if rng.random() < 0.5 else STAY
        out.append(PhraseHands(phrase.start, phrase.end, acting, idle))
    return tuple(out)


def weights_at(hands: Sequence[PhraseHands], time: float) -> tuple[float, float, float]:
    """Weights of left-hand, right-hand and two-handed strokes at a time; a stroke may start before its phrase."""
    for phrase in hands:
        if phrase.start - 0.4 <= time < phrase.end:
            return _WEIGHTS[phrase.acting]
    return _WEIGHTS[LEFT, RIGHT]


Levels = tuple[list[tuple[float, float]], list[tuple[float, float]]]
"""Per arm [(seconds, share of the home pose)]."""


def waiting_levels(hands: Sequence[PhraseHands], drives: Sequence[float], run_starts: Sequence[float],
                   raise_time: float, manner: Manner, rng: np.random.Generator) -> Levels:
    """Per arm [(time, share of the home pose)]: the height at which it waits in each phrase. drives: the vigour of each
    phrase. run_starts: seconds at which speech begins after a long pause; the hands rise `raise_time` before it."""
    out: Levels = ([], [])
    for k, (phrase, drive) in enumerate(zip(hands, drives, strict=True)):
        first = any(abs(phrase.start - start) < 0.05 for start in run_starts)
        for side in (LEFT, RIGHT):
            time = phrase.start - (raise_time if first else _EARLY) + float(rng.normal(0.0, _JITTER))
            level = _level(phrase, side, drive, bool(out[side]) and not first, out[side], rng)
            if level is not None:
                out[side].append((time, level))
        gap = hands[k + 1].start - phrase.end if k + 1 < len(hands) else 0.0
        if _FALL_GAP[0] < gap < _FALL_GAP[1] and rng.random() < manner.falling:
            for side in (LEFT, RIGHT):
                if rng.random() < 0.7:
                    out[side].append((phrase.end + 0.05 + float(rng.uniform(0.0, 0.2)), HANGING_LEVEL))
    for levels in out:
        levels.sort()
    return out


def _level(phrase: PhraseHands, side: int, drive: float, going_on: bool, levels: list[tuple[float, float]],
           rng: np.random.Generator) -> float | None:
    """The level that an arm takes for a phrase; None to stay at the last of its `levels`."""
    if side in phrase.acting:
        if going_on and levels[-1][1] > 0.4 and rng.random() < _STAY_UP:
            return None
        return float(rng.uniform(0.6, 1.15) * np.exp(0.2 * drive))
    if phrase.idle == HANG or not levels:
        return HANGING_LEVEL
    return float(rng.uniform(0.25, 0.55)) if phrase.idle == LOW else None


def unevenness(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Lag [count, 2] seconds and gain [count, 2] of the left and the right hand in two-handed strokes."""
    lag, gain = np.zeros((count, 2)), np.ones((count, 2))
    later, rows = rng.integers(0, 2, count), np.arange(count)
    lag[rows, later] = rng.uniform(*_LAG, count)
    ratio = np.exp(rng.normal(0.0, _UNEVEN, count))
    gain[rows, later], gain[rows, 1 - later] = 1.0 / ratio, ratio
    return lag, gain


@dataclass(frozen=True)
class Habits:
    """The habits of a performer.

    meaning: probability that a meaningful word takes its stroke; eagerness: offset on the prominence at which a
    syllable takes a beat; hands: weights of left, right, both; looseness: standard deviation of the beat about the
    syllable, seconds; speed and gain: relative to the recorded clips; nod: size of a nod, degrees; damping: seconds of
    the low pass of the arms, longer for a performer whose clips tremble.
    """

    meaning: float = 0.65
    eagerness: float = 0.0
    hands: tuple[float, float, float] = (1.0, 1.0, 1.0)
    looseness: float = 0.05
    speed: float = 1.2
    gain: float = 1.0
    nod: float = 3.0
    damping: float = 0.02


HABITS = {name: Habits(**{**row, "hands": tuple(row["hands"])}) for name, row in table("clips.toml")["habits"].items()}


@dataclass(frozen=True)
class Planned:
    """A stroke placed in time, seconds of the performance. gain: factor on the excursion; lag, uneven: delay in seconds
    and factor on the gain of the left and the right hand. meaning: label of the gesture that a word calls for
    and the clip shows ("point_there"), "" for a beat; word: index of the word that it falls on, -1 if unknown."""

    stroke: Stroke
    start: float
    beat: float
    hold_end: float
    end: float
    syllable: float
    gain: float
    lag: tuple[float, float] = (0.0, 0.0)
    uneven: tuple[float, float] = (1.0, 1.0)
    meaning: str = ""
    word: int = -1


@dataclass(frozen=True)
class _Wish:
    """A syllable that should have a stroke: its candidate lexemes, the time of the beat, the vigour, the label of the
    meaning that its word asks for ("" for none), and the log of the size that a take from a script should have."""

    at: Syllable
    beat: float
    lexemes: tuple[str, ...]
    drive: float
    label: str = ""
    size: float = 0.0


def runs_of(phrases: Sequence[Phrase], pause: float = REST_PAUSE) -> list[tuple[float, float]]:
    """Stretches of speech [(start, end)] in seconds, phrases joined across pauses shorter than `pause`."""
    runs: list[tuple[float, float]] = []
    for phrase in sorted(phrases, key=lambda p: p.start):
        if runs and phrase.start - runs[-1][1] < pause:
            runs[-1] = (runs[-1][0], max(runs[-1][1], phrase.end))
        else:
            runs.append((phrase.start, phrase.end))
    return runs


def drives(spoken: Spoken) -> Array:
    """The vigour of each syllable, [syllables], -1 to 1: half the effort of its phrase, half its loudness (averaged
    with the phrase's; 6 dB give about 0.75), so that it can be predicted from the sound."""
    loud = np.array([s.loudness for s in spoken.syllables])
    starts = np.array([s.vowel for s in spoken.syllables])
    out = np.zeros(len(loud))
    for phrase in spoken.phrases:
        inside = (starts >= phrase.start) & (starts < phrase.end)
        if inside.any():
            level = 0.5 * loud[inside] + 0.5 * loud[inside].mean()
            out[inside] = 0.5 * np.clip(phrase.effort, -1.0, 1.0) + 0.5 * np.tanh(level / 6.0)
    return np.clip(out, -1.0, 1.0)


@dataclass(frozen=True)
class Casting:
    """The manner of a talk, the hands that play each of its phrases, and its style."""

    manner: Manner
    hands: tuple[PhraseHands, ...]
    style: StyleTrack = NEUTRAL

    def habits_of(self, performer: str) -> Habits:
        habits = HABITS.get(performer, Habits())
        return replace(habits, eagerness=habits.eagerness + self.manner.eagerness)


def cast(spoken: Spoken, performer: str, manner: Manner, style: StyleTrack, rng: np.random.Generator) -> Casting:
    left, right, _ = HABITS.get(performer, Habits()).hands
    return Casting(manner, hands_of_phrases(spoken.phrases, manner, RIGHT if right >= left else LEFT, rng), style)


def plan(spoken: Spoken, performer: str, strokes: StrokeSet, casting: Casting, rng: np.random.Generator,
         split: str = "train") -> tuple[Planned, ...]:
    """The strokes that `performer` plays on `spoken`, in order of their beats, without overlap on one arm. Held-out
    strokes are used in the split "test" only."""
    usable = strokes.of(performer, split)
    habits = casting.habits_of(performer)
    known = {stroke.lexeme for stroke in usable}
    cues = strokes.cues
    words = spoken.speech.words or ()
    pauses = [max(after.start - word.end, 0.0) for word, after in zip(words, words[1:], strict=False)]
    asked = cues.asked(_texts(spoken), spoken.language, pauses) if cues else {}
    apart, again = _BUDGET if cues and cues.detected else (0.0, 0.0)
    labels = _labels(spoken, habits, asked, ({stroke.meaning for stroke in usable}, apart, again), rng)
    wishes = _wishes(spoken, habits, known, (casting.style, labels, set(asked), apart > 0.0), rng)
    chosen: list[Planned] = []
    recent: list[str] = []
    busy = {LEFT: 0.0, RIGHT: 0.0}
    for wish in wishes:
        habits = replace(habits, hands=weights_at(casting.hands, wish.at.vowel))
        stroke = _choose(wish, usable, habits, recent, rng)
        stroke = strokes.played(stroke, performer) if stroke else None
        placed = _place(stroke, wish, habits, busy, casting, rng) if stroke else None
        if stroke is None or placed is None:
            continue
        chosen.append(replace(placed, meaning=stroke.meaning if stroke.meaning == wish.label else "",
                              word=wish.at.word, gain=1.0 if stroke.faithful else placed.gain))
        recent = [*recent, stroke.base][-_RECENT:]
        for side in stroke.sides:
            busy[side] = placed.hold_end if stroke.scripted else placed.beat + _AFTER_BEAT
    joined = _join(chosen, runs_of(spoken.phrases))
    lags, gains = unevenness(rng, len(joined))
    alike = [len(p.stroke.sides) < 2 or p.stroke.scripted for p in joined]
    uneven = [p if same else replace(p, lag=tuple(lag), uneven=tuple(gain))
              for p, same, lag, gain in zip(joined, alike, lags.tolist(), gains.tolist(), strict=True)]
    return _held_through(uneven, spoken.phrases)


def _wishes(spoken: Spoken, habits: Habits, known: set[str],
            given: tuple[StyleTrack, Mapping[int, str], set[int], bool], rng: np.random.Generator) -> list[_Wish]:
    """The syllables with strokes. given: the style, the labels of meanings by syllable, the words with a cue, and
    whether meanings have a budget: beats then leave room before them."""
    style, labels, cued, budgeted = given
    syllables = spoken.syllables
    if not syllables:
        return []
    strength = drives(spoken)
    loose = np.clip(rng.normal(-0.010, habits.looseness, len(syllables)), -0.13, 0.11)
    taken: dict[int, tuple[str, ...]] = dict.fromkeys(labels, ())
    if spoken.language == "en":
        taken |= _meaningful(spoken, habits, known, (set(taken), cued), rng)
    times = np.array([s.vowel for s in syllables])
    tempo = style.at(times)[:, 1]
    eager = habits.eagerness + _EAGER_OF_TEMPO * tempo
    chance = 1.0 / (1.0 + np.exp(-3.0 * (np.array([s.prominence for s in syllables]) - 0.1 + eager)))
    draws, moods = rng.random(len(syllables)), rng.normal(0.0, 0.3, len(syllables))
    gaps = np.maximum(_MIN_GAP, rng.uniform(_MIN_GAP, _MIN_GAP + 0.35, len(syllables)) * np.exp(-0.3 * tempo))
    for i, syllable in enumerate(syllables):
        near = min((abs(times[i] - times[j]) for j in taken), default=np.inf)
        if budgeted and any(0.0 <= times[j] - times[i] < _READIED for j in labels):
            continue
        if i not in taken and near >= gaps[i] and draws[i] < chance[i]:
            level = beat_level(syllable.prominence + 0.5 * strength[i] + moods[i])
            taken[i] = tuple(name for name in BEATS[level] if name in known) or tuple(
                name for names in BEATS.values() for name in names if name in known)
    if budgeted:
        loose[list(labels)] = np.clip(loose[list(labels)], *_APEX)
    sizes = np.column_stack([strength, style.at(times)[:, 0]]) @ _SIZE_OF_TAKES
    wishes = [_Wish(syllables[i], float(times[i] + loose[i]), taken[i], float(strength[i]), labels.get(i, ""),
                    float(sizes[i])) for i in sorted(taken)]
    if budgeted:
        # The gesture with a meaning goes first: beats near it give way.
        meant = [wish.at.vowel for wish in wishes if wish.label]
        wishes = [wish for wish in wishes if wish.label or not any(
            -_MIN_GAP < wish.at.vowel - time < _MIN_GAP or 0.0 <= time - wish.at.vowel < _READIED for time in meant)]
    return [wish for before, wish in zip([None, *wishes], wishes, strict=False)
            if before is None or wish.at.vowel - before.at.vowel >= _MIN_GAP - 1e-9]


def _texts(spoken: Spoken) -> list[str]:
    return [word.text for word in spoken.speech.words or ()]


def _strongest(spoken: Spoken) -> dict[int, int]:
    """Index of each word that is known -> index of its most prominent syllable."""
    strongest: dict[int, int] = {}
    for i, syllable in enumerate(spoken.syllables):
        best = strongest.get(syllable.word)
        if 0 <= syllable.word < len(spoken.speech.words or ()) and (
                best is None or syllable.prominence > spoken.syllables[best].prominence):
            strongest[syllable.word] = i
    return strongest


def _labels(spoken: Spoken, habits: Habits, asked: Mapping[int, Asked], limits: tuple[set[str], float, float],
            rng: np.random.Generator) -> dict[int, str]:
    """The syllables that play a meaning, with its label. Of cues too near to each other the weightiest is played.
    limits: the labels that have strokes, the least seconds between two meanings, and those until a label comes again.
    """
    known, apart, again = limits
    strongest = _strongest(spoken)
    out: dict[int, str] = {}
    for word in sorted(set(asked) & set(strongest), key=lambda word: (-asked[word].weight, word)):
        i = strongest[word]
        gaps = [(abs(spoken.syllables[i].vowel - spoken.syllables[j].vowel), label) for j, label in out.items()]
        soon = {label for gap, label in gaps if gap < again}
        chances = {label: chance for label, chance in asked[word].labels.items() if label in known - soon}
        near = min((gap for gap, _ in gaps), default=np.inf)
        if chances and rng.random() < habits.meaning * asked[word].weight and near >= max(_MIN_GAP + 0.1, apart):
            weights = np.array(list(chances.values()))
            out[i] = list(chances)[int(rng.choice(len(chances), p=weights / weights.sum()))]
    return out


def _meaningful(spoken: Spoken, habits: Habits, known: set[str], settled: tuple[set[int], set[int]],
                rng: np.random.Generator) -> dict[int, tuple[str, ...]]:
    """The lexemes that other words ask for. settled: the syllables that have a stroke, and the words with a cue."""
    texts, (taken, cued) = _texts(spoken), settled
    out: dict[int, tuple[str, ...]] = {}
    times = [spoken.syllables[i].vowel for i in taken]
    for word, i in sorted(_strongest(spoken).items()):
        lexemes, strength = lexemes_of(texts, word)
        lexemes = tuple(name for name in lexemes if name in known and word not in cued)
        at = spoken.syllables[i].vowel
        near = min((abs(at - time) for time in times), default=np.inf)
        if lexemes and rng.random() < habits.meaning * strength and near >= _MIN_GAP + 0.1:
            out[i] = lexemes
            times.append(at)
    return out


def _choose(wish: _Wish, usable: Sequence[Stroke], habits: Habits, recent: Sequence[str],
            rng: np.random.Generator) -> Stroke | None:
    """Draw a stroke of the wanted lexemes; earlier names, the acting hands, and clips not recently used weigh more. A
    stroke of the wanted meaning comes before all others."""
    order = {name: 0.5 ** place for place, name in enumerate(wish.lexemes)}
    candidates = [s for s in usable if wish.label and s.meaning == wish.label and s.base not in recent[-1:]]
    if not candidates:
        candidates = [s for s in usable if s.lexeme in order and s.base not in recent[-1:]]
    if not candidates:
        candidates = [s for s in usable if s.lexeme.startswith("Beat") and s.base not in recent[-1:]]
    if not candidates:
        return None
    hands = dict(zip(("left", "right", "both"), habits.hands, strict=True)) | {"none": 1.0}
    weights = np.array([order.get(s.lexeme, 1.0) * hands[s.hand]
                        * (_RECENT_WEIGHT if s.base in recent else 1.0) for s in candidates])
    scripted = np.array([s.scripted for s in candidates])
    if scripted.any():
        weights = weights * [_fit(s.size, wish.size) if s.scripted else 1.0 for s in candidates]
        if not scripted.all():
            # Captured strokes and takes from scripts are played equally often.
            weights[scripted] *= weights[~scripted].sum() / weights[scripted].sum()
    return candidates[int(rng.choice(len(candidates), p=weights / weights.sum()))]


def _fit(size: float, wished: float) -> float:
    """How well a take's size fits the log of the one that is wished for."""
    return float(np.exp(-0.5 * ((np.log(size) - wished) / _SPREAD_OF_TAKES) ** 2))


def _place(stroke: Stroke, wish: _Wish, habits: Habits, busy: dict[int, float], casting: Casting,
           rng: np.random.Generator) -> Planned | None:
    """Times and size of a stroke on its syllable; None if its arms are not free in time."""
    amplitude, tempo = casting.style.at(wish.beat).tolist()
    size = _SIZE_OF_DRIVE * wish.drive + _SIZE_OF_STYLE * amplitude
    pace = 0.8 * 0.2 * wish.drive + _PACE_OF_STYLE * tempo
    gain = habits.gain * float(np.clip(casting.manner.gain * np.exp(size + 0.06 * rng.normal()), 0.6, _LARGEST))
    speed = float(np.clip(habits.speed * np.exp(pace + 0.05 * rng.normal()), 0.7, 1.15))
    if stroke.steady:
        speed = min(speed, 1.0)
    free = max([0.0, *(busy[side] for side in stroke.sides)])
    if wish.beat - free < _MIN_PREPARATION:
        return None
    if stroke.scripted:
        return _placed_as_drawn(stroke, wish, free)
    preparation = max(_MIN_PREPARATION, (stroke.beat - stroke.start) / speed)
    hold = casting.manner.hold * float(np.clip((stroke.hold_end - stroke.beat) / speed, 0.12, _LONGEST_HOLD / _STRETCH))
    back = float(np.clip((stroke.end - stroke.hold_end) / speed, 0.5, 1.0))
    start = max(free, wish.beat - preparation)
    return Planned(stroke, start, wish.beat, wish.beat + hold, wish.beat + hold + back, wish.at.vowel, gain)


def _placed_as_drawn(stroke: Stroke, wish: _Wish, free: float) -> Planned | None:
    """A take from a script with its apex at the wish, in its tempo; None if the arms are free too late for that."""
    start = max(free, wish.beat - (stroke.beat - stroke.start))
    if wish.beat - start < _HURRIED * (stroke.beat - stroke.start):
        return None
    return Planned(stroke, start, wish.beat, wish.beat + stroke.hold_end - stroke.beat,
                   wish.beat + stroke.end - stroke.beat, wish.at.vowel, 1.0)


def _held_through(planned: Sequence[Planned], phrases: Sequence[Phrase]) -> tuple[Planned, ...]:
    """Extend holds that reach into a pause of under 1.6 s through it, as far as the arm's next stroke allows."""
    order = sorted(phrases, key=lambda p: p.start)
    pauses = [(a.end, b.start) for a, b in zip(order, order[1:], strict=False) if 0.2 < b.start - a.end < REST_PAUSE]
    out = []
    for k, one in enumerate(planned):
        following = _next_start(planned, k)
        for start, end in pauses:
            if start - 0.45 <= one.hold_end <= end and one.beat < start + 0.1:
                hold_end = min(max(one.hold_end, end - 0.15), following)
                one = replace(one, hold_end=hold_end,
                              end=max(hold_end, min(hold_end + 1.1 * (one.end - one.hold_end), following)))
        out.append(one)
    return tuple(out)


def _next_start(planned: Sequence[Planned], k: int) -> float:
    sides = set(planned[k].stroke.sides)
    return min((p.start for p in planned[k + 1:k + 8] if sides & set(p.stroke.sides)), default=np.inf)


def _join(planned: Sequence[Planned], runs: Sequence[tuple[float, float]]) -> tuple[Planned, ...]:
    """Cut holds at the start of the arm's next stroke, or extend them to it if it starts soon."""
    out = []
    for k, one in enumerate(planned):
        following = _next_start(planned, k)
        hold_end, back = one.hold_end, one.end - one.hold_end
        if following < hold_end + _JOIN and any(a - 1.0 <= one.beat and following <= b for a, b in runs):
            hold_end = min(following, one.beat + _STRETCH * (one.hold_end - one.beat))
        hold_end = min(hold_end, following)
        out.append(replace(one, hold_end=hold_end, end=min(hold_end + back, max(following, hold_end))))
    return tuple(out)

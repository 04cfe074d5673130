"""The effects that the papers give their parts, by the rows of docs/coverage.md, and the claims that decide them.

An effect has the verdict of the first of its claims that has a valid test: the first is the figure from which the paper
draws its conclusion, the next the one that it prints beside it. A row of the page is done when its effect holds, does
not hold, or has no figure in the paper; it is partial while the effect is undecided, or is known only by metrics that
fail their controls.
"""

from __future__ import annotations

from dataclasses import dataclass

from eval.rows import OURS, racer


@dataclass(frozen=True)
class Effect:
    """says: as on the page; rows: ids of the page; claims: names (`PaperClaim.name`), the deciding one first."""

    says: str
    rows: tuple[str, ...]
    claims: tuple[str, ...]


def _pair(where: str, first: str, second: str, *metrics: str) -> tuple[str, ...]:
    """Claims of one table on two rows."""
    return tuple(f"{where}: {metric}, {first}, {second}" for metric in metrics)


_PMB = "pmb_above_chance"
_RACER = ("RACER Table 2", racer.OURS)
EFFECTS = (
    Effect("blocks that end on beats: lower FGD, better timing", ("RG-02", "RG-03"),
           _pair("RG Table 1", OURS, "no-segmentation", "fgd", _PMB)),
    Effect("acoustics at a low level, content at a high level", ("RG-09",),
           ("RG 4.1.3: sound is told better from a low level, words from a high one",)),
    Effect("contrastive training aligns the high level with the words", ("RG-10",),
           ("RG Eq. 1: contrast with the words brings the high level nearer to them",)),
    Effect("a second language helps the encoder", ("RG-11",),
           ("RG 7.1.2: speech of a second language helps the encoder, for either",)),
    Effect("lexemes provide the variety", ("RG-13", "RG-43"),
           _pair("RG Table 5", OURS, "no-lexemes", "diversity")),
    Effect("audio in the generator: more variance, better timing", ("RG-15",),
           _pair("RG Table 2", "no-style", "no-audio-no-style", "variance", _PMB)),
    Effect("the position in the block: lower FGD, better timing", ("RG-16", "RG-46"),
           _pair("RG Table 7", OURS, "no-position", "fgd", _PMB)),
    Effect("style codes: more variance", ("RG-18", "RG-22", "RG-40"),
           _pair("RG Table 2", OURS, "no-style", "variance")),
    Effect("words in the style interpreter: lower FGD", ("RG-41",), _pair("RG Table 3", "style-reads", OURS, "fgd")),
    Effect("the interpreter is more accurate than frequencies", ("RG-21", "RG-45"),
           _pair("RG Table 6", OURS, "statistical", "accuracy")),
    Effect("one language's model is in time with others", ("RG-24",),
           ("RG Fig. 13: a model of one language gestures in time with others, for each above chance",)),
    Effect("the silent hint calms the hands", ("RG-26",), _pair("RG 6.4.1", OURS, "no-hint", "silence_speed")),
    Effect("silent augmentation calms the hands", ("RG-27",),
           _pair("RG 6.4.1", OURS, "no-augmentation", "silence_speed")),
    Effect("hands follow the controls", ("RG-29",),
           ("RG Fig. 10: motion follows what is asked of height, speed and radius",)),
    Effect("people prefer ours", ("RG-38",), ("RG Fig. 12: people prefer ours",)),
    Effect("people prefer RACER", ("RA-21",), ("RACER Fig. 4: people prefer RACER",)),
    Effect("ours beats the other systems", ("RG-39",),
           ("RG Table 1: ours beats SG, Ges, GTC and S2AG in MAJE, MAD, FGD and PMB",)),
    Effect("RACER beats the other systems", ("RA-16",),
           ("RACER Table 1: RACER beats SG, Ges, S2AG and Bailando in MAJE, MAD, FGD and PMB",)),
    Effect("intervals of 0.2 to 0.5 s beat longer ones", ("RG-42",),
           _pair("RG Table 4", OURS, "range-0.5-1.0", "fgd", _PMB)),
    Effect("50 to 100 lexemes are enough", ("RG-44",), _pair("RG Fig. 18", "size-100", "size-400", "fgd")),
    Effect("the high level determines lexemes, the low one style", ("RG-47",),
           ("RG Fig. 14: the high level tells lexemes better than the low one",)),
    Effect("reward models identify the motion that belongs to the audio", ("RA-03", "RA-04", "RA-05"),
           ("RACER 4.2: the reward finds the motion of a sound among others more often than chance, either way",)),
    Effect("learning offline beats imitation", ("RA-07", "RA-17"),
           _pair(*_RACER, f"{racer.PREFIX}supervised", "fgd", _PMB)),
    Effect("the learned reward beats distance", ("RA-18",),
           _pair(*_RACER, f"{racer.PREFIX}distance", "mad", _PMB)),
    Effect("offline beats DQN with a simulator", ("RA-19",),
           _pair(*_RACER, f"{racer.PREFIX}dqn", "return", _PMB)),
    Effect("offline beats actor and critic", ("RA-20",),
           _pair(*_RACER, f"{racer.PREFIX}actor-critic", "return", _PMB)),
    Effect("fast enough to run beside speech", ("RA-22",),
           ("RACER 1: a decision takes less than the shortest block, 200 ms",)),
)

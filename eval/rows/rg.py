"""The rows of Rhythmic Gesticulator's tables: each a question, and the settings that put it (Tables 1 to 7, Fig. 18).

A row is what it changes on top of a preset, as one would type it after `--set`, or how the same weights are played. The
presets are of the paper's system (poses, regression); what the preset `default` has in its place is the row `flow`.
`TABLES` puts rows in the papers' order with the papers' figures; one row may stand in several tables. The papers' other
systems (SG, Ges, GTC, S2AG, Bailando) are lines too: their motion for the test speech is handed in, not made here.

How a part is left out by settings alone:
- beats (w/o BC): `rhythm.beats.rule=even` cuts every D_M seconds, whatever is heard; such blocks all have the length
  that normalisation would give them, so nothing is stretched either.
- lexemes (w/o SC): a lexicon of one lexeme tells the generator nothing. Its encoder stays a plain autoencoder
  (`lexicon.warm_up=1`), so that the perceptual loss is what it was; the lexeme loss, which has nothing to ask, is off.
- style codes (w/o ZC), low-level audio, position: an input of width 0. The interpreter of codes has nothing to learn.
- silence (RG 6.4.1): the hint gives the interpreter silent lexemes to learn from, the mask leaves it no other in
  silence. Without both it must know silence by itself; with the mask alone the hint has nothing left to do.
"""

from __future__ import annotations

import dataclasses

from eval.rows.row import COLUMNS, PaperTable, Row, RowColumn, line
from gesticulator.bundle import config as configs
from gesticulator.bundle.config import Config
from gesticulator.training import presets

OURS = "ours"
PERFORMER, REAL_TAKE = "performer", "real-take"
STILL, FLOOR = "still", "halves"
REFERENCES = {PERFORMER: "the motion that the store was made with", REAL_TAKE: "a person speaking (BEAT), one take"}
CONTROLS = {"shuffled": "the performer's motion for another speech", "reversed": "the performer's motion, backwards",
            "jitter": "the performer's motion, each joint 2 cm off, anew in each frame",
            STILL: "the performer's mean pose, held", FLOOR: "one half of the performer's clips against the other"}
"""References and controls stand in every table; nothing is trained for them."""
SYSTEMS = {"SG": "Style Gestures", "Ges": "Gesticulator", "GTC": "Trimodal Context", "S2AG": "Speech2AffectiveGestures",
           "Bailando": "Bailando"}
"""The papers' baselines, by the names under which `--system NAME=DIR` fills their lines."""

_NO_STYLE = ("generator.style_width=0", "schedules.style.steps=0")
_ONE_LEXEME = ("lexicon.size=1", "lexicon.warm_up=1", "generator.lexeme=0", "schedules.interpreter.steps=0",
               "schedules.interpreter_text.steps=0")
_MOVEMENTS = ("system=movement", "lexicon.quantizer=vq-vae", "lexicon.size=200", "lexicon.code_width=128",
              "lexicon.commitment=0.5", "lexicon.revive_below=0.1", "lexicon.warm_up=0.1",
              "generator.style_width=0", "schedules.style.steps=0",
              "schedules.generator.rate=0.0015", "schedules.generator.weight_decay=0.03",
              "motion.least_deviation=0.0175", "motion.smoothing=0.02", "silence.augmentation=0", "silence.hint=false",
              "silence.mask=false", "selection.temperature=1")
"""What the preset `default` has where `regression` has the paper's, but for what is heard and for the interpreters."""
_SEEING = ("interpreter.pose_features=96", "interpreter.pose_noise=0.1", "interpreter.memory=8",
           "interpreter.reads_by=block", "interpreter.lexeme_features=48", "interpreter.history_dropout=0.2",
           "interpreter.own_past_most=0")
"""The interpreter of `default`, which sees the body."""
SIZES = (10, 25, 50, 100, 200, 400)
"""Lexicon sizes of Fig. 18; the paper shows its own only in the plot."""

ROWS: dict[str, Row] = {
    OURS: Row("the system as the preset has it"),
    "no-segmentation": Row("does it matter that blocks end on beats? (w/o BC)", ("rhythm.beats.rule=even",)),
    "no-lexemes": Row("does the generator need lexemes? (w/o SC)", _ONE_LEXEME),
    "no-style": Row("does it need style codes? (w/o ZC)", _NO_STYLE),
    "audio-only": Row("what is lost without words and speaker?",
                      ("interpreter.text_features=0", "interpreter.text_head=0", "interpreter.use_speaker=false",
                       "style.text_features=0")),
    "no-audio-no-style": Row("can lexemes alone carry the motion?", ("generator.audio_features=0", *_NO_STYLE)),
    "random-style": Row("would any style code do?", style="random"),
    "style-reads": Row("does the style interpreter gain from words?",
                       ("style.text_features=32", "style.text_bottleneck=32")),
    "range-0.2-1.0": Row("may intervals between beats vary more?", ("rhythm.beats.d_max=1.0",)),
    "range-0.5-1.0": Row("may they be long?", ("rhythm.beats.d_max=1.0", "rhythm.beats.d_min=0.5")),
    "words-in-lstm": Row("do words help more inside the recurrence? (Eq. 18; ours: a head on a frozen LSTM)",
                         ("interpreter.text_features=32", "interpreter.text_bottleneck=32", "interpreter.text_head=0",
                          "schedules.interpreter_text.steps=0")),
    "statistical": Row("must the lexemes fit the speech? Drawn from Eq. 24, at temperature 1",
                       interpreter="statistical"),
    "q-network": Row("may reinforcement learning choose them?",
                     ("schedules.reward.steps=300", "schedules.reward.batch=64", "schedules.cql.steps=300"),
                     interpreter="cql"),
    "no-position": Row("must the generator be told how far a block is done?", ("generator.position_width=0",)),
    "no-hint": Row("must the interpreter be taught silence? Neither hint nor mask",
                   ("silence.hint=false", "silence.mask=false")),
    "no-augmentation": Row("must the generator be shown more silence?", ("silence.augmentation=0",)),
    **{f"size-{size}": Row(f"how many lexemes? {size}, on the validation split", (f"lexicon.size={size}",), split="val")
       for size in SIZES},
    "style-editing": Row("does it cost anything that height, speed and radius can be asked for?",
                         ("generator.use_control=true", "interpreter.use_control=true")),
    "pose-aware": Row("does an interpreter that sees the body choose better among the paper's lexemes?", _SEEING),
    "flow": Row("is a lexicon of movements, drawn by sampling, better than poses, drawn by regression?",
                (*_MOVEMENTS, *_SEEING)),
    "k-means": Row("must the lexicon of movements be learned? By k-means instead of a VQ-VAE",
                   (*_MOVEMENTS, *_SEEING, "lexicon.quantizer=k-means")),
}

_T1 = "maje mad fgd pmb"
_SG, _GES, _S2AG = (97.29, 4.26, 36.98, 54.54), (82.41, 3.62, 31.04, 71.0), (54.93, 1.49, 20.36, 79.53)
_T2 = "variance fgd pmb"
_PMB = ("pmb", "pmb_above_chance")


def _columns(*names: str) -> dict[str, RowColumn]:
    return {name: COLUMNS[name] for name in names}


TABLES: dict[str, PaperTable] = {
    "RG Table 1": PaperTable(_columns("maje", "mad", "fgd", *_PMB), (
        line("Real", PERFORMER, "pmb", (95.74,), (93.10,)),
        line("SG", "SG", _T1, _SG), line("Ges", "Ges", _T1, _GES),
        line("GTC", "GTC", _T1, (), (26.95, 3.03, 3.73, 71.72)),
        line("S2AG", "S2AG", _T1, _S2AG, (24.49, 2.93, 3.54, 75.57)),
        line("Ours (w/o BC)", "no-segmentation", _T1, (59.11, 1.89, 16.13, 78.18), (27.10, 3.11, 3.88, 67.88)),
        line("Ours (w/o SC)", "no-lexemes", _T1, (70.10, 2.51, 29.75, 85.74), (30.07, 3.53, 5.22, 83.10)),
        line("Ours (w/o ZC)", "no-style", _T1, (52.85, 1.35, 12.53, 91.36), (21.33, 2.61, 2.47, 88.67)),
        line("Ours (audio only)", "audio-only", _T1, (57.99, 1.83, 15.79, 87.35), (27.28, 3.17, 3.96, 81.33)),
        line("Ours", OURS, _T1, (49.53, 0.97, 10.78, 91.36), (18.13, 2.29, 2.04, 89.52)))),
    "RG Table 2": PaperTable(_columns("variance", "fgd", *_PMB), (
        line("Real", PERFORMER, "variance pmb", (0.41, 95.74), (2.72, 93.10)),
        line("w/o a_low, z", "no-audio-no-style", _T2, (0.09, 17.99, 89.35), (0.89, 3.71, 84.57)),
        line("w/ a_low, w/o z", "no-style", _T2, (0.21, 12.53, 91.36), (1.87, 2.47, 88.67)),
        line("w/ a_low, random z", "random-style", _T2, (0.30, 11.96, 91.28), (2.49, 2.13, 88.89)),
        line("w/ a_low, z", OURS, _T2, (0.37, 10.78, 91.36), (2.45, 2.04, 89.52)))),
    "RG Table 3": PaperTable(_columns("fgd", *_PMB), (
        line("w/o text feature", OURS, "fgd pmb", (10.91, 91.36), (2.09, 89.22)),
        line("w/ text feature", "style-reads", "fgd pmb", (10.78, 91.36), (2.04, 89.52)))),
    "RG Table 4": PaperTable(_columns("fgd", *_PMB), (
        line("0.5 to 1.0 s", "range-0.5-1.0", "fgd pmb", (25.45, 73.87), (3.61, 65.34)),
        line("0.2 to 1.0 s", "range-0.2-1.0", "fgd pmb", (19.16, 90.75), (2.55, 89.10)),
        line("0.2 to 0.5 s", OURS, "fgd pmb", (10.78, 91.36), (2.04, 89.52)))),
    "RG Table 5": PaperTable(_columns("diversity"), (
        line("Real", PERFORMER, "diversity", (3.79,), (4.32,)),
        line("w/o gesture lexeme", "no-lexemes", "diversity", (1.91,), (2.99,)),
        line("w/ gesture lexeme", OURS, "diversity", (3.40,), (4.09,)))),
    "RG Table 6": PaperTable(_columns("accuracy", "teacher_forced", "fgd", *_PMB), (
        line("Statistical", "statistical", "accuracy fgd pmb", (28.01, 21.53, 90.75), (32.11, 3.57, 87.99)),
        line("Learning-based", OURS, "accuracy fgd pmb", (59.15, 10.78, 91.36), (62.53, 2.04, 89.52)),
        line("Learning-based, words in the recurrence", "words-in-lstm"), line("Q-network", "q-network"))),
    "RG Table 7": PaperTable(_columns("fgd", *_PMB), (
        line("w/o positional encoding", "no-position", "fgd pmb", (11.15, 89.98), (2.19, 88.13)),
        line("w/ positional encoding", OURS, "fgd pmb", (10.78, 91.36), (2.04, 89.52)))),
    "RG Fig. 18": PaperTable(_columns("fgd", *_PMB),
                             tuple(line(f"{size} lexemes", f"size-{size}") for size in SIZES), "val"),
    "RG 6.4.1": PaperTable(_columns("silence_speed", "speech_speed", *_PMB), (
        line("w/o silent period hint", "no-hint"), line("w/o silent augmentation", "no-augmentation"),
        line("both", OURS))),
    "RG Fig. 10": PaperTable(_columns("fgd", *_PMB), (
        line("nothing can be asked", OURS), line("height, speed and radius can be asked", "style-editing"))),
    "Movements": PaperTable(_columns("fgd", *_PMB, "diversity", "speech_speed", "silence_speed"), (
        line("poses, regression (the paper's)", OURS), line("the same, chosen by who sees the body", "pose-aware"),
        line("movements, flow", "flow"), line("movements by k-means, flow", "k-means"))),
    "RACER Table 1": PaperTable(_columns("maje", "mad", "fgd", *_PMB), (
        line("Real", PERFORMER, "pmb", (95.74,)), line("Style Gestures", "SG", _T1, _SG, (62.95, 3.46, 30.11, 53.56)),
        line("Gesticulator", "Ges", _T1, _GES), line("S2AG", "S2AG", _T1, _S2AG),
        line("Bailando", "Bailando", _T1, (61.89, 1.74, 17.29, 84.21), (45.45, 1.29, 25.07, 68.53)),
        line("RACER (our Q-network over this lexicon)", "q-network", _T1, (50.33, 1.21, 13.44, 89.58),
              (43.25, 1.19, 9.21, 74.29))), places=("Trinity", "Chinese")),
}


def ablation() -> Config:
    """The preset `paper-quick`, for a row and seed in at most five minutes of one core."""
    return dataclasses.replace(presets.paper_quick(), name="ablation")


def tiny() -> Config:
    """The `tiny` preset at half its steps, without what no row of the papers has: gate, style editing, Q-network."""
    base = presets.tiny()
    halved = {name: dataclasses.replace(own, steps=own.steps // 2)
              for name in ("speech", "contrast", "lexicon", "generator", "interpreter", "style")
              for own in [getattr(base.schedules, name)]}
    return configs.with_settings(
        dataclasses.replace(base, schedules=dataclasses.replace(base.schedules, **halved)),
        ["schedules.gate.steps=0", "schedules.planner.steps=0", "schedules.reward.steps=0", "schedules.cql.steps=0",
         "generator.use_control=false", "interpreter.use_control=false", "style.text_features=0"])


PRESETS = {"ablation": ablation, "tiny": tiny}

"""`python -m eval COMMAND ...`: one door to the judges; `python -m eval COMMAND --help` tells of each."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from data_module.errors import InputError, one_line_errors

COMMANDS: dict[str, tuple[str, str]] = {
    "score": ("eval.score", "real, generated and foreign motion side by side, with the controls"),
    "figures": ("eval.figures", "the figures of the README, on the test split"),
    "corpus": ("eval.corpus", "is a built data set good enough to learn from?"),
    "policies": ("eval.policies", "lexeme interpreters judged as policies"),
    "rewards": ("eval.rewards", "does RACER's reward rank?"),
    "racer": ("eval.racer_ablation", "RACER's ablation over our lexicon, and alpha"),
    "ablate": ("eval.ablate", "every table and figure of both papers, as deltas of settings"),
    "beat_labels": ("eval.beat_labels", "beats that people labelled by hand, against those that we find"),
    "video": ("eval.draw.video", "a motion with its sound as a video file"),
    "report": ("eval.report", "everything that was measured, on one page"),
    "claims": ("eval.claims", "what the papers claim, held against what was run"),
    "study": ("eval.study", "a user study as a page, and its analysis"),
    "parts": ("eval.parts", "what text and the learned speech levels bought"),
    "languages": ("eval.languages", "does one language's model gesture in time with another?"),
}
"""Command -> the module whose `main(argv)` it is, and what it is for; a module is imported when it is called."""


def usage() -> str:
    """The commands, one a line."""
    width = max(map(len, COMMANDS))
    return "usage: python -m eval COMMAND ...\n\n" + "\n".join(
        f"  {name:<{width}}  {purpose}" for name, (_, purpose) in COMMANDS.items()) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Hand the arguments to the command that is named first; exit code 2 for none or an unknown one."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] in (["-h"], ["--help"]):
        print(usage(), end="")
        return 0
    with one_line_errors("python -m eval"):
        if not arguments or arguments[0] not in COMMANDS:
            told = f"{arguments[0]!r} is unknown" if arguments else "is missing"
            raise InputError("the command", told, f"choose among {', '.join(COMMANDS)}")
    code: int = importlib.import_module(COMMANDS[arguments[0]][0]).main(arguments[1:])
    return code


if __name__ == "__main__":
    raise SystemExit(main())

"""`python -m eval VERB ...`: the verbs of `eval.commands`, as `gesticulator VERB ...` has them."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from data_module.errors import InputError, one_line_errors
from eval.commands import VERBS
from gesticulator.cli import usage


def main(argv: Sequence[str] | None = None) -> int:
    """Hand the arguments to the verb that is named first; exit code 2 for none or an unknown one."""
    given = list(sys.argv[1:] if argv is None else argv)
    if given[:1] in (["-h"], ["--help"]):
        print(usage(VERBS, "python -m eval"), end="")
        return 0
    with one_line_errors("python -m eval"):
        if not given or given[0] not in VERBS:
            wrong = f"{given[0]!r} is unknown" if given else "is missing"
            raise InputError("the verb", wrong, f"choose among {', '.join(VERBS)}")
    return VERBS[given[0]].main(f"python -m eval {given[0]}", given[1:])


if __name__ == "__main__":
    raise SystemExit(main())

"""`gesticulator mcp`: a server of the Model Context Protocol on standard input and output."""

from __future__ import annotations

import argparse
from pathlib import Path

from data_module.registry import Requirement
from gesticulator.cli import Command, limited_threads


def _arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("--folder", type=Path, default=Path("gestures"), metavar="DIR",
                   help="where results are written (default: gestures)")
    p.add_argument("--bundle", metavar="NAME", help="trained weights: default, paper, a folder, or ORG/NAME of a hub")
    p.add_argument("--voice", default="en-us", metavar="NAME", help="voice of espeak-ng for texts without a recording "
                   "(default: en-us)")


def _run(args: argparse.Namespace) -> int:
    Requirement("mcp", "mcp", "mcp").check("gesticulator mcp")
    from gesticulator_mcp.server import server_of
    from gesticulator_mcp.studio import Studio

    with limited_threads(1):
        server_of(Studio(args.folder, args.bundle, args.voice)).run("stdio")
    return 0


COMMAND = Command("offer gestures as tools to a language model (MCP)", _arguments, _run,
                  examples=("mcp", "mcp --folder results --bundle paper"))

"""How large the repository is: counts of its tracked files, which `test_budget` holds to the ceilings of budget.json.

`python tests/budget.py` prints the counts. A ceiling is lowered to the printed count, rounded up to the next hundred,
whenever code is taken away; it is raised only together with a reason in the commit.
"""

import ast
import io
import json
import re
import subprocess
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ("data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval")
DIALECT = re.compile(r"own|told|made|found|one|asked|seen|kept|heard|hear|deaf|unheard|ours|rolled|played")
"""Names of variables and arguments that say nothing of what they hold."""
LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING,
          tokenize.ENDMARKER}


def tracked() -> list[Path]:
    """Files under version control, relative to the root; none outside of a checkout."""
    listing = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True, check=False)
    return [Path(name) for name in listing.stdout.split("\0") if name and (ROOT / name).is_file()]


def source_counts(text: str) -> Counter[str]:
    """Tokens without comments, docstrings and layout; comments, settings and dialect names of a file."""
    tree, counts = ast.parse(text), Counter[str]()
    documentation = {(node.lineno, node.col_offset) for node in ast.walk(tree)
                     if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        counts["tokens"] += token.type not in LAYOUT and token.start not in documentation
        counts["comments"] += token.type == tokenize.COMMENT
    for node in ast.walk(tree):
        if isinstance(node, ast.arg) or (isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)):
            name = node.arg if isinstance(node, ast.arg) else node.id
            counts["dialect names"] += DIALECT.fullmatch(name) is not None
        elif isinstance(node, ast.ClassDef) and node.name.endswith(("Config", "Settings")):
            counts["settings"] += sum(isinstance(child, ast.AnnAssign) for child in node.body)
    return counts


def measure(files: list[Path]) -> Counter[str]:
    """Lines of each top folder and of the largest room of `gesticulator`, counts of the source, files of docs."""
    lines, source = Counter[str](), Counter[str]()
    for path in (path for path in files if path.suffix == ".py"):
        text = (ROOT / path).read_text(encoding="utf-8")
        length = len(text.splitlines())
        lines[path.parts[0]] += length
        if path.parts[0] == "gesticulator":
            lines[f"gesticulator/{path.parts[1] if len(path.parts) > 2 else ''}"] += length
        if path.parts[0] in SOURCE:
            source += source_counts(text)
    counts = Counter({f"lines of {name}": count for name, count in lines.items() if not {"/", "."} & set(name)})
    counts["lines of the largest room"] = max(count for name, count in lines.items() if "/" in name)
    counts["comments per mille"] = round(1000 * source.pop("comments") / sum(lines[name] for name in SOURCE))
    for folder in ("docs", "docs/results"):
        counts[f"files of {folder}"] = sum(path.is_relative_to(folder) for path in files)
    return counts + source


if __name__ == "__main__":
    print(json.dumps(measure(tracked()), indent=1, sort_keys=True))

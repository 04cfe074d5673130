"""Draw the floors and the rooms of the source from its imports: `python docs/pictures/make_architecture.py`.

An arrow leads from a room to a room that it imports; arrows that follow from others are left out. A room stands above
everything that it imports; an import that runs back up is orange.
"""

from __future__ import annotations

import ast
from html import escape
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parent.parent.parent
OUT = ROOT / "docs" / "pictures" / "architecture.svg"
FLOORS = (("eval",), ("gesticulator",), ("lexicon", "interpreters", "generator"), ("data_module",))
"""The packages from the top floor down."""
NOT_ROOMS = {"__main__", "version"}
"""Modules that are part of the entrance."""
WIDTH, MARGIN, GAP = 1180, 24, 16
BOX, STEP = 58, 92
"""Height of a room and distance of two rows, pixels."""
NARROW, WIDE = 150, 264


def imports() -> dict[str, set[str]]:
    """Each module of the six packages with the modules that it imports, whether at the top or in a function."""
    graph = grimp.build_graph(*(name for floor in FLOORS for name in floor), exclude_type_checking_imports=True,
                              cache_dir=None)
    return {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}


def rooms(files: dict[str, set[str]]) -> dict[str, dict[str, int]]:
    """Each room of gesticulator/ (a folder or a module) with the rooms that it imports, and how many times."""
    def room(module: str) -> str | None:
        parts = module.split(".")
        return parts[1] if parts[0] == "gesticulator" and len(parts) > 1 and parts[1] not in NOT_ROOMS else None

    edges: dict[str, dict[str, int]] = {}
    for module, imported in files.items():
        own = room(module)
        if own is not None:
            counts = edges.setdefault(own, {})
            for other in map(room, imported):
                if other not in (None, own):
                    counts[other] = counts.get(other, 0) + 1
    return edges


def reached(name: str, edges: dict[str, set[str]]) -> set[str]:
    """All rooms that a room imports, straight or by way of others."""
    found: set[str] = set()
    left = [name]
    while left:
        new = edges.get(left.pop(), set()) - found
        found |= new
        left += new
    return found


def without_circles(counts: dict[str, dict[str, int]]) -> tuple[dict[str, set[str]], list[tuple[str, str]]]:
    """The arrows without those that run back up: of each circle the one with the fewest imports is taken out."""
    edges = {name: set(others) for name, others in counts.items()}
    back = []
    while True:
        closing = [(counts[name][other], name, other) for name in edges for other in edges[name]
                   if name in reached(other, edges)]
        if not closing:
            return edges, back
        _, name, other = min(closing)
        edges[name].remove(other)
        back.append((name, other))


def levels(edges: dict[str, set[str]]) -> dict[str, int]:
    """The row of each room, 0 at the bottom: one above the highest that it imports."""
    known: dict[str, int] = {}

    def level(name: str) -> int:
        if name not in known:
            known[name] = 1 + max(map(level, edges.get(name, ())), default=-1)
        return known[name]

    for name in edges:
        level(name)
    return known


def direct(edges: dict[str, set[str]]) -> list[tuple[str, str]]:
    """The arrows that do not follow from others (transitive reduction)."""
    return [(name, other) for name in sorted(edges) for other in sorted(edges[name])
            if not any(other in reached(between, edges) for between in edges[name] - {other})]


def sentence(name: str) -> str:
    """The first sentence of the docstring of a package or a module, without markup."""
    folder = ROOT / name.replace(".", "/")
    file = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    text = " ".join((ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").split())
    return text.split(". ")[0].rstrip(".").replace("`", "")


def lines(text: str, letters: int, most: int = 2) -> list[str]:
    """Text in lines of so many letters, cut off after `most` of them."""
    rows = [""]
    for word in text.split():
        if len(rows[-1]) + len(word) + 1 > letters and rows[-1]:
            rows.append(word)
        else:
            rows[-1] = f"{rows[-1]} {word}".strip()
    if len(rows) > most:
        rows = [*rows[:most - 1], rows[most - 1][:letters - 2].rstrip(" ,;:") + " …"]
    return rows


def box(name: str, about: str, place: tuple[float, float, float], colour: str) -> str:
    """A room: its name and its sentence in a box (left, top, width)."""
    left, top, width = place
    text = "".join(f'<text x="{left + 9:.0f}" y="{top + 34 + 13 * k:.0f}" class="about">{escape(line)}</text>'
                   for k, line in enumerate(lines(about, int((width - 14) / 5.6))))
    return (f'<rect x="{left:.0f}" y="{top:.0f}" width="{width:.0f}" height="{BOX}" rx="4" fill="{colour}"/>'
            f'<text x="{left + 9:.0f}" y="{top + 18:.0f}" class="name">{escape(name)}</text>{text}')


def ordered(rows: dict[int, list[str]], edges: dict[str, set[str]]) -> None:
    """Order each row so that rooms stand near the rooms that import them."""
    importers: dict[str, list[str]] = {}
    for name, others in edges.items():
        for other in others:
            importers.setdefault(other, []).append(name)
    for _ in range(4):
        place = {name: (k + 0.5) / len(row) for row in rows.values() for k, name in enumerate(row)}
        for row in rows.values():
            near = {name: importers.get(name, []) + sorted(edges[name]) for name in row}
            row.sort(key=lambda name: sum(place[n] for n in near[name]) / len(near[name]) if near[name] else 0.5)


def house(counts: dict[str, dict[str, int]], top: float) -> tuple[list[str], float]:
    """The rooms of gesticulator/ with their arrows, from `top` on, and where they end."""
    edges, back = without_circles(counts)
    level = levels(edges)
    rows: dict[int, list[str]] = {}
    for name in sorted(level):
        rows.setdefault(level[name], []).append(name)
    ordered(rows, edges)
    places: dict[str, tuple[float, float, float]] = {}
    highest = max(rows)
    for number, row in rows.items():
        width = min(WIDE, (WIDTH - 4 * MARGIN - GAP * (len(row) - 1)) / len(row))
        left = (WIDTH - width * len(row) - GAP * (len(row) - 1)) / 2
        for k, name in enumerate(row):
            places[name] = (left + k * (width + GAP), top + (highest - number) * STEP, width)
    arrows = []
    for name, other in direct(edges):
        (x0, y0, w0), (x1, y1, w1) = places[name], places[other]
        start, end, bend = x0 + w0 / 2, x1 + w1 / 2, (y1 - y0 - BOX) / 2
        arrows.append(f'<path d="M{start:.0f},{y0 + BOX:.0f} C{start:.0f},{y0 + BOX + bend:.0f} '
                      f'{end:.0f},{y1 - bend:.0f} {end:.0f},{y1 - 3:.0f}" class="arrow" marker-end="url(#tip)"/>')
    for name, other in back:
        (x0, y0, w0), (x1, y1, w1) = places[name], places[other]
        arrows.append(f'<path d="M{x0 + w0 - 12:.0f},{y0:.0f} L{x1 + w1 - 12:.0f},{y1 + BOX + 3:.0f}" '
                      'class="arrow back"/>')

    def shown(name: str) -> str:
        return f"{name}/" if (ROOT / "gesticulator" / name).is_dir() else f"{name}.py"

    boxes = [box(shown(name), sentence(f"gesticulator.{name}"), place, "#d3e3ee") for name, place in places.items()]
    return arrows + boxes, top + highest * STEP + BOX


def picture() -> str:
    """The whole picture as SVG."""
    parts: list[str] = []
    y = float(MARGIN)
    for number, floor in enumerate(FLOORS):
        packages = escape(" | ".join(floor))
        title = f'<text x="{2 * MARGIN}" y="{{y:.0f}}" class="floor">floor {3 - number}: {packages}</text>'
        band = f'<rect x="{MARGIN}" y="{y:.0f}" width="{WIDTH - 2 * MARGIN}" height="{{height:.0f}}" class="band"/>'
        if floor == ("gesticulator",):
            inner, end = house(rooms(imports()), y + 40)
        else:
            width = (WIDTH - 4 * MARGIN - GAP * (len(floor) - 1)) / len(floor)
            inner = [box(f"{name}/", sentence(name), (2 * MARGIN + k * (width + GAP), y + 34, width), "#e6dfd0")
                     for k, name in enumerate(floor)]
            end = y + 34 + BOX
        parts += [band.format(height=end - y + 16), title.format(y=y + 23), *inner]
        y = end + 16 + GAP
    style = ("text{font-family:DejaVu Sans,Verdana,sans-serif;fill:#22303a}.name{font-size:13px;font-weight:bold}"
             ".about{font-size:10.5px}.floor{font-size:13px;fill:#5a6a74}.band{fill:#f6f8f9;stroke:#c9d3d9}"
             ".arrow{fill:none;stroke:#7d93a1;stroke-width:1.1}.back{stroke:#d9812b}")
    tip = ('<marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
           '<path d="M0,0 L8,4 L0,8 z" fill="#7d93a1"/></marker>')
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {y:.0f}" width="{WIDTH}" height="{y:.0f}">'
            f'<rect width="100%" height="100%" fill="#ffffff"/><style>{style}</style><defs>{tip}</defs>'
            + "\n".join(parts) + "</svg>\n")


if __name__ == "__main__":
    OUT.write_text(picture(), encoding="utf-8")

#!/usr/bin/env python3
"""Runs the campaigns of scenarios/robustness, and makes the tables of docs/robustness.md and their pictures from what they leave.

    python3 docs/robustness.py [--calibrig target/release/calibrig] [--out runs/robustness] [--keep] [NAME ...]

With --keep, campaigns that are in --out already are not run again. Python 3.9, without packages.
"""

import argparse, json, math, re, subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE, PICTURES = ROOT / "docs/robustness.md", ROOT / "docs/pictures/robustness"
MODES = {"only_calibration": "only calibration", "with_gravity": "with gravity", "elasto_geometric": "geometry and stiffness", "extended": "extended"}
# Levels that a reader does not understand as they stand in the scenario.
WORDS = {
    ("poses between rounds of nests", "1000"): "once, before",
    ("calibrated with", "none"): "no load",
    ("calibrated with", "none, tool"): "load in half",
}
COLOURS = ["#0b63a5", "#c2571a", "#2d7d46", "#8a3fa0"]


def run(arguments, name):
    folder = arguments.out / name
    if not (arguments.keep and (folder / "summary.json").exists()):
        subprocess.run(["rm", "-rf", folder], check=True)
        command = [arguments.calibrig, "montecarlo", ROOT / f"scenarios/robustness/{name}.toml", "--out", folder]
        # Exit code 3: a trial failed, which the table counts.
        if subprocess.run(command, stdout=subprocess.DEVNULL).returncode not in (0, 3):
            raise SystemExit(f"{name}: the campaign could not be run")
    return json.loads((folder / "summary.json").read_text())


def studied(summary):
    """Of every mode and combination: levels, error at true places (mm), coverage, each with its interval; how many trials are called doubtful."""
    found, names = {}, [factor["name"] for factor in summary["factors"]]
    for place, mode in enumerate(mode["mode"] for mode in summary["groups"][0]["modes"]):
        for group in summary["groups"]:
            figures = group["modes"][place]
            rms, inside = figures["sets"]["truth"]["rms_3d_m"], figures["prediction_coverage"]
            mean, half = 1e3 * rms["mean"], 1e3 * rms["half_width_95"]
            levels = [re.sub(r'[\[\]"]', "", level) for level in group["levels"]]
            found.setdefault(mode, []).append({
                "levels": [WORDS.get(level, level[1]) for level in zip(names, levels)], "trials": group["trials"] - group["failed"], "failed": group["failed"],
                "rms": (mean, mean - half, mean + half), "coverage": (inside["fraction"], *inside["interval_99_9"]), "doubtful": figures["doubtful"],
            })
    return found


def table(summary, found):
    names = [factor["name"] for factor in summary["factors"]]
    lines = ["| " + " | ".join(names + [MODES[mode] for mode in found]) + " |", "|" + " --- |" * (len(names) + len(found))]
    for cells in zip(*found.values()):
        shown = []
        for cell in cells:
            (rms, low, _), (share, *_) = cell["rms"], cell["coverage"]
            half = rms - low
            digits = max(0, 1 - math.floor(math.log10(half)))
            failed = f", {cell['failed']} failed" if cell["failed"] else ""
            shown.append(f"{rms:.{digits}f} ± {half:.{digits}f} mm; {100 * share:.0f} %; {cell['doubtful']}/{cell['trials']}{failed}")
        lines.append("| " + " | ".join(cells[0]["levels"] + shown) + " |")
    return "\n".join(lines)


class Panel:
    """One plot of the picture: levels of the first factor across, even steps; a curve a mode and level of the second factor."""

    def __init__(self, left, title, levels, values, share):
        self.left, self.levels, self.share = left, levels, share
        low, high = min(values), max(values)
        self.log = not share and low > 0 and high / low > 8
        if share:
            self.ends = (0.0, 1.0)
        elif self.log:
            # Out to the next lines of the grid, so that the first and the last have a figure.
            self.ends = (max(t for t in GRID if t <= math.log10(low)), min(t for t in GRID if t >= math.log10(high)))
        else:
            step = 10.0 ** math.floor(math.log10(high))
            self.step = next(s for s in (step / 5, step / 2, step, 2 * step) if high / s <= 5)
            self.ends = (0.0, self.step * math.ceil(high / self.step))
        self.svg = [f'<text x="{left}" y="{TOP - 12}" font-weight="600">{title}</text>']
        for tick in self.ticks():
            y = self.y(tick)
            self.svg.append(f'<path d="M{left} {y:.1f}h{WIDTH}" stroke="#d8dde2"/>')
            self.svg.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{f"{100 * tick:.0f} %" if share else f"{tick:g}"}</text>')
        size = ' font-size="11"' if max(map(len, levels)) > 5 else ""
        for place, level in enumerate(levels):
            self.svg.append(f'<text x="{self.x(place):.1f}" y="{TOP + HEIGHT + 18}" text-anchor="middle"{size}>{level}</text>')

    def ticks(self):
        if self.share:
            return [0.0, 0.25, 0.5, 0.75, 1.0]
        if self.log:
            return [10.0**t for t in GRID if self.ends[0] <= t <= self.ends[1]]
        return [self.step * k for k in range(round(self.ends[1] / self.step) + 1)]

    def x(self, place, shift=0.0):
        return self.left + WIDTH * (place + 0.5 + shift) / len(self.levels)

    def y(self, value):
        value = math.log10(max(value, 1e-12)) if self.log else value
        share = (value - self.ends[0]) / (self.ends[1] - self.ends[0])
        return TOP + HEIGHT * (1.0 - min(max(share, 0.0), 1.0))

    def curve(self, points, colour, dashes, shift):
        """Points are (value, low, high) each, or None."""
        there = [(self.x(place, shift), point) for place, point in enumerate(points) if point]
        path = "L".join(f"{x:.1f} {self.y(value):.1f}" for x, (value, _, _) in there)
        self.svg.append(f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="1.8"{dashes}/>')
        for x, (value, low, high) in there:
            self.svg.append(f'<path d="M{x:.1f} {self.y(low):.1f}V{self.y(high):.1f}" stroke="{colour}" stroke-width="1.8"/>')
            self.svg.append(f'<circle cx="{x:.1f}" cy="{self.y(value):.1f}" r="3" fill="{colour}"/>')


LEFT, WIDTH, HEIGHT, TOP, GAP = 52, 250, 190, 62, 62
GRID = [math.log10(m) + e for e in range(-9, 9) for m in (1, 2, 5)]


def picture(summary, found):
    names = [factor["name"] for factor in summary["factors"]]
    unique = lambda place: list(dict.fromkeys(cell["levels"][place] for cell in next(iter(found.values()))))
    across, second = unique(0), unique(1) if len(names) > 1 else [None]
    ends = [end for cells in found.values() for cell in cells for end in cell["rms"]]
    panels = [
        (Panel(LEFT, "RMS error at held-out poses, mm", across, ends, False), lambda cell: cell["rms"]),
        (Panel(LEFT + WIDTH + GAP, "True places in their 95 % intervals", across, [0.0, 1.0], True), lambda cell: cell["coverage"]),
        (Panel(LEFT + 2 * (WIDTH + GAP), "Trials that are called doubtful", across, [0.0, 1.0], True), lambda cell: (cell["doubtful"] / cell["trials"],) * 3),
    ]
    width, height = LEFT + 3 * WIDTH + 2 * GAP + 10, TOP + HEIGHT + 44
    svg, legend, curves = [], float(LEFT), [(mode, level) for mode in found for level in second]
    for order, (mode, level) in enumerate(curves):
        colour, dashes = COLOURS[list(found).index(mode) % 4], ' stroke-dasharray="5 4"' if second.index(level) else ""
        cells = [next(c for c in found[mode] if c["levels"][0] == a and level in (None, *c["levels"][1:])) for a in across]
        for panel, figure in panels:
            panel.curve([figure(cell) for cell in cells], colour, dashes, 0.06 * (order - (len(curves) - 1) / 2))
    keys = [(COLOURS[place % 4], "", MODES[mode]) for place, mode in enumerate(found)]
    keys += [("#1d2329", ' stroke-dasharray="5 4"' if place else "", f"{names[1]}: {level}") for place, level in enumerate(second) if level]
    for colour, dashes, words in keys:
        svg.append(f'<path d="M{legend:.0f} 18h26" stroke="{colour}" stroke-width="2"{dashes}/><text x="{legend + 32:.0f}" y="22">{words}</text>')
        legend += 52 + 6.4 * len(words)
    svg += [line for panel, _ in panels for line in panel.svg]
    svg.append(f'<path d="M{panels[1][0].left} {panels[1][0].y(0.95):.1f}h{WIDTH}" stroke="#55606b" stroke-dasharray="2 3"/>')
    svg.append(f'<text x="{width / 2}" y="{height - 6}" text-anchor="middle">{names[0]}</text>')
    width = max(width, legend - 18)
    body = "\n".join(svg)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height}" font-family="system-ui, sans-serif" font-size="12" fill="#1d2329">\n'
        f'<rect width="{width:.0f}" height="{height}" fill="#ffffff"/>\n{body}\n</svg>\n'
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="studies; all without")
    parser.add_argument("--calibrig", type=Path, default=ROOT / "target/release/calibrig")
    parser.add_argument("--out", type=Path, default=ROOT / "runs/robustness")
    parser.add_argument("--keep", action="store_true")
    arguments = parser.parse_args()
    text = PAGE.read_text()
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or sorted(path.stem for path in (ROOT / "scenarios/robustness").glob("*.toml")):
        summary = run(arguments, name)
        found = studied(summary)
        (PICTURES / f"{name}.svg").write_text(picture(summary, found))
        mark, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        made = f"{mark}\n{table(summary, found)}\n{end}"
        if mark not in text or end not in text:
            raise SystemExit(f"{PAGE.name}: no place for {name}: expected {mark} and {end}")
        text = re.sub(f"{re.escape(mark)}.*?{re.escape(end)}", lambda _: made, text, flags=re.S)
        PAGE.write_text(text)
        print(f"{name}: {summary['trials']} trials, {summary['failed']} failed, {summary['doubtful']} doubtful")


main()

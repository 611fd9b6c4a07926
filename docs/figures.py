#!/usr/bin/env python3
"""Measures the figures of docs/figures.md and the table of docs/experiment.md again, and puts them into these pages.

    python3 docs/figures.py [--slow] [--calibrig target/release/calibrig] [NAME ...]

A row of docs/figures.md ends with its name, as <!-- name -->. Its command is the first one in it that stands in backquotes, and is run as it stands, with
`calibrig` on the path. A row that takes minutes is measured only with --slow or by its name; else it keeps its value and its date. Rows that are not in
ROWS are written by hand. With CALIBRIG_DATA, rows on real measurements are measured as well. Python 3.9, without packages.
"""

import argparse, datetime, json, os, re, subprocess, time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE, EXPERIMENT, OUT = ROOT / "docs/figures.md", ROOT / "docs/experiment.md", ROOT / "runs/figures"
NUMBER = r"([-+\d.e]+)"
# The last two figures of each row of the verification set: RMS and largest error.
TITLES = ("without calibration", "only calibration", "geometry and stiffness")
RMS = "Verification set.*?" + ".*?".join(rf"\n{title}[^\n]* {NUMBER} +{NUMBER}(?=\n)" for title in TITLES)
RATIOS = ".*?".join(rf"{{p}} poses, axis {axis}: [^\n]*: {NUMBER}\n" for axis in range(3))

# Name: pattern of the output, whose groups go into the text, in their order; whether it is slow.
ROWS = {
    "exact": (f"largest error of the 24: {NUMBER} m or rad", "within {} m or rad", False),
    "noise": (
        f"freedom {NUMBER}, band 1 \\+- {NUMBER}\n.*?of the 24 parameters: {NUMBER} to {NUMBER}",
        "chi-square per degree of freedom {}, 99.9 % band 1 ± {}; {} to {} of the intervals hold", True,
    ),
    "floor": (
        RATIOS.replace("{p}", "60") + ".*?" + RATIOS.replace("{p}", "180"),
        "{}, {}, {} in x, y, z from 60 poses; {}, {}, {} from 180", True,
    ),
    "matched": (
        f"NEES per parameter {NUMBER}, inside its 99.9 % band {NUMBER} .. {NUMBER}; squared error over the bound at the truth {NUMBER} ± {NUMBER} "
        f"a parameter; {NUMBER} %",
        "NEES per parameter {}, 99.9 % band {} to {}; squared error over the bound {} ± {}; {} % of true coordinates in their 95 % intervals", True,
    ),
    "acceptance": (
        f"(\\d+) of 300 pass.*?lengths {NUMBER}, two faces {NUMBER}, range intervals {NUMBER} of the MPE",
        "{} pass; medians of the largest errors over their MPE: lengths {}, two faces {}, range {}", False,
    ),
    "two_faces": (r"intervals that hold, of 100: (.*?); chi-square (\d+) of (\d+)", "of 100 by error: {}; chi-square {} of {}", False),
    "payloads": (
        r"drive3 +(\S+) +(\S+).*?drive4 +(\S+) +(\S+).*?drive6 +(\S+) +(\S+).*?drive7 +(\S+) +(\S+)",
        "shoulder {} % without a payload, {} % with; elbow {}, {}; roll {}, {}; wrist {}, {} %", False,
    ),
    "replay": (r"Replay: (\d+) recorded estimates, (all identical bit for bit)", "{} estimates, {}", False),
    "ur5": (RMS, "RMS 3D {0} mm nominal, {2} geometric, {4} with stiffness; largest {1}, {3}, {5} mm", False),
    "wam": (RMS, "RMS 3D {0} mm nominal, {2} geometric, {4} with stiffness; largest {1}, {3}, {5} mm", False),
    "splits": (
        r"UR5, 20 splits.*?geometric (\S+) mm, with stiffness (\S+) mm, (\S+) mm \[(\S+), (\S+)\] less",
        "{} mm geometric, {} mm with stiffness: {} mm less, 95 % interval {} to {}", False,
    ),
}


def when():
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True).stdout.strip()
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    return f"{datetime.date.today()}, {commit}, {model[1] if model else 'unknown'}, {os.cpu_count()} cores"


def run(command, binary):
    path = f"{binary.resolve().parent}:{os.environ['PATH']}"
    ended = subprocess.run(["sh", "-c", command], cwd=ROOT, env={**os.environ, "PATH": path}, capture_output=True, text=True)
    # Exit code 3 is a result: campaigns with a failed trial end so, and it is in the output.
    if ended.returncode not in (0, 3):
        raise SystemExit(f"{command} ended with {ended.returncode}\n{ended.stderr[-2000:]}")
    return ended.stdout + ended.stderr


def rows_of_experiment(summary):
    """The table of docs/experiment.md from the summary of a campaign."""
    published = {
        "without_calibration": ((5.7, 14.4, 6.3), (5.9, 13.9, 6.7)),
        "only_calibration": ((0.9, 0.6, 0.8), (1.0, 0.6, 1.1)),
        "with_gravity": ((0.7, 0.4, 0.7), (0.8, 0.5, 1.1)),
    }
    titles = {"with_gravity": "calibration considering gravity", "elasto_geometric": "geometry and stiffness"}
    lines = ["| row | identification x | y | z | verification x | y | z |", "| --- | --- | --- | --- | --- | --- | --- |"]
    for mode in summary["modes"]:
        cells = []
        for place, kind in enumerate(("identification", "verification")):
            for axis, mean in enumerate(mode["sets"][kind]["mean_m"]):
                beside = published.get(mode["mode"])
                cells.append(f"{1e3 * mean['mean']:.2f}" + (f" ({beside[place][axis]})" if beside else ""))
        lines.append(f"| {titles.get(mode['mode'], mode['mode'].replace('_', ' '))} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="rows; without, all that are fast")
    parser.add_argument("--slow", action="store_true", help="the slow rows as well")
    parser.add_argument("--calibrig", type=Path, default=ROOT / "target/release/calibrig")
    arguments = parser.parse_args()
    known = [*ROWS, "rows"]
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        raise SystemExit(f"no rows {', '.join(unknown)}: expected {', '.join(known)}")
    # What an earlier run left would be in the way of campaigns.
    subprocess.run(["rm", "-rf", OUT], check=True)
    for line in PAGE.read_text().split("\n"):
        name = re.search(r"<!-- (\w+) -->$", line)
        pattern, text, slow = ROWS.get(name[1], (None, "", True)) if name else (None, "", True)
        if pattern is None or (name[1] not in arguments.names if arguments.names else slow and not arguments.slow):
            continue
        claim, _, command, *_ = line.removeprefix("| ").split(" | ")
        words = re.search(r"`([^`]+)`", command)[1]
        if "$CALIBRIG_DATA" in words and "CALIBRIG_DATA" not in os.environ:
            print(f"{name[1]}: skipped, no CALIBRIG_DATA")
            continue
        began = time.monotonic()
        found = re.search(pattern, run(words, arguments.calibrig), re.S)
        if not found:
            raise SystemExit(f"{name[1]}: the output of {words} has not what is expected")
        measured = text.format(*found.groups())
        made = f"| {claim} | {measured} | {command} | {when()} | {name[0]}"
        PAGE.write_text(PAGE.read_text().replace(line, made))
        print(f"{name[1]}: {measured} ({time.monotonic() - began:.0f} s)")
    if "rows" in arguments.names or not arguments.names:
        run(f"calibrig montecarlo scenarios/paper.toml --trials 20 --out {OUT}/rows", arguments.calibrig)
        table = rows_of_experiment(json.loads((OUT / "rows/summary.json").read_text()))
        made = f"<!-- rows -->\n{table}\n\nMeasured on {when()}.\n<!-- end of rows -->"
        EXPERIMENT.write_text(re.sub(r"<!-- rows -->.*?<!-- end of rows -->", lambda _: made, EXPERIMENT.read_text(), flags=re.S))
        print("rows: docs/experiment.md")


main()

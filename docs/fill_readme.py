"""Put into README.md what its commands really print: behind every ``<!-- run: ... -->`` the output of that command.

``python docs/fill_readme.py`` rewrites the file, ``--bench`` its table of measurements too, from what ``make bench``
and ``make hidden`` wrote last; ``--check`` only says whether it is as it should be. A test does that, so the page
cannot say what the program does not.
"""

import json
import math
import re
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / "_ext"))

README = Path(__file__).resolve().parents[1] / "README.md"
BLOCK = re.compile(r"<!-- run: (?P<command>[^\n]*) -->\n(?:\n```text\n.*?\n```\n)?", re.DOTALL)
BENCH = re.compile(r"<!-- bench -->\n(?:\n(?:\|[^\n]*\n)*\n?)?")
ROWS = {
    "plain over C": "its time over that of the same algorithm in C, gcc -O3",
    "python-control over plain": "time of python-control, one `nlsys` with the exact step, over its time",
    "C and plain, largest difference of position": "largest difference of position from the C program",
    "python-control and plain, difference of position": "largest difference of position from python-control",
    "one hour at 1 kHz, core model": "a simulated hour at 1 kHz",
    "10,000 plants at +-2 %, metrics, two workers": "10,000 plants with parameters within 2 %, on two cores",
}
MOST_LINES = 34


def filled(text: str) -> str:
    """``text`` with fresh output behind every command."""
    from run_command import execute

    with tempfile.TemporaryDirectory() as folder:
        execute("emps-design init . --force", Path(folder))

        def block(match: re.Match) -> str:
            done = execute(match["command"], Path(folder))
            if done.returncode:
                raise SystemExit(f"{match['command']}: exit status {done.returncode}\n{done.stderr}")
            lines = [line.rstrip() for line in done.stdout.strip("\n").splitlines()]
            lines = [*lines[:MOST_LINES], "..."] if len(lines) > MOST_LINES else lines
            shown = "\n".join([f"$ {match['command']}", *lines])
            return f"<!-- run: {match['command']} -->\n\n```text\n{shown}\n```\n"

        return BLOCK.sub(block, text)


def measured() -> str:
    """The rows of the last `make bench` that compare with what people use now."""
    rows = {row["work"]: row for row in json.loads((README.parent / "benchmarks" / "latest.json").read_text())["rows"]}
    lines = [f"| {text} | {shown(rows[name])} |" for name, text in ROWS.items() if name in rows]
    for kind, rows in (("", named), ("_no_laps", named_without_laps)):
        hidden = README.parent / "benchmarks" / f"hidden{kind}.json"
        if hidden.exists():
            lines += [f"| {text} | {value} |" for text, value in rows(json.loads(hidden.read_text())["summary"])]
    return "\n".join(["| this program | measured |", "|---|---|", *lines])


def named(count: dict) -> list[tuple[str, str]]:
    """Rows of the last `make hidden`."""
    return [
        ("records with hidden effects that `diagnose` names right", f"{count['right']} of {count['effects']}"),
        ("wrong names among them", f"{count['wrong']}"),
        ("unknown physics that it leaves unnamed", f"{count['unknown_right']} of {count['unknown']}"),
        ("false alarms on healthy records", f"{count['false_alarms']} of {count['healthy']}"),
        ("share of the force gap closed, median", f"{count['median_gap_closed']:.3f}"),
    ]


def named_without_laps(count: dict) -> list[tuple[str, str]]:
    """Rows of the same where no reference repeats; effects below the noise are not asked for."""
    asked = count["effects"] - count["too_small"]
    return [("the same where no lap repeats", f"{count['right']} of {asked} right, {count['wrong']} wrong")]


def shown(row: dict) -> str:
    """A value with its unit, three digits, whole numbers written out."""
    value = row["value"]
    return f"{value:,.0f} {row['unit']}" if value >= 1000 else f"{value:.3g} {row['unit']}"


def same(one: str, other: str) -> bool:
    """Whether two pages say the same: words alike, numbers within 5 % (processors differ, and so do last digits)."""
    number = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
    words = [" ".join(re.sub("[\u2500-\u257f]+", " ", number.sub("#", text)).split()) for text in (one, other)]
    values = [[float(found) for found in number.findall(text)] for text in (one, other)]
    return words[0] == words[1] and all(math.isclose(a, b, rel_tol=0.05) for a, b in zip(*values, strict=True))


if __name__ == "__main__":
    before = README.read_text(encoding="utf-8")
    after = filled(before)
    if "--bench" in sys.argv:
        after = BENCH.sub(lambda _: f"<!-- bench -->\n\n{measured()}\n\n", after)
    if "--check" in sys.argv:
        sys.exit(not same(before, after))
    README.write_text(after, encoding="utf-8")

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
import textwrap
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
HIDDEN = {
    "": "one or two at once",
    "_no_laps": "the same where no lap repeats",
    "_small": "5 to 100 % of their size",
    "_several": "three and four at once",
    "_beside": "one beside physics that no library has",
    "_unknown": "",
    "_healthy": "",
}  # sets of `make hidden`, those with effects to name in words
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
            lines = [row for line in done.stdout.strip("\n").splitlines() for row in on_a_terminal(line)]
            lines = [*lines[:MOST_LINES], "..."] if len(lines) > MOST_LINES else lines
            shown = "\n".join([f"$ {match['command']}", *lines])
            return f"<!-- run: {match['command']} -->\n\n```text\n{shown}\n```\n"

        return BLOCK.sub(block, text)


def on_a_terminal(line: str) -> list[str]:
    """``line`` as a terminal of 80 columns wraps it at words."""
    if len(line) <= 80:
        return [line.rstrip()]
    return textwrap.wrap(line, 80, break_long_words=False, break_on_hyphens=False)


def measured() -> str:
    """The rows of the last `make bench` that compare with what people use now."""
    rows = {row["work"]: row for row in json.loads((README.parent / "benchmarks" / "latest.json").read_text())["rows"]}
    lines = [f"| {text} | {shown(rows[name])} |" for name, text in ROWS.items() if name in rows]
    return "\n".join(["| this program | measured |", "|---|---|", *lines, *hidden()])


def hidden() -> list[str]:
    """Rows of the last `make hidden`: the effects named of each set, and of all sets what should not have been said.

    Effects below the noise are not asked for.
    """
    files = {kind: README.parent / "benchmarks" / f"hidden{kind}.json" for kind in HIDDEN}
    counts = {kind: json.loads(file.read_text())["summary"] for kind, file in files.items() if file.exists()}

    def share(part: dict) -> str:
        return f"{part['count']} of {part['of']}"

    def total(part: str, of: str) -> str:
        return f"{sum(one[part] for one in counts.values())} of {sum(one[of] for one in counts.values())}"

    false = [one["false_names"] for one in counts.values()]
    rows = {
        f"hidden effects above the noise that `diagnose` names, {HIDDEN[kind]}": share(one["asked_for"])
        for kind, one in counts.items()
        if HIDDEN[kind]
    }
    rows["names that are false, over all records"] = share(
        {key: sum(one[key] for one in false) for key in ("count", "of")}
    )
    rows["records with unknown physics alone that it leaves unnamed"] = total("unknown_right", "unknown")
    rows["false alarms on healthy records"] = total("false_alarms", "healthy")
    return [f"| {text} | {value} |" for text, value in rows.items()]


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

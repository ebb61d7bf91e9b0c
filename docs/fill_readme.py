"""Put into README.md what its commands really print: behind every ``<!-- run: ... -->`` the output of that command.

``python docs/fill_readme.py`` rewrites the file; ``--check`` only says whether it is as it should be. A test does the
latter, so the page cannot say what the program does not.
"""

import re
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / "_ext"))

README = Path(__file__).resolve().parents[1] / "README.md"
BLOCK = re.compile(r"<!-- run: (?P<command>[^\n]*) -->\n(?:\n```text\n.*?\n```\n)?", re.DOTALL)
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


def without_numbers_tail(text: str) -> str:
    """``text`` with numbers cut to three digits: processors differ in the last ones."""
    return re.sub(r"\d+\.\d+(?:e[-+]?\d+)?", lambda m: f"{float(m[0]):.3g}", re.sub(r" +", " ", text))


if __name__ == "__main__":
    before = README.read_text(encoding="utf-8")
    after = filled(before)
    if "--check" in sys.argv:
        sys.exit(without_numbers_tail(before) != without_numbers_tail(after))
    README.write_text(after, encoding="utf-8")

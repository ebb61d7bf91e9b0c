"""The ``run`` directive: runs a command while the page is built and shows what it really prints.

Every page has a folder of its own, filled by ``emps-design init``, in which its commands run one after another.
"""

import os
import shlex
import subprocess
import sys
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive, directives

LONGEST = 60  # lines shown


class Run(Directive):
    """``{run} emps-design gains --crossover 100``; ``:status:`` is the exit status the page expects."""

    required_arguments = 1
    final_argument_whitespace = True
    option_spec = {"status": directives.nonnegative_int, "lines": directives.positive_int, "stderr": directives.flag}  # noqa: RUF012

    def run(self):
        environment = self.state.document.settings.env
        folder = working_folder(environment)
        command = " ".join(self.arguments[0].split()).replace("{docs}", str(Path(environment.srcdir)))
        done = execute(command, folder)
        if done.returncode != self.options.get("status", 0):
            raise self.error(f"{command}: exit status {done.returncode}\n{done.stderr}")
        text = done.stdout + (done.stderr if "stderr" in self.options or not done.stdout else "")
        lines = text.replace(str(folder), "~").rstrip().splitlines()
        longest = self.options.get("lines", LONGEST)
        if len(lines) > longest:
            lines = [*lines[:longest], f"... ({len(lines) - longest} more lines)"]
        command = command.replace(f"{environment.srcdir}/", "docs/")
        shown = "\n".join([f"$ {command}", *lines])
        block = nodes.literal_block(shown, shown)
        block["language"] = "text"
        return [block]


def working_folder(environment) -> Path:
    """The folder of the page that is being read, with an axis and a record in it."""
    folder = Path(environment.app.outdir).parent / "run" / environment.docname.replace("/", "-")
    if getattr(environment, "command_output_fresh", None) != environment.docname:
        for old in sorted(folder.rglob("*"), reverse=True) if folder.exists() else ():
            old.rmdir() if old.is_dir() else old.unlink()
        execute("emps-design init . --force", folder)
        environment.command_output_fresh = environment.docname
    return folder


def execute(command: str, folder: Path) -> subprocess.CompletedProcess:
    """Run ``emps-design`` (or Python) of this environment in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    words = shlex.split(command)
    program = {"emps-design": [sys.executable, "-m", "emps_design.cli"], "python": [sys.executable]}[words[0]]
    settings = {**os.environ, "COLUMNS": "110", "TERM": "dumb", "NO_COLOR": "1", "MPLBACKEND": "Agg"}
    settings["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).resolve().parents[2]), settings.get("PYTHONPATH", "")])
    return subprocess.run(
        [*program, *words[1:]], cwd=folder, env=settings, capture_output=True, text=True, check=False, timeout=900
    )


def setup(app):
    """Register the directive."""
    app.add_directive("run", Run)
    return {"parallel_read_safe": False, "parallel_write_safe": True}

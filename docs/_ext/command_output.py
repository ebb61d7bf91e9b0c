"""The ``run`` directive: runs a command while the page is built and shows what it really prints.

Every page has a folder of its own, filled by ``emps-design init``, in which its commands run one after another.
"""

import os
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive, directives
from run_command import execute

LONGEST = 60  # lines shown


class Run(Directive):
    """``{run} emps-design gains --crossover 100``; ``:status:`` is the exit status the page expects,
    ``:picture:`` a file that the command draws and what it shows, such as ``out.png A response``: it stands below."""

    required_arguments = 1
    final_argument_whitespace = True
    option_spec = {  # noqa: RUF012
        "status": directives.nonnegative_int,
        "lines": directives.positive_int,
        "stderr": directives.flag,
        "picture": directives.unchanged_required,
    }

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
        if "picture" not in self.options:
            return [block]
        name, _, shows = self.options["picture"].partition(" ")
        if not (folder / name).is_file():
            raise self.error(f"{command}: drew no {name}")
        return [block, nodes.image(uri=f"/{os.path.relpath(folder / name, environment.srcdir)}", alt=shows)]


def working_folder(environment) -> Path:
    """The folder of the page that is being read, with an axis and a record in it."""
    folder = Path(environment.app.outdir).parent / "run" / environment.docname.replace("/", "-")
    if getattr(environment, "command_output_fresh", None) != environment.docname:
        for old in sorted(folder.rglob("*"), reverse=True) if folder.exists() else ():
            old.rmdir() if old.is_dir() else old.unlink()
        execute("emps-design init . --force", folder)
        environment.command_output_fresh = environment.docname
    return folder


def setup(app):
    """Register the directive."""
    app.add_directive("run", Run)
    return {"parallel_read_safe": False, "parallel_write_safe": True}

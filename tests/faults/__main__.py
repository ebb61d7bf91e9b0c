"""Put faults into the code, one at a time, and ask the tests: ``python -m tests.faults`` (``make faults``).

Each ``*.patch`` beside this file is one fault; its first line names the test that found it last. It is applied to a
copy of the working tree. That test runs first, then the doctests and the unit tests of the fault's room, all tests that
import the room, and the whole suite, until one fails. Prints a row for each fault with that test, and writes all of
them to ``--out``, and with ``--renew`` into the patches. A fault that nothing finds gives exit status 1.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
REPOSITORY = FOLDER.parents[1]
FOUND_BY = "Found by "
LEFT_OUT = shutil.ignore_patterns(".git", ".venv", "build", ".mypy_cache", ".pytest_cache", ".hypothesis")


def room(patch: Path) -> str:
    """The folder of the package that the fault is in, or the name of its module at the top."""
    line = next(line for line in patch.read_text(encoding="utf-8").splitlines() if line.startswith("+++ "))
    return line.partition("emps_design/")[2].split("/")[0].removesuffix(".py")


def last(tree: Path, patch: Path) -> list[str]:
    """The test that found the fault last, if it is still there."""
    line = patch.read_text(encoding="utf-8").partition("\n")[0]
    file, _, function = line.removeprefix(FOUND_BY).partition("::")
    place = tree / file
    name = function.partition("[")[0].rpartition(".")[2]  # of a doctest the function it describes
    known = line.startswith(FOUND_BY) and place.exists() and name in place.read_text("utf-8")
    return [f"{file}::{function}"] if known else []


def renew(patch: Path, test: str) -> None:
    """Write into ``patch`` that ``test`` found it."""
    text = patch.read_text(encoding="utf-8")
    if text.startswith(FOUND_BY):
        text = text.partition("\n")[2]
    patch.write_text(f"{FOUND_BY}{test}\n{text}", encoding="utf-8")


def own(tree: Path, name: str) -> list[str]:
    """Unit tests of the room called ``name``, and its doctests."""
    place = tree / "emps_design" / name
    tests = tree / "tests" / "unit" / name
    places = (tests, tests.with_name(f"test_{name}.py"), place, place.with_suffix(".py"))
    return [str(path.relative_to(tree)) for path in places if path.exists()]


def near(tree: Path, name: str) -> list[str]:
    """Tests that import the room called ``name``."""
    tests = [test for test in sorted((tree / "tests").rglob("test_*.py")) if f"emps_design.{name}" in test.read_text()]
    return [str(path.relative_to(tree)) for path in sorted(tests, key=lambda test: "unit" not in test.parts)]


def apply(tree: Path, patch: Path, *options: str) -> None:
    """Put the fault in, or take it out with ``-R``; a patch that no longer fits ends the run with its name."""
    done = subprocess.run(["git", "apply", *options, str(patch)], cwd=tree, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{patch.name}: does not fit the code any more, renew it: {done.stderr.strip()}")


def first_failure(tree: Path, tests: list[str], workers: str) -> str | None:
    """The first of the ``tests`` that fails, of all where there are none; None where all pass."""
    # The copy is first on the path of what the tests start, too: the package may be installed from elsewhere.
    environment = {**os.environ, "PYTHONPATH": str(tree), "EMPS_DESIGN_DATA": data(), "PYTHONHASHSEED": "0"}
    several = ["-n", workers, "--dist", "worksteal"] if not tests or "::" not in tests[0] else []
    command = [sys.executable, "-m", "pytest", "-x", *several, "--no-header", "-rfE", *tests]
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return None
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return failed[0].split(" - ")[0].partition(" ")[2] if failed else f"pytest ended with {done.returncode}"


def data() -> str:
    return os.environ.get("EMPS_DESIGN_DATA", str(REPOSITORY.parent / "shared" / "data"))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("names", nargs="*", help="faults to try, all without")
    parser.add_argument("--workers", default="2")
    parser.add_argument("--near", action="store_true", help="only the tests that import the room of a fault")
    parser.add_argument("--renew", action="store_true", help="write the test that found a fault into its patch")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "build" / "faults.json")
    options = parser.parse_args()
    patches = [patch for patch in sorted(FOLDER.glob("*.patch")) if not options.names or patch.stem in options.names]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "emps_design"
        shutil.copytree(REPOSITORY, tree, ignore=LEFT_OUT)  # with the compiled code beside the sources
        for patch in patches:
            start = time.perf_counter()
            apply(tree, patch)
            name = room(patch)
            steps = list(filter(None, (last(tree, patch), own(tree, name), near(tree, name))))
            steps += [] if options.near else [[]]
            failed = next(filter(None, (first_failure(tree, tests, options.workers) for tests in steps)), None)
            apply(tree, patch, "-R")
            if options.renew and failed:
                renew(patch, failed)
            seconds = time.perf_counter() - start
            rows.append({"fault": patch.stem, "room": name, "failed": failed, "seconds": round(seconds, 1)})
            print(f"{patch.stem:<40}{failed or 'NOT FOUND':<100}{seconds:7.1f} s", flush=True)
            options.out.parent.mkdir(parents=True, exist_ok=True)
            options.out.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
    missed = [row["fault"] for row in rows if row["failed"] is None]
    print(f"{len(rows) - len(missed)} of {len(rows)} faults found{': not ' + ', '.join(missed) if missed else ''}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())

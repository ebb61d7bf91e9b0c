"""How long work goes on after it was told to stop: ``python -m benchmarks.cancel`` writes ``benchmarks/cancel.json``.

Every command that can take minutes is started on enough work for them, and gets a signal in the midst of it; the jobs
of the studio are cancelled the way its button does it. What counts is wall time, on whatever else the machine was doing
(its load is in the file).
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

MOMENTS = {signal.SIGTERM: 1.5, signal.SIGINT: 3.0}  # CPU seconds from the start of the process
LONG = {
    "identify, 100,000 draws of the bootstrap": "identify {record} --bootstrap 100000",
    "diagnose": "diagnose {record}",
    "diagnose, 1,000 healthy records": "diagnose {record} --healthy-runs 1000",
    "simulate, 1,000,000 plants": "simulate --scenario comanipulation --plants 1000000",
    "impedance, 1,000,000 plants": "impedance --mass 50 --damping 100 --mismatch 0.02 --plants 1000000",
    "report": "report --record {record} --mass 50 --damping 100 --out {out}",
}


def in_the_terminal(line: str, number: signal.Signals, moment: float) -> float | None:
    """Seconds from a signal after ``moment`` [s] of computing to the end; None where the work was done by then."""
    command = [sys.executable, "-m", "emps_design.cli", *line.split()]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        while process.poll() is None and computed(process.pid) < moment:
            time.sleep(0.02)
        if process.poll() is not None:
            return None
        start = time.perf_counter()
        process.send_signal(number)
        process.communicate()
        assert process.returncode == 130, (line, process.returncode)
        return time.perf_counter() - start


def computed(pid: int) -> float:
    """Seconds that a process has computed: fields 14 and 15 of proc(5)'s stat."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return float("inf")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def in_the_studio(work: Callable[[Callable], object], moment: float) -> float | None:
    """The same for the button of a job: its poll, which the page calls, is called by hand."""
    from emps_design.studio import panes

    polls: list[Callable[[], None]] = []
    said: list[object] = []

    class Callback:
        def stop(self) -> None:
            polls.clear()

    panes.pn.state.add_periodic_callback = lambda poll, period: polls.append(poll) or Callback()
    job = panes.Job()
    start = time.process_time()
    job.start(work, said.append, said.append)
    while polls and time.process_time() - start < moment:
        polls[0]()
        time.sleep(panes.POLL / 1e3)
    if not polls:
        return None
    job.stop()
    start = time.perf_counter()
    while polls:
        polls[0]()
        time.sleep(panes.POLL / 1e3)
    assert said == [panes.CANCELLED], said
    return time.perf_counter() - start


def main() -> None:
    """Cancel everything at every moment, and write the longest."""
    from emps_design.discrepancy.diagnosis import diagnose
    from emps_design.files import write_text
    from emps_design.machines import machine
    from emps_design.simulation.synthetic import synthetic_record
    from emps_design.studio.simulation_view import simulate
    from emps_design.studio.state import State

    for number in MOMENTS:  # a job in the background of a shell ignores one of them
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    axis = machine("emps2019")
    record = synthetic_record(axis)
    rows = []

    def add(work: str, how: str, seconds: list[float | None]) -> None:
        found = [one for one in seconds if one is not None]
        worst = round(max(found), 2) if found else None
        rows.append({"work": work, "how": how, "times": len(found), "longest": worst})
        print(*rows[-1].values(), flush=True)

    with tempfile.TemporaryDirectory() as folder:
        places = {"record": f"{folder}/record.npz", "out": f"{folder}/out.html"}
        record.save(places["record"])
        for work, line in LONG.items():
            line = line.format(**places)
            add(work, "signal", [in_the_terminal(line, number, moment) for number, moment in MOMENTS.items()])
    state = State.of(machine("emps2018")).changed(plants=10000)
    jobs_ = {
        "studio: 10,000 plants": lambda progress: simulate(state, progress),
        "studio: diagnose": lambda progress: diagnose(record, axis, progress=progress),
    }
    for work, job in jobs_.items():
        add(work, "Cancel work", [in_the_studio(job, moment) for moment in MOMENTS.values()])
    document = {
        "date": datetime.now(UTC).date().isoformat(),
        "load": round(os.getloadavg()[0], 1),
        "processors": os.cpu_count(),
        "rows": rows,
    }
    write_text(Path(__file__).with_name("cancel.json"), json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""BLAS has one thread where matrices are tall and thin, also that of a library which is loaded only then."""

import os
import subprocess
import sys

COUNT = """
from emps_design.identification.controller import identify_law
from emps_design.records import Record
from threadpoolctl import threadpool_info

def threads(records, units):
    import scipy.optimize
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

identify_law.__globals__["_identified"] = threads
print(identify_law(object.__new__(Record)))
"""


def test_a_search_for_a_law_has_one_thread_even_if_it_loads_scipy():
    own = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", COUNT], capture_output=True, text=True, check=True, env=own)
    assert done.stdout.strip() == "{1}"

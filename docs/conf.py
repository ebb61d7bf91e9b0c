"""Sphinx settings. The build runs the commands it shows and needs no network."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

from gallery_examples import gallery_sources, needs_nothing  # noqa: E402

from emps_design import __version__  # noqa: E402

project = "emps_design"
author = "the emps_design authors"
release = version = __version__
extensions = [
    "myst_parser",
    "command_output",
    "constants",
    "derivation_steps",
    "mathtext",
    "effects_catalogue",
    "measured_tables",
    "reference_pages",
    "sphinx_gallery.gen_gallery",
]
sphinx_gallery_conf = {
    "examples_dirs": str(gallery_sources(HERE.parent / "examples", HERE / "_build" / "examples")),
    "gallery_dirs": "gallery",
    "filename_pattern": needs_nothing(HERE.parent / "examples"),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "image_scrapers": ("gallery_examples",),
    "show_memory": False,
    "show_signature": False,
    "within_subsection_order": "FileNameSortKey",
    "min_reported_time": 1e9,
    "reset_argv": "gallery_examples.arguments",
}

html_theme = "furo"
html_title = f"emps_design {release}"
html_math_renderer = "mathtext"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_copy_source = False
html_show_copyright = False
templates_path: list[str] = []
exclude_patterns = ["_build", "_ext", "sg_execution_times.rst", "gallery/*.ipynb", "gallery/*.py"]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
nitpicky = False
suppress_warnings = ["config.cache"]
